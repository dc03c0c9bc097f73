"""`artibot inspect`: what a recording holds is said as it is, and every line of advice works when it is typed."""

from __future__ import annotations

import json
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from bag_helpers import EPOCH, JOINTS, ODOMETRY, ROOT, foreign, joint_state, odometry
from report_helpers import recording
from rosbags.rosbag1 import Writer as Rosbag1
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from artibot_sim.cli import main
from artibot_sim.errors import ArtibotError
from artibot_sim.exchange.inspection import Inspection, inspect_recording
from artibot_sim.experiment import BagWriter, read_bag, serialize
from artibot_sim.experiment.messages import message_class, vector
from artibot_sim.model import MOTORS

PERIOD = 20_000_000
COUNT = 500
TIMES = EPOCH + PERIOD * np.arange(COUNT)


def bag(
    folder: Path, names: dict[str, str] | None = None, motors: tuple[str, ...] = ("front_right", "front_left")
) -> Path:
    """10 s of a rover that drives on, its topics called as `names` says."""
    names = {"motors": "/motor_torques", "pose": "/ground_truth/odom"} | (names or {})
    with BagWriter(folder, live=False) as writer:
        writer.register(names["motors"], JOINTS)
        writer.register(names["pose"], ODOMETRY)
        for i, t in enumerate(TIMES.tolist()):
            speed = [3.0 + 0.01 * i + k for k in range(len(motors))]
            writer.write(names["motors"], joint_state(t, motors, velocity=speed), t, t)
            writer.write(names["pose"], odometry(t, x=0.01 * i, yaw=0.001 * i), t, t)
    return folder


def use(found: Inspection, name: str) -> tuple[bool, str]:
    (one,) = [entry for entry in found.uses if entry.name == name]
    return one.ready, "; ".join(one.lacks)


def typed(found: Inspection, part: str) -> list[str]:
    """The command that a line of advice names."""
    (line,) = [line for line in found.advice if part in line]
    return shlex.split(line[line.index("artibot ") :])[1:]


def test_a_contract_bag_is_ready_for_everything() -> None:
    found = inspect_recording(ROOT / "bags" / "table6_agriq")
    assert [entry.name for entry in found.uses if entry.ready] == [
        "plot",
        "resimulate",
        "check",
        "identify",
        "diagnose",
    ]
    assert (found.robot, found.storage, found.advice, len(found.segments)) == ("agriq", "mcap", (), 1)
    by_topic = {view.topic: view for view in found.topics}
    assert by_topic["/motor_torques"].rate == pytest.approx(50.0)
    assert by_topic["/motor_torques"].held == pytest.approx(0.0, abs=0.02)
    assert by_topic["/planned/path"].messages == 1


def test_rates_gaps_held_values_and_segments_are_those_of_the_recording(tmp_path: Path) -> None:
    t = np.concatenate([np.arange(0, 10, 0.02), np.arange(20, 30, 0.02)])
    pose_t = t[(t < 4) | (t >= 5.5)]
    held = np.floor(t * 10 + 1e-6)  # five samples of each value
    moving = {"front_right.velocity": held, "front_left.velocity": held + 1}
    path = recording(
        tmp_path / "run",
        {"motor_torques": (t, moving), "ground_truth_odom": (pose_t, {"x": pose_t, "y": pose_t**2, "yaw": pose_t})},
    ).path
    found = inspect_recording(path)
    motors, pose = (
        {view.topic: view for view in found.topics}[name] for name in ("/motor_torques", "/ground_truth/odom")
    )
    assert len(found.segments) == 2
    assert motors.rate == pytest.approx(50.0)
    assert motors.distinct == pytest.approx(10.0, rel=0.02)
    assert motors.gaps == ()
    ((start, length),) = pose.gaps
    assert (start, length) == pytest.approx((3.98, 1.52), abs=0.03)


def test_a_standstill_is_not_held(tmp_path: Path) -> None:
    t = np.arange(0, 30, 0.02)
    speed = np.where(t < 10, 1.0 + np.sin(7 * t), 0.0)
    path = recording(tmp_path / "run", {"motor_torques": (t, {"front_right.velocity": speed})}).path
    (view,) = inspect_recording(path).topics
    assert view.held < 0.02


@pytest.mark.parametrize(
    ("keys", "missing"),
    [
        ({"motor_torques"}, "where the rover went"),
        ({"ground_truth_odom"}, "/motor_torques"),
        ({"motor_torques", "ground_truth_odom"}, ""),
    ],
)
def test_identify_names_what_it_lacks_and_does_so_itself(tmp_path: Path, keys: set[str], missing: str) -> None:
    from artibot_sim.estimation.measurements import stretches
    from artibot_sim.model import load_robot

    t = np.arange(0, 10, 0.02)
    tables = {
        "motor_torques": (t, {f"{side}.velocity": 3.0 + 0.1 * t for side in ("front_right", "front_left")}),
        "ground_truth_odom": (t, {"x": 0.5 * t, "y": 0.0 * t, "yaw": 0.0 * t}),
    }
    path = recording(tmp_path / "run", {key: tables[key] for key in keys}).path
    ready, lacks = use(inspect_recording(path), "identify")
    assert ready == (not missing)
    assert missing in lacks
    if missing:  # what inspect says is missing, identify refuses
        with pytest.raises(ArtibotError):
            stretches(read_bag(path), load_robot("husky"))
    else:
        assert stretches(read_bag(path), load_robot("husky"))


T60 = np.arange(0, 60, 0.02)
EVERYWHERE = np.ones(len(T60), bool)


@pytest.mark.parametrize(
    ("motors", "positions", "share", "said"),
    [
        (T60 % 0.9 < 0.5, EVERYWHERE, None, "motors without gaps: /motor_torques has 66 gaps of more than 0.2 s"),
        (T60 % 8 < 4, T60 % 8 > 4, None, "/ground_truth/odom and /motor_torques at the same time"),
        (EVERYWHERE, T60 % 20 < 0.06, 0.0, "0.1 of 60.0 s, 0.1 s at a time at most: /ground_truth/odom is missing"),
        (EVERYWHERE, T60 % 3 < 0.3, 0.09, "5.6 of 60.0 s, 0.3 s at a time at most: /ground_truth/odom is missing for"),
        (T60 % 4 < 1.5, T60 % 4 < 1.5, 0.39, "1.5 s at a time at most: /motor_torques has 14 gaps"),
        (EVERYWHERE, EVERYWHERE, 1.0, ""),
    ],
    ids=["motors-everywhere", "in-turns", "three-places", "positions", "both", "none"],
)
def test_gaps_are_named_for_what_cannot_bridge_them(
    tmp_path: Path, motors: np.ndarray, positions: np.ndarray, share: float | None, said: str
) -> None:
    """A recording full of gaps is not simply ready: what is refused is missing, what holds for a part is said so."""
    from artibot_sim.estimation.measurements import stretches
    from artibot_sim.estimation.windows import cut
    from artibot_sim.model import load_robot

    speeds = {f"{side}.velocity": 3.0 + 0.1 * np.sin(T60[motors]) for side in ("front_right", "front_left")}
    place = {"x": 0.5 * T60[positions], "y": 0.1 * T60[positions], "yaw": 0.0 * T60[positions]}
    tables = {"motor_torques": (T60[motors], speeds), "ground_truth_odom": (T60[positions], place)}
    path = recording(tmp_path / "run", tables).path
    found = inspect_recording(path)
    for one in (entry for entry in found.uses if entry.name != "plot"):
        assert one.ready == (share is not None), one.name
        assert said in "; ".join(one.lacks), one.name
        if share is not None:
            assert one.share == pytest.approx(share, abs=0.01)
    husky = load_robot("husky")
    if share is None:  # what inspect says is missing, identify refuses
        with pytest.raises(ArtibotError):
            stretches(read_bag(path), husky)
    else:
        assert cut(stretches(read_bag(path), husky), husky, 2.0)


def test_one_sided_motors_are_named(tmp_path: Path) -> None:
    ready, lacks = use(inspect_recording(bag(tmp_path / "run", motors=("front_right",))), "identify")
    assert not ready
    assert "rotation of front_left on /motor_torques, which has front_right" in lacks


@pytest.mark.parametrize(
    ("motors", "listed", "left_out"),
    [(("front_right", "front_left"), "husky", "agriq"), (MOTORS, "agriq", "husky")],
    ids=["rigid", "articulated"],
)
def test_only_robots_of_its_kind_are_proposed(
    tmp_path: Path, motors: tuple[str, ...], listed: str, left_out: str
) -> None:
    (advice,) = [one for one in inspect_recording(bag(tmp_path / "run", motors=motors)).advice if "for ROBOT" in one]
    names = advice.partition("give ")[2].partition(", or make")[0].split(", ")
    assert listed in names
    assert left_out not in names


def test_another_name_is_said_with_what_to_type(tmp_path: Path) -> None:
    path = bag(tmp_path / "run", {"pose": "/lidar/pose", "motors": "/wheels"})
    found = inspect_recording(path)
    assert not use(found, "identify")[0]
    command = typed(found, "if all are")
    assert command.count("--topic") == 2 and main(command) == 0
    assert sum("/wheels" in line for line in found.advice) == 2, "by itself and with all, not for commands as well"
    renames = {"/ground_truth/odom": "/lidar/pose", "/motor_torques": "/wheels"}
    again = inspect_recording(path, renames)
    assert use(again, "identify")[0]
    assert all(entry.command.count("--topic") == 2 for entry in again.uses)
    assert again.topics[0].read_as == "/ground_truth/odom"


def test_a_lidars_pose_that_is_called_odom_is_asked_for(tmp_path: Path) -> None:
    """A robot's own belief is mostly called so: what it may be is said, and it is proposed where nothing else is."""
    found = inspect_recording(bag(tmp_path / "run", {"pose": "/lidar/odom"}))
    (line,) = [line for line in found.advice if "/lidar/odom" in line]
    assert "from outside" in line and line.endswith("--topic /ground_truth/odom=/lidar/odom")
    assert use(inspect_recording(tmp_path / "run", {"/ground_truth/odom": "/lidar/odom"}), "identify")[0]
    other = inspect_recording(bag(tmp_path / "other", {"pose": "/lidar/pose"}))
    assert any("if /lidar/pose is it" in line for line in other.advice)


def test_no_kind_of_robot_is_claimed_where_no_motor_was_read(tmp_path: Path) -> None:
    (advice,) = [
        line
        for line in inspect_recording(bag(tmp_path / "run", {"motors": "/wheels"}, motors=MOTORS)).advice
        if "for ROBOT" in line
    ]
    assert "rigid" not in advice and {"agriq,", "husky,"} <= set(advice.split())


WHEELS = ("front_left_wheel_joint", "front_right_wheel_joint", "rear_left_wheel_joint", "rear_right_wheel_joint")


def test_wheels_in_joint_states_are_shown_as_both(tmp_path: Path) -> None:
    found = inspect_recording(bag(tmp_path / "run", {"motors": "/joint_states"}, motors=WHEELS))
    assert use(found, "identify")[0]
    read = {view.read_as: view for view in found.topics}
    assert read["/motor_torques"].topic == read["/joint_states"].topic == "/joint_states"
    assert read["/motor_torques"].messages == read["/joint_states"].messages == COUNT
    assert len(found.topics) == 3
    assert any("front_right is the mean of front_right_wheel_joint, rear_right_wheel_joint" in r for r in found.remarks)


def test_wheels_under_any_names_are_named_by_option_or_beside_the_recording(tmp_path: Path) -> None:
    path = bag(tmp_path / "run", {"pose": "/icp", "motors": "/joint_states"}, motors=("a", "b", "c", "d"))
    renames = {"/ground_truth/odom": "/icp"}
    found = inspect_recording(path, renames)
    assert not use(found, "identify")[0]
    assert any(
        "add --joint front_right=FOUND[,FOUND] --joint front_left=FOUND[,FOUND]" in line for line in found.advice
    )
    assert main(["inspect", str(path), "--topic", "/ground_truth/odom=/icp", "--joint", "front_right=a,b",
                 "--joint", "front_left=c,d"]) == 0  # fmt: skip
    found = inspect_recording(path, renames, joints={"front_right": ("a", "b"), "front_left": ("c", "d")})
    ready = {entry.name: entry for entry in found.uses}
    assert ready["plot"].ready and ready["identify"].ready
    assert all(" --joint front_right=a,b --joint front_left=c,d" in entry.command for entry in found.uses)
    assert main([*shlex.split(ready["plot"].command)[1:], "--json", str(tmp_path / "plot.json")]) == 0
    names = "topics: {/ground_truth/odom: /icp}\njoints: {front_right: [a, b], front_left: [c, d]}\n"
    (path / "names.yaml").write_text(names)
    found = inspect_recording(path)
    assert use(found, "identify")[0]
    assert "--joint" not in found.uses[0].command, "kept with the recording, nothing is to be typed"
    assert main(["plot", str(path), "--json", str(tmp_path / "again.json")]) == 0
    assert (tmp_path / "again.json").read_text() == (tmp_path / "plot.json").read_text()


def test_what_a_robot_believes_is_not_offered_as_where_it_was(tmp_path: Path) -> None:
    found = inspect_recording(bag(tmp_path / "run", {"pose": "/odom"}))
    assert not use(found, "identify")[0]
    assert not any("/ground_truth/odom=" in line for line in found.advice)


def test_namespaces_one_is_found_and_two_are_asked_about(tmp_path: Path) -> None:
    one = bag(tmp_path / "one", {"pose": "/rover1/ground_truth/odom", "motors": "/rover1/motor_torques"})
    assert use(inspect_recording(one), "identify")[0]
    two = tmp_path / "two"
    with BagWriter(two, live=False) as writer:
        for space in ("/rover1", "/rover2"):
            writer.register(f"{space}/motor_torques", JOINTS)
            for t in TIMES[:50].tolist():
                writer.write(f"{space}/motor_torques", joint_state(t, ["front_right"], velocity=[1.0]), t, t)
    found = inspect_recording(two)
    assert any("--namespace /rover1" in line for line in found.advice)
    assert {view.topic for view in found.topics} == {"/rover1/motor_torques", "/rover2/motor_torques"}
    assert inspect_recording(two, namespace="/rover2").topics[0].topic == "/rover2/motor_torques"


def test_twist_without_a_stamp_and_sqlite_work(tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    twist = message_class("geometry_msgs/msg/Twist")(linear=vector(0.5, 0.0, 0.0), angular=vector(0.0, 0.0, 0.1))
    writer = Writer(tmp_path / "run", version=9, storage_plugin=StoragePlugin.SQLITE3)
    with writer:
        there = writer.add_connection("/cmd_vel", "geometry_msgs/msg/Twist", typestore=store)
        data = serialize("geometry_msgs/msg/Twist", linear=twist.linear, angular=twist.angular)
        for t in TIMES.tolist():
            writer.write(there, t, data)
    found = inspect_recording(tmp_path / "run")
    assert found.storage == "sqlite3"
    assert found.topics[0].read_as == "/cmd_vel"
    assert found.topics[0].rate == pytest.approx(50.0)


def ros1_bag(path: Path) -> Path:
    """A ROS 1 recording of odometry under the contract's name."""
    store = get_typestore(Stores.ROS1_NOETIC)
    types = store.types
    zero = np.zeros(36)
    with Rosbag1(path) as writer:
        there = writer.add_connection("/ground_truth/odom", ODOMETRY, typestore=store)
        for i, t in enumerate(TIMES.tolist()):
            stamp = types["builtin_interfaces/msg/Time"](sec=t // 10**9, nanosec=t % 10**9)
            pose = types["geometry_msgs/msg/Pose"](
                position=types["geometry_msgs/msg/Point"](x=0.01 * i, y=0.5, z=0.0),
                orientation=types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
            )
            still = types["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0)
            message = types[ODOMETRY](
                header=types["std_msgs/msg/Header"](seq=i, stamp=stamp, frame_id="map"),
                child_frame_id="base_link",
                pose=types["geometry_msgs/msg/PoseWithCovariance"](pose=pose, covariance=zero),
                twist=types["geometry_msgs/msg/TwistWithCovariance"](
                    twist=types["geometry_msgs/msg/Twist"](linear=still, angular=still), covariance=zero
                ),
            )
            writer.write(there, t, store.serialize_ros1(message, ODOMETRY))
    return path


@pytest.mark.parametrize("inside_a_folder", [False, True])
def test_a_ros_1_bag_says_what_to_type_and_that_works(
    tmp_path: Path, inside_a_folder: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    path = ros1_bag(tmp_path / "old.bag")
    assert main(["inspect", str(tmp_path if inside_a_folder else path)]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    words = shlex.split(said[said.index("rosbags-convert") :])
    subprocess.run([str(Path(sys.executable).parent / words[0]), *words[1:]], check=True, timeout=60)
    found = inspect_recording(tmp_path / "old")
    assert found.topics[0].rate == pytest.approx(50.0)
    assert np.allclose(read_bag(tmp_path / "old").channels["ground_truth_odom"]["x"], 0.01 * np.arange(COUNT))


def test_the_screen_fits_and_the_json_is_the_same(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["inspect", str(ROOT / "bags" / "table6_agriq"), "--json", str(tmp_path / "x.json")]) == 0
    screen = capsys.readouterr().out
    assert len(screen.splitlines()) <= 30
    assert "identify   ready" in screen
    found = json.loads((tmp_path / "x.json").read_text(encoding="utf-8"))
    assert found["robot"] == "agriq"
    assert {topic["topic"]: topic["messages"] for topic in found["topics"]}["/odom"] == 1494


@pytest.mark.parametrize(
    ("name", "topic", "low", "high"),
    [
        ("real/husky_deflated", "/motor_torques", 9.0, 11.0),
        ("real/husky_wetgrass", "/motor_torques", 0.7, 2.5),
        ("real/warthog_gravel", "/motor_torques", 3.0, 5.0),
        ("real/warthog_gravel", "/ground_truth/odom", 3.0, 5.0),
        ("real/optiodom_diff_1", "/ground_truth/odom", 18.0, 21.0),
    ],
)
def test_real_recordings_repeat_values_as_often_as_their_description_says(
    name: str, topic: str, low: float, high: float
) -> None:
    found = {view.topic: view for view in inspect_recording(foreign(name)).topics}
    assert low < found[topic].distinct < high


def test_of_several_rovers_one_line_says_what_to_type(tmp_path: Path) -> None:
    """Two rovers' topics below their namespaces: every reader asks which one, by a command that then works."""
    path, spaces = tmp_path / "two", ("/rover1", "/rover2")
    with (
        Reader(ROOT / "bags" / "table6_agriq") as one,
        Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as two,
    ):
        known = {
            (space, c.id): two.add_connection(space + c.topic, c.msgtype, msgdef=c.msgdef.data, rihs01=c.digest)
            for space in spaces for c in one.connections
        }  # fmt: skip
        for connection, stamp, data in one.messages():
            for space in spaces:
                two.write(known[space, connection.id], stamp, data)
    (line,) = inspect_recording(path).advice
    assert "several rovers (/rover1, /rover2)" in line
    words = line.partition("artibot inspect ")[2].split()
    assert words == [str(path), "--namespace", "/rover1"]
    assert inspect_recording(path, namespace=words[2]).uses[0].ready
    with pytest.raises(ArtibotError, match=r"several rovers .* --namespace /rover1"):
        read_bag(path)
    with pytest.raises(ArtibotError, match=r"no topic below /rover3/; the recording has /rover1, /rover2$"):
        read_bag(path, namespace="rover3")
