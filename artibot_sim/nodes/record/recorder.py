"""Recording: topics found as they appear, messages taken as bytes, written by a thread of their own."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from fnmatch import filter as filter_names
from fnmatch import fnmatchcase
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment.topics import GLOBAL, TOPICS, Qos
from artibot_sim.experiment.writer import BagWriter
from artibot_sim.nodes.common.message_types import describe, import_message, qos_dict
from artibot_sim.nodes.common.qos import subscription

POLL_PERIOD = 0.02
"""s between visits to the subscriptions; messages carry the middleware's time of reception meanwhile."""
DISCOVERY_PERIOD = 0.2
DEPTH = 2000
"""Messages that the middleware may hold between two visits, and over a hiccup of the machine."""

FOR_VIEWERS = ("robot_description", "/tf", "/tf_static", "tf", "tf_static")
"""What RViz and Foxglove place a rover with; the last two where a namespace has transforms of its own."""


class RecordSelection:
    """Which topics to record.

    Parameters
    ----------
    patterns : names with `*` and `?`; None for the topics of the contract, and what viewers place the rover with.
    exclude : patterns of what to leave out.
    everything : record all that is not hidden.
    resolve : turns a relative name into the one on the graph (namespace, remapping).

    Attributes
    ----------
    requested : the patterns that somebody gave, as they are looked for; none where they are the contract's.
    """

    def __init__(
        self,
        patterns: Sequence[str] | None,
        exclude: Sequence[str],
        everything: bool,
        resolve: Callable[[str], str],
    ) -> None:
        # a namespace moves relative names only; /clock and its like stay what they are in any
        usual = [topic.name if topic.name in GLOBAL else topic.name.lstrip("/") for topic in TOPICS]

        def found(name: str) -> str:
            if not set(name) & set("*?"):
                return resolve(name)
            # ROS resolves no pattern: a relative one stands where a relative name would
            return name if name.startswith(("/", "*")) else resolve("any").removesuffix("any") + name

        self.patterns = [found(name) for name in patterns or (*usual, *FOR_VIEWERS)]
        self.requested = self.patterns if patterns else []
        self.exclude = list(exclude)
        self.everything = everything

    def __contains__(self, topic: str) -> bool:
        if any(fnmatchcase(topic, pattern) or topic == f"/{pattern}" for pattern in self.exclude):
            return False
        if self.everything:
            return not any(part.startswith("_") for part in topic.split("/"))
        return any(fnmatchcase(topic, pattern) for pattern in self.patterns)


class Recorder:
    """Takes messages of the selected topics and writes them to a bag.

    Parameters
    ----------
    node : the ROS node that subscribes; nothing else needs to spin it.
    bag : where to write; closed by `close`.
    selection : which topics.

    Notes
    -----
    Subscriptions are visited every 20 ms and emptied, without an executor: rebuilding a wait set for each
    message costs more than taking it. Nothing is deserialised. Writing happens on a thread, so a slow disk
    delays no reception.
    """

    def __init__(self, node: Node, bag: BagWriter, selection: RecordSelection) -> None:
        self.node = node
        self.bag = bag
        self.selection = selection
        self._polled = self._put = 0
        self._with_messages: set[str] = set()
        self._others: set[str] = set()
        self.failure: ArtibotError | None = None
        self._subscriptions: dict[str, Any] = {}
        self._demands: dict[str, tuple[bool, bool]] = {}
        self._refused: set[str] = set()
        self._left_out: dict[str, str] = {}
        self._queue: deque[tuple[str, bytes, int, int, int | None]] = deque()
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._write, name="bag writer", daemon=True)
        self._thread.start()

    @property
    def taken(self) -> int:
        """Messages taken so far."""
        return self._polled + self._put

    @property
    def topics(self) -> list[str]:
        """Topics subscribed to and those that come another way, sorted."""
        return sorted({*self._subscriptions, *self._others})

    @property
    def without_messages(self) -> list[str]:
        """Requested names and patterns that brought no message."""
        return [each for each in self.selection.requested if not filter_names(self._with_messages, each)]

    @property
    def waiting(self) -> int:
        """Messages taken and not written yet."""
        return len(self._queue)

    def add(self, topic: str, ros_type: str, qos: Qos, why: str) -> None:
        """Announce a topic whose messages are `put`; if it is published too, that is left out and `why` said."""
        self.bag.register(topic, ros_type, qos)
        self._others.add(topic)
        self._left_out[topic] = why

    def put(self, topic: str, data: bytes, stamp_ns: int) -> None:
        """Take a message that came another way than over ROS; for one thread."""
        self._queue.append((topic, data, stamp_ns, stamp_ns, None))
        self._with_messages.add(topic)
        self._put += 1

    def discover(self) -> None:
        """Subscribe to selected topics that have appeared; adapt to publishers that have joined."""
        for topic, _ in self.node.get_topic_names_and_types():
            if topic not in self.selection or topic in self._refused:
                continue
            publishers = self.node.get_publishers_info_by_topic(topic)
            if not publishers:
                continue
            if topic in self._left_out:
                self._refuse(topic, f"is not subscribed to: {self._left_out[topic]}")
                continue
            types = sorted({each.topic_type for each in publishers})  # what others subscribe with is no matter
            if len(types) != 1:
                self._refuse(topic, f"is published with several types ({', '.join(types)})")
                continue
            demand = _demand(publishers)
            known = self._demands.get(topic)
            if known is None or any(had and not wanted for had, wanted in zip(known, demand, strict=True)):
                self._subscribe(topic, types[0], publishers, demand)

    def _subscribe(self, topic: str, ros_type: str, publishers: list[Any], demand: tuple[bool, bool]) -> None:
        """Subscribe, again if a publisher came that offers less than the present subscription demands."""
        try:
            message = import_message(ros_type)
            text, type_hash = describe(ros_type, str(publishers[0].topic_type_hash))
            self.bag.register(
                topic, ros_type, [qos_dict(p.qos_profile) for p in publishers], definition=text, type_hash=type_hash
            )
        except ArtibotError as error:
            self._refuse(topic, f"cannot be recorded: {error}")
            return
        reliable, latched = demand
        profile = QoSProfile(
            history=HistoryPolicy.KEEP_LAST,
            depth=DEPTH,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        )
        former = self._subscriptions.get(topic)
        if former is not None:
            self._polled += self._empty(topic, former)
            self.node.destroy_subscription(former)
        self._subscriptions[topic] = subscription(self.node, message, topic, _unused, profile, raw=True, anew=True)
        self._demands[topic] = demand
        kind = f"{'reliable' if reliable else 'best effort'}{', latched' if latched else ''}"
        self.node.get_logger().info(f"recording {topic} [{ros_type}], {kind}")

    def _refuse(self, topic: str, why: str) -> None:
        self._refused.add(topic)
        self.node.get_logger().warning(f"{topic} {why}")

    def poll(self) -> int:
        """Take every message that has arrived; return how many."""
        count = sum(self._empty(topic, subscription) for topic, subscription in self._subscriptions.items())
        self._polled += count
        return count

    def _empty(self, topic: str, subscription: Any) -> int:
        count = 0
        while True:
            taken = subscription.handle.take_message(subscription.msg_type, True)
            if taken is None:
                if count:
                    self._with_messages.add(topic)
                return count
            data, info = taken
            now = info["received_timestamp"] or time.time_ns()
            self._queue.append((topic, bytes(data), info["source_timestamp"] or now, now, _sequence(info)))
            count += 1

    def _write(self) -> None:
        """Write what is queued until the end: the thread's body."""
        while True:
            ending = self._ending.is_set()  # looked at first: what was queued before it is still written
            while self._queue:
                topic, data, published, received, sequence = self._queue.popleft()
                try:
                    self.bag.write(topic, data, published, received, sequence)
                except ArtibotError as error:
                    self.failure = error
                    return
            if ending:
                return
            time.sleep(POLL_PERIOD)

    def close(self) -> None:
        """Take the last messages, write everything and close the bag.

        Raises
        ------
        ArtibotError
            If the bag could not be written in full.
        """
        self.poll()
        self._ending.set()
        self._thread.join()
        self.bag.close()
        if self.failure is not None:
            raise self.failure


def _unused(_message: bytes) -> None:
    """Stand in for a callback: the subscription is emptied by hand."""


def _demand(publishers: list[Any]) -> tuple[bool, bool]:
    """Return whether to demand reliability, and latched messages: only what every publisher offers.

    Never latched without reliability: who comes late gets nothing sent again then, and a subscription that takes the
    place of a latched one must not.
    """
    profiles = [publisher.qos_profile for publisher in publishers]
    reliable = all(profile.reliability == ReliabilityPolicy.RELIABLE for profile in profiles)
    return reliable, reliable and all(profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for profile in profiles)


def _sequence(info: dict[str, Any]) -> int | None:
    """Return the publisher's counter, None where the middleware has none (then it is all ones)."""
    number = info.get("publication_sequence_number")
    return number if number is not None and number < 2**63 else None
