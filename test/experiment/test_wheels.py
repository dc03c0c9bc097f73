"""Recordings of other robots: wheels, poses and topics under other names become those of the same recording."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from bag_helpers import joint_state
from click.testing import CliRunner

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment import BagWriter, open_recording, read_bag, write_channels
from artibot_sim.experiment.inputs import rotations
from artibot_sim.experiment.messages import message_class, serialize
from artibot_sim.experiment.wheels import detected_sides, parse_joints
from artibot_sim.model import load_robot

T = np.arange(0.0, 3.0, 0.02)
STAMPS = np.round((1000.0 + T) * 1e9).astype(np.int64)
RIGHT, LEFT = 2.0 + np.sin(T), 1.5 + np.cos(T)
POSE = {"x": 0.3 * T, "y": 0.1 * T**2, "yaw": 0.2 * T}
ROBOT = load_robot("husky")


def wheels(**columns: np.ndarray) -> dict[str, np.ndarray]:
    return {f"{name}.velocity": values for name, values in columns.items()}


def bag(folder: Path, name: str = "run", **channels: dict[str, np.ndarray]) -> Path:
    return write_channels(folder / name, {key: (STAMPS, columns) for key, columns in channels.items()})


def test_wheels_are_known_by_their_names_and_each_side_is_their_mean(tmp_path: Path) -> None:
    columns = wheels(
        front_left_wheel_joint=LEFT + 0.1, rear_left_wheel_joint=LEFT - 0.1,
        front_right_wheel_joint=RIGHT, rear_right_wheel_joint=RIGHT,
    )  # fmt: skip
    found = read_bag(bag(tmp_path, joint_states=columns, ground_truth_odom=POSE))
    motors = found.require("motor_torques", "front_right.velocity", "front_left.velocity")
    np.testing.assert_allclose(motors["front_left.velocity"], LEFT, atol=1e-12)
    np.testing.assert_allclose(motors["front_right.velocity"], RIGHT, atol=1e-12)
    assert any("rear_left_wheel_joint" in remark for remark in found.remarks)


def test_a_joint_that_is_named_goes_before_what_names_say_and_must_be_there(tmp_path: Path) -> None:
    path = bag(tmp_path, joint_states=wheels(left_wheel=RIGHT, right_wheel=LEFT), ground_truth_odom=POSE)
    given = parse_joints(["front_right=left_wheel", "front_left=right_wheel"])
    motors = read_bag(path, joints=given).require("motor_torques")
    np.testing.assert_allclose(motors["front_right.velocity"], RIGHT)
    with pytest.raises(ArtibotError, match=r"front_right=wheel: no such joint; the recording has left_wheel, right_"):
        read_bag(path, joints=parse_joints(["front_right=wheel"]))
    with pytest.raises(ArtibotError, match="expected one of front_right"):
        parse_joints(["right=left_wheel"])


@pytest.mark.parametrize(
    ("names", "right"),
    [
        (["wheel_left", "wheel_right"], ("wheel_right",)),
        (["leftWheelJoint", "rightWheelJoint"], ("rightWheelJoint",)),
        (["left_wheel", "left_steering_wheel", "right_wheel", "right_steering_wheel"], ("right_wheel",)),
        (["left_arm", "right_arm"], None),
        (["left_wheel", "front_right_wheel", "rear_right_wheel"], None),
        ([f"{a}_{s}_{b}_wheel" for a in ("front", "back") for s in ("right", "left") for b in ("front", "back")], None),
    ],
)  # fmt: skip
def test_only_names_that_are_clear_are_taken_for_wheels(names: list[str], right: tuple[str, ...] | None) -> None:
    assert detected_sides(names).get("front_right") == right


def test_wheels_of_artibots_own_recordings_stay_as_they_are(tmp_path: Path) -> None:
    columns = wheels(front_right=RIGHT, front_left=LEFT)
    path = bag(tmp_path, motor_torques=columns, joint_states=wheels(left_wheel=LEFT, right_wheel=LEFT))
    found = read_bag(path)
    assert set(found.channels["motor_torques"].columns) == set(columns)
    assert not found.remarks


def test_an_odometry_gives_back_the_wheels_that_made_it(tmp_path: Path) -> None:
    rolled = ROBOT.wheel.r_w * ROBOT.drive.front.tau
    twist = {"vx": rolled * (RIGHT + LEFT) / 2, "yaw_rate": rolled * (RIGHT - LEFT) / ROBOT.front.i_y}
    path = bag(tmp_path, odom={**POSE, **twist}, ground_truth_odom=POSE)
    motors = open_recording(path, ROBOT).require("motor_torques")
    np.testing.assert_allclose(motors["front_right.velocity"], RIGHT, atol=1e-9)
    np.testing.assert_allclose(motors["front_left.velocity"], LEFT, atol=1e-9)
    assert "motor_torques" not in open_recording(path, load_robot("agriq")).channels


def transforms(folder: Path, links: dict[tuple[str, str], tuple[float, float, float]], moving: tuple[str, str]) -> Path:
    """A bag with wheels and `/tf`: links that stand, published once, and one that moves as POSE does."""
    stamp, header = message_class("builtin_interfaces/msg/Time"), message_class("std_msgs/msg/Header")
    vector, turn = message_class("geometry_msgs/msg/Vector3"), message_class("geometry_msgs/msg/Quaternion")
    shift = message_class("geometry_msgs/msg/Transform")
    stamped = message_class("geometry_msgs/msg/TransformStamped")

    def link(ns: int, names: tuple[str, str], x: float, y: float, yaw: float) -> object:
        at = header(stamp=stamp(sec=ns // 10**9, nanosec=ns % 10**9), frame_id=names[0])
        half = turn(x=0.0, y=0.0, z=float(np.sin(yaw / 2)), w=float(np.cos(yaw / 2)))
        return stamped(header=at, child_frame_id=names[1], transform=shift(vector(x=x, y=y, z=0.0), half))

    path = folder / "tf"
    with BagWriter(path) as writer:
        writer.register("/tf", "tf2_msgs/msg/TFMessage")
        for row, ns in enumerate(STAMPS.tolist()):
            sent = [link(ns, moving, *(float(POSE[name][row]) for name in ("x", "y", "yaw")))]
            sent += [link(ns, names, *where) for names, where in links.items()] if row == 0 else []
            writer.write("/tf", serialize("tf2_msgs/msg/TFMessage", transforms=sent), ns, ns)
    return path


def test_transforms_are_a_pose_where_they_lead_from_a_map_to_the_rover(tmp_path: Path) -> None:
    path = transforms(tmp_path, {("map", "odom"): (1.0, 2.0, np.pi / 2)}, ("odom", "base_link"))
    found = read_bag(path, {"/ground_truth/odom": "/tf"}).require("ground_truth_odom", "x", "y", "yaw")
    np.testing.assert_allclose(found["x"], 1.0 - POSE["y"], atol=1e-9)
    np.testing.assert_allclose(found["y"], 2.0 + POSE["x"], atol=1e-9)
    np.testing.assert_allclose(found["yaw"], np.pi / 2 + POSE["yaw"], atol=1e-9)


def test_transforms_without_a_map_are_what_the_rover_believes_and_no_pose(tmp_path: Path) -> None:
    path = transforms(tmp_path, {}, ("odom", "base_link"))
    with pytest.raises(ArtibotError, match="no chain from map or world to base_link"):
        read_bag(path, {"/ground_truth/odom": "/tf"})


def test_a_topic_that_was_given_is_not_asked_for_again(tmp_path: Path) -> None:
    path = tmp_path / "empty"
    with BagWriter(path) as writer:
        writer.register("/lidar", "nav_msgs/msg/Odometry")
        writer.register("/clock", "rosgraph_msgs/msg/Clock")
        five = message_class("builtin_interfaces/msg/Time")(5, 0)
        writer.write("/clock", serialize("rosgraph_msgs/msg/Clock", clock=five), 5, 5)
    with pytest.raises(ArtibotError, match="there is no message on /lidar") as said:
        read_bag(path, {"/ground_truth/odom": "/lidar"})
    assert "WANTED" not in str(said.value)


@pytest.mark.parametrize(
    ("wanted", "found", "said"),
    [
        ("/motor_torques", "/ground_truth/odom", "is of type nav_msgs/msg/Odometry; artibot reads /motor_torques as"),
        (
            "/ground_truth/odom",
            "/motor_torques",
            "is of type sensor_msgs/msg/JointState; artibot reads /ground_truth/odom",
        ),
        ("/imu/data", "/motor_torques", "is of type sensor_msgs/msg/JointState; artibot reads /imu/data as"),
    ],
)
def test_a_topic_of_another_type_is_called_that(tmp_path: Path, wanted: str, found: str, said: str) -> None:
    """Both types are read, each as something else: the message names them, and asks for no other topic."""
    path = bag(tmp_path, motor_torques=wheels(front_right=RIGHT, front_left=LEFT), ground_truth_odom=POSE)
    with pytest.raises(ArtibotError, match=said) as refused:
        read_bag(path, {wanted: found})
    assert "WANTED" not in str(refused.value) and "=FOUND" not in str(refused.value)


def test_motors_without_any_value_are_said_to_have_nothing(tmp_path: Path) -> None:
    path = tmp_path / "empty"
    with BagWriter(path) as writer:
        writer.register("/motor_torques", "sensor_msgs/msg/JointState")
        for stamp in STAMPS.tolist():
            writer.write("/motor_torques", joint_state(stamp, ["a", "b"]), stamp, stamp)
    with pytest.raises(ArtibotError, match="nor velocity of front_right; it has nothing; name the wheels with --joint"):
        rotations(read_bag(path), ROBOT, 0.0, 1.0)


def test_names_kept_with_a_recording_are_used_until_an_option_says_otherwise(tmp_path: Path) -> None:
    path = bag(tmp_path, joint_states=wheels(a=RIGHT, b=LEFT, c=LEFT), ground_truth_odom=POSE)
    (path / "names.yaml").write_text("joints: {front_right: a, front_left: [b, c]}\n")
    motors = open_recording(path, ROBOT).require("motor_torques")
    np.testing.assert_allclose(motors["front_left.velocity"], LEFT)
    other = open_recording(path, ROBOT, joints=["front_left=a"]).require("motor_torques")
    np.testing.assert_allclose(other["front_left.velocity"], RIGHT)
    (path / "names.yaml").write_text("wheels: {front_right: a}\n")
    with pytest.raises(ArtibotError, match=r"names\.yaml: expected a mapping with topics, joints, namespace"):
        open_recording(path, ROBOT)


def test_the_command_takes_joints(tmp_path: Path) -> None:
    from artibot_sim.cli.check import command

    path = bag(tmp_path, joint_states=wheels(a=RIGHT, b=LEFT), ground_truth_odom=POSE)
    given = [str(path), "--robot", "husky", "--joint", "front_right=a", "--joint", "front_left=b"]
    found = CliRunner().invoke(command, given)
    assert not isinstance(found.exception, ArtibotError), found.exception
