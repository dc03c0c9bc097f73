"""Short simulated recordings that several tests draw, and a browser for their pages."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from browser import Browser, browser

from artibot_sim.experiment import Experiment, read_bag, write_experiment
from artibot_sim.model import Robot, load_robot, rollout
from artibot_sim.planning import Plan, load_manoeuvre, plan


@pytest.fixture(scope="session")
def agriq() -> Robot:
    return load_robot("agriq")


@pytest.fixture(scope="session")
def planned(agriq: Robot) -> Plan:
    return plan(load_manoeuvre("table6_agriq"), agriq)


@pytest.fixture(scope="session")
def bags(tmp_path_factory: pytest.TempPathFactory, agriq: Robot, planned: Plan) -> list[Path]:
    """Table 6 driven with kappa 0.6 and 1.0, whole, at 20 Hz."""
    folder = tmp_path_factory.mktemp("bags")
    paths = []
    for kappa in (0.6, 1.0):
        robot = agriq.replace({"control.kappa": kappa})
        result = rollout(robot, planned.commands(), every=50)
        paths.append(write_experiment(folder / f"kappa_{kappa:g}", result, planned, robot))
    return paths


@pytest.fixture(scope="session")
def run(bags: list[Path]) -> Experiment:
    return read_bag(bags[0])


@pytest.fixture(scope="session")
def runs(bags: list[Path]) -> list[Experiment]:
    return [read_bag(path) for path in bags]


@pytest.fixture(scope="module")
def chromium(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with browser(tmp_path_factory.mktemp("browser") / "profile") as opened:
        yield opened
