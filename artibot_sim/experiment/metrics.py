"""Figures of merit of a run: eqs 31 and 32, radii of circular paths, and how far a simulation is from its recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment.columns import Floats
from artibot_sim.experiment.smoothing import noise_of

# ----------------------------------------------------------------------
# Figures of merit of a run: eqs 31 and 32 of the paper, radii of circular paths, path length.
# ----------------------------------------------------------------------


Array = NDArray[np.float64]


@dataclass(frozen=True)
class Circle:
    """A circle fitted to points.

    Attributes
    ----------
    x, y : centre, m.
    radius : m.
    rmse : root mean square of the points' distances from the circle, m.
    """

    x: float
    y: float
    radius: float
    rmse: float


def yaw_error(gamma_f: ArrayLike, gamma_d: ArrayLike, t: ArrayLike) -> float:
    """Relative error of the yaw over a motion, e_gamma of eq. 31.

    Parameters
    ----------
    gamma_f : (n,) yaw of the front module, rad, continuous (not wrapped).
    gamma_d : (n,) planned yaw at the same times, rad, continuous.
    t : (n,) times, s, increasing; the integrals run over all of them.

    Returns
    -------
    float
        Dimensionless; negative where the rover turned less than planned.

    Raises
    ------
    ArtibotError
        If lengths differ, something is not finite, or the planned yaw integrates to zero, for which eq. 31
        has no value.
    """
    gamma_f, gamma_d, t = _columns(2, gamma_f=gamma_f, gamma_d=gamma_d, t=t)
    if not (np.diff(t) > 0).all():
        raise ArtibotError("yaw_error: times are not increasing; sort them first")
    planned = _integral(gamma_d, t)
    if abs(planned) <= 1e-12 * _integral(np.abs(gamma_d), t) or planned == 0.0:
        raise ArtibotError("yaw_error: the planned yaw integrates to zero, so eq. 31 has no value for this motion")
    return _integral(gamma_f - gamma_d, t) / planned


def _integral(values: Array, t: Array) -> float:
    """Integrate by trapezoids; NumPy's own function has another name in each major version."""
    return float(np.sum(0.5 * (values[1:] + values[:-1]) * np.diff(t)))


def position_error(p_f: ArrayLike, p_d: ArrayLike, sigma: float) -> float:
    """Relative error of the final position, e_x of eq. 32.

    Parameters
    ----------
    p_f : (2,) position of the front module at the end of the motion, m, in `map`.
    p_d : (2,) planned position there, m.
    sigma : length of the planned path, m.

    Raises
    ------
    ArtibotError
        If a position is not finite, or `sigma` is not positive.
    """
    if not (np.isfinite(sigma) and sigma > 0):
        raise ArtibotError(f"position_error: sigma is {sigma}; expected the planned path's length in m, above 0")
    difference = np.asarray(p_f, float)[:2] - np.asarray(p_d, float)[:2]
    if difference.shape != (2,) or not np.isfinite(difference).all():
        raise ArtibotError(f"position_error: positions {p_f!r} and {p_d!r}; expected two finite points (x, y) in m")
    return float(np.hypot(*difference)) / float(sigma)


def path_length(x: ArrayLike, y: ArrayLike) -> float:
    """Return the length of a polyline through points (n,), m; NaN points are passed over."""
    points = _finite_points(x, y)
    return float(np.hypot(*np.diff(points, axis=0).T).sum())


def radius(x: ArrayLike, y: ArrayLike) -> float:
    """Return the radius of the circle that fits points (n,) best, m (see `fit_circle`)."""
    return fit_circle(x, y).radius


def fit_circle(x: ArrayLike, y: ArrayLike, iterations: int = 50) -> Circle:
    """Fit a circle to points: least squares of their distances from it.

    Parameters
    ----------
    x, y : (n,) points, m, n ≥ 3; NaN points are passed over.
    iterations : most steps of the refinement.

    Returns
    -------
    Circle
        Taubin's algebraic fit, which is hardly biased on short arcs, refined by Gauss-Newton steps with
        Levenberg's damping on the geometric distances.

    Raises
    ------
    ArtibotError
        If there are fewer than three different points, or they lie on a line.
    """
    points = _finite_points(x, y)
    if not _three_differ(points):
        raise ArtibotError(f"fit_circle: {len(points)} usable points; expected at least 3 different ones")
    centre = points.mean(axis=0)
    scale = float(np.sqrt(((points - centre) ** 2).sum(axis=1).mean()))
    u, v = ((points - centre) / scale).T
    a, b, r = _refine(u, v, *_taubin(u, v), iterations)
    residual = np.hypot(u - a, v - b) - r
    rmse = float(np.sqrt((residual**2).mean()))
    return Circle(float(a * scale + centre[0]), float(b * scale + centre[1]), float(r * scale), rmse * scale)


def _taubin(u: Array, v: Array) -> tuple[float, float]:
    """Return the centre of Taubin's algebraic fit to centred, scaled points (n,)."""
    z = u * u + v * v
    z_mean = float(z.mean())
    rows = np.column_stack([(z - z_mean) / (2.0 * np.sqrt(z_mean)), u, v])
    _, sizes, axes = np.linalg.svd(np.linalg.qr(rows, mode="r"))  # of the long matrix, without its long factor
    if sizes[1] < 1e-9 * sizes[0] or abs(axes[2, 0]) < 1e-12:
        raise ArtibotError("fit_circle: the points lie on a line; a circle needs a curve")
    p, q, s = axes[2]
    p /= 2.0 * np.sqrt(z_mean)
    return float(-q / (2.0 * p)), float(-s / (2.0 * p))


def _refine(u: Array, v: Array, a: float, b: float, iterations: int) -> tuple[float, float, float]:
    """Minimise the sum of (distance from (a, b) − r)², starting from an algebraic fit; r is the mean distance."""
    damping = 1e-3
    away, distance, cost = _offsets(u, v, a, b)
    for _ in range(iterations):
        slope = away / distance
        slope -= slope.mean(axis=1)[:, None]
        (aa, ab), (_, bb) = (slope @ slope.T).tolist()
        to_a, to_b = (slope @ distance).tolist()
        aa, bb = aa * (1.0 + damping), bb * (1.0 + damping)
        det = aa * bb - ab * ab + 1e-300
        step_a, step_b = (to_a * bb - to_b * ab) / det, (to_b * aa - to_a * ab) / det
        there = _offsets(u, v, a + step_a, b + step_b)
        better = there[2] <= cost
        if better:
            a, b = a + step_a, b + step_b
            away, distance, cost = there
        damping *= 0.1 if better else 10.0
        size = max(abs(step_a), abs(step_b)) / max(1.0, abs(a), abs(b))
        if size < (1e-13 if better else 1e-8):  # where so small a step makes nothing better, only rounding is left
            break
    return a, b, float(distance.mean())


def _offsets(u: Array, v: Array, a: float, b: float) -> tuple[Array, Array, float]:
    """Where points (n,) are from (a, b): along both axes (2, n), how far (n,), and the squares' sum about its mean."""
    away = np.empty((2, len(u)))
    np.subtract(u, a, out=away[0])
    np.subtract(v, b, out=away[1])
    distance = np.maximum(np.sqrt(away[0] * away[0] + away[1] * away[1]), 1e-300)
    residual = distance - distance.mean()
    return away, distance, float(residual @ residual)


def _three_differ(points: Array) -> bool:
    """Whether at least three of the points (n, 2) are different ones."""
    others = points[(points != points[:1]).any(axis=1)]
    return bool((others != others[:1]).any())


def _finite_points(x: ArrayLike, y: ArrayLike) -> Array:
    points = np.column_stack([np.asarray(x, float).ravel(), np.asarray(y, float).ravel()])
    return points[np.isfinite(points).all(axis=1)]


def _columns(least: int, **arrays: ArrayLike) -> list[Array]:
    """Return arrays (n,) of equal length n ≥ `least`, all finite; the error names the one that is not."""
    out = {name: np.asarray(values, float).ravel() for name, values in arrays.items()}
    lengths = {name: len(values) for name, values in out.items()}
    if len(set(lengths.values())) != 1 or min(lengths.values()) < least:
        raise ArtibotError(f"lengths {lengths}; expected equal ones of at least {least}")
    for name, values in out.items():
        if not np.isfinite(values).all():
            bad = int((~np.isfinite(values)).sum())
            raise ArtibotError(f"{name}: {bad} values are not finite; leave them out first")
    return list(out.values())


# ----------------------------------------------------------------------
# How far a simulation is from its recording, channel by channel (the contract's names).
# ----------------------------------------------------------------------


UNITS = {
    "position": "m",
    "yaw": "rad",
    "yaw_rate": "rad/s",
    "articulation_yaw": "rad",
    "front_velocity": "rad/s",
    "torque_front": "N·m",
    "torque_back": "N·m",
}
"""Channel → unit. Motor quantities are motor-side."""


@dataclass(frozen=True)
class Compared:
    """One channel, recorded and simulated at the same instants of one segment.

    Attributes
    ----------
    t : (n,) s.
    recorded, simulated : (n, k): coordinates of a point, or motors; simulated NaN where the model has no answer.
    """

    t: Floats
    recorded: Floats
    simulated: Floats


@dataclass(frozen=True)
class Metric:
    """Size of a channel's deviations.

    Attributes
    ----------
    unit : of all the others.
    rmse, median, p90 : of the absolute deviations (of positions: of the distance).
    noise : standard deviation of the recording's own noise, as `smoothing.noise_of` estimates it; of positions
        that of the distance. NaN if there are too few samples.
    count : how many deviations.
    """

    unit: str
    rmse: float
    median: float
    p90: float
    noise: float
    count: int

    def as_dict(self) -> dict[str, object]:
        """Return what metrics.json holds."""
        noise = self.noise if np.isfinite(self.noise) else None
        return {"unit": self.unit, "rmse": self.rmse, "median": self.median, "p90": self.p90, "noise": noise,
                "count": self.count}  # fmt: skip


def deviations(channel: str, part: Compared) -> Floats:
    """Return the absolute deviations of a part: (m,) of positions and angles, both motors' one after the other."""
    difference = part.simulated - part.recorded
    if channel == "yaw":
        difference = np.arctan2(np.sin(difference), np.cos(difference))
    if channel == "position":
        difference = np.hypot(difference[:, 0], difference[:, 1])
    size = np.abs(difference).ravel()
    return size[np.isfinite(size)]


def metrics_of(compared: Mapping[str, list[Compared]]) -> dict[str, Metric]:
    """Return the metrics of each channel over all its parts; a channel without a deviation is left out."""
    found = {}
    for channel, unit in UNITS.items():
        parts = compared.get(channel, [])
        size = np.concatenate([deviations(channel, part) for part in parts]) if parts else np.empty(0)
        if len(size):
            found[channel] = Metric(
                unit, float(np.sqrt(np.mean(size**2))), float(np.median(size)), float(np.quantile(size, 0.9)),
                _noise(channel, parts), len(size),
            )  # fmt: skip
    return found


def _noise(channel: str, parts: list[Compared]) -> float:
    """Return the noise's standard deviation, averaged in square over the parts by their lengths."""
    squares, weights = [], []
    for part in parts:
        columns = np.array([noise_of(part.t, column) for column in part.recorded.T]) ** 2
        squares.append(columns.sum() if channel == "position" else columns.mean())
        weights.append(len(part.t))
    known = np.isfinite(squares)
    if not known.any():
        return float("nan")
    return float(np.sqrt(np.average(np.array(squares)[known], weights=np.array(weights, float)[known])))
