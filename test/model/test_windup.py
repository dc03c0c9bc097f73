"""Wheels that wind up: what they lose when the force along them changes its sign, and that nothing comes of it."""

from __future__ import annotations

import numpy as np
import pytest
from model.effects import with_effects
from model.helpers import front_commands, ramp

from artibot_sim.estimation.windows import wound_wheels
from artibot_sim.model import WHEELS, load_robot, rollout

WAY = 0.02


def to_and_fro(robot, turn=0.0):
    """Forwards, then backwards, with a rate of turning that changes its sign with the speed."""

    def there_and_back(t):
        return ramp(t, 1.0) - 2.0 * ramp(t - 4.0, 1.0)

    commands = front_commands(robot, lambda t: 0.4 * there_and_back(t), lambda t: turn * there_and_back(t), 9.0)
    return rollout(robot, commands, dt=2.5e-4, every=4)


def forces(result, wheel, k_l):
    """Slip (m/s) of a wheel that holds, eq. 15's force along it and the one that there is, N."""
    motor = {"front_right": "fr", "front_left": "fl"}[wheel.rsplit("_", 1)[0]]
    robot = result.robot
    rim = robot.wheel.r_w * robot.drive.front.tau * result[f"theta_{motor}_dot"]
    slip = rim - result[f"p_x_{wheel}"]
    return slip, k_l * slip, result[f"F_l_{wheel}"]


def test_after_a_change_of_its_sign_the_force_comes_back_over_the_way_slipped():
    """The more of it was there before, the less is at first: 1 − before · exp(−slipped/way) of eq. 15's."""
    holding = load_robot("agriq").replace({"contact.mu_s": 5.0, "contact.mu_d": 5.0})
    robot = with_effects(holding, wheel_windup={"way": WAY})
    result = to_and_fro(robot)
    for wheel in WHEELS[:4]:
        slip, steady, force = forces(result, wheel, robot.contact.k_l)
        first = int(np.flatnonzero((slip < 0.0) & (result.t > 3.0))[0])
        before = force[first - 10] / steady[first - 10]
        share = force[first + 10 :] / steady[first + 10 :]
        slipped = np.abs(np.cumsum(slip[first:]) * np.diff(result.t).mean())[10:]
        assert before > 0.6
        assert slipped.max() > 0.5 * WAY
        np.testing.assert_allclose(share, 1.0 - before * np.exp(-slipped / WAY), atol=0.005)


def test_it_only_ever_takes_energy_out_of_the_motion():
    robot = with_effects(load_robot("husky"), wheel_windup={"way": WAY})
    result = to_and_fro(robot, 0.7)
    for wheel in WHEELS[:4]:
        slip, _, force = forces(result, wheel, robot.contact.k_l)
        assert (force * slip >= 0.0).all()
        assert np.abs(force).max() > 10.0


@pytest.mark.parametrize("name", ["agriq", "husky", "train3"])
def test_a_rover_that_has_long_moved_evenly_moves_as_without(name):
    """What is lost is lost when the sign changes: in a long arc forces and motion are the paper's."""
    plain = load_robot(name)
    ends = []
    for robot in (plain, with_effects(plain, wheel_windup={"way": 0.005})):
        commands = front_commands(robot, lambda t: 0.4 * ramp(t), lambda t: 0.2 * ramp(t - 1.0), 20.0)
        ends.append(rollout(robot, commands, dt=1e-3, integrator="semi_implicit").final_state)
    speeds = [np.hypot(end.v[0], end.v[1]) for end in ends]
    assert speeds[1] == pytest.approx(speeds[0], rel=1e-3)
    assert ends[1].v[5] == pytest.approx(ends[0].v[5], rel=1e-3)
    assert np.abs(ends[1].windup[:4]).min() > 0.99


@pytest.mark.parametrize("name", ["agriq", "husky"])
def test_windows_begin_as_wound_up_as_a_rover_that_has_moved_so(name):
    robot = with_effects(load_robot(name), wheel_windup={"way": 0.005})
    commands = front_commands(robot, lambda t: 0.4 * ramp(t), lambda t: 0.2 * ramp(t - 1.0), 20.0)
    end = rollout(robot, commands, dt=1e-3, integrator="semi_implicit").final_state
    given = wound_wheels([robot], np.zeros(1, np.int64), end.q[None], end.v[None])[0]
    assert given[:4] == pytest.approx(end.windup[:4], abs=0.05)  # back wheels of Agri.q slip less than the way in 3 s
