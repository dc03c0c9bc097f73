"""Where each quantity of a robot of any number of modules stands in a rollout's tables, and what it is called.

A train's state holds eight coordinates a module, one module after the other, as that of two modules does. Its row of
contributions holds :data:`KEPT` of each module, taken from a row that is laid out as `layout` says, in which the module
stands in the front's place; the joint behind a module stands in the module's row. Names follow from the place: those
of the first two modules and of the first joint are the two-module rover's.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from artibot_sim.model.kernels.layout import (
    COLUMNS,
    COORDINATES,
    E_ARTICULATION,
    E_DRAG,
    E_GEAR,
    E_JOINT,
    E_MOTOR,
    E_NORMAL,
    E_OFFSET,
    E_PUSH,
    E_ROLLING,
    E_SLIP_L,
    E_SLIP_T,
    E_TILT,
    ENERGY_COLUMNS,
)
from artibot_sim.model.robot.robot import module_name

_OF_FRONT = [
    i
    for i, name in enumerate(COLUMNS)
    if "front_" in name or name.endswith(("_f", "_f_ddot", "_fr_ddot", "_fl_ddot")) or name.startswith("lambda_")
]
_SHARED = [COLUMNS.index(name) for name in ("M_joint", "push_x", "push_y")]

KEPT = np.array(sorted(_OF_FRONT + _SHARED))
"""Entries of a module's row that a rollout keeps."""

KEPT_ENERGIES = np.array(
    [
        *range(E_MOTOR, E_MOTOR + 2),
        *range(E_GEAR, E_GEAR + 2),
        *(start + i for start in (E_SLIP_L, E_SLIP_T, E_OFFSET, E_ROLLING, E_NORMAL, E_TILT) for i in range(4)),
        E_JOINT,
        *range(E_DRAG, E_DRAG + 2),
        E_ARTICULATION,
        E_PUSH,
    ]
)
"""Entries of a module's energies that a rollout keeps; what joints do and what pushes is summed in the front one's."""


class Places(NamedTuple):
    """Column → the table of a rollout that holds it (`q`, `v`, `row` or `energy`), and where."""

    columns: dict[str, tuple[str, int]]
    energies: dict[str, tuple[str, int]]


def symbol(module: int) -> str:
    """What stands in a column's name for a module by its place, counted from 0: f, b, 3, 4, …"""
    return "fb"[module] if module < 2 else str(module + 1)


def coordinates(modules: int) -> tuple[str, ...]:
    """Names of the generalised coordinates of so many modules."""
    front = COORDINATES[:8]
    return tuple(
        f"{name[: name.index('_')]}_{symbol(i)}{name[name.index('_') + 2 :]}" for i in range(modules) for name in front
    )


@cache
def places(modules: int) -> Places:
    """The columns of a train's rollout."""
    columns: dict[str, tuple[str, int]] = {}
    for i, name in enumerate(coordinates(modules)):
        columns[name] = ("q", i)
    columns |= {f"{name}_dot": ("v", i) for i, name in enumerate(coordinates(modules))}
    energies: dict[str, tuple[str, int]] = {}
    for table, kept, known, found in (
        ("row", KEPT, COLUMNS, columns),
        ("energy", KEPT_ENERGIES, ENERGY_COLUMNS, energies),
    ):
        for module in range(modules):
            for k, entry in enumerate(kept):
                column = _renamed(known[entry], module, modules)
                if column is not None:
                    found[column] = (table, module * len(kept) + k)
    return Places(columns, energies)


def _renamed(name: str, module: int, modules: int) -> str | None:
    """The name of a column of the front module or the first joint for another module; None for what that has not."""
    if name.startswith("lambda_"):
        return f"lambda_{4 * module + int(name[7:])}" if module < modules - 1 else None
    if name in ("M_joint", "E_articulation"):
        return (name if module == 0 else f"{name}_{module + 1}") if module < modules - 1 else None
    if name in ("push_x", "push_y", "E_push", "E_joint"):
        return name if module == 0 else None
    if "_front_right" in name or "_front_left" in name:
        return name.replace("_front_", f"_{module_name(module)}_", 1)
    for ending in ("_f", "_f_ddot", "_fr_ddot", "_fl_ddot"):
        if name.endswith(ending):
            return f"{name[: -len(ending)]}_{symbol(module)}{ending[2:]}"
    return None
