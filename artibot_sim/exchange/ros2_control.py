"""A robot for ros2_control: a URDF whose joints are the front motors as well, and the parameters of its controllers.

The tag names ``joint_state_topic_hardware_interface``, which turns controllers' commands into
``motor_command_request`` and reads ``motor_torques``: the safe stop and the torque law stay with the driver.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping

from artibot_sim.exchange.controllers import section_of
from artibot_sim.exchange.turning import spread
from artibot_sim.exchange.urdf import urdf
from artibot_sim.model import MOTORS, Robot
from artibot_sim.progress import Report

PLUGIN = "joint_state_topic_hardware_interface/JointStateTopicSystem"
RATE = 50
"""Hz of the controllers; the driver takes 0.1 s without a request for silence."""
SETTINGS = {
    "joint_commands_topic": "motor_command_request",
    "joint_states_topic": "motor_torques",
    "trigger_joint_command_threshold": "0",  # every command is sent, or an unchanged one would be silence
}
CONTROLLER = "diff_drive_controller"
_SIDE = {"right": MOTORS[0], "left": MOTORS[1]}


def description(robot: Robot) -> str:
    """The URDF of a robot as text, with its front motors as joints and ros2_control's tag for them.

    A motor's joint turns as ``motor_torques`` counts: rad of the motor, forward positive. It stands where the middle of
    its side's wheels is, without size and next to without mass, beside the wheels' own joints.
    """
    root = ET.fromstring(urdf(robot))
    for side, motor in _SIDE.items():
        link = ET.SubElement(root, "link", name=f"{motor}_motor_link")
        inertial = ET.SubElement(link, "inertial")
        ET.SubElement(inertial, "mass", value="0.001")
        ET.SubElement(inertial, "inertia", ixx="1e-6", ixy="0", ixz="0", iyy="1e-6", iyz="0", izz="1e-6")
        joint = ET.SubElement(root, "joint", name=motor, type="continuous")
        ET.SubElement(joint, "parent", link="base_link")
        ET.SubElement(joint, "child", link=f"{motor}_motor_link")
        y = math.copysign(robot.front.i_y / 2, -1.0 if side == "right" else 1.0)
        ET.SubElement(joint, "origin", xyz=f"0 {y:.9g} 0", rpy="0 0 0")
        ET.SubElement(joint, "axis", xyz="0 1 0")
    root.append(_tag(robot))
    ET.indent(root)
    made = "<!-- made by `artibot export`, for ros2_control, from the robot file -->"
    return f'<?xml version="1.0"?>\n{made}\n{ET.tostring(root, encoding="unicode")}\n'


def _tag(robot: Robot) -> ET.Element:
    tag = ET.Element("ros2_control", name=robot.name, type="system")
    hardware = ET.SubElement(tag, "hardware")
    ET.SubElement(hardware, "plugin").text = PLUGIN
    for key, value in SETTINGS.items():
        ET.SubElement(hardware, "param", name=key).text = value
    for motor in _SIDE.values():
        joint = ET.SubElement(tag, "joint", name=motor)
        ET.SubElement(joint, "command_interface", name="velocity")
        for state in ("position", "velocity"):
            ET.SubElement(joint, "state_interface", name=state)
    return tag


def controllers(grounds: Mapping[str, Robot], speed: float | None = None, progress: Report | None = None) -> str:
    """Parameters of the controller manager and of a `diff_drive_controller` that turns the front motors, as YAML.

    Parameters
    ----------
    grounds : mapping of str to Robot
        One robot by its file's name.
    speed : float, optional
        Of the turns to which the controller is fitted, m/s.
    progress : callable, optional
        Called with the share that is done.
    """
    ((name, robot),) = grounds.items()
    found = spread(robot, speed, progress=progress)
    joints = {side: (motor,) for side, motor in _SIDE.items()}
    lines = [
        "# Made by `artibot export … --to ros2_control` (docs/integration.md): its joints are the front motors, so the",
        "# wheels' radius is that of a wheel times the gear's ratio, m for each rad of a motor.",
        "controller_manager:",
        "  ros__parameters:",
        f"    update_rate: {RATE}",
        f"    {CONTROLLER}:",
        f"      type: {CONTROLLER}/DiffDriveController",
        "",
        *section_of(CONTROLLER, name, robot, found, speed, joints=joints, ratio=robot.drive.front.tau),
        "    position_feedback: false",
        "    enable_odom_tf: false  # artibot publishes odom -> base_link",
        "    base_frame_id: base_link",
        "    odom_frame_id: odom",
    ]
    return "\n".join(lines) + "\n"
