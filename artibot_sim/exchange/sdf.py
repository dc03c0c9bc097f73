"""A robot file as SDF for Gazebo: the bodies and joints of its URDF, and the ground's friction under each wheel."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from artibot_sim.exchange.ground import Friction, left_out, wheels_of
from artibot_sim.exchange.urdf import AXLE, motor_of, urdf
from artibot_sim.model import Robot

VERSION = "1.9"
"""Of SDF: that of Gazebo Garden and later."""


def sdf(robot: Robot) -> str:
    """The SDF model of a robot as text.

    Links stand where the joints at rest put them, `base_link` at the height of its wheels' radius. A wheel's `ode`
    friction has its first direction along the axle, where it does not turn with the wheel.

    Raises
    ------
    ArtibotError
        As :func:`artibot_sim.exchange.urdf.urdf`.
    """
    tree = ET.fromstring(urdf(robot))
    places = _places(tree)
    root = ET.Element("sdf", version=VERSION)
    model = ET.SubElement(root, "model", name=robot.name)
    ET.SubElement(model, "pose").text = f"0 0 {robot.wheel.r_w:.9g} 0 0 0"
    wheels = wheels_of(robot)
    for link in tree.findall("link"):
        name = str(link.get("name"))
        motor = motor_of(name.removesuffix("_link"))
        _link(model, link, places[name], wheels[motor].friction if motor in wheels else None)
    for joint in tree.findall("joint"):
        _joint(model, joint)
    ET.indent(root)
    comment = "\n     ".join(["made by `artibot export`; left out:", *(f"- {word}" for word in left_out(robot))])
    return f'<?xml version="1.0"?>\n<!-- {comment} -->\n{ET.tostring(root, encoding="unicode")}\n'


def _attribute(element: ET.Element, path: str, name: str) -> str:
    found = element.find(path)
    assert found is not None  # the URDF is ours
    return str(found.get(name))


def _places(tree: ET.Element) -> dict[str, NDArray[np.float64]]:
    """Positions of all links in `base_link`, joints at zero."""
    joints = {_attribute(joint, "child", "link"): joint for joint in tree.findall("joint")}

    def place(link: str) -> NDArray[np.float64]:
        if link not in joints:
            return np.zeros(3)
        joint = joints[link]
        return place(_attribute(joint, "parent", "link")) + np.array(_attribute(joint, "origin", "xyz").split(), float)

    return {link: place(link) for link in ("base_link", *joints)}


def _link(model: ET.Element, link: ET.Element, place: NDArray[np.float64], friction: Friction | None) -> None:
    made = ET.SubElement(model, "link", name=str(link.get("name")))
    ET.SubElement(made, "pose").text = " ".join(f"{value:.9g}" for value in (*place, 0.0, 0.0, 0.0))
    inertial = ET.SubElement(made, "inertial")
    ET.SubElement(inertial, "mass").text = _attribute(link, "inertial/mass", "value")
    inertia = ET.SubElement(inertial, "inertia")
    for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"):
        ET.SubElement(inertia, key).text = _attribute(link, "inertial/inertia", key)
    for kind in ("collision", "visual"):
        if link.find(kind) is not None:
            part = _shape(made, link, kind)
            if kind == "collision" and friction is not None:
                _surface(part, friction)


def _shape(made: ET.Element, link: ET.Element, kind: str) -> ET.Element:
    part = ET.SubElement(made, kind, name=kind)
    origin = f"{_attribute(link, f'{kind}/origin', 'xyz')} {_attribute(link, f'{kind}/origin', 'rpy')}"
    ET.SubElement(part, "pose").text = origin
    shape = link.findall(f"{kind}/geometry/*")[0]
    geometry = ET.SubElement(ET.SubElement(part, "geometry"), shape.tag)
    for key, value in shape.attrib.items():
        ET.SubElement(geometry, key).text = value
    return part


def _surface(part: ET.Element, friction: Friction) -> None:
    ode = ET.SubElement(ET.SubElement(ET.SubElement(part, "surface"), "friction"), "ode")
    for key, value in zip(("mu", "mu2", "slip1", "slip2"), friction, strict=True):
        ET.SubElement(ode, key).text = f"{value:.9g}"
    ET.SubElement(ode, "fdir1").text = AXLE


def _joint(model: ET.Element, joint: ET.Element) -> None:
    """A joint at its child's origin, as in the URDF."""
    made = ET.SubElement(model, "joint", name=str(joint.get("name")), type="revolute")
    for end in ("parent", "child"):
        ET.SubElement(made, end).text = _attribute(joint, end, "link")
    axis = ET.SubElement(made, "axis")
    ET.SubElement(axis, "xyz").text = _attribute(joint, "axis", "xyz")
    limit = ET.SubElement(axis, "limit")
    bounded = joint.find("limit") is not None
    for key, free in (("lower", "-1e16"), ("upper", "1e16")):
        ET.SubElement(limit, key).text = _attribute(joint, "limit", key) if bounded else free
