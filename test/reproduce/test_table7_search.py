"""The search for an Epi.q that is nowhere further from Table 7 than its first geometry."""

from __future__ import annotations

import math

import numpy as np
import pytest

from artibot_sim.model import load_robot
from artibot_sim.planning import load_manoeuvre
from artibot_sim.reproduce.calibration import overall_length
from artibot_sim.reproduce.paper import KAPPAS, TABLE_7
from artibot_sim.reproduce.simulations import drive
from artibot_sim.reproduce.table7_search import (
    FAR,
    FIRST,
    INFERRED,
    LENGTHS,
    NEAREST,
    Table7Search,
    differences,
    epiq,
)

SHIPPED = {"overall": 0.30, "gap": 0.02, "i_y": 0.34, "l_b/l_f": 1.0, "r_w": 0.035}
ASSUMED = {"J_m": 1e-7, "m_w": 0.12, "J_z": 0.02, "log A_motor": math.log(100.0), "log A_joint": math.log(20.0)}


def test_differences_are_those_of_section_7() -> None:
    stiff = epiq(SHIPPED).replace({"contact.k_n": 1e8})  # whose step of 1 ms is refused
    found = differences([epiq(SHIPPED), None, load_robot("epiq").replace(FIRST), epiq(SHIPPED | ASSUMED), stiff])
    assert np.isnan(found[4]).all()
    for kappa, of in zip(KAPPAS, found[0], strict=True):
        run, (e_gamma, e_x) = drive(load_robot("epiq"), load_manoeuvre("table6_epiq"), kappa), TABLE_7["epiq"][kappa]
        np.testing.assert_allclose(of, [100 * run.e_gamma + e_gamma, 100 * run.e_x - e_x], atol=2e-3)
    assert np.isnan(found[1]).all()
    assert (found[2, :, 0] > 5.0).all()  # of the wrong sign
    np.testing.assert_allclose(found[3], found[0], atol=1e-9)


def test_masses_and_lengths_are_those_that_are_stated() -> None:
    rng = np.random.default_rng(1)
    for _ in range(5):
        values = {name: float(rng.uniform(*bounds)) for name, bounds in (LENGTHS | INFERRED).items()}
        values["overall"], values["r_w"], values["gap"] = 0.31, 0.03, 0.01
        robot = epiq(values)
        assert overall_length(robot) == pytest.approx(0.31)
        assert robot.back is not None and robot.back.l == pytest.approx(values["l_b/l_f"] * robot.front.l)
        assert robot.front.m + 4.0 * robot.wheel.m_w == pytest.approx(1.98)  # Table 2


def test_the_worst_number_counts_and_so_do_geometries_beside() -> None:
    search = Table7Search(tuple(LENGTHS))
    impossible = SHIPPED | {"r_w": 0.2}
    rows = np.array([[values[name] for name in LENGTHS] for values in (SHIPPED, impossible)])
    cost = search.cost(rows.T)
    off = differences([epiq(SHIPPED)])[0]
    assert search.tried[0][2] == pytest.approx((np.abs(off) - search.bounds).max())
    beside = [
        epiq(SHIPPED | {k: s * SHIPPED[k] for k in ("overall", "gap", "i_y", "r_w")}) for s in (0.995, 1.0, 1.005)
    ]
    assert cost[0] == pytest.approx(search.beyond(differences(beside)).mean())
    assert cost[1] == FAR
    ((limit, row, found),) = search.trade((0.3,))
    assert limit == 0.3 and row.tolist() == list(SHIPPED.values()) and np.abs(found[:, 0]).max() < 0.3


def test_the_nearest_geometry_stands_between_two_jumps() -> None:
    """Within the bounds, to half a hundredth of a point; half a percent of m_w moves it by 0.2 points, either way."""
    m_w = NEAREST["m_w"]
    at, less, more = differences([epiq(NEAREST | {"m_w": scale * m_w}) for scale in (1.0, 0.995, 1.005)])
    assert (np.abs(at) - Table7Search(tuple(LENGTHS)).bounds).max() < 0.005
    assert np.sqrt((at**2).mean()) < 0.3725
    assert all((-np.array(TABLE_7["epiq"][kappa][0]) + off) < 0.0 for kappa, off in zip(KAPPAS, at[:, 0], strict=True))
    assert np.abs(less - at).max() > 0.2 and np.abs(more - at).max() > 0.2
