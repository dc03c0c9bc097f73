"""Publishing a recording with its own timing: recorded bytes, deadlines, `/clock`, pause and step."""

from __future__ import annotations

import time
from array import array
from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool, Trigger

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment.storage import BagInfo, ChannelInfo
from artibot_sim.experiment.topics import parse_qos
from artibot_sim.nodes.common.message_types import import_message
from artibot_sim.nodes.common.qos import publisher
from artibot_sim.nodes.common.stamps import SECOND, stamp_of, with_stamp
from artibot_sim.nodes.replay.progress import ReplayProgress
from artibot_sim.nodes.replay.source import Due, MessageSource, RecordedTime, lateness_summary

# ----------------------------------------------------------------------
# Publishers of recorded bytes: type and quality of service as recorded, nothing decoded.
# ----------------------------------------------------------------------


DEPTH = 1000
"""Messages that a publisher keeps for reliable subscribers that are slow."""


@dataclass(frozen=True)
class Outlet:
    """A publisher of one topic.

    Attributes
    ----------
    publisher : takes CDR bytes.
    latched : whether it is transient local.
    stamped : whether its messages begin with a Header.
    """

    publisher: Any
    latched: bool
    stamped: bool


def recorded_qos(channels: list[ChannelInfo]) -> QoSProfile:
    """Return what a topic's publishers offered: of several the more that each subscriber was served by."""
    offered = [parse_qos(channel.qos) for channel in channels]
    latched = all(qos.durability == "transient_local" for qos in offered)
    reliable = any(qos.reliability == "reliable" for qos in offered)
    kept = max((qos.depth for qos in offered if qos.history == "keep_last"), default=0)
    if channels[0].topic == "/tf_static":
        kept = max(kept, sum(channel.message_count for channel in channels))
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=min(DEPTH, max(kept, 1)) if latched else DEPTH,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def make_outlets(node: Node, info: BagInfo, names: dict[str, str]) -> dict[str, Outlet]:
    """Make a publisher for each topic.

    Parameters
    ----------
    node : that publishes.
    info : of the recording.
    names : topic as recorded → name to publish it under.

    Returns
    -------
    dict
        Recorded topic → outlet; topics of a type that is not installed are left out, with a warning.

    Raises
    ------
    ArtibotError
        If none is left.
    """
    outlets: dict[str, Outlet] = {}
    problems = []
    for topic, name in names.items():
        channels = [channel for channel in info.channels if channel.topic == topic]
        try:
            message: Any = import_message(channels[0].ros_type)
        except ArtibotError as error:
            problems.append(f"{topic} is left out: {error}")
            node.get_logger().warning(problems[-1])
            continue
        qos = recorded_qos(channels)
        fields = list(message.get_fields_and_field_types().values())
        outlets[topic] = Outlet(
            publisher(node, message, name, qos),
            qos.durability == DurabilityPolicy.TRANSIENT_LOCAL,
            bool(fields) and fields[0] == "std_msgs/Header",
        )
    if names and not outlets:
        raise ArtibotError(f"{info.path}: nothing can be published: {problems[0]}")
    return outlets


# ----------------------------------------------------------------------
# Publishing a recording with its own timing: deadlines on the steady clock, `/clock`, pause and step.
# ----------------------------------------------------------------------


NAP = 0.02
"""Longest sleep, s: between two of them services are served and signals seen."""
SERVICE_PERIOD = 0.02
BUSY_PERIOD = 0.2
"""So often services are served when there is no time for it between messages, s."""
DISCOVERY = 3.5
"""Participants announce themselves every 3 s (Fast DDS): whoever is there has been found by then, s."""
QUIET = 0.5
"""Discovery is over when no subscriber was found for so long, s."""
MATCHED = 0.1
"""So long the subscriber's side of a match may take after ours, s."""
ACKNOWLEDGED = 5.0
"""How long subscribers may take at the end to acknowledge what they were sent, s."""


@dataclass(frozen=True)
class PlaybackOptions:
    """How to play.

    Attributes
    ----------
    rate : recorded seconds a second.
    clock : Hz of `/clock`; 0: none.
    restamp : whether header stamps of later passes move on with `/clock`.
    paused : whether to begin paused.
    """

    rate: float = 1.0
    clock: float = 100.0
    restamp: bool = False
    paused: bool = False


class Player:
    """Plays messages of a source.

    Parameters
    ----------
    node : that publishes; has the services `~/pause` and `~/step`.
    source : messages with their due times.
    outlets : recorded topic → where its messages go.
    recorded : the time that `/clock` says.
    pace : how to play.
    asked : grows when the process is asked to end.
    """

    def __init__(
        self, node: Node, source: MessageSource, outlets: dict[str, Outlet], recorded: RecordedTime,
        pace: PlaybackOptions, asked: list[int],
    ) -> None:  # fmt: skip
        self.node = node
        self.source = source
        self.outlets = outlets
        self.recorded = recorded
        self.pace = pace
        self.asked = asked
        self.counts: Counter[str] = Counter()
        self.late = array("d")
        self._late_of = {topic: array("d") for topic in outlets}
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(node)
        self._origin = 0.0  # steady time at which the first pass began, were it never paused
        self._held: float | None = None  # s into the recording while paused
        self._steps = 0
        self._served = 0.0
        self._next_tick = 0.0
        self._last_tick = 0
        qos = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)  # serves subscribers of either kind
        self._clock = publisher(node, Clock, "/clock", qos) if pace.clock > 0 else None
        self._services = [
            node.create_service(SetBool, "~/pause", self._on_pause),
            node.create_service(Trigger, "~/step", self._on_step),
        ]
        self._progress = ReplayProgress(source.stretch.period_ns / SECOND, source.loop)

    @property
    def position(self) -> float:
        """Recorded seconds since the beginning of the first pass."""
        return self._held if self._held is not None else (time.monotonic() - self._origin) * self.pace.rate

    def wait_for_discovery(self) -> int:
        """Wait until all subscribers that are there already have been found; return how many they are, of all topics.

        One that was found at once says nothing of others: the answer to a new participant gets lost now and then, and
        the other announces itself again only after its period. So the whole period is waited for.
        """
        publishers = [outlet.publisher for outlet in self.outlets.values()]
        found, begun = -1, time.monotonic()
        changed = begun
        while not self.asked and time.monotonic() < max(begun + DISCOVERY, changed + QUIET):
            self._executor.spin_once(timeout_sec=NAP)
            if (count := sum(publisher.get_subscription_count() for publisher in publishers)) != found:
                found, changed = count, time.monotonic()
        time.sleep(MATCHED)
        return max(found, 0)

    def _lacking(self, count: int) -> list[str]:
        """Topics with fewer subscribers."""
        publishers = [outlet.publisher for outlet in self.outlets.values()]
        return sorted(p.topic_name for p in publishers if p.get_subscription_count() < count)

    def wait_for_subscribers(self, count: int, timeout: float) -> None:
        """Wait until every topic has `count` subscribers.

        Raises
        ------
        ArtibotError
            If they do not come within `timeout` seconds.
        """
        deadline = time.monotonic() + timeout
        lacked = False
        while not self.asked:
            lacking = self._lacking(count)
            if not lacking:
                time.sleep(MATCHED if lacked else 0.0)
                return
            lacked = True
            if time.monotonic() > deadline:
                raise ArtibotError(
                    f"{', '.join(lacking)}: fewer than {count} subscribers within {timeout:g} s; start them in "
                    "the same ROS_DOMAIN_ID, name fewer --topics, or do not --wait"
                )
            self._executor.spin_once(timeout_sec=NAP)

    def run(self) -> None:
        """Play to the end, or until asked to end.

        Raises
        ------
        ArtibotError
            Where the recording turns out to be damaged.
        """
        self.source.wait_ready()
        self._origin = self._next_tick = time.monotonic()
        self._held = 0.0 if self.pace.paused else None
        try:
            for due in self.source:
                if due is None:
                    self._rest(time.monotonic() + 0.002)
                elif self._wait_until(due.at_ns / SECOND):
                    self._publish(due)
                if self.asked:
                    break
            else:
                self._wait_until(self.source.stretch.period_ns / SECOND if not self.counts else 0.0)
        finally:
            self._progress.end()
            self.source.close()
            self._wait_acknowledged()

    def statistics(self) -> dict[str, Any]:
        """Return how many messages were published, by recorded topic, and how late, ms."""
        return {
            "messages": sum(self.counts.values()),
            "topics": dict(sorted(self.counts.items())),
            "rate": self.pace.rate,
            **lateness_summary(np.array(self.late)),
            "late_p99_ms_by_topic": {
                topic: 1e3 * float(np.percentile(late, 99)) for topic, late in sorted(self._late_of.items()) if late
            },
        }

    def _wait_until(self, at: float) -> bool:
        """Wait for a position in the recording; return False when asked to end before."""
        while not self.asked:
            if self._held is not None:
                if self._steps:
                    self._steps -= 1
                    self._held = max(self._held, at)
                    self._tick_if_due()
                    return True
                self._rest(time.monotonic() + NAP)
                continue
            deadline = self._origin + at / self.pace.rate
            if time.monotonic() >= deadline:
                self._tick_if_due()
                self._serve(time.monotonic(), BUSY_PERIOD)
                return self._held is None or self._wait_until(at)
            self._rest(deadline)
        return False

    def _rest(self, deadline: float) -> None:
        """Sleep until `deadline`, the next `/clock` or a nap's length, after serving services."""
        self._tick_if_due()
        now = time.monotonic()
        if deadline - now > 0.003:
            self._progress.show(self.position, sum(self.counts.values()))
            self._serve(now, SERVICE_PERIOD)
            now = time.monotonic()
        until = min(deadline, now + NAP)
        if self._clock is not None and self._held is None:
            until = min(until, self._next_tick)
        if until > now:
            time.sleep(until - now)

    def _serve(self, now: float, period: float) -> None:
        if now - self._served >= period:
            self._served = now
            self._executor.spin_once(timeout_sec=0.0)

    def _tick_if_due(self) -> None:
        """Publish the time of the recording, if it is time to and time has gone on."""
        now = time.monotonic()
        if self._clock is None or now < self._next_tick:
            return
        stamp = self.recorded.at(round(self.position * SECOND))
        if stamp > self._last_tick:
            self._last_tick = stamp
            message = Clock()
            message.clock.sec, message.clock.nanosec = divmod(stamp, SECOND)
            self._clock.publish(message)
        period = 1.0 / self.pace.clock
        self._next_tick = max(self._next_tick + period, now)

    def _publish(self, due: Due) -> None:
        topic = due.message.channel.topic
        outlet, data = self.outlets[topic], due.message.data
        if self.pace.restamp and due.pass_number and outlet.stamped:
            data = with_stamp(data, stamp_of(data) + self.recorded.shift(due.pass_number))
        outlet.publisher.publish(data)
        self.counts[topic] += 1
        if self._held is None:
            late = time.monotonic() - self._origin - due.at_ns / SECOND / self.pace.rate
            self.late.append(late)
            self._late_of[topic].append(late)

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        """Hold the recording's time, or let it go on from where it is held."""
        if request.data and self._held is None:
            self._held = self.position
        elif not request.data and self._held is not None:
            self._origin = self._next_tick = time.monotonic()
            self._origin -= self._held / self.pace.rate
            self._held, self._steps = None, 0
        response.success = True
        response.message = f"{'paused' if request.data else 'playing'} at {self.position:.3f} s"
        return response

    def _on_step(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Publish the next message, while paused."""
        response.success = self._held is not None
        if response.success:
            self._steps += 1
            response.message = "the next message is published"
        else:
            response.message = "playing; call ~/pause with data: true first"
        return response

    def _wait_acknowledged(self) -> None:
        """Give reliable subscribers the time to take what they were sent, before the publishers vanish."""
        for outlet in self.outlets.values():
            if not self.asked:
                outlet.publisher.wait_for_all_acked(Duration(seconds=ACKNOWLEDGED))
