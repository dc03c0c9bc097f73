"""The driver node's parameters: the table of :mod:`artibot_driver.config`, declared with ROS and checked."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from artibot_driver.config import ALL_SPECS, COMMANDING_SPECS, KAPPA, LAW, SPECS, DriverConfig
from artibot_driver.master import check_kappa
from artibot_sim.errors import ArtibotError
from artibot_sim.estimation.odometry import metres_per_radian
from artibot_sim.model import Robot, load_robot
from artibot_sim.nodes.common.arbiter import Rules, check_sources, parse_sources
from artibot_sim.nodes.common.parameters import declare
from artibot_sim.parameters import Value
from artibot_sim.sharing import Law, load_law

Settings = Mapping[str, Any]
"""Checked parameters by name."""


def declare_all(node: Any) -> tuple[Robot, dict[str, Any]]:
    """Declare every parameter on an rclpy node; return the robot and the checked values.

    Raises
    ------
    ArtibotError
        When a value given at the start, or the robot, is refused.
    """
    robot = load_robot(str(declare(node, SPECS["robot"])))
    if len(robot.motors) > 4:
        raise ArtibotError(f"robot '{robot.name}': it has {len(robot.motors)} motors; the driver drives four at most")
    settings: dict[str, Any] = {"robot": robot.name}
    for name, spec in ALL_SPECS.items():
        if name == "robot":
            settings[name] = node.get_parameter(name).value
            continue
        default = robot.control.kappa if spec is KAPPA else None
        settings[name] = check(name, declare(node, spec, default), robot)
    return robot, settings


def check(name: str, value: Any, robot: Robot) -> Value:
    """A parameter's value in its type.

    Raises
    ------
    ArtibotError
        With the reason when it is refused.
    """
    checked = ALL_SPECS[name].check(value)
    if name == KAPPA.name:
        check_kappa(robot, float(checked))
    if name == LAW.name and (law := law_of(str(checked))) is not None:
        _check_law(robot, law)
    if name == "command_source":
        check_sources(str(checked))
    return checked


def _check_law(robot: Robot, law: Law) -> None:
    """That the motors allow every kappa of a law; NaN stands for the driver's own."""
    for name in law.kappas:
        value = law.values.get(name, law.defaults[name])
        try:
            check_kappa(robot, value if math.isfinite(value) else robot.control.kappa)
        except ArtibotError as reason:
            raise ArtibotError(f"parameter law: {law.id}: {name}: {reason}") from reason


def law_of(text: str) -> Law | None:
    """The law of a parameter's text; None for eq. 30 itself, which the driver computes in the drives' counts.

    Raises
    ------
    ArtibotError
        For an unknown law.
    """
    law = load_law(text)
    return None if law.id == "constant" and not law.values else law


def of_drives(settings: Settings) -> dict[str, Any]:
    """Those that the bus and the drives are set up with."""
    return {name: value for name, value in settings.items() if name not in COMMANDING_SPECS}


def rules(settings: Settings, robot: Robot, config: DriverConfig) -> Rules:
    """What the arbitration between commands goes by; the master refuses back efforts that are too large."""
    return Rules(
        metres_per_radian=metres_per_radian(robot),
        track=robot.front.i_y,
        sources=parse_sources(settings["command_source"]),
        command_timeout=settings["command_timeout"],
        cmd_vel_timeout=settings["cmd_vel_timeout"],
        stop_deceleration=config.stop_deceleration,
        acceleration_limit=settings["acceleration_limit"],
        max_speed=config.max_speed,
    )
