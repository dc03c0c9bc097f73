"""Rollouts of a segment's windows, one after the other, and the simulation at any instant of it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from artibot_sim.experiment.columns import Floats
from artibot_sim.experiment.local_fit import hermite
from artibot_sim.model import Mode, Robot, Rollout, Status
from artibot_sim.model.layout import M_M, ROW

_EPSILON = 1e-7  # s: stamps are whole nanoseconds, knots are not


class _Part(NamedTuple):
    """What is kept of a rollout: a third of its numbers, for two hours of them are gigabytes."""

    t: Floats
    q: Floats
    v: Floats
    torque: Floats


class Pieces:
    """What was simulated of one segment.

    Parameters
    ----------
    t_start, t_end : s; instants outside have no simulation.
    """

    def __init__(self, t_start: float, t_end: float) -> None:
        self.t_start = t_start
        self.t_end = t_end
        self._windows: list[list[_Part]] = []
        self._robot: Robot | None = None
        self._modes: tuple[Mode, ...] = ()

    def __len__(self) -> int:
        return len(self._windows)

    def add(self, result: Rollout, first: bool) -> None:
        """Append a rollout, later than all before: the first of a window, or one that goes on from the last."""
        if len(result.t) < 2 or not np.isfinite(result.q).all():
            return
        if first:
            self._windows.append([])
        self._robot, self._modes = result.robot, result.modes
        self._windows[-1].append(_Part(result.t, result.q, result.v, result.motor_torque.copy()))

    def covers(self, t: Floats) -> NDArray[np.bool_]:
        """Say at which times (n,) there is a simulation."""
        inside = self._window(t) >= 0
        return inside & (t >= self.t_start - _EPSILON) & (t <= self.t_end + _EPSILON)

    def _window(self, t: Floats) -> NDArray[np.int64]:
        """Return the window that each time (n,) belongs to, −1 for none.

        A window's end belongs to it, its start to the one before, or if there is none to itself.
        """
        if not self._windows:
            return np.full(len(t), -1)
        first = np.array([window[0].t[0] for window in self._windows])
        last = np.array([window[-1].t[-1] for window in self._windows])
        early = first + _EPSILON
        early[0] = first[0] - _EPSILON
        number = np.searchsorted(early, t, side="left") - 1
        return np.where((number >= 0) & (t <= last[number] + _EPSILON), number, -1)

    def at(self, t: Floats) -> Rollout:
        """Return the simulation at times (n,) that are covered: as a rollout whose rows are at these times.

        Coordinates are interpolated by the cubics that their rates give, rates and motor torques linearly; other
        contributions are NaN.
        """
        q, v = np.full((2, len(t), 16), np.nan)
        row = np.full((len(t), ROW), np.nan)
        number = self._window(t)
        order = np.argsort(number, kind="stable")
        bounds = np.searchsorted(number[order], np.arange(len(self._windows) + 1))
        for window, begin, end in zip(self._windows, bounds[:-1], bounds[1:], strict=True):
            rows = order[begin:end]
            if not len(rows):
                continue
            window[:] = [_joined(window)]  # once; a recording is looked at piece by piece
            times, all_q, all_v, all_m = window[0]
            at = np.clip(t[rows], times[0], times[-1])
            i = np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(times) - 2)
            q[rows], _ = hermite(times[i], times[i + 1], all_q[i], all_q[i + 1], all_v[i], all_v[i + 1], at)
            share = ((at - times[i]) / (times[i + 1] - times[i]))[:, None]
            v[rows] = all_v[i] + share * (all_v[i + 1] - all_v[i])
            row[rows, M_M : M_M + 4] = all_m[i] + share * (all_m[i + 1] - all_m[i])
        assert self._robot is not None, "nothing was simulated"
        return Rollout(self._robot, Status.OK, "interpolated", np.array(t), q, v, row, None, None, self._modes)


def _joined(window: list[_Part]) -> _Part:
    """Return a window's rollouts as one; a shared instant stands once."""
    if len(window) == 1:
        return window[0]
    ends = [*(-1 for _ in window[1:]), None]
    parts = [tuple(array[:end] for array in part) for part, end in zip(window, ends, strict=True)]
    return _Part(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))
