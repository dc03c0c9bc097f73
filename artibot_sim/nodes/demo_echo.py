"""Listening to a replay: is what comes what was recorded, byte by byte?"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from artibot_sim.experiment import bag_info, iter_messages
from artibot_sim.nodes.replay_selection import Wish, select


class Echo:
    """Takes what a replay publishes and compares it with the recording.

    Parameters
    ----------
    node : rclpy Node
    recording : Path
    """

    def __init__(self, node: Any, recording: Path) -> None:
        from artibot_sim.nodes.record_types import import_message
        from artibot_sim.nodes.replay_publishers import recorded_qos

        info = bag_info(recording)
        topics = select(info, Wish(), node.resolve_topic_name).names
        self.recorded: dict[str, list[bytes]] = {topic: [] for topic in topics}
        for message in iter_messages(recording, topics):
            self.recorded[message.channel.topic].append(message.data)
        self.heard: dict[str, list[bytes]] = {topic: [] for topic in topics}
        self._subscriptions = {}
        for topic, name in topics.items():
            channels = [channel for channel in info.channels if channel.topic == topic]
            qos = recorded_qos(channels)
            qos.depth = 1 + len(self.recorded[topic])  # nothing may be lost
            ros_type = import_message(channels[0].ros_type)
            self._subscriptions[topic] = node.create_subscription(ros_type, name, _unused, qos, raw=True)

    def take(self) -> None:
        """Take what has come."""
        for topic, subscription in self._subscriptions.items():
            while (taken := subscription.handle.take_message(subscription.msg_type, True)) is not None:
                self.heard[topic].append(bytes(taken[0]))

    @property
    def count(self) -> int:
        """How many messages were heard."""
        return sum(map(len, self.heard.values()))

    @property
    def expected(self) -> int:
        """How many there are to hear."""
        return sum(map(len, self.recorded.values()))

    def difference(self) -> str:
        """Return where the replay differs from the recording, empty if it does not."""
        for topic, recorded in self.recorded.items():
            heard = self.heard[topic]
            if len(heard) != len(recorded):
                return f"{topic}: {len(recorded)} messages were recorded, {len(heard)} came again"
            for i, (one, other) in enumerate(zip(recorded, heard, strict=True)):
                if one != other:
                    return f"{topic}: message {i + 1} of {len(recorded)} came again with other content"
        return ""


@contextlib.contextmanager
def listening(recording: Path, domain: int) -> Iterator[Echo]:
    """A node in `domain` that listens for a replay of `recording`."""
    import rclpy
    from rclpy.context import Context
    from rclpy.signals import SignalHandlerOptions

    context = Context()
    rclpy.init(context=context, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = rclpy.create_node("demo", context=context, start_parameter_services=False, enable_rosout=False)
        yield Echo(node, recording)
        node.destroy_node()
    finally:
        rclpy.try_shutdown(context=context)


def _unused(_message: bytes) -> None:
    """Stand in for a callback: the subscriptions are emptied by hand."""
