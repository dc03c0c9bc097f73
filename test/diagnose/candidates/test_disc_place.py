"""Where a disc of other ground is, and how surely: from a fit that has it somewhere beside."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from diagnose.turns import EVEN, TURNS

from artibot_sim.diagnose.candidates.hypotheses import with_effect
from artibot_sim.diagnose.candidates.patches import disc_place, on_best_disc
from artibot_sim.estimation.parameters import Extension
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.search import Fit, converge
from artibot_sim.estimation.solver import evaluate
from artibot_sim.identify.problems import problem_of
from artibot_sim.identify.requested import parameter_set
from artibot_sim.identify.synthetic import synthetic
from artibot_sim.identify.validation import fitted_starts
from artibot_sim.model import load_robot

ROBOT = load_robot("agriq")
THERE = {"x": 3.0, "y": 1.5, "radius": 1.5}
BESIDE = {"x": 3.2, "y": 1.35, "radius": 1.4}


def fitted(effect: str, size: float, fixed: dict[str, float]) -> tuple[Problem, Fit]:
    """A recording with the patch, and a fit with the effect as it is given."""
    recording = synthetic(replace(ROBOT, effects={"friction_patch": {"scale": 0.6, **THERE}}), TURNS, kappa=0.8, seed=4)
    problem = problem_of([recording], parameter_set(ROBOT), 5.0, 2)
    starts = fitted_starts(problem, 2)
    more = with_effect(problem, Extension(effect, fixed))
    (point,) = evaluate(more, EVEN, [np.append(starts.coordinates, size)], starts.starts)
    return more, converge(more, point, EVEN, 2)


def missed(disc: Mapping[str, float]) -> float:
    """How far a disc's centre is off, m."""
    return math.hypot(*(disc[name] - THERE[name] for name in ("x", "y")))


@pytest.mark.long
def test_the_disc_is_found_from_one_beside_it_and_the_interval_holds_it() -> None:
    problem, fit = fitted("friction_patch", -1.0, BESIDE)
    found = disc_place(problem, fit, 0, seed=1)
    assert found == disc_place(problem, fit, 0, seed=1)
    assert missed({name: value for name, (value, _) in found.items()}) < 0.6 * missed(BESIDE)
    for name, (_, (low, high)) in found.items():
        assert low - 0.05 <= THERE[name] <= high + 0.05
        assert 0.1 < high - low < 0.6


@pytest.mark.long
def test_the_fit_is_taken_to_the_best_disc() -> None:
    problem, fit = fitted("friction_patch", -1.0, BESIDE)
    moved, found = on_best_disc(problem, fit, seed=1, steps=2)
    disc = {name: float(moved.parameters.extensions[0].fixed[name]) for name in THERE}
    assert missed(disc) < 0.6 * missed(BESIDE)
    anew = evaluate(moved, found.loss, [found.point.coordinates], found.point.starts)[0]
    assert anew.cost == pytest.approx(found.point.cost)
    assert found.point.cost < fit.point.cost - 24.0


def test_what_is_no_disc_has_no_place() -> None:
    problem, fit = fitted("joint_friction", 0.1, {})
    assert disc_place(problem, fit, 0, seed=1) == {}
    assert on_best_disc(problem, fit, seed=1, steps=2) == (problem, fit)
