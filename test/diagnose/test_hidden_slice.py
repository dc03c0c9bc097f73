"""Hidden effects found: a slice of the campaign that a test run has time for. One is found in real bags by the command.

Beside it stand tyre_relaxation (test_tyre_relaxation.py), what others recorded (test_elsewhere.py: speed_loop_lag,
slope, joint_friction, nothing) and all of the campaign (``make diagnose-campaign``).
"""

from __future__ import annotations

from dataclasses import asdict

import pytest
from diagnose.hidden import case
from diagnose.hidden.score import score
from diagnose.hidden.work import command_line, in_memory
from diagnose.searches import FEW, try_only

SMALL = {"runs": 2, "held_out": 1, "duration": 8.0, "manoeuvres": ("eight", "stop_and_go", "slalom")}


def test_nothing_is_named_where_nothing_is_hidden():
    result = score(in_memory(case((), seed=23, **SMALL)), {"effects": {}, "unlisted": {}, "idle": {}})
    assert result.answer == "none", result


def test_what_is_hidden_is_named():
    """A force of a single motor, in real bags; of what only commands show and of sensors see below."""
    found = case(("motor_drag",), seed=27, **SMALL)
    result = score(command_line(found), asdict(found.truth))
    assert result.answer == "motor_drag", result
    assert all(error < 0.15 for error in result.errors.values()), result


@pytest.mark.long
def test_a_limit_of_commands_and_a_wheel_out_of_round_are_both_named(monkeypatch: pytest.MonkeyPatch):
    """One shows between commands and speeds, the other between rotations and motion: neither takes from the other."""
    try_only(monkeypatch, *FEW, "wheel_runout", "motor_drag", "wheel_resistance", "encoder_scale")
    found = case(("command_rate_limit", "wheel_runout"), seed=28, **SMALL)
    answer = in_memory(found)
    assert [cause["effect"] for cause in answer["causes"]] == ["command_rate_limit", "wheel_runout"]
    result = score(answer, asdict(found.truth))
    assert all(error < 0.05 for error in result.errors.values()), result
    assert all(result.covered.values()), result


@pytest.mark.long
def test_errors_of_two_sensors_are_named_beside_each_other(monkeypatch: pytest.MonkeyPatch):
    """What the first one leaves in the yaw rates is as slow as a bias is: taken for noise, nothing would be named."""
    try_only(monkeypatch, *FEW, "encoder_scale", "torque_scale", "pose_delay", "pose_lever_arm", "wheel_runout")
    found = case(("gyro_bias", "encoder_scale"), 3.0, seed=31, **SMALL)
    answer = in_memory(found)
    assert {cause["effect"] for cause in answer["causes"]} == set(found.truth.effects)
    result = score(answer, asdict(found.truth))
    assert all(error < 0.05 for error in result.errors.values()), result
