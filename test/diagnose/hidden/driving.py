"""What the rover is told to do: random manoeuvres as speed and yaw rate over time, without a planner."""

from __future__ import annotations

from collections.abc import Callable
from math import inf, pi

import numpy as np
from diagnose.hidden.machine import Machine, Way
from numba import njit

Array = np.ndarray
Rng = np.random.Generator
PERIOD = 0.01
"""s between two commands."""
LONGEST_CORNER = 0.5
"""m of path over which a curvature is blended."""


def _smooth(values: Array, seconds: float) -> Array:
    """Two moving means one after the other: no jump is left in the values nor in their slope."""
    size = max(1, round(seconds / PERIOD / 2))
    for _ in range(2):
        padded = np.pad(values, (size, size), mode="edge")
        values = np.convolve(padded, np.ones(size) / size, mode="same")[size:-size]
    return values


def _ways(speed: Array) -> Array:
    """Path length so far (n,), m."""
    return np.concatenate(([0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1])) * PERIOD))


def _begin(rng: Rng, t: Array, speed: float) -> Array:
    """Standing for a while, then a steady speed."""
    return _smooth(np.where(t > rng.uniform(0.6, 1.4), speed, 0.0), rng.uniform(1.0, 2.0))


def _sign(rng: Rng) -> float:
    return float(rng.choice((-1.0, 1.0)))


def _turning(v: Array, curvature: Array, speed: float) -> tuple[Array, Array]:
    return v, v * _smooth(curvature, LONGEST_CORNER / speed)


def eight(rng: Rng, t: Array) -> tuple[Array, Array]:
    speed, radius = rng.uniform(0.4, 0.8), rng.uniform(1.5, 2.6)
    v = _begin(rng, t, speed)
    lobe = np.floor(_ways(v) / (2 * pi * radius)) % 2
    return _turning(v, _sign(rng) * (1.0 - 2.0 * lobe) / radius, speed)


def slalom(rng: Rng, t: Array) -> tuple[Array, Array]:
    speed, wave = rng.uniform(0.4, 0.8), rng.uniform(4.5, 9.0)
    v = _begin(rng, t, speed)
    return v, v * _sign(rng) * rng.uniform(0.35, 0.6) * np.sin(2 * pi * _ways(v) / wave)


def circles(rng: Rng, t: Array) -> tuple[Array, Array]:
    """First one way and then the other, with another radius."""
    speed, sign = rng.uniform(0.4, 0.8), _sign(rng)
    v = _begin(rng, t, speed)
    first, second = rng.uniform(1.4, 3.0, 2)
    return _turning(v, np.where(t < rng.uniform(0.4, 0.6) * t[-1], sign / first, -sign / second), speed)


def spiral(rng: Rng, t: Array) -> tuple[Array, Array]:
    """Ever narrower, and out again the other way round."""
    speed, tightest = rng.uniform(0.4, 0.7), 1.0 / rng.uniform(1.3, 1.8)
    v = _begin(rng, t, speed)
    way = _ways(v) / _ways(v)[-1]
    return v, v * _sign(rng) * tightest * np.sin(2 * pi * way) * np.minimum(1.0, 4.0 * np.abs(way - 0.5) + 0.2)


def chirp(rng: Rng, t: Array) -> tuple[Array, Array]:
    """A yaw rate that oscillates faster and faster."""
    speed, top = rng.uniform(0.4, 0.7), rng.uniform(0.25, 0.6)
    v = _begin(rng, t, speed)
    phase = 2 * pi * (0.04 * t + 0.5 * (top - 0.04) * t**2 / t[-1])
    return v, _sign(rng) * rng.uniform(0.2, 0.35) * np.sin(phase) * np.minimum(1.0, v / speed)


def pumping(rng: Rng, t: Array) -> tuple[Array, Array]:
    """A speed that goes up and down faster and faster, on an arc."""
    speed, top = rng.uniform(0.45, 0.6), rng.uniform(0.2, 0.5)
    v = _begin(rng, t, speed)
    v = v * (1.0 + 0.45 * np.sin(2 * pi * (0.05 * t + 0.5 * (top - 0.05) * t**2 / t[-1])))
    return _turning(v, np.where(t < 0.5 * t[-1], 1.0, -1.0) * _sign(rng) / rng.uniform(1.6, 3.5), speed)


def stop_and_go(rng: Rng, t: Array) -> tuple[Array, Array]:
    """Legs of a few seconds, straight and turning, now and then in reverse for a short while."""
    v, curvature, now, turn = np.zeros_like(t), np.zeros_like(t), rng.uniform(0.6, 1.4), _sign(rng)
    while now < t[-1]:
        back = now > 8.0 and rng.random() < 0.2
        leg = rng.uniform(2.5, 4.0) if back else rng.uniform(4.0, 9.0)
        rows = (t >= now) & (t < now + leg)
        v[rows] = -0.3 if back else rng.uniform(0.4, 0.8)
        arc = rows & (t >= now + leg * (1.0 if back else rng.uniform(0.1, 0.5)))
        turn = -turn
        curvature[arc] = turn / rng.uniform(1.4, 2.8)
        now += leg + rng.uniform(1.2, 2.0)
    v = _smooth(v, rng.uniform(0.9, 1.4))
    return v, v * _smooth(curvature, 0.9)


def meander(rng: Rng, t: Array) -> tuple[Array, Array]:
    """Speed and curvature that wander."""
    knots = np.arange(0.0, t[-1] + 4.0, 4.0)
    speed = np.interp(t, knots, rng.uniform(0.3, 0.8, len(knots)))
    curvature = np.interp(t, knots + 1.3, rng.uniform(-0.65, 0.65, len(knots)))
    v = _smooth(np.where(t > rng.uniform(0.6, 1.4), speed, 0.0), 1.4)
    return v, v * _smooth(curvature, 1.0)


MANOEUVRES: dict[str, Callable[[Rng, Array], tuple[Array, Array]]] = {
    manoeuvre.__name__: manoeuvre
    for manoeuvre in (eight, slalom, stop_and_go, circles, chirp, spiral, pumping, meander)
}


def commands(machine: Machine, name: str, rng: Rng, duration: float) -> tuple[Array, Array]:
    """Times (n,) in s and front motor speeds (n, 2) in rad/s, right and left, that a manoeuvre asks for."""
    t = PERIOD * np.arange(round(duration / PERIOD) + 1)
    v, w = MANOEUVRES[name](rng, t)
    v, w = v * machine.length**0.5, w / machine.length**0.5  # as hard a turn for a smaller rover (Froude)
    right, left = v + 0.5 * machine.track * w, v - 0.5 * machine.track * w
    return t, np.column_stack([right, left]) / (machine.radius * machine.tau)


def executed(t: Array, command: Array, way: Way, fine: Array) -> Array:
    """Speeds (m, 2) that the drives want at the times `fine` (m,), s: up to the fastest, on a ramp, late, with a dead
    band, behind a lag.

    Between two commands a drive goes straight from one to the next.
    """
    command = np.clip(command, -way.fastest, way.fastest)
    if way.ramp < inf:
        wish = np.column_stack([np.interp(fine, t, column) for column in command.T])
        ramped = _ramped(wish, way.ramp * (fine[1] - fine[0]))
        command = np.column_stack([np.interp(t, fine, column) for column in ramped.T])
    alive = np.where(np.abs(command) < way.deadband, 0.0, command)
    wish = np.column_stack([np.interp(fine - way.delay, t, column) for column in alive.T])
    if way.time_constant > 0.0:
        from scipy.signal import lfilter

        # exact for a wish that is straight between two fine instants
        h = fine[1] - fine[0]
        decay = np.exp(-h / way.time_constant)
        late = way.time_constant / h * (1.0 - decay)
        start = np.zeros((1, 2))
        wish = lfilter([1.0 - late, late - decay], [1.0, -decay], wish, axis=0, zi=start)[0]
    return wish


@njit(cache=True)
def _ramped(wish: Array, most: float) -> Array:
    """Speeds (m, 2) that go after a wish by no more than `most` a step, rad/s."""
    out = wish.copy()
    for i in range(1, wish.shape[0]):
        for k in range(2):
            out[i, k] = out[i - 1, k] + min(max(wish[i, k] - out[i - 1, k], -most), most)
    return out
