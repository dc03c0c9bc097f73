"""Whether what the wheels rolled fits where the rover went, and whether clocks of topics run apart."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from artibot_sim.experiment import Channel, Experiment
from artibot_sim.experiment.columns import SEGMENT_GAP
from artibot_sim.experiment.measured import Measured
from artibot_sim.model import MOTORS, Robot

# ----------------------------------------------------------------------
# Whether what the wheels rolled fits where the rover went: a wrong robot, wrong units, sides taken for each
# other.
# ----------------------------------------------------------------------


Array = NDArray[np.float64]

FACTOR_REFUSED = 3.0
"""Wheels that rolled so many times what the rover went (or so little of it) are another robot's."""
_FACTOR_REPORTED = 1.5
"""Factor between the way that wheels rolled and the way gone, from which on it is said."""
_LEAST_WAY = 0.5
"""m that wheels or rover must have moved."""
_STRIDE = 1.0
"""s between the positions whose distances add up to a path: noise does not."""
_SPEEDS_ALIKE = 0.3
"""Known factors within this, as a logarithm, are named."""
_SCALE = 0.05
"""Difference between a motor's positions and velocities that is said."""


@dataclass(frozen=True)
class Rolled:
    """What the wheels of a recording rolled, and how far the rover went.

    Attributes
    ----------
    experiment : Experiment
    source : str
        Topic of the positions.
    wheels, path : float
        m.
    """

    experiment: Experiment
    source: str
    wheels: float
    path: float

    @property
    def factor(self) -> float:
        """Rolled over gone."""
        return self.wheels / max(self.path, 1e-3)

    def guess(self, robot: Robot) -> str:
        """What such a factor comes from, in brackets; empty where nobody knows."""
        tau = robot.drive.front.tau
        known = {
            1.0 / tau: "the gear ratio: are these speeds of motors?",
            tau: "the gear ratio: are these speeds of wheels?",
            60.0 / (2.0 * np.pi): "rpm per rad/s",
            180.0 / np.pi: "degrees per rad",
            1.0 / (2.0 * np.pi): "turns per rad",
        }
        away = {factor: abs(float(np.log(self.factor / factor))) for factor in known if factor != 1.0}
        nearest = min(away, key=lambda factor: away[factor])
        return f" (about {known[nearest]})" if away[nearest] < _SPEEDS_ALIKE else ""


def rolled(experiment: Experiment, robot: Robot) -> Rolled | None:
    """What the front wheels rolled and how far the rover went, None where neither moved."""
    motors = experiment.require("motor_torques")
    wheels, path, source = 0.0, 0.0, ""
    for first, last in experiment.segments:
        measured = Measured(experiment, first, last)
        t, points = measured.position()
        if len(t) < 3 or measured.position_source is None:
            continue
        source = measured.position_source.topic
        at = np.arange(t[0], t[-1], _STRIDE)
        steps = np.diff(np.column_stack([np.interp(at, t, column) for column in points.T]), axis=0)
        path += float(np.hypot(*steps.T).sum())
        speed = front_speed(motors, robot, at)
        if speed is not None:
            wheels += float(np.abs(np.diff(speed[1], axis=0)).sum())
    if max(wheels, path) < _LEAST_WAY or not source:
        return None
    return Rolled(experiment, source, wheels, path)


def front_speed(motors: Channel, robot: Robot, at: Array) -> tuple[Array, Array] | None:
    """Angles (n,) turned and distances (n,) rolled by the front wheels at times (n,), rad and m; None if not measured.

    Without slip: half the sum and, over the track, the difference of both sides.
    """
    angles = []
    for motor in MOTORS[:2]:
        angle = _angle(motors, motor, at)
        if angle is None:
            return None
        angles.append(angle * robot.drive.front.tau * robot.wheel.r_w)
    right, left = angles
    return (right - left) / robot.front.i_y, (right + left) / 2.0


def _angle(motors: Channel, motor: str, at: Array) -> Array | None:
    """Rotation of a motor at times (n,), rad, by its positions, else its speeds."""
    for quantity in ("position", "velocity"):
        name = f"{motor}.{quantity}"
        if name in motors:
            t, values = motors.series(name)
            if len(t) < 4:
                continue
            if quantity == "velocity":
                values = np.concatenate(([0.0], np.cumsum(0.5 * np.diff(t) * (values[1:] + values[:-1]))))
            return np.asarray(np.interp(at, t, values))
    return None


def scale_between(motors: Channel, motor: str) -> float | None:
    """Change of a motor's positions over the integral of its velocities, None where it does not turn enough."""
    names = f"{motor}.position", f"{motor}.velocity"
    if not set(names) <= set(motors.columns):
        return None
    (t, position), (t_v, velocity) = (motors.series(name) for name in names)
    if len(t) < 10 or len(t_v) < 10:
        return None
    at = np.arange(max(t[0], t_v[0]), min(t[-1], t_v[-1]), 0.2)
    turned = np.interp(at, t_v, np.concatenate(([0.0], np.cumsum(0.5 * np.diff(t_v) * (velocity[1:] + velocity[:-1])))))
    seen = (_around(t, at) < SEGMENT_GAP) & (_around(t_v, at) < SEGMENT_GAP)
    both = seen[1:] & seen[:-1]
    a, b = np.diff(np.interp(at, t, position))[both], np.diff(turned)[both]
    square = float(b @ b)
    return float(a @ b) / square if square > 1.0 else None


def _around(t: Array, at: Array) -> Array:
    """How far the samples at times t (n,) are apart around instants (m,), s."""
    return np.diff(t)[np.clip(np.searchsorted(t, at) - 1, 0, len(t) - 2)]


def wheel_faults(experiment: Experiment, robot: Robot) -> Iterator[str]:
    """Sentences on wheels that do not fit the path, each other or the robot."""
    motors = experiment.channels["motor_torques"]
    back = any(f"{motor}.{what}" in motors for motor in MOTORS[2:] for what in ("position", "velocity"))
    if robot.articulated and not back:
        yield f"{motors.topic} has no rotation of the back motors; they are driven by eq. 30's torque instead"
    elif back and not robot.articulated:
        yield f"{motors.topic} has back motors, which robot '{robot.name}' has not: is it the right robot?"
    for motor in MOTORS:
        scale = scale_between(motors, motor)
        if scale is not None and abs(scale - 1.0) > _SCALE:
            yield f"{motors.topic}: positions of {motor} change by {scale:.3g} times its velocities: one is wrong"
    way = rolled(experiment, robot)
    if way is not None and not 1 / _FACTOR_REPORTED < way.factor < _FACTOR_REPORTED:
        yield (
            f"the wheels rolled {way.wheels:.3g} m, the rover went {way.path:.3g} m: a factor of "
            f"{way.factor:.3g}{way.guess(robot)}; slip, or another robot?"
        )


# ----------------------------------------------------------------------
# Clocks that run apart, by when messages arrived.
# ----------------------------------------------------------------------


_DRIFT = 0.02
"""s by which a clock runs away over a recording before it is said."""
_FEW = 40
"""Topics with fewer messages are not asked."""
_CLOCKS = ("total_station", "ground_truth_odom", "imu", "joint_states")


def clock_faults(experiment: Experiment) -> Iterator[str]:
    """Sentences on topics whose stamps and times of arrival run apart, in comparison with the motors'."""
    motors = experiment.channels["motor_torques"]
    for key in _CLOCKS:
        channel = experiment.channels.get(key)
        if channel is None or len(channel) < _FEW or len(motors) < _FEW:
            continue
        apart = _apart(channel, motors)
        if abs(apart) > _DRIFT:
            way = "loses" if apart > 0 else "gains"
            yield (
                f"the clock of {channel.topic} {way} {1e3 * abs(apart):.0f} ms on the motors' over "
                f"{experiment.duration:.0f} s"
            )


def _apart(channel: Channel, reference: Channel) -> float:
    """By how much more a topic's messages come after their stamps at its end than at its beginning, s.

    More than the reference's of the same stamps do: a simulator whose time is not everybody's has stamps of its own, in
    all topics alike.
    """
    common = np.interp(channel.t_ns, reference.t_ns, reference.received_ns - reference.t_ns)
    delay = (channel.received_ns - channel.t_ns - common) / 1e9
    tenth = max(len(delay) // 10, _FEW // 4)
    return float(np.median(delay[-tenth:]) - np.median(delay[:tenth]))
