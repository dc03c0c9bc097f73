"""Which compiled loop a rover takes, and which version: on a plane where it stays on one, else in space."""

from __future__ import annotations

from typing import Any

import numpy as np

from artibot_sim.model.ground.raster import Surface
from artibot_sim.model.kernels import loop, plane_loop
from artibot_sim.model.kernels.layout import ENERGIES, MEMORY


def advance(
    integrator: str, given: tuple[Any, ...], effects: tuple[Any, ...] = (), ground: Surface | None = None
) -> tuple[int, int]:
    """Advance a rover, in place; whoever starts level stays so, but on uneven ground.

    Parameters
    ----------
    integrator : {"rk4", "semi_implicit"}
    given
        What `loop.integrate_rk4` takes, but for effects.
    effects : tuple, optional
        Effects' record, and in a tuple what the wheels remember where an effect has them do so, see `layout.MEMORY`.
    ground : Surface, optional
        Flat ground without.

    Returns
    -------
    tuple of int
        `loop.OK`, `loop.DIVERGED` or `loop.STOPPED`, and the number of rows written.
    """
    implicit = integrator == "semi_implicit"
    in_space: Any = loop.integrate_semi_implicit if implicit else loop.integrate_rk4
    given, effects = _compiled_for(given, effects)
    if ground is not None:
        return in_space(*given, *(effects or (None, ())), ground)
    status, rows = (plane_loop.level_semi if implicit else plane_loop.level_rk4)(*given, *effects)
    if status != plane_loop.LEAVES:
        return status, rows
    return in_space(*given, *effects)


def _compiled_for(given: tuple[Any, ...], effects: tuple[Any, ...]) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
    """The arguments that choose a version of a loop.

    With effects there are two: without energies and wheels that remember, which is a third faster, and with both,
    asked for or not. Four would take twice as long to compile.
    """
    *others, out_e = given
    if not effects or (out_e is None and not effects[1]):
        return given, effects
    fx, memory = effects
    return (*others, np.empty((0, ENERGIES)) if out_e is None else out_e), (fx, memory or (np.zeros(MEMORY),))
