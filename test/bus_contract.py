"""What any CAN bus must do for the driver: one abstract suite, run on the loopback bus and on a real vcan."""

from __future__ import annotations

import contextlib
import random
import threading
import time
from collections.abc import Iterator

import can
import canopen
import pytest
from canopen.profiles.p402 import BaseNode402
from drive_bench import running_drives

from artibot_driver.bus import Bus, BusState, open_bus
from artibot_driver.cia402 import DriveState
from artibot_driver.config import config_from_parameters
from artibot_driver.dictionary import load_dictionary
from artibot_driver.frames import Emcy, Frame, Heartbeat, NmtCommand, NmtState, heartbeat, nmt
from artibot_driver.pdo import Pdo
from artibot_driver.rig import Rig, load_rig

BusAddress = tuple[str, str]
"""Interface and channel."""


def random_frame(rng: random.Random) -> Frame:
    """A data frame with 11-bit identifier."""
    return Frame(rng.randrange(0x800), rng.randbytes(rng.randrange(9)))


def received(bus: Bus, timeout: float = 5.0) -> Frame:
    """The next frame, which must come."""
    message = bus.receive(timeout)
    assert message is not None, bus.health()
    assert not message.is_extended_id
    return Frame(message.arbitration_id, bytes(message.data))


class BusContract:
    """Inherit, and give a fixture ``address`` with the interface and channel of a fresh bus."""

    @pytest.fixture
    def pair(self, address: BusAddress) -> Iterator[tuple[Bus, Bus]]:
        with open_bus(*address) as one, open_bus(*address) as other:
            yield one, other

    @pytest.fixture
    def rig(self) -> Rig:
        return load_rig(config_from_parameters({}))

    @pytest.mark.parametrize("seed", [1, 2])
    def test_frames_cross_both_ways_unchanged_and_in_order(self, pair: tuple[Bus, Bus], seed: int) -> None:
        rng = random.Random(seed)
        for sender, receiver in (pair, pair[::-1]):
            frames = [random_frame(rng) for _ in range(300)]
            for start in range(0, 300, 50):  # a socket's buffer is not endless
                assert all(sender.send(frame) for frame in frames[start : start + 50])
                assert [received(receiver) for _ in range(50)] == frames[start : start + 50]
        assert pair[0].counters.sent == pair[0].counters.received == 300

    def test_a_bus_does_not_hear_itself_and_silence_is_none(self, pair: tuple[Bus, Bus]) -> None:
        assert pair[0].send(Frame(0x80, b""))
        assert received(pair[1]) == Frame(0x80, b"")
        assert pair[0].receive(0.05) is None
        assert pair[1].receive() is None

    def test_everyone_hears_everyone(self, address: BusAddress, pair: tuple[Bus, Bus]) -> None:
        with open_bus(*address) as third:
            for sender, listeners in ((pair[0], (pair[1], third)), (third, pair)):
                assert sender.send(Frame(0x123, b"abc"))
                assert [received(bus) for bus in listeners] == [Frame(0x123, b"abc")] * 2

    def test_foreign_kinds_of_frame_arrive_as_what_they_are(self, pair: tuple[Bus, Bus]) -> None:
        assert pair[0].send_message(can.Message(arbitration_id=0x1F334455, data=b"1", is_extended_id=True))
        request = can.Message(arbitration_id=0x181, is_remote_frame=True, is_extended_id=False, dlc=8)
        assert pair[0].send_message(request)
        extended, remote = (pair[1].receive(5.0) for _ in range(2))
        assert extended is not None
        assert (extended.arbitration_id, extended.is_extended_id) == (0x1F334455, True)
        assert remote is not None
        assert (remote.arbitration_id, remote.is_remote_frame) == (0x181, True)

    def test_a_fresh_bus_is_active_and_closes_twice(self, address: BusAddress) -> None:
        bus = open_bus(*address)
        health = bus.health()
        assert (health.state, health.reason) == (BusState.ACTIVE, "")
        assert health.state.carries_frames
        bus.close()
        bus.close()

    def test_what_was_sent_last_arrives_though_the_sender_closes(self, address: BusAddress) -> None:
        with open_bus(*address) as listener:
            with open_bus(*address) as chatter:
                for k in range(20):
                    assert listener.send(Frame(0x100 + k, b""))  # left unread by the one that closes
                assert chatter.send(Frame(0x181, b"last"))
            assert received(listener) == Frame(0x181, b"last")

    def test_a_canopen_node_is_set_up_as_the_rig_says_and_speaks_the_codec(self, address: BusAddress, rig: Rig) -> None:
        """canopen's node takes every setting from canopen's master, and our codec reads and writes its PDOs."""
        motor, node = "back_left", rig.config.node_ids["back_left"]
        with CanopenNetwork(address) as drives, CanopenNetwork(address) as masters, open_bus(*address) as ours:
            drive = drives.create_node(node, load_dictionary(node=node))
            drive.tpdo.read(from_od=True)
            drive.rpdo.read(from_od=True)
            master = masters.add_node(node, load_dictionary(node=node))
            for each in rig.settings(motor):
                variable = master.sdo[each.index]
                variable = variable[each.subindex] if not hasattr(variable, "raw") else variable
                if each.written:
                    variable.raw = each.value
                assert variable.raw == each.value, each
            collected = []
            drive.tpdo[1]["Statusword"].raw = 0x0237
            drive.tpdo[1]["Velocity actual value"].raw = -123456
            drive.tpdo[1]["Torque actual value"].raw = -250
            drive.tpdo[1].transmit()
            drive.emcy.send(0x8130, 0x11)
            assert ours.send(rig.codec.pdo("RPDO1", node, (0x0F, 1000, -77)))
            assert wait_for(lambda: drive.rpdo[1]["Target torque"].raw == -77)
            assert drive.rpdo[1]["Target velocity"].raw == 1000
            deadline = time.monotonic() + 5.0
            while len(collected) < 2 and time.monotonic() < deadline:
                message = ours.receive(0.2)
                decoded = rig.codec.decode_message(message) if message else None
                collected += [decoded] if isinstance(decoded, (Pdo, Emcy)) else []
        assert collected[0] == Pdo(node, rig.codec.maps["TPDO1"], (0x0237, -123456, -250))
        assert collected[1] == Emcy(node, 0x8130, 0x11, bytes(5))

    def test_canopen_s_master_sets_a_simulated_drive_up_drives_it_and_is_lost(
        self, address: BusAddress, rig: Rig
    ) -> None:
        node = rig.config.node_ids["front_left"]
        with CanopenNetwork(address) as network, open_bus(*address) as bus, running_drives(bus, rig) as drives:
            master = BaseNode402(node, load_dictionary(node=node))
            network.add_node(master)
            assert wait_for(lambda: drives["front_left"].nmt is NmtState.PRE_OPERATIONAL)
            assert master.sdo["Manufacturer device name"].raw == "artibot drive"
            for each in rig.settings("front_left"):
                variable = master.sdo[each.index]
                variable = variable[each.subindex] if not hasattr(variable, "raw") else variable
                if each.written:
                    variable.raw = each.value
                assert variable.raw == each.value, each
            with pytest.raises(canopen.SdoAbortedError, match="0x06010002"):
                master.sdo["Statusword"].raw = 1
            beat = network.send_periodic(0x700 + rig.config.driver_id, bytes((5,)), rig.config.driver_period)
            master.nmt.state = "OPERATIONAL"
            network.sync.start(0.01)
            master.setup_402_state_machine()
            with transmitted(master.rpdo[1], 0.01):  # canopen leaves a synchronous RPDO to be sent to others
                assert wait_for(lambda: master.state == "SWITCH ON DISABLED")
                master.state = "OPERATION ENABLED"
                assert wait_for(lambda: drives["front_left"].state is DriveState.OPERATION_ENABLED)
                master.rpdo[1]["Target velocity"].raw = 500_000
                assert wait_for(lambda: abs(master.tpdo[1]["Velocity actual value"].raw - 500_000) < 5_000)
            beat.stop()
            assert wait_for(lambda: drives["front_left"].state is DriveState.FAULT)
            assert [error.code for error in master.emcy.log] == [0x8130]
            assert drives["back_left"].state is DriveState.SWITCH_ON_DISABLED
            network.sync.stop()

    def test_canopen_understands_our_services(self, address: BusAddress) -> None:
        with CanopenNetwork(address) as network, open_bus(*address) as ours:
            remote = network.add_node(5, load_dictionary(node=5))
            local = network.create_node(6, load_dictionary(node=6))
            assert ours.send(heartbeat(5, NmtState.OPERATIONAL))
            assert wait_for(lambda: remote.nmt.state == "OPERATIONAL")
            for command, state in ((NmtCommand.START, "OPERATIONAL"), (NmtCommand.STOP, "STOPPED")):
                assert ours.send(nmt(command, 6))
                assert wait_for(lambda state=state: local.nmt.state == state)
            rig = load_rig(config_from_parameters({}))
            assert ours.send(rig.codec.emcy(5, 0x7305, 0x21, b"abcde"))
            assert wait_for(lambda: bool(remote.emcy.log))
            assert (remote.emcy.log[0].code, remote.emcy.log[0].data) == (0x7305, b"abcde")
            local.nmt.start_heartbeat(20)
            beats = [rig.codec.decode(*received(ours)) for _ in range(2)]
            local.nmt.stop_heartbeat()
        assert all(isinstance(beat, Heartbeat) and beat.node == 6 for beat in beats)


def wait_for(condition: object, timeout: float = 5.0) -> bool:
    """Whether `condition()` comes true in time."""
    assert callable(condition)
    deadline = time.monotonic() + timeout
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.005)
    return True


@contextlib.contextmanager
def transmitted(pdo: canopen.pdo.PdoMap, period: float) -> Iterator[None]:
    """Send a PDO every `period` seconds: python-can-remote's own periodic frames cannot change their data."""
    finished = threading.Event()

    def run() -> None:
        while not finished.wait(period):
            pdo.transmit()

    thread = threading.Thread(target=run, name="rpdo")
    thread.start()
    try:
        yield
    finally:
        finished.set()
        thread.join()


class CanopenNetwork:
    """canopen's network on a bus of its own, closed with the block."""

    def __init__(self, address: BusAddress) -> None:
        self._bus = open_bus(*address)
        self._network = canopen.Network(self._bus.raw)

    def __enter__(self) -> canopen.Network:
        self._network.connect()
        return self._network

    def __exit__(self, *_: object) -> None:
        self._network.notifier.stop()
        self._bus.close()
