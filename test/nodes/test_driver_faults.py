"""The suite of faults around the driver node, on a loopback bus between processes."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from node_faults import NodeFaults, Place

from artibot_driver.loopback import loopback_bus


@pytest.fixture
def place() -> Iterator[Place]:
    with loopback_bus() as channel:
        yield "remote", channel


class TestLoopback(NodeFaults):
    """All of :class:`NodeFaults`."""
