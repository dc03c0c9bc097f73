"""Runs inside a kernel with CAN (test_driver_vcan.py starts it there): the suite of faults around the driver node."""

from __future__ import annotations

import pytest
from node_faults import NodeFaults, Place


@pytest.fixture
def place() -> Place:
    return "socketcan", "vcan0"


class TestVcan(NodeFaults):
    """All of :class:`NodeFaults`."""
