"""Layouts for Foxglove and PlotJuggler: everything they draw is in a recording as artibot records by default."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ElementTree
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed; run `make setup`, or source a ROS 2 Jazzy")

from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from artibot_sim.resources import config_folder
from ros_helpers import ros_processes

VIEWER = config_folder() / "viewer"
JOINTS = "sensor_msgs/msg/JointState"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Topic → its last message, read by another program."""
    folder = tmp_path_factory.mktemp("layouts")
    with ros_processes("layouts", folder) as (start_node, _):
        record = start_node("record", "-o", folder / "run")
        sim = start_node("sim", "--params", "sim_noisy")
        planner = start_node("planner", "short")
        assert planner.wait(120.0) == 0
        for node in (sim, record):
            assert node.stop(20.0) == 0
    found = {}
    with AnyReader([folder / "run"], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        for connection, _, data in reader.messages():
            found[connection.topic] = reader.deserialize(data, connection.msgtype)
    return found


def foxglove_paths() -> list[str]:
    layout = json.loads((VIEWER / "foxglove.json").read_text(encoding="utf-8"))
    plots = [config for name, config in layout["configById"].items() if name.startswith("Plot!")]
    return [path["value"] for plot in plots for path in plot["paths"]]


def plotjuggler_curves() -> list[str]:
    root = ElementTree.parse(VIEWER / "plotjuggler.xml").getroot()
    return [curve.attrib["name"] for curve in root.iter("curve")]


def topic_of(path: str, topics: dict[str, Any], end: str) -> str:
    """The longest topic that a path begins with, followed by what separates it from the field."""
    return max((topic for topic in topics if path.startswith(topic + end)), key=len, default="")


def followed(message: Any, names: list[str]) -> float:
    for name in names:
        field, _, index = name.partition("[")
        message = getattr(message, field)
        message = message[int(index.rstrip("]"))] if index else message
    return float(message)


@pytest.mark.parametrize("path", foxglove_paths())
def test_foxglove_finds_every_path(recorded: dict[str, Any], path: str) -> None:
    topic = topic_of(path, recorded, ".")
    assert topic, f"{path}: not recorded"
    followed(recorded[topic], path.removeprefix(f"{topic}.").split("."))


@pytest.mark.parametrize("curve", plotjuggler_curves())
def test_plotjuggler_finds_every_curve(recorded: dict[str, Any], curve: str) -> None:
    """It names the joints of a JointState: /motor_torques/front_right/velocity."""
    topic = topic_of(curve, recorded, "/")
    assert topic, f"{curve}: not recorded"
    message, names = recorded[topic], curve.removeprefix(f"{topic}/").split("/")
    if message.__msgtype__ == JOINTS:
        joint, field = names
        float(getattr(message, field)[message.name.index(joint)])
    else:
        followed(message, names)


def test_foxglove_shows_each_panel_and_what_the_3d_view_needs_but_tf(recorded: dict[str, Any]) -> None:
    layout = json.loads((VIEWER / "foxglove.json").read_text(encoding="utf-8"))
    shown = set(re.findall(r'"((?:3D|Plot)![a-z]+)"', json.dumps(layout["layout"])))
    assert shown == set(layout["configById"])
    view = layout["configById"]["3D!rover"]
    topics = {*view["topics"], *(layer["topic"] for layer in view["layers"].values() if "topic" in layer)}
    assert topics <= set(recorded)
    assert view["followTf"] == recorded["/ground_truth/odom"].header.frame_id
