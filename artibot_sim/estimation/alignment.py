"""The streams of a recording on one clock: stamps that are late or early are shifted before anything is fitted.

So are signs and sides that are the wrong way round turned, and a recording cut where its pose leaps.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from artibot_sim.estimation.checks.clocks import DELAYS
from artibot_sim.estimation.checks.comparisons import Finding, compare_streams, pose_channel
from artibot_sim.estimation.checks.findings import (
    GYRO_TURNED,
    SHORTEST,
    findings,
    imu_tilt,
    level,
    with_columns,
    with_signs,
    without_leaps,
)
from artibot_sim.estimation.checks.stream_values import StreamTable, stream_values
from artibot_sim.experiment import Channel, Experiment
from artibot_sim.model import Robot

SHIFTED = ("rotation_delay", "gyro_delay", "pose_delay", "articulation_delay")
"""Findings that say by how much stamps are off."""
SCALED = "clock_skew"
"""The finding that says how a clock drifts."""
LEAPS = "pose_leap"
"""The finding that says where poses have no relation to those before."""
FLIPPED = "gyro_flip"
"""The finding that the gyroscope is upside down, which its own rate shows."""
SWAPPED = "side_swap"
"""The finding that left and right wheels are taken for each other."""
TILTED = "imu_tilt"
"""The finding that an IMU's z axis does not point up."""
BIAS = "gyro_bias"
"""The finding that yaw rates are too large all the time. No recording is changed for it: the effect of that name may be
among what is fitted. Odometry, which has no pose to see it by, takes it from the robot file."""
EARLY = 0.1
"""s by which rotations must be early, at the least that the interval allows, before their stamps are shifted: tyres and
wheels that answer late look alike. Rotations that are late cannot be the rover's own doing."""


@dataclass(frozen=True)
class Aligned:
    """A recording on one clock.

    Attributes
    ----------
    experiment : Experiment
        With the stamps shifted.
    mended : tuple of Finding
        What was wrong with it, and is not any more.
    found : tuple of Finding
        What else is wrong with it, the serious first.
    streams : mapping of str to mapping
        What is known of each stream as it came, by topic; see `stream_values`.
    """

    experiment: Experiment
    mended: tuple[Finding, ...]
    found: tuple[Finding, ...]
    streams: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    @property
    def pose_delay(self) -> Finding | None:
        """By how much positions are late, where that was found and left as it is."""
        return next((one for one in self.found if _late_pose(one) and shiftable(one)), None)


def aligned(experiment: Experiment, robot: Robot, seed: int = 0, poses: bool | None = True) -> Aligned:
    """Shift the stamps of streams that are late or early, and level the IMU, as the streams themselves show.

    Rotations that are late stay so where the robot has a low-pass in front of its velocities (`velocity_filter`): that
    is what makes them late then.

    Parameters
    ----------
    experiment : Experiment
    robot : Robot
    seed : int
        Of the draws that intervals come from.
    poses : bool or None
        Whether late poses are shifted, too; not where their delay is a parameter of the model that is fitted. None is
        for a model in which it may become one: then late poses are shifted where other stamps are, too. Left by
        themselves they would be later than before against rotations that were shifted.
    """
    part = experiment.fitted_part
    if part is not None:  # one recording has one clock, and nothing is learnt from what is held out
        known = aligned(part, robot, seed, poses)
        return replace(known, experiment=_without_faults(_levelled(experiment), known.mended, robot))
    levelled = _levelled(experiment)
    tilted = () if levelled is experiment else tuple(imu_tilt(experiment))
    streams, wrong_signs = with_signs(compare_streams(without_leaps(levelled, robot), seed))
    signed = with_columns(levelled, wrong_signs)
    found = findings(signed, robot, streams)
    values = stream_values(streams, [*wrong_signs, *found], robot.wheel.r_w * robot.drive.front.tau)
    if poses is None:
        poses = any(one.name == "rotation_delay" and shiftable(one) for one in found)
    shifts, found = _shifts(found, levelled, robot, poses)
    leaps_and_turns = [one for one in found if one.name in (LEAPS, FLIPPED)]
    stated = [one for one in known_faults(signed, robot, values) if poses or one.name != "pose_delay"]
    mended = (*tilted, *wrong_signs, *shifts, *leaps_and_turns, *stated)
    rest = tuple(one for one in found if one not in mended)
    return Aligned(_without_faults(levelled, mended, robot) if mended else experiment, mended, rest, values)


def _shifts(
    found: Sequence[Finding], experiment: Experiment, robot: Robot, poses: bool
) -> tuple[list[Finding], list[Finding]]:
    """Findings by which stamps are shifted, and all findings, as they are then.

    Where only one of poses and rotations is surely late, the gyroscope is shifted instead, if `poses` may be.
    """
    every, shifts = list(found), [one for one in found if shiftable(one) and (poses or not _late_pose(one))]
    if poses and (late := _half_known(found)) is not None:
        every.remove(late)
        shifts.remove(late)
        shifts.append(_gyro_instead(late, experiment.channels["imu"].topic))
    if "velocity_filter" in robot.effects:  # which is what makes rotations late
        shifts = [one for one in shifts if one.name != "rotation_delay" or (one.value or 0.0) < 0.0]
    return shifts, every


def _levelled(experiment: Experiment) -> Experiment:
    """A recording whose IMU is level, as its accelerometer says; the same one where nothing is to be turned."""
    imu = experiment.channels.get("imu")
    if imu is None or (turned := level(imu)) is imu or not any(imu_tilt(experiment)):
        return experiment
    return replace(experiment, channels={**experiment.channels, "imu": turned})


def _without_faults(experiment: Experiment, faults: Sequence[Finding], robot: Robot) -> Experiment:
    """A recording with the signs, sides and stamps that it should have, cut where its pose leaps."""
    experiment = with_columns(experiment, faults)
    channels = dict(experiment.channels)
    for one in faults:
        for key, channel in channels.items():
            if channel.topic == one.topic and one.name in (*SHIFTED, SCALED):
                channels[key] = _restamped(channel, one, 0.5 * experiment.duration)
    return without_leaps(replace(experiment, channels=channels), robot)


def _half_known(found: Sequence[Finding]) -> Finding | None:
    """The sure one of the delays of poses and of rotations, where the other one is not sure; else None.

    Shifting one of the two by what it is late against the gyroscope would set it apart from the other, whose delay
    is about the same: how the robot advances for what its wheels turn would be wrong by all of it.
    """
    both = [one for one in found if one.name in ("pose_delay", "rotation_delay")]
    sure = [one for one in both if shiftable(one)]
    return sure[0] if len(both) == 2 and len(sure) == 1 else None


def _gyro_instead(late: Finding, topic: str) -> Finding:
    """The finding that the gyroscope is early beside a stream that is late: the same, with the other one shifted."""
    value, (low, high) = float(late.value or 0.0), late.interval or (0.0, 0.0)
    mine, other = ("poses", "rotations") if late.name == "pose_delay" else ("rotations", "poses")
    return replace(
        late, name="gyro_delay", topic=topic, value=-value, interval=(-high, -low),
        text=f"the gyroscope's rates are stamped {value:.2f} s early ({low:.2f}–{high:.2f}) beside {mine}",
        evidence=f"{late.evidence}; how late {other} are is not sure, so these and {mine} stay together",
        mend=f"shift their stamps by {value:+.2f} s",
    )  # fmt: skip


def known_faults(experiment: Experiment, robot: Robot, told: Mapping[str, Mapping[str, Any]]) -> Iterator[Finding]:
    """What the robot file says is wrong with streams, where a recording does not tell it itself.

    Parameters
    ----------
    experiment : Experiment
    robot : Robot
    told : mapping
        What `stream_values` says of the recording.
    """
    sensors, pose = robot.sensors, pose_channel(experiment)
    for key, name in DELAYS.items():
        channel, late = experiment.channels.get(key), float(getattr(sensors, name))
        if channel is not None and late and "delay" not in told.get(channel.topic, {}):
            late_words = f"is stamped {abs(late):.2f} s {'late' if late > 0 else 'early'}"
            yield _known(robot, name, channel, late, "s", late_words, f"shift its stamps by {-late:+.2f} s")
    if pose is not None and sensors.clock_skew and "delay" not in told.get(pose.topic, {}):
        words = f"has a clock that runs away by {sensors.clock_skew:.0f} ppm"
        yield _known(robot, SCALED, pose, sensors.clock_skew, "ppm", words, "scale its stamps")
    imu = experiment.channels.get("imu")
    if imu is not None and "yaw_rate" in imu and sensors.gyro_flip and "scale" not in told.get(imu.topic, {}):
        known = _known(robot, FLIPPED, imu, None, "-", "has yaw rates of the wrong sign", "turn its sign")
        yield replace(known, columns=GYRO_TURNED)


def _known(robot: Robot, name: str, channel: Channel, value: float | None, unit: str, words: str, mend: str) -> Finding:
    """What the robot file says is wrong with a stream."""
    return Finding(
        name, channel.topic, value, robot.intervals.get(f"sensors.{name}"), unit, f"{channel.topic} {words}",
        f"sensors.{name} of robot '{robot.name}'; the recording itself does not tell", mend,
    )  # fmt: skip


def with_faults(robot: Robot, timed: Sequence[Aligned], word: str) -> Robot:
    """A robot whose file says what was wrong with streams in these recordings: what was mended, and a gyroscope's bias.

    Parameters
    ----------
    robot : Robot
    timed : sequence of Aligned
    word : str
        What the source begins with: ``identified`` or ``diagnosed``.
    """
    faults, sources, intervals = dict[str, float](), dict(robot.sources), dict(robot.intervals)
    names = (*SHIFTED, SCALED, FLIPPED, *(() if BIAS in robot.effects else (BIAS,)))
    for name in names:
        found = [
            (one.experiment.name, was)
            for one in timed for was in (one.found if name == BIAS else one.mended)
            if was.name == name and (name != SCALED or _of_poses(one, was))
        ]  # fmt: skip
        if not found or len(found) < len(timed):  # in some recordings only: that is no property of the robot
            continue
        key = f"sensors.{name}"
        faults[name] = 1.0 if name == FLIPPED else float(np.mean([was.value for _, was in found]))
        sources[key] = f"{word}: from {', '.join(who for who, _ in found)}"
        ends = [was.interval for _, was in found if was.interval is not None]
        intervals |= {key: (min(low for low, _ in ends), max(high for _, high in ends))} if ends else {}
    return replace(robot, sensors=replace(robot.sensors, **faults), sources=sources, intervals=intervals)


def _of_poses(one: Aligned, was: Finding) -> bool:
    pose = pose_channel(one.experiment)
    return pose is not None and pose.topic == was.topic


def shiftable(one: Finding) -> bool:
    """Whether a finding says by how much stamps have to be shifted or scaled, surely enough to do so.

    That is where stamps are better afterwards, wherever in its interval the truth lies: no end of it is nearer to 0
    than to the value that is taken off.
    """
    if one.name not in (*SHIFTED, SCALED) or one.value is None or one.interval is None:
        return False
    low, high = one.interval
    if not (np.isfinite(low) and np.isfinite(high)):
        return False
    return low > 0.5 * one.value if one.value > 0.0 else high < min(0.5 * one.value, _least_early(one))


def _least_early(one: Finding) -> float:
    """s, negative, which the interval of a stream that is early must not reach."""
    return -EARLY if one.name == "rotation_delay" else 0.0


def _restamped(channel: Channel, was: Finding, middle: float) -> Channel:
    """A channel with the stamps that it should have; a drift leaves them as they are at `middle`, s."""
    size = float(was.value or 0.0)
    if was.name == SCALED:
        return restamped(channel, channel.t - 1e-6 * size * (channel.t - middle))
    return restamped(channel, channel.t - size)


def restamped(channel: Channel, t: NDArray[np.float64]) -> Channel:
    """A channel with other stamps (n,), s.

    Times of arrival move along: how these and the stamps run apart says something of the recording as it came.
    """
    ns = np.round(1e9 * (t - channel.t)).astype(np.int64)
    return replace(channel, t_ns=channel.t_ns + ns, t=channel.t + 1e-9 * ns, received_ns=channel.received_ns + ns)


def _late_pose(one: Finding) -> bool:
    return one.name == "pose_delay" and (one.value or 0.0) > 0.0


def on_one_clock(
    recordings: Sequence[Experiment], robot: Robot, seed: int = 0, poses: bool | None = True
) -> list[Aligned]:
    """Several recordings, each `aligned` by itself."""
    return [aligned(one, robot, seed, poses) for one in recordings]


def stream_table(timed: Sequence[Aligned]) -> StreamTable:
    """What is known of each stream as it came: topic → recording → `stream_values`."""
    found: dict[str, dict[str, Mapping[str, Any]]] = {}
    for one in timed:
        for topic, values in one.streams.items():
            found.setdefault(topic, {})[one.experiment.name] = values
    return found


def mean_shifts(timed: Sequence[Aligned]) -> dict[str, float]:
    """s by which stamps were shifted, in the mean over recordings, by the name of what was found."""
    each = [{was.name: -float(was.value or 0.0) for was in one.mended if was.name in SHIFTED} for one in timed]
    return {name: float(np.mean([found.get(name, 0.0) for found in each])) for name in SHIFTED if each}


def what_was_mended(timed: Sequence[Aligned]) -> list[str]:
    """Sentences on what was mended: stamps shifted or scaled, signs turned, leaps cut out; alike recordings in one."""
    return _together((one, was, f"{_mend(was)} beforehand") for one in timed for was in one.mended)


def _together(found: Iterable[tuple[Aligned, Finding, str]]) -> list[str]:
    """A sentence on each thing that is wrong with a stream and what becomes of it, whichever recordings it is in."""
    alike: dict[tuple[str, str, bool, bool], list[tuple[str, Finding, str]]] = {}
    for one, finding, then in found:
        key = (finding.name, finding.topic, (finding.value or 0.0) < 0.0, finding.serious)
        alike.setdefault(key, []).append((one.experiment.name, finding, then))
    said = []
    for (name, finding, then), *others in alike.values():
        likewise = ", ".join(f"{other} {_size(its)}".rstrip() for other, its, _ in others)
        said.append(
            f"{name}: {finding.text} ({finding.evidence}); {then}" + (f"; likewise {likewise}" if others else "")
        )
    return said


def _size(one: Finding) -> str:
    """How large a finding is, where its size differs from recording to recording."""
    if one.value is None or one.unit not in ("s", "ppm", "rad/s"):
        return ""
    digits = {"s": 2, "ppm": 0, "rad/s": 3}[one.unit]
    between = ""
    if one.interval:
        low, high = sorted(abs(end) for end in one.interval)
        between = f" ({low:.{digits}f}–{high:.{digits}f})" if np.isfinite(high) else " or more"
    return f"{abs(one.value):.{digits}f} {one.unit}{between}"


def _mend(was: Finding) -> str:
    size = float(was.value or 0.0)
    if was.name == SWAPPED:
        return "the sides were exchanged"
    if was.columns:
        return "the sign was turned"
    if was.name == TILTED:
        return "its axes were turned"
    if was.name == LEAPS:
        return f"the recording was cut there, pieces shorter than {SHORTEST:g} s were left out,"
    if was.name == SCALED:
        return f"that drift was taken off {was.topic}"
    return f"stamps were shifted by {-size:+.2f} s".replace("-", "−")


def what_is_left(timed: Sequence[Aligned], serious: bool | None = None) -> list[str]:
    """Sentences on what else is wrong with the streams; only on what is `serious`, or is not, where that is asked."""
    return _together(
        (one, found, found.mend)
        for one in timed for found in one.found if serious is None or found.serious == serious
    )  # fmt: skip


def what_is_wrong(fitted: Sequence[Aligned], held: Sequence[Aligned]) -> tuple[str, ...]:
    """What a report says first: what makes its figures worthless, what was mended, and what is doubtful.

    Parameters
    ----------
    fitted, held : sequence of Aligned
        Recordings; of those that are held out only what was mended.
    """
    held = [one for one in held if one.experiment.fitted_part is None]
    first = [f"mend this first, figures are worth nothing with it: {said}" for said in what_is_left(fitted, True)]
    return (*first, *what_was_mended([*fitted, *held]), *what_is_left(fitted, False))
