"""The classical Runge-Kutta method and the semi-implicit steps, each once, coordinate by coordinate.

Every loop applies them to its own state: `loop` to the sixteen coordinates in space, `plane_loop` to the ten that move
on a plane, `train_loop` to eight a module, `lanes` to those of a whole block of rovers. Nothing here branches but on
the stage's number, which a loop over coordinates does not change.
"""

from __future__ import annotations

import math

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


# ----------------------------------------------------------------------
# Semi-implicit steps, in which each motor's spin is solved for together with the slip of its wheels.
#
# Two stages make them of second order. With u the state, F its rate, and k(u, h) = (1 - h A)^-1 F(u), where A is what
# of F's derivative is taken implicitly:
#
#     k_1 = k(u, 2 g dt),  k_2 = k(u + dt/4 k_1, g dt),  u(dt) = u + dt (2 k_2 - k_1),  g = (3 - sqrt 5) / 4.
#
# Terms of dt^2 with A cancel, so the order does not ask for an exact A, and a secant will do. A rate z = dt A that is
# negative, however large, changes its motion by a factor between -0.24 and 1, which vanishes for the largest.
# ----------------------------------------------------------------------


IMPLICIT = (3.0 - math.sqrt(5.0)) / 4.0
"""g: over which share of a step the second stage takes spin implicitly; the first one over twice as much."""


FINER = np.int64(16)
"""A step over which a wheel begins or ceases to slide is taken again in so many. Eq. 16 jumps there, a step over which
is of first order, and on its way a rover passes few."""


@inlined
def semi_implicit_time(k, dt):
    """When stage `k` of two is, s after the step's start."""
    return 0.0 if k == 0 else 0.25 * dt


@inlined
def semi_implicit_weight(k):
    """Share of stage `k` of two in the whole step."""
    return -1.0 if k == 0 else 2.0


@inlined
def implicit_over(k, dt):
    """Over how long stage `k` of two takes spin implicitly, s."""
    return (2.0 * IMPLICIT if k == 0 else IMPLICIT) * dt


@inlined
def next_semi_implicit(k, dt, x, v, acceleration, first):
    """A coordinate and its rate at the second stage (`k` is 0), or at the next step (1).

    Where nothing damps them springs are stable up to 2 over their frequency.

    Parameters
    ----------
    x, v : float
        At the step's start.
    acceleration, first : float
        At stage `k`, and at stage 0; anything at stage 0.

    Returns
    -------
    x, v : float
    """
    mean = acceleration if k == 0 else 2.0 * acceleration - first
    h = 0.25 * dt if k == 0 else dt
    new = v + h * mean
    return x + h * (0.5 * (v + new)), new


@inlined
def next_semi_implicit_lag(k, dt, x, rate, first):
    """`next_semi_implicit` of a number with a `rate` and no acceleration."""
    return x + (0.25 * dt * rate if k == 0 else dt * (2.0 * rate - first))


@inlined
def one_stage(dt, x, v, acceleration, sprung):
    """A coordinate and its rate after a step of one stage, symplectic Euler: what the loops of trains take.

    Where the ground is a spring (`sprung`) the new rate must be used; elsewhere the mean of old and new is closer.
    """
    new = v + dt * acceleration
    return x + dt * (new if sprung else 0.5 * (v + new)), new
