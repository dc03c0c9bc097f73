"""Fits of a robot whose sensors have errors: the robot that has them explains its recordings, starts included."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnose.hidden.logged import recordings
from experiment.test_recorded_as import with_speeds_alone
from model.effects import SENSORS_1

from artibot_sim.estimation.loss import channel_levels
from artibot_sim.estimation.measurements import stretches
from artibot_sim.estimation.parameters import Extension, ParameterSet
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.windows import CHANNEL_NAMES, cut
from artibot_sim.identify import Effort, Prior, identify
from artibot_sim.identify.synthetic import Noise, synthetic
from artibot_sim.identify.validation import fitted_starts
from artibot_sim.model import Robot, load_robot
from artibot_sim.planning import Arc, Dwell, Manoeuvre, Ramp, Slalom, Stop

QUICK = Effort(starts=1, finalists=1)
TURNS = Manoeuvre(
    "turns",
    (Dwell(0.5), Ramp(speed=0.6), Slalom(curvature=0.45, wavelength=5.0, periods=1.5),
     Arc(radius=1.6, angle=-2.5), Stop()),
    a_max=0.5,
)  # fmt: skip
SHOWN = {
    "encoder_scale": "position", "torque_scale": "torque_back", "pose_lever_arm": "position", "pose_delay": "position",
    "pose_heading_offset": "position", "gyro_bias": "yaw_rate", "velocity_filter": "articulation_yaw",
}  # fmt: skip


def seen_by(robot: Robot, recording) -> Problem:
    found = stretches(recording, robot)
    return Problem(ParameterSet(robot, ()), found, cut(found, robot, 4.0, 0.3))


@pytest.mark.parametrize("name", sorted(SENSORS_1))
def test_the_robot_that_has_the_errors_explains_them(name: str) -> None:
    plain = load_robot("agriq")
    robot = replace(plain, effects={name: SENSORS_1[name]})
    quiet = Noise(velocity=0.01)  # what is taken off a low-pass's noise makes more of it in torques
    noise = {"pose_heading_offset": Noise(heading=0.002), "velocity_filter": quiet}.get(name)
    recording = synthetic(robot, TURNS, kappa=0.7, seed=1, start=(3.0, -2.0, 2.0), noise=noise)
    if name == "velocity_filter":
        recording = with_speeds_alone(recording)
    own, other = seen_by(robot, recording), seen_by(plain, recording)
    best, worse = fitted_starts(own, 3), fitted_starts(other, 3)
    assert best.cost < worse.cost - 500.0
    levels = channel_levels(own.windows, best.residuals)
    assert all(level < 1.6 for level in levels.values()), levels
    assert channel_levels(other.windows, worse.residuals)[SHOWN[name]] > 1.15 * levels[SHOWN[name]]
    away = (best.starts - own.starts) / own.start_sd
    assert np.sqrt(np.mean(away**2)) < 1.5, "the measured starts are right for this robot"
    carried = own.carried(np.empty(0), best.starts)
    followed = [i for i, before in enumerate(own._before) if before is not None]
    assert np.abs((carried - best.starts)[followed][:, :3]).max() < 0.08


def test_an_angle_of_the_tracked_body_is_found_beside_where_it_sits() -> None:
    """Of a rigid robot with a logger's poses, whose wheels say nothing about either."""
    (drive,), truth, _ = recordings(("pose_heading_offset", "pose_lever_arm"), 1.0, 3, ["drive"], 40.0, "husky_driven")
    angle, arm = "effects.pose_heading_offset.angle", "effects.pose_lever_arm.x"
    priors = {angle: Prior(0.0, 0.05), arm: Prior(0.0, 0.15)}
    result = identify(
        [drive], load_robot("husky_driven"), fit=["k_l", "k_t", angle, arm], priors=priors, window=2.0, effort=QUICK
    ).result
    low, high = result[angle].ci95
    assert low < truth["pose_heading_offset"]["angle"] < high
    assert low * high > 0.0, "the angle is told from none"


ARM = Extension("pose_lever_arm")
OWN = [CHANNEL_NAMES.index(name) for name in ("yaw_rate", "articulation_yaw", "torque_front", "torque_back")]


@pytest.fixture(scope="module")
def turns() -> Problem:
    plain = load_robot("agriq")
    recording = synthetic(plain, TURNS, kappa=0.7, seed=1, start=(3.0, -2.0, 2.0))
    seen = seen_by(plain, recording)
    return seen.with_parameters(ParameterSet(plain, (), (ARM,)))


def test_a_motion_that_is_held_is_the_same_to_all_other_sensors(turns: Problem) -> None:
    there = np.array([1.0, -1.0])
    before, after = (turns.parameters.robot_at(c) for c in (np.zeros(2), there))
    held = turns.held(before, after, turns.starts)
    assert np.array_equal(held[:, :2], turns.starts[:, :2])
    assert turns.held(after, before, held) == pytest.approx(turns.starts, abs=1e-12)
    of = turns.samples
    own = np.isin(of.channel, OWN)
    plain, with_arm = (turns.residuals([c], s)[0].flat for c, s in ((np.zeros(2), turns.starts), (there, held)))
    assert np.abs(with_arm - plain)[own].max() < 1e-6
    assert np.abs(with_arm - plain)[of.x].max() > 10.0
    as_seen = turns.residuals([there], turns.starts)[0].flat
    assert np.abs(as_seen - plain)[own].max() > 1.0


def test_sensitivities_with_the_motion_held_are_those_of_starts_that_stay(turns: Problem) -> None:
    residuals, found = turns.linearised(np.zeros(2), turns.starts, (0, 1))
    step = 1e-4
    for k in range(2):
        moved = turns.residuals([step * np.eye(2)[k]], turns.starts)[0]
        plainly = (moved.flat - residuals.flat) / step
        away = np.abs(found.parameters[k] - plainly)
        assert np.median(away) < 0.02 * np.sqrt(np.mean(plainly**2))
        assert np.corrcoef(found.parameters[k], np.clip(plainly, -100.0, 100.0))[0, 1] > 0.9


def test_a_low_pass_before_speeds_is_found_and_told_from_none() -> None:
    plain, key = load_robot("husky_driven"), "effects.velocity_filter.time_constant"
    noise = Noise(velocity=0.01, heading=0.002)
    found = []
    for true in (0.15, 0.0):
        robot = replace(plain, effects={"velocity_filter": {"time_constant": true}})
        drive = with_speeds_alone(synthetic(robot, TURNS, noise=noise, seed=4))
        result = identify(
            [drive], plain, fit=["k_l", "k_t", key], priors={key: Prior(0.1, 0.1)}, window=3.0, effort=QUICK
        )
        found.append(result.result[key])
    assert found[0].ci95[0] < 0.15 < found[0].ci95[1]
    assert found[1].ci95[1] < found[0].ci95[0]
