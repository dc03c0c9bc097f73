"""The studies behind sections 6 and 7, made once."""

from __future__ import annotations

import pytest

from artibot_sim.model import load_robot
from artibot_sim.reproduce import section6, section7


@pytest.fixture(scope="session")
def circles() -> section6.Study:
    """Section 6, quick."""
    return section6.study(load_robot("agriq"), quick=True)


@pytest.fixture(scope="session")
def runs() -> section7.Study:
    """Section 7, quick."""
    return section7.study(quick=True)
