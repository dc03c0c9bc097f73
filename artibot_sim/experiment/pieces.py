"""Rollouts of a segment's windows, one after the other, and the simulation at any instant of it."""

from __future__ import annotations

import numpy as np

from artibot_sim.experiment.columns import Floats
from artibot_sim.experiment.local_fit import hermite
from artibot_sim.model import Rollout, Status
from artibot_sim.model.layout import M_M

_EPSILON = 1e-7  # s: stamps are whole nanoseconds, knots are not


class Pieces:
    """What was simulated of one segment.

    Parameters
    ----------
    t_start, t_end : s; instants outside have no simulation.
    """

    def __init__(self, t_start: float, t_end: float) -> None:
        self.t_start = t_start
        self.t_end = t_end
        self._windows: list[list[Rollout]] = []

    def __len__(self) -> int:
        return len(self._windows)

    def add(self, result: Rollout, first: bool) -> None:
        """Append a rollout: the first of a window, or one that goes on from the last."""
        if len(result.t) < 2 or not np.isfinite(result.q).all():
            return
        if first:
            self._windows.append([])
        self._windows[-1].append(result)

    def covers(self, t: Floats) -> np.ndarray:
        """Say at which times (n,) there is a simulation."""
        inside = np.zeros(len(t), bool)
        for number, window in enumerate(self._windows):
            inside |= self._within(t, number, window)
        return inside & (t >= self.t_start - _EPSILON) & (t <= self.t_end + _EPSILON)

    def _within(self, t: Floats, number: int, window: list[Rollout]) -> np.ndarray:
        """Say which times belong to a window: its end does, its start only to the segment's first."""
        first, last = window[0].t[0], window[-1].t[-1]
        early = first - _EPSILON if number == 0 else first + _EPSILON
        return (t > early) & (t <= last + _EPSILON)

    def at(self, t: Floats) -> Rollout:
        """Return the simulation at times (n,) that are covered: as a rollout whose rows are at these times.

        Coordinates are interpolated by the cubics that their rates give, rates and motor torques linearly; other
        contributions are NaN.
        """
        some = self._windows[0][0]
        q, v = np.full((2, len(t), 16), np.nan)
        row = np.full((len(t), some.row.shape[1]), np.nan)
        for number, window in enumerate(self._windows):
            rows = np.flatnonzero(self._within(t, number, window))
            if not len(rows):
                continue
            times, all_q, all_v, all_m = _joined(window)
            at = np.clip(t[rows], times[0], times[-1])
            i = np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(times) - 2)
            q[rows], _ = hermite(times[i], times[i + 1], all_q[i], all_q[i + 1], all_v[i], all_v[i + 1], at)
            share = ((at - times[i]) / (times[i + 1] - times[i]))[:, None]
            v[rows] = all_v[i] + share * (all_v[i + 1] - all_v[i])
            row[rows, M_M : M_M + 4] = all_m[i] + share * (all_m[i + 1] - all_m[i])
        return Rollout(some.robot, Status.OK, "interpolated", np.array(t), q, v, row, None, None, some.modes)


def _joined(window: list[Rollout]) -> tuple[Floats, Floats, Floats, Floats]:
    """Return times, coordinates, rates and motor torques of a window's rollouts; a shared instant stands once."""
    ends = [*(-1 for _ in window[1:]), None]
    parts = [(r.t[:end], r.q[:end], r.v[:end], r.motor_torque[:end]) for r, end in zip(window, ends, strict=True)]
    t, q, v, m = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return t, q, v, m
