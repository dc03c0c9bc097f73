"""The driver's bus: found again where it was lost, and what a search finds after it was ended is nobody's."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import pytest

from artibot_driver.bus import Bus
from artibot_driver.config import DriverConfig, config_from_parameters
from artibot_driver.faults.live_loop import SwitchableLoopback
from artibot_driver.frames import Frame
from artibot_sim.nodes.driver import loop
from artibot_sim.nodes.driver.loop import BusKeeper, opened


@pytest.fixture
def place() -> Iterator[SwitchableLoopback]:
    found = SwitchableLoopback()
    yield found
    found.close()


@pytest.fixture
def config(place: SwitchableLoopback) -> DriverConfig:
    return config_from_parameters({"bus.interface": "remote", "bus.channel": place.channel})


def wait_for_search_to_end() -> None:
    until = time.monotonic() + 10.0
    while any(thread.name == "bus" for thread in threading.enumerate()):
        assert time.monotonic() < until
        time.sleep(0.02)


def test_a_lost_bus_is_found_again(place: SwitchableLoopback, config: DriverConfig) -> None:
    keeper = BusKeeper(config)
    keeper.open()
    place.down()
    assert keeper.again() is None
    place.up()
    until = time.monotonic() + 10.0
    while (found := keeper.again()) is None:
        assert time.monotonic() < until
        time.sleep(0.02)
    with place.open() as other:
        assert found.send(Frame(0x80, b""))
        assert other.receive(2.0) is not None
    assert keeper._search is None
    keeper.close()


def test_what_a_search_finds_after_its_end_is_closed_and_never_handed_out(
    place: SwitchableLoopback, config: DriverConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The node is cleaned up and configured again while a search is just opening a bus."""
    opening, go_on, late = threading.Event(), threading.Event(), []

    def slowly(config: DriverConfig) -> Bus:
        if threading.current_thread().name != "bus":
            return opened(config)
        opening.set()
        assert go_on.wait(10.0)
        late.append(opened(config))
        return late[-1]

    monkeypatch.setattr(loop, "opened", slowly)
    keeper = BusKeeper(config)
    first = keeper.open()
    assert keeper.again() is None
    assert opening.wait(10.0)
    keeper.close()
    second = keeper.open()
    go_on.set()
    wait_for_search_to_end()
    assert len(late) == 1
    assert not late[0].send(Frame(0x80, b""))  # closed
    assert not first.send(Frame(0x80, b""))
    assert second.send(Frame(0x80, b""))
    keeper.close()
