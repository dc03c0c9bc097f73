"""Diagnoses of recordings that another program made of a rover with one effect, or none."""

from __future__ import annotations

import numpy as np
import pytest
from bag_helpers import foreign

from artibot_sim.diagnose import Verdict, diagnose
from artibot_sim.experiment import read_bag
from artibot_sim.model import load_robot

ROBOT = load_robot("agriq")


FIELD_TRUTH = {
    "none": {},
    "slope": {"grade": 0.05, "heading": 1.875},
    "joint_friction": {"torque": 10.0},
    "speed_loop_lag": {"time_constant": 0.25},
}


@pytest.mark.long
@pytest.mark.parametrize("what", FIELD_TRUTH)
def test_recordings_made_elsewhere(what: str) -> None:
    """Twelve seconds of each run say enough."""
    runs = [read_bag(foreign(f"field_examples/{what}/run{k}")).between(20.0, 32.0) for k in range(3)]
    result = diagnose(runs, ROBOT)
    truth = FIELD_TRUTH[what]
    if not truth:
        assert result.verdict is Verdict.NONE
        return
    assert result.verdict is Verdict.NAMED
    assert [cause.effect for cause in result.causes] == [what]
    for name, value in truth.items():
        given = result.causes[0].parameters[name]
        assert given.value == pytest.approx(value, rel=0.15)
        assert given.ci95[0] < value < given.ci95[1]
    assert np.isfinite(result.causes[0].log10_bayes_factor)
