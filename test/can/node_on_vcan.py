"""Runs inside a kernel with CAN (test_driver_vcan.py starts it there): the suite of faults around the driver node."""

from __future__ import annotations

import os

import pytest
from node_faults import NodeFaults, Place


@pytest.fixture
def place() -> Place:
    return "socketcan", "vcan0"


class TestVcan(NodeFaults):
    """All of :class:`NodeFaults`; at half the rate where one slow emulated processor is all there is.

    There the driver's loop alone is tens of milliseconds late, and a planner takes the processor from it for seconds.
    What a bad command does has nothing to do with the bus.
    """

    if "IN_UML" in os.environ:
        SYNC_RATE, STEP_MS = 50, 5
        BY_DRIVER, BY_DRIVES = 0.3, 0.4
        test_planner_killed = test_bad_commands = None
