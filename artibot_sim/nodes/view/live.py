"""A running rover in the browser: what its topics say now, thirty times a second."""

from __future__ import annotations

import math
import time
from functools import partial

import numpy as np
from nav_msgs.msg import Odometry, Path
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState

from artibot_sim.model import MOTORS, Robot, load_robot
from artibot_sim.nodes.common.process import built, destroyed, ros_process
from artibot_sim.nodes.common.qos import subscription
from artibot_sim.view.frames import MEASURED, Film, Poses, chain, state_of, wheel_forces, wheels_of
from artibot_sim.view.scene import Scene
from artibot_sim.view.server import announced, legend, staged, started, stopped, suit

_SENSOR = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
_LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL, reliability=ReliabilityPolicy.RELIABLE)
_PERIOD = 1.0 / 30.0
_PATH_PERIOD = 0.5
"""s between two drawings of the paths."""
_POINTS = 3000
"""Points of a path that is drawn."""
_STEP = 0.01
"""m between two of them."""


class LiveRover(Node):
    """The last of what a rover's topics said.

    Parameters
    ----------
    robot : Robot
    """

    def __init__(self, robot: Robot) -> None:
        super().__init__("view")
        self.robot = robot
        self.paths: dict[str, list[tuple[float, float]]] = {}
        self.changed: set[str] = set()
        self.seen = 0
        self._poses: dict[str, tuple[tuple[float, float, float], tuple[float, float, float]]] = {}
        self._bends: dict[str, tuple[float, float]] = {}
        self._motors = np.full((len(robot.motors), 2), np.nan)
        poses = (("true", "ground_truth/odom"), ("odometric", "odom"))
        self._taken = [
            *(subscription(self, Odometry, topic, partial(self._on_pose, kind), _SENSOR) for kind, topic in poses),
            subscription(self, Path, "planned/path", self._on_plan, _LATCHED),
            subscription(self, JointState, "motor_torques", self._on_motors, _SENSOR),
            subscription(self, JointState, "joint_states", self._on_joints, _SENSOR),
        ]

    def take(self) -> None:
        """Take the last message of each topic, if it is new; to take all that come would cost more than all drawing."""
        for subscribed in self._taken:
            with subscribed.handle:
                taken = subscribed.handle.take_message(subscribed.msg_type, subscribed.raw)
            if taken is not None:
                subscribed.callback(taken[0])

    def _on_pose(self, kind: str, message: Odometry) -> None:
        place, turn, twist = message.pose.pose.position, message.pose.pose.orientation, message.twist.twist
        yaw = math.atan2(2.0 * (turn.w * turn.z + turn.x * turn.y), 1.0 - 2.0 * (turn.y**2 + turn.z**2))
        self._poses[kind] = (place.x, place.y, yaw), (twist.linear.x, twist.linear.y, twist.angular.z)
        self.seen += 1
        points = self.paths.setdefault(kind, [])
        if not points or math.hypot(place.x - points[-1][0], place.y - points[-1][1]) > _STEP:
            points.append((place.x, place.y))
            del points[:-_POINTS]
            self.changed.add(kind)

    def _on_plan(self, message: Path) -> None:
        self.paths["planned"] = [(one.pose.position.x, one.pose.position.y) for one in message.poses]
        self.changed.add("planned")

    def _on_motors(self, message: JointState) -> None:
        for column, values in enumerate((message.position, message.velocity)):
            for name, value in zip(message.name, values, strict=False):
                if name in self.robot.motors:
                    self._motors[self.robot.motors.index(name), column] = value

    def _on_joints(self, message: JointState) -> None:
        for i, name in enumerate(message.name):
            if name.startswith("articulation_yaw") and i < len(message.position):
                rate = message.velocity[i] if i < len(message.velocity) else 0.0
                self._bends[name] = message.position[i], rate

    def poses(self) -> Poses | None:
        """The rover now, None before its pose is known; with forces where the true motion is."""
        kind = "true" if "true" in self._poses else "odometric"
        if kind not in self._poses:
            return None
        robot, (pose, twist) = self.robot, self._poses[kind]
        names = robot.articulation_joints[::2]
        bends = [self._bends.get(name, (0.0, 0.0)) for name in names]
        count = 4 * len(robot.modules)
        wheels = wheels_of(robot, self._motors[:, 0])
        forces, sliding = np.zeros((count, 2)), np.zeros(count, bool)
        speeds = self._motors[: len(MOTORS), 1]
        if kind == "true" and not robot.trailing and np.isfinite(speeds[: 4 if robot.articulated else 2]).all():
            q, v = state_of(robot, pose, twist, bends[0] if bends else (0.0, 0.0), speeds.tolist())
            forces, sliding = wheel_forces(robot, q, v)
        modules = chain(robot, np.array([pose]), np.array([[angle for angle, _ in bends]]))
        return Poses(modules, wheels[None], forces[None], sliding[None])


def run(robot_name: str, port: int, browser: bool, ros_args: list[str]) -> int:
    """Show a running rover until the process is asked to end; return the exit status."""
    robot = load_robot(robot_name)
    with ros_process("view", ros_args) as asked, destroyed(built(LiveRover, robot)) as node:
        server = started(port)
        try:
            empty = Poses(
                np.full((1, len(robot.modules), 3), np.nan), np.zeros((1, 4 * len(robot.modules))),
                np.zeros((1, 4 * len(robot.modules), 2)), np.zeros((1, 4 * len(robot.modules)), bool),
            )  # fmt: skip
            film = Film("live", robot, np.zeros(1), {MEASURED: empty}, {})
            server.gui.configure_theme(show_share_button=False, show_logo=False)
            server.gui.add_markdown(legend(film))
            scene = staged(server, film)
            suit(server)
            print(announced(server, browser), flush=True)
            _follow(node, scene, asked)
        finally:
            stopped(server)
    return 0


def _follow(node: LiveRover, scene: Scene, asked: list[int]) -> None:
    """Draw what comes in, at a steady pace."""
    shown, paths_at, due = -1, 0.0, time.monotonic()
    while not asked:
        due = max(due + _PERIOD, time.monotonic())
        time.sleep(max(0.0, due - time.monotonic()))
        node.take()
        poses = node.poses() if node.seen != shown else None
        shown = node.seen
        if poses is not None:
            scene.show({MEASURED: poses}, 0)
        if time.monotonic() > paths_at:
            paths_at = time.monotonic() + _PATH_PERIOD
            for kind in node.changed:
                scene.line(kind, np.array(node.paths[kind]))
            node.changed.clear()
