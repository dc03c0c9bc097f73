"""Runs inside a kernel with CAN (test_bus_vcan.py starts it there): the bus suite on vcan0, and can-utils as peers."""

from __future__ import annotations

import random
import subprocess
import time
from collections.abc import Iterator

import pytest
from bus_contract import BusAddress, BusContract, random_frame, received, wait_for
from drive_bench import running_drives

from artibot_driver.bus import Bus, BusState, open_bus
from artibot_driver.cia402 import DriveState, state_of
from artibot_driver.config import config_from_parameters
from artibot_driver.frames import Emcy, Frame, NmtCommand, NmtState, heartbeat, nmt
from artibot_driver.pdo import Pdo
from artibot_driver.rig import load_rig
from artibot_sim.errors import ArtibotError

CODEC = load_rig(config_from_parameters({})).codec


def ip(*words: str) -> None:
    """`ip link …`, which must succeed."""
    subprocess.run(["ip", "link", *words], check=True, capture_output=True)


@pytest.fixture
def address() -> BusAddress:
    return "socketcan", "vcan0"


@pytest.fixture
def own_interface() -> Iterator[str]:
    """A virtual interface for one test, which may put it down or delete it."""
    ip("add", "dev", "vcan9", "type", "vcan")
    ip("set", "vcan9", "up")
    yield "vcan9"
    subprocess.run(["ip", "link", "del", "vcan9"], check=False, capture_output=True)


class TestVcan(BusContract):
    """All of :class:`BusContract`."""


def test_candump_shows_what_the_codec_encodes(address: BusAddress) -> None:
    frames = [
        CODEC.sync(),
        nmt(NmtCommand.START),
        heartbeat(127, NmtState.OPERATIONAL),
        CODEC.pdo("RPDO1", 3, (0x0F, 1000, -1)),
        CODEC.pdo("TPDO2", 4, (-1, 10, 0, 0)),
        CODEC.emcy(2, 0x8130, 0x11),
    ]
    command = ["candump", "-L", "-n", str(len(frames)), "vcan0"]
    with open_bus(*address) as bus, subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as dump:
        wait_until_listened("vcan0", 2)
        assert all(bus.send(frame) for frame in frames)
        shown, _ = dump.communicate(timeout=20)
    assert [line.split()[2] for line in shown.splitlines()] == [
        "080#", "000#0100", "77F#05", "203#0F00E8030000FFFF", "284#FFFFFFFF0A000000", "082#3081110000000000"
    ]  # fmt: skip


def wait_until_listened(channel: str, sockets: int) -> None:
    """Wait until so many sockets receive on `channel`."""

    def enough() -> bool:
        with open("/proc/net/can/rcvlist_all", encoding="ascii") as listing:
            return sum(line.split()[:1] == [channel] for line in listing) >= sockets

    assert wait_for(enough, 10.0)


def test_what_cansend_sends_is_decoded(address: BusAddress) -> None:
    with open_bus(*address) as bus:
        for word in ("181#3702E8030000F4FF", "081#3081110000000000", "181#37", "1F334455#00"):
            subprocess.run(["cansend", "vcan0", word], check=True)
        messages = [bus.receive(5.0) for _ in range(4)]
    pdo, emcy, cut, foreign = [CODEC.decode_message(message) for message in messages if message is not None]
    assert isinstance(pdo, Pdo)
    assert (state_of(pdo.value("statusword")), pdo.values[1:]) == (DriveState.OPERATION_ENABLED, (1000, -12))
    assert isinstance(emcy, Emcy)
    assert emcy.text.startswith("8130h heartbeat")
    assert cut.reason.startswith("TPDO1 of 1 bytes")  # type: ignore[union-attr]
    assert foreign.reason.startswith("extended frame")  # type: ignore[union-attr]


def test_an_interface_that_goes_down_is_noticed_and_used_again(own_interface: str) -> None:
    with open_bus("socketcan", own_interface) as bus, open_bus("socketcan", own_interface) as other:
        ip("set", own_interface, "down")
        assert bus.health().state is BusState.DOWN
        assert not bus.send(Frame(0x80, b""))
        assert bus.receive(0.05) is None
        assert other.receive(0.05) is None
        assert bus.counters.not_sent == 1
        assert "down" in bus.health().reason
        ip("set", own_interface, "up")
        assert bus.health().state is BusState.ACTIVE
        assert bus.send(Frame(0x80, b""))
        assert received(other) == Frame(0x80, b"")


def test_an_interface_that_vanishes_is_lost_for_good(own_interface: str) -> None:
    with open_bus("socketcan", own_interface) as bus:
        ip("del", own_interface)
        assert bus.health().state is BusState.LOST
        assert not bus.send(Frame(0x80, b""))
        assert bus.receive(0.01) is None
        assert bus.health().reason == "vcan9 is no longer there"


def test_an_interface_that_vanishes_is_noticed_by_use_alone(own_interface: str) -> None:
    with open_bus("socketcan", own_interface) as bus:
        ip("del", own_interface)
        for _ in range(3):
            bus.receive(0.01)
            assert not bus.send(Frame(0x80, b""))
        assert bus.health().state is BusState.LOST


ERRORS = [  # as a CAN controller's driver reports them; cansend can send error frames on vcan
    ("20000004#0004000000000000", BusState.WARNING),
    ("20000004#0020000000000000", BusState.PASSIVE),
    ("20000204#000C000000006080", BusState.WARNING),
    ("20000040#0000000000000000", BusState.BUS_OFF),
    ("20000100#0000000000000000", BusState.ACTIVE),
    ("20000004#0010000000000000", BusState.PASSIVE),
    ("20000004#0040000000000000", BusState.ACTIVE),
]


def test_error_frames_tell_the_controller_s_state(address: BusAddress) -> None:
    with open_bus(*address) as bus:
        for word, state in ERRORS:
            subprocess.run(["cansend", "vcan0", word], check=True)
            assert wait_for(lambda state=state: bus.receive(0.01) is None and bus.health().state is state), word
        subprocess.run(["cansend", "vcan0", "20000004#0001000000000000"], check=True)
        assert wait_for(lambda: bus.receive(0.01) is None and bus.counters.overruns == 1)
        health = bus.health()
        assert (health.tx_errors, health.rx_errors) == (0x60, 0x80)
        assert (health.state, health.reason) == (BusState.ACTIVE, "controller, overrun")
        assert (bus.counters.error_frames, bus.counters.restarts) == (len(ERRORS) + 1, 1)
        subprocess.run(["cansend", "vcan0", "20000040#0000000000000000"], check=True)
        subprocess.run(["cansend", "vcan0", "181#3702E8030000F4FF"], check=True)
        assert received(bus) == Frame(0x181, bytes.fromhex("3702E8030000F4FF"))  # not hidden by the error before it
        assert bus.health().state is BusState.BUS_OFF
        assert not bus.health().state.carries_frames


def test_bus_off_ends_where_the_interface_was_put_down_and_up(own_interface: str) -> None:
    with open_bus("socketcan", own_interface) as bus:
        subprocess.run(["cansend", own_interface, "20000040#0000000000000000"], check=True)
        assert wait_for(lambda: bus.receive(0.01) is None and bus.health().state is BusState.BUS_OFF)
        ip("set", own_interface, "down")
        assert bus.health().state is BusState.DOWN
        ip("set", own_interface, "up")
        assert bus.health().state is BusState.ACTIVE


@pytest.mark.parametrize(
    ("channel", "message"),
    [
        (
            "vcan7",
            r"vcan7: there is no such interface; sudo ip link add dev vcan7 type vcan; sudo ip",
        ),
        ("can0", r"can0: there is no such interface; connect the adapter"),
        ("lo", r"lo: is no CAN interface; `ip -br link show type can`"),
    ],
)
def test_a_missing_interface_names_the_mend(channel: str, message: str) -> None:
    with pytest.raises(ArtibotError, match=message):
        open_bus("socketcan", channel)


def test_an_interface_that_is_down_names_the_mend(own_interface: str) -> None:
    ip("set", own_interface, "down")
    with pytest.raises(ArtibotError, match=r"vcan9: the interface is down; sudo ip link set vcan9 up$"):
        open_bus("socketcan", own_interface)


def test_a_flood_is_survived_and_the_bus_works_after_it(address: BusAddress) -> None:
    rng = random.Random(3)
    with open_bus(*address) as bus, open_bus(*address) as other:
        sent = sum(other.send(random_frame(rng)) for _ in range(20_000))  # nobody reads: the socket's buffer overflows
        begin, taken = time.monotonic(), drained(bus)
        assert 0 < taken <= sent
        assert time.monotonic() - begin < 20
        assert other.send(Frame(0x80, b""))
        assert received(bus) == Frame(0x80, b"")
        assert bus.health().state is BusState.ACTIVE


def drained(bus: Bus) -> int:
    """How many frames wait in a bus's buffer."""
    count = 0
    while bus.receive(0.0) is not None:
        count += 1
    return count


def test_candump_and_cansend_talk_to_a_simulated_drive(address: BusAddress) -> None:
    rig = load_rig(config_from_parameters({}))
    with (
        open_bus(*address) as bus,
        subprocess.Popen(["candump", "-L", "vcan0"], stdout=subprocess.PIPE, text=True) as dump,
    ):
        wait_until_listened("vcan0", 2)
        with running_drives(bus, rig) as drives:
            assert wait_for(lambda: drives["back_left"].state is DriveState.SWITCH_ON_DISABLED)
            for word in (
                "604#4041600000000000",  # read 6041h
                "604#2F6060000A000000",  # 6060h: cyclic synchronous torque
                "000#0104",  # start node 4
                "204#0600000000000000",  # shutdown
                "080#",
                "204#0F00000000006400",  # enable operation, 100 ‰
                "080#",
            ):
                subprocess.run(["cansend", "vcan0", word], check=True)
            assert wait_for(lambda: drives["back_left"].state is DriveState.OPERATION_ENABLED)
            time.sleep(0.02)
            subprocess.run(["cansend", "vcan0", "080#"], check=True)
            time.sleep(0.1)
        dump.terminate()
        shown, _ = dump.communicate(timeout=20)
    lines = [line.split()[2] for line in shown.splitlines()]
    assert "704#00" in lines  # boot-up
    assert "584#4B41600070000000" in lines  # switch on disabled, voltage enabled
    assert "584#6060600000000000" in lines
    assert [line for line in lines if line.startswith("184#")][-1].endswith("6400")  # torque actual value, 100 ‰
