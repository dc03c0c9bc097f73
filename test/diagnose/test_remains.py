"""What a fit leaves is held against all noise that its predictions have, that of the rotations included."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from estimation.logger import Logger, drive, recorded

from artibot_sim.diagnose.records import SlowResidual
from artibot_sim.diagnose.remains import beyond_noise, remains
from artibot_sim.estimation.measurements import HALF_WIDTH, stretches
from artibot_sim.estimation.parameters import ParameterSet
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.windows import cut
from artibot_sim.experiment import Experiment
from artibot_sim.identify.validation import fitted_starts
from artibot_sim.model import Robot, load_robot

HUSKY = load_robot("husky_driven")
RATES = {"motor_torques": 30.0, "ground_truth_odom": 10.0, "imu": 50.0}


def remaining(experiment: Experiment, robot: Robot) -> dict[str, SlowResidual]:
    """What a robot as it is leaves, by channel."""
    found = stretches(experiment, robot, HALF_WIDTH)
    problem = Problem(ParameterSet(robot, ()), found, cut(found, robot, 2.0), 1)
    return remains(problem, fitted_starts(problem, 2))


def left(experiment: Experiment, robot: Robot) -> tuple[str, ...]:
    """Channels in which a robot as it is leaves more than noise."""
    return beyond_noise(remaining(experiment, robot))


@pytest.mark.parametrize("polled", [0.0, 20.0])
def test_wheels_that_are_measured_badly_are_no_force_and_other_ground_is_one(polled: float) -> None:
    seen = recorded(
        drive(HUSKY, np.random.default_rng([1, 5]), 60.0),
        Logger(polled=polled, rates=RATES),
        np.random.default_rng([1, 6]),
    )
    channels = {key: seen.channels[key] for key in ("motor_torques", "ground_truth_odom")}
    seen = replace(seen, channels=channels, path=Path("logged"))
    assert left(seen, HUSKY) == ()
    softer = HUSKY.replace({"contact.k_t": 0.5 * HUSKY.contact.k_t})
    assert "yaw" in left(seen, softer)


def test_a_force_in_few_windows_is_more_than_noise_where_forces_show() -> None:
    """As a drag that fades is; poses miss as much in a few windows of ground that varies."""
    few = SlowResidual(1.2, 50.0)
    for name in ("torque_front", "torque_back", "articulation_yaw"):
        assert beyond_noise({name: few}) == (name,)
        assert not beyond_noise({name: SlowResidual(1.2, 1.7)})
    assert not beyond_noise({"yaw": few, "yaw_rate": few, "position": few})


@pytest.mark.parametrize("seed", range(4))
def test_stamps_that_scatter_with_heavy_tails_leave_white_noise(seed: int) -> None:
    seen = recorded(
        drive(HUSKY, np.random.default_rng([seed, 5]), 30.0),
        Logger(polled=20.0, rates=RATES, jitter={"ground_truth_odom": 0.05}),
        np.random.default_rng([seed, 6]),
    )
    channels = {key: seen.channels[key] for key in ("motor_torques", "ground_truth_odom")}
    found = remaining(replace(seen, channels=channels, path=Path("logged")), HUSKY)
    assert all(0.4 < one.typical < 1.4 for one in found.values()), found
