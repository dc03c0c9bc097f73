"""Where the model does not hold is found in every row, however few of them are looked at closely."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from artibot_sim.model import Status, load_robot, rollout
from artibot_sim.model.kernels.layout import ALPHA, BACK, BETA, LOAD, PUSH, ROW, Z
from artibot_sim.model.robot.derived import params
from artibot_sim.model.simulate.rollout import FASTEST, HARDEST, TIPPED_AT, first_fault
from artibot_sim.planning import load_manoeuvre, plan

ROBOTS = {
    name: replace(load_robot(name), effects={"external_force": {"force": 1.0, "heading": 0.0}})
    for name in ("agriq", "husky")
}
"""With an effect: nothing else pushes, and forces of a robot without any are not looked at."""


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


def drawn(rng: np.random.Generator, name: str, rows: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows in which one quantity in five is anywhere up to beyond its limit, its components alike in size."""
    robot, p = ROBOTS[name], params(ROBOTS[name])

    def some(limit: float, components: int) -> np.ndarray:
        size = rng.uniform(0.0, 1.2, (rows, 1)) * (rng.random((rows, 1)) < 0.2) * limit
        return size * rng.uniform(0.8, 1.0, (rows, components)) * rng.choice((-1.0, 1.0), (rows, components))

    q, v, w = np.zeros((rows, 16)), np.zeros((rows, 16)), rng.normal(0.0, 1e9, (rows, ROW))
    w[:, [LOAD + 3, LOAD + 4]] = 0.0  # of a module that is not there
    for i, body in enumerate([p.front, p.back][: len(robot.modules)]):
        b, hard = BACK * i, HARDEST * body.m * abs(p.g_z)
        q[:, b : b + 2] = rng.uniform(-1e3, 1e3, (rows, 2))
        q[:, b + ALPHA : b + BETA + 1] = some(TIPPED_AT, 2)
        q[:, b + Z] = 0.9 * (body.r_0 + robot.wheel.r_w) + some(0.3, 1)[:, 0]
        v[:, b : b + 2] = some(FASTEST, 2)
        forces = some(hard, 4)
        if i == 0:
            w[:, PUSH : PUSH + 2] = forces[:, 2:]
        w[:, LOAD + 3 * i : LOAD + 3 * i + 2] = forces[:, :2]
    return q, v, w


@pytest.mark.parametrize("name", sorted(ROBOTS))
@pytest.mark.parametrize("rows", [1, 3])
def test_the_first_row_that_fails_is_found_whatever_is_near_its_limit(name: str, rows: int) -> None:
    rng, seen = np.random.default_rng(rows), set()
    for _ in range(4000):
        q, v, w = drawn(rng, name, rows)
        expected = reference(name, q, v, w)
        found = first_fault(params(ROBOTS[name]), ROBOTS[name], q, v, w, np.zeros(rows))
        first = next((row for row, status in enumerate(expected) if status is not None), None)
        assert (found and found[:2]) == (None if first is None else (first, expected[first]))
        seen |= set(expected)
    assert seen == {None, Status.TIPPED, Status.AIRBORNE, Status.INVALID}


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


def test_a_motor_that_spins_up_without_a_limit_is_named(agriq) -> None:
    """At a kappa of 0.01 eq. 30 gives the back motors far more than their wheels hold: no step is too long there."""
    commands = plan(load_manoeuvre("table6_agriq"), agriq).commands()
    result = rollout(agriq, commands, kappa=0.01, integrator="semi_implicit")
    assert result.status == Status.DIVERGED
    assert "the motor back_" in result.message and "eq. 30's share at a kappa of 0.01" in result.message
