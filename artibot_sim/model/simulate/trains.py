"""Rollouts of robots of three modules or more, by the loops of `kernels.train_loop`.

`rollout` comes here by itself. What is here lays a checked setup out module by module: motors that a robot does not
have (a passive module's) are sides whose wheels turn under no torque.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from artibot_sim.errors import ArtibotError
from artibot_sim.model.analysis.stability import largest_step, number_of_parts, parts
from artibot_sim.model.effects import records
from artibot_sim.model.equations.transmission import Mode
from artibot_sim.model.kernels.layout import Grid, KernelInputs, RowTables, RunState
from artibot_sim.model.kernels.train_layout import KEPT, KEPT_ENERGIES
from artibot_sim.model.robot.derived import packed_all
from artibot_sim.model.robot.parameters import Train
from artibot_sim.model.robot.robot import Robot, sides_of
from artibot_sim.model.simulate.commands import Commands
from artibot_sim.model.simulate.state import State, from_memory

Array = NDArray[np.float64]


def sides(robot: Robot) -> list[int]:
    """Where the robot's motors stand among the sides of its modules, in the order of `Robot.motors`."""
    names = sides_of(len(robot.modules))
    return [names.index(motor) for motor in robot.motors]


def by_side(robot: Robot, modes: Sequence[Mode]) -> tuple[Mode, ...]:
    """The modes of all sides; wheels without a motor turn under no torque."""
    found = [Mode.TORQUE] * (2 * len(robot.modules))
    for side, mode in zip(sides(robot), modes, strict=True):
        found[side] = mode
    return tuple(found)


def unlimited_beside_prescribed(p: Train, modes: Sequence[Mode]) -> Train:
    """Motors that share the torque of prescribed ones, which have no limit, have none themselves; modes by side."""
    if Mode.DRIVEN in modes[:2]:
        return p
    modules = [p.modules[0]]
    for i, module in enumerate(p.modules[1:], 1):
        right, left = (
            unit if modes[2 * i + side] == Mode.DRIVEN else unit._replace(torque_max=math.inf)
            for side, unit in enumerate((module.right_front, module.left_front))
        )
        modules.append(module._replace(right_front=right, left_front=left))
    return p._replace(modules=tuple(modules))


def inputs_of(
    robot: Robot, commands: Commands, modes: Sequence[Mode] = (), factors: Sequence[float] = ()
) -> KernelInputs:
    """What the loops take: `commands` for each side, zero where nothing is commanded, NaN for the torque of eq. 30.

    Modes are those of all sides (`by_side`), `factors` of `transmission.torque_factors`.

    Raises
    ------
    ArtibotError
        When there are more columns than motors.
    """
    knots, given = commands.velocity.shape
    places, modules = sides(robot), len(robot.modules)
    if given > len(places):
        raise ArtibotError(
            f"commands: {given} columns; robot '{robot.name}' has {len(places)} motors: {', '.join(robot.motors)}"
        )
    position, velocity = np.zeros((2 * modules, knots)), np.zeros((2 * modules, knots))
    torque = np.full((2 * modules, knots), np.nan)
    for column, side in enumerate(places[:given]):
        torque[side] = commands.torque[:, column]
        if commands.commanded[column]:
            position[side], velocity[side] = commands.position[:, column], commands.velocity[:, column]
    shape = (modules, 2, knots)
    position, velocity, torque = (
        np.ascontiguousarray(table.reshape(shape).swapaxes(1, 2)) for table in (position, velocity, torque)
    )
    by_module = np.array(modes, dtype=np.int64).reshape(-1, 2)
    return KernelInputs(by_module, position, velocity, torque, np.array(factors, dtype=float))


class Tables(NamedTuple):
    """Rows of a rollout: coordinates, rates, contributions, and energies where asked for."""

    q: Array
    v: Array
    w: Array
    e: Array | None


def run(
    robot: Robot, p: Train, inputs: KernelInputs, start: State, grid: Grid, integrator: str, energy: bool
) -> tuple[Tables, int, State | None]:
    """Simulate; a step is cut into as many parts as the quickest motion needs.

    Returns
    -------
    Tables
    int
        How many of their rows there are.
    State or None
        At the end; None where it diverged.
    """
    from artibot_sim.model.kernels import train_loop

    modules, (dt, steps, every, knot_steps) = len(p.modules), grid
    modes, factors = tuple(Mode(int(mode)) for mode in inputs.modes.ravel()), tuple(np.atleast_1d(inputs.share))
    if integrator == "semi_implicit":
        cut = parts(p, dt, factors)
    else:
        longest, motion = largest_step(p, integrator, modes, factors)
        cut = number_of_parts(dt, 1.0 / longest, motion)
    rows = -(-steps // every) + 1
    tables = Tables(
        np.empty((rows, 8 * modules)), np.empty((rows, 8 * modules)), np.empty((rows, len(KEPT) * modules)),
        np.empty((rows, len(KEPT_ENERGIES) * modules)) if energy else None,
    )  # fmt: skip
    q, v = start.q.reshape(modules, 8).copy(), start.v.reshape(modules, 8).copy()
    eta, torque, behind = (array.reshape(modules, 2).copy() for array in (start.eta, start.torque, start.behind))
    memory = np.hstack(list(start.memory.reshape(4, modules, 4)))
    fx = records(robot.effects, start.t, modules)
    effects: tuple[Any, ...] = () if fx is None else (fx, memory)
    loop = train_loop.train_semi_implicit if integrator == "semi_implicit" else train_loop.train_rk4
    cut_grid = Grid(dt / cut, steps * cut, every * cut, knot_steps * cut)
    status, kept = loop(
        RunState(q, v, eta, torque, behind), packed_all(p.modules), packed_all(p.joints), inputs, cut_grid,
        train_loop.workspace(modules), RowTables(*tables[:3]), tables.e, *effects,
    )  # fmt: skip
    if status != train_loop.OK:
        return tables, kept, None
    by_kind = memory.reshape(modules, 4, 4).transpose(1, 0, 2).reshape(-1)
    ends = [*(array.reshape(-1) for array in (q, v, eta, torque)), *from_memory(by_kind), behind.reshape(-1)]
    return tables, kept, State(start.t + steps * dt, *ends)
