"""One tree of transforms: what is published on /tf agrees with /odom and with the truth, whoever publishes which part.

tf2_msgs comes with a full ROS 2 only, so a class with TFMessage's one field stands in for it here.
"""

from __future__ import annotations

import math
import sys
import types
from types import SimpleNamespace as Record
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed; run `make setup`, or source a ROS 2 Jazzy")

from nav_msgs.msg import Odometry as OdometryMessage
from rclpy.node import Node

from artibot_driver.config import ALL_SPECS
from artibot_driver.master import Feedback
from artibot_sim.estimation.odometry import Odometry, Slip, metres_per_radian
from artibot_sim.model import Robot, load_robot
from artibot_sim.nodes.common import transforms
from artibot_sim.nodes.common.rotations import rotation
from artibot_sim.nodes.common.transforms import FrameNames
from artibot_sim.nodes.driver import publishers
from artibot_sim.nodes.sim.engine import Engine, Periods, StartPose, TrueState
from artibot_sim.nodes.sim.publishers import Published, Publishers
from artibot_sim.nodes.sim.sensors import SensorModel, SimulatedSensors
from artibot_sim.nodes.sim.transforms import corrected
from ros_helpers import spin_until

Tree = dict[tuple[str, str], np.ndarray]


@pytest.fixture
def sent(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """All transforms that are published on /tf."""
    stand_in = types.ModuleType("tf2_msgs.msg")
    stand_in.TFMessage = lambda transforms: transforms  # type: ignore[attr-defined]
    package = types.ModuleType("tf2_msgs")
    package.__spec__ = types.SimpleNamespace(name="tf2_msgs")  # type: ignore[assignment]
    monkeypatch.setitem(sys.modules, "tf2_msgs", package)
    monkeypatch.setitem(sys.modules, "tf2_msgs.msg", stand_in)
    found: list[Any] = []
    real = transforms.publisher

    def publisher(node: Node, kind: type, topic: str, *args: Any) -> Any:
        # a message is filled in place: what it holds is taken when it is published
        return Record(publish=lambda m: found.extend(map(frozen, m))) if topic == "/tf" else real(node, kind, topic)

    monkeypatch.setattr(transforms, "publisher", publisher)
    return found


def frozen(stamped: Any) -> tuple[int, tuple[str, str], np.ndarray]:
    stamp = stamped.header.stamp.sec * 10**9 + stamped.header.stamp.nanosec
    return stamp, (stamped.header.frame_id, stamped.child_frame_id), matrix(stamped.transform)


def matrix(transform: Any) -> np.ndarray:
    q, p = transform.rotation, transform.translation
    x, y, z, w = q.x, q.y, q.z, q.w
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w), p.x],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w), p.y],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y), p.z],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def tree(sent: list[Any], stamp: int | None = None) -> Tree:
    """The newest transform of each pair, or those of a stamp."""
    return {pair: found for t, pair, found in sent if stamp is None or t == stamp}


def published(with_driver: bool = False, frames: FrameNames | None = None) -> Published:
    return Published(False, False, with_driver, True, False, False, frames or FrameNames(), 0.0, 0.0)


def sample_at(robot: Robot, x: float, y: float, yaw: float, bend: float) -> TrueState:
    """The truth of a rover that stands tilted a little."""
    q = Engine(robot, Periods.of(100.0, 1e-3), StartPose(x, y, yaw, bend)).state.q.copy()
    q[3:5] = 0.03, -0.05
    none = np.zeros(4)
    articulation = np.array([[bend, 0.0], [0.0, 0.0]]) if robot.articulated else np.zeros((2, 2))
    still = np.zeros(3)
    return TrueState(q[:3], q[3:6], (0.0, 0.0, 0.0), still, still, still, none, none, none, articulation, (0.0, 0.0))


def test_the_chain_ends_at_the_truth_and_odom_says_what_the_odometry_says(ros_context: Any, sent: list[Any]) -> None:
    robot, node = load_robot("epiq"), Node("sim", context=ros_context)
    odoms: list[Any] = []
    node.create_subscription(OdometryMessage, "odom", odoms.append, 10)
    out = Publishers(node, robot, published())
    believed = Odometry(metres_per_radian(robot), robot.front.i_y, Slip(0.02, 0.2, 0.06))
    believed.reset(0.9, 2.2, 0.4)
    sample = sample_at(robot, 1.0, 2.0, 0.5, 0.6)
    out.publish(7_000_000_123, sample, SimulatedSensors(SensorModel(), 0), believed, False)
    spin_until(node, lambda: bool(odoms), what="odom")
    found = tree(sent, 7_000_000_123)
    chain = ["map", "odom", "base_link", "articulation_link", "back_link"]
    assert set(found) == set(zip(chain[:-1], chain[1:], strict=True))
    front = found["map", "odom"] @ found["odom", "base_link"]
    np.testing.assert_allclose(front[:3, :3], sample.attitude, atol=1e-12)
    np.testing.assert_allclose(front[:3, 3], sample.position, atol=1e-12)
    pose = odoms[0].pose.pose
    stated = matrix(Record(translation=pose.position, rotation=pose.orientation))
    np.testing.assert_allclose(found["odom", "base_link"], stated, atol=1e-12)
    assert (pose.position.x, pose.position.y, pose.position.z) == (0.9, 2.2, 0.0)
    back = front @ found["base_link", "articulation_link"] @ found["articulation_link", "back_link"]
    assert np.linalg.norm(back[:3, 3] - front[:3, 3]) == pytest.approx(
        math.hypot(robot.front.l + robot.back.l * math.cos(0.6), robot.back.l * math.sin(0.6)), abs=1e-6
    )


@pytest.mark.parametrize("place", [(3.0, -2.0, 2.5), (100.0, 50.0, -3.0)])
def test_a_correction_carries_any_belief_to_the_truth(place: tuple[float, float, float]) -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        truth = (tuple(rng.uniform(-5, 5, 3)), tuple(rng.uniform(-1.2, 1.2, 3)))
        belief = placed((*place[:2], 0.0), (0.0, 0.0, place[2]))
        np.testing.assert_allclose(placed(*corrected(truth, place)) @ belief, placed(*truth), atol=1e-10)


def placed(translation: Any, rpy: Any) -> np.ndarray:
    full = np.eye(4)
    full[:3, :3], full[:3, 3] = rotation(*rpy), translation
    return full


def driver_settings(**given: Any) -> dict[str, Any]:
    return {name: spec.default for name, spec in ALL_SPECS.items()} | given


def feedback(robot: Robot, stamp_ns: int, right: float, left: float) -> Feedback:
    """What four drives report: angles of the front motors after so many metres."""
    radian = metres_per_radian(robot)
    turned = (right / radian, left / radian, 0.0, 0.0)
    return Feedback(position=turned, velocity=(0.0,) * 4, torque=(0.0,) * 4, stamp_ns=(stamp_ns,) * 4)


def test_with_a_driver_there_is_one_tree_and_the_driver_s_odometry_is_in_it(ros_context: Any, sent: list[Any]) -> None:
    """The rover starts away from map's origin, where the driver's odometry begins."""
    robot = load_robot("agriq")
    node, other = Node("sim", context=ros_context), Node("driver", context=ros_context)
    sim = Publishers(node, robot, published(with_driver=True))
    driver = publishers.DriverPublishers(other, robot, driver_settings())
    sensors, believed = SimulatedSensors(SensorModel(), 0), Odometry(1.0, 1.0)
    heard: list[Any] = []
    node.create_subscription(OdometryMessage, "odom", heard.append, 10)
    t, step = 1_000_000_000, 10_000_000
    for k in range(3):
        sim.publish(t + (k - 3) * step, sample_at(robot, 2.0, 1.0, 1.0, 0.1), sensors, believed, False)
    assert ("map", "odom") not in tree(sent), "unknown before the driver speaks"
    assert {("base_link", "articulation_link"), ("articulation_link", "back_link")} <= set(tree(sent))
    for k, way in enumerate((0.0, 0.5)):
        now, ahead = t + k * step, sample_at(robot, 2.0 + way * math.cos(1.0), 1.0 + way * math.sin(1.0), 1.0, 0.1)
        sent.clear()
        driver.feedback(feedback(robot, now, way, way), 0)
        spin_until(node, lambda k=k: len(heard) > k, what="the driver's odometry")
        sim.publish(now, ahead, sensors, believed, False)
        found = tree(sent, now)
        assert len(sent) == len(found) == 4, "each transform has one publisher"
        pose = heard[-1].pose.pose
        stated = matrix(Record(translation=pose.position, rotation=pose.orientation))
        np.testing.assert_allclose(found["odom", "base_link"], stated, atol=1e-12)
        front = found["map", "odom"] @ found["odom", "base_link"]
        np.testing.assert_allclose(front[:3, 3], ahead.position, atol=1e-9)
        np.testing.assert_allclose(front[:3, :3], ahead.attitude, atol=1e-9)
    later = sample_at(robot, 2.0 + 0.7 * math.cos(1.0), 1.0 + 0.7 * math.sin(1.0), 1.0, 0.1)
    sim.publish(t + 2 * step, later, sensors, believed, False)
    np.testing.assert_allclose(tree(sent)["map", "odom"], found["map", "odom"], atol=1e-12)  # until the driver speaks


def test_names_of_frames_have_one_prefix_but_the_map(ros_context: Any, sent: list[Any]) -> None:
    """Two rovers in one tree: robot_state_publisher's frame_prefix does the same to the URDF's links."""
    robot = load_robot("agriq")
    for name in ("rover1", "rover2"):
        node = Node("driver", namespace=name, context=ros_context)
        driver = publishers.DriverPublishers(node, robot, driver_settings(frame_prefix=f"{name}/"))
        driver.feedback(feedback(robot, 1, 0.0, 0.0), 0)
        sim = Publishers(node, robot, published(frames=FrameNames.of(f"{name}/")))
        sim.publish(
            10, sample_at(robot, 0.0, 0.0, 0.0, 0.0), SimulatedSensors(SensorModel(), 0), Odometry(1.0, 1.0), False
        )
    pairs = set(tree(sent))
    for name in ("rover1", "rover2"):
        links = ["map", *(f"{name}/{link}" for link in ("odom", "base_link", "articulation_link", "back_link"))]
        assert set(zip(links[:-1], links[1:], strict=True)) <= pairs
    children = [child for _, child in pairs]
    assert len(children) == len(set(children)) == 8, "every frame has one parent"


def test_without_publish_tf_a_filter_has_the_transform_for_itself(ros_context: Any, sent: list[Any]) -> None:
    node = Node("driver", context=ros_context)
    driver = publishers.DriverPublishers(node, load_robot("agriq"), driver_settings(publish_tf=False))
    driver.feedback(feedback(load_robot("agriq"), 1, 0.0, 0.0), 0)
    assert not sent
