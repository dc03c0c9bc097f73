"""What `make steadiness` changes is what it says, and its summary tells steady answers from others."""

from __future__ import annotations

import numpy as np
import pytest
from click.testing import CliRunner

from artibot_sim.bench.steadiness import OutcomeSpread, VariantOutcome, generated, main, scaled, thinned, variants
from artibot_sim.model import load_robot


def test_changes_touch_what_they_say() -> None:
    (case,) = generated(1, 4.0, load_robot("agriq"))
    recording = case.recordings[0]
    before = recording.channels["motor_torques"].columns
    after = scaled([recording], 1.0 + 1e-5)[0].channels["motor_torques"].columns
    changed = [name for name in before if not np.array_equal(before[name], after[name])]
    assert len(changed) == 1 and changed[0].endswith(".effort")
    np.testing.assert_allclose(after[changed[0]], before[changed[0]] * (1.0 + 1e-5), rtol=1e-15)
    fewer = thinned([recording])[0].channels
    for key, channel in recording.channels.items():
        assert 0.95 * len(channel) - 2 < len(fewer[key]) <= len(channel)
        assert set(fewer[key].t_ns) <= set(channel.t_ns)
    assert len(fewer["motor_torques"]) < len(recording.channels["motor_torques"])
    assert {one.seed for one in variants(False)} == set(range(10))


@pytest.mark.parametrize(
    ("nats", "value", "length", "steady"),
    [(101.0, 5.01, 1.0, True), (104.0, 5.01, 1.0, False), (101.0, 5.2, 1.0, False), (101.0, 5.01, 1.3, False)],
)
def test_what_is_wanted_is_asked_of_evidence_values_and_lengths(
    nats: float, value: float, length: float, steady: bool
) -> None:
    first = VariantOutcome("as it is", "named", ("slope",), 100.0, {"slope.grade": (5.0, 1.0)}, 1.0)
    other = VariantOutcome("seed 1", "named", ("slope",), nats, {"slope.grade": (value, length)}, 1.0)
    assert OutcomeSpread.of([first, other]).steady(100.0) is steady
    assert OutcomeSpread.of([first, other]).nats == pytest.approx(nats - 100.0)
    none = VariantOutcome("seed 2", "none", (), float("nan"), {}, 1.0)
    assert OutcomeSpread.of([first, none]).alike == 0.5 and not OutcomeSpread.of([first, none]).steady(100.0)


def test_absent_examples_are_said() -> None:
    done = CliRunner().invoke(main, ["--examples", "absent", "--generated", "0"], catch_exceptions=False)
    assert done.exit_code == 0 and "no field examples: absent" in done.output and "0 of 0 steady" in done.output
