"""Publishers of recorded bytes: type and quality of service as recorded, nothing decoded."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment.storage import BagInfo, ChannelInfo
from artibot_sim.experiment.topics import parse_qos
from artibot_sim.nodes.record_types import import_message

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
            node.create_publisher(message, name, qos),
            qos.durability == DurabilityPolicy.TRANSIENT_LOCAL,
            bool(fields) and fields[0] == "std_msgs/Header",
        )
    if names and not outlets:
        raise ArtibotError(f"{info.path}: nothing can be published: {problems[0]}")
    return outlets
