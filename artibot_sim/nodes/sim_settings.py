"""From the node's parameters to what its parts take."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from artibot_sim.errors import ArtibotError
from artibot_sim.model import Robot
from artibot_sim.nodes.command_messages import Rules, parse_sources
from artibot_sim.nodes.odometry import metres_per_radian
from artibot_sim.nodes.sim_engine import Start
from artibot_sim.nodes.sim_sensors import SensorModel

Settings = Mapping[str, Any]
"""Checked parameters by name (:data:`artibot_sim.nodes.sim_parameters.SPECS`)."""


def rules(settings: Settings, robot: Robot) -> Rules:
    """What the arbitration between commands goes by.

    Below real time the limits of silence stretch: publishers whose timers follow /clock slow down with it.
    """
    rate = settings["rate"]
    stretch = 1.0 / min(1.0, rate) if rate else 1.0
    return Rules(
        metres_per_radian=metres_per_radian(robot),
        track=robot.front.i_y,
        torque_max=(robot.drive.back or robot.drive.front).torque_max,
        sources=parse_sources(settings["command_source"]),
        command_timeout=settings["command_timeout"] * stretch,
        cmd_vel_timeout=settings["cmd_vel_timeout"] * stretch,
        stop_deceleration=settings["stop_deceleration"],
        acceleration_limit=settings["acceleration_limit"],
        max_speed=settings["max_speed"],
        needs_sign_of_life=rate != 0,
        sign_tolerance=max(1.0, settings["command_timeout"] * max(1.0, rate)),
    )


def start(settings: Settings) -> Start:
    """Where the rover starts."""
    return Start(*(settings[f"start.{name}"] for name in ("x", "y", "yaw", "articulation_yaw")))


def sensor_model(settings: Settings) -> SensorModel:
    """The sensors' errors."""
    return SensorModel(
        encoder_counts=settings["noise.encoder_counts"],
        velocity=settings["noise.velocity"],
        torque=settings["noise.torque"],
        torque_relative=settings["noise.torque_relative"],
        articulation=settings["noise.articulation"],
        gyro=settings["imu.gyro_noise"],
        gyro_bias=settings["imu.gyro_bias"],
        acceleration=settings["imu.acceleration_noise"],
        station=settings["total_station.noise"],
        station_loss=settings["total_station.loss"],
        prism=settings["total_station.prism"],
    )


def gyro_deviation(settings: Settings) -> float:
    """What imu/data states of its yaw rate: as given, or what noise and bias come to (rad/s)."""
    return settings["imu.gyro_deviation"] or math.hypot(settings["imu.gyro_noise"], settings["imu.gyro_bias"])


def check_drives(settings: Settings) -> None:
    """Refuse what does not go together with drives: they and their driver count real time.

    Raises
    ------
    ArtibotError
        Naming the parameter.
    """
    for name, needed in (("rate", 1.0), ("wait_for_profile", False), ("start_paused", False)):
        if settings[name] != needed:
            raise ArtibotError(
                f"parameter {name}: found {settings[name]}, expected {needed} with with_driver: drives on a bus and "
                "their driver live in real time, which cannot be stretched or stopped"
            )


def switched(settings: Settings, name: str, automatic: bool) -> bool:
    """A parameter that is ``true``, ``false`` or ``auto``."""
    return automatic if settings[name] == "auto" else bool(settings[name] == "true")
