"""`artibot record --can` on a real bus: every frame is in the recording, whatever happens to bus or recorder."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import canopen
import cantools
import pytest
from bag_helpers import mcap_file
from drive_bench import running_drives
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from artibot_driver.bus import open_bus
from artibot_driver.config import config_from_parameters
from artibot_driver.dbc import dbc_text
from artibot_driver.explain import Explainer
from artibot_driver.frames import Frame, NmtCommand, nmt
from artibot_driver.rig import Rig, load_rig
from artibot_sim.experiment import bag_info, recover
from artibot_sim.experiment.can_frames import CanFrame, iter_frames
from artibot_sim.experiment.messages import CAN_FRAME
from ros_helpers import ROOT, NodeProcess, NodeStarter

if TYPE_CHECKING:
    from rclpy.context import Context

pytest.importorskip("rclpy", reason="needs ROS 2")

TOPIC = "/from_can_bus"
Pair = tuple[int, bytes]


class Ear:
    """Hears a bus beside the recorder."""

    def __init__(self, channel: str) -> None:
        self.heard: list[Pair] = []
        self._bus = open_bus("remote", channel)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while not self._stop.is_set():
            while (message := self._bus.receive(0.02)) is not None:
                self.heard.append((message.arbitration_id, bytes(message.data)))

    def end(self) -> list[Pair]:
        time.sleep(0.3)
        self._stop.set()
        self._thread.join()
        self._bus.close()
        return self.heard


@pytest.fixture
def rig() -> Rig:
    return load_rig(config_from_parameters({}))


@contextmanager
def recording(start_node: NodeStarter, folder: Path, channel: str, *args: object) -> Iterator[NodeProcess]:
    node = start_node("record", "-o", folder, "--can", channel, *args)
    node.wait_for("from CAN bus")
    yield node
    node.send(signal.SIGINT)
    assert node.wait(20) == 0


def frames_of(folder: Path) -> list[CanFrame]:
    return list(iter_frames(folder, [TOPIC]))


def by_identifier(pairs: list[Pair]) -> dict[int, list[bytes]]:
    """The data of each identifier's frames, in order."""
    found: dict[int, list[bytes]] = {}
    for can_id, data in pairs:
        found.setdefault(can_id, []).append(data)
    return found


def drive_for_a_while(channel: str, rig: Rig, cycles: int) -> None:
    """What a driver does, by canopen's own master and plain frames: set up, enable, turn, stop."""
    network = canopen.Network()
    with open_bus("remote", channel) as bus, running_drives(bus, rig):
        network.connect(interface="remote", channel=channel)
        try:
            for motor, node_id in rig.codec.nodes.items():
                node = network.add_node(canopen.RemoteNode(node_id, rig.dictionary))
                node.sdo.RESPONSE_TIMEOUT = 2.0
                node.sdo[0x6085].raw = 100_000
                node.sdo[0x6060].raw = int(rig.config.mode(motor))
            network.nmt.send_command(NmtCommand.START)
            for k in range(cycles):
                word = (0x06, 0x0F)[k > 5]
                for node_id in rig.codec.nodes.values():
                    frame = rig.codec.pdo("RPDO1", node_id, (word, 1000 * k, k))
                    network.send_message(frame.can_id, frame.data)
                network.send_message(rig.codec.sync_id, b"")
                time.sleep(0.01)
        finally:
            network.disconnect()


def test_a_driven_rig_is_recorded_in_full_and_decoded_as_cantools_does(
    start_node: NodeStarter, tmp_path: Path, channel: str, rig: Rig
) -> None:
    ear = Ear(channel)
    with recording(start_node, tmp_path / "run", channel):
        before = time.time_ns()
        drive_for_a_while(channel, rig, 150)
        heard = ear.end()
        after = time.time_ns()
    written = frames_of(tmp_path / "run")
    # each identifier has one sender; frames that two send at once the loopback bus may hand out in either order
    assert by_identifier([(f.can_id, f.data) for f in written]) == by_identifier(heard)
    assert len(written) > 150 * 13
    stamps = [frame.stamp_ns for frame in written]
    assert stamps == sorted(stamps)
    assert before <= stamps[0] <= stamps[-1] <= after

    info = bag_info(tmp_path / "run")
    assert info.metadata["can"] == f"remote {channel}"
    with AnyReader([tmp_path / "run"], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as bag:
        messages = [bag.deserialize(data, CAN_FRAME) for _, _, data in bag.messages()]
    assert [(m.id, bytes(m.data)[: m.dlc]) for m in messages] == [(f.can_id, f.data) for f in written]
    with open(mcap_file(tmp_path / "run"), "rb") as stream:
        from mcap_ros2.decoder import DecoderFactory

        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        decoded = [each.decoded_message for each in reader.iter_decoded_messages()]
    assert [(m.id, bytes(m.data)[: m.dlc]) for m in decoded] == [(f.can_id, f.data) for f in written]

    explainer = Explainer(rig)
    database = cantools.database.load_string(dbc_text(rig), "dbc")
    kinds = set()
    for frame in written:
        found = explainer.explain(frame)
        kinds.add(found.kind)
        if found.kind in ("rpdo", "tpdo"):
            physical = database.decode_message(frame.can_id, frame.data, decode_choices=False)
            assert {v.name: v.raw if v.si is None else v.si for v in found.values} == physical
            assert database.get_message_by_frame_id(frame.can_id).name == f"{found.node}_{found.what.lower()}"
    assert kinds == {"rpdo", "tpdo", "sync", "nmt", "heartbeat", "sdo"}


def test_frames_beside_topics_and_both_without_loss(
    start_node: NodeStarter, ros_context: Context, tmp_path: Path, channel: str
) -> None:
    from rclpy.node import Node
    from sensor_msgs.msg import JointState

    probe = Node("probe", context=ros_context)
    publisher = probe.create_publisher(JointState, "/motor_torques", 500)
    with recording(start_node, tmp_path / "run", channel) as node, open_bus("remote", channel) as bus:
        node.wait_for("recording /motor_torques")
        time.sleep(0.5)
        begin = time.monotonic()
        for k in range(400):
            for n in range(10):
                assert bus.send(Frame(0x181, (10 * k + n).to_bytes(8, "little")))
            publisher.publish(JointState(name=["front_right"], velocity=[float(k)]))
            time.sleep(max(0.0, begin + 0.0025 * (k + 1) - time.monotonic()))
        time.sleep(0.5)
    counts = {c.topic: c.message_count for c in bag_info(tmp_path / "run").channels}
    assert counts == {TOPIC: 4000, "/motor_torques": 400}
    assert [int.from_bytes(f.data, "little") for f in frames_of(tmp_path / "run")] == list(range(4000))
    assert "missed" not in node.output


def test_a_namespace_moves_the_topic_and_parameters_name_the_bus(
    start_node: NodeStarter, tmp_path: Path, channel: str
) -> None:
    words = ("--ros-args", "-r", "__ns:=/rover1", "-p", f"can_channel:={channel}", "-p", "can_interface:=remote")
    node = start_node("record", "-o", tmp_path / "run", *words)
    node.wait_for("recording /rover1/from_can_bus")
    with open_bus("remote", channel) as bus:
        assert bus.send(nmt(NmtCommand.STOP))
    time.sleep(0.3)
    assert node.stop() == 0
    (info,) = bag_info(tmp_path / "run").channels
    assert (info.topic, info.ros_type, info.message_count) == ("/rover1/from_can_bus", CAN_FRAME, 1)


def test_a_killed_recorder_loses_at_most_a_second_of_frames(
    start_node: NodeStarter, tmp_path: Path, channel: str
) -> None:
    node = start_node("record", "-o", tmp_path / "run", "--can", channel)
    node.wait_for("from CAN bus")
    with open_bus("remote", channel) as bus:
        count, begin = 0, time.monotonic()
        while time.monotonic() - begin < 3.0:
            assert bus.send(Frame(0x181, count.to_bytes(8, "little")))
            count += 1
            time.sleep(0.001)
        last = time.time_ns()
        node.send(signal.SIGKILL)
        node.wait(10)
    saved = frames_of(recover(tmp_path / "run").out)
    assert [int.from_bytes(frame.data, "little") for frame in saved] == list(range(len(saved)))
    assert last - saved[-1].stamp_ns <= 1_000_000_000


def test_a_bus_lost_on_the_way_is_said_once_and_the_recording_goes_on(
    start_node: NodeStarter, ros_context: Context, tmp_path: Path
) -> None:
    from rclpy.node import Node
    from sensor_msgs.msg import JointState

    server = subprocess.Popen(
        [sys.executable, "-m", "artibot_driver.loopback"], cwd=ROOT, stdout=subprocess.PIPE, text=True
    )
    assert server.stdout is not None
    channel = server.stdout.readline().strip()
    probe = Node("probe", context=ros_context)
    publisher = probe.create_publisher(JointState, "/motor_torques", 500)
    try:
        with recording(start_node, tmp_path / "run", channel) as node:
            node.wait_for("recording /motor_torques")
            with open_bus("remote", channel) as bus:
                for k in range(50):
                    assert bus.send(Frame(0x181, bytes([k])))
                time.sleep(0.3)
            server.kill()
            node.wait_for("waiting for it; the recording goes on")
            for k in range(100):
                publisher.publish(JointState(name=["front_right"], velocity=[float(k)]))
                time.sleep(0.02)
            time.sleep(0.5)
    finally:
        server.kill()
        server.communicate()
    assert node.output.count("CAN bus") == 2  # recorded from, lost
    counts = {c.topic: c.message_count for c in bag_info(tmp_path / "run").channels}
    assert counts == {TOPIC: 50, "/motor_torques": 100}


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (("--can", "ws://127.0.0.1:9/"), "nobody answers there"),
        (("--can-interface", "remote"), "of which bus? give --can CHANNEL too"),
        (("--can", "vcan77"), "bus vcan77: "),
    ],
)
def test_a_bus_that_cannot_be_opened_is_refused_and_leaves_nothing(
    start_node: NodeStarter, tmp_path: Path, args: tuple[str, ...], said: str
) -> None:
    node = start_node("record", "-o", tmp_path / "run", *args)
    assert node.wait(20) == 2
    assert said in node.output
    assert not (tmp_path / "run").exists()
