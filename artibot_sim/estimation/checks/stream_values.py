"""Delay, hold, scale and sign of each stream of a recording as numbers, for programs that read results."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from artibot_sim.estimation.checks.clocks import DELAYS, articulation_after_modules, body_after_wheels
from artibot_sim.estimation.checks.comparisons import Finding, StreamComparisons, agreeing
from artibot_sim.estimation.checks.findings import COLUMNS
from artibot_sim.estimation.streams import Delay, holding

StreamTable = Mapping[str, Mapping[str, Mapping[str, Any]]]
"""Topic → recording → what `stream_values` gives."""

_FLIPS = ("gyro_flip", "pose_flip", "reversed_wheel")


def stream_values(of: StreamComparisons, found: Sequence[Finding], wheel_radius: float) -> dict[str, dict[str, Any]]:
    """What is known of each stream, by topic.

    Parameters
    ----------
    of : StreamComparisons
    found : sequence of Finding
        What is wrong with the recording, mended or not.
    wheel_radius : float
        m by which the robot should go for a radian of its motors.

    Returns
    -------
    dict of dict
        Values with ``ci95`` (null where it is not known): ``delay`` (s by which stamps are late), ``skew`` (ppm, drift
        of that delay), ``hold`` (share of samples that repeat the one before, and the period of changes, s), ``scale``
        (recorded over true), and ``sign``, which is 1 or -1. Of a stream that is not late by what can be told the
        delay is that ``against`` another one. What cannot be told is left out.
    """
    values: dict[str, dict[str, Any]] = {}
    for key, names in COLUMNS.items():
        channel = of.experiment.channels.get(key)
        if channel is None or channel.topic in values:
            continue
        mine = {one.name: one for one in found if one.topic == channel.topic}
        about: dict[str, Any] = {"sign": -1 if any(name in mine for name in _FLIPS) else 1}
        about |= _delay(of, key, mine, found)
        if "clock_skew" in mine:
            about["skew"] = _said(mine["clock_skew"])
        held = holding(channel, names)
        if held is not None:
            about["hold"] = {"share": held.share, "period": held.period, "unit": "s"}
        about |= _scale(of, key, wheel_radius)
        values[channel.topic] = about
    return values


def _said(one: Finding) -> dict[str, Any]:
    return _value(one.value, one.unit, one.interval)


def _value(value: float | None, unit: str, ends: Sequence[float] | None) -> dict[str, Any]:
    """A number with its interval; an end that nobody knows is null."""
    known = [end if math.isfinite(end) else None for end in ends] if ends else None
    return {"value": value, "unit": unit, "ci95": known}


def _delay(of: StreamComparisons, key: str, mine: Mapping[str, Finding], found: Sequence[Finding]) -> dict[str, Any]:
    """By how much a stream is late."""
    late = next((mine[name] for name in DELAYS.values() if name in mine), None)
    if late is not None:
        return {"delay": _said(late)}
    names, channels = {one.name for one in found}, of.experiment.channels
    if key == "joint_states":
        bent = articulation_after_modules(of, found)
        topic = channels["motor_torques"].topic
        return {} if bent is None else {"delay": {**_value(bent.value, "s", bent.interval), "against": topic}}
    topics = {key: channels[key].topic for key in ("imu", "motor_torques") if key in channels}
    topics["pose"] = of.pose_topic
    pose, gyro, wheels = body_after_wheels(of)
    against = {
        "imu": ((gyro, -1.0, "pose"), (wheels, 1.0, "motor_torques")),
        "motor_torques": ((wheels, -1.0, "imu"), (pose, -1.0, "pose")),
    }.get(key, ((gyro, 1.0, "imu"), (pose, 1.0, "motor_torques")))
    for delay, sign, other in against:
        if delay is not None and DELAYS.get(other, "pose_delay") not in names:
            ends = sorted(sign * end for end in delay.interval)
            return {"delay": {**_value(sign * delay.value, "s", ends), "against": topics[other]}}
    return {}


def _scale(of: StreamComparisons, key: str, wheel_radius: float) -> dict[str, Any]:
    """Recorded over true: of the gyroscope against the heading, of rotations against the path."""
    if key == "imu" and (gyro := agreeing(of.gyro)) is not None:
        return _ratio(1.0, abs(float(gyro.coefficients[0])), gyro, 1)
    if key == "motor_torques" and (forward := agreeing(of.forward)) is not None:
        return _ratio(wheel_radius, float(abs(forward.coefficients[:2]).sum()), forward, 2)
    return {}


def _ratio(expected: float, fitted: float, delay: Delay, columns: int) -> dict[str, Any]:
    if not fitted > 0.0:
        return {}
    value, share = expected / fitted, 2.0 * float((delay.spread[:columns] ** 2).sum() ** 0.5) / fitted
    return {"scale": _value(value, "-", (value * (1.0 - share), value * (1.0 + share)))}
