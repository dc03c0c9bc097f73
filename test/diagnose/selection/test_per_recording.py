"""Recordings of several soils: that is said, and no effect or force takes its place."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnose.hidden import OTHER_GROUND, Case, case
from diagnose.searches import FEW, try_only

from artibot_sim.diagnose import Verdict, diagnose
from artibot_sim.diagnose.candidates.hypotheses import with_effect
from artibot_sim.diagnose.extended import found_parameters
from artibot_sim.diagnose.pipeline import baseline
from artibot_sim.diagnose.records import Options
from artibot_sim.diagnose.selection.per_recording import fitted_by_recording
from artibot_sim.diagnose.selection.ridge_search import at_size
from artibot_sim.diagnose.sizes import sized
from artibot_sim.diagnose.validation.stability import disagreement
from artibot_sim.estimation.parameters import Extension
from artibot_sim.estimation.search import converge
from artibot_sim.estimation.solver import evaluate
from artibot_sim.model import load_robot


def driven(hidden: tuple[str, ...], seed: int, duration: float = 20.0) -> Case:
    """Two recordings to diagnose and one to hold out."""
    return case(hidden, 1.0, seed, runs=2, duration=duration)


@pytest.mark.long
def test_the_ground_is_said_to_differ() -> None:
    found = driven((OTHER_GROUND,), 31, duration=9.0)
    answer = diagnose(found.recordings, load_robot("agriq"), holdout=found.holdout)
    assert answer.verdict is Verdict.UNEXPLAINED and not answer.causes
    assert answer.unexplained is not None and answer.unexplained.variable == "recording"
    assert answer.unexplained.size == pytest.approx(0.25, abs=0.04)  # a ratio of two values, each right to 3 %
    assert "run0" in answer.unexplained.where and "run1" in answer.unexplained.where
    assert answer.next_experiment is not None and "one by one" in answer.next_experiment.what
    assert "the ground is not the same" in str(answer).lower()


@pytest.mark.long
def test_each_soil_is_found() -> None:
    found = driven((OTHER_GROUND,), 35)
    soil, factor = found.truth.soil, found.truth.unlisted[OTHER_GROUND]["factor"]
    problem, fit = baseline(found.recordings, load_robot("agriq"), Options())
    assert disagreement(problem, fit) > 100.0
    alone = fitted_by_recording(problem, fit)
    assert alone.sufficient and alone.nats > 200.0
    for name, _, values in alone.soil:
        other = soil[name] * (factor if name != "u_w" else 1.0)
        assert values == pytest.approx([soil[name], other], rel=0.05), name


@pytest.mark.long
def test_a_compromise_is_no_place_to_be_stuck_at() -> None:
    """From the fit of both, steps alone end at a soil that leaves seven times the noise in the first one's torques."""
    found = case((OTHER_GROUND,), 1.0, 4021737138, runs=2, duration=30.0)
    problem, fit = baseline(found.recordings, load_robot("agriq"), Options(seed=1))  # from one seed in two it is found
    assert fitted_by_recording(problem, fit).sufficient
    beside = at_size(problem, fit, Extension("torque_scale"), np.array([0.02]), 1)
    assert fitted_by_recording(*beside).sufficient


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
def test_effects_are_named_beside_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """One in the motion, one that only commands show. One soil for two would bend the first one's size.

    By itself each recording has it right, and their mean is what is given.
    """
    try_only(monkeypatch, *FEW)
    found = driven(("slope", "command_delay", OTHER_GROUND), 51, duration=10.0)
    answer = diagnose(found.recordings, load_robot("agriq"), holdout=found.holdout)
    causes = {cause.effect: cause.parameters for cause in answer.causes}
    assert causes.keys() == {"slope", "command_delay"}
    grade = causes["slope"]["grade"]
    assert grade.value == pytest.approx(0.05, rel=0.1) and grade.ci95[0] < 0.05 < grade.ci95[1]
    assert causes["command_delay"]["delay"].value == pytest.approx(0.15, rel=0.02)
    (said,) = (warning for warning in answer.warnings if "the ground is not the same in all recordings" in warning)
    alone = re.search(r"slope: grade \(rad\) (\S+) in run0, (\S+) in run1", said)
    assert alone is not None, said
    assert [float(value) for value in alone.groups()] == pytest.approx([0.05, 0.05], rel=0.1)


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


@pytest.mark.long
def test_an_effect_is_no_other_soil() -> None:
    """What acts in all recordings is left in each of them, whatever soil it has."""
    problem, fit = baseline(driven(("joint_friction",), 42).recordings, load_robot("agriq"), Options())
    alone = fitted_by_recording(problem, fit)
    assert disagreement(problem, fit) > 58.0 and not alone.sufficient
    assert np.isfinite(alone.nats)
