"""What must follow a fault does so on the loopback bus."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from safety_contract import SafetyContract

from artibot_driver.faults.live_loop import SwitchableLoopback


@pytest.fixture(scope="module")
def site() -> Iterator[SwitchableLoopback]:
    bus = SwitchableLoopback()
    yield bus
    bus.close()


@pytest.fixture
def words(site: SwitchableLoopback) -> tuple[str, str]:
    return "remote", site.channel


class TestLoopback(SafetyContract):
    """All of :class:`SafetyContract`."""
