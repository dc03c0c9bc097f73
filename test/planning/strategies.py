"""Random manoeuvres and a robot for the planning tests."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
from hypothesis import strategies as st

from artibot_sim.planning import (
    Arc,
    Dwell,
    Eight,
    Manoeuvre,
    Plan,
    PlanSample,
    Ramp,
    Repeat,
    Segment,
    Slalom,
    SpeedChirp,
    Spiral,
    Stop,
    Straight,
    TurnInPlace,
    YawRateChirp,
    plan,
)

AGRIQ: Any = SimpleNamespace(
    name="agriq",
    front=SimpleNamespace(i_y=0.72),
    wheel=SimpleNamespace(r_w=0.2),
    drive_front=SimpleNamespace(tau=1 / 47.64),
)
"""What planning needs to know of Agri.q."""

A_MAX = 0.5
"""Largest acceleration of the random manoeuvres, m/s²."""


def number(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_nan=False, allow_infinity=False)


def signed(low: float, high: float) -> st.SearchStrategy[float]:
    return st.tuples(number(low, high), st.sampled_from([-1.0, 1.0])).map(lambda pair: pair[0] * pair[1])


def driven() -> st.SearchStrategy[Segment]:
    """Paths to be driven at the speed reached before them."""
    curvature = number(-0.8, 0.8)
    frequencies = {"start_frequency": number(0.05, 0.5), "end_frequency": number(0.05, 1.0)}
    return st.one_of(
        st.builds(Straight, length=number(0.1, 4.0)),
        st.builds(Arc, radius=number(1.0, 5.0), angle=signed(0.1, 6.0)),
        st.builds(Spiral, length=number(0.5, 5.0), start_curvature=curvature, end_curvature=curvature),
        st.builds(
            Slalom, curvature=curvature, wavelength=number(3.0, 9.0), periods=number(0.3, 2.0), phase=number(-6.0, 6.0)
        ),
        st.builds(Eight, radius=number(1.0, 2.0), left_first=st.booleans(), smooth=st.just(True)),
        st.builds(YawRateChirp, amplitude=number(-0.5, 0.5), duration=number(2.0, 6.0), **frequencies),
        st.builds(
            SpeedChirp, amplitude=number(-0.03, 0.03), duration=number(2.0, 6.0), curvature=curvature, **frequencies
        ),
    )


def standing() -> st.SearchStrategy[Segment]:
    """What is done at standstill."""
    return st.one_of(
        st.builds(Dwell, duration=number(0.1, 2.0)),
        st.builds(TurnInPlace, angle=signed(0.05, 4.0), yaw_rate=number(0.2, 0.8), yaw_a_max=number(0.2, 1.0)),
    )


@st.composite
def excursions(draw: st.DrawFn) -> list[Segment]:
    """From rest to rest, forward or in reverse."""
    direction = draw(st.sampled_from([-1.0, 1.0]))
    parts: list[Segment] = [*draw(st.lists(standing(), max_size=1))]
    parts.append(Ramp(direction * draw(number(0.2, 1.0)), draw(number(-0.5, 0.5))))
    for segment in draw(st.lists(driven(), min_size=1, max_size=3)):
        parts += [segment] if draw(st.booleans()) else [segment, Ramp(direction * draw(number(0.2, 1.0)))]
    return [*parts, Stop()]


@st.composite
def manoeuvres(draw: st.DrawFn) -> Manoeuvre:
    """Random sequences from rest to rest."""
    parts = [segment for part in draw(st.lists(excursions(), min_size=1, max_size=2)) for segment in part]
    if draw(st.booleans()):
        parts = [Repeat(2, tuple(parts))]
    return Manoeuvre("random", tuple(parts), a_max=A_MAX)


def starts() -> st.SearchStrategy[tuple[float, float, float]]:
    return st.tuples(number(-50.0, 50.0), number(-50.0, 50.0), number(-7.0, 7.0))


def of(*segments: Segment, **more: Any) -> Plan:
    """The plan of some segments for Agri.q."""
    return plan(Manoeuvre("test", segments, a_max=A_MAX, **more), AGRIQ)


def integral(p: Plan, rate: Callable[[PlanSample], np.ndarray], cell: float = 0.02) -> tuple[np.ndarray, np.ndarray]:
    """Times, and the running integral of `rate` (n, width) from 0, by Gauss-Legendre within small cells.

    Cells end where segments do; within a segment the motion must be smooth.
    """
    edges = np.concatenate(
        [np.linspace(mark.start, mark.end, int((mark.end - mark.start) / cell) + 2)[:-1] for mark in p.marks]
    )
    edges = np.append(edges, p.duration)
    nodes, weights = np.polynomial.legendre.leggauss(4)
    half = np.diff(edges)[:, None] / 2
    t = edges[:-1, None] + half * (1 + nodes)
    values = rate(p.at(t.ravel()))
    steps = np.einsum("k,nkw->nw", weights, values.reshape(*t.shape, -1)) * half
    return edges, np.concatenate([np.zeros((1, steps.shape[1])), np.cumsum(steps, axis=0)])
