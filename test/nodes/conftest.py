"""Recordings of a rover that several tests of the replay play."""

from __future__ import annotations

from pathlib import Path

import pytest
from replay_probe import input_bag, rover_bag


@pytest.fixture(scope="session")
def rover(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return rover_bag(tmp_path_factory.mktemp("bags") / "rover")


@pytest.fixture(scope="session")
def inputs(tmp_path_factory: pytest.TempPathFactory, rover: Path) -> Path:
    return input_bag(tmp_path_factory.mktemp("bags") / "inputs", rover)
