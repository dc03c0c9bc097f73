"""How a robot turns: steady turns of its model, and the differential drive that turns likewise."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from artibot_sim.errors import ArtibotError
from artibot_sim.model import Commands, Robot, rollout
from artibot_sim.model.simulate.sensors import sensor_errors
from artibot_sim.progress import Report

Array = NDArray[np.float64]

FROUDE = 0.2
"""Speed of the turns over sqrt(g × track): 0.5 m/s for a rover of 0.7 m. Slow enough that only friction matters."""
RADII_RIGID = (1.0, 2.0, 4.0)
"""Radii of turns that are commanded, in tracks, to both sides; a rigid robot turns on the spot as well."""
RADII_ARTICULATED = (3.0, 6.0, 12.0)
"""An articulated one folds in tighter turns."""
_SPOT = 0.5
"""Wheels' speed when turning on the spot, over that of the other turns."""
_RAMP = 1.5
"""s in which speeds are taken up."""
_LENGTHS = 6.0
"""Lengths of the robot that it drives before it is taken to move steadily."""
_LEAST = 4.0
"""s that it drives at least before it is taken to move steadily."""
_MEASURED = 2.0
"""s at the end over which the motion is averaged."""
DRAWS = 40
"""Robots drawn within the intervals of a robot file."""

PLACES = ("slope", "external_force", "friction_patch", "soil_softening")
"""Effects of a place or a time, not of the robot and its ground: steady turns are simulated without them."""


@dataclass(frozen=True)
class SteadyTurn:
    """One steady turn.

    Attributes
    ----------
    right, left : speeds of the front wheels as their encoders count them, rad/s.
    speed, drift, yaw_rate : motion of the front module's origin in its own frame: forward, leftward (m/s), rad/s.
    """

    right: float
    left: float
    speed: float
    drift: float
    yaw_rate: float


@dataclass(frozen=True)
class Differential:
    """A differential drive that moves like a robot does.

    Attributes
    ----------
    separation : effective track, m.
    radius_right, radius_left : effective wheel radii, m.
    drift : leftward speed over yaw rate, m: a differential drive has none.
    tracks : effective track in each turn alone, m, in the order of `turns`.
    turns : what it was fitted to.
    """

    separation: float
    radius_right: float
    radius_left: float
    drift: float
    tracks: tuple[float, ...]
    turns: tuple[SteadyTurn, ...]


def turn_speed(robot: Robot) -> float:
    """Speed of the turns by default, m/s."""
    return FROUDE * math.sqrt(9.81 * robot.front.i_y)


def wheel_speeds(robot: Robot, speed: float | None = None) -> Array:
    """Return the front wheels' speeds (n, 2), right and left, of the turns that a robot is known by, rad/s."""
    v, track, r_w = speed or turn_speed(robot), robot.front.i_y, robot.wheel.r_w
    radii = RADII_ARTICULATED if robot.articulated else RADII_RIGID
    rates = [0.0, *(sign * v / (radius * track) for radius in radii for sign in (1.0, -1.0))]
    pairs = [(v + 0.5 * track * rate, v - 0.5 * track * rate) for rate in rates]
    if not robot.articulated:
        pairs += [(_SPOT * v, -_SPOT * v), (-_SPOT * v, _SPOT * v)]
    return np.array(pairs) / r_w


def profile(robot: Robot, wheels: Array, dt: float = 0.01) -> Array:
    """Return the front wheels' speeds (k, 2) over time, `dt` apart: a ramp, then steady until the motion is."""
    fastest = float(np.abs(wheels).max()) * robot.wheel.r_w
    length = robot.front.i_x + (robot.front.l + robot.back.l if robot.back is not None else 0.0)
    steady = max(_LEAST, _LENGTHS * length / fastest)
    t = np.arange(round((_RAMP + steady) / dt) + 1) * dt
    return np.minimum(t / _RAMP, 1.0)[:, None] * wheels


def placeless(robot: Robot) -> Robot:
    """Return the robot without what belongs to a place or a time."""
    kept = {name: values for name, values in robot.effects.items() if name not in PLACES}
    return dataclasses.replace(robot, effects=kept)


def steady_turn(robot: Robot, wheels: Array) -> SteadyTurn:
    """Simulate one turn until it is steady.

    Raises
    ------
    ArtibotError
        If the simulation diverges.
    """
    speeds = profile(robot, wheels)
    velocity = np.full((len(speeds), 4), np.nan)
    velocity[:, :2] = speeds / robot.drive.front.tau
    result = rollout(robot, Commands(0.01, velocity), integrator="semi_implicit")
    if result.final_state is None:
        raise ArtibotError(f"robot '{robot.name}': the simulated turn diverged: {result.message}")
    last = result.t >= result.t[-1] - _MEASURED
    yaw, (vx, vy, rate) = result.q[last, 5], result.v[last][:, [0, 1, 5]].T
    forward, aside = np.cos(yaw) * vx + np.sin(yaw) * vy, np.cos(yaw) * vy - np.sin(yaw) * vx
    right, left = (sensor_errors(robot).encoder_scale * wheels).tolist()
    return SteadyTurn(right, left, float(forward.mean()), float(aside.mean()), float(rate.mean()))


def steady_turns(robot: Robot, speed: float | None = None) -> tuple[SteadyTurn, ...]:
    """Simulate the turns that a robot is known by."""
    alone = placeless(robot)
    return tuple(steady_turn(alone, wheels) for wheels in wheel_speeds(robot, speed))


def differential(turns: Sequence[SteadyTurn]) -> Differential:
    """Return the differential drive that moves most like the turns.

    Its forward speed is ``(r_r right + r_l left) / 2`` and its yaw rate ``(r_r right - r_l left) / b``: both are
    linear in the radii over 2 and over b, and each is fitted by least squares with the turns' own sizes as weights.

    Raises
    ------
    ArtibotError
        If the robot does not turn at all.
    """
    table = np.array([(turn.right, turn.left, turn.speed, turn.drift, turn.yaw_rate) for turn in turns])
    wheels, speed, drift, rate = table[:, :2], table[:, 2], table[:, 3], table[:, 4]
    turning = np.abs(wheels[:, 0] - wheels[:, 1]) > 1e-9
    if not turning.any() or np.abs(rate[turning]).max() < 1e-6:
        raise ArtibotError("the simulated robot does not turn: its wheels hold it, or it has no track")
    signs = np.array([1.0, -1.0])
    per_track = np.linalg.lstsq(_weighted(wheels * signs, rate), _weighted(rate, rate), rcond=None)[0]
    halves = np.linalg.lstsq(wheels, speed, rcond=None)[0]
    separation = float(2.0 * halves.sum() / per_track.sum())
    right, left = (separation * per_track).tolist()
    rolled = wheels @ (np.array([right, left]) * signs)
    tracks = np.divide(rolled, rate, out=np.full(len(rate), np.nan), where=turning)
    slope = float(drift @ rate / (rate @ rate))
    return Differential(separation, right, left, slope, tuple(tracks.tolist()), tuple(turns))


def _weighted(values: Array, rate: Array) -> Array:
    """Weigh rows (n, …) so that a wide turn counts as much as a tight one; one that hardly turns as the widest."""
    size = np.abs(rate)
    weight = 1.0 / np.maximum(size, size[size > 0.05 * size.max()].min())
    return (values.T * weight).T


# ----------------------------------------------------------------------
# What the intervals of a robot file make of it.
# ----------------------------------------------------------------------


@dataclass(frozen=True)
class DrawnDrives:
    """The differential drive of a robot, and those of robots drawn within its file's intervals.

    Attributes
    ----------
    value : of the robot itself.
    drawn : of the others; empty where the file has no intervals.
    keys : parameters that were drawn.
    """

    value: Differential
    drawn: tuple[Differential, ...]
    keys: tuple[str, ...]

    def interval(self, name: str) -> tuple[float, float] | None:
        """Return the 95 % interval of a field of `Differential`, None where nothing was drawn."""
        if not self.drawn:
            return None
        low, high = np.quantile([getattr(one, name) for one in self.drawn], (0.025, 0.975)).tolist()
        return min(low, getattr(self.value, name)), max(high, getattr(self.value, name))


def spread(
    robot: Robot, speed: float | None = None, draws: int = DRAWS, seed: int = 0, progress: Report | None = None
) -> DrawnDrives:
    """Return the differential drive of a robot, with what its intervals make of it.

    Parameters are drawn one by one, on each side of the value with its own width: a robot file says nothing about how
    its parameters hang together, so intervals here are rather too wide.
    """
    advance = progress or (lambda _: None)
    value = differential(steady_turns(robot, speed))
    keys = tuple(key for key in robot.intervals if _is_drawn(robot, key))
    rng = np.random.default_rng(seed)
    drawn = []
    for number in range(draws if keys else 0):
        advance(number / draws)
        drawn.append(differential(steady_turns(_draw(robot, keys, rng), speed)))
    return DrawnDrives(value, tuple(drawn), keys)


def _is_drawn(robot: Robot, key: str) -> bool:
    low, high = robot.intervals[key]
    return bool(np.isfinite([low, high]).all() and high > low) and not any(f"effects.{name}." in key for name in PLACES)


def _draw(robot: Robot, keys: Sequence[str], rng: np.random.Generator) -> Robot:
    """Return a robot whose `keys` are drawn within their intervals and bounds."""
    bounds = {key: quantity for key, quantity, _ in (*robot.quantities(), *robot.effect_quantities())}
    values = {}
    for key, middle, z in zip(keys, robot.as_vector(keys).tolist(), rng.standard_normal(len(keys)), strict=True):
        low, high = robot.intervals[key]
        width = max(middle - low, 0.0) if z < 0 else max(high - middle, 0.0)
        quantity = bounds[key]
        least = quantity.low + (1e-9 if quantity.low_open else 0.0)
        values[key] = min(max(middle + z * width / 1.96, least), quantity.high)
    contact = robot.contact
    mu_s = values.get("contact.mu_s", contact.mu_s)
    if values.get("contact.mu_d", contact.mu_d) > mu_s:
        values["contact.mu_d" if "contact.mu_d" in values else "contact.mu_s"] = (
            mu_s if "contact.mu_d" in values else contact.mu_d
        )
    return robot.replace(values)
