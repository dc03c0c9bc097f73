"""Which topics a replay publishes: decided without ROS."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment import BagInfo, ChannelInfo
from artibot_sim.nodes.common.stamps import stamp_of, with_stamp
from artibot_sim.nodes.replay.selection import INPUTS, Wish, moves_a_rover, select
from artibot_sim.nodes.replay.source import GAP_NS, PlayedSpan, RecordedTime

TYPES = {
    "/planned/front_velocity": "trajectory_msgs/msg/JointTrajectory",
    "/motor_command_request": "sensor_msgs/msg/JointState",
    "/cmd_vel": "geometry_msgs/msg/TwistStamped",
    "/motor_command": "sensor_msgs/msg/JointState",
    "/planned/odom": "nav_msgs/msg/Odometry",
    "/planned/path": "nav_msgs/msg/Path",
    "/odom": "nav_msgs/msg/Odometry",
    "/clock": "rosgraph_msgs/msg/Clock",
    "/rosout": "rcl_interfaces/msg/Log",
    "/gps/velocity": "geometry_msgs/msg/TwistStamped",
}


def info(prefix: str = "", encoding: str = "cdr") -> BagInfo:
    channels = tuple(ChannelInfo(prefix + t, kind, "", "", "", "", encoding, 1) for t, kind in TYPES.items())
    return BagInfo(Path("run"), (), channels, {}, 0, 10**9, len(channels))


def absolute(name: str) -> str:
    return name if name.startswith("/") else f"/{name}"


@pytest.mark.parametrize("prefix", ["", "/rover1", "/fleet/rover_2"])
def test_inputs_stay_out_in_any_namespace(prefix: str) -> None:
    chosen = select(info(prefix), Wish(), absolute)
    published = {absolute(name).removeprefix(prefix) for name in chosen.names.values()}
    hidden = {"/clock", "/rosout"} if not prefix else set()  # those of a namespace are nobody's own
    assert published == set(TYPES) - {f"/{name}" for name in INPUTS} - hidden
    assert set(chosen.left_out) == {f"{prefix}/{name}" for name in INPUTS}


@given(st.sampled_from(sorted(TYPES)), st.sampled_from(INPUTS), st.sampled_from(["", "/a", "/a/b"]))
def test_no_name_makes_an_input_of_a_recorded_topic(topic: str, target: str, prefix: str) -> None:
    wish = Wish(remap=[f"{topic}:={prefix}/{target}"])
    if topic in ("/clock", "/rosout"):
        assert topic not in select(info(), wish, absolute).names
        return
    with pytest.raises(ArtibotError, match=r"--drive"):
        select(info(), wish, absolute)


def test_driving_publishes_inputs_and_what_is_named() -> None:
    assert set(select(info(), Wish(drive=True), absolute).names) == {
        "/planned/front_velocity",
        "/cmd_vel",
        "/planned/path",
    }
    named = select(info(), Wish(["odom", "motor_command_request", "/planned/*"], drive=True), absolute).names
    assert set(named) == {"/planned/front_velocity", "/cmd_vel", "/planned/path", "/odom", "/motor_command_request"}


@pytest.mark.parametrize(
    ("topic", "kind"),
    [
        ("/husky_velocity_controller/cmd_vel_unstamped", "geometry_msgs/msg/Twist"),
        ("/arm_controller/joint_trajectory", "trajectory_msgs/msg/JointTrajectory"),
        ("/can0/tx", "can_msgs/msg/Frame"),
        ("/drive", "ackermann_msgs/msg/AckermannDriveStamped"),
        ("/wheel/speed_command", "std_msgs/msg/Float64"),
    ],
)
def test_commands_of_other_robots_move_them_too(topic: str, kind: str) -> None:
    assert moves_a_rover(topic, kind)


def test_messages_that_are_no_cdr_are_named() -> None:
    assert set(select(info(encoding="json"), Wish(), absolute).unread.values()) == {"json"}


@given(st.integers(0, 2**31 * 10**9 - 1), st.binary(max_size=40))
def test_a_stamp_is_all_that_changes(stamp: int, rest: bytes) -> None:
    data = b"\x00\x01\x00\x00" + b"\xff" * 8 + rest
    changed = with_stamp(data, stamp)
    assert stamp_of(changed) == stamp
    assert changed[:4] + changed[12:] == data[:4] + data[12:]


@given(st.integers(1, 10**10), st.lists(st.integers(0, 10**11), min_size=2, max_size=20))
def test_the_time_of_the_recording_never_goes_back(length: int, instants: list[int]) -> None:
    stretch = PlayedSpan(5, 5 + length)
    time = RecordedTime(Path("run"), stretch, has_clock=False)
    times = [time.at(since) for since in sorted(instants)]
    assert times == sorted(times)
    assert time.at(0) == 5
    assert time.at(stretch.period_ns) == 5 + length + GAP_NS


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (["--stats", "nowhere/stats.json"], "--stats nowhere/stats.json: cannot be written: there is no"),
        (["--resimulate", "rotations", "--out", "."], "metrics.json: exists already"),
    ],
)
def test_what_cannot_be_written_is_refused_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], args: list[str], said: str
) -> None:
    from artibot_sim.cli import main

    monkeypatch.chdir(tmp_path)
    (tmp_path / "metrics.json").touch()
    assert main(["replay", "there is no recording", *args]) == 2
    assert said in capfd.readouterr().err
