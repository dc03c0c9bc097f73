"""Runs inside a kernel with CAN (test_bus_vcan.py starts it there): what must follow a fault does so on vcan0."""

from __future__ import annotations

import pytest
from safety_contract import SafetyContract

from artibot_driver.faults.live_loop import SwitchableSocketCan


@pytest.fixture
def site() -> SwitchableSocketCan:
    return SwitchableSocketCan("vcan0")


@pytest.fixture
def words() -> tuple[str, str]:
    return "socketcan", "vcan0"


class TestVcan(SafetyContract):
    """All of :class:`SafetyContract`."""
