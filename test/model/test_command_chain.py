"""What happens to a command on its way to the front motors."""

from __future__ import annotations

import numpy as np
import pytest
from model.effects import with_effects
from model.helpers import front_commands, ramp

from artibot_sim.model import rollout
from artibot_sim.model.simulate.commands import CommandChain, as_executed

H = 0.01


def planned(robot, duration=4.0):
    return front_commands(robot, lambda t: 0.4 * ramp(t - 0.5), lambda t: 0.2 * ramp(t - 1.5), duration, H)


def test_without_effects_commands_are_what_motors_follow(agriq):
    commands = planned(agriq)
    assert as_executed(agriq, commands) is commands
    neutral = with_effects(
        agriq, command_delay={"delay": 0.0}, speed_loop_lag={"time_constant": 0.0}, deadband={"threshold": 0.0},
        command_rate_limit={"rate": np.inf},
    )  # fmt: skip
    assert as_executed(neutral, commands) is commands


@pytest.mark.parametrize("delay", [0.15, 0.004, 0.137])
def test_a_delay_moves_commands_back_in_time(agriq, delay):
    commands = planned(agriq)
    t = H * np.arange(len(commands.velocity))
    late = as_executed(with_effects(agriq, command_delay={"delay": delay}), commands)
    for motor in (0, 1):
        expected = np.interp(t - delay, t, commands.velocity[:, motor])
        np.testing.assert_allclose(late.velocity[:, motor], expected, atol=1e-9)
    assert np.isnan(late.velocity[:, 2:]).all()


def test_a_lag_answers_a_ramp_by_the_time_constant(agriq):
    T, slope = 0.25, 40.0
    way = CommandChain(with_effects(agriq, speed_loop_lag={"time_constant": T}), H, np.zeros(2))
    t = H * np.arange(1, 300)
    speeds = way.follow(np.column_stack([slope * t, -slope * t]))
    expected = slope * (t - T * (1 - np.exp(-t / T)))
    np.testing.assert_allclose(speeds, np.column_stack([expected, -expected]), rtol=1e-9)


def test_a_dead_band_lets_larger_commands_through(agriq):
    commands = planned(agriq)
    threshold = 0.4 * np.abs(commands.velocity[:, 0]).max()
    followed = as_executed(with_effects(agriq, deadband={"threshold": threshold}), commands).velocity[:, 0]
    small = np.abs(commands.velocity[:, 0]) < threshold
    assert small.any() and not small.all()
    assert (followed[small] == 0.0).all()
    np.testing.assert_array_equal(followed[~small], commands.velocity[~small, 0])


def test_a_rate_limit_goes_after_commands_on_a_ramp_and_arrives(agriq):
    commands = planned(agriq, 6.0)
    asked = commands.velocity[:, 0]
    steepest = np.abs(np.diff(asked)).max() / H
    rate = 0.4 * steepest
    followed = as_executed(with_effects(agriq, command_rate_limit={"rate": rate}), commands).velocity[:, 0]
    changes = np.abs(np.diff(followed)) / H
    assert changes.max() == pytest.approx(rate, rel=1e-9)
    on_ramp = np.abs(asked - followed)[1:] > 1e-9
    np.testing.assert_allclose(changes[on_ramp], rate, rtol=1e-9)
    assert on_ramp.any() and followed[-1] == pytest.approx(asked[-1], abs=1e-9)
    above = as_executed(with_effects(agriq, command_rate_limit={"rate": 1.01 * steepest}), commands).velocity[:, 0]
    np.testing.assert_allclose(above, asked, atol=1e-9)


def test_samples_one_by_one_are_the_whole(agriq):
    robot = with_effects(
        agriq, command_delay={"delay": 0.033}, speed_loop_lag={"time_constant": 0.1}, deadband={"threshold": 10.0},
        command_rate_limit={"rate": 100.0},
    )  # fmt: skip
    front = planned(robot).velocity[:, :2]
    whole = CommandChain(robot, H, front[0]).follow(front[1:])
    way, parts = CommandChain(robot, H, front[0]), []
    for i in range(1, len(front), 7):
        parts.append(way.follow(front[i : i + 7]))
    np.testing.assert_array_equal(np.vstack(parts), whole)


def test_a_late_rover_is_behind(agriq):
    commands = planned(agriq)
    late = rollout(agriq, as_executed(with_effects(agriq, command_delay={"delay": 0.15}), commands))
    on_time = rollout(agriq, commands)
    behind = np.interp(on_time.t[200:] - 0.15, on_time.t, on_time["theta_fr_dot"])
    np.testing.assert_allclose(late["theta_fr_dot"][200:], behind, atol=0.05 * behind.max())
