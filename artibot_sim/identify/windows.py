"""A recording cut into windows, each with a start of its own and the samples that it has to explain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from artibot_sim.experiment.measured import Motion
from artibot_sim.identify.sensing import CHANNELS, Stretch
from artibot_sim.identify.starts import Start, start_of
from artibot_sim.model import Robot
from artibot_sim.model.windows import KINDS, Plan

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

CHANNEL_NAMES = tuple(CHANNELS)
HEADINGS = (KINDS.index("yaw"), KINDS.index("heading"))
"""Kinds that are angles in `map`."""
_STILL = 0.05
"""rad/s: a motor whose smoothed speed is less stands."""
_CALM = 0.5
"""s around a start that should be calm."""
_SURE = 2.0
"""Standard deviation of a start's measured pose, in the noise of one sample."""
_OVER = 0.1
"""How much faster than its wheels say a rigid rover may be measured to move, as a share of their speed."""
_POSITIONS = 4
"""Positions without which a window says nothing."""
_NEAR = 0.7
"""s without a position around a start, after which its pose and velocity count as badly known."""


@dataclass(frozen=True)
class Window:
    """A stretch of time with what was measured in it.

    Attributes
    ----------
    stretch : int
        Which stretch of the recordings.
    first, knots : int
        First knot of the stretch's inputs, and intervals.
    t : float
        Start, s since the recording's beginning.
    start : Start
    plan : Plan
        When and what was measured.
    value, sigma : array, shape (n,)
        Measured, and the noise's standard deviation.
    channel : array of int, shape (n,)
        Places in CHANNEL_NAMES.
    """

    stretch: int
    first: int
    knots: int
    t: float
    start: Start
    plan: Plan
    value: Array
    sigma: Array
    channel: Indices

    def __len__(self) -> int:
        return len(self.value)

    @cached_property
    def counts(self) -> Array:
        """Samples of each channel, shape (channels,)."""
        return np.bincount(self.channel, minlength=len(CHANNEL_NAMES)).astype(float)

    @cached_property
    def places(self) -> tuple[Indices, Indices, Indices]:
        """Which samples are x, y and angles in `map`."""
        kind = self.plan.kind
        x, y, heading = kind == 0, kind == 1, np.isin(kind, HEADINGS)
        return np.flatnonzero(x), np.flatnonzero(y), np.flatnonzero(heading)


def cut(found: Sequence[Stretch], robot: Robot, length: float, lead: float = 0.0) -> list[Window]:
    """All stretches cut into windows of about `length` s; a shorter stretch is one window.

    With a `lead` (s) every window but a stretch's first begins so much earlier, in the one before, and that part is
    not compared: slip forgets within tenths of a second with which velocities a window began.
    """
    windows: list[Window] = []
    for i, stretch in enumerate(found):
        knots = len(stretch.inputs.t) - 1
        count = max(1, round(knots * stretch.inputs.dt / length))
        edges = _calm(stretch, np.linspace(0, knots, count + 1).round().astype(int))
        before = round(lead / stretch.inputs.dt)
        for a, b in zip(edges.tolist(), edges[1:].tolist(), strict=False):
            first = max(0, a - before)
            windows.append(window_at(stretch, i, robot, first, b - first, a - first))
    return [window for window in windows if (window.channel == 0).sum() >= 2 * _POSITIONS]


def predecessors(windows: Sequence[Window]) -> list[int | None]:
    """For each window which one runs when it begins, None where none does."""
    found: list[int | None] = []
    for window in windows:
        running = [
            i for i, w in enumerate(windows)
            if w.stretch == window.stretch and w.first < window.first <= w.first + w.knots
        ]  # fmt: skip
        found.append(max(running, key=lambda i: windows[i].first) if running else None)
    return found


def _calm(stretch: Stretch, edges: Indices) -> Indices:
    """Edges moved by up to an eighth of a window to where least happens.

    A window that starts while a wheel breaks away is explained by its start or not at all.
    """
    inputs, new = stretch.inputs, edges.copy()
    unrest = _unrest(stretch)
    for k in range(1, len(edges) - 1):
        reach = (edges[k + 1] - edges[k]) // 8
        near = np.arange(edges[k] - reach, edges[k] + reach + 1)
        # a tie, as at standstill, leaves the edge where it is
        new[k] = near[np.argmin(unrest[near] + 1e-6 * np.abs(near - edges[k]) * inputs.dt)]
    return new


def _unrest(stretch: Stretch) -> Array:
    """How much changes around each knot (n,): variances over _CALM of torques and rates over their noises'."""
    t = stretch.inputs.t
    total = np.zeros(len(t))
    for series in stretch.series:
        if series.channel in ("position", "yaw", "articulation_yaw") or len(series.t) < 10:
            continue
        value = np.interp(t, series.t, series.value)
        size = max(3, round(_CALM / stretch.inputs.dt))
        kernel = np.ones(size) / size
        mean = np.convolve(np.pad(value, size, mode="edge"), kernel, "same")[size:-size]
        square = np.convolve(np.pad(value**2, size, mode="edge"), kernel, "same")[size:-size]
        total += np.maximum(square - mean**2, 0.0) / series.sigma**2
    return total


def window_at(stretch: Stretch, number: int, robot: Robot, first: int, knots: int, lead: int = 0) -> Window:
    """The window from a knot on, its start estimated from the measurements around it; `lead` knots are not compared."""
    t = float(stretch.inputs.t[first])
    end = t + knots * stretch.inputs.dt
    times, kinds, values, sigmas, channels = [], [], [], [], []
    for series in stretch.series:
        # a sample on the border of two windows counts for the earlier one: a start is not predicted
        rows = slice(*np.searchsorted(series.t, (t + lead * stretch.inputs.dt + 1e-6, end + 1e-6)))
        size = len(series.t[rows])
        times.append(series.t[rows] - t)
        values.append(series.value[rows])
        kinds.append(np.full(size, series.kind))
        sigmas.append(np.hypot(series.sigma, series.slack[rows]))
        channels.append(np.full(size, CHANNEL_NAMES.index(series.channel)))
    plan = Plan(np.concatenate(times), np.concatenate(kinds).astype(np.int64))
    return Window(
        number, first, knots, t, measured_start(stretch, robot, first), plan, np.concatenate(values),
        np.concatenate(sigmas), np.concatenate(channels).astype(np.int64),
    )  # fmt: skip


def measured_start(stretch: Stretch, robot: Robot, knot: int) -> Start:
    """The state at a knot as the measurements around it give it."""
    inputs, measured, t = stretch.inputs, stretch.measured, float(stretch.inputs.t[knot])
    motion = measured.at(t)
    speeds = inputs.measured_velocity[knot]
    if (np.abs(speeds[np.isfinite(speeds)]) < _STILL).all():
        motion = motion._replace(vx=0.0, vy=0.0, yaw_rate=0.0, articulation_rate=0.0)
    times, _ = measured.position()
    away = float(np.abs(times - t).min()) if len(times) else np.inf
    poor = frozenset({"forward", "left"} if away > _NEAR else set())
    if not len(measured.yaw_rate()[0]):
        poor |= {"yaw_rate"}
    motion = _finite(motion, inputs.velocity[knot], robot)
    return start_of(robot, motion, inputs.position[knot], speeds, poor, _known(stretch), measured.late_heading)


def _known(stretch: Stretch) -> dict[str, float]:
    """How well a measured pose is known: where headings are measured, too, a start need not guess its own."""
    sigma = {series.channel: series.sigma for series in stretch.series}
    if "yaw" not in sigma:
        return {}
    place = min(_SURE * sigma["position"], 0.03)
    heading = {"yaw": min(_SURE * sigma["yaw"], 0.1)} if stretch.measured.late_heading else {}
    return {"x": place, "y": place} | heading


def _finite(motion: Motion, speeds: Array, robot: Robot) -> Motion:
    """The motion with velocities of rolling where none could be measured; the articulation stays unknown."""
    wheels = np.nan_to_num(speeds[:2]) * robot.drive.front.tau * robot.wheel.r_w
    forward, yaw = float(wheels.mean()), float(np.nan_to_num(motion.yaw))
    if not np.isfinite([motion.vx, motion.vy]).all():
        motion = motion._replace(vx=forward * np.cos(yaw), vy=forward * np.sin(yaw))
    motion = motion._replace(yaw=yaw, yaw_rate=float(np.nan_to_num(motion.yaw_rate)))
    return motion if robot.articulated else _driven(motion, wheels, robot)


def _driven(motion: Motion, wheels: Array, robot: Robot) -> Motion:
    """A rigid rover's motion, no faster than its wheels make it.

    Its velocities are mostly differences of poses, and where those jump (6 m/s, 8 rad/s have been seen) no window
    could be predicted from them. `wheels` (2,) are the speeds of its rims, m/s.
    """
    c, s = np.cos(motion.yaw), np.sin(motion.yaw)
    over = _OVER * float(np.abs(wheels).max())
    turn = float(wheels[0] - wheels[1]) / robot.front.i_y
    rate = float(np.clip(motion.yaw_rate, min(turn, 0.0) - over, max(turn, 0.0) + over))
    forward = float(np.clip(c * motion.vx + s * motion.vy, wheels.min() - over, wheels.max() + over))
    aside = 0.5 * robot.front.i_x * abs(rate) + over
    left = float(np.clip(c * motion.vy - s * motion.vx, -aside, aside))
    return motion._replace(vx=c * forward - s * left, vy=s * forward + c * left, yaw_rate=rate)
