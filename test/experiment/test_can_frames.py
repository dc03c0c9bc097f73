"""CAN frames in recordings: any frame survives, and rosbags and mcap read what is written."""

from __future__ import annotations

import io
from pathlib import Path

import can
import numpy as np
import pytest
from bag_helpers import EPOCH, JOINTS, joint_state, mcap_file
from candump import line_of
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment import BagWriter, ChannelInfo, bag_info, recover
from artibot_sim.experiment.can_frames import (
    CAN_QOS,
    CAN_TOPIC,
    CanFrame,
    can_topics,
    encode_frame,
    frame_decoder,
    frame_of,
    is_candump,
    iter_candump,
    iter_frames,
)
from artibot_sim.experiment.messages import CAN_FRAME, definition, header, serialize

AS_ROSIDL_HASHES_IT = "RIHS01_0cdc7d15657573ee6ff151e5cc1943888301e370d957e2c077a154f4755fd976"
"""In the C code that rosidl generates for can_msgs."""

STAMPS = st.integers(1, 2**31 * 10**9 - 1)


@st.composite
def frames(draw: st.DrawFn) -> CanFrame:
    """Any frame of a classical bus, as SocketCAN hands them out."""
    kind = draw(st.sampled_from(("standard", "extended", "error")))
    remote = kind != "error" and draw(st.booleans())
    data = b"" if remote else draw(st.binary(max_size=8))
    dlc = draw(st.integers(0, 8)) if remote else len(data)
    if len(data) == 8:
        dlc = draw(st.integers(8, 15))  # a raw code beyond 8 means 8 bytes too
    number = draw(st.integers(0, 2**29 - 1 if kind == "extended" else 2**11 - 1))
    return CanFrame(draw(STAMPS), number, data, dlc, kind == "extended", remote, kind == "error")


def channel(text: str | None = None) -> ChannelInfo:
    known, type_hash = definition(CAN_FRAME)
    return ChannelInfo("/from_can_bus", CAN_FRAME, text or known, "ros2msg", "" if text else type_hash, "", "cdr")


DECODE = frame_decoder(channel())


@given(frame=frames(), frame_id=st.text("abcdefgh_0", max_size=9))
def test_any_frame_survives_and_is_the_message_that_rosbags_makes(frame: CanFrame, frame_id: str) -> None:
    data = encode_frame(frame, frame_id)
    assert DECODE(data) == frame
    eight = np.frombuffer(frame.data.ljust(8, b"\0"), np.uint8)
    assert data == serialize(
        CAN_FRAME, header=header(frame.stamp_ns, frame_id), id=frame.can_id, is_rtr=frame.is_remote,
        is_extended=frame.is_extended, is_error=frame.is_error, dlc=frame.dlc, data=eight,
    )  # fmt: skip


OTHERS_TEXT = (
    "# a comment\nstd_msgs/Header header\nuint32 id # 11 or 29 bits\nbool is_rtr\nbool is_extended\nbool is_error\n"
    "uint8 dlc\nuint8[8] data\n"
)
DECODE_OTHERS = frame_decoder(channel(OTHERS_TEXT))


@given(frame=frames())
def test_other_writers_definitions_and_byte_order_are_read(frame: CanFrame) -> None:
    message = STORE.deserialize_cdr(encode_frame(frame), CAN_FRAME)
    assert DECODE_OTHERS(bytes(STORE.serialize_cdr(message, CAN_FRAME, little_endian=False))) == frame


STORE = get_typestore(Stores.ROS2_JAZZY)
STORE.register(get_types_from_msg(definition(CAN_FRAME)[0].split("=" * 80)[0], CAN_FRAME))


def test_the_type_hash_is_that_of_the_real_package() -> None:
    assert definition(CAN_FRAME)[1] == AS_ROSIDL_HASHES_IT


@pytest.mark.parametrize(
    "frame",
    [CanFrame(1, 1, bytes(9), 9), CanFrame(1, 2**32, b"", 0), CanFrame(1, 1, b"", 256), CanFrame(2**63, 1, b"", 0)],
)
def test_what_the_message_cannot_hold_is_refused(frame: CanFrame) -> None:
    with pytest.raises(ArtibotError, match="no classical CAN frame"):
        encode_frame(frame)


def test_bytes_that_are_no_frame_are_refused_with_the_topic() -> None:
    with pytest.raises(ArtibotError, match=r"topic /from_can_bus: a message is no can_msgs/msg/Frame"):
        DECODE(b"\0\1\0\0\1")


def some(count: int, step_ns: int = 1000) -> list[CanFrame]:
    return [CanFrame(EPOCH + i * step_ns, 0x181 + i % 4, i.to_bytes(8, "little"), 8) for i in range(count)]


def frame_bag(folder: Path, given: list[CanFrame], topic: str = f"/{CAN_TOPIC}", others: bool = False) -> Path:
    with BagWriter(folder, {"robot": "agriq"}, live=False) as bag:
        bag.register(topic, CAN_FRAME, CAN_QOS)
        if others:
            bag.register("/joint_states", JOINTS)
        for frame in given:
            bag.write(topic, encode_frame(frame), frame.stamp_ns, frame.stamp_ns)
            if others:
                data = joint_state(frame.stamp_ns, ["a"], [0.0])
                bag.write("/joint_states", data, frame.stamp_ns, frame.stamp_ns)
    return folder


def test_rosbags_and_mcap_read_the_frames(tmp_path: Path) -> None:
    from mcap_ros2.decoder import DecoderFactory

    written = [*some(500), CanFrame(EPOCH + 10**9, 0x1ABCDEF, b"", 3, True, True)]
    folder = frame_bag(tmp_path / "run", written, others=True)
    seen = []
    with AnyReader([folder], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as bag:  # which checks the type hash
        (connection,) = [each for each in bag.connections if each.topic == "/from_can_bus"]
        assert connection.digest == AS_ROSIDL_HASHES_IT
        for _, stamp, data in bag.messages([connection]):
            message = bag.deserialize(data, CAN_FRAME)
            seen.append((stamp, message.id, bytes(message.data)[: message.dlc], message.is_extended, message.is_rtr))
    assert seen[:-1] == [(f.stamp_ns, f.can_id, f.data, False, False) for f in written[:-1]]
    assert seen[-1] == (EPOCH + 10**9, 0x1ABCDEF, bytes(3), True, True)
    with open(mcap_file(folder), "rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        decoded = [each.decoded_message for each in reader.iter_decoded_messages(topics=["/from_can_bus"])]
    assert [(m.id, bytes(m.data)[: m.dlc]) for m in decoded[:-1]] == [(f.can_id, f.data) for f in written[:-1]]
    assert decoded[0].header.frame_id == "can"


def test_frames_come_back_in_order_also_those_of_one_instant(tmp_path: Path) -> None:
    written = some(30_000, step_ns=0)  # several chunks
    folder = frame_bag(tmp_path / "run", written)
    assert list(iter_frames(folder, can_topics(bag_info(folder)))) == written


def test_part_of_the_time(tmp_path: Path) -> None:
    written = some(100)
    folder = frame_bag(tmp_path / "run", written)
    found = list(iter_frames(folder, ["/from_can_bus"], EPOCH + 10_000, EPOCH + 20_000))
    assert found == written[10:20]


def test_topics_with_frames_are_found_by_their_type(tmp_path: Path) -> None:
    info = bag_info(frame_bag(tmp_path / "run", some(3), topic="/rover1/from_can_bus", others=True))
    assert can_topics(info) == can_topics(info, ["rover1/from_can_bus"]) == ("/rover1/from_can_bus",)
    with pytest.raises(ArtibotError, match=r"no CAN frames on a topic '/from_can_bus'; expected one of /rover1/from"):
        can_topics(info, ["/from_can_bus"])
    with BagWriter(tmp_path / "none", live=False) as bag:
        bag.register("/odom", "nav_msgs/msg/Odometry")
    with pytest.raises(ArtibotError, match=r"none: no CAN frames: expected .* /from_can_bus by default, found /odom;"):
        can_topics(bag_info(tmp_path / "none"))


def test_buses_of_several_rovers_are_not_mixed(tmp_path: Path) -> None:
    """Their nodes have the same ids; what one bus says and is told is one thing, though it be two topics."""
    with BagWriter(tmp_path / "two", live=False) as bag:
        for topic in ("/rover1/from_can_bus", "/rover1/to_can_bus", "/rover2/from_can_bus"):
            bag.register(topic, CAN_FRAME)
    two = bag_info(tmp_path / "two")
    with pytest.raises(ArtibotError, match=r"several buses \(.*\); choose with --topic /rover1/from_can_bus$"):
        can_topics(two)
    both = ["/rover1/from_can_bus", "/rover1/to_can_bus"]
    assert can_topics(two, both) == tuple(both)
    with BagWriter(tmp_path / "one", live=False) as bag:
        for topic in both:
            bag.register(topic, CAN_FRAME)
    assert can_topics(bag_info(tmp_path / "one")) == tuple(both)


def test_a_cut_recording_keeps_its_frames(tmp_path: Path) -> None:
    written = some(40_000)
    file = mcap_file(frame_bag(tmp_path / "run", written))
    file.write_bytes(file.read_bytes()[: int(0.6 * file.stat().st_size)])
    (tmp_path / "run" / "metadata.yaml").unlink()
    report = recover(tmp_path / "run")
    found = list(iter_frames(report.out, ["/from_can_bus"]))
    assert found == written[: len(found)]
    assert len(found) > 15_000


MICROSECONDS = st.integers(1, 2**31 * 10**6 - 1).map(lambda us: 1000 * us)


@given(frame=frames().flatmap(lambda frame: MICROSECONDS.map(lambda ns: frame._replace(stamp_ns=ns))))
def test_any_frame_survives_a_line_of_candump(frame: CanFrame) -> None:
    assert frame_of(line_of(frame, "vcan0")) == frame


@given(frame=frames().filter(lambda frame: not frame.is_error and frame.dlc <= 8))
def test_data_and_remote_frames_are_read_as_python_can_reads_them(frame: CanFrame) -> None:
    line = line_of(frame)
    (theirs,) = can.CanutilsLogReader(io.StringIO(line + "\n"))
    ours = frame_of(line)
    assert ours is not None
    assert (ours.can_id, ours.data, ours.dlc) == (theirs.arbitration_id, bytes(theirs.data), theirs.dlc)
    assert (ours.is_extended, ours.is_remote) == (theirs.is_extended_id, theirs.is_remote_frame)
    assert 1e-9 * ours.stamp_ns == pytest.approx(theirs.timestamp, abs=1e-6)


def test_lines_that_candump_writes() -> None:
    lines = [
        "(1436509052.249713) vcan0 044#2A366C2BBA",
        "(1436509052.449847) vcan0 0F6#7ADFE07BD2 R",
        "",
        "(1436509053.850870) can0 1F334455#1122334455667788",
        "(1436509053.850871) can0 181##11122334455667788",
        "(1436509053.850872) can0 123#R5",
        "(1436509053.850873) can0 20000004#0004000000000000",
        "(1436509053.850874) can0 123#1122334455667788_F",
    ]
    found = list(iter_candump(lines, "log"))
    assert [(f.can_id, f.data.hex(), f.dlc, f.is_extended, f.is_remote, f.is_error) for f in found] == [
        (0x44, "2a366c2bba", 5, False, False, False),
        (0xF6, "7adfe07bd2", 5, False, False, False),
        (0x1F334455, "1122334455667788", 8, True, False, False),
        (0x123, "", 5, False, True, False),
        (0x4, "0004000000000000", 8, False, False, True),
        (0x123, "1122334455667788", 15, False, False, False),
    ]
    assert found[0].stamp_ns == 1436509052249713000


@pytest.mark.parametrize(
    "line", ["(1.5) can0 181#123", "(1.5) can0 81#12", "hello", "(1.5) can0 181#112233445566778899"]
)
def test_a_bad_line_is_named(line: str) -> None:
    with pytest.raises(ArtibotError, match=r"log: line 2: found "):
        list(iter_candump(["(1.5) can0 181#12", line], "log"))


def test_a_log_is_told_from_a_recording(tmp_path: Path) -> None:
    log = tmp_path / "log"
    log.write_text("(1436509052.249713) vcan0 044#2A366C2BBA\n")
    assert is_candump(log)
    assert not is_candump(mcap_file(frame_bag(tmp_path / "run", some(1))))
    assert not is_candump(tmp_path / "absent")
