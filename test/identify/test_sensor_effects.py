"""Fits of a robot whose sensors have errors: the robot that has them explains its recordings, starts included."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from model.effects import SENSORS_1

from artibot_sim.identify.holdout import fitted_starts
from artibot_sim.identify.parameters import ParameterSet
from artibot_sim.identify.problem import Problem
from artibot_sim.identify.robust import channel_levels
from artibot_sim.identify.sensing import stretches
from artibot_sim.identify.synthetic import synthetic
from artibot_sim.identify.windows import cut
from artibot_sim.model import Robot, load_robot
from artibot_sim.planning import Arc, Dwell, Manoeuvre, Ramp, Slalom, Stop

TURNS = Manoeuvre(
    "turns",
    (Dwell(0.5), Ramp(speed=0.6), Slalom(curvature=0.45, wavelength=5.0, periods=1.5),
     Arc(radius=1.6, angle=-2.5), Stop()),
    a_max=0.5,
)  # fmt: skip
SHOWN = {
    "encoder_scale": "position", "torque_scale": "torque_back", "pose_lever_arm": "position", "pose_delay": "position",
    "gyro_bias": "yaw_rate",
}  # fmt: skip


def seen_by(robot: Robot, recording) -> Problem:
    found = stretches(recording, robot)
    return Problem(ParameterSet(robot, ()), found, cut(found, robot, 4.0, 0.3))


@pytest.mark.parametrize("name", sorted(SENSORS_1))
def test_the_robot_that_has_the_errors_explains_them(name: str) -> None:
    plain = load_robot("agriq")
    robot = replace(plain, effects={name: SENSORS_1[name]})
    recording = synthetic(robot, TURNS, kappa=0.7, seed=1, start=(3.0, -2.0, 2.0))
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
