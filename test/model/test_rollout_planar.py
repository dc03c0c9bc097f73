"""The full model against the planar minimal-coordinate one, and single modules against closed forms."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from model.helpers import GRAVITY, front_commands, ramp
from model.planar import planar_rollout, starred

from artibot_sim.model import MOTORS, WHEELS, rollout
from artibot_sim.model.equations.kinematics import constraint

POSE = ["x_f", "y_f", "gamma_f", "gamma_b"]


def pose_gap(result, planar):
    columns = POSE if result.robot.articulated else POSE[:3]
    return np.abs(np.column_stack([result[c] for c in columns]) - planar.q[:, : len(columns)]).max()


@pytest.mark.parametrize("kappa", [0.6, 0.8, 1.0])
def test_table_6_agrees_with_the_planar_derivation(agriq, table6, kappa):
    """28.85 s with dozens of switches of eqs 16 and 23, which both must take at the same step."""
    result = rollout(agriq, table6, kappa=kappa)
    switches = sum(np.abs(np.diff(result[f"sat_{wheel}"])).sum() for wheel in WHEELS)
    assert switches > 10, "no wheel slid: the comparison would be too easy"
    planar = planar_rollout(agriq, table6, kappa=kappa)
    assert pose_gap(result, planar) < 1e-5, "another path than the planar rover's"
    inner = slice(0, -1)  # past its last knot a command stays: another acceleration at the very end
    np.testing.assert_allclose(result.motor_torque[inner], planar.M_m[inner], atol=1e-5, err_msg="motor torques")
    eta = np.column_stack([result[f"eta_{motor}"] for motor in MOTORS])
    np.testing.assert_array_equal(eta, planar.eta, err_msg="efficiencies of eq. 23")


def test_joint_ahead_of_the_axle_agrees(epiq):
    """Epi.q: l_f > 0, so the joint's force turns the front module too."""
    commands = front_commands(epiq, lambda t: 0.3 * ramp(t), lambda t: 0.4 * ramp(t - 2) - 0.8 * ramp(t - 5), 9.0)
    changes = {"drive.front.J_m": 2e-6, "drive.back.J_m": 2e-6}  # RK4's limit on the spin of light wheels
    robot = epiq.replace(changes)
    result = rollout(robot, commands, dt=2e-4, kappa=0.7, every=50)
    planar = planar_rollout(robot, commands, dt=2e-4, kappa=0.7, every=50)
    assert np.ptp(result["gamma_f"]) > 0.5
    assert pose_gap(result, planar) < 1e-6


@pytest.mark.parametrize("heading", [0.0, 2.0])
def test_slope_agrees(agriq, heading):
    """A slope pulls m g sin(grade) and relieves the wheels by cos(grade)."""
    grade = 0.05
    robot = dataclasses.replace(agriq, effects={"slope": {"grade": grade, "heading": heading}})
    commands = front_commands(agriq, lambda t: 0.6 * ramp(t), lambda t: 0.25 * ramp(t - 2), 8.0)
    result = rollout(robot, commands, kappa=0.8)
    pull = GRAVITY * np.sin(grade) * np.array([np.cos(heading), np.sin(heading)])
    planar = planar_rollout(agriq, commands, kappa=0.8, pull=pull)
    assert pose_gap(result, planar) < 1e-8
    flat = rollout(agriq, commands, kappa=0.8)
    assert np.abs(result.pose - flat.pose).max() > 0.02, "the slope must matter for this test to mean anything"


def test_single_module_agrees(husky):
    commands = front_commands(husky, lambda t: 0.8 * ramp(t), lambda t: 0.9 * ramp(t - 2) - 1.8 * ramp(t - 6), 10.0)
    result = rollout(husky, commands)
    planar = planar_rollout(husky, commands)
    assert np.ptp(result["gamma_f"]) > 0.5
    assert pose_gap(result, planar) < 1e-6
    np.testing.assert_allclose(result.motor_torque[:-1, :2], planar.M_m[:-1, :2], atol=1e-5)


def test_single_module_speeds_up_as_the_closed_form_says(husky):
    """m v' = 4 k_l (r_w omega - v) with omega = a t: v = r_w a (t - T (1 - exp(-t/T))), T = m / (4 k_l)."""
    a = 0.5
    commands = front_commands(husky, lambda t: a * t, lambda t: 0.0, 3.0)
    result = rollout(husky, commands)
    m, _ = starred(husky.front, husky.wheel)
    T = m / (4 * husky.contact.k_l)
    settled = result.t > 0.5  # the prescribed motor needs some 1/A to take up the sudden acceleration
    expected = a * (result.t - T * (1 - np.exp(-result.t / T)))
    np.testing.assert_allclose(result["x_f_dot"][settled], expected[settled], rtol=1e-7)
    # RK4's stages leave the parabola of a prescribed angle by A^2 dt^2 a / 8, which the slip shows: 4e-6 of F_l
    np.testing.assert_allclose(result["F_l_front_left_back"][settled], m * a / 4, rtol=1e-5)


def test_single_module_turns_on_the_spot_as_the_closed_form_says(husky):
    """Wheels at ±omega without sliding: moments of F_l and F_t about the centre balance."""
    ideal = 2 * 0.08 / husky.front.i_y  # yaw rate without slip for rims at ±0.08 m/s
    commands = front_commands(husky, lambda t: 0.0, lambda t: ideal * ramp(t, 1.0), 4.0)
    result = rollout(husky.replace({"contact.mu_s": 5.0, "contact.mu_d": 5.0}), commands)
    c, body = husky.contact, husky.front
    expected = ideal * c.k_l * body.i_y**2 / (c.k_l * body.i_y**2 + c.k_t * body.i_x**2)
    np.testing.assert_allclose(result["gamma_f_dot"][-1], expected, rtol=1e-9)
    assert np.abs(result.pose[:, :2]).max() < 1e-12, "it leaves the spot"


@pytest.mark.parametrize(("integrator", "dt"), [("rk4", 1e-3), ("semi_implicit", 1e-3), ("semi_implicit", 2e-3)])
def test_joint_does_not_drift_in_a_minute(agriq, integrator, dt):
    commands = front_commands(agriq, lambda t: 0.8 * ramp(t), lambda t: 0.5 * np.sin(0.5 * t) * ramp(t), 60.0)
    result = rollout(agriq, commands, integrator=integrator, dt=dt, every=50, kappa=0.8)
    gap = max(np.abs(constraint(agriq, q)).max() for q in result.q)
    assert gap < 1e-6, f"the joint opens by {gap} m"
    assert np.ptp(result["z_f"]) < 1e-9, "undamped vertical motion grows"
    assert np.ptp(result["alpha_f"]) < 1e-9, "undamped roll grows"
