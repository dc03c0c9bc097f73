"""Serialised profiles are read as ROS itself reads them, and what is none is refused."""

from __future__ import annotations

import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("rclpy", reason="rclpy is not installed; run `make setup`, or source a ROS 2 Jazzy")

from rclpy.serialization import serialize_message
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from artibot_sim.nodes.common.profile import Profile, ProfileReader, Refused, parse_profile, read_trajectory

sequences = st.lists(st.floats(allow_nan=False), max_size=3)


@st.composite
def points(draw: st.DrawFn) -> JointTrajectoryPoint:
    fields = {name: draw(sequences) for name in ("positions", "velocities", "accelerations", "effort")}
    point = JointTrajectoryPoint(**fields)
    point.time_from_start.sec = draw(st.integers(-(2**31), 2**31 - 1))
    point.time_from_start.nanosec = draw(st.integers(0, 2**32 - 1))
    return point


@st.composite
def trajectories(draw: st.DrawFn) -> JointTrajectory:
    message = JointTrajectory(joint_names=draw(st.lists(st.text(st.characters(codec="ascii", min_codepoint=1)))))
    message.header.frame_id = draw(st.sampled_from(["", "a", "map", "base_link"]))
    message.header.stamp.sec = draw(st.integers(-(2**31), 2**31 - 1))
    message.points = draw(st.lists(points(), max_size=4))
    return message


@given(trajectories())
def test_it_reads_what_ros_has_serialised(message: JointTrajectory) -> None:
    found = read_trajectory(serialize_message(message))
    assert found.joint_names == list(message.joint_names)
    assert found.header.stamp.sec == message.header.stamp.sec
    assert len(found.points) == len(message.points)
    for one, other in zip(found.points, message.points, strict=True):
        assert list(one.positions) == list(other.positions)
        assert list(one.velocities) == list(other.velocities)
        assert one.time_from_start.sec == other.time_from_start.sec
        assert one.time_from_start.nanosec == other.time_from_start.nanosec


@given(trajectories(), st.data())
def test_what_is_cut_or_garbled_is_refused_or_read_but_never_raises(
    message: JointTrajectory, data: st.DataObject
) -> None:
    whole = bytearray(serialize_message(message))
    for _ in range(data.draw(st.integers(0, 3))):
        whole[data.draw(st.integers(4, len(whole) - 1))] = data.draw(st.integers(0, 255))
    cut = bytes(whole[: data.draw(st.integers(4, len(whole)))])
    try:
        parse_profile(read_trajectory(cut))
    except Refused as reason:
        assert str(reason)


@pytest.mark.parametrize("length", range(5))
def test_next_to_nothing_is_refused(length: int) -> None:
    with pytest.raises(Refused, match="cannot be decoded"):
        read_trajectory(bytes(length))


def test_beside_a_loop_nothing_waits_for_it() -> None:
    message = JointTrajectory(joint_names=["front_right", "front_left"])
    for k in range(5000):
        point = JointTrajectoryPoint(velocities=[0.01 * k, 0.02 * k])
        point.time_from_start.sec, point.time_from_start.nanosec = divmod(10_000_000 * k, 10**9)
        message.points.append(point)
    data = serialize_message(message)
    at_once, beside = ProfileReader(beside=False), ProfileReader(beside=True)
    at_once.submit(data, 1.0)
    ((expected, received),) = at_once.results()
    assert isinstance(expected, Profile) and received == 1.0
    beside.submit(data, 2.0)
    beside.submit(data[:1000], 3.0)
    found: list = []
    deadline = time.monotonic() + 30.0
    while len(found) < 2 and time.monotonic() < deadline:
        found += beside.results()
    (first, last) = found
    assert first == (expected, 2.0)
    assert isinstance(last[0], Refused) and last[1] == 3.0
    beside.submit(data, 4.0)
    beside.drop()
    time.sleep(0.2)
    assert not list(beside.results())
