"""`artibot replay --can`: recorded frames on a real bus, none lost or reordered, and no command unless asked for."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from bag_helpers import EPOCH, JOINTS, joint_state
from replay_probe import Listener, recorded

from artibot_driver.bus import open_bus
from artibot_driver.config import config_from_parameters
from artibot_driver.frames import Frame, NmtCommand, NmtState, heartbeat, nmt
from artibot_driver.rig import load_rig
from artibot_sim.experiment import BagWriter
from artibot_sim.experiment.can_frames import CAN_QOS, CanFrame, encode_frame
from artibot_sim.experiment.messages import CAN_FRAME
from ros_helpers import ROOT, NodeStarter

if TYPE_CHECKING:
    from rclpy.context import Context

pytest.importorskip("rclpy", reason="needs ROS 2")

CODEC = load_rig(config_from_parameters({})).codec
CYCLES = 100
COMMANDS = (CODEC.sync_id, 0, 0x77F, *(0x200 + n for n in range(1, 5)), *(0x600 + n for n in range(1, 5)))
Pair = tuple[int, bytes]


def cycle(k: int) -> list[Frame]:
    """What is on the bus in one period, and now and then what is not: SDOs, heartbeats, NMT, strangers."""
    nodes = CODEC.nodes.values()
    sent = [CODEC.pdo("RPDO1", n, (0x0F, 100 * k, k)) for n in nodes] + [CODEC.sync()]
    sent += [CODEC.pdo("TPDO1", n, (0x237, 100 * k + n, k)) for n in nodes]
    if k % 10 == 0:
        sent += [heartbeat(n, NmtState.OPERATIONAL) for n in nodes] + [heartbeat(127, NmtState.OPERATIONAL)]
        sent += [Frame(0x601, b"\x40\x41\x60" + bytes(5)), Frame(0x581, b"\x4b\x41\x60\x00\x37\x02\0\0")]
        sent += [nmt(NmtCommand.START), CODEC.emcy(3, 0x8130, 1), Frame(0x3FF, bytes([k]))]
    return sent


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bags") / "driven"
    with BagWriter(folder, live=False) as writer:
        writer.register("/from_can_bus", CAN_FRAME, CAN_QOS)
        writer.register("/motor_torques", JOINTS)
        for k in range(CYCLES):
            start = EPOCH + 10_000_000 * k
            for i, frame in enumerate(cycle(k)):
                stamp = start + 100_000 * i
                message = encode_frame(CanFrame(stamp, frame.can_id, frame.data, len(frame.data)))
                writer.write("/from_can_bus", message, stamp, stamp)
            writer.write("/motor_torques", joint_state(start, ["front_right"], velocity=[float(k)]), start, start)
        error = CanFrame(EPOCH, 0x40, bytes(8), 8, is_error=True)
        writer.write("/from_can_bus", encode_frame(error), EPOCH + 5_000_000, EPOCH + 5_000_000)
    return folder


def frames(first: int = 0, last: int = CYCLES) -> list[Pair]:
    return [(frame.can_id, frame.data) for k in range(first, last) for frame in cycle(k)]


def from_drives(pairs: list[Pair]) -> list[Pair]:
    return [pair for pair in pairs if pair[0] not in COMMANDS and pair[0] != 0x3FF]


@contextmanager
def hearing(channel: str) -> Iterator[list[Pair]]:
    """What passes on a bus."""
    heard: list[Pair] = []
    stop = threading.Event()
    with open_bus("remote", channel) as bus:

        def run() -> None:
            while not stop.is_set():
                while (message := bus.receive(0.02)) is not None:
                    heard.append((message.arbitration_id, bytes(message.data)))

        thread = threading.Thread(target=run)
        thread.start()
        try:
            yield heard
            time.sleep(0.3)
        finally:
            stop.set()
            thread.join()


def test_by_default_only_what_the_drives_sent_is_played_beside_the_topics(
    start_node: NodeStarter, ros_context: Context, bag: Path, channel: str, tmp_path: Path
) -> None:
    listener = Listener(ros_context, {"/motor_torques": JOINTS})
    with listener.listening(), hearing(channel) as heard:
        node = start_node("replay", bag, "--can", channel, "--wait", 1, "--stats", tmp_path / "stats.json")
        assert node.wait() == 0
    assert heard == from_drives(frames())
    assert listener.bytes_of("/motor_torques") == recorded(bag)["/motor_torques"]
    found = json.loads((tmp_path / "stats.json").read_text())
    assert found["topics"] == {"/from_can_bus": len(heard), "/motor_torques": CYCLES}
    assert found["not_sent"] == 0
    by_topic = found["late_p99_ms_by_topic"]
    assert set(by_topic) == set(found["topics"])
    assert max(by_topic.values()) <= found["late_max_ms"]
    assert "WILL MOVE" not in node.output


@pytest.mark.parametrize("which", ["commands", "all"])
def test_commands_are_played_only_when_asked_for_and_not_without_a_warning(
    start_node: NodeStarter, bag: Path, channel: str, which: str
) -> None:
    with hearing(channel) as heard:
        node = start_node("replay", bag, "--can", channel, "--can-only", "--can-frames", which)
        assert node.wait() == 0
    expected = frames() if which == "all" else [pair for pair in frames() if pair[0] in COMMANDS]
    assert heard == expected
    assert "WILL MOVE their motors" in node.output


def test_without_the_option_no_frame_is_played_and_the_reader_is_told(
    start_node: NodeStarter, bag: Path, channel: str
) -> None:
    with hearing(channel) as heard:
        node = start_node("replay", bag)
        assert node.wait() == 0
    assert heard == []
    assert "CAN frames stay out: /from_can_bus (--can CHANNEL plays them on a bus)" in node.output


def test_part_of_the_time_faster_and_again(start_node: NodeStarter, bag: Path, channel: str) -> None:
    part = ("--start", 0.2, "--end", 0.399, "--rate", 2)
    with hearing(channel) as heard:
        begin = time.monotonic()
        node = start_node("replay", bag, "--can", channel, "--can-only", *part)
        assert node.wait() == 0
        assert time.monotonic() - begin >= 0.19 / 2
    once = from_drives(frames(20, 40))
    assert heard == once
    with hearing(channel) as heard:
        node = start_node("replay", bag, "--can", channel, "--can-only", "--loop", *part)
        while len(heard) < 3 * len(once):
            assert node.running
            time.sleep(0.02)
        node.send(signal.SIGINT)
        assert node.wait() == 0
    assert heard[: 3 * len(once)] == 3 * once
    assert "ended: " in node.output


def test_frames_alone_need_no_ros(bag: Path, channel: str) -> None:
    code = (
        "import sys\n"
        "sys.modules['rclpy'] = None\n"  # importing it fails, as where it is not installed
        "from artibot_sim.cli import main\n"
        f"sys.exit(main(['replay', {str(bag)!r}, '--can', {channel!r}, '--can-only']))\n"
    )
    with hearing(channel) as heard:
        done = subprocess.run(
            [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False, env=dict(os.environ)
        )
    assert done.returncode == 0, done.stderr
    assert heard == from_drives(frames())


def test_a_bus_with_drives_on_it_is_left_alone(start_node: NodeStarter, bag: Path, channel: str) -> None:
    stop = threading.Event()
    with open_bus("remote", channel) as drive, hearing(channel) as heard:

        def beat() -> None:
            while not stop.wait(0.05):
                drive.send(heartbeat(2, NmtState.OPERATIONAL))

        thread = threading.Thread(target=beat)
        thread.start()
        try:
            node = start_node("replay", bag, "--can", channel)
            assert node.wait() == 2
        finally:
            stop.set()
            thread.join()
    assert "somebody sends frame 702 there" in node.output
    assert {pair[0] for pair in heard} == {0x702}


def test_frames_that_cannot_be_sent_are_said_and_the_status_tells(
    start_node: NodeStarter, bag: Path, tmp_path: Path
) -> None:
    server = subprocess.Popen(
        [sys.executable, "-m", "artibot_driver.loopback"], cwd=ROOT, stdout=subprocess.PIPE, text=True
    )
    assert server.stdout is not None
    channel = server.stdout.readline().strip()
    try:
        node = start_node("replay", bag, "--can", channel, "--can-only", "--loop", "--stats", tmp_path / "stats.json")
        node.wait_for("playing the CAN frames")
        time.sleep(0.5)
        server.kill()
        node.wait_for("a frame could not be sent")
        node.send(signal.SIGINT)
        assert node.wait() == 1
    finally:
        server.kill()
        server.communicate()
    assert node.output.count("could not be sent") == 1
    assert json.loads((tmp_path / "stats.json").read_text())["not_sent"] > 0


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (("--can-only",), "--can-only needs --can CHANNEL"),
        (("--can-frames", "all"), "--can-frames needs --can CHANNEL"),
        (("--can", "ws://127.0.0.1:9/"), "nobody answers there"),
        (("--can", "vcan0", "--drive"), "--can does not work with --drive"),
        (("--can", "vcan0", "--can-only", "-t", "/odom"), "--topics does not work with --can-only"),
        (("--can", "vcan0", "--can-topic", "/motor_torques"), "expected one of /from_can_bus"),
        (("-t", "/from_can_bus"), "it is published only with --drive"),
    ],
)
def test_what_cannot_be_done_is_refused(start_node: NodeStarter, bag: Path, args: tuple[str, ...], said: str) -> None:
    node = start_node("replay", bag, *args)
    assert node.wait() == 2
    assert said in " ".join(node.output.split())
