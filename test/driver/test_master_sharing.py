"""Eq. 30 in the drives' counts, and what the motors' limits say about kappa."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from artibot_driver.config import config_from_parameters
from artibot_driver.master import check_kappa, kappa_bounds
from artibot_driver.master.setpoints import back_torque
from artibot_driver.rig import Rig, load_rig
from artibot_sim.errors import ArtibotError
from artibot_sim.model import Robot, load_robot
from artibot_sim.model.equations.transmission import back_torque_factor

RIG = load_rig(config_from_parameters({}))
PERMILLE = st.integers(-1000, 1000)


def with_back_limit(robot: Robot, torque: float) -> Robot:
    assert robot.drive.back is not None
    return replace(robot, drive=replace(robot.drive, back=replace(robot.drive.back, torque_max=torque)))


def test_agriq_s_bound_is_the_stated_one() -> None:
    low, high = kappa_bounds(load_robot("agriq"))
    assert (low, high) == (0.622, 1.0)
    exact = 1 / (1 + 28.93 / 47.64)
    assert exact - 1e-3 < low <= exact


@settings(max_examples=30)
@given(st.floats(0.05, 3.0))
def test_at_the_bound_the_back_motor_s_limit_is_met(torque: float) -> None:
    """Both front motors at their limit, kappa at its bound: what eq. 30 asks for is what the back motors have."""
    robot = with_back_limit(load_robot("agriq"), torque)
    low, _ = kappa_bounds(robot)
    assert robot.drive.back is not None
    ratio = robot.drive.back.tau / robot.drive.front.tau
    asked = [ratio * (1 / kappa - 1) * robot.drive.front.torque_max for kappa in (low, low + 1e-3)]
    assert asked[1] <= torque <= asked[0] * (1 + 1e-9)


@pytest.mark.parametrize("kappa", [0.621, 1.0001, 0.0, -1.0, math.nan, math.inf])
def test_a_kappa_out_of_bounds_is_refused_with_the_bounds(kappa: float) -> None:
    with pytest.raises(ArtibotError, match=r"expected 0.622 to 1 for robot 'agriq'"):
        check_kappa(RIG.robot, kappa)


@pytest.mark.parametrize("kappa", [0.622, 0.8, 1.0])
def test_a_kappa_within_bounds_is_taken(kappa: float) -> None:
    assert check_kappa(RIG.robot, kappa) == kappa


def test_without_limits_in_the_robot_file_there_is_no_bound_but_zero() -> None:
    robot = load_robot("epiq")
    assert kappa_bounds(robot) == (0.0, 1.0)
    assert check_kappa(robot, 0.01) == 0.01
    with pytest.raises(ArtibotError, match="kappa: found 0"):
        check_kappa(robot, 0.0)


def paper(rig: Rig, kappa: float, right: int, left: int) -> float:
    """Eq. 30 as printed, split between the sides: N m forwards, from permille with the polarity of each motor."""
    front, back = rig.robot.drive.front, rig.robot.drive.back
    assert back is not None
    total = 1e-3 * front.rated_torque * (front.polarity.right * right + front.polarity.left * left)
    return total / front.tau * (1 - kappa) / kappa * back.tau / 2


@given(st.floats(0.622, 1.0), PERMILLE, PERMILLE)
def test_the_back_torque_is_that_of_eq_30_to_rounding(kappa: float, right: int, left: int) -> None:
    expected = paper(RIG, kappa, right, left)
    for motor, sign in (("back_right", -1), ("back_left", 1)):
        scaled = back_torque(RIG, motor, back_torque_factor(RIG.robot, kappa), (right, left))
        permille = sign * expected / (1e-3 * 0.6)
        assert abs(scaled.raw - max(-1000.0, min(1000.0, permille))) <= 0.5 + 1e-9
        assert scaled.saturated == (abs(permille) > 1000.5)
