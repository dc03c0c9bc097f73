"""Friction that falls once a wheel slides, and friction that falls from the first slip on: which it is, is told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnose.searches import try_only

from artibot_sim.diagnose.candidates.hypotheses import hypotheses
from artibot_sim.diagnose.pipeline import diagnose
from artibot_sim.diagnose.verdict import Verdict
from artibot_sim.identify.synthetic import random_manoeuvre, random_soil, synthetic
from artibot_sim.model import load_robot

VELOCITY = 0.08


def test_both_forms_are_tried():
    tried = [one for one in hypotheses(load_robot("agriq"), []) if one.id == "stribeck"]
    assert [one.extension.values(np.ones(1)) for one in tried] == [
        {"velocity": pytest.approx(VELOCITY), "early": early} for early in (0.0, 1.0)
    ]
    assert {one.alternatives for one in tried} == {2}


@pytest.mark.long
@pytest.mark.parametrize("early", [0.0, 1.0])
def test_the_form_is_told(monkeypatch: pytest.MonkeyPatch, early: float) -> None:
    try_only(monkeypatch, "payload", "back_friction", "joint_damping", "stribeck", "slip_ratio", "friction_anisotropy")
    robot, rng = load_robot("agriq"), np.random.default_rng([77, 3])
    hidden = replace(random_soil(robot, rng), effects={"stribeck": {"velocity": VELOCITY, "early": early}})
    recordings = [
        synthetic(hidden, random_manoeuvre(rng, 15.0), duration=15.0, seed=30 + i, name=f"run{i}") for i in range(3)
    ]
    found = diagnose(recordings[:2], robot, holdout=recordings[2:])
    assert found.verdict is Verdict.NAMED
    assert [cause.effect for cause in found.causes] == ["stribeck"]
    parameters = found.causes[0].parameters
    assert parameters["early"].value == early
    assert parameters["velocity"].value == pytest.approx(VELOCITY, rel=0.25)
