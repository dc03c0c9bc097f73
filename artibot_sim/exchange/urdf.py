"""A robot file as URDF: boxes and wheels where the model has them, joints as in ``/joint_states``.

``python -m artibot_sim.exchange.urdf`` writes ``config/urdf/*.urdf`` for all shipped robots; a test holds the files to
it.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path

from artibot_sim.errors import ArtibotError
from artibot_sim.exchange.ground import left_out, masses, wheels_of
from artibot_sim.model import Robot, load_robot
from artibot_sim.model.robot.robot import Module, module_name
from artibot_sim.resources import config_folder, config_names

MATERIALS = {"body": "0.85 0.45 0.10 1", "wheel": "0.12 0.12 0.12 1"}
"""Colours by name, red green blue alpha."""


def _number(value: float) -> str:
    return f"{value:.9g}"


def _vector(*values: float) -> str:
    return " ".join(map(_number, values))


AXLE = "0 0 1"
"""First direction of friction, along a wheel's axle, in the frame of its cylinder: there it does not turn with it."""


def _link(robot: ET.Element, name: str, mass: float, inertia: tuple[float, float, float]) -> ET.Element:
    link = ET.SubElement(robot, "link", name=name)
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "mass", value=_number(mass))
    xx, yy, zz = map(_number, inertia)
    ET.SubElement(inertial, "inertia", ixx=xx, ixy="0", ixz="0", iyy=yy, iyz="0", izz=zz)
    return link


def _shape(link: ET.Element, shape: str, attributes: dict[str, str], material: str, rpy: str = "0 0 0") -> None:
    for kind in ("visual", "collision"):
        part = ET.SubElement(link, kind)
        ET.SubElement(part, "origin", xyz="0 0 0", rpy=rpy)
        ET.SubElement(ET.SubElement(part, "geometry"), shape, attributes)
        if kind == "visual":
            ET.SubElement(part, "material", name=material)


def _joint(
    robot: ET.Element, name: str, kind: str, parent: str, child: str, xyz: str, axis: str, limit: float | None = None
) -> None:
    joint = ET.SubElement(robot, "joint", name=name, type=kind)
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
    ET.SubElement(joint, "origin", xyz=xyz, rpy="0 0 0")
    ET.SubElement(joint, "axis", xyz=axis)
    if limit is not None:
        ET.SubElement(joint, "limit", lower=_number(-limit), upper=_number(limit), effort="0", velocity="10")


def _module(root: ET.Element, robot: Robot, module: Module, mass: float, link: str, joints: tuple[str, ...]) -> None:
    """One module's box and four wheels; `joints` in the order right front, right back, left front, left back."""
    wheel, wheels = robot.wheel, wheels_of(robot)
    body = _link(root, link, mass, (module.J_x, module.J_y, module.J_z))
    width = max(module.i_y - wheel.r_w, 0.2 * module.i_y)
    _shape(body, "box", {"size": _vector(module.i_x + wheel.r_w, width, wheel.r_w)}, "body")
    for k, joint in enumerate(joints):
        x, y = (1 - 2 * (k % 2)) * module.i_x / 2, (-1 if k < 2 else 1) * module.i_y / 2
        name = f"{joint}_link"
        part = _link(root, name, wheel.m_w, (wheel.J_wx, wheel.J_wy, wheel.J_wx))
        cylinder = {"radius": _number(wheels[motor_of(joint)].radius), "length": _number(0.4 * wheel.r_w)}
        _shape(part, "cylinder", cylinder, "wheel", rpy=_vector(math.pi / 2, 0, 0))
        _joint(root, joint, "continuous", link, name, _vector(x, y, 0), "0 1 0")


def motor_of(joint: str) -> str:
    """The motor that turns a wheel joint."""
    return joint.removesuffix("_wheel").rpartition("_")[0]


def _gazebo(root: ET.Element, robot: Robot, joints: Sequence[str]) -> None:
    """Friction of the wheels in Gazebo's own words."""
    for joint in joints:
        friction = wheels_of(robot)[motor_of(joint)].friction
        extension = ET.SubElement(root, "gazebo", reference=f"{joint}_link")
        for key, value in zip(("mu1", "mu2", "slip1", "slip2"), friction, strict=True):
            ET.SubElement(extension, key).text = _number(value)
        ET.SubElement(extension, "fdir1").text = AXLE


def urdf(robot: Robot, gazebo: bool = False) -> str:
    """The URDF of a robot as text.

    Parameters
    ----------
    robot : what is described.
    gazebo : whether the wheels' friction is added in Gazebo's own words, and what is left out as comments.

    Geometry is the robot file's: wheels at (±i_x/2, ±i_y/2, 0) of their module, the joint at (−l_f, 0, O_z) of
    `base_link` and at (l_b, 0, 0) of `back_link`, turning first in yaw about z of the front module, then in roll
    about x of the back one. Modules behind follow likewise (`articulation_link_2`, `module_3_link`, …). The size of
    the boxes is for the eye alone.

    Raises
    ------
    ArtibotError
        When a joint is not level with the origin of the module behind it.
    """
    for i, module in enumerate(robot.modules[1:], 1):
        if module.O_z != 0:
            name = module_name(i)
            raise ArtibotError(
                f"{name}.O_z: {module.O_z:g} m; a URDF can be made only where the joint is level with the {name} "
                "module (0)"
            )
    root = ET.Element("robot", name=robot.name)
    for name, rgba in MATERIALS.items():
        ET.SubElement(ET.SubElement(root, "material", name=name), "color", rgba=rgba)
    mass = masses(robot)
    wheels, ahead = robot.wheel_joints, "base_link"
    _module(root, robot, robot.front, mass[0], ahead, wheels[:4])
    for i, (hitch, behind) in enumerate(zip(robot.hitches, robot.modules[1:], strict=True), 1):
        number, link = ("" if i == 1 else f"_{i}"), f"{module_name(i)}_link"
        middle = f"articulation_link{number}"
        _link(root, middle, 1e-3, (1e-6, 1e-6, 1e-6))
        place = _vector(-hitch.l, 0, hitch.O_z)
        _joint(root, f"articulation_yaw{number}", "revolute", ahead, middle, place, "0 0 1", math.pi / 2)
        place = _vector(-behind.l, 0, 0)
        _module(root, robot, behind, mass[i], link, wheels[4 * i : 4 * i + 4])
        # the module's origin lies behind the joint, so the roll axis passes through both
        _joint(root, f"articulation_roll{number}", "revolute", middle, link, place, "1 0 0", math.pi / 2)
        ahead = link
    made = "made by `python -m artibot_sim.exchange.urdf` from the robot file"
    if gazebo:
        _gazebo(root, robot, wheels)
        made = "\n     ".join(["made by `artibot export`; left out:", *(f"- {word}" for word in left_out(robot))])
    ET.indent(root)
    return f'<?xml version="1.0"?>\n<!-- {made} -->\n{ET.tostring(root, encoding="unicode")}\n'


def write_all(folder: Path) -> list[Path]:
    """Write the URDF of every shipped robot into `folder`; return the paths."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{name}.urdf" for name in config_names("robots")]
    for path in paths:
        path.write_text(urdf(load_robot(path.stem)), encoding="utf-8")
    return paths


if __name__ == "__main__":
    for written in write_all(config_folder() / "urdf"):
        print(written)
