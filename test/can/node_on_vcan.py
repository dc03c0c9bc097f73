"""Runs inside a kernel with CAN (test_driver_vcan.py starts it there): the suite of faults around the driver node."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from node_faults import NodeFaults, Rover, running_rover


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rover]:
    with running_rover(("socketcan", "vcan0"), tmp_path_factory.mktemp("faults")) as rover:
        yield rover


class TestVcan(NodeFaults):
    """All of :class:`NodeFaults`."""
