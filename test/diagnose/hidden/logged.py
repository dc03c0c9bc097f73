"""Rigid robots as a logger records them: wheel speeds and poses like a lidar's, no torques, stamps that scatter.

The model itself drives them (:mod:`estimation.logger`), so what is asked here is not whether its physics is right, but
what a diagnosis makes of such noise, of ground that varies and of what is there besides.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from diagnose.hidden.effects import LISTED, Recipe
from diagnose.hidden.machine import random_soil
from estimation.logger import Drive, Logger, drive, recorded

from artibot_sim.diagnose.sizes import factors
from artibot_sim.experiment import Experiment
from artibot_sim.identify.validation import hold_out
from artibot_sim.model import Robot, load_robot
from artibot_sim.model.simulate.sensors import sensor_errors, tracked_point

HORIZON = 2.0
"""s, of predictions: longer ones of such recordings say little."""
VARYING = "varying_ground"
"""Soil that is another one every few seconds, about the same mean."""
PERIOD = 2.0
"""s on one soil."""
JITTER = 0.05
"""s, of the poses' stamps."""
SPREAD = 0.12
"""Of the mean soil's parameters about the robot file's, in logarithms."""
RECIPES: dict[str, Recipe] = {
    "wheel_resistance": Recipe(lambda rng, s, track: {"share": 0.15 * s}, lambda machine, values: machine),
    "stiction": Recipe(lambda rng, s, track: {"length": 0.02 * s}, lambda machine, values: machine),
    "wheel_windup": Recipe(lambda rng, s, track: {"way": 0.025 * s}, lambda machine, values: machine),
    "com_height": Recipe(lambda rng, s, track: {"height": 0.35 * s}, lambda machine, values: machine),
    "pose_lever_arm": LISTED["pose_lever_arm"],
    "pose_heading_offset": Recipe(
        lambda rng, s, track: {"angle": float(rng.choice((-0.03, 0.03))) * s}, lambda machine, values: machine
    ),
}
"""Of effects that act on such robots' paths; the sizes are those found on real ones."""


def recordings(
    effects: Sequence[str], severity: float, seed: int, names: Sequence[str], duration: float, robot: str,
    flaw: Logger | None = None,
) -> tuple[list[Experiment], dict[str, dict[str, Any]], dict[str, float]]:  # fmt: skip
    """Recordings of a robot with these effects, the effects' parameters, and the soil in the mean.

    Soil, commands, noise and logger are the same whatever the effects.

    Parameters
    ----------
    flaw : Logger, optional
        What is the matter with the logger besides. Where it is given a gyroscope is recorded as well.
    """
    told, rng = np.random.default_rng([seed, 0]), np.random.default_rng([seed, 1])
    numbers = load_robot(robot)
    soil = random_soil(numbers, told, SPREAD)
    mean = _on(numbers, soil)
    put_in = {name: _drawn(name, severity, rng, numbers) for name in effects if name != VARYING}
    acting = replace(mean, effects={**mean.effects, **put_in})
    polled = float(told.choice([0.0, 20.0]))
    rates = {"motor_torques": 30.0, "ground_truth_odom": 10.0, "imu": 50.0, "joint_states": 40.0}
    logger, kept = Logger(polled, rates, jitter={"ground_truth_odom": JITTER}), ("motor_torques", "ground_truth_odom")
    if flaw is not None:
        slow = {key: rate for key, rate in flaw.rates.items() if rate < rates[key]}
        logger, kept = replace(flaw, polled=polled, rates=rates | slow, jitter=logger.jitter), (*kept, "imu")
    found = []
    for number, name in enumerate(names):
        ground = [acting]
        if VARYING in effects:
            each = np.random.default_rng([seed, 2, number])
            ground = [_on(acting, random_soil(acting, each, 0.3 * severity)) for _ in range(round(duration / PERIOD))]
        each = np.random.default_rng([seed, 3, number])
        seen = recorded(_seen(drive(acting, each, duration, ground), acting), logger, each)
        channels = {key: seen.channels[key] for key in kept}
        found.append(replace(seen, name=name, path=Path(name), metadata={"robot": robot}, channels=channels))
    return found, put_in, soil


def nats_of(
    name: str, put_in: Mapping[str, Mapping[str, Any]], found: Sequence[Experiment], soil: Mapping[str, float],
    robot: str,
) -> float:  # fmt: skip
    """Half the squared change of predictions over noise between the true model and the same without one effect.

    Windows begin with the pose that was measured.
    """
    numbers = _on(load_robot(robot), soil)
    others = {other: dict(values) for other, values in put_in.items() if other != name}
    total = 0.0
    for recording in found:
        without, with_it = (
            hold_out(recording, replace(numbers, effects={**numbers.effects, **acting}), HORIZON, workers=1).residuals
            for acting in (others, put_in)
        )
        total += sum(0.5 * float(np.sum((a - b) ** 2)) for a, b in zip(without, with_it, strict=True))
    return total


def _on(robot: Robot, soil: Mapping[str, float]) -> Robot:
    return robot.replace({f"contact.{name}": value for name, value in soil.items()})


def _drawn(name: str, severity: float, rng: np.random.Generator, robot: Robot) -> dict[str, Any]:
    """An effect's parameters, as plain for this robot."""
    scale = factors(name, robot)
    values = RECIPES[name].draw(rng, severity, np.zeros((1, 2)))
    return {key: value * scale.get(key, 1.0) for key, value in values.items()}


def _seen(of: Drive, robot: Robot) -> Drive:
    """A drive as sensors with the robot's own errors would have it."""
    errors = sensor_errors(robot)
    pose = np.column_stack([tracked_point(errors, of.pose), of.pose[:, 2] + errors.heading])
    return replace(of, pose=pose, speed=of.speed * errors.encoder_scale)
