"""Receiver a bus for hours: all frames of every kind, and a bus that goes away is said once and awaited."""

from __future__ import annotations

import socket
import subprocess
import sys
import time

import can
import pytest
from bus_contract import wait_for

from artibot_driver.bus import open_bus
from artibot_driver.listener import Listener, interface_of, stamp_ns
from artibot_driver.loopback import loopback_bus
from artibot_sim.errors import ArtibotError
from ros_helpers import ROOT


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def serve(port: int) -> subprocess.Popen[str]:
    """A loopback bus that a test can take away."""
    command = [sys.executable, "-m", "artibot_driver.loopback", "--port", str(port)]
    server = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
    assert server.stdout is not None
    assert server.stdout.readline().startswith("ws://")
    return server


def unsaid(bad: bool, text: str) -> None:
    raise AssertionError(text)


KINDS = [
    can.Message(arbitration_id=0x181, data=bytes(8), is_extended_id=False),
    can.Message(arbitration_id=0x1ABCDEF, data=b"abc", is_extended_id=True),
    can.Message(arbitration_id=0x123, dlc=5, is_remote_frame=True, is_extended_id=False),
    can.Message(arbitration_id=0x40, data=bytes(8), is_error_frame=True, is_extended_id=False),
]


def test_frames_of_every_kind_are_heard_with_their_time_of_arrival() -> None:
    with loopback_bus() as channel, open_bus("remote", channel) as sender:
        listener = Listener("remote", channel, lambda bad, text: None)  # an error frame is news
        before = time.time_ns()
        for message in KINDS:
            assert sender.send_message(message)
        heard = [listener.receive(5.0) for _ in KINDS]
        after = time.time_ns()
        for sent, got in zip(KINDS, heard, strict=True):
            assert got is not None
            assert sent.equals(got, timestamp_delta=None, check_channel=False, check_direction=False)
        stamps = [listener.arrival_ns(message) for message in heard if message is not None]
        assert before - 1_000_000 <= stamps[0] <= stamps[-1] <= after
        assert stamps == sorted(stamps)
        listener.close()


def test_a_burst_larger_than_a_batch_is_heard_in_full_and_in_order() -> None:
    with loopback_bus() as channel, open_bus("remote", channel) as sender:
        listener = Listener("remote", channel, unsaid)
        for k in range(700):
            sender.send_message(can.Message(arbitration_id=1, data=k.to_bytes(4, "big"), is_extended_id=False))
        heard = [listener.receive(5.0) for _ in range(700)]
        assert [int.from_bytes(message.data, "big") for message in heard if message is not None] == list(range(700))
        assert listener.receive(0.0) is None
        listener.close()


def test_a_bus_that_goes_away_is_said_once_and_heard_again_when_it_is_back() -> None:
    port = free_port()
    server = serve(port)
    said: list[tuple[bool, str]] = []
    listener = Listener("remote", f"ws://127.0.0.1:{port}/", lambda bad, text: said.append((bad, text)))
    try:
        server.kill()
        server.wait()
        assert wait_for(lambda: listener.receive(0.05) is None and bool(said), 10.0)
        begin = time.monotonic()
        for _ in range(20):
            assert listener.receive(0.1) is None
        assert time.monotonic() - begin > 0.3, "it waits, and is not busy"
        assert [bad for bad, _ in said] == [True]
        assert "waiting for it" in said[0][1]
        server = serve(port)
        assert wait_for(lambda: listener.receive(0.05) is None and len(said) == 2, 10.0)
        assert said[1][0] is False
        with open_bus("remote", listener.channel) as sender:
            sender.send_message(KINDS[0])
            assert wait_for(lambda: listener.receive(0.05) is not None, 10.0)
    finally:
        listener.close()
        server.kill()
        server.communicate()


def test_a_bus_that_is_not_there_is_refused() -> None:
    with pytest.raises(ArtibotError, match="nobody answers there"):
        Listener("remote", f"ws://127.0.0.1:{free_port()}/", unsaid)


def test_stamps_of_another_clock_are_not_believed() -> None:
    with loopback_bus() as channel, open_bus("remote", channel):
        listener = Listener("remote", channel, unsaid)
        now = time.time()
        listener.own_clock = True
        assert listener.arrival_ns(can.Message(timestamp=now)) == stamp_ns(can.Message(timestamp=now))
        assert abs(stamp_ns(can.Message(timestamp=now)) / 1e9 - now) < 1e-6
        listener.own_clock = False  # an adapter that counts from its own start
        assert abs(listener.arrival_ns(can.Message(timestamp=12.5)) / 1e9 - time.time()) < 5.0
        listener.close()


def test_the_interface_goes_with_the_channel() -> None:
    assert interface_of("can0") == "socketcan"
    assert interface_of("ws://127.0.0.1:5900/") == "remote"
    assert interface_of("PCAN_USBBUS1", "pcan") == "pcan"
