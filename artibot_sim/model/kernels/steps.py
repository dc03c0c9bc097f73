"""The classical Runge-Kutta method and the semi-implicit step, each once, coordinate by coordinate.

Every loop applies them to its own state: `loop` to the sixteen coordinates in space, `plane_loop` to the ten that move
on a plane, `train_loop` to eight a module, `lanes` to those of a whole block of rovers. Nothing here branches but on
the stage's number, which a loop over coordinates does not change.
"""

from __future__ import annotations

import numpy as np

from artibot_sim.model.kernels.compilation import inlined

STAGE = tuple(map(np.int64, range(4)))
"""Numbers of the stages (not Python's integers, for each of whose values numba would compile every function anew)."""


@inlined
def stage_time(k, dt):
    """When stage `k` is, s after the step's start."""
    return 0.0 if k == 0 else dt if k == 3 else 0.5 * dt


@inlined
def stage_weight(k):
    """Share of stage `k` in the whole step."""
    return 1.0 / 6.0 if k == 0 or k == 3 else 1.0 / 3.0


@inlined
def stage_reach(k, dt):
    """How far the stage after `k` is from the step's start, s: along the rates of stage `k`."""
    return dt if k == 2 else 0.5 * dt


@inlined
def next_stage(k, dt, x, v, speed, acceleration, first, total):
    """A coordinate and its rate at the stage after `k`; after stage 3, at the next step.

    Speeds at the stages come of accelerations at those before, so only these are summed.

    Parameters
    ----------
    x, v : float
        At the step's start.
    speed, acceleration : float
        At stage `k`.
    first, total : float
        Accelerations at stage 0, and summed up to the stage before; anything at stage 0.

    Returns
    -------
    x, v, first, total : float
    """
    if k == 0:
        first = total = acceleration
    elif k < 3:
        total += acceleration
    if k == 3:
        return (
            x + dt * (v + dt / 6.0 * total),
            v + dt / 6.0 * (2.0 * total - first + acceleration),
            first,
            total,
        )
    h = stage_reach(k, dt)
    return x + h * speed, v + h * acceleration, first, total


@inlined
def next_stage_of_lag(k, dt, x, rate, total):
    """From stage `k` to the next of a number with a `rate` and no acceleration; `total` sums the weighted rates.

    Returns
    -------
    x, total : float
    """
    weighted = stage_weight(k) * rate
    total = weighted if k == 0 else total + weighted
    return (x + dt * total if k == 3 else x + stage_reach(k, dt) * rate), total


@inlined
def semi_implicit(dt, x, v, acceleration, sprung):
    """A coordinate and its rate after a step of symplectic Euler.

    Where the ground is a spring (`sprung`) the new rate must be used; elsewhere the mean of old and new is closer.
    """
    new = v + dt * acceleration
    return x + dt * (new if sprung else 0.5 * (v + new)), new
