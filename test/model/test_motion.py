"""What sensors on tilted modules see: rates against derivatives of attitudes, angles of the joint against its axes."""

from __future__ import annotations

import numpy as np
import pytest
from model.test_uneven import driving

from artibot_sim.model import initial_state, random_ground, rollout
from artibot_sim.model.reference.contact import rotation_x, rotation_y, rotation_z
from artibot_sim.model.simulate.motion import angular_velocity, axes_of, joint_motion, linear_velocity


@pytest.fixture(scope="module")
def run(agriq):
    ground = random_ground(5, rms=0.1, length=1.0, size=12.8)
    start = initial_state(agriq, articulation_yaw=0.2, ground=ground)
    return rollout(agriq, driving(agriq, 0.6, 0.3, 3.0), ground=ground, state=start, every=1)


def test_axes_are_those_of_eq_2(run) -> None:
    for module, b in ((0, 0), (1, 8)):
        q = run.q[1500]
        want = rotation_z(q[b + 5])[0] @ rotation_y(q[b + 4])[0] @ rotation_x(q[b + 3])[0]
        np.testing.assert_allclose(axes_of(q, module), want, rtol=0, atol=1e-14)


@pytest.mark.parametrize("module", [0, 1])
def test_velocity_and_rates_are_derivatives_in_the_module_s_own_frame(run, module: int) -> None:
    i, dt, b = 1500, 1e-3, 8 * module
    axes = axes_of(run.q[i], module)
    spin = axes.T @ (axes_of(run.q[i + 1], module) - axes_of(run.q[i - 1], module)) / (2 * dt)
    rates = angular_velocity(run.q[i], run.v[i], module)
    np.testing.assert_allclose([spin[2, 1], spin[0, 2], spin[1, 0]], rates, rtol=0, atol=1e-4)
    moved = (run.q[i + 1, b : b + 3] - run.q[i - 1, b : b + 3]) / (2 * dt)
    np.testing.assert_allclose(axes.T @ moved, linear_velocity(run.q[i], run.v[i], module), rtol=0, atol=1e-4)
    assert np.abs(rates[:2]).max() > 1e-3


def test_the_joint_turns_about_the_axes_of_the_universal_joint(run) -> None:
    """Its two angles say all of how the modules stand to each other, which differences of yaws and rolls do not."""
    angles, rates = joint_motion(run.q, run.v)
    between = np.swapaxes(axes_of(run.q), 1, 2) @ axes_of(run.q, 1)
    for i in (0, 1500, 2900):
        yaw, roll = angles[i]
        np.testing.assert_allclose(rotation_z(yaw)[0] @ rotation_x(roll)[0], between[i], rtol=0, atol=1e-6)
    np.testing.assert_allclose(np.gradient(angles, 1e-3, axis=0)[1:-1], rates[1:-1], rtol=0, atol=2e-3)
    assert np.abs(angles[:, 0] - run.articulation_yaw).max() > 1e-5


def test_level_rovers_see_what_they_do_from_above(agriq) -> None:
    flat = rollout(agriq, driving(agriq, yaw_rate=0.3))
    np.testing.assert_array_equal(linear_velocity(flat.q, flat.v)[:, :2], flat.twist[:, :2])
    np.testing.assert_array_equal(angular_velocity(flat.q, flat.v)[:, 2], flat.twist[:, 2])
    np.testing.assert_array_equal(joint_motion(flat.q, flat.v)[0][:, 0], flat.articulation_yaw)
