"""Clocks of a recording's topics against each other: constant offsets, and clocks that run apart."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.data_check.wheels import front_speed
from artibot_sim.experiment import Channel, Experiment
from artibot_sim.experiment.local_fit import local_fit
from artibot_sim.experiment.measured import Measured
from artibot_sim.model import Robot

Array = NDArray[np.float64]

_STEP = 0.02
_LONGEST = 0.6
"""s to either side of which an offset is looked for."""
_EARLY, _LATE = 0.05, 0.12
"""s of an offset that are said: a rover answers its wheels late by itself, by up to 0.07 s where their speed jumps,"""
_SURE = 5.0
"""if it is so many times its standard deviation,"""
_ALIKE = 0.99
"""and the two agree so well (correlation) where they agree best. Where slip makes the rover's speed another one than
its wheels' any offset may be the best: 15 drives without a fault had 0.995 or more, or at most 0.98 and then up to
0.37 s."""
_DRIFT = 0.02
"""s by which a clock runs away over a recording before it is said."""
_FEW = 40
"""Topics with fewer messages are not asked."""
_SMOOTH = 0.15
"""s around each instant over which rates are taken."""
_DELAYS = ("motor_torques", "total_station", "ground_truth_odom", "imu", "joint_states")


def clock_faults(experiment: Experiment, robot: Robot) -> Iterator[str]:
    """Sentences on topics whose clock differs from the motors'."""
    yield from _stamped(experiment)
    motors = experiment.channels["motor_torques"]
    for what, topic, pair in _pairs(experiment, robot):
        found = lag(*pair)
        if found is None:
            continue
        offset, sd = found
        if abs(offset) > max(_LATE if offset > 0 else _EARLY, _SURE * sd):
            way = "late" if offset > 0 else "early"
            yield f"{topic} is {1e3 * abs(offset):.0f} ms {way} against {motors.topic}, by its {what}"


def _stamped(experiment: Experiment) -> Iterator[str]:
    """Topics whose stamps and times of arrival run apart, in comparison with the motors'."""
    motors = experiment.channels["motor_torques"]
    for key in _DELAYS[1:]:
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


def _pairs(experiment: Experiment, robot: Robot) -> Iterator[tuple[str, str, tuple[Array, Array, Array]]]:
    """What a sensor and the wheels measure both: words, topic, and times with both rates (n,)."""
    motors = experiment.channels["motor_torques"]
    first, last = max(experiment.segments, key=lambda segment: segment[1] - segment[0])
    measured = Measured(experiment, first, last)
    at = np.arange(first + 1.0, last - 1.0, _STEP)
    if len(at) < 250:
        return
    by_wheels = [front_speed(motors, robot, at + side * _SMOOTH) for side in (1.0, -1.0)]
    if by_wheels[0] is None or by_wheels[1] is None:
        return
    turn, speed = ((a - b) / (2 * _SMOOTH) for a, b in zip(*by_wheels, strict=True))
    t, rate = measured.yaw_rate()
    if len(t) > 50:
        angle = np.concatenate(([0.0], np.cumsum(0.5 * np.diff(t) * (rate[1:, 0] + rate[:-1, 0]))))
        same = (np.interp(at + _SMOOTH, t, angle) - np.interp(at - _SMOOTH, t, angle)) / (2 * _SMOOTH)
        imu = experiment.channels.get("imu")
        topic = imu.topic if imu is not None and "yaw_rate" in imu else "/ground_truth/odom"
        yield "yaw rate", topic, (at, turn, same)
    t, points = measured.position()
    if len(t) > 50 and measured.position_source is not None:
        _, velocity = local_fit(t, points, at, max(2 * _SMOOTH, 2.5 * float(np.median(np.diff(t)))))
        yield "speed", measured.position_source.topic, (at, np.abs(speed), np.hypot(*velocity.T))


def lag(t: Array, reference: Array, other: Array) -> tuple[float, float] | None:
    """By how much `other` (n,) is later than `reference` (n,), on an even grid; and its standard deviation, s.

    The offset at which a straight line from one to the other leaves least; None where that is not far from perfect,
    or lies at the end of what is looked at.
    """
    dt = float(t[1] - t[0])
    most = round(_LONGEST / dt)
    middle = slice(most, len(t) - most)
    x = reference[middle]
    x = x - x.mean()
    scores, left = [], []
    for shift in range(-most, most + 1):
        y = other[most + shift : len(t) - most + shift]
        y = y - y.mean()
        size = float(np.linalg.norm(x) * np.linalg.norm(y))
        score = float(x @ y) / size if size > 0 else 0.0
        scores.append(score)
        left.append((1.0 - score**2) * float(y @ y))
    best = int(np.argmax(scores))
    if scores[best] < _ALIKE or best in (0, 2 * most):
        return None
    a, b, c = (left[best + side] for side in (-1, 0, 1))
    bend = a - 2 * b + c
    between = 0.5 * (a - c) / bend if bend > 0 else 0.0
    slope = np.gradient(other[best : len(t) - 2 * most + best], dt)
    independent = max(len(x) * dt / (4 * _SMOOTH), 2.0)
    spread = b / len(x)
    sd = float(np.sqrt(spread / max(float(np.mean(slope**2)) * independent, 1e-12)))
    return (best - most + between) * dt, sd
