"""How far odometry goes astray on a recording with a reference: by wheels alone, and through the model."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize, minimize_scalar
from scipy.stats import chi2

from artibot_sim.errors import ArtibotError
from artibot_sim.estimation.model_odometry import ModelOdometry, StreamProperties
from artibot_sim.estimation.odometry import Slip, metres_per_radian
from artibot_sim.experiment.columns import Channel, Experiment
from artibot_sim.experiment.measured import dead_reckon
from artibot_sim.experiment.smoothing import fresh, noise_of
from artibot_sim.model import MOTORS, Robot
from artibot_sim.model.simulate.sensors import sensor_errors
from artibot_sim.progress import Report

Array = NDArray[np.float64]

LENGTH = 10.0
"""m that the faster side rolls in a window; a segment that is shorter is a window of its own."""
_LEAST = 0.3
"""Windows of less than so much of `LENGTH`, or of the longest window, are left out."""
ALIKE = 0.1
"""Two windows are driven alike where each side's ways differ by less than this share of the longest one."""
ENOUGH = 20
"""Windows to fit covariances on, at least: of fewer the 95 % quantile lies beyond the largest that was seen."""
_BIAS_SAID = 0.003
"""rad/s of a gyroscope's bias from which on it is said."""
_SURELY = 4.0
"""Standard deviations of a gyroscope's bias from which on it is said."""
SHORTEST = 0.5
"""m of a window to fit covariances on, at least."""
_FEWEST = 5
"""Nearly straight windows from which a spread is said."""
_BOUND = float(chi2.ppf(0.95, 3))
"""95 % of the normalised squared errors of three coordinates lie below."""


@dataclass(frozen=True)
class Motors:
    """What a recording says of its motors: times (n,) s, positions and speeds (n, m), NaN where nothing is said."""

    t: Array
    position: Array
    velocity: Array

    @classmethod
    def of(cls, experiment: Experiment, robot: Robot) -> Motors:
        """From `/motor_torques`."""
        channel = experiment.require("motor_torques")
        names = MOTORS if robot.articulated else MOTORS[:2]
        columns = [[_column(channel, f"{name}.{what}") for name in names] for what in ("position", "velocity")]
        return cls(channel.t, np.array(columns[0]).T, np.array(columns[1]).T)

    def rolled(self, metres: float) -> Array:
        """Ground that right and left side have rolled since the beginning (n, 2), m, without slip."""
        angle = self.position[:, :2].copy()
        missing = ~np.isfinite(angle).all(axis=1)
        if missing.all():
            speed = np.nan_to_num(self.velocity[:, :2])
            step = 0.5 * np.diff(self.t)[:, None] * (speed[1:] + speed[:-1])
            angle = np.concatenate([np.zeros((1, 2)), np.cumsum(step, axis=0)])
        else:
            for side in (0, 1):
                angle[missing, side] = np.interp(self.t[missing], self.t[~missing], angle[~missing, side])
        return (angle - angle[0]) * metres


def _column(channel: Channel, name: str) -> Array:
    return channel.columns.get(name, np.full(len(channel), math.nan))


@dataclass(frozen=True)
class OdometryWindow:
    """One window: where it led, and what odometry says.

    Attributes
    ----------
    begin, end : s
    sides : ground rolled by right and left (k, 2), m, from the window's beginning.
    truth : x, y (m) and yaw (rad) at the end, from the pose at the beginning.
    model : the same through the model, by name.
    covariance : of each, the reference's noise included.
    """

    begin: float
    end: float
    sides: Array
    truth: Array
    model: Mapping[str, Array]
    covariance: Mapping[str, Array]

    @property
    def rolled(self) -> float:
        """By the faster side, m."""
        return float(np.abs(np.diff(self.sides, axis=0)).sum(axis=0).max())

    def wheels(self, track: float, ratio: float = 0.0) -> Array:
        """Return x, y (m) and yaw (rad) at the end by wheels that roll without slip, `track` m apart.

        Those on the right go farther than those on the left by the share `ratio`.
        """
        right, left = (self.sides * (1.0 + 0.5 * ratio, 1.0 - 0.5 * ratio)).T
        travelled, turned = 0.5 * (right + left), (right - left) / track
        return np.asarray(dead_reckon(travelled, turned)[-1])


@dataclass(frozen=True)
class ReferencePoses:
    """Poses of the front module that were measured.

    Attributes
    ----------
    t : (n,) s, when they were true.
    pose : x, y (m) and yaw (rad), (n, 3).
    noise : (3,)
    delay : s, by which their stamps are later.
    """

    t: Array
    pose: Array
    noise: Array
    delay: float = 0.0

    @classmethod
    def of(cls, experiment: Experiment, robot: Robot, delay: float) -> ReferencePoses:
        """From `/ground_truth/odom`, each value once, stamped `delay` s late."""
        channel, errors = experiment.require("ground_truth_odom", "x", "y", "yaw"), sensor_errors(robot)
        pose = np.column_stack([channel["x"], channel["y"], channel["yaw"]])
        there = np.flatnonzero(np.isfinite(pose).all(axis=1))
        there = there[fresh(pose[there])]
        late = delay + errors.delay
        pose, t = pose[there], channel.t[there] - late
        pose[:, 2] -= errors.heading
        c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
        pose[:, 0] -= c * errors.arm_x - s * errors.arm_y
        pose[:, 1] -= s * errors.arm_x + c * errors.arm_y
        pose[:, 2] = np.unwrap(pose[:, 2])
        noise = [noise_of(t, column) if len(t) > 15 else math.nan for column in pose.T]
        return cls(t, pose, np.nan_to_num(noise), late)

    def known(self, begin: float, end: float) -> tuple[float, float] | None:
        """From when to when poses are known that are stamped between two instants (s); None where they are not."""
        t = self.t[(self.t + self.delay >= begin - 1e-6) & (self.t + self.delay <= end + 1e-6)]
        return (float(t[0]), float(t[-1])) if len(t) > 1 else None

    def between(self, begin: float, end: float) -> Array:
        """Pose (3,) at the end, seen from that at the beginning."""
        first, last = (np.array([np.interp(t, self.t, column) for column in self.pose.T]) for t in (begin, end))
        c, s = math.cos(first[2]), math.sin(first[2])
        x, y = (last - first)[:2]
        return np.array([c * x + s * y, c * y - s * x, last[2] - first[2]])


@dataclass(frozen=True)
class OdometrySettings:
    """How to measure.

    Attributes
    ----------
    length : m, see LENGTH.
    streams : of the measurements.
    pose_delay : by which reference poses are stamped late, s.
    slip : what the model leaves open.
    kappa : front share of the torque, see `ModelOdometry`.
    """

    length: float = LENGTH
    streams: StreamProperties = field(default_factory=StreamProperties)
    pose_delay: float = 0.0
    slip: Slip | None = None
    kappa: float | None = None


def pieces(
    experiment: Experiment, robot: Robot, settings: OdometrySettings, progress: Report | None = None
) -> list[OdometryWindow]:
    """Cut a recording into windows and carry odometry through each of them.

    Raises
    ------
    ArtibotError
        Where the recording has no rotations or no reference, or nothing moves in it.
    """
    motors, reference = Motors.of(experiment, robot), ReferencePoses.of(experiment, robot, settings.pose_delay)
    sides = motors.rolled(metres_per_radian(robot) / sensor_errors(robot).encoder_scale)
    gyro = _gyro(experiment)
    names = ["model"] + (["model and gyro"] if gyro is not None else [])
    lag = settings.streams.rotation_delay
    found: list[OdometryWindow] = []
    drives = list(_windows(experiment, motors, sides, reference, settings))
    for number, edges in enumerate(drives):
        if progress:
            progress(number / len(drives))
        carried = [_carried(motors, edges, robot, settings, gyro if name != "model" else None) for name in names]
        for first, last, *ends in zip(edges[:-1], edges[1:], *carried, strict=True):
            begin, end = float(motors.t[first]) - lag, float(motors.t[last]) - lag
            way, noise = sides[first : last + 1] - sides[first], np.diag(2.0 * reference.noise**2)  # at both ends
            model = {name: pose for name, (pose, _) in zip(names, ends, strict=True)}
            covariance = {name: own + noise for name, (_, own) in zip(names, ends, strict=True)}
            found.append(OdometryWindow(begin, end, way, reference.between(begin, end), model, covariance))
    longest = max((piece.rolled for piece in found), default=0.0)
    kept = [piece for piece in found if piece.rolled > _LEAST * min(settings.length, longest)]
    if not kept:
        raise ArtibotError(f"{experiment.path}: nothing moves where both rotations and reference poses are recorded")
    return kept


def _gyro(experiment: Experiment) -> tuple[Array, Array] | None:
    channel = experiment.channels.get("imu")
    if channel is None or "yaw_rate" not in channel or np.isfinite(channel["yaw_rate"]).sum() < 2:
        return None
    t, rate = channel.series("yaw_rate")
    new = fresh(rate)
    return t[new], rate[new]


def _windows(
    experiment: Experiment, motors: Motors, sides: Array, reference: ReferencePoses, settings: OdometrySettings
) -> Iterator[list[int]]:
    """Yield the rows between which the windows of each segment lie: one more than windows."""
    lag = settings.streams.rotation_delay
    for begin, end in experiment.segments:
        known = reference.known(begin, end)  # poses of one segment say nothing of another's
        if known is None:
            continue
        begin, end = max(begin, known[0] + lag), min(end, known[1] + lag)
        rows = np.flatnonzero((motors.t >= begin - 1e-6) & (motors.t <= end + 1e-6))
        if len(rows) < 3:
            continue
        way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(sides[rows], axis=0)).max(axis=1))])
        edges = np.unique(np.append(np.searchsorted(way, np.arange(0.0, way[-1], settings.length)), len(rows) - 1))
        if len(edges) > 2 and edges[-1] - edges[-2] <= 2:
            edges = np.delete(edges, -2)  # a rest of a sample or two is no window
        if len(edges) > 1:
            yield rows[edges].tolist()


def _carried(
    motors: Motors, edges: Sequence[int], robot: Robot, settings: OdometrySettings, gyro: tuple[Array, Array] | None
) -> list[tuple[Array, Array]]:
    """Carry odometry on through windows that follow each other, as it goes on in use; only the pose begins anew.

    Before the first window it goes on for half a second, where that was recorded.

    Returns
    -------
    list of (array, shape (3,); array, shape (3, 3))
        Pose and covariance at the end of each window, from its beginning.
    """
    odometry = ModelOdometry(robot, settings.slip, settings.streams, settings.kappa)
    before = int(np.searchsorted(motors.t, motors.t[edges[0]] - 0.5))
    t_gyro, rate = gyro or (np.empty(0), np.empty(0))
    place = int(np.searchsorted(t_gyro, motors.t[before] - 3.0))
    found: list[tuple[Array, Array]] = []
    ends = set(edges[1:])
    for row in range(before, edges[-1] + 1):
        t = float(motors.t[row])
        while place < len(t_gyro) and t_gyro[place] <= t + 0.1:
            odometry.take_gyro(float(t_gyro[place]), float(rate[place]))
            place += 1
        odometry.update(t, motors.position[row], motors.velocity[row])
        if row in ends:
            found.append((np.array(odometry.pose), odometry.pose_covariance))
        if row in ends or row == edges[0]:
            odometry.settle()
    return found


# ----------------------------------------------------------------------
# Tables of the errors.
# ----------------------------------------------------------------------


def fitted_track(found: Sequence[OdometryWindow], robot: Robot) -> float:
    """Return the effective track (m) with which wheels alone turn as the reference does, by the mean absolute error."""

    def error(logarithm: float) -> float:
        return float(np.mean([abs(p.wheels(math.exp(logarithm))[2] - p.truth[2]) for p in found]))

    track = robot.front.i_y
    best = minimize_scalar(error, bounds=(math.log(0.5 * track), math.log(8.0 * track)), method="bounded")
    return math.exp(float(best.x))


def fitted_sides(found: Sequence[OdometryWindow], robot: Robot) -> tuple[float, float]:
    """Return the track (m) and the ratio of the sides with which wheels alone turn as the reference does.

    By the mean absolute error of the heading, as `fitted_track`. Two sides that go differently far by the same angle
    (unequal tyres, or loads) are what a track does not tell.
    """

    def error(given: Array) -> float:
        return float(np.mean([abs(p.wheels(math.exp(given[0]), given[1])[2] - p.truth[2]) for p in found]))

    first = np.array([[math.log(fitted_track(found, robot)), 0.0]])
    corners = first + [[0.0, 0.0], [0.05, 0.0], [0.0, 0.02]]
    best = minimize(error, first[0], method="Nelder-Mead", options={"initial_simplex": corners, "xatol": 1e-6})
    return math.exp(float(best.x[0])), float(best.x[1])


STRAIGHT = 0.15
"""A window is nearly straight where the sides' ways differ by less than this share of the longer one."""


def heading_walk(found: Sequence[OdometryWindow], track: float) -> tuple[float, int]:
    """Return by how much the heading goes astray on nearly straight stretches, rad a square root of a metre.

    That is what the sides' grounds differ by: wheels on the same ground slip alike, and go straight on. A constant
    part (unequal wheels) is left out. The spread is robust (median absolute deviation).

    Returns
    -------
    float, int
        NaN where there are fewer than five such windows; how many there are.
    """
    errors = []
    for each in found:
        right, left = np.abs(each.sides[-1])
        if abs(right - left) < STRAIGHT * max(right, left) and max(right, left) > 0.7 * each.rolled:
            errors.append((each.truth[2] - each.wheels(track)[2]) / math.sqrt(each.rolled))
    if len(errors) < _FEWEST:
        return math.nan, len(errors)
    return 1.4826 * float(np.median(np.abs(errors - np.median(errors)))), len(errors)


def gyro_bias(found: Sequence[OdometryWindow]) -> float | None:
    """Return by how much the gyroscope shows too much all the time, rad/s; None where the windows do not tell.

    A robot that never stands does not show it to the odometry, and over 10 m it is most of the heading's error.
    """
    name = "model and gyro"
    if name not in found[0].model or len(found) < _FEWEST:
        return None
    rates = np.array([
        math.remainder(each.model[name][2] - each.truth[2], math.tau) / (each.end - each.begin) for each in found
    ])  # fmt: skip
    bias = float(np.median(rates))
    spread = 1.4826 * float(np.median(np.abs(rates - bias))) / math.sqrt(len(rates))
    return bias if abs(bias) > max(_SURELY * spread, _BIAS_SAID) else None


def repeatability(found: Sequence[OdometryWindow], track: float) -> tuple[float, int]:
    """Return by how much the heading at the end differs between windows in a row that were driven alike, rad.

    No odometry by rotations alone can tell such windows apart, so its median error is not below that on this ground:
    the median difference over the square root of two, as both have their share.

    Parameters
    ----------
    track : m, of wheels that say what little difference there is in how they were driven.

    Returns
    -------
    float, int
        NaN where there are fewer than `ENOUGH` such pairs; how many there are.
    """
    differences = []
    for one, next_one in pairwise(found):
        first, second = one.sides[-1], next_one.sides[-1]
        if np.abs(first - second).max() < ALIKE * np.abs([first, second]).max():
            errors = [each.truth[2] - each.wheels(track)[2] for each in (one, next_one)]
            differences.append(abs(math.remainder(errors[0] - errors[1], math.tau)))
    if len(differences) < ENOUGH:
        return math.nan, len(differences)
    return float(np.median(differences)) / math.sqrt(2.0), len(differences)


def windows_for_covariance(
    experiment: Experiment,
    robot: Robot,
    settings: OdometrySettings,
    found: list[OdometryWindow],
    progress: Report | None = None,
) -> list[OdometryWindow]:
    """Return windows of the same stretch to fit covariances on: `found`, or shorter ones where those are too few.

    The covariance says how errors grow, so short windows tell its size as well; pose noise and timing count more in
    them, and what follows for long ones is rather too wide.

    Parameters
    ----------
    found : windows of `experiment` by `settings`, all or the first of them.
    """
    length = max(SHORTEST, sum(one.rolled for one in found) / ENOUGH)
    if len(found) >= ENOUGH or length >= settings.length:
        return found
    shorter = pieces(experiment, robot, replace(settings, length=length), progress)
    return [one for one in shorter if found[0].begin <= one.begin and one.end <= found[-1].end] or found


def fitted_factors(found: Sequence[OdometryWindow]) -> dict[str, float]:
    """Return for each model the factor of its deviations with which 95 % of the windows lie below their bound."""
    return {
        name: math.sqrt(float(np.quantile([_normalised(p, name, 1.0) for p in found], 0.95)) / _BOUND)
        for name in found[0].model
    }


def _normalised(piece: OdometryWindow, name: str, factor: float) -> float:
    error = piece.model[name] - piece.truth
    error[2] = math.remainder(error[2], math.tau)
    return float(error @ np.linalg.solve(factor**2 * piece.covariance[name], error))


@dataclass(frozen=True)
class OdometryErrors:
    """Errors of one odometry over all windows.

    Attributes
    ----------
    name : of the odometry.
    heading, position : at the windows' ends: root mean square and median, rad and m.
    per_metre, per_radian : medians of the heading's error over the way (rad/m) and over the turned angle (1).
    consistent : share of windows whose normalised squared error lies below its 95 % bound; None without covariance.
    normalised : its mean; 3 where the covariance is right, less where it is wide.
    """

    name: str
    heading: tuple[float, float]
    position: tuple[float, float]
    per_metre: float
    per_radian: float
    consistent: float | None = None
    normalised: float | None = None

    def as_dict(self) -> dict[str, Any]:
        """For JSON, with units."""
        return {
            "heading_rms": {"value": self.heading[0], "unit": "rad"},
            "heading_median": {"value": self.heading[1], "unit": "rad"},
            "position_rms": {"value": self.position[0], "unit": "m"},
            "position_median": {"value": self.position[1], "unit": "m"},
            "heading_per_metre": {"value": self.per_metre, "unit": "rad/m"},
            "heading_per_radian": {"value": self.per_radian, "unit": "1"},
            "consistent": self.consistent,
            "normalised_mean": self.normalised,
        }


def rows(
    found: Sequence[OdometryWindow],
    robot: Robot,
    track: float,
    sides: tuple[float, float],
    factors: Mapping[str, float],
) -> list[OdometryErrors]:
    """Return the errors of wheels with nominal and with fitted track, with fitted sides, and of the model."""
    table = [
        _row(found, "wheels, nominal track", [p.wheels(robot.front.i_y) for p in found]),
        _row(found, f"wheels, fitted track {track:.3f} m", [p.wheels(track) for p in found]),
        _row(found, f"wheels, {sides[0]:.3f} m and sides {sides[1]:+.3f}", [p.wheels(*sides) for p in found]),
    ]
    for name in found[0].model:
        normalised = np.array([_normalised(p, name, factors[name]) for p in found])
        consistent = float(np.mean(normalised <= _BOUND))
        table.append(_row(found, name, [p.model[name] for p in found], consistent, float(normalised.mean())))
    return table


def _row(
    found: Sequence[OdometryWindow],
    name: str,
    ends: Sequence[Array],
    consistent: float | None = None,
    normalised: float | None = None,
) -> OdometryErrors:
    error = np.array(ends) - np.array([p.truth for p in found])
    heading, position = np.abs(error[:, 2]), np.hypot(error[:, 0], error[:, 1])
    way, turned = (np.array([p.rolled for p in found]), np.array([abs(p.truth[2]) for p in found]))
    return OdometryErrors(
        name,
        (float(np.sqrt(np.mean(heading**2))), float(np.median(heading))),
        (float(np.sqrt(np.mean(position**2))), float(np.median(position))),
        float(np.median(heading / way)),
        float(np.median(heading / np.maximum(turned, 0.1))),
        consistent,
        normalised,
    )


def as_text(table: Sequence[OdometryErrors], windows: int, fitted: int, short: int) -> str:
    """Return the table for a terminal; the track was fitted on `fitted` windows, covariances on `short`."""
    also = "and covariances fitted on" if short == fitted else "fitted on"
    apart = "" if short == fitted else f", covariances on {short} shorter ones"
    lines = [
        f"{windows} windows, track {also} {fitted} others{apart}; errors at the windows' ends",
        f"{'':34}{'heading, rad':>18}{'position, m':>18}{'rad/m':>9}{'rad/rad':>9}{'within 95 %':>13}",
        f"{'':34}{'rms':>9}{'median':>9}{'rms':>9}{'median':>9}{'median':>9}{'median':>9}{'':>13}",
    ]
    for row in table:
        numbers = (*row.heading, *row.position, row.per_metre, row.per_radian)
        share = "" if row.consistent is None else f"{100 * row.consistent:.0f} %"
        lines.append(f"{row.name:34}" + "".join(f"{number:9.3g}" for number in numbers) + f"{share:>13}")
    return "\n".join(lines)


def _heading_off(found: Sequence[OdometryWindow], sides: tuple[float, float] | None = None) -> float:
    """Return the heading's mean absolute error by wheels of such sides, rad; by the model where none are given."""
    ends = [one.model["model"] if sides is None else one.wheels(*sides) for one in found]
    return float(np.mean([
        abs(math.remainder(end[2] - one.truth[2], math.tau)) for end, one in zip(ends, found, strict=True)
    ]))  # fmt: skip


def remarks(
    fit: Sequence[OdometryWindow],
    found: Sequence[OdometryWindow],
    robot: Robot,
    track: float,
    sides: tuple[float, float],
) -> list[str]:
    """Return what windows say beside the table, for a terminal: slip and size of the sides, gyroscope's bias, ground.

    Parameters
    ----------
    fit, found : sequence of OdometryWindow
        Windows that were fitted, and those that are judged.
    robot : Robot
    track : float
        Fitted, m.
    sides : tuple of float
        Fitted track (m) and ratio of the sides.
    """
    said = []
    if "wheel_radius_mismatch" not in robot.effects and _heading_off(found, sides) < _heading_off(found):
        said.append(
            f"the sides differ by {sides[1]:+.3g}, of which the model does not know: identify with --fit soil,geometry"
        )
    walk, straight = heading_walk([*fit, *found], track)
    if math.isfinite(walk):  # else there are too few such windows
        stated = 2.0 * robot.odometry.travel_slip / robot.front.i_y
        said.append(
            f"heading by wheels on {straight} nearly straight windows: {walk:.3g} rad per root metre; "
            f"odom states {stated:.3g}, for sides that slip on grounds of their own"
        )
    if (bias := gyro_bias([*fit, *found])) is not None:
        said.append(
            f"the gyroscope shows {bias:.3g} rad/s too much: identify with --fit …,effects.gyro_bias.bias "
            "--prior effects.gyro_bias.bias=0±0.02"
        )
    differ, pairs = repeatability(found, track)
    if math.isfinite(differ):
        said.append(
            f"{pairs} pairs of windows in a row were driven alike: headings differ by {differ:.3g} rad (median, the "
            "share of one); no odometry by rotations alone is better on this ground"
        )
    return said
