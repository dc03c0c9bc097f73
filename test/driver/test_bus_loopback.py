"""The loopback bus across processes does what any bus must, and ends with whoever started it."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator

import can
import pytest
from bus_contract import BusAddress, BusContract, received, wait_for
from can_remote.websocket import get_accept_key

from artibot_driver.bus import BusState, open_bus
from artibot_driver.frames import Frame
from artibot_driver.loopback import HOST, loopback_bus
from artibot_driver.relay import RelayServer
from artibot_sim.errors import ArtibotError
from ros_helpers import ROOT


@pytest.fixture(scope="module")
def address() -> Iterator[BusAddress]:
    with loopback_bus() as channel:
        yield "remote", channel


class TestLoopback(BusContract):
    """All of :class:`BusContract`."""


def serve(*arguments: str) -> subprocess.Popen[str]:
    """A server as a user starts it."""
    command = [sys.executable, "-m", "artibot_driver.loopback", *arguments]
    return subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_server_started_by_hand_ends_on_a_signal(number: signal.Signals) -> None:
    server = serve()
    assert server.stdout is not None
    channel = server.stdout.readline().strip()
    with open_bus("remote", channel) as one, open_bus("remote", channel) as other:
        assert one.send(Frame(1, b"x"))
        assert received(other) == Frame(1, b"x")
        server.send_signal(number)
        _, said = server.communicate(timeout=10)
    assert (server.returncode, said) == (0, "")


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_a_lost_server_is_noticed_counted_and_never_raises(number: signal.Signals) -> None:
    server = serve()
    assert server.stdout is not None
    bus = open_bus("remote", server.stdout.readline().strip())
    server.send_signal(number)
    server.communicate(timeout=10)
    assert bus.receive(5.0) is None
    assert wait_for(lambda: bus.receive(0.01) is None and bus.health().state is BusState.LOST)
    assert not bus.health().state.carries_frames
    assert "connection lost" in bus.health().reason or "has closed" in bus.health().reason
    assert not bus.send(Frame(1, b""))
    assert bus.counters.not_sent == 1
    bus.close()


def test_a_server_that_hangs_holds_nobody_up_for_long() -> None:
    server = serve()
    assert server.stdout is not None
    bus = open_bus("remote", server.stdout.readline().strip())
    os.kill(server.pid, signal.SIGSTOP)
    try:
        begin = time.monotonic()
        while bus.send(Frame(0x181, bytes(8))):
            assert time.monotonic() - begin < 60
        assert bus.health().state is BusState.LOST
        bus.close()
    finally:
        os.kill(server.pid, signal.SIGKILL)
        server.communicate(timeout=10)


def test_nothing_is_kept_of_nodes_that_were_killed() -> None:
    server = RelayServer(HOST, 0)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    channel = f"ws://{HOST}:{server.server_port}/"
    hangs = "from artibot_driver.bus import open_bus\nimport sys, time\nbus = open_bus('remote', sys.argv[1])\n"
    hangs += "print('here', flush=True)\ntime.sleep(60)"  # killed with something unread, a node resets its connection
    with open_bus("remote", channel) as bus:
        for _ in range(3):
            with subprocess.Popen([sys.executable, "-c", hangs, channel], cwd=ROOT, stdout=subprocess.PIPE) as node:
                assert node.stdout is not None and node.stdout.readline()
                assert len(server.nodes) == 2
                for number in range(50):
                    bus.send(Frame(number, b""))
                node.kill()
            assert wait_for(lambda: bus.send(Frame(1, b"")) and len(server.nodes) == 1, 10.0)
    server.shutdown()
    server.server_close()


def test_a_node_that_does_not_read_holds_up_nobody_and_misses_nothing() -> None:
    server = RelayServer(HOST, 0)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    channel = f"ws://{HOST}:{server.server_port}/"
    numbers = [number.to_bytes(4, "big") for number in range(20_000)]
    with open_bus("remote", channel) as idle:
        (its,) = server.nodes
        its.socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 14)
        idle.raw.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 16)
        with open_bus("remote", channel) as one, open_bus("remote", channel) as other:
            for begin in range(0, len(numbers), 500):
                for number in numbers[begin : begin + 500]:
                    assert one.send(Frame(1, number))
                assert [received(other, 30.0).data for _ in range(500)] == numbers[begin : begin + 500]
            assert its.unsent, "what the kernel has no room for is the server's to keep"
            assert [received(idle, 30.0).data for _ in numbers] == numbers
            assert not its.unsent
    server.shutdown()
    server.server_close()


@pytest.mark.parametrize("plain", ["sender", "receiver"])
def test_python_can_s_own_nodes_are_served(address: BusAddress, plain: str) -> None:
    """Frames of either side of python-can-remote, masked as its clients do, and sent again and again by the server."""
    with open_bus(*address) as own, can.Bus(interface="remote", channel=address[1]) as theirs:
        sender, receiver = (theirs, own.raw) if plain == "sender" else (own.raw, theirs)
        for size in range(9):
            sender.send(can.Message(arbitration_id=0x100 + size, data=bytes(range(size)), is_extended_id=False))
            found = receiver.recv(5.0)
            assert found is not None and abs(found.timestamp - time.time()) < 60.0
            assert (found.arbitration_id, bytes(found.data)) == (0x100 + size, bytes(range(size)))
        task = sender.send_periodic(can.Message(arbitration_id=0x80, data=b"s", is_extended_id=False), 0.01)
        for _ in range(3):
            found = receiver.recv(5.0)
            assert found is not None and bytes(found.data) == b"s"
        task.stop()
        while receiver.recv(0.5) is not None:
            pass


def test_the_server_ends_with_the_process_that_started_it() -> None:
    begin = "from artibot_driver.loopback import loopback_bus\nimport os\nblock = loopback_bus()\n"
    command = [sys.executable, "-c", begin + "print(block.__enter__(), flush=True)\nos._exit(9)"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 9
    channel = done.stdout.strip()

    def refused() -> bool:
        try:
            open_bus("remote", channel).close()
        except ArtibotError as error:
            return "nobody answers there" in str(error)
        return False

    assert wait_for(refused, 10.0)


def test_a_server_that_ends_while_it_is_joined_does_not_answer() -> None:
    """It has taken the connection, and goes before the bus is open."""
    with socket.create_server((HOST, 0)) as server:

        def welcome() -> None:
            other, _ = server.accept()
            with other, other.makefile("rb") as asked:
                lines = iter(asked.readline, b"\r\n")
                key = next(line.split()[1].decode() for line in lines if line.lower().startswith(b"sec-websocket-key:"))
                for _ in lines:
                    pass
                upgrade = "HTTP/1.1 101 Switching Protocols", "Upgrade: WebSocket", "Connection: Upgrade"
                answer = *upgrade, f"Sec-WebSocket-Accept: {get_accept_key(key)}", "Sec-WebSocket-Protocol: can.json.v1"
                other.sendall("\r\n".join([*answer, "", ""]).encode())
                other.shutdown(socket.SHUT_WR)
                asked.read()

        leaving = threading.Thread(target=welcome, daemon=True)
        leaving.start()
        with pytest.raises(ArtibotError, match="nobody answers there"):
            open_bus("remote", f"ws://{HOST}:{server.getsockname()[1]}/")
        leaving.join(10.0)
        assert not leaving.is_alive()


def test_a_taken_port_says_so(address: BusAddress) -> None:
    port = int(address[1].rstrip("/").rpartition(":")[2])
    expected = rf"loopback bus: did not start: port {port} on 127.0.0.1: .*in use"
    with pytest.raises(ArtibotError, match=expected), loopback_bus(port):
        pass


def test_only_this_machine_is_served(address: BusAddress) -> None:
    assert address[1].startswith("ws://127.0.0.1:")


@pytest.mark.parametrize(
    ("interface", "channel", "message"),
    [
        (
            "remote",
            "ws://127.0.0.1:1/",
            r"bus ws://127.0.0.1:1/: nobody answers there .* artibot can loopback",
        ),
        ("carrier_pigeon", "x", r"bus carrier_pigeon x: cannot be opened: Unknown interface type"),
        ("socketcan", "nosuchcan0", r"bus nosuchcan0: (this machine's kernel has no CAN|there is no such interface)"),
    ],
)
def test_a_bus_that_cannot_be_opened_names_the_mend(interface: str, channel: str, message: str) -> None:
    with pytest.raises(ArtibotError, match=message):
        open_bus(interface, channel)
