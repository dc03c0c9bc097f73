"""Recordings of several soils: that is said, and no effect or force takes its place."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnose.hidden import Case, case
from diagnose.searches import baseline

from artibot_sim.diagnose.candidates.hypotheses import with_effect
from artibot_sim.diagnose.extended import found_parameters
from artibot_sim.diagnose.records import Options
from artibot_sim.diagnose.selection.per_recording import fitted_by_recording
from artibot_sim.diagnose.sizes import sized
from artibot_sim.diagnose.validation.stability import disagreement
from artibot_sim.estimation.search import converge
from artibot_sim.estimation.solver import evaluate
from artibot_sim.model import load_robot


def driven(hidden: tuple[str, ...], seed: int, duration: float = 20.0) -> Case:
    """Two recordings to diagnose and one to hold out."""
    return case(hidden, 1.0, seed, runs=2, duration=duration)


@pytest.fixture(scope="module")
def alike() -> Case:
    """Recordings on one soil with nothing hidden."""
    return driven((), 36)


def test_one_soil_is_one(alike: Case) -> None:
    problem, fit = baseline(alike.recordings, load_robot("agriq"), Options())
    assert -1e-6 < disagreement(problem, fit) < 30.0
    assert fitted_by_recording(problem, fit).nats < 30.0


def test_a_single_recording_agrees_with_itself(alike: Case) -> None:
    assert disagreement(*baseline(alike.recordings[:1], load_robot("agriq"), Options())) == 0.0


@pytest.mark.long
def test_of_three_days_the_friction_is_the_same_and_the_ground_is_not() -> None:
    """Each day has a soil of its own. One for all makes the joint's friction a sixth too small; their mean has it."""
    days = [case(("joint_friction",), 1.0, seed, runs=1, held_out=0, duration=12.0) for seed in (61, 62, 63)]
    names = [f"day{k}" for k in (1, 2, 3)]
    each = [replace(day.recordings[0], name=name, path=Path(name)) for day, name in zip(days, names, strict=True)]
    problem, fit = baseline(each, load_robot("agriq"), Options())
    extension = sized("joint_friction", load_robot("agriq"))
    larger = with_effect(problem, extension)
    begin = np.concatenate([fit.point.coordinates, extension.coordinates({"torque": 10.0})])
    fit = converge(larger, evaluate(larger, fit.loss, [begin], fit.point.starts)[0], fit.loss, 8)
    alone = fitted_by_recording(larger, fit)
    assert alone.sufficient and alone.nats > 200.0
    mean, covariance = alone.mean("joint_friction")
    found = found_parameters(extension, mean, covariance)["torque"]
    assert found.value == pytest.approx(10.0, rel=0.03) and found.ci95[0] < 10.0 < found.ci95[1]
    assert found.ci95[1] - found.ci95[0] < 2.0
    for name, _, values in alone.soil:
        assert values == pytest.approx([day.truth.soil[name] for day in days], rel=0.05), name
    assert re.fullmatch(
        r"joint friction: torque \(N·m\) \S+ in day1, \S+ in day2, \S+ in day3 \(mean 9\.\d+, spread 0\.\d+\)",
        alone.size_words,
    )
