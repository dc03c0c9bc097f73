"""Recordings of several soils: that is said, and no effect or force takes its place."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnose.hidden import case

from artibot_sim.diagnose import Verdict, diagnose
from artibot_sim.diagnose.apart import apart
from artibot_sim.diagnose.drift import disagreement
from artibot_sim.diagnose.options import Options
from artibot_sim.diagnose.run import baseline
from artibot_sim.experiment import Experiment
from artibot_sim.model import load_robot

SOFTER = 0.8
"""Of the first recording's soil, that of the second; its rolling resistance is the same."""


def recordings(effects: tuple[str, ...], factor: float, seed: int) -> tuple[list[Experiment], list[dict[str, float]]]:
    """Two to diagnose and one to hold out, the second of them on another soil; and both soils."""
    plain = dict(case(effects, 1.0, seed, runs=1, held_out=0, duration=5.0).truth.soil)
    softer = {name: value * (1.0 if name == "u_w" else factor) for name, value in plain.items()}
    found = []
    for number, soil in enumerate((plain, softer, plain)):
        drives = case(effects, 1.0, seed, runs=3, held_out=0, duration=20.0, soil=soil).recordings
        found.append(replace(drives[number], name=f"run{number}", path=Path(f"run{number}")))
    return found, [plain, softer]


def test_the_ground_is_said_to_differ() -> None:
    found, _ = recordings((), SOFTER, 31)
    answer = diagnose(found[:2], load_robot("agriq"), holdout=found[2:])
    assert answer.verdict is Verdict.UNEXPLAINED and not answer.causes
    assert answer.unexplained is not None and answer.unexplained.variable == "recording"
    assert answer.unexplained.size == pytest.approx(1.0 / SOFTER - 1.0, rel=0.1)
    assert "run0" in answer.unexplained.where and "run1" in answer.unexplained.where
    assert answer.next_experiment is not None and "one by one" in answer.next_experiment.what
    assert "the ground is not the same" in str(answer).lower()


def test_each_soil_is_found() -> None:
    found, soils = recordings((), SOFTER, 35)
    problem, fit = baseline(found[:2], load_robot("agriq"), Options())
    assert disagreement(problem, fit) > 100.0
    alone = apart(problem, fit)
    assert alone.sufficient and alone.nats > 200.0
    for name, _, values in alone.soil:
        assert values == pytest.approx([soil[name] for soil in soils], rel=0.05), name


def test_one_soil_is_one() -> None:
    found, _ = recordings((), 1.0, 36)
    problem, fit = baseline(found[:2], load_robot("agriq"), Options())
    assert -1e-6 < disagreement(problem, fit) < 30.0
    assert apart(problem, fit).nats < 30.0


def test_a_single_recording_agrees_with_itself() -> None:
    found, _ = recordings((), 1.0, 36)
    assert disagreement(*baseline(found[:1], load_robot("agriq"), Options())) == 0.0


def test_an_effect_is_named_beside_it() -> None:
    """With one soil for two its size is a compromise; by itself each recording has it right."""
    found, _ = recordings(("slope",), SOFTER, 51)
    answer = diagnose(found[:2], load_robot("agriq"), holdout=found[2:])
    assert [cause.effect for cause in answer.causes] == ["slope"]
    assert answer.causes[0].parameters["grade"].value == pytest.approx(0.05, rel=0.2)
    (said,) = (warning for warning in answer.warnings if "the ground is not the same in all recordings" in warning)
    alone = re.search(r"slope: grade \(rad\) (\S+) in run0, (\S+) in run1", said)
    assert alone is not None, said
    assert [float(value) for value in alone.groups()] == pytest.approx([0.05, 0.05], rel=0.1)


def test_so_is_one_that_only_commands_show() -> None:
    found, _ = recordings(("command_delay",), SOFTER, 51)
    answer = diagnose(found[:2], load_robot("agriq"), holdout=found[2:])
    assert [cause.effect for cause in answer.causes] == ["command_delay"]
    assert answer.causes[0].parameters["delay"].value == pytest.approx(0.15, rel=0.02)
    assert any("the ground is not the same in all recordings" in warning for warning in answer.warnings)


def test_an_effect_is_no_other_soil() -> None:
    """What acts in all recordings is left in each of them, whatever soil it has."""
    found, _ = recordings(("joint_friction",), 1.0, 41)
    problem, fit = baseline(found[:2], load_robot("agriq"), Options())
    alone = apart(problem, fit)
    assert disagreement(problem, fit) > 58.0 and not alone.sufficient
    assert np.isfinite(alone.nats)
