"""The suite of faults around the driver node, on a loopback bus between processes."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from node_faults import NodeFaults, Rover, running_rover

from artibot_driver.loopback import loopback_bus


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rover]:
    folder = tmp_path_factory.mktemp("faults")
    with loopback_bus() as channel, running_rover(("remote", channel), folder) as rover:
        yield rover


class TestLoopback(NodeFaults):
    """All of :class:`NodeFaults`."""
