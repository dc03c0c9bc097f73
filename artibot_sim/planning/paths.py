"""Shapes of paths: pose as a function of the progress along them."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

# ----------------------------------------------------------------------
# Running integrals of smooth functions, to rounding.
# ----------------------------------------------------------------------


Array = NDArray[np.float64]

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)


class Running:
    """The integral of `f` from ``edges[0]`` to any point, by Gauss-Legendre quadrature within cells.

    Parameters
    ----------
    f : callable
        Takes an array of any shape and returns an array of the same shape with a last axis of `width` components.
    edges : (n + 1,) array
        Increasing; between two of them `f` must be smooth and change little (half a radian of phase, say): then
        the 24th-order rule is exact to rounding.
    """

    def __init__(self, f: Callable[[Array], Array], edges: Array) -> None:
        self._f = f
        self._edges = edges
        cells = self._between(edges[:-1], edges[1:])
        self._sums = np.concatenate([np.zeros((1, cells.shape[-1])), np.cumsum(cells, axis=0)])

    def __call__(self, x: Array) -> Array:
        """Integrals up to `x` (n,), as (n, width)."""
        cell = np.clip(np.searchsorted(self._edges, x, side="right") - 1, 0, len(self._edges) - 2)
        return self._sums[cell] + self._between(self._edges[cell], x)

    def _between(self, a: Array, b: Array) -> Array:
        half = 0.5 * (b - a)
        x = a[:, None] + half[:, None] * (1.0 + _NODES)
        return np.einsum("k,nkw->nw", _WEIGHTS, self._f(x)) * half[:, None]


def cells(kinks: list[float], phase: float) -> Array:
    """Edges between `kinks` (increasing), so that a `phase` in rad spread evenly over them changes by ≤ 0.5 a cell."""
    span = kinks[-1] - kinks[0]
    parts = []
    for a, b in pairwise(kinks):
        if b > a:
            parts.append(np.linspace(a, b, int(np.ceil(phase * (b - a) / span / 0.5)) + 2)[:-1])
    return np.concatenate([*parts, np.array([kinks[-1]])])


# ----------------------------------------------------------------------
# Shapes of paths: pose as a function of the progress along them.
#
# A shape's progress `sigma` begins at 0; its unit is metres for a path of given curvature, radians for a turn in
# place and seconds for what is given in time. Forward speed and yaw rate are ``advance(sigma) * sigma_dot`` and
# ``turn(sigma) * sigma_dot``; how `sigma` grows with time is another matter (:mod:`artibot_sim.planning.route`). All
# arrays are (n,), in SI units; poses are relative to the shape's start.
# ----------------------------------------------------------------------


def chord(curvature: Array | float, arc: Array) -> tuple[Array, Array]:
    """End point (x, y) of an arc that starts along x; exact, and stable where the curvature vanishes."""
    half = 0.5 * np.asarray(curvature) * arc
    length = arc * np.sinc(half / math.pi)
    return length * np.cos(half), length * np.sin(half)


@dataclass(frozen=True)
class Shape(ABC):
    """A path from its start to `length` (in the unit of the progress)."""

    length: float

    @abstractmethod
    def advance(self, sigma: Array) -> Array:
        """Forward motion per progress; negative in reverse."""

    @abstractmethod
    def turn(self, sigma: Array) -> Array:
        """Change of yaw per progress."""

    @abstractmethod
    def arc(self, sigma: Array) -> Array:
        """Signed distance driven from the start, m."""

    @abstractmethod
    def yaw(self, sigma: Array) -> Array:
        """Yaw relative to the start, rad."""

    @abstractmethod
    def _edges(self) -> Array:
        """Cells for the quadrature of the position."""

    @cached_property
    def _running(self) -> Running:
        def slope(sigma: Array) -> Array:
            yaw, advance = self.yaw(sigma.ravel()), self.advance(sigma.ravel())
            return np.stack([advance * np.cos(yaw), advance * np.sin(yaw)], axis=-1).reshape(*sigma.shape, 2)

        return Running(slope, self._edges())

    def position(self, sigma: Array) -> tuple[Array, Array]:
        """Position (x, y) relative to the start, m."""
        xy = self._running(sigma)
        return xy[:, 0], xy[:, 1]


@dataclass(frozen=True)
class PathShape(Shape):
    """A path given by its curvature over its length in m, driven forward (direction 1) or in reverse (-1)."""

    direction: float

    def advance(self, sigma: Array) -> Array:
        return np.full_like(sigma, self.direction)

    def turn(self, sigma: Array) -> Array:
        return self.direction * self.curvature(sigma)

    def arc(self, sigma: Array) -> Array:
        return self.direction * sigma

    @abstractmethod
    def curvature(self, sigma: Array) -> Array:
        """Curvature, 1/m, positive to the left."""

    @abstractmethod
    def part(self, start: float, end: float) -> PathShape:
        """The piece between two distances."""


@dataclass(frozen=True)
class Clothoid(PathShape):
    """Curvature linear in the arc length: straights, arcs and spirals."""

    start_curvature: float
    slope: float = 0.0

    def curvature(self, sigma: Array) -> Array:
        return self.start_curvature + self.slope * sigma

    def yaw(self, sigma: Array) -> Array:
        return self.direction * (self.start_curvature + 0.5 * self.slope * sigma) * sigma

    def position(self, sigma: Array) -> tuple[Array, Array]:
        if self.slope == 0:
            return chord(self.start_curvature, self.direction * sigma)
        return super().position(sigma)

    def part(self, start: float, end: float) -> Clothoid:
        return Clothoid(end - start, self.direction, self.start_curvature + self.slope * start, self.slope)

    def _edges(self) -> Array:
        largest = max(abs(self.start_curvature), abs(self.start_curvature + self.slope * self.length))
        return cells([0.0, self.length], largest * self.length)


@dataclass(frozen=True)
class Sine(PathShape):
    """Curvature ``amplitude * sin(wavenumber * sigma + phase)``."""

    amplitude: float
    wavenumber: float
    phase: float = 0.0

    def curvature(self, sigma: Array) -> Array:
        return self.amplitude * np.sin(self.wavenumber * sigma + self.phase)

    def yaw(self, sigma: Array) -> Array:
        # cos(p) - cos(p + k s) without the cancellation near s = 0
        half = 0.5 * self.wavenumber * sigma
        difference = 2.0 * np.sin(half + self.phase) * np.sin(half)
        return self.direction * self.amplitude / self.wavenumber * difference

    def part(self, start: float, end: float) -> Sine:
        phase = self.phase + self.wavenumber * start
        return Sine(end - start, self.direction, self.amplitude, self.wavenumber, phase)

    def _edges(self) -> Array:
        return cells([0.0, self.length], (abs(self.amplitude) + self.wavenumber) * self.length)


@dataclass(frozen=True)
class SpotTurn(Shape):
    """A turn in place; progress is the angle turned, `sense` 1 to the left and -1 to the right."""

    sense: float

    def advance(self, sigma: Array) -> Array:
        return np.zeros_like(sigma)

    def turn(self, sigma: Array) -> Array:
        return np.full_like(sigma, self.sense)

    def arc(self, sigma: Array) -> Array:
        return np.zeros_like(sigma)

    def yaw(self, sigma: Array) -> Array:
        return self.sense * sigma

    def position(self, sigma: Array) -> tuple[Array, Array]:
        return np.zeros_like(sigma), np.zeros_like(sigma)

    def _edges(self) -> Array:
        return np.array([0.0, self.length])


@dataclass(frozen=True)
class Wave:
    """A faded chirp in time: amplitude, frequencies in Hz, duration and fade in s."""

    amplitude: float
    start_frequency: float
    end_frequency: float
    duration: float
    fade: float

    def __call__(self, t: Array) -> Array:
        sweep = (self.end_frequency - self.start_frequency) / self.duration
        phase = 2 * math.pi * (self.start_frequency + 0.5 * sweep * t) * t
        return self.amplitude * self._envelope(t) * np.sin(phase)

    def _envelope(self, t: Array) -> Array:
        u = np.clip(np.minimum(t, self.duration - t) / self.fade, 0.0, 1.0)
        return u * u * (3.0 - 2.0 * u)

    def edges(self, more_phase: float) -> Array:
        """Cells between the fades' kinks."""
        fastest = 2 * math.pi * max(self.start_frequency, self.end_frequency) * self.duration
        return cells([0.0, self.fade, self.duration - self.fade, self.duration], fastest + more_phase)

    def peak_slope(self) -> float:
        """Largest rate of change, by dense sampling (relative error below 1e-4)."""
        per_cycle = 400
        cycles = max(self.start_frequency, self.end_frequency) * self.duration + self.duration / self.fade
        t = np.linspace(0.0, self.duration, int(per_cycle * cycles) + 2)
        return float(np.max(np.abs(np.diff(self(t)) / np.diff(t))))

    @cached_property
    def _running(self) -> Running:
        return Running(lambda t: self(t)[..., None], self.edges(0.0))

    def integral(self, t: Array) -> Array:
        """Integral from 0."""
        return self._running(t)[:, 0]


@dataclass(frozen=True)
class YawWave(Shape):
    """A yaw rate given in time at constant speed; progress is time."""

    speed: float
    wave: Wave

    def advance(self, sigma: Array) -> Array:
        return np.full_like(sigma, self.speed)

    def turn(self, sigma: Array) -> Array:
        return self.wave(sigma)

    def arc(self, sigma: Array) -> Array:
        return self.speed * sigma

    def yaw(self, sigma: Array) -> Array:
        return self.wave.integral(sigma)

    def _edges(self) -> Array:
        return self.wave.edges(abs(self.wave.amplitude) * self.wave.duration)


@dataclass(frozen=True)
class SpeedWave(Shape):
    """A speed given in time on an arc or straight; progress is time."""

    speed: float
    curvature: float
    wave: Wave

    def advance(self, sigma: Array) -> Array:
        return self.speed + self.wave(sigma)

    def turn(self, sigma: Array) -> Array:
        return self.curvature * self.advance(sigma)

    def arc(self, sigma: Array) -> Array:
        return self.speed * sigma + self.wave.integral(sigma)

    def yaw(self, sigma: Array) -> Array:
        return self.curvature * self.arc(sigma)

    def position(self, sigma: Array) -> tuple[Array, Array]:
        return chord(self.curvature, self.arc(sigma))

    def _edges(self) -> Array:
        return self.wave.edges(0.0)
