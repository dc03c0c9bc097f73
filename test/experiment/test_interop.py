"""rosbags and mcap read what artibot writes, and artibot what rosbags writes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from bag_helpers import EPOCH, JOINTS, ODOMETRY, STEP, joint_state, mcap_file, odometry, small_bag, write_bag
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment import BagWriter, Qos, bag_info, read_bag
from artibot_sim.experiment.topics import LATCHED, SENSOR, dump_profiles, parse_qos

STORE = get_typestore(Stores.ROS2_JAZZY)


def by_rosbags(
    folder: Path, plugin: StoragePlugin, count: int = 50, compression: CompressionMode = CompressionMode.NONE
) -> Path:
    bag = Writer(folder, version=9, storage_plugin=plugin)
    bag.set_compression(compression, CompressionFormat.ZSTD)
    with bag:
        odom = bag.add_connection("/odom", ODOMETRY, typestore=STORE)
        joints = bag.add_connection("/joint_states", JOINTS, typestore=STORE)
        for i in range(count):
            t = EPOCH + i * STEP
            bag.write(odom, t, odometry(t, x=0.1 * i, yaw=0.2 * i))
            bag.write(joints, t + 1, joint_state(t, ["a", "b"], [float(i), -float(i)]))
    return folder


@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_bags_made_by_rosbags_are_read(tmp_path: Path, plugin: StoragePlugin) -> None:
    folder = by_rosbags(tmp_path / "run", plugin)
    experiment = read_bag(folder)
    assert np.allclose(experiment.channels["odom"]["yaw"], 0.2 * np.arange(50), atol=1e-12)
    assert experiment.channels["joint_states"]["b.position"].tolist() == [-float(i) for i in range(50)]
    assert experiment.channels["joint_states"].received_ns[3] == EPOCH + 3 * STEP + 1
    info = bag_info(folder)
    assert {c.topic: c.message_count for c in info.channels} == {"/odom": 50, "/joint_states": 50}
    assert (info.start_ns, info.end_ns) == (EPOCH, EPOCH + 49 * STEP + 1)
    (file,) = (f for f in folder.iterdir() if f.suffix in (".mcap", ".db3"))
    assert read_bag(file).channels["odom"]["x"].tolist() == experiment.channels["odom"]["x"].tolist()


def test_both_storages_and_our_own_give_the_same_columns(tmp_path: Path) -> None:
    one = read_bag(by_rosbags(tmp_path / "mcap", StoragePlugin.MCAP))
    other = read_bag(by_rosbags(tmp_path / "sqlite", StoragePlugin.SQLITE3))
    for key, channel in one.channels.items():
        for name, values in channel.columns.items():
            assert np.array_equal(values, other.channels[key][name], equal_nan=True)


@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_bags_compressed_by_the_message_or_as_a_file(tmp_path: Path, plugin: StoragePlugin) -> None:
    folder = by_rosbags(tmp_path / "run", plugin, compression=CompressionMode.MESSAGE)
    assert read_bag(folder).channels["joint_states"]["a.position"].tolist() == [float(i) for i in range(50)]
    folder = by_rosbags(tmp_path / "packed", plugin, compression=CompressionMode.FILE)
    with pytest.raises(ArtibotError, match=r"zstd: this is a zstd-compressed file; decompress it with `zstd -d` first"):
        read_bag(folder)


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_rosbags_reads_every_message_of_ours(tmp_path: Path, compression: str) -> None:
    folder = small_bag(tmp_path / "run", 300, compression=compression)
    with Reader(folder) as bag:
        assert bag.message_count == 300
        assert bag.duration == 299 * STEP + 1
        got = [(c.topic, t, STORE.deserialize_cdr(data, c.msgtype)) for c, t, data in bag.messages()]
    assert [t for _, t, _ in got] == [EPOCH + i * STEP for i in range(300)]
    assert got[7][2].velocity.tolist() == [7.0]
    with AnyReader([folder]) as bag:  # which checks type hashes
        assert sum(1 for _ in bag.messages()) == 300


def test_mcap_reads_every_message_of_ours_with_the_schemas_in_the_file(tmp_path: Path) -> None:
    from mcap_ros2.decoder import DecoderFactory

    file = mcap_file(small_bag(tmp_path / "run", 60))
    with open(file, "rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        decoded = [d.decoded_message for d in reader.iter_decoded_messages()]
    assert [m.pose.pose.position.x for m in decoded[::2]] == [0.01 * i for i in range(0, 60, 2)]


def test_channels_carry_what_the_ros2_profile_asks_for(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "run", {"robot": "agriq"}, live=False) as bag:
        bag.register("/planned/path", "nav_msgs/msg/Path", LATCHED)
        bag.register("/imu/data", "sensor_msgs/msg/Imu", SENSOR)
        bag.register("/joint_states", JOINTS)
    with open(mcap_file(tmp_path / "run"), "rb") as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        (record,) = [r for r in reader.iter_metadata() if r.name == "artibot"]
    assert record.metadata == {"contract": "1", "robot": "agriq"}
    content = yaml.safe_load((tmp_path / "run" / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert content["version"] == 9
    entries = [entry["topic_metadata"] for entry in content["topics_with_message_count"]]
    listed = {entry["name"]: entry for entry in entries}
    for channel in summary.channels.values():
        schema = summary.schemas[channel.schema_id]
        assert (channel.message_encoding, schema.encoding) == ("cdr", "ros2msg")
        assert channel.metadata["topic_type_hash"] == STORE.hash_rihs01(schema.name)
        entry = listed[channel.topic]
        assert entry["type_description_hash"] == channel.metadata["topic_type_hash"]
        # where the two differ, rosbags yields no message and says nothing
        assert yaml.safe_load(channel.metadata["offered_qos_profiles"]) == entry["offered_qos_profiles"]
    assert listed["/planned/path"]["offered_qos_profiles"][0]["durability"] == "transient_local"
    assert listed["/imu/data"]["offered_qos_profiles"][0]["reliability"] == "best_effort"


@pytest.mark.parametrize("qos", [Qos(), LATCHED, SENSOR, Qos("best_effort", "transient_local", "unknown", 0)])
def test_qos_survives_writing_and_reading(qos: Qos) -> None:
    assert parse_qos(dump_profiles([qos.as_dict()])) == qos


def test_qos_in_numbers_as_before_version_9_is_understood() -> None:
    assert parse_qos("- history: 3\n  depth: 0\n  reliability: 2\n  durability: 1\n") == Qos(
        "best_effort", "transient_local", "unknown", 0
    )
    assert parse_qos("") == parse_qos("{ no yaml: [") == Qos()


def test_a_split_recording_is_one(tmp_path: Path) -> None:
    first = small_bag(tmp_path / "a", 100)
    later = [EPOCH + (100 + i) * STEP for i in range(20)]
    second = write_bag(
        tmp_path / "b",
        [("/motor_torques", JOINTS, joint_state(t, ["front_right"], velocity=[0.0]), t) for t in later],
    )
    both = tmp_path / "run"
    both.mkdir()
    mcap_file(first).rename(both / "run_0.mcap")
    mcap_file(second).rename(both / "run_10.mcap")
    experiment = read_bag(both)
    assert len(experiment.channels["motor_torques"]) == 70
    assert bag_info(both).message_count == 120


def test_a_file_without_index_is_read(tmp_path: Path) -> None:
    from mcap.writer import CompressionType, IndexType
    from mcap.writer import Writer as Plain

    text, type_hash = STORE.generate_msgdef(ODOMETRY, ros_version=2)[0], STORE.hash_rihs01(ODOMETRY)
    for chunking in (True, False):
        file = tmp_path / f"bare{chunking}.mcap"
        with open(file, "wb") as stream:
            writer = Plain(
                stream, compression=CompressionType.NONE, index_types=IndexType.NONE, use_chunking=chunking,
                repeat_channels=False, repeat_schemas=False, use_statistics=False, use_summary_offsets=False,
            )  # fmt: skip
            writer.start(profile="ros2")
            schema = writer.register_schema(ODOMETRY, "ros2msg", text.encode())
            channel = writer.register_channel("/odom", "cdr", schema, {"topic_type_hash": type_hash})
            for i in range(30):
                writer.add_message(channel, EPOCH + i * STEP, odometry(EPOCH + i * STEP, x=float(i)), EPOCH)
            writer.finish()
        assert read_bag(file).channels["odom"]["x"].tolist() == [float(i) for i in range(30)]
        assert bag_info(file).message_count == 30


def test_other_encodings_are_told_from_ros_2(tmp_path: Path) -> None:
    from mcap.writer import Writer as Plain

    file = tmp_path / "json.mcap"
    with open(file, "wb") as stream:
        writer = Plain(stream)
        writer.start()
        channel = writer.register_channel("/odom", "json", writer.register_schema("odom", "jsonschema", b"{}"))
        writer.add_message(channel, 1, b"{}", 1)
        writer.finish()
    with pytest.raises(ArtibotError, match=r"json\.mcap: no topic is encoded as cdr \(found: json\)"):
        read_bag(file)
