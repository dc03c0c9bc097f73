"""The planner node: publishes a plan, and while it is followed where the rover ought to be.

It waits until somebody who follows listens to the profile (see `followers`), chooses a start a little ahead
(`start_delay`), publishes path and profile once (transient local) and the planned odometry all the time, until a little
after the end. All stamps are the node's time: the system's, or /clock's with `use_sim_time`.

"""

from __future__ import annotations

import math
import time
from array import array
from collections.abc import Callable
from typing import Any

import numpy as np
from builtin_interfaces.msg import Duration, Time
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion
from nav_msgs.msg import Odometry, Path
from numpy.typing import NDArray
from rclpy.node import Node, NodeNameNonExistentError
from rclpy.parameter import Parameter
from std_msgs.msg import Header
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from artibot_driver.priority import take_priority
from artibot_sim.errors import ArtibotError
from artibot_sim.model import MOTORS, load_robot
from artibot_sim.nodes.common.motor_publishers import OdometryPublisher
from artibot_sim.nodes.common.pacer import Seldom
from artibot_sim.nodes.common.parameters import declare, warn_of_unknown
from artibot_sim.nodes.common.qos import LATCHED, publisher
from artibot_sim.parameters import Spec
from artibot_sim.planning import Plan, load_manoeuvre, plan

# ----------------------------------------------------------------------
# A plan as ROS messages.
# ----------------------------------------------------------------------


SECOND = 1_000_000_000


def stamp(t_ns: int) -> Time:
    """A time stamp from nanoseconds."""
    return Time(sec=t_ns // SECOND, nanosec=t_ns % SECOND)


def pose(x: float, y: float, yaw: float) -> Pose:
    """A pose in the plane (m, m, rad)."""
    turned = Quaternion(x=0.0, y=0.0, z=math.sin(yaw / 2), w=math.cos(yaw / 2))
    return Pose(position=Point(x=x, y=y, z=0.0), orientation=turned)


def front_velocity(plan: Plan, start_ns: int) -> JointTrajectory:
    """The front motors' profile: a point each `plan.dt`, positions from 0 and velocities, motor-side.

    Parameters
    ----------
    plan : Plan
    start_ns : int
        Absolute time of the first point, ns.
    """
    message = JointTrajectory(header=Header(stamp=stamp(start_ns)), joint_names=list(MOTORS[:2]))
    times = np.round(plan.t * SECOND).astype(np.int64).tolist()
    rows = zip(times, plan.position.tolist(), plan.velocity.tolist(), strict=True)
    message.points = [
        JointTrajectoryPoint(
            positions=array("d", position),
            velocities=array("d", velocity),
            time_from_start=Duration(sec=t // SECOND, nanosec=t % SECOND),
        )
        for t, position, velocity in rows
    ]
    return message


def path(plan: Plan, start_ns: int, interval: float, frame: str) -> Path:
    """The planned path: a pose each `interval` seconds and one at the end, each with the time it is planned for."""
    times = np.append(np.arange(0.0, plan.duration - 1e-6, interval), plan.duration)
    message = Path(header=Header(stamp=stamp(start_ns), frame_id=frame))
    stamps = (start_ns + np.round(times * SECOND).astype(np.int64)).tolist()
    message.poses = [
        PoseStamped(header=Header(stamp=stamp(t), frame_id=frame), pose=pose(*row))
        for t, row in zip(stamps, plan.at(times).pose.tolist(), strict=True)
    ]
    return message


# ----------------------------------------------------------------------
# The planner node: publishes a plan, and while it is followed where the rover ought to be.
#
# It waits until somebody who follows listens to the profile (see `followers`), chooses a start a little ahead
# (`start_delay`), publishes path and profile once (transient local) and the planned odometry all the time, until a
# little after the end. All stamps are the node's time: the system's, or /clock's with `use_sim_time`.
# ----------------------------------------------------------------------


SPECS = (
    Spec("manoeuvre", "table6_agriq", "Manoeuvre: the name of a shipped one or the path of a YAML file."),
    Spec("robot", "agriq", "Robot: a name (agriq, epiq, husky) or the path of a robot file."),
    Spec("dt", 0.01, "Interval between the points of the profile, s.", low=1e-3, high=0.1),
    Spec("rate", 50.0, "Rate of planned/odom, Hz; the contract asks for 20 or more.", low=20.0, high=1000.0),
    Spec("start.x", 0.0, "Start of the front module in the frame, m.", low=-1e6, high=1e6),
    Spec("start.y", 0.0, "Start of the front module in the frame, m.", low=-1e6, high=1e6),
    Spec("start.yaw", 0.0, "Heading at the start, rad.", low=-10.0, high=10.0),
    Spec("start_delay", 1.0, "How long after its publication the profile starts, s.", low=0.05, high=3600.0),
    Spec(
        "subscriber_timeout",
        120.0,
        "How long to wait for them to listen to planned/front_velocity, s; 0: do not wait.",
        low=0.0,
        high=1e6,
    ),
    Spec(
        "wait_for",
        "follower",
        "For whom to wait: follower, who listens and publishes a JointState, as simulator and driver do and a recorder "
        "does not; anyone, who listens.",
        choices=("follower", "anyone"),
    ),
    Spec("clock_timeout", 120.0, "How long to wait for the first /clock with use_sim_time, s.", low=0.1, high=1e6),
    Spec("tail", 0.5, "How long planned/odom goes on after the end, s.", low=0.0, high=1e6),
    Spec("realtime_priority", 45, "Priority among the machine's real-time threads (SCHED_FIFO) while the profile is "
         "followed in system time: a sign of life that a busy machine delays stops the rover. 0, and where the system "
         "does not allow it: that of any other process.", low=0, high=99),
    Spec("keep", False, "Stay after the end, so that late subscribers still get path and profile."),
    Spec("path_interval", 0.1, "Time between poses of planned/path, s.", low=1e-3, high=100.0),
    Spec("frame_id", "map", "Frame of the planned poses."),
    Spec("child_frame_id", "base_link", "Frame of the front module."),
    Spec("frame_prefix", "", "Before child_frame_id, as in the simulator and the driver: rover1/."),
    Spec("wheel_speed_limit", 0.0, "Warn of wheels faster over ground, m/s; 0: never.", low=0.0, high=100.0),
)  # fmt: skip
"""Every parameter; none can be changed while the node runs, for the profile is published once."""

IDLE = 0.1
"""How long the executor is waited in at a time, s."""

SAY_EVERY = 5.0
"""How far the drive is, is said so often, s; and who waits for longer says for what."""

GRID = 1e-3
"""s between the planned motions that are worked out before the start: one by one each takes as long as a hundred."""

CLOCK_LOST = 2.0
"""Without a publisher of /clock for this long (s, steady time) the planner gives up."""


class PlannerNode(Node):
    """``planner`` (see the module's text).

    Parameters
    ----------
    overrides : dict
        Parameters set by the command line; they win over ``--ros-args``.
    asked : list of int
        Signals received so far; the node ends when there is one.

    Raises
    ------
    ArtibotError
        When a parameter, the robot or the manoeuvre is refused.
    """

    def __init__(self, overrides: dict[str, Any], asked: list[int]) -> None:
        super().__init__("planner", parameter_overrides=[Parameter(name, value=v) for name, v in overrides.items()])
        self.settings: dict[str, Any] = {spec.name: declare(self, spec) for spec in SPECS}
        get = self.settings.__getitem__
        self.plan = plan(
            load_manoeuvre(get("manoeuvre")),
            load_robot(get("robot")),
            dt=get("dt"),
            start=(get("start.x"), get("start.y"), get("start.yaw")),
            wheel_speed_limit=get("wheel_speed_limit") or None,
        )
        self._grid = _grid(self.plan)
        self.start_ns: int | None = None
        self.finished = False
        self._say_how_far = Seldom(SAY_EVERY)
        self._asked = asked
        self._path = publisher(self, Path, "planned/path", LATCHED)
        self._profile = publisher(self, JointTrajectory, "planned/front_velocity", LATCHED)
        message = Odometry(child_frame_id=get("frame_prefix") + get("child_frame_id"))
        message.header.frame_id = get("frame_id")
        self._odom = OdometryPublisher(publisher(self, Odometry, "planned/odom"), message)
        warn_of_unknown(self)

    def run(self, executor: Any) -> int:
        """Publish the plan and stay until it is over; return the exit status.

        0 after the end; 128 and the signal's number when asked to end before; 1 when /clock was lost.

        Raises
        ------
        ArtibotError
            When there is no clock or nobody who listens.
        """
        log, what = self.get_logger(), self.plan
        log.info(f"{what.manoeuvre.name} for {what.robot}: {what.duration:.2f} s, {what.path_length:.2f} m")
        for warning in what.warnings:
            log.warning(f"{what.manoeuvre.name}: {warning}")
        self._wait_for_clock(executor)
        timer = self.create_timer(1.0 / self.settings["rate"], self._tick)
        self._wait_for_listener(executor)
        if not self._asked:
            self._publish_profile()
        if not self._on_clock:
            take_priority(self.settings["realtime_priority"])
        status = self._follow(executor)
        timer.cancel()
        if self.settings["keep"] and status == 0:
            log.info("finished; staying for late subscribers (keep)")
            self._spin(executor, lambda: False)
        return status

    def _spin(self, executor: Any, done: Callable[[], bool], timeout: float = float("inf")) -> bool:
        """Spin until `done`, a signal, or `timeout` (steady time); return whether it was done."""
        deadline = time.monotonic() + timeout
        while not done():
            if self._asked or time.monotonic() > deadline:
                return False
            executor.spin_once(timeout_sec=IDLE)
        return True

    def _came(self, executor: Any, done: Callable[[], bool], timeout: float, awaited: str) -> bool:
        """Wait until `done` or asked to end; False where `timeout` (s) is over before."""
        if self._spin(executor, done, min(timeout, SAY_EVERY)) or self._asked:
            return True
        if timeout > SAY_EVERY:
            self.get_logger().info(
                f"waiting for {awaited}, {timeout:g} s at most; a simulator that compiles its model may take a minute"
            )
        return self._spin(executor, done, timeout - SAY_EVERY) or bool(self._asked)

    @property
    def _on_clock(self) -> bool:
        return bool(self.get_parameter("use_sim_time").value)

    def _wait_for_clock(self, executor: Any) -> None:
        if not self._on_clock:
            return
        timeout = self.settings["clock_timeout"]
        if not self._came(executor, lambda: self.get_clock().now().nanoseconds > 0, timeout, "a simulator's /clock"):
            raise ArtibotError(
                f"/clock: nothing came within {timeout:g} s, expected a simulator's time (use_sim_time is true); "
                "start one that publishes it, or set use_sim_time to false"
            )

    def _wait_for_listener(self, executor: Any) -> None:
        timeout, topic = self.settings["subscriber_timeout"], self._profile.topic_name
        if timeout == 0:
            return
        anyone = self.settings["wait_for"] == "anyone"

        def subscribed() -> bool:
            return self._profile.get_subscription_count() > 0 and (anyone or followers(self, topic) > 0)

        if not self._came(executor, subscribed, timeout, f"a simulator or driver that listens to {topic}"):
            others = sorted({info.node_name for info in self.get_subscriptions_info_by_topic(topic)})
            who = f"nobody but {', '.join(others)}" if others else "nobody"
            raise ArtibotError(
                f"{topic}: {who} listened within {timeout:g} s, expected a simulator or driver; start one in the same "
                "namespace and ROS_DOMAIN_ID, set wait_for to anyone, or subscriber_timeout to 0 to publish anyway"
            )
        if not self._on_clock and self.count_publishers("/clock"):
            self.get_logger().warning("somebody publishes /clock, but use_sim_time is false: stamps may not agree")

    def _publish_profile(self) -> None:
        profile = front_velocity(self.plan, 0)  # takes a while to fill, so it is stamped afterwards
        self.start_ns = self.get_clock().now().nanoseconds + round(self.settings["start_delay"] * SECOND)
        profile.header.stamp = stamp(self.start_ns)
        self._profile.publish(profile)
        interval, frame = self.settings["path_interval"], self.settings["frame_id"]
        self._path.publish(path(self.plan, self.start_ns, interval, frame))
        self.get_logger().info(f"starts at {self.start_ns / SECOND:.3f}, {len(profile.points)} points")

    def _tick(self) -> None:
        """Publish where the rover ought to be now; before the start, and until it is chosen, that is the start pose."""
        now = self.get_clock().now().nanoseconds
        t = -1.0 if self.start_ns is None else (now - self.start_ns) / SECOND
        if t > self.plan.duration + self.settings["tail"]:
            self.finished = True
            return
        x, y, yaw, speed, rate = self._planned(t)
        self._odom.publish(now, (x, y, yaw), (speed, 0.0, rate))
        if t > 0 and self._say_how_far.due():
            self.get_logger().info(f"{t:.0f} of {self.plan.duration:.0f} s")

    def _planned(self, t: float) -> list[float]:
        """Planned x, y and yaw (m, rad), speed and yaw rate (m/s, rad/s) at `t` seconds after the start."""
        at = t / GRID
        if not 0.0 <= at < len(self._grid) - 1:
            sample = self.plan.at(t)
            return [*sample.pose[0].tolist(), *sample.twist[0].tolist()]
        row = int(at)
        begin, end = self._grid[row : row + 2].tolist()
        return [a + (at - row) * (b - a) for a, b in zip(begin, end, strict=True)]

    def _follow(self, executor: Any) -> int:
        """Spin until the end of the profile and its tail."""
        seen = time.monotonic()

        def over() -> bool:
            nonlocal seen
            if not self._on_clock or self.count_publishers("/clock"):
                seen = time.monotonic()
            return self.finished or time.monotonic() - seen > CLOCK_LOST

        if not self._spin(executor, over):
            self.get_logger().warning("ended by a signal before the profile was over: who follows it will stop")
            return 128 + self._asked[0]
        if not self.finished:
            self.get_logger().error("/clock is gone before the profile was over: the simulator has ended")
            return 1
        self.get_logger().info(f"{self.plan.manoeuvre.name} is over")
        return 0


def _grid(plan: Plan) -> NDArray[np.float64]:
    """Planned x, y, yaw, speed and yaw rate each `GRID` seconds, shape (n, 5)."""
    sample = plan.at(np.arange(0.0, plan.duration, GRID))
    return np.column_stack([sample.pose, sample.twist])


def followers(node: Node, topic: str) -> int:
    """Return how many nodes listen to a profile and publish a JointState.

    Whoever turns motors says what they do; a recorder or a viewer listens and says nothing.
    """
    count = 0
    for info in node.get_subscriptions_info_by_topic(topic):
        if not info.node_namespace.startswith("/"):  # rclpy's "unknown": not discovered in full yet
            continue
        try:
            published = node.get_publisher_names_and_types_by_node(info.node_name, info.node_namespace)
        except NodeNameNonExistentError:
            continue
        count += any("sensor_msgs/msg/JointState" in types for _, types in published)
    return count
