"""Recorded frames sent again: commands only when asked for, none lost, and not where somebody sends them already."""

from __future__ import annotations

import threading
import time
from typing import NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

from artibot_driver.bus import open_bus
from artibot_driver.config import config_from_parameters
from artibot_driver.explain import Explainer
from artibot_driver.frames import Frame, NmtState, heartbeat
from artibot_driver.loopback import loopback_bus
from artibot_driver.playback import (
    FrameChoice,
    Sender,
    Which,
    check_alone,
    identifiers_from_drives,
    identifiers_of_commands,
)
from artibot_driver.rig import load_rig
from artibot_sim.errors import ArtibotError

RIG = load_rig(config_from_parameters({}))
FROM_DRIVES = identifiers_from_drives(RIG.codec)
COMMANDS = identifiers_of_commands(RIG.codec, RIG.config.driver_id)
EXPLAINER = Explainer(RIG)


class Recorded(NamedTuple):
    """A frame as a recording has it."""

    can_id: int
    data: bytes
    dlc: int
    is_extended: bool = False
    is_remote: bool = False
    is_error: bool = False


@given(can_id=st.integers(0, 0x7FF), data=st.binary(max_size=8))
def test_what_moves_motors_is_told_from_what_drives_say(can_id: int, data: bytes) -> None:
    frame = Recorded(can_id, data, len(data))
    found = EXPLAINER.explain(frame)
    ours = found.node in RIG.codec.nodes
    drives = FrameChoice(Which.DRIVES, RIG.codec, RIG.config.driver_id).wants(frame)
    commands = FrameChoice(Which.COMMANDS, RIG.codec, RIG.config.driver_id).wants(frame)
    assert not (drives and commands)
    from_them = found.kind in ("tpdo", "emcy", "heartbeat") or found.what.endswith("answer")
    to_them = found.kind in ("rpdo", "nmt", "sync") or found.what.endswith("request")
    if from_them:
        assert drives == ours
    if to_them:
        assert commands == (ours or found.kind in ("nmt", "sync"))
    if found.kind == "heartbeat":
        assert commands == (found.node == "driver")
    if found.kind == "other":
        assert not drives and not commands


def test_the_two_share_nothing() -> None:
    assert not FROM_DRIVES & COMMANDS
    pdos = {each.id_of(node) for each in RIG.codec.maps.values() for node in RIG.codec.nodes.values()}
    assert pdos <= FROM_DRIVES | COMMANDS


def test_all_is_all_but_error_frames() -> None:
    chooser = FrameChoice(Which.ALL, RIG.codec, RIG.config.driver_id)
    assert chooser.wants(Recorded(0x1ABCDEF, b"", 0, is_extended=True))
    assert chooser.wants(Recorded(5, b"", 3, is_remote=True))
    assert not chooser.wants(Recorded(0x40, bytes(8), 8, is_error=True))
    drives = FrameChoice(Which.DRIVES, RIG.codec, RIG.config.driver_id)
    assert not drives.wants(Recorded(0x181, b"", 0, is_extended=True))
    assert not drives.wants(Recorded(0x181, b"", 8, is_remote=True))


def test_frames_of_every_kind_go_out_unchanged() -> None:
    frames = [
        Recorded(0x181, b"12345678", 8),
        Recorded(0x1ABCDEF, b"1", 1, is_extended=True),
        Recorded(0x33, b"", 6, is_remote=True),
    ]
    with loopback_bus() as channel, open_bus("remote", channel) as bus, open_bus("remote", channel) as other:
        sender = Sender(bus)
        assert all(sender.send(frame) for frame in frames)
        got = [other.receive(5.0) for _ in frames]
        seen = [(m.arbitration_id, m.dlc, m.is_extended_id, m.is_remote_frame) for m in got if m is not None]
        assert seen == [(f.can_id, f.dlc, f.is_extended, f.is_remote) for f in frames]
        assert (sender.sent, sender.failed) == (3, 0)


def test_a_bus_that_is_gone_is_given_up_soon_and_counted() -> None:
    with loopback_bus() as channel:
        bus = open_bus("remote", channel)
    sender = Sender(bus)
    begin = time.monotonic()
    outcomes = [sender.send(Recorded(1, b"", 0)) for _ in range(20)]
    assert not outcomes[-1]
    assert time.monotonic() - begin < 5.0
    assert sender.failed >= 18  # the first may go into a socket whose other end has not said goodbye yet
    bus.close()


def test_it_does_not_begin_where_somebody_sends_the_same() -> None:
    with loopback_bus() as channel, open_bus("remote", channel) as bus, open_bus("remote", channel) as drive:
        check_alone(bus, FROM_DRIVES)
        stop = threading.Event()

        def beat() -> None:
            while not stop.wait(0.02):
                drive.send(heartbeat(1, NmtState.OPERATIONAL))
                drive.send(Frame(0x3FF, b""))

        thread = threading.Thread(target=beat)
        thread.start()
        try:
            with pytest.raises(ArtibotError, match="somebody sends frame 701 there, which is to be played"):
                check_alone(bus, FROM_DRIVES)
            check_alone(bus, COMMANDS)
        finally:
            stop.set()
            thread.join()
