"""Which streams of a recording are late or early, and clocks that run away."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from artibot_sim.estimation.checks.comparisons import Finding, StreamComparisons, agreeing
from artibot_sim.estimation.streams import (
    LAGS,
    Delay,
    bending,
    delay_of,
    reach,
)
from artibot_sim.model import MOTORS

LATE_REPORTED = 0.04
"""s that the interval of a delay of the wheels must stay away from 0: a rover answers them late by itself."""
LATE_REPORTED_POSE = 0.02
"""s that other intervals must stay away from 0: pose and gyroscope see one body, and no pose comes before rotations."""
TOGETHER = 0.07
"""s within which two streams count as equally late."""
DRIFT_REPORTED = 0.02
"""s by which a clock must run away over a recording, at the least that its interval allows."""
SKEW_REPORTED = 100e-6
"""Seconds a second by which a clock must run away, at the least that its interval allows."""


def delays(of: StreamComparisons) -> Iterator[Finding]:
    """Which stream is late, by all comparisons together."""
    pose_wheels, pose_gyro, gyro_wheels = body_after_wheels(of)
    motors = of.experiment.channels.get("motor_torques")
    imu = of.experiment.channels.get("imu")
    wheels_topic, gyro_topic = motors.topic if motors else "", imu.topic if imu else ""
    if pose_gyro is not None and pose_wheels is not None and gyro_wheels is not None:
        if abs(pose_gyro.value) <= LATE_REPORTED_POSE:
            yield from _late_rotations(wheels_topic, gyro_wheels, "pose and gyroscope")
        elif _together(gyro_wheels):
            yield from _late("pose_delay", of.pose_topic, pose_gyro, gyro_topic, LATE_REPORTED_POSE)
        elif _together(pose_wheels):
            beside = " and rotations; or these are late together" if pose_gyro.value > 0 else " and rotations"
            yield from _late("gyro_delay", gyro_topic, _negative(pose_gyro), of.pose_topic + beside, LATE_REPORTED_POSE)
        else:
            yield from _late("pose_delay", of.pose_topic, pose_gyro, gyro_topic, LATE_REPORTED_POSE)
            yield from _late_rotations(wheels_topic, gyro_wheels, gyro_topic)
    elif pose_wheels is not None and gyro_wheels is not None:
        yield from _by_wheels(of, pose_wheels, gyro_wheels, wheels_topic, gyro_topic)
    elif pose_wheels is not None:
        if pose_wheels.value >= 0:
            yield from _late("pose_delay", of.pose_topic, pose_wheels, wheels_topic, TOGETHER)
        else:
            yield from _late_rotations(wheels_topic, pose_wheels, of.pose_topic)


def body_after_wheels(of: StreamComparisons) -> tuple[Delay | None, Delay | None, Delay | None]:
    """By how much poses are later than wheels, poses than the gyroscope, and this than wheels.

    Pose and gyroscope see one body. How it advances tells when its wheels turned; how it turns goes through lateral
    forces, with lags and leads that nobody knows beforehand (tyres that relax lead by 0.1 s), and counts where it does
    not contradict, or where there is nothing else.
    """
    turn, forward = agreeing(of.turn), agreeing(of.forward)
    pose_gyro, gyro_wheels = agreeing(of.gyro), agreeing(of.gyro_wheels)
    if pose_gyro is None:
        return _borne_out(forward, turn), None, gyro_wheels
    before = _negative(pose_gyro)
    return (
        forward or surest(turn, _sum(pose_gyro, gyro_wheels)), pose_gyro,
        _borne_out(_sum(forward, before), gyro_wheels, _sum(turn, before)),
    )  # fmt: skip


def _borne_out(advance: Delay | None, *turning: Delay | None) -> Delay | None:
    """The surest of delays: of those by turning, which lie in the interval of that by advance, if there is one."""
    if advance is None:
        return surest(*turning)
    low, high = advance.interval
    return surest(advance, *(one for one in turning if one is not None and low <= one.value <= high))


def _together(body: Delay) -> bool:
    """Whether wheels count as on time beside a body that is so much later: it may move later, but not before them."""
    return body.value <= TOGETHER and body.interval[1] >= -LATE_REPORTED_POSE


def _late_rotations(topic: str, body: Delay | None, against: str) -> Iterator[Finding]:
    """Rotations that are late, or early, where the body is so much later than its wheels: it moves later by itself."""
    if body is not None:
        least = LATE_REPORTED_POSE if body.value < 0 else LATE_REPORTED
        yield from _late("rotation_delay", topic, _negative(body), against, least)


def or_smoothed(of: StreamComparisons, found: Finding) -> Finding:
    """Late rotations where nothing but speeds is recorded: a low-pass on these (`velocity_filter`) looks the same."""
    motors = of.experiment.channels.get("motor_torques")
    recorded = motors is not None and any(f"{motor}.position" in motors for motor in MOTORS)
    if found.name != "rotation_delay" or (found.value or 0.0) < 0.0 or recorded:
        return found
    either = "or smoothed by a low-pass of that time constant (velocity_filter), which recorded angles would tell"
    return replace(found, text=f"{found.text}, {either}")


def _by_wheels(
    of: StreamComparisons, pose: Delay, gyro: Delay, wheels_topic: str, gyro_topic: str
) -> Iterator[Finding]:
    """Pose (a point without heading) and gyroscope, each against the wheels."""
    if abs(pose.value - gyro.value) <= TOGETHER and min(pose.value, gyro.value) < 0:
        yield from _late_rotations(wheels_topic, surest(pose, gyro), "pose and gyroscope")
        return
    yield from _late("pose_delay", of.pose_topic, pose, wheels_topic, TOGETHER if pose.value > 0 else LATE_REPORTED)
    yield from _late("gyro_delay", gyro_topic, gyro, wheels_topic, TOGETHER if gyro.value > 0 else LATE_REPORTED)


_BACK_LAGS = (0.0, 0.03)
"""s of first-order lag of both modules' turning, of which only the back one's is by its wheels."""


def articulation_after_modules(of: StreamComparisons, found: Sequence[Finding]) -> Delay | None:
    """By how much the articulation is later than the modules' turning, whose own delays in `found` are taken off."""
    values = {one.name: one.value for one in found if one.value is not None}
    late = {key: values[name] for key, name in DELAYS.items() if name in values}
    _, most = reach(of.segments)
    pieces = list(bending(of.segments, late)) if most > 0.1 else []
    lags = LAGS if _front_turns_by(of) == "motor_torques" else _BACK_LAGS
    return agreeing(delay_of(pieces, most, np.random.default_rng(of.seed), lags=lags))


def late_articulation(of: StreamComparisons, found: Sequence[Finding]) -> Iterator[Finding]:
    """The articulation's angles where they are late or early; other clocks' faults are `found` already."""
    delay = articulation_after_modules(of, found)
    if delay is not None:
        channels = of.experiment.channels
        topics = dict.fromkeys(channels[key].topic for key in (_front_turns_by(of), "motor_torques"))
        yield from _late("articulation_delay", channels["joint_states"].topic, delay, " and ".join(topics), TOGETHER)


def _front_turns_by(of: StreamComparisons) -> str:
    """The stream that says how the front module turns."""
    return next((one.front_turning[0] for one in of.segments if one.front_turning is not None), "motor_torques")


def surest(*delays: Delay | None) -> Delay | None:
    """The delay with the shortest interval; None if there is none."""
    there = [d for d in delays if d is not None]
    return min(there, key=_width) if there else None


def _width(delay: Delay) -> float:
    return delay.interval[1] - delay.interval[0]


def _sum(first: Delay | None, then: Delay | None) -> Delay | None:
    """By how much one stream is later than another, by way of a third: `first` than that, and that `then` the other."""
    if first is None or then is None:
        return None
    below = np.hypot(first.value - first.interval[0], then.value - then.interval[0])
    above = np.hypot(first.interval[1] - first.value, then.interval[1] - then.value)
    value = first.value + then.value
    return replace(
        first, value=value, interval=(value - float(below), value + float(above)),
        agreement=min(first.agreement, then.agreement), blocks=min(first.blocks, then.blocks),
    )  # fmt: skip


def _negative(delay: Delay) -> Delay:
    (low, high), (falls, rises) = delay.interval, delay.skew_interval
    return replace(delay, value=-delay.value, interval=(-high, -low), skew=-delay.skew, skew_interval=(-rises, -falls))


DELAYS = {
    "motor_torques": "rotation_delay", "imu": "gyro_delay", "ground_truth_odom": "pose_delay",
    "total_station": "pose_delay", "joint_states": "articulation_delay",
}  # fmt: skip
"""Stream → the finding that its stamps are late or early."""
_WORDS = {
    "pose_delay": "poses are", "rotation_delay": "rotations are", "gyro_delay": "the gyroscope's rates are",
    "articulation_delay": "the articulation's angles are",
}  # fmt: skip


def _late(name: str, topic: str, delay: Delay, against: str, least: float) -> Iterator[Finding]:
    low, high = delay.interval
    if low <= least and high >= -least:
        return
    word = "late" if delay.value > 0 else "early"
    ends = sorted((abs(low), abs(high)))
    between = f"{ends[0]:.2f}–{ends[1]:.2f}" if np.isfinite(ends[1]) else "or more: windows this short show no later"
    yield Finding(
        name, topic, delay.value, delay.interval, "s",
        f"{_WORDS[name]} stamped {abs(delay.value):.2f} s {word} ({between})",
        f"{topic} against {against}; {100 * delay.agreement:.0f} % of the motion agrees then",
        f"shift their stamps by {-delay.value:+.2f} s",
    )  # fmt: skip


def skews(of: StreamComparisons) -> Iterator[Finding]:
    """The surest drift of one stream's clock against another's."""
    motors = of.experiment.channels.get("motor_torques")
    imu = of.experiment.channels.get("imu")
    pairs = [
        (agreeing(of.gyro), of.pose_topic, imu.topic if imu else ""),
        (surest(agreeing(of.turn), agreeing(of.forward)), of.pose_topic, motors.topic if motors else ""),
        (agreeing(of.gyro_wheels), imu.topic if imu else "", motors.topic if motors else ""),
    ]
    duration = of.experiment.duration
    for delay, topic, against in pairs:
        if delay is None or not np.isfinite(delay.skew_interval).all():
            continue
        low, high = delay.skew_interval
        least = min(abs(low), abs(high)) if low * high > 0 else 0.0
        if least > SKEW_REPORTED and least * duration > DRIFT_REPORTED:
            yield Finding(
                "clock_skew", topic, 1e6 * delay.skew, (1e6 * low, 1e6 * high), "ppm",
                f"the clock of {topic} runs away from that of {against} by {1e6 * abs(delay.skew):.0f} ppm",
                f"its delay changes by {1e3 * abs(delay.skew) * duration:.0f} ms over {duration:.0f} s",
                "scale its stamps, or stamp both with one clock",
            )  # fmt: skip
            return
