"""Small sweeps over a short manoeuvre."""

from __future__ import annotations

from pathlib import Path

import pytest

from artibot_sim.sweep import SweepPlan, plan_from_dict

BEND = {
    "a_max_m_s2": 1.0,
    "segments": [{"ramp": {"speed_m_s": 0.8}}, {"arc": {"radius_m": 2.0, "angle_deg": 40.0}}, "stop"],
}
"""About 3 s."""

GRID = {
    "manoeuvre": BEND,
    "axes": {
        "contact.mu_s": {"from": 0.4, "to": 0.7, "count": 4},
        "kappa": [0.7, 1.0],
        "effects.slope.grade": [-0.05, 0.0, 0.05],
        "manoeuvre.segments[1].arc.radius_m": [1.5, 2.5],
    },
}
"""48 runs over a parameter of each kind."""


@pytest.fixture(scope="session")
def grid() -> SweepPlan:
    return plan_from_dict(GRID)


@pytest.fixture(scope="session")
def swept(grid: SweepPlan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The grid, done in one go by threads of this process."""
    from artibot_sim.sweep import sweep

    return sweep(grid, tmp_path_factory.mktemp("sweep") / "once").folder
