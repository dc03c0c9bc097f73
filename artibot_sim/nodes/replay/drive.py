"""Driving an experiment again: its recorded inputs with new stamps, and the planner's sign of life."""

from __future__ import annotations

import time
from bisect import bisect_right
from collections import Counter
from dataclasses import dataclass
from typing import Any

from nav_msgs.msg import Odometry, Path
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment.storage import BagInfo, RawMessage, iter_messages
from artibot_sim.nodes.common.arbiter import SIGN_OF_LIFE
from artibot_sim.nodes.common.qos import publisher
from artibot_sim.nodes.common.stamps import SECOND, stamp_of, with_stamp
from artibot_sim.nodes.replay.player import Outlet
from artibot_sim.nodes.replay.progress import ReplayProgress
from artibot_sim.nodes.replay.selection import COMMAND, PROFILE, REQUEST, called, moves_a_rover, sibling

SIGN_PERIOD = 0.02
"""s between signs of life; the contract asks for 0.05 at most."""
TAIL = 0.5
"""How long the sign of life goes on after the end, s."""
CLOCK_LOST = 2.0
"""Without simulated time going on for this long (s, steady time) the drive ends."""
_NAP = 0.005


@dataclass(frozen=True)
class Publication:
    """Something to publish: `at` s after the drive's start (negative: before it)."""

    at: float
    outlet: Outlet
    data: bytes
    kind: str


class Script:
    """What a recording says about a drive.

    Parameters
    ----------
    info : of the recording.
    outlets : recorded topic → where its messages go.
    request : outlet for requests made from `request_from`, and that topic; None if there are none.

    Raises
    ------
    ArtibotError
        If nothing in it moves a rover.

    Attributes
    ----------
    start_ns : stamp in the recording's time at which it was begun to drive.
    events : in order.
    signs : recorded topic of a sign of life → stamps and bytes of its messages.
    length : s from the start to the last command.
    """

    def __init__(self, info: BagInfo, outlets: dict[str, Outlet], request: tuple[str, Outlet] | None) -> None:
        self.outlets = outlets
        self.request = request
        types = {channel.topic: channel.ros_type for channel in info.channels}
        life = [topic for topic in types if called(topic, SIGN_OF_LIFE) and types[topic] == "nav_msgs/msg/Odometry"]
        wanted = {*outlets, *life, *((request[0],) if request else ())}
        messages = list(iter_messages(info.path, wanted))
        signs = [m for m in messages if m.channel.topic in life]
        self.signs: dict[str, list[tuple[int, bytes]]] = {topic: [] for topic in life}
        for message in signs:
            self.signs[message.channel.topic].append((stamp_of(message.data), message.data))
        for each in self.signs.values():
            each.sort()
        driving = [m for m in messages if self._drives(m)]
        if not driving:
            has = ", ".join(sorted(topic for topic in types if called(topic, REQUEST) or called(topic, COMMAND)))
            raise ArtibotError(
                f"{info.path}: no message on {PROFILE} or cmd_vel to drive by"
                + (f"; it has {has}: ask for it with --topics or --request-from" if has else "")
            )
        profiles = [m for m in driving if types[m.channel.topic] == "trajectory_msgs/msg/JointTrajectory"]
        self.start_ns = stamp_of(profiles[0].data) if profiles else driving[0].log_ns
        self.start_log = _log_time(self.start_ns, signs) if profiles else driving[0].log_ns
        self.profiled = bool(profiles)
        self.events = sorted((event for m in messages for event in self._events(m)), key=lambda event: event.at)
        ends = [_profile_end(m.data) for m in profiles]
        last_log = max((m.log_ns for m in driving if m not in profiles), default=self.start_log)
        self.length = max([(last_log - self.start_log) / SECOND] + [(end - self.start_ns) / SECOND for end in ends])

    def _drives(self, message: RawMessage) -> bool:
        topic = message.channel.topic
        if self.request and topic == self.request[0]:
            return True
        return topic in self.outlets and moves_a_rover(topic, message.channel.ros_type)

    def _events(self, message: RawMessage) -> list[Publication]:
        """Return what becomes of a recorded message; plans at once, all else at its time."""
        topic, ros_type = message.channel.topic, message.channel.ros_type
        at = (message.log_ns - self.start_log) / SECOND
        found = []
        if topic in self.outlets:
            outlet = self.outlets[topic]
            if ros_type == "trajectory_msgs/msg/JointTrajectory":
                later = (stamp_of(message.data) - self.start_ns) / SECOND
                found.append(Publication(-1e9 if later <= 0 else at, outlet, message.data, "profile"))
            elif ros_type == "nav_msgs/msg/Path":
                found.append(Publication(-1e9, outlet, message.data, "path"))
            else:
                driving = moves_a_rover(topic, ros_type)
                found.append(Publication(at, outlet, message.data, "command" if driving else "record"))
        if self.request and topic == self.request[0]:
            found.append(Publication(at, self.request[1], message.data, "command"))
        return found

    def sign(self, topic: str, since_start: float, now_ns: int) -> bytes:
        """Return the sign of life recorded on `topic` nearest before `since_start` s, stamped `now_ns`.

        Where none was recorded, its pose is NaN: nobody knows where the rover ought to be.
        """
        signs = self.signs.get(topic)
        if signs:
            i = bisect_right(signs, self.start_ns + round(since_start * SECOND), key=lambda sign: sign[0]) - 1
            return with_stamp(signs[max(0, i)][1], now_ns)
        message = Odometry()
        message.header.frame_id, message.child_frame_id = "map", "base_link"
        where = message.pose.pose.position
        where.x = where.y = where.z = float("nan")
        return with_stamp(serialize_message(message), now_ns)


def request_outlet(node: Node, topic: str) -> Outlet:
    """Return where requests go that are made of a recorded topic: to the rover in whose namespace it is."""
    source = COMMAND if called(topic, COMMAND) else REQUEST
    name = sibling(topic, source, REQUEST).lstrip("/")
    return Outlet(publisher(node, JointState, name), latched=False, stamped=True)


def _log_time(stamp_ns: int, signs: list[RawMessage]) -> int:
    """Return the log time of a stamp, by the sign of life nearest to it; the stamp itself without any."""
    if not signs:
        return stamp_ns
    nearest = min(signs, key=lambda m: abs(stamp_of(m.data) - stamp_ns))
    return nearest.log_ns + stamp_ns - stamp_of(nearest.data)


def _profile_end(data: bytes) -> int:
    profile: Any = deserialize_message(data, JointTrajectory)
    after = profile.points[-1].time_from_start if profile.points else None
    return stamp_of(data) + (after.sec * SECOND + after.nanosec if after else 0)


def _moved_path(data: bytes, shift_ns: int) -> bytes:
    """Return a Path with all its stamps moved on."""
    path: Any = deserialize_message(data, Path)
    for header in (path.header, *(pose.header for pose in path.poses)):
        stamp = header.stamp.sec * SECOND + header.stamp.nanosec + shift_ns
        header.stamp.sec, header.stamp.nanosec = divmod(stamp, SECOND)
    return bytes(serialize_message(path))


def _signs_of_life(script: Script) -> dict[str, str]:
    """Return the recorded topic of each rover's sign of life, and the name to publish it under: beside its profile."""
    names = {
        sibling(topic, PROFILE, SIGN_OF_LIFE): sibling(outlet.publisher.topic_name, PROFILE, SIGN_OF_LIFE)
        for topic, outlet in script.outlets.items()
        if called(topic, PROFILE)
    }
    return names or {f"/{SIGN_OF_LIFE}": SIGN_OF_LIFE}


class Driver:
    """Drives by a script, in the node's time (the system's, or `/clock`'s with use_sim_time).

    Parameters
    ----------
    node : that publishes.
    script : what to publish.
    delay : s from now to the start.
    asked : grows when the process is asked to end.
    """

    def __init__(self, node: Node, script: Script, delay: float, asked: list[int]) -> None:
        self.node = node
        self.script = script
        self.delay = delay
        self.asked = asked
        self.counts: Counter[str] = Counter()
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(node)
        self._lives = {recorded: publisher(node, Odometry, name) for recorded, name in _signs_of_life(script).items()}
        self._progress = ReplayProgress(script.length)

    def wait(self, count: int, timeout: float) -> None:
        """Wait for simulated time, if that is used, and for `count` listeners to every driving topic.

        Raises
        ------
        ArtibotError
            If they do not come within `timeout` s.
        """
        deadline = time.monotonic() + timeout
        outlets = {e.outlet.publisher.topic_name: e.outlet for e in self.script.events if e.kind != "record"}
        outlets.pop(next((name for name in outlets if called(name, "planned/path")), ""), None)
        while not self.asked:
            lacking = [name for name, outlet in outlets.items() if outlet.publisher.get_subscription_count() < count]
            if self._now() > 0 and not lacking:
                return
            if time.monotonic() > deadline:
                what = f"{', '.join(lacking)}: fewer than {count} listeners" if lacking else "/clock: nothing came"
                raise ArtibotError(
                    f"{what} within {timeout:g} s; start a simulator or driver in the same ROS_DOMAIN_ID, or --wait 0"
                )
            self._executor.spin_once(timeout_sec=0.02)

    def _now(self) -> int:
        return int(self.node.get_clock().now().nanoseconds)

    def run(self) -> bool:
        """Drive to the end; return False when it ended before, asked to or without simulated time.

        While it drives, the sign of life goes on at 1/`SIGN_PERIOD` in steady time; a signal ends it at once, and a
        rover that follows the profile comes to a standstill by itself.
        """
        start_ns = self._now() + round(self.delay * SECOND)
        events, index, next_sign = self.script.events, 0, time.monotonic()
        seen_ns, seen = self._now(), time.monotonic()
        self.node.get_logger().info(f"starts at {start_ns / SECOND:.3f}, {self.script.length:.1f} s")
        while not self.asked:
            self._executor.spin_once(timeout_sec=0.0)
            now_ns, steady = self._now(), time.monotonic()
            since = (now_ns - start_ns) / SECOND
            if now_ns != seen_ns:
                seen_ns, seen = now_ns, steady
            if since > self.script.length + TAIL and index == len(events):
                break
            if steady - seen > CLOCK_LOST:
                self.node.get_logger().error("/clock stands still: the simulator has ended; no longer driving")
                return False
            if steady >= next_sign:
                for topic, life in self._lives.items():
                    life.publish(self.script.sign(topic, since, now_ns))
                next_sign = max(next_sign + SIGN_PERIOD, steady)
            while index < len(events) and events[index].at <= since:
                self._publish(events[index], now_ns, start_ns)
                index += 1
            self._progress.show(max(0.0, since), sum(self.counts.values()))
            coming = events[index].at - since if index < len(events) else _NAP
            time.sleep(max(0.0, min(_NAP, coming, next_sign - time.monotonic())))
        self._progress.end()
        return not self.asked

    def _publish(self, event: Publication, now_ns: int, start_ns: int) -> None:
        data = event.data
        if event.kind == "profile":
            data = with_stamp(data, stamp_of(data) - self.script.start_ns + start_ns)
        elif event.kind == "path":
            data = _moved_path(data, start_ns - self.script.start_ns)
        elif event.kind == "command" and event.outlet.stamped:
            data = with_stamp(data, now_ns)
        event.outlet.publisher.publish(data)
        self.counts[event.outlet.publisher.topic_name] += 1

    def close(self) -> None:
        """Leave the progress bar, and wait for what was sent last to arrive."""
        self._progress.end()
        for outlet in self.script.outlets.values():
            if not self.asked:
                outlet.publisher.wait_for_all_acked(Duration(seconds=2.0))
