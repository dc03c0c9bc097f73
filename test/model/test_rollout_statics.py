"""Standing still, and not standing still: eq. 15 has no static friction, so a parked rover creeps downhill."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from model.helpers import GRAVITY, standstill

from artibot_sim.model import WHEELS, Mode, initial_state, rollout
from artibot_sim.model.equations.kinematics import constraint

GRADE = 0.05
MOTORS = [6, 7, 14, 15]
BODIES = [i for i in range(16) if i not in MOTORS]


def weights(robot):
    return [body.m + 4 * robot.wheel.m_w for body in (robot.front, robot.back) if body is not None]


def sloped(robot, heading, grade=GRADE):
    return dataclasses.replace(robot, effects={"slope": {"grade": grade, "heading": heading}})


@pytest.mark.parametrize("integrator", ["rk4", "semi_implicit"])
@pytest.mark.parametrize("bend", [0.0, 0.4])
def test_stays_where_it_stands_on_flat_ground(agriq, integrator, bend):
    state = initial_state(agriq, x=1.0, y=-2.0, yaw=0.7, articulation_yaw=bend)
    result = rollout(agriq, standstill(10.0), integrator=integrator, state=state)
    moved = np.abs(result.q - state.q).max(axis=0)
    assert moved[BODIES].max() < 1e-13, f"a rover at rest on flat ground moves: {moved[BODIES]}"
    assert moved[MOTORS].max() < 1e-11, f"free wheels of a rover at rest turn: {moved[MOTORS]} rad"
    assert np.abs(result.v).max() < 1e-12


def test_wheels_carry_the_weight(agriq):
    result = rollout(agriq, standstill(0.1))
    m_f, m_b = weights(agriq)
    for wheel in WHEELS:
        expected = (m_f if wheel.startswith("front") else m_b) * GRAVITY / 4
        np.testing.assert_allclose(result[f"F_n_{wheel}"], expected, rtol=1e-12)


@pytest.mark.parametrize("raised", [0.15, -0.1])
def test_joint_above_the_wheels_still_starts_closed(agriq, raised):
    robot = agriq.replace({"front.O_z": raised, "back.O_z": raised, "front.l": 0.2})
    state = initial_state(robot, articulation_yaw=0.5)
    assert np.abs(constraint(robot, state.q)).max() < 1e-14
    result = rollout(robot, standstill(2.0), state=state)
    assert np.abs(result.q - state.q).max() < 1e-12


@pytest.mark.parametrize("integrator", ["rk4", "semi_implicit"])
@pytest.mark.parametrize("heading", [0.0, np.pi])
def test_creeps_along_a_slope_at_the_viscous_speed(agriq, integrator, heading):
    """All motors held: sum of m g sin(grade) against eight wheels that each drag with k_l."""
    robot = sloped(agriq, heading)
    result = rollout(robot, standstill(2.0, motors=4), integrator=integrator, modes=Mode.PRESCRIBED)
    speed = sum(weights(agriq)) * GRAVITY * np.sin(GRADE) / (8 * agriq.contact.k_l)
    assert 1e-4 < speed < 0.1
    np.testing.assert_allclose(result["x_f_dot"][-1], speed * np.cos(heading), rtol=1e-9, err_msg="creep speed")
    assert np.abs(result["y_f"]).max() < 1e-12
    carried = weights(agriq)[0] * GRAVITY * np.cos(GRADE) / 4
    np.testing.assert_allclose(result[f"F_n_{WHEELS[0]}"], carried, rtol=1e-12, err_msg="weight on a slope")


@pytest.mark.parametrize("heading", [np.pi / 2, -np.pi / 2])
def test_creeps_across_a_slope_at_the_viscous_speed(husky, heading):
    """One module across the slope: four wheels drag with k_t (u_w = 0 keeps it from turning)."""
    robot = sloped(husky.replace({"contact.u_w": 0.0}), heading)
    result = rollout(robot, standstill(2.0), integrator="semi_implicit")
    (m,) = weights(husky)
    speed = m * GRAVITY * np.sin(GRADE) / (4 * husky.contact.k_t)
    np.testing.assert_allclose(result["y_f_dot"][-1], speed * np.sin(heading), rtol=1e-9, err_msg="creep speed")
    assert np.abs(result["gamma_f"]).max() < 1e-12


def test_creep_across_a_slope_turns_by_the_wheels_offset(husky):
    """With u_w > 0 the lateral forces act ahead of the centre: the yaw rate that balances their moment."""
    robot = sloped(husky, np.pi / 2, grade=0.01)
    result = rollout(robot, standstill(0.5), integrator="semi_implicit")
    c, body = husky.contact, husky.front
    (m,) = weights(husky)
    # sum F_t = -m g sin(grade) and sum (x + u) F_t - y F_l = 0, F_t = -k_t (v_y + x w), F_l = k_l y w
    expected = -c.u_w * m * GRAVITY * np.sin(0.01) / (c.k_t * body.i_x**2 + c.k_l * body.i_y**2)
    np.testing.assert_allclose(result["gamma_f_dot"][-1], expected, rtol=1e-3)
