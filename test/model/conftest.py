"""What the model's tests share: the shipped robots and the paper's long run, made once."""

from __future__ import annotations

import pytest

from artibot_sim.model import load_robot


@pytest.fixture(scope="session")
def agriq():
    return load_robot("agriq")


@pytest.fixture(scope="session")
def epiq():
    return load_robot("epiq")


@pytest.fixture(scope="session")
def husky():
    return load_robot("husky")


@pytest.fixture(scope="session")
def table6(agriq):
    """Commands of Table 6 for Agri.q."""
    from artibot_sim.planning import load_manoeuvre, plan

    return plan(load_manoeuvre("table6_agriq"), agriq).commands()
