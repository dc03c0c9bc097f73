"""A recording cut into windows, each with a start of its own and the samples that it has to explain."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from artibot_sim.estimation.measurements import CHANNELS, PAST, Stretch
from artibot_sim.experiment.inputs import plausible_motion, start_state
from artibot_sim.experiment.measured import MeasuredMotion, forward_speed
from artibot_sim.model import Robot
from artibot_sim.model.effects import stiction, wheel_windup
from artibot_sim.model.effects.tyre_relaxation import EFFECT, SLOWEST
from artibot_sim.model.equations.contact import steady_bending
from artibot_sim.model.kernels.layout import BACK, GAMMA, THETA_L, THETA_R, X, Y
from artibot_sim.model.robot.derived import params, train
from artibot_sim.model.robot.environment import STANDARD_GRAVITY
from artibot_sim.model.robot.parameters import ModuleParams
from artibot_sim.model.simulate.rollout import motor_coordinates
from artibot_sim.model.simulate.sensors import sensor_errors, true_starts
from artibot_sim.model.simulate.state import initial_state, posture_at_rest
from artibot_sim.model.simulate.window_inputs import KINDS, SamplingPlan, by_numbers

# ----------------------------------------------------------------------
# Where windows start: the measured state and its uncertainty, and the model's state at many guesses of it.
# ----------------------------------------------------------------------


START = ("x", "y", "yaw", "forward", "left", "yaw_rate", "articulation", "articulation_rate")
"""What a start is described by: pose in `map` (m, rad), velocity in the front module's frame (m/s, rad/s), joint.

Angle and rate of each joint behind the first follow (`start_names`); what is said of START is said of all of these.
"""
_RIGID = 6
"""So many of them describe a robot without joints."""


def start_names(robot: Robot) -> tuple[str, ...]:
    """What a start of a robot of any number of modules is described by."""
    joints = [f"_{j + 1}" if j else "" for j in range(len(robot.modules) - 1)]
    return START[:_RIGID] + tuple(f"{what}{number}" for number in joints for what in START[_RIGID:])


def for_starts(values: Array, size: int) -> Array:
    """Values (8,) in the order of START for starts of `size` numbers: those of the first joint for every joint."""
    return np.append(values[:_RIGID], np.tile(values[_RIGID:], (size - _RIGID) // 2))


def _of_first(names: Sequence[str]) -> list[str]:
    """The names with those of joints behind the first replaced by the first one's: sizes are alike."""
    return [name if name in START else name.rsplit("_", 1)[0] for name in names]


_SD = {
    "x": 0.03, "y": 0.03, "yaw": 0.1, "forward": 0.03, "left": 0.03, "yaw_rate": 0.015, "articulation": 0.01,
    "articulation_rate": 0.05,
}  # fmt: skip
"""Standard deviations of the measured start. A window's own samples correct it, so these are wide; the heading's in
particular, which an integrated gyroscope would tie to its bias."""
_UNMEASURED = {"forward": 0.2, "left": 0.2, "yaw_rate": 0.3, "articulation": 0.5, "articulation_rate": 0.5, "yaw": 1.0}
"""Standard deviations of those parts of a start that nothing measures."""


@dataclass(frozen=True)
class WindowStart:
    """A window's start as measured.

    Attributes
    ----------
    mean, sd : array, shape (8,)
        In the order of START; a rigid robot has the first 6, a train two more for each joint behind the first.
    weight : array, shape (8, 8)
        weight · (start − mean) has unit covariance. What was measured is the velocity in `map`, so a start that heads
        more to the left has its velocity more to the right.
    q, v : array, shape (16,)
        The model's state at the mean, for sensors without errors; (8 modules,) of a train.
    late : bool
        Whether the heading was measured with the positions, and is as late as they may be.
    """

    mean: Array
    sd: Array
    weight: Array
    q: Array
    v: Array
    late: bool = False


def start_of(
    robot: Robot,
    motion: MeasuredMotion,
    angles: Array,
    speeds: Array,
    poor: frozenset[str] = frozenset(),
    known: Mapping[str, float] | None = None,
    late: bool = False,
    behind: Array | None = None,
) -> WindowStart:
    """A start from measurements.

    Parameters
    ----------
    robot : Robot
    motion : MeasuredMotion
        NaN is unknown.
    angles, speeds : array, shape (4,)
        Of the motors, rad and rad/s.
    poor : set of str
        Names of START that are measured badly though they have a value.
    known : mapping of str to float, optional
        Standard deviations of names of START that are measured better or worse than usual.
    late : bool
        See `WindowStart`.
    behind : array, shape (2, joints), optional
        Angles and rates of the joints behind the first, rad and rad/s; NaN is unknown.
    """
    c, s = np.cos(np.nan_to_num(motion.yaw)), np.sin(np.nan_to_num(motion.yaw))
    forward, left = c * motion.vx + s * motion.vy, c * motion.vy - s * motion.vx
    mean = np.array(
        [motion.x, motion.y, motion.yaw, forward, left, motion.yaw_rate, motion.articulation, motion.articulation_rate]
    )
    names = start_names(robot)
    if behind is not None:
        mean = np.append(mean, behind.T.ravel())
    mean, sizes = mean[: len(names)], _of_first(names)
    unmeasured = ~np.isfinite(mean) | np.array([name in poor for name in names])
    usual = _SD | dict(known or {})
    sd = np.array(
        [
            _UNMEASURED.get(name, usual[name]) if none else usual[name]
            for name, none in zip(sizes, unmeasured, strict=True)
        ]
    )
    turn = np.eye(len(names))
    turn[3, 2], turn[4, 2] = -np.nan_to_num(left), np.nan_to_num(forward)
    state = start_state(robot, motion, angles, speeds, behind=behind)
    return WindowStart(np.nan_to_num(mean), sd, turn / sd[:, None], state.q, state.v, late)


def turned(starts: Array, angle: float) -> Array:
    """Starts (n, 8 or 6) that head `angle` rad more to the left and move as before."""
    new = starts.copy()
    c, s = np.cos(angle), np.sin(angle)
    new[:, 2] += angle
    new[:, 3], new[:, 4] = c * starts[:, 3] + s * starts[:, 4], c * starts[:, 4] - s * starts[:, 3]
    return new


class Postures(NamedTuple):
    """Of some robots what a start takes from them.

    Attributes
    ----------
    level : array, shape (r, 16)
        At rest on their wheels: heights, roll and pitch; (r, 8 modules) of trains.
    arms : array, shape (r, joints, 2)
        How far each joint is behind the origin of the module ahead (l_f), and ahead of the next one's (l_b), m.
    sensors : array, shape (r, 6)
        `SensorErrors` of each.
    motors : list of int
        Where angles of motors stand in a state.
    passive : tuple of (int, float, float)
        Coordinates of each module without motors, its half track and its wheels' radius, m.
    """

    level: Array
    arms: Array
    sensors: Array
    motors: list[int]
    passive: tuple[tuple[int, float, float], ...]


def postures(robots: Sequence[Robot]) -> Postures:
    """What `states` needs to know of robots, which all have as many modules."""
    different, like = by_numbers(robots)
    one = robots[0]
    level = np.array([initial_state(r).q if r.trailing else posture_at_rest(params(r)) for r in different])
    arms = np.array([arms_of(robot) for robot in different]).reshape(len(different), -1, 2)
    sensors = np.array([sensor_errors(robot) for robot in different])
    passive = tuple(
        (8 * i, 0.5 * one.modules[i].i_y, one.wheel.r_w) for i, drive in enumerate(one.drives) if drive is None
    )
    return Postures(level[like], arms[like], sensors[like], motor_coordinates(one), passive)


def arms_of(robot: Robot) -> list[tuple[float, float]]:
    """How far each joint is behind the origin of the module ahead, and ahead of the next one's, m."""
    return [(hitch.l, module.l) for hitch, module in zip(robot.hitches, robot.modules[1:], strict=True)]


def states(
    of: Postures, robot: NDArray[np.int64], q: Array, v: Array, guesses: Array, late: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """The model's states at guesses of starts: q and v, shape (n, 16) each, or (n, 8 modules) of trains.

    Parameters
    ----------
    of : Postures
    robot : array of int, shape (n,)
    q, v : array, shape (n, 16)
        States whose motors are taken over, as their encoders show them.
    guesses : array, shape (n, 8 or 6)
        In the order of START, as sensors show it: a guess means another motion for a robot whose sensors have errors.
    late : array of bool, shape (n,)
        See `WindowStart`.

    Notes
    -----
    Joints are closed as seen from above (eq. 13), their rates as well; pitch, where there is any, changes that by
    less than 1e-4 of l, which eq. 25's stabilisation draws in.
    """
    turned = of.sensors[robot, :1]
    motor_q, motor_v = q[:, of.motors] / turned, v[:, of.motors] / turned
    guesses = true_starts(of.sensors[robot], guesses, late)
    q, v = of.level[robot], np.zeros_like(v)
    q[:, of.motors], v[:, of.motors] = motor_q, motor_v
    x, y, yaw, forward, left, rate = guesses[:, :_RIGID].T
    c, s = np.cos(yaw), np.sin(yaw)
    q[:, 0], q[:, 1], q[:, 5] = x, y, yaw
    v[:, 0], v[:, 1], v[:, 5] = c * forward - s * left, s * forward + c * left, rate
    for j in range(of.arms.shape[1]):
        a, b = 8 * j, 8 * (j + 1)
        l_f, l_b = of.arms[robot, j].T
        bend, bend_rate = guesses[:, _RIGID + 2 * j : _RIGID + 2 * j + 2].T
        yaw_b, rate_b = yaw + bend, rate + bend_rate
        c_b, s_b = np.cos(yaw_b), np.sin(yaw_b)
        q[:, b], q[:, b + 1] = q[:, a] - l_f * c - l_b * c_b, q[:, a + 1] - l_f * s - l_b * s_b
        v[:, b] = v[:, a] + l_f * rate * s + l_b * rate_b * s_b
        v[:, b + 1] = v[:, a + 1] - l_f * rate * c - l_b * rate_b * c_b
        q[:, b + 5], v[:, b + 5] = yaw_b, rate_b
        yaw, rate, c, s = yaw_b, rate_b, c_b, s_b
    for k, half, radius in of.passive:  # their wheels roll
        ahead = np.cos(q[:, k + 5]) * v[:, k] + np.sin(q[:, k + 5]) * v[:, k + 1]
        v[:, k + 6], v[:, k + 7] = (ahead + half * v[:, k + 5]) / radius, (ahead - half * v[:, k + 5]) / radius
    return q, v


# ----------------------------------------------------------------------
# A recording cut into windows, each with a start of its own and the samples that it has to explain.
# ----------------------------------------------------------------------


Array = NDArray[np.float64]
Indices = NDArray[np.int64]

CHANNEL_NAMES = tuple(CHANNELS)
HEADINGS = (KINDS.index("yaw"), KINDS.index("heading"))
"""Kinds that are angles in `map`."""
_CALM = 0.5
"""s around a start that should be calm."""
_SURE = 2.0
"""Standard deviation of a start's measured pose, in the noise of one sample."""
_POSITIONS = 4
"""Positions without which a window says nothing."""
_NEAR_START = 0.7
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
        WindowStart, s since the recording's beginning.
    start : WindowStart
    plan : SamplingPlan
        When and what was measured.
    value, sigma : array, shape (n,)
        Measured, and the standard deviation that its noise is taken to have.
    sensor : array, shape (n,)
        That of the sensor's own noise.
    channel : array of int, shape (n,)
        Places in CHANNEL_NAMES.
    """

    stretch: int
    first: int
    knots: int
    t: float
    start: WindowStart
    plan: SamplingPlan
    value: Array
    sigma: Array
    sensor: Array
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
        sigmas.append(series.spread[rows])
        channels.append(np.full(size, CHANNEL_NAMES.index(series.channel)))
    plan = SamplingPlan(np.concatenate(times), np.concatenate(kinds).astype(np.int64))
    sigma = np.concatenate(sigmas)
    return Window(
        number, first, knots, t, measured_start(stretch, robot, first), plan, np.concatenate(values), sigma, sigma,
        np.concatenate(channels).astype(np.int64),
    )  # fmt: skip


def measured_start(stretch: Stretch, robot: Robot, knot: int) -> WindowStart:
    """The state at a knot as the measurements around it give it."""
    inputs, measured, t = stretch.inputs, stretch.measured, float(stretch.inputs.t[knot])
    speeds = inputs.measured_velocity[knot]
    motion = plausible_motion(robot, measured.at(t), speeds)
    times, _ = measured.position()
    away = float(np.abs(times - t).min()) if len(times) else np.inf
    poor = frozenset({"forward", "left"} if away > _NEAR_START else set())
    if not len(measured.yaw_rate()[0]):
        poor |= {"yaw_rate"}
    behind = measured.behind(t, stretch.behind)
    if not motion.articulation_rate:  # its motors stand, and so does the robot
        behind[1] = 0.0
    return start_of(
        robot, motion, inputs.position[knot], speeds, poor, _known(stretch, motion), measured.late_heading, behind
    )


def _known(stretch: Stretch, motion: MeasuredMotion) -> dict[str, float]:
    """How well a measured pose is known: where headings are measured, too, a start need not guess its own."""
    series = {one.channel: one for one in stretch.series}
    if "yaw" not in series:
        return {}

    def sd(channel: str, rate: float, most: float) -> float:
        one = series[channel]
        return float(np.hypot(min(_SURE * one.sigma, most), _SURE * one.jitter * np.nan_to_num(rate)))

    heading = {"yaw": sd("yaw", motion.yaw_rate, 0.1)} if stretch.measured.late_heading else {}
    return {"x": sd("position", motion.vx, 0.03), "y": sd("position", motion.vy, 0.03)} | heading


# ----------------------------------------------------------------------
# Lateral forces that lag, where windows start: they remember the way that the wheels came.
# ----------------------------------------------------------------------


_SAMPLES = round(6.0 / PAST)
"""So many before a window's start are remembered."""
_NEAR_PAST = 0.25
"""s around a start whose motion, in the mean, is the start's: single rates are noisy."""
_BENDINGS = 6
"""Times that bristles and friction are found in turn: within a few per cent of what a simulation comes to."""
_WINDING = 3.0
"""s for which wheels have slipped before a window as they do at its start: most turns take longer."""


class Past(NamedTuple):
    """How wheels came to where windows start, as measured.

    Attributes
    ----------
    distance : array, shape (windows, m + 1)
        How far away each of m intervals before the start begins, m, the oldest first; 0 at the start.
    lateral : array, shape (windows, m, modules, 5)
        By how much each module's lateral velocity (m/s) and turn rate (rad/s) differed in those from what they are
        at the start; then, by how much what the place of the tracked point adds to that velocity did, for a metre
        ahead of the front module's origin and for a metre to its left (m/s); last, the same of what a radian adds by
        which the measured heading is too large (m/s).
    """

    distance: Array
    lateral: Array


def past_of(stretches: Sequence[Stretch], windows: Sequence[Window], arms: Sequence[tuple[float, float]]) -> Past:
    """The way before every window; before a stretch begins all was as it starts. `arms` are those of `arms_of`, m."""
    distance, lateral = np.zeros((len(windows), _SAMPLES + 1)), np.zeros((len(windows), _SAMPLES, len(arms) + 1, 5))
    for i, window in enumerate(windows):
        times, motion = stretches[window.stretch].motion
        last = int(np.searchsorted(times, window.t, side="right"))
        speed, side = _in_modules(motion[max(0, last - _SAMPLES) : last], arms)
        n = len(speed)
        if not n:
            continue
        _, here = _in_modules(motion[np.abs(times - window.t) <= _NEAR_PAST], arms)
        side = side - here.mean(axis=0)
        side[..., 4] *= stretches[window.stretch].measured.late_heading
        steps = PAST * np.maximum(np.abs(speed), SLOWEST)
        distance[i, :] = steps.sum()
        distance[i, _SAMPLES - n : -1] = np.cumsum(steps[::-1])[::-1]
        distance[i, -1] = 0.0
        lateral[i, _SAMPLES - n :] = side
    return Past(distance, lateral)


def relaxation_length(robot: Robot) -> float:
    """Way over which its tyres' lateral forces build up, m; 0 where they do so at once."""
    return float(robot.effects.get(EFFECT.id, {}).get("length", 0.0))


def time_over(stretch: Stretch, t: float, distance: float) -> float:
    """Time from `t` (s) on in which the wheels come so far (m) as lagging forces count it, s."""
    times, motion = stretch.motion
    speed = np.abs(forward_speed(np.nan_to_num(motion[times >= t])))
    return PAST * int(np.searchsorted(np.cumsum(PAST * np.maximum(speed, SLOWEST)), distance))


def _in_modules(motion: Array, arms: Sequence[tuple[float, float]]) -> tuple[Array, Array]:
    """Forward speed (n,) of the tracked point; modules' lateral velocities, turn rates and leverage (n, modules, 5)."""
    motion = np.nan_to_num(motion)
    _, _, yaw, vx, vy, rate, *bends = motion.T
    forward, left = forward_speed(motion), np.cos(yaw) * vy - np.sin(yaw) * vx
    ahead, aside, along, across = forward, left, np.ones_like(rate), np.zeros_like(rate)
    turned, astray = -left, forward
    found, front = [np.column_stack([left, rate, rate, np.zeros_like(rate), astray])], rate
    for (l_f, l_b), bend, bend_rate in zip(arms, bends[::2], bends[1::2], strict=False):
        c, s, rate_b = np.cos(bend), np.sin(bend), rate + bend_rate
        beside = aside - l_f * rate
        behind = -s * ahead + c * beside - l_b * rate_b
        along, across = c * along - s * across, c * across + s * along
        turned, astray = c * turned + s * astray, c * astray - s * turned
        found.append(np.column_stack([behind, rate_b, along * front, across * front, astray]))
        ahead, aside, rate = c * ahead + s * beside, behind, rate_b
    return forward, np.stack(found, axis=1)


def lagging_forces(robots: Sequence[Robot], robot: Indices, window: Indices, q: Array, v: Array, past: Past) -> Array:
    """Lateral forces (n, 4 modules) at starts q and v: what the starts ask for, less what has yet to build up.

    dF/dt = (F_steady − F) |p_x| / length is a mean over the way that the wheel came, the last `length` weighing most.
    """
    found = np.zeros((len(robot), 4 * max(2, len(robots[0].modules))))
    for r, one in enumerate(robots):
        rows = np.flatnonzero(robot == r)
        length = relaxation_length(one)
        if not length or not len(rows):
            continue
        seen = sensor_errors(one)
        left = np.exp(-past.distance[window[rows]] / length)
        weight = np.diff(left, axis=1)
        weight[:, 0] += left[:, 0]
        behind = np.einsum("wm,wmab->wab", weight, past.lateral[window[rows]])
        for module, p in enumerate(train(one).modules if one.articulated else (params(one),)):
            body = p.front
            b = BACK * module
            c, s = np.cos(q[rows, b + GAMMA]), np.sin(q[rows, b + GAMMA])
            aside = c * v[rows, b + Y] - s * v[rows, b + X] + behind[:, module, 0]
            aside -= seen.arm_x * behind[:, module, 2] + seen.arm_y * behind[:, module, 3]
            aside += seen.heading * behind[:, module, 4]
            sweep = body.half_x * (v[rows, b + GAMMA] + behind[:, module, 1])
            ends = -body.k_t * np.column_stack([aside + sweep, aside - sweep])
            found[rows, 4 * module : 4 * module + 4] = np.tile(ends, 2)
    return found


def _slipping(robot: Robot, q: Array, v: Array) -> Iterator[tuple[int, ModuleParams, Array, Array]]:
    """Its wheels at starts q and v: number, module, speed of the rim (n,) and slip along and across (n, 2), m/s."""
    for module, p in enumerate(train(robot).modules if robot.articulated else (params(robot),)):
        b = BACK * module
        c, s = np.cos(q[:, b + GAMMA]), np.sin(q[:, b + GAMMA])
        ahead, aside = c * v[:, b + X] + s * v[:, b + Y], c * v[:, b + Y] - s * v[:, b + X]
        rate = v[:, b + GAMMA]
        sides = (p.right_front, THETA_R, p.front.half_y), (p.left_front, THETA_L, -p.front.half_y)
        for side, (unit, motor, right) in enumerate(sides):
            rim = unit.r_w * unit.tau * v[:, b + motor]
            for end, before in enumerate((p.front.half_x, -p.front.half_x)):
                slip = np.column_stack([rim - ahead - right * rate, -(aside + before * rate)])
                yield 4 * module + 2 * side + end, p.front, rim, slip


def wound_wheels(robots: Sequence[Robot], robot: Indices, q: Array, v: Array) -> Array:
    """How far wheels are wound up (n, 4 modules), −1 to 1, at starts q and v: as after `_WINDING` at these speeds."""
    found = np.zeros((len(robot), q.shape[1] // 2))
    for r, one in enumerate(robots):
        rows = np.flatnonzero(robot == r)
        way = float(one.effects.get(wheel_windup.EFFECT.id, {}).get("way", 0.0))
        if way and len(rows):
            for wheel, _, _, slip in _slipping(one, q[rows], v[rows]):
                found[rows, wheel] = np.sign(slip[:, 0]) * -np.expm1(-np.abs(slip[:, 0]) * _WINDING / way)
    return found


def bent_bristles(robots: Sequence[Robot], robot: Indices, q: Array, v: Array) -> Array:
    """How far bristles are bent along wheels and then across (n, 8 modules), m, at starts q and v.

    They are taken to have come to where they stay at these speeds, under static loads (`equations.contact.bending`).
    What other effects make of stiffness and friction is left out: rolling mends it within `length`.
    """
    wheels = q.shape[1] // 2
    found = np.zeros((len(robot), 2 * wheels))
    for r, one in enumerate(robots):
        rows = np.flatnonzero(robot == r)
        length = float(one.effects.get(stiction.EFFECT.id, {}).get("length", 0.0))
        if length and len(rows):
            for wheel, body, rim, slip in _slipping(one, q[rows], v[rows]):
                bent, holds = np.empty(slip.shape), body.mu_s * body.m * STANDARD_GRAVITY / 4.0
                steady_bending(body, 1.0 / stiction.TIME, holds, slip, np.abs(rim) / length, _BENDINGS, bent)
                found[rows, wheel], found[rows, wheels + wheel] = bent.T
    return found
