"""The tables that decide: every row decides somewhere, all facts are decided, and the docs have them as they are."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import pytest

from artibot_sim.diagnose import policy
from artibot_sim.diagnose.conclusion import size_of
from artibot_sim.diagnose.records import SlowResidual
from artibot_sim.diagnose.remains import COMMANDED, LIMITS
from artibot_sim.diagnose.tables import filled
from artibot_sim.diagnose.verdict import COMMANDS, MOTION, TABLES, VERDICT, Outcome, Reason, Table, Verdict
from artibot_sim.estimation.windows import CHANNEL_NAMES
from ros_helpers import ROOT


def every(table: Table) -> Iterator[dict[str, str]]:
    """All combinations of facts."""
    for facts in itertools.product(*(answers for _, answers in table.questions.values())):
        yield dict(zip(table.questions, facts, strict=True))


@pytest.mark.parametrize("table", TABLES, ids=lambda table: table.title)
def test_every_combination_is_decided_and_every_row_decides_some(table: Table) -> None:
    deciding = {id(table.first(facts.__getitem__)) for facts in every(table)}
    assert deciding == {id(row) for row in table.rows}


@pytest.mark.parametrize("table", TABLES, ids=lambda table: table.title)
def test_rows_ask_for_facts_that_there_are(table: Table) -> None:
    for row in table.rows:
        for question, facts in row.when.items():
            assert set(facts) <= set(table.questions[question][1]), (row, question)


def test_nothing_is_asked_that_is_not_needed() -> None:
    """Forces and predictions cost minutes."""
    asked: list[str] = []

    def ask(question: str) -> str:
        asked.append(question)
        return {"several soils": "no", "effects": "no", "left": "noise"}[question]

    assert MOTION.first(ask).then is Outcome.NOTHING
    assert asked == ["several soils", "effects", "left"]


def test_a_fact_that_there_is_not_is_refused() -> None:
    with pytest.raises(ValueError, match="left is 'much'"):
        MOTION.first({"several soils": "no", "effects": "no", "left": "much"}.__getitem__)


def test_nothing_is_named_that_held_out_recordings_speak_against() -> None:
    for table in (MOTION, COMMANDS):
        for facts in every(table):
            row = table.first(facts.__getitem__)
            if facts["held out"] == "worse":
                assert row.then is not Outcome.NAMED
            if row.then is Outcome.NAMED:
                assert facts["effects"] == "yes"


def test_nothing_is_called_right_where_more_than_noise_is_left() -> None:
    for facts in every(MOTION):
        if MOTION.first(facts.__getitem__).then is Outcome.NOTHING:
            assert "noise" in (facts["left without"] if facts["effects"] == "yes" else facts["left"])
    for facts in every(COMMANDS):
        if COMMANDS.first(facts.__getitem__).then is Outcome.NOTHING and facts["followed"] not in UNJUDGED:
            assert facts["left without" if facts["effects"] == "yes" else "left"] == "noise"
    for facts in every(VERDICT):
        if VERDICT.first(facts.__getitem__).then is Verdict.NONE:
            assert facts["motion"] == facts["commands"] == "nothing"


def test_every_channel_counts_in_what_is_left() -> None:
    assert set(LIMITS) == {*CHANNEL_NAMES, COMMANDED}


@pytest.mark.parametrize("channel", [*CHANNEL_NAMES])
def test_a_channel_far_beyond_its_noise_is_no_answer(channel: str) -> None:
    """Positions 0.2 s late, named as joint friction, leave 280 times their noise."""
    facts = {
        "several soils": "no", "effects": "yes", "force": "no", "held out": "better", "forces": "yes", "sure": "yes",
        "left without": "far more",
    }  # fmt: skip
    left = {name: SlowResidual(1.0, 1.5) for name in CHANNEL_NAMES}
    assert MOTION.first((facts | {"left": size_of(left)}).__getitem__).then is Outcome.NAMED
    left[channel] = SlowResidual(280.0, 300.0)
    assert MOTION.first((facts | {"left": size_of(left)}).__getitem__).then is Outcome.UNEXPLAINED


def test_positions_may_err_slowly() -> None:
    """A total station leaves 3, poses that a filter smoothed 34 with the right effect named."""
    assert (
        size_of({"position": SlowResidual(34.0, 60.0)}) == "noise"
        and size_of({"position": SlowResidual(150.0, 150.0)}) == "more"
    )


UNJUDGED = ("not commanded", "not theirs")
NO_COMMANDS = {"followed": "not commanded"}
QUIET = {"followed": "yes", "effects": "no", "left": "noise"}
EFFECT = {
    "several soils": "no", "effects": "yes", "left": "noise", "force": "no", "held out": "better", "forces": "yes",
}  # fmt: skip
MOVED = EFFECT | {"forces": "no", "sure": "yes"}
"""Found where only rates and poses were measured, and sure on held-out recordings."""
NOTHING = {"several soils": "no", "effects": "no", "left": "noise"}
DELAY = {"followed": "yes", "effects": "yes", "left": "noise", "share": "little", "held out": "better"}


@pytest.mark.parametrize(
    ("motion", "commands", "tie", "verdict", "reasons"),
    [
        (NOTHING, NO_COMMANDS, "no", Verdict.NONE, ("", "")),
        (NOTHING, QUIET, "no", Verdict.NONE, ("", "")),
        (NOTHING, QUIET | {"left": "more"}, "no", Verdict.UNEXPLAINED, ("", "")),  # a ramp on the commands
        (NOTHING, {"followed": "no"}, "no", Verdict.UNEXPLAINED, ("", "")),
        (NOTHING, {"followed": "not theirs"}, "no", Verdict.NONE, ("", "")),
        (EFFECT, {"followed": "not theirs"}, "no", Verdict.NAMED, ("", "")),
        (NOTHING | {"left": "more"}, QUIET, "no", Verdict.UNEXPLAINED, ("", "")),
        (NOTHING | {"left": "far more"}, DELAY, "no", Verdict.UNEXPLAINED, ("", "")),
        (EFFECT, QUIET, "no", Verdict.NAMED, ("", "")),
        (EFFECT, QUIET, "yes", Verdict.AMBIGUOUS, ("", "")),
        (NOTHING, DELAY, "yes", Verdict.AMBIGUOUS, ("", "")),
        (EFFECT | {"left": "more"}, QUIET, "no", Verdict.NAMED, ("BESIDE", "")),
        (EFFECT, QUIET | {"left": "more"}, "no", Verdict.NAMED, ("", "")),
        (EFFECT | {"left": "far more"}, QUIET, "no", Verdict.UNEXPLAINED, ("DOUBT", "")),
        (EFFECT | {"left": "more", "force": "yes"}, QUIET, "no", Verdict.UNEXPLAINED, ("", "")),
        (EFFECT | {"force": "yes"}, QUIET, "no", Verdict.UNEXPLAINED, ("", "")),  # noise is left, a law likelier
        (EFFECT | {"force": "beside"}, QUIET, "no", Verdict.NAMED, ("LAW", "")),
        (EFFECT | {"held out": "worse", "left without": "noise"}, QUIET, "no", Verdict.NONE, ("REFUTED", "")),
        (EFFECT | {"held out": "worse", "left without": "more"}, QUIET, "no", Verdict.UNEXPLAINED, ("REFUTED", "")),
        (EFFECT | {"held out": "worse", "left without": "noise"}, DELAY, "no", Verdict.NAMED, ("REFUTED", "")),
        (EFFECT | {"left": "more", "held out": "little", "left without": "more"}, QUIET, "no", Verdict.UNEXPLAINED,
         ("MINOR", "")),
        (MOVED | {"left": "more", "held out": "little"}, QUIET, "no", Verdict.NAMED, ("VARIES", "")),
        (MOVED | {"left": "far more"}, QUIET, "no", Verdict.NAMED, ("VARIES", "")),
        (MOVED | {"left": "far more", "sure": "no"}, QUIET, "no", Verdict.UNEXPLAINED, ("DOUBT", "")),
        (MOVED | {"left": "more", "held out": "little", "sure": "no", "left without": "more"}, QUIET, "no",
         Verdict.UNEXPLAINED, ("MINOR", "")),
        (MOVED | {"left": "more", "held out": "worse", "left without": "more"}, QUIET, "no", Verdict.UNEXPLAINED,
         ("REFUTED", "")),
        (MOVED | {"left": "more", "force": "yes"}, QUIET, "no", Verdict.NAMED, ("VARIES", "")),
        (MOVED | {"left": "more", "force": "yes", "sure": "no"}, QUIET, "no", Verdict.UNEXPLAINED, ("", "")),
        (MOVED | {"left": "more", "force": "yes", "held out": "worse"}, QUIET, "no", Verdict.UNEXPLAINED, ("", "")),
        ({"several soils": "instead"}, QUIET, "no", Verdict.UNEXPLAINED, ("", "")),
        ({"several soils": "instead"}, DELAY, "no", Verdict.NAMED, ("", "")),
        (EFFECT | {"several soils": "beside", "left": "far more"}, QUIET, "no", Verdict.NAMED, ("", "")),
        (NOTHING, DELAY, "no", Verdict.NAMED, ("", "")),
        (NOTHING, DELAY | {"left": "more"}, "no", Verdict.NAMED, ("", "BESIDE")),
        (NOTHING, DELAY | {"left": "more", "share": "most"}, "no", Verdict.UNEXPLAINED, ("", "DOUBT")),
        (NOTHING, DELAY | {"held out": "worse", "left without": "noise"}, "no", Verdict.NONE, ("", "REFUTED")),
        (NOTHING, DELAY | {"held out": "worse", "left without": "more"}, "no", Verdict.UNEXPLAINED, ("", "REFUTED")),
    ],
)  # fmt: skip
def test_the_ways_to_each_verdict(
    motion: dict[str, str], commands: dict[str, str], tie: str, verdict: Verdict, reasons: tuple[str, str]
) -> None:
    first, second = MOTION.first(motion.__getitem__), COMMANDS.first(commands.__getitem__)
    facts = {"motion": first.then.name.lower(), "commands": second.then.name.lower(), "tie": tie, "encoders": "nothing"}
    assert VERDICT.first(facts.__getitem__).then is verdict
    smoothed = VERDICT.first((facts | {"encoders": "named"}).__getitem__).then  # speeds, as angles show
    assert smoothed is (Verdict.NAMED if verdict is Verdict.NONE and tie == "no" else verdict)
    wanted = tuple(Reason[one] if one else Reason.NO_REASON for one in reasons)
    assert (first.reason, second.reason) == wanted


def test_the_docs_have_the_tables_as_they_are() -> None:
    """`make tables` writes them."""
    text = (ROOT / "docs" / "diagnosis_method.md").read_text(encoding="utf-8")
    assert filled(text) == text
    with pytest.raises(ValueError, match="no place"):
        filled("no table here")


def test_every_number_says_what_it_is() -> None:
    found = policy.numbers()
    assert len(found) > 20
    for name, one in found.items():
        assert one.unit and one.meaning and one.calibration, name
    assert float(policy.NATS_FLOOR) == policy.THRESHOLDS.floor
