"""Fixtures for all tests; what they are made of is in ``ros_helpers.py``."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import settings

from ros_helpers import NodeStarter, rclpy_context, reserved_domain, ros_environment, skip

if TYPE_CHECKING:
    from rclpy.context import Context

# No test is about how long an example takes on a busy machine; every run draws other examples.
settings.register_profile("artibot", deadline=None, max_examples=40)
settings.load_profile("artibot")

LONGEST = (
    "nodes/test_driver_node.py",
    "nodes/test_sim_services.py",
    "nodes/test_closed_loop.py",
    "nodes/test_record.py",
    "nodes/test_replay.py",
    "model/test_fast_equals_plain.py",
    "diagnose/test_seeds.py",
    "model/test_train.py",
    "model/test_lanes.py",
    "model/test_level.py",
    "model/test_uneven.py",
    "bench/test_bench_command.py",
    "driver/test_foreign_drives.py",
    "diagnose/unlisted/test_explanations.py",
    "diagnose/test_run.py",
    "diagnose/test_elsewhere.py",
    "diagnose/selection/test_per_recording.py",
    "diagnose/test_sizes.py",
    "diagnose/unlisted/test_finding.py",
    "diagnose/selection/test_backward.py",
    "diagnose/commands/test_view.py",
    "diagnose/test_tyre_relaxation.py",
    "diagnose/selection/test_stepwise.py",
    "diagnose/next_experiment/test_force.py",
    "diagnose/test_refuted.py",
    "diagnose/test_handbook.py",
    "diagnose/commands/test_mixing.py",
    "diagnose/validation/test_explainable.py",
    "diagnose/test_hidden_cases.py",
    "experiment/test_kill.py",
    "test_install.py",
)
"""Files whose tests take longest together, in `test`: of those that run last what only computes comes first.

The first ones need other loops than each other, so that none waits for what another compiles."""


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Where files are shared out among processes the longest come first, so that none is left over at the end."""
    if hasattr(config, "workerinput"):
        rank = {Path(__file__).parent / name: place for place, name in enumerate(LONGEST)}
        items.sort(key=lambda item: rank.get(item.path, len(rank)))


@pytest.fixture
def ros_domain(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """A ROS domain id for this test alone, set in the environment together with discovery on this machine only."""
    if importlib.util.find_spec("rclpy") is None:
        skip("rclpy is not installed; run `make setup`, or source a ROS 2 Jazzy")
    with reserved_domain(request.node.nodeid) as domain:
        for key, value in ros_environment(domain, tmp_path / "ros_log").items():
            monkeypatch.setenv(key, value)
        yield domain


@pytest.fixture
def start_node(ros_domain: int, tmp_path: Path) -> Iterator[NodeStarter]:
    """``start_node(word, *args)`` starts ``artibot word args…`` in the test's domain; all end with the test."""
    folder = tmp_path / "processes"
    folder.mkdir()
    starter = NodeStarter(folder, ros_environment(ros_domain, tmp_path / "ros_log"))
    try:
        yield starter
    finally:
        starter.end()


@pytest.fixture
def ros_context(ros_domain: int) -> Iterator[Context]:
    """An rclpy context in the test's domain: ``Node("probe", context=ros_context)``."""
    with rclpy_context(ros_domain) as context:
        yield context


@pytest.fixture(scope="module")
def channel() -> Iterator[str]:
    """The channel of a CAN bus for one file's tests (interface ``remote``)."""
    from artibot_driver.loopback import loopback_bus

    with loopback_bus() as found:
        yield found
