"""Messages that are serialised once: what is published is as long as what the middleware itself would send."""

from __future__ import annotations

import numpy as np
import pytest
from rclpy.serialization import deserialize_message
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import JointState

from artibot_sim.nodes.common.prepared import PreparedMessage

NAMES = ["front_right", "front_left", "x"]
STORE = get_typestore(Stores.ROS2_JAZZY)


class Published:
    """Keeps what is published."""

    def publish(self, data: bytes) -> None:
        """Keep it."""
        self.data = data


@pytest.mark.parametrize(
    "filled", [("position", "velocity"), ("velocity", "effort"), ("position",), ("velocity",), ("position", "effort")]
)
def test_a_prepared_message_has_its_numbers_and_nothing_behind_them(filled: tuple[str, ...]) -> None:
    """Sequences that stay empty are part of it; a reader of recordings refuses a byte too many."""
    published = Published()
    message = JointState(name=NAMES, **{name: [0.0] * 3 for name in filled})
    prepared = PreparedMessage(published, message)
    for i, name in enumerate(filled):
        prepared.numbers(name, 3)[:] = [i + 0.1, i + 0.2, i + 0.3]
    prepared.publish(3_000_000_004)
    read = STORE.deserialize_cdr(published.data, "sensor_msgs/msg/JointState")
    assert len(STORE.serialize_cdr(read, "sensor_msgs/msg/JointState")) == len(published.data)
    received = deserialize_message(published.data, JointState)
    assert (received.header.stamp.sec, received.header.stamp.nanosec) == (3, 4) and received.name == NAMES
    for name in ("position", "velocity", "effort"):
        numbers = [filled.index(name) + tenth for tenth in (0.1, 0.2, 0.3)] if name in filled else []
        np.testing.assert_array_equal(getattr(received, name), numbers)
