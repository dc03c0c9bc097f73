"""A diagnosis's searches for tests: the soil's alone, and those for effects with few of them tried, each made once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest

from artibot_sim.diagnose.candidates.hypotheses import Hypothesis
from artibot_sim.diagnose.records import Options
from artibot_sim.diagnose.selection import forward, stepwise
from artibot_sim.diagnose.selection.every_window import every_window
from artibot_sim.estimation.loss import Loss
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.search import Fit
from artibot_sim.experiment import Experiment
from artibot_sim.model import Robot

FEW = ("joint_damping", "payload", "slope", "gyro_bias")
"""One of every kind: in the joint, of the body, of the ground, of a sensor."""


def baseline(recordings: Sequence[Experiment], robot: Robot, options: Options) -> tuple[Problem, Fit]:
    """The paper's model with its soil identified, as a diagnosis begins."""
    return every_window(recordings, robot, options).soil()


def try_only(monkeypatch: pytest.MonkeyPatch, *effects: str) -> None:
    """Have searches by rotations try these effects alone, and none on a disc.

    Screening all of the list is most of what a search costs; that the right one of all is named is asked in
    test_seeds.py and test_elsewhere.py.
    """
    every = forward.hypotheses

    def few(*given: Any) -> list[Hypothesis]:
        return [one for one in every(*given) if one.id in effects]

    monkeypatch.setattr(forward, "hypotheses", few)
    monkeypatch.setattr(forward, "discs", lambda base: [])


def remember_stages(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have `stepwise` make a stage's search once for the same problem, fit and named effects."""
    searched: dict[tuple[object, ...], tuple[stepwise.SearchStage, Problem, Fit]] = {}
    stage = stepwise.stage

    def remembered(problem: Problem, fit: Fit, loss: Loss, named: Sequence[str], *rest: Any) -> stepwise.SearchStage:
        key = id(problem), id(fit), tuple(named)
        if key not in searched:  # problem and fit are kept, so that their numbers are not given to others
            searched[key] = stage(problem, fit, loss, named, *rest), problem, fit
        return searched[key][0]

    monkeypatch.setattr(stepwise, "stage", remembered)
