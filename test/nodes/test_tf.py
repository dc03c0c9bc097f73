"""/tf over the middleware, by nodes as users start them, recorded by default and read by another program."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed; run `make setup`, or source a ROS 2 Jazzy")

from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from tf2_package import environment

from artibot_driver.loopback import loopback_bus
from ros_helpers import NodeProcess, NodeStarter

MOUNTS = """
import signal
import sys
import rclpy
from geometry_msgs.msg import TransformStamped
from rclpy.qos import DurabilityPolicy, QoSProfile
from tf2_msgs.msg import TFMessage

latched = QoSProfile(depth=1 if sys.argv[1] == "say" else 10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
rclpy.init()
node = rclpy.create_node(f"mounts_{sys.argv[2]}")
if sys.argv[1] == "say":
    publisher = node.create_publisher(TFMessage, "/tf_static", latched)
    mount = TransformStamped(child_frame_id=sys.argv[2])
    mount.header.frame_id, mount.transform.translation.z = "base_link", float(sys.argv[3])
    publisher.publish(TFMessage(transforms=[mount]))
else:
    def heard(message):
        for each in message.transforms:
            print("heard", each.child_frame_id, each.transform.translation.z, flush=True)
    node.create_subscription(TFMessage, "/tf_static", heard, latched)
print("there", flush=True)
try:
    rclpy.spin(node)
except BaseException:
    pass
"""
"""A sensor's mount on /tf_static, as a static transform publisher says it once; or who listens to mounts."""

Pose = tuple[float, float, float, float]
"""x, y, z and yaw."""


@pytest.fixture(scope="module")
def with_tf(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    return environment(tmp_path_factory.mktemp("tf2_msgs"))


def messages(bag: Path, topic: str) -> Iterator[Any]:
    with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        for connection, _, data in reader.messages([c for c in reader.connections if c.topic == topic]):
            yield reader.deserialize(data, connection.msgtype)


def pose(position: Any, rotation: Any) -> Pose:
    yaw = math.atan2(2 * (rotation.w * rotation.z + rotation.x * rotation.y), 1 - 2 * (rotation.y**2 + rotation.z**2))
    return position.x, position.y, position.z, yaw


def newest_tree(bag: Path) -> dict[tuple[str, str], Pose]:
    """Parent and child → where the child is."""
    return {
        (each.header.frame_id, each.child_frame_id): pose(each.transform.translation, each.transform.rotation)
        for message in messages(bag, "/tf")
        for each in message.transforms
    }


def placed(first: Pose, second: Pose) -> Pose:
    """The second in the frame that the first is in, both without roll and pitch."""
    c, s = math.cos(first[3]), math.sin(first[3])
    x, y = first[0] + c * second[0] - s * second[1], first[1] + s * second[0] + c * second[1]
    return x, y, first[2] + second[2], first[3] + second[3]


def test_with_a_driver_odom_and_tf_agree_and_end_at_the_truth(
    start_node: NodeStarter, tmp_path: Path, with_tf: dict[str, str]
) -> None:
    """The driver's odometry begins at zero wherever the rover stands; map → odom makes up for it."""
    with loopback_bus() as channel:
        bag = tmp_path / "run"
        record = start_node("record", "-o", bag, env=with_tf)
        given = ("--with-driver", "--channel", channel, "--start", 2, 1, 1.0)
        sim, driver = start_node("sim", *given, env=with_tf), start_node("driver", "--channel", channel, env=with_tf)
        driver.wait_for("disabled, may be enabled", 60.0)
        (second,) = [start_node("driver", "--help")]  # a second of wall time and more, in which all of them publish
        second.wait()
        record.wait_for("/ground_truth/odom")
        for node in (driver, sim, record):
            assert node.stop(20.0) == 0
    found, odom = newest_tree(bag), [*messages(bag, "/odom")][-1].pose.pose
    chain = ["map", "odom", "base_link", "articulation_link", "back_link"]
    assert set(found) == set(zip(chain[:-1], chain[1:], strict=True))
    assert found["odom", "base_link"] == pytest.approx(pose(odom.position, odom.orientation), abs=1e-9)
    assert found["odom", "base_link"] == pytest.approx((0, 0, 0, 0), abs=1e-6)
    truth = [*messages(bag, "/ground_truth/odom")][-1].pose.pose
    front = placed(found["map", "odom"], found["odom", "base_link"])
    assert front == pytest.approx(pose(truth.position, truth.orientation), abs=1e-3)
    assert front == pytest.approx((2.0, 1.0, 0.2, 1.0), abs=5e-3)
    assert len([*messages(bag, "/robot_description")]) >= 1


def test_two_rovers_have_one_tree_with_names_of_their_own(
    start_node: NodeStarter, tmp_path: Path, with_tf: dict[str, str]
) -> None:
    bag = tmp_path / "two"
    record = start_node("record", "-o", bag, "-t", "/tf", env=with_tf)
    places = {"rover1": (1.0, 2.0, 0.5), "rover2": (-3.0, 0.0, -1.0)}
    sims = []
    for name, place in places.items():
        ros = ("--ros-args", "-r", f"__ns:=/{name}", "-p", f"frame_prefix:={name}/")
        sims.append(start_node("sim", "--start", *place, *ros, env=with_tf))
    for sim in sims:
        sim.wait_for("is ready", 60.0)
    record.wait_for("/tf")
    start_node("sim", "--help").wait()
    for node in (*sims, record):
        assert node.stop(20.0) == 0
    found = newest_tree(bag)
    children = [child for _, child in found]
    assert len(set(children)) == len(children), "no frame has two parents"
    for name, (x, y, yaw) in places.items():
        front = placed(found["map", f"{name}/odom"], found[f"{name}/odom", f"{name}/base_link"])
        assert np.array(front)[[0, 1, 3]] == pytest.approx((x, y, yaw), abs=5e-3)


def test_mounts_on_tf_static_are_recorded_by_default_and_played_to_who_comes_late(
    start_node: NodeStarter, tmp_path: Path, with_tf: dict[str, str]
) -> None:
    """artibot says nothing there itself, but a viewer places a rover's sensors with what others said long ago."""
    heights = {"lidar": 0.5, "camera": 0.25}

    def mounts(*words: object) -> NodeProcess:
        process = start_node.run([sys.executable, "-c", MOUNTS, *map(str, words)], f"mounts_{words[1]}", env=with_tf)
        process.wait_for("there", 60.0)
        return process

    said = [mounts("say", *mount) for mount in heights.items()]
    bag = tmp_path / "run"
    record = start_node("record", "-o", bag, env=with_tf)
    record.wait_for("recording /tf_static [tf2_msgs/msg/TFMessage], reliable, latched", 60.0)
    simulator = start_node("sim", env=with_tf)
    simulator.wait_for("is ready", 60.0)
    record.wait_for("recording /robot_description")
    for node in (simulator, record, *said):
        node.stop(20.0)
    recorded = [each for message in messages(bag, "/tf_static") for each in message.transforms]
    assert {each.child_frame_id: each.transform.translation.z for each in recorded} == heights

    start_node("replay", bag, "--wait", 0, "--rate", 0.05, env=with_tf).wait_for("playing ")
    late = mounts("hear", "late")
    for name, height in heights.items():
        late.wait_for(f"heard {name} {height}")
