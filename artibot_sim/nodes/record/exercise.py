"""Messages to record, at rising rates, for benchmarks.

``python -m artibot_sim.nodes.record.exercise SECONDS RATE…`` publishes motors' states on four topics below /bench/ once
somebody subscribes to all of them, at each rate (messages a second, all topics together) for so many seconds. A
message's stamp says which rate it belongs to (sec) and its number (nanosec). Prints as JSON how many went out at each
rate, and how long that took.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Sequence
from typing import Any

from artibot_sim.errors import ArtibotError
from artibot_sim.model import MOTORS
from artibot_sim.nodes.common.process import destroyed, ros_process

TOPICS = tuple(f"/bench/motors_{i}" for i in range(4))
DEPTH = 1000
"""Messages that a publisher keeps for those who have not got them yet."""

PATIENCE = 60.0
"""Somebody who listens is waited for so long, s."""

TICK = 1e-3
"""Messages go out in bunches so far apart, s."""


def messages(stage: int, count: int) -> list[bytes]:
    """So many states of four motors, encoded."""
    from builtin_interfaces.msg import Time
    from rclpy.serialization import serialize_message
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Header

    state = JointState(name=list(MOTORS), position=[1.0] * 4, velocity=[2.0] * 4, effort=[3.0] * 4)
    encoded = []
    for number in range(count):
        state.header = Header(stamp=Time(sec=stage, nanosec=number), frame_id="base_link")
        encoded.append(serialize_message(state))
    return encoded


def publish(publishers: Sequence[Any], encoded: Sequence[bytes], rate: float) -> float:
    """Publish in turns at `rate` (1/s), as fast as it goes where that is slower; return how long it took, s."""
    begin, sent = time.monotonic(), 0
    while sent < len(encoded):
        due = min(int((time.monotonic() - begin) * rate) + 1, len(encoded))
        for number in range(sent, due):
            publishers[number % len(publishers)].publish(encoded[number])
        sent = due
        time.sleep(TICK)
    return time.monotonic() - begin


def exercise(node: Any, seconds: float, rates: Sequence[float]) -> list[dict[str, float]]:
    """All rates in turn."""
    from rclpy.qos import QoSProfile, ReliabilityPolicy
    from sensor_msgs.msg import JointState

    qos = QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.RELIABLE)
    publishers = [node.create_publisher(JointState, topic, qos) for topic in TOPICS]
    stages = [messages(stage, round(rate * seconds)) for stage, rate in enumerate(rates)]
    deadline = time.monotonic() + PATIENCE
    while not all(publisher.get_subscription_count() for publisher in publishers):
        if time.monotonic() > deadline:
            raise ArtibotError(f"exercise: nobody listens within {PATIENCE:g} s")
        time.sleep(0.05)
    time.sleep(0.5)
    found = []
    for rate, encoded in zip(rates, stages, strict=True):
        took = publish(publishers, encoded, rate)
        found.append({"rate": rate, "sent": len(encoded), "seconds": took})
        time.sleep(0.5)
    return found


def main() -> int:
    """Run, and print what was sent."""
    import rclpy

    with ros_process("exercise", ()), destroyed(rclpy.create_node("exercise")) as node:
        print(json.dumps(exercise(node, float(sys.argv[1]), [float(rate) for rate in sys.argv[2:]])), flush=True)
        time.sleep(1.0)  # what was sent last is still on its way to those who listen
    return 0


if __name__ == "__main__":
    sys.exit(main())
