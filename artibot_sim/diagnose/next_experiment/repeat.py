"""What to measure next where something acts of which no manoeuvre is known to show more: the same once more."""

from __future__ import annotations

from collections.abc import Sequence

from artibot_sim.diagnose.diagnosis import NextExperiment
from artibot_sim.diagnose.words import channel_words, joined


def repeated(missing: Sequence[str]) -> NextExperiment:
    """One of the recorded drives again, with what was not measured, or else elsewhere.

    Parameters
    ----------
    missing : sequence of str
        Channels that the recordings lack.
    """
    if missing:
        absent = joined([channel_words(channel) for channel in missing])
        said = f"Drive one of these again and record {absent} as well: a force on no list shows what it is there."
    else:
        said = (
            "Drive one of these again, once on the same ground and once on another: what comes back on both belongs to "
            "the rover, what comes back on the same ground alone to that, and what does not come back to that hour."
        )
    return NextExperiment(said, "", (), float("nan"))


def one_by_one(names: Sequence[str]) -> NextExperiment:
    """Nothing to drive yet: the same recordings, of which each has a soil of its own."""
    said = (
        f"Diagnose {joined(names)} one by one: each is then held against a soil of its own. Manoeuvres that are to be "
        "diagnosed together are best driven on one ground, within hours."
    )
    return NextExperiment(said, "", (), float("nan"))
