"""`read_bag` gives back what was recorded, whatever the order, the stamps and the publishers."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from bag_helpers import (
    EPOCH,
    JOINTS,
    ODOMETRY,
    STEP,
    foreign,
    foreign_recordings,
    joint_state,
    mcap_file,
    odometry,
    small_bag,
    write_bag,
)
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment import BagWriter, bag_info, iter_messages, read_bag, serialize
from artibot_sim.experiment.messages import header, message_class
from artibot_sim.experiment.topics import BY_NAME
from artibot_sim.resources import config_names

quick = settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.mark.parametrize("name", foreign_recordings())
def test_a_recording_made_elsewhere_is_read_in_full(name: str) -> None:
    path = foreign(name)
    experiment = read_bag(path)
    (file,) = path.glob("*.mcap")
    with open(file, "rb") as stream:
        summary = make_reader(stream).get_summary()
    counts = {summary.channels[k].topic: count for k, count in summary.statistics.channel_message_counts.items()}
    expected = {topic: count for topic, count in counts.items() if topic in BY_NAME}
    assert {channel.topic: len(channel) for channel in experiment.channels.values()} == expected
    assert experiment.metadata["robot"] in config_names("robots")
    assert not experiment.remarks
    for channel in experiment.channels.values():
        assert (np.diff(channel.t_ns) > 0).all()
        assert set(channel.units) == set(channel.columns)
    assert experiment.require("motor_torques", "front_right.velocity", "front_left.velocity")


def test_the_file_alone_is_read_as_its_folder_is() -> None:
    path = foreign("field_examples/none/run0")
    experiment = read_bag(path)
    (file,) = path.glob("*.mcap")
    bare = read_bag(file)
    assert bare.name == experiment.name
    assert bare.channels.keys() == experiment.channels.keys()


def test_of_a_recording_with_too_many_messages_pieces_from_all_of_it_are_read() -> None:
    path = foreign("field_examples/none/run0")
    whole = read_bag(path)
    count = sum(len(channel) for channel in whole.channels.values())
    assert read_bag(path, most=2 * count).segments == whole.segments
    few = read_bag(path, most=count // 5)
    assert few.remarks[0].startswith("10 pieces of ")
    assert len(few.segments) == 10
    assert sum(len(channel) for channel in few.channels.values()) == pytest.approx(count / 5, rel=0.1)
    motors, every = few.channels["motor_torques"], whole.channels["motor_torques"]
    assert motors.t_ns[0] == every.t_ns[0]
    assert every.t_ns[-1] - motors.t_ns[-1] < 0.1e9
    rows = np.isin(every.t_ns, motors.t_ns)
    assert rows.sum() == len(motors)
    for name, values in motors.columns.items():
        assert np.array_equal(values, every[name][rows], equal_nan=True)


def test_the_husky_windows_are_segments_of_2_s_and_their_twist_is_nan() -> None:
    experiment = read_bag(foreign("husky_a"))
    assert len(experiment.segments) == 204
    assert all(abs(b - a - 1.95) < 1e-6 for a, b in experiment.segments)
    truth = experiment.channels["ground_truth_odom"]
    assert np.isnan(truth["vx"]).all()
    assert truth.series("vx")[0].size == 0
    starts = np.searchsorted(truth.t, [a for a, _ in experiment.segments])
    # each window's pose is relative to its own start: unwrapping must not carry a turn over from the last
    assert np.abs(truth["yaw"][starts]).max() < 0.5
    assert "front_right.effort" not in experiment.channels["motor_torques"]


def test_the_field_examples_have_four_motors_and_a_prism() -> None:
    experiment = read_bag(foreign("field_examples/none/run0"))
    assert len(experiment.segments) == 1
    motors = experiment.channels["motor_torques"]
    for motor in ("front_right", "front_left", "back_right", "back_left"):
        for quantity in ("position", "velocity", "effort"):
            assert np.isfinite(motors[f"{motor}.{quantity}"]).all()
    command = experiment.channels["motor_command"]
    assert "front_right.velocity" in command
    assert "back_right.velocity" not in command  # NaN throughout: not commanded
    assert len(experiment.channels["total_station"]) == 445
    assert experiment.channels["imu"].units["yaw_rate"] == "rad/s"


@quick
@given(order=st.permutations(range(12)))
def test_the_order_in_which_messages_were_logged_does_not_matter(
    tmp_path_factory: pytest.TempPathFactory, order: list[int]
) -> None:
    folder = tmp_path_factory.mktemp("bag") / "run"
    write_bag(
        folder,
        [("/odom", ODOMETRY, odometry(EPOCH + i * STEP, x=float(i)), EPOCH + k) for k, i in enumerate(order)],
    )
    experiment = read_bag(folder)
    channel = experiment.channels["odom"]
    assert channel["x"].tolist() == [float(i) for i in range(12)]
    assert channel.t_ns.tolist() == [EPOCH + i * STEP for i in range(12)]
    assert channel.received_ns.tolist() == [EPOCH + order.index(i) for i in range(12)]
    assert bool(experiment.remarks) == (list(order) != list(range(12)))


def test_joints_of_several_publishers_keep_their_own_times(tmp_path: Path) -> None:
    wheels = [EPOCH + i * 10_000_000 for i in range(20)]
    joint = [EPOCH + 3_000_000 + i * 20_000_000 for i in range(8)] + [wheels[15]]
    messages = [
        ("/joint_states", JOINTS, joint_state(t, ["w1", "w2"], [float(i), -float(i)]), t) for i, t in enumerate(wheels)
    ]
    messages += [
        ("/joint_states", JOINTS, joint_state(t, ["articulation_yaw"], [0.1 * i]), t + 9_000_000)
        for i, t in enumerate(joint)
    ]
    experiment = read_bag(write_bag(tmp_path / "run", messages))
    assert not experiment.remarks  # each is in order, though one comes later than the other
    channel = experiment.channels["joint_states"]
    t, values = channel.series("articulation_yaw.position")
    assert np.allclose(t, (np.array(joint) - EPOCH) / 1e9, atol=1e-12)
    assert np.allclose(values, 0.1 * np.arange(9))
    assert channel.series("w2.position")[1].tolist() == [-float(i) for i in range(20)]
    assert len(channel) == len(set(wheels) | set(joint))  # where both have one stamp they share a row
    row = int(np.flatnonzero(channel.t_ns == wheels[15])[0])
    assert channel["w1.position"][row] == 15.0
    assert channel["articulation_yaw.position"][row] == pytest.approx(0.8)


def test_what_was_not_measured_is_absent(tmp_path: Path) -> None:
    nan = float("nan")
    messages = [
        (
            "/motor_torques",
            JOINTS,
            joint_state(EPOCH + i, ["a", "b"], velocity=[1.0, nan], effort=[nan, nan]),
            EPOCH + i,
        )
        for i in range(1, 4)
    ]
    experiment = read_bag(write_bag(tmp_path / "run", messages))
    assert set(experiment.channels["motor_torques"].columns) == {"a.velocity"}


def test_a_field_of_the_wrong_length_is_left_out_with_a_remark(tmp_path: Path) -> None:
    data = joint_state(EPOCH, ["a", "b"], velocity=[1.0, 2.0], effort=[3.0])
    experiment = read_bag(write_bag(tmp_path / "run", [("/motor_torques", JOINTS, data, EPOCH)]))
    assert set(experiment.channels["motor_torques"].columns) == {"a.velocity", "b.velocity"}
    assert "not as long as its names" in experiment.remarks[0]


def test_repeated_stamps_are_merged_and_said(tmp_path: Path) -> None:
    messages = [("/odom", ODOMETRY, odometry(EPOCH + (i // 2) * STEP, x=float(i)), EPOCH + i) for i in range(6)]
    experiment = read_bag(write_bag(tmp_path / "run", messages))
    assert experiment.channels["odom"]["x"].tolist() == [1.0, 3.0, 5.0]
    assert "3 stamps occur twice" in experiment.remarks[0]


def test_a_message_that_is_published_twice_is_no_contradiction(tmp_path: Path) -> None:
    messages = [("/odom", ODOMETRY, odometry(EPOCH + (i // 2) * STEP, x=float(i // 2)), EPOCH + i) for i in range(6)]
    experiment = read_bag(write_bag(tmp_path / "run", messages))
    assert experiment.channels["odom"]["x"].tolist() == [0.0, 1.0, 2.0]
    assert not experiment.remarks


def test_without_a_header_stamp_the_time_of_reception_counts(tmp_path: Path) -> None:
    messages = [("/odom", ODOMETRY, odometry(0, x=float(i)), EPOCH + i * STEP) for i in range(5)]
    experiment = read_bag(write_bag(tmp_path / "run", messages))
    assert experiment.channels["odom"].t_ns.tolist() == [EPOCH + i * STEP for i in range(5)]
    assert "5 messages without a header stamp" in experiment.remarks[0]


def test_yaw_is_continuous_within_a_segment_and_starts_anew_after_a_gap(tmp_path: Path) -> None:
    true = np.concatenate([np.linspace(0, 12, 200), np.linspace(0, -12, 200)])
    stamps = EPOCH + np.concatenate([np.arange(200), 300 + np.arange(200)]) * STEP
    messages = [("/odom", ODOMETRY, odometry(int(t), yaw=float(a)), int(t)) for t, a in zip(stamps, true, strict=True)]
    experiment = read_bag(write_bag(tmp_path / "run", messages))
    assert len(experiment.segments) == 2
    assert np.abs(experiment.channels["odom"]["yaw"] - true).max() < 1e-9


def test_a_recording_without_a_message_is_not_told_to_rename_topics(tmp_path: Path) -> None:
    with pytest.raises(ArtibotError, match="no message was recorded; start what publishes"):
        read_bag(write_bag(tmp_path / "run", []))


def test_renamed_topics(tmp_path: Path) -> None:
    folder = write_bag(tmp_path / "run", [("/lidar/odom", ODOMETRY, odometry(EPOCH, x=2.0), EPOCH)])
    with pytest.raises(
        ArtibotError, match=r"no message on any topic that artibot reads; the recording has /lidar/odom"
    ):
        read_bag(folder)
    experiment = read_bag(folder, topics={"/ground_truth/odom": "/lidar/odom"})
    assert experiment.channels["ground_truth_odom"].topic == "/lidar/odom"
    with pytest.raises(ArtibotError, match=r"no topic '/nowhere'; it has /lidar/odom"):
        read_bag(folder, topics={"ground_truth_odom": "/nowhere"})


CAN_FRAME = (
    "std_msgs/Header header\nuint32 id\nbool is_rtr\nbool is_extended\nbool is_error\nuint8 dlc\nuint8[8] data\n"
)


def foreign_type_bag(folder: Path) -> Path:
    with BagWriter(folder, live=False) as bag:
        bag.register("/from_can_bus", "can_msgs/msg/Frame", definition=CAN_FRAME, type_hash="")
        bag.register("/odom", ODOMETRY)
        for i in range(3):
            t = EPOCH + i * STEP
            bag.write("/from_can_bus", b"\x00\x01\x00\x00" + bytes(28), t, t)
            bag.write("/odom", odometry(t, x=float(i)), t, t)
    return folder


def test_topics_of_unknown_types_do_no_harm(tmp_path: Path) -> None:
    folder = foreign_type_bag(tmp_path / "run")
    experiment = read_bag(folder)
    assert experiment.topics["/from_can_bus"] == "can_msgs/msg/Frame"
    assert len(experiment.channels["odom"]) == 3
    with pytest.raises(ArtibotError, match=r"/from_can_bus is of type can_msgs/msg/Frame; artibot reads /odom as"):
        read_bag(folder, topics={"/odom": "/from_can_bus"})


def test_a_contract_topic_of_another_type_is_left_out_with_a_remark(tmp_path: Path) -> None:
    text = serialize("std_msgs/msg/String", data="hello")
    folder = write_bag(
        tmp_path / "run",
        [("/imu/data", "std_msgs/msg/String", text, EPOCH), ("/odom", ODOMETRY, odometry(EPOCH), EPOCH)],
    )
    experiment = read_bag(folder)
    assert "imu" not in experiment.channels
    assert "/imu/data is of type std_msgs/msg/String" in experiment.remarks[0]


def test_the_definition_in_the_recording_rules(tmp_path: Path) -> None:
    """A PointStamped that another distribution defines with a field more is read by its own definition."""
    definition = (
        "std_msgs/Header header\nfloat64 quality\ngeometry_msgs/Point point\n"
        f"{'=' * 80}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
        f"{'=' * 80}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
        f"{'=' * 80}\nMSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z\n"
    )
    body = (
        np.array([EPOCH // 10**9, 0, 1], "<u4").tobytes()
        + b"\x00"
        + bytes(3)
        + np.array([0.5, 1.0, 2.0, 3.0]).tobytes()
    )
    with BagWriter(tmp_path / "run", live=False) as bag:
        bag.register(
            "/total_station/point", "geometry_msgs/msg/PointStamped", definition=definition, type_hash="RIHS01_00"
        )
        bag.write("/total_station/point", b"\x00\x01\x00\x00" + body, EPOCH, EPOCH)
    channel = read_bag(tmp_path / "run").channels["total_station"]
    assert [channel[name][0] for name in "xyz"] == [1.0, 2.0, 3.0]


def test_bytes_that_are_no_such_message_name_the_topic(tmp_path: Path) -> None:
    folder = write_bag(tmp_path / "run", [("/odom", ODOMETRY, b"\x00\x01\x00\x00\x01", EPOCH)])
    with pytest.raises(
        ArtibotError, match=rf"topic /odom: the message logged at {EPOCH} ns is not a nav_msgs/msg/Odometry"
    ):
        read_bag(folder)


def test_plans_are_rows_in_time(tmp_path: Path) -> None:
    from artibot_sim.experiment.messages import path_message, trajectory_message

    after = [0, 500_000_000, 1_000_000_000]
    angles = np.array([[0.0, 0.0], [1.0, 2.0], [3.0, 4.0]])
    profile = trajectory_message(EPOCH, ["front_right", "front_left"], after, angles, 2 * angles)
    path = path_message(EPOCH, [EPOCH + t for t in after], np.array([[0, 0, 0], [1, 0, 0.1], [2, 0.1, 0.2]]))
    messages = [
        ("/planned/front_velocity", "trajectory_msgs/msg/JointTrajectory", profile, EPOCH + k) for k in range(3)
    ]
    messages += [("/planned/path", "nav_msgs/msg/Path", path, EPOCH), ("/odom", ODOMETRY, odometry(EPOCH), EPOCH)]
    experiment = read_bag(write_bag(tmp_path / "run", messages))
    planned = experiment.channels["planned_front_velocity"]
    assert planned["front_left.velocity"].tolist() == [0.0, 4.0, 8.0]  # published thrice, the same plan
    assert planned.t.tolist() == [0.0, 0.5, 1.0]
    assert experiment.channels["planned_path"]["x"].tolist() == [0.0, 1.0, 2.0]


def test_streaming_gives_the_same_messages_and_obeys_its_bounds(tmp_path: Path) -> None:
    messages = [("/odom", ODOMETRY, odometry(EPOCH + i * STEP), EPOCH + i * STEP) for i in range(50)]
    messages += [("/ground_truth/odom", ODOMETRY, odometry(EPOCH + i * STEP), EPOCH + i * STEP + 1) for i in range(50)]
    folder = write_bag(tmp_path / "run", messages, {"robot": "agriq"})
    got = list(iter_messages(folder))
    assert sorted((m.channel.topic, m.log_ns, m.data) for m in got) == sorted((t, s, d) for t, _, d, s in messages)
    assert [m.log_ns for m in got] == sorted(m.log_ns for m in got)
    part = list(iter_messages(folder, ["/odom"], EPOCH + 10 * STEP, EPOCH + 20 * STEP))
    assert [m.log_ns for m in part] == [EPOCH + i * STEP for i in range(10, 20)]
    info = bag_info(mcap_file(folder))
    assert (info.message_count, info.start_ns, info.end_ns) == (100, EPOCH, EPOCH + 49 * STEP + 1)
    assert info.metadata["robot"] == "agriq"
    assert {c.topic: c.message_count for c in info.channels} == {"/odom": 50, "/ground_truth/odom": 50}


def test_an_error_of_the_reader_is_not_mistaken_for_one_of_the_file(tmp_path: Path) -> None:
    folder = write_bag(tmp_path / "run", [("/odom", ODOMETRY, odometry(EPOCH), EPOCH)])
    with pytest.raises(KeyError, match="mine"):
        for _ in iter_messages(folder):
            raise KeyError("mine")


def test_twists_with_and_without_header(tmp_path: Path) -> None:
    linear = message_class("geometry_msgs/msg/Vector3")
    twist = message_class("geometry_msgs/msg/Twist")(
        linear=linear(x=0.5, y=0.0, z=0.0), angular=linear(x=0.0, y=0.0, z=0.2)
    )
    bare = serialize("geometry_msgs/msg/Twist", linear=twist.linear, angular=twist.angular)
    stamped = serialize("geometry_msgs/msg/TwistStamped", header=header(EPOCH), twist=twist)
    for ros_type, data in (("geometry_msgs/msg/Twist", bare), ("geometry_msgs/msg/TwistStamped", stamped)):
        folder = tmp_path / ros_type.rpartition("/")[2]
        channel = read_bag(write_bag(folder, [("/cmd_vel", ros_type, data, EPOCH)])).channels["cmd_vel"]
        assert (channel["vx"][0], channel["yaw_rate"][0], channel.t_ns[0]) == (0.5, 0.2, EPOCH)


def test_a_file_without_an_index_tells_of_both_passes(tmp_path: Path) -> None:
    bag = small_bag(tmp_path / "indexed", 1500)
    bare = tmp_path / "bare.mcap"
    with open(mcap_file(bag), "rb") as source, open(bare, "wb") as sink:
        writer = Writer(sink, index_types=IndexType.NONE, use_statistics=False, use_summary_offsets=False)
        writer.start("ros2", "test")
        schemas, channels = {}, {}
        for schema, channel, message in make_reader(source).iter_messages():
            if schema.id not in schemas:
                schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
            if channel.id not in channels:
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, schemas[schema.id], channel.metadata
                )
            writer.add_message(channels[channel.id], message.log_time, message.data, message.publish_time)
        writer.finish()
    told: list[float] = []
    experiment = read_bag(bare, progress=told.append)
    assert told == sorted(told) and len(told) > 4 and 0.5 in told and told[-1] <= 1.0
    indexed = read_bag(bag)
    for key, channel in indexed.channels.items():
        assert np.array_equal(channel.t_ns, experiment.channels[key].t_ns)


def test_a_record_that_is_longer_than_its_chunk_is_damage(tmp_path: Path) -> None:
    path, data = tmp_path / "long.mcap", odometry(EPOCH)
    with open(path, "wb") as sink:
        writer = Writer(sink, compression=CompressionType.NONE, enable_crcs=False)
        writer.start("ros2", "test")
        schema = writer.register_schema(ODOMETRY, "ros2msg", b"")
        writer.add_message(writer.register_channel("/odom", "cdr", schema), EPOCH, data, EPOCH)
        writer.finish()
    assert [message.data for message in iter_messages(path)] == [data]
    length = struct.pack("<Q", 22 + len(data))
    whole = path.read_bytes()
    assert whole.count(length) == 1
    path.write_bytes(whole.replace(length, struct.pack("<Q", 23 + len(data))))
    with pytest.raises(ArtibotError, match=f"{path}.* a record of {23 + len(data)} bytes"):
        list(iter_messages(path))


def in_namespaces(folder: Path, *names: str) -> Path:
    """A bag with the motors and the truth of a rover below each namespace, distinguished by their first speed."""
    messages = []
    for number, name in enumerate(names):
        for k in range(50):
            stamp = EPOCH + k * STEP
            motors = joint_state(stamp, ["front_right", "front_left"], velocity=[10.0 * number, 1.0])
            messages.append((f"{name}/motor_torques", JOINTS, motors, stamp))
            messages.append((f"{name}/ground_truth/odom", ODOMETRY, odometry(stamp, x=0.01 * k), stamp))
            messages.append((f"{name}/odom", ODOMETRY, odometry(stamp, x=0.02 * k), stamp))
    return write_bag(folder, messages)


def test_the_topics_of_the_only_rover_are_found_below_its_namespace(tmp_path: Path) -> None:
    experiment = read_bag(in_namespaces(tmp_path / "run", "/field/rover1"))
    assert set(experiment.channels) == {"motor_torques", "ground_truth_odom", "odom"}
    assert experiment.channels["odom"].topic == "/field/rover1/odom"
    assert experiment.channels["odom"]["x"][-1] == pytest.approx(0.98)
    assert any("/field/rover1/" in remark for remark in experiment.remarks)


def test_of_several_rovers_one_is_chosen_by_hand(tmp_path: Path) -> None:
    folder = in_namespaces(tmp_path / "run", "/rover1", "/rover2")
    with pytest.raises(ArtibotError, match=r"/rover1, /rover2.*--namespace /rover1"):
        read_bag(folder)
    for asked in ("/rover2", "rover2/"):
        motors = read_bag(folder, namespace=asked).channels["motor_torques"]
        assert motors["front_right.velocity"][0] == 10.0
    with pytest.raises(ArtibotError, match=r"--namespace /rover3.*has /rover1, /rover2$"):
        read_bag(folder, namespace="/rover3")
    named = read_bag(folder, {"motor_torques": "/rover2/motor_torques"}).channels
    assert set(named) == {"motor_torques"} and named["motor_torques"]["front_right.velocity"][0] == 10.0


def test_a_rover_without_a_namespace_comes_first_and_shared_devices_serve_all(tmp_path: Path) -> None:
    assert read_bag(in_namespaces(tmp_path / "a", "", "/rover2")).channels["motor_torques"].topic == "/motor_torques"
    other = read_bag(in_namespaces(tmp_path / "b", "", "/rover2"), namespace="rover2")
    assert other.channels["motor_torques"].topic == "/rover2/motor_torques"
    point = message_class("geometry_msgs/msg/Point")(x=1.0, y=2.0, z=0.0)
    station = serialize("geometry_msgs/msg/PointStamped", header=header(EPOCH, "map"), point=point)
    motors = joint_state(EPOCH, ["front_right", "front_left"], velocity=[1.0, 1.0])
    messages = [("/rover1/motor_torques", JOINTS, motors, EPOCH),
                ("/total_station/point", "geometry_msgs/msg/PointStamped", station, EPOCH)]  # fmt: skip
    shared = read_bag(write_bag(tmp_path / "c", messages)).channels
    assert shared["total_station"].topic == "/total_station/point"
    assert shared["motor_torques"].topic == "/rover1/motor_torques"
