"""What was held up on its way counts as old as it is, whatever two machines' clocks say."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed; run `make setup`, or source a ROS 2 Jazzy")

from geometry_msgs.msg import Twist
from hypothesis import given
from hypothesis import strategies as st
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import JointState

from artibot_sim.nodes.common.arbiter import TOPICS, CommandSource, Rules
from artibot_sim.nodes.common.inputs import MEMORY, CommandInputs, Lateness
from ros_helpers import spin_until

MS = 1_000_000
RULES = Rules(metres_per_radian=0.2 / 47.64, track=0.72)
KNOT = 10 * MS

ways = st.lists(st.integers(0, 3000), min_size=1, max_size=40)
"""Of messages that are sent every 20 ms: how long each takes, ms."""


def late(ways_ms: list[int], apart_ns: int = 0) -> list[float]:
    """What messages that take so long are late by, s; the sender's clock is `apart_ns` behind."""
    lateness, found = Lateness(), []
    for number, way in enumerate(ways_ms):
        sent = 1_700_000_000_000 * MS + 20 * number * MS
        found.append(lateness.of(sent - apart_ns, sent + way * MS, 0.02 * number))
    return found


@given(ways, st.integers(-(10**12), 10**12))
def test_clocks_need_not_agree(ways_ms: list[int], apart_ns: int) -> None:
    assert late(ways_ms, apart_ns) == pytest.approx(late(ways_ms), abs=1e-9)


@given(ways)
def test_a_message_is_late_by_what_the_fastest_before_it_was_not(ways_ms: list[int]) -> None:
    for number, found in enumerate(late(ways_ms)):
        assert found == pytest.approx(1e-3 * (ways_ms[number] - min(ways_ms[: number + 1])))


def test_an_old_fastest_one_is_forgotten() -> None:
    """Clocks drift, and are set: after a while the way of today is what counts."""
    lateness = Lateness()
    period, found = 0.5, []
    for number in range(round(3 * MEMORY / period)):
        now = number * period
        found.append(lateness.of(0, round((now > 1.0) * 200) * MS, now))
    assert max(found) == pytest.approx(0.2)
    assert found[-1] == 0.0
    kept = [number * period for number, seconds in enumerate(found) if seconds]
    assert MEMORY - 1.0 <= kept[-1] <= 2.0 * MEMORY + period


def test_after_a_long_silence_nothing_is_late() -> None:
    lateness = Lateness()
    assert lateness.of(0, 5 * MS, 0.0) == 0.0
    assert lateness.of(0, 900 * MS, 2.0 * MEMORY + 1.0) == 0.0


@pytest.fixture
def ear(ros_context: Context) -> Iterator[Node]:
    node = Node("ear", context=ros_context)
    yield node
    node.destroy_node()


def sender(node: Node, source: CommandSource) -> Callable[[], None]:
    """A function that publishes one command that asks for motion."""
    kind = JointState if source is CommandSource.LIVE else Twist
    publisher = node.create_publisher(kind, TOPICS[source], qos_profile_sensor_data)
    spin_until(node, lambda: publisher.get_subscription_count() > 0, 10.0)
    message = kind()
    if source is CommandSource.LIVE:
        message.name, message.velocity = ["front_right", "front_left"], [60.0, 40.0]
    else:
        message.linear.x = 0.3
    return lambda: publisher.publish(message)


def decided(inputs: CommandInputs) -> CommandSource:
    """Who rules now."""
    inputs.take()
    return inputs.decide(KNOT).source


def follows(inputs: CommandInputs, source: CommandSource, send: Callable[[], None]) -> bool:
    """Whether what comes in time is followed, at the latest after some seconds."""
    deadline = time.monotonic() + 10.0
    while time.monotonic() < deadline:
        send()
        time.sleep(0.005)
        if decided(inputs) is source:
            return True
    return False


@pytest.mark.parametrize("source", [CommandSource.LIVE, CommandSource.CMD_VEL])
@pytest.mark.parametrize("aged", [True, False])
def test_what_waited_longer_than_the_timeout_moves_nothing(ear: Node, source: CommandSource, aged: bool) -> None:
    """A real message in a real queue: it was sent, and is heard only when a timeout is over."""
    inputs = CommandInputs(ear, RULES, stamped=False, aged=aged)
    wait = 0.1 + (RULES.command_timeout if source is CommandSource.LIVE else RULES.cmd_vel_timeout)
    send = sender(ear, source)
    assert follows(inputs, source, send)
    send()
    time.sleep(wait)
    assert decided(inputs) is (CommandSource.NONE if aged else source)
    assert inputs.latest >= wait - 0.05 if aged else inputs.latest == 0.0
    assert follows(inputs, source, send)
    inputs.drop((0.0, 0.0))
    assert inputs.latest == 0.0
