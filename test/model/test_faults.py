"""Where the model does not hold is found in every row, however few of them are looked at closely."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from artibot_sim.model import Status, load_robot
from artibot_sim.model.kernels.layout import ALPHA, BACK, BETA, LOAD, PUSH, ROW, Z
from artibot_sim.model.robot.derived import params
from artibot_sim.model.simulate.rollout import FASTEST, HARDEST, TIPPED_AT, first_fault

ROBOTS = {name: load_robot(name) for name in ("agriq", "husky")}


def reference(name: str, q: np.ndarray, v: np.ndarray, w: np.ndarray) -> list[Status | None]:
    """How each row fails, by the words of section 4.3 and of the limits alone."""
    robot, p = ROBOTS[name], params(ROBOTS[name])
    found: list[Status | None] = []
    for row in range(len(q)):
        faults = []
        for i, body in enumerate([p.front, p.back][: len(robot.modules)]):
            z, alpha, beta = q[row, BACK * i + Z : BACK * i + BETA + 1]
            pushes = [w[row, LOAD + 3 * i : LOAD + 3 * i + 2]] + ([w[row, PUSH : PUSH + 2]] if i == 0 else [])
            force, speed = np.sum(pushes, axis=0), v[row, BACK * i : BACK * i + 2]
            if max(abs(alpha), abs(beta)) > TIPPED_AT:
                faults.append(Status.TIPPED)
            if z - body.half_y * abs(math.sin(alpha)) > body.r_0 + robot.wheel.r_w:
                faults.append(Status.AIRBORNE)
            if math.hypot(*force) > HARDEST * body.m * abs(p.g_z) or math.hypot(*speed) > FASTEST:
                faults.append(Status.INVALID)
        found.append(min(faults, default=None))
    return found


def drawn(name: str, seed: int, rows: int, share: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows whose values lie on both sides of the limits: up to 1.2 of them, of a `share` of the columns."""
    robot, p, rng = ROBOTS[name], params(ROBOTS[name]), np.random.default_rng(seed)

    def some(limit: float, size: tuple[int, ...]) -> np.ndarray:
        return rng.uniform(-1.2, 1.2, size) * limit * (rng.random(size) < share)

    q, v, w = np.zeros((rows, 16)), np.zeros((rows, 16)), some(1e9, (rows, ROW))
    w[:, PUSH:ROW] = 0.0
    for i, body in enumerate([p.front, p.back][: len(robot.modules)]):
        b = BACK * i
        q[:, b : b + 2] = rng.uniform(-1e3, 1e3, (rows, 2))
        q[:, b + ALPHA : b + BETA + 1] = some(TIPPED_AT, (rows, 2))
        q[:, b + Z] = 0.9 * body.r_0 + some(0.2, (rows,))
        v[:, b : b + 2] = some(FASTEST, (rows, 2))
        hard = HARDEST * body.m * abs(p.g_z)
        w[:, LOAD + 3 * i : LOAD + 3 * i + 2] = some(hard, (rows, 2))
        if i == 0:
            w[:, PUSH : PUSH + 2] = some(hard, (rows, 2))
    w[:, [LOAD + 2, LOAD + 5]] = some(1e9, (rows, 2))  # moments have no limit
    return q, v, w


@given(
    st.sampled_from(sorted(ROBOTS)), st.integers(0, 2**32 - 1), st.integers(1, 3), st.sampled_from([0.05, 0.2, 0.5, 1])
)
def test_the_first_row_that_fails_is_found_whatever_is_near_its_limit(
    name: str, seed: int, rows: int, share: float
) -> None:
    q, v, w = drawn(name, seed, rows, share)
    expected = reference(name, q, v, w)
    found = first_fault(params(ROBOTS[name]), ROBOTS[name], q, v, w, np.arange(rows) * 0.1)
    first = next((row for row, status in enumerate(expected) if status is not None), None)
    if first is None:
        assert found is None
    else:
        assert found is not None
        assert (found[0], found[1]) == (first, expected[first])


def test_rows_on_both_sides_were_drawn() -> None:
    for name in ROBOTS:
        outcomes = {status for seed in range(200) for status in reference(name, *drawn(name, seed, 3, 0.2))}
        assert outcomes == {None, Status.TIPPED, Status.AIRBORNE, Status.INVALID}


@pytest.mark.parametrize("place", [PUSH, PUSH + 1, LOAD, LOAD + 1, LOAD + 3, LOAD + 4])
def test_each_force_alone_has_its_limit(place: int) -> None:
    p, w = params(ROBOTS["agriq"]), np.zeros((1, ROW))
    hard = HARDEST * (p.back if place > LOAD + 2 else p.front).m * abs(p.g_z)
    for share, status in ((0.29, None), (0.99, None), (1.01, Status.INVALID), (-1.01, Status.INVALID)):
        w[0, place] = share * hard
        found = first_fault(p, ROBOTS["agriq"], np.zeros((1, 16)), np.zeros((1, 16)), w, np.zeros(1))
        assert (found and found[1]) == status


def test_a_centre_of_mass_beyond_the_wheels_is_named_at_rest() -> None:
    robot = replace(ROBOTS["agriq"], effects={"com_offset": {"x": 1.0, "y": 0.0}})
    found = first_fault(params(robot), robot, np.zeros((1, 16)), np.zeros((1, 16)), np.zeros((1, ROW)), np.zeros(1))
    assert found is not None and found[1] is Status.INVALID
