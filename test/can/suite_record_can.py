"""Runs inside a kernel with CAN: frames of can-utils, recorded by the real recorder and played back to candump."""

from __future__ import annotations

import re
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from bus_contract import wait_for

from artibot_driver.bus import open_bus
from artibot_driver.frames import Frame
from artibot_sim.experiment import bag_info, recover
from artibot_sim.experiment.can_frames import CanFrame, iter_candump, iter_frames
from ros_helpers import NodeProcess, NodeStarter

TOPIC = "/from_can_bus"


def listeners(channel: str) -> int:
    """How many sockets receive all frames of an interface."""
    with open("/proc/net/can/rcvlist_all", encoding="ascii") as listing:
        return sum(line.split()[:1] == [channel] for line in listing)


@contextmanager
def candump(file: Path, channel: str = "vcan0") -> Iterator[Path]:
    """A peer that nobody here wrote logs all frames, error frames too."""
    before = listeners(channel)
    with open(file, "wb") as sink:
        process = subprocess.Popen(["candump", "-L", "-r", "8000000", f"{channel},0:0,#FFFFFFFF"], stdout=sink)
        try:
            assert wait_for(lambda: listeners(channel) > before, 10.0)
            yield file
            assert wait_for(settled(file), 30.0)
        finally:
            process.terminate()
            process.wait()


def settled(file: Path) -> Callable[[], bool]:
    """Whether a file has not grown for half a second."""
    seen: list[tuple[float, int]] = []

    def done() -> bool:
        size = file.stat().st_size
        if not seen or seen[-1][1] != size:
            seen.append((time.monotonic(), size))
        return time.monotonic() - seen[-1][0] > 0.5

    return done


def logged(file: Path) -> list[CanFrame]:
    return list(iter_candump(file.read_text().splitlines(), str(file)))


def recorded(folder: Path) -> list[CanFrame]:
    return list(iter_frames(folder, [TOPIC]))


def without_stamps(frames: list[CanFrame]) -> list[CanFrame]:
    return [frame._replace(stamp_ns=0) for frame in frames]


def begin(start_node: NodeStarter, folder: Path, channel: str = "vcan0") -> NodeProcess:
    node = start_node("record", "-o", folder, "--can", channel)
    node.wait_for("from CAN bus", 60.0)
    return node


def end(node: NodeProcess) -> None:
    node.send(signal.SIGINT)
    assert node.wait(60) == 0


def cangen(*words: str) -> None:
    subprocess.run(["cangen", "vcan0", *words], check=True, capture_output=True)


def test_what_can_utils_send_is_recorded_byte_for_byte_in_order_and_played_again(
    start_node: NodeStarter, tmp_path: Path
) -> None:
    node = begin(start_node, tmp_path / "run")
    with candump(tmp_path / "log") as log:
        cangen("-g", "0.2", "-n", "1500", "-I", "r", "-L", "r", "-D", "r")
        cangen("-g", "0.2", "-n", "1000", "-e", "-I", "r", "-L", "r", "-D", "r")
        cangen("-g", "0.2", "-n", "500", "-R", "-I", "r", "-L", "r")
        for word in ("20000004#0004000000000000", "20000100#0000000000000000", "123#R5", "1F334455#", "000#0102"):
            subprocess.run(["cansend", "vcan0", word], check=True)
    end(node)
    sent = logged(log)
    assert len(sent) == 3005
    written = recorded(tmp_path / "run")
    assert without_stamps(written) == without_stamps(sent)
    assert all(abs(ours.stamp_ns - theirs.stamp_ns) < 2000 for ours, theirs in zip(written, sent, strict=True))
    assert "missed" not in node.output

    with candump(tmp_path / "again") as log:
        words = ("--can", "vcan0", "--can-only", "--can-frames", "all")
        node = start_node("replay", tmp_path / "run", *words)
        assert node.wait(120) == 0
    played = logged(log)
    assert without_stamps(played) == without_stamps([frame for frame in sent if not frame.is_error])
    length = (sent[-1].stamp_ns - sent[0].stamp_ns) / 1e9
    assert (played[-1].stamp_ns - played[0].stamp_ns) / 1e9 == pytest.approx(length, abs=0.5)
    print(node.output)


def test_a_killed_recorder_keeps_the_frames(start_node: NodeStarter, tmp_path: Path) -> None:
    node = begin(start_node, tmp_path / "run")
    with candump(tmp_path / "log") as log:
        cangen("-g", "1", "-n", "1500", "-I", "i", "-L", "8", "-D", "i")
        time.sleep(1.0)
        node.send(signal.SIGKILL)
        node.wait(10)
    saved = recorded(recover(tmp_path / "run").out)
    assert without_stamps(saved) == without_stamps(logged(log))


def test_an_interface_that_goes_down_or_away_is_said_and_heard_again(start_node: NodeStarter, tmp_path: Path) -> None:
    def ip(*words: str) -> None:
        subprocess.run(["ip", "link", *words], check=True, capture_output=True)

    ip("add", "dev", "vcan8", "type", "vcan")
    ip("set", "vcan8", "up")
    node = begin(start_node, tmp_path / "run", "vcan8")
    subprocess.run(["cansend", "vcan8", "181#01"], check=True)
    ip("set", "vcan8", "down")
    node.wait_for("CAN bus vcan8: interface down; the recording goes on")
    ip("set", "vcan8", "up")
    node.wait_for("CAN bus vcan8: error active")
    subprocess.run(["cansend", "vcan8", "181#02"], check=True)
    time.sleep(0.5)
    ip("del", "vcan8")
    node.wait_for("CAN bus vcan8: vcan8 is no longer there; waiting for it; the recording goes on")
    time.sleep(2.5)
    ip("add", "dev", "vcan8", "type", "vcan")
    ip("set", "vcan8", "up")
    node.wait_for("CAN bus vcan8: there again")
    subprocess.run(["cansend", "vcan8", "181#03"], check=True)
    time.sleep(0.5)
    end(node)
    ip("del", "vcan8")
    assert [frame.data for frame in recorded(tmp_path / "run")] == [b"\1", b"\2", b"\3"]
    assert node.output.count("no longer there") == 1


def test_frames_that_the_kernel_threw_away_are_counted_and_said(start_node: NodeStarter, tmp_path: Path) -> None:
    node = begin(start_node, tmp_path / "run")
    count = 40_000
    node.send(signal.SIGSTOP)
    with open_bus("socketcan", "vcan0") as bus:
        assert all(bus.send(Frame(0x181, k.to_bytes(8, "little"))) for k in range(count))
    node.send(signal.SIGCONT)
    node.wait_for("frames missed so far", 60.0)
    end(node)
    written = [int.from_bytes(frame.data, "little") for frame in recorded(tmp_path / "run")]
    assert written == sorted(set(written))
    found = re.search(r"(\d+) frames recorded, (\d+) missed \((\d+) not read in time\)", node.output)
    assert found is not None
    assert int(found[1]) == len(written) < count
    assert int(found[1]) + int(found[2]) == count
    assert bag_info(tmp_path / "run").message_count == len(written)
