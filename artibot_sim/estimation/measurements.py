"""What a recording measured, as series that a prediction is held against, each with the noise found in it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from artibot_sim.errors import ArtibotError
from artibot_sim.estimation.pose_noise import PoseNoise, pose_noise, rates
from artibot_sim.experiment import Experiment
from artibot_sim.experiment.inputs import MOTOR_GAP, MotorInputs, is_stretch, rotations, unbroken
from artibot_sim.experiment.measured import Measured
from artibot_sim.experiment.smoothing import noise_of
from artibot_sim.model import Robot
from artibot_sim.model.simulate.window_inputs import MotorTable, kind_of

Array = NDArray[np.float64]

CHANNELS = {
    "position": ("x", "y"),
    "yaw": ("yaw",),
    "yaw_rate": ("yaw_rate",),
    "articulation_yaw": ("articulation_yaw",),
    "torque_front": ("torque_front_right", "torque_front_left"),
    "torque_back": ("torque_back_right", "torque_back_left"),
}
"""Channel of the contract → what is sampled for it of a robot of two modules; of any number see `sampled`."""

CHANNEL_UNITS = {
    "position": "m", "yaw": "rad", "yaw_rate": "rad/s", "articulation_yaw": "rad", "torque_front": "N m",
    "torque_back": "N m",
}  # fmt: skip

_TORQUES = ("torque_front", "torque_back")
_GUESS = {"position": 0.01, "yaw": 0.01, "yaw_rate": 0.01, "articulation_yaw": 0.005, **dict.fromkeys(_TORQUES, 0.08)}
"""Noise where there are too few samples to tell; of torques a share of the largest ones, for motors of any size."""
_LEAST = {
    "position": 3e-4, "yaw": 3e-4, "yaw_rate": 5e-4, "articulation_yaw": 3e-4, **dict.fromkeys(_TORQUES, 0.005),
}  # fmt: skip
"""Noise that is taken at least, in the same units: encoders are smoothed and steps are finite, also where a recording
is exact."""
_LARGEST = 0.99
"""Share of all torques that are no larger than what counts as the largest: single samples may be wrong."""
HALF_WIDTH = 0.04
"""s around an instant whose encoder positions give a motor's rotation. Wider ones cut the peaks of slip, and every
force comes out too large for it (0.3 % here); narrower ones leave more of the encoders' counts in the slip, and every
force comes out too small."""
TIMING = 0.005
"""s to which it is known when something was measured."""
_JUMP = 4.0
"""Change from one sample to the next, in units of its noise, that counts as a jump."""
_FEW = 100
"""Samples of the motors from which gaps are said to be everywhere: fewer are few samples."""
PAST = 0.1
"""s between two looks at how the rover came to where it is."""


@dataclass(frozen=True)
class MeasuredSeries:
    """One measured quantity of one stretch.

    Attributes
    ----------
    channel : str
        One of CHANNELS.
    kind : int
        See `window_inputs.kind_of`.
    t, value : array, shape (n,)
        s since the recording's start, SI.
    sigma : float
        Standard deviation of its noise.
    jitter : float
        Standard deviation of the instants that its stamps are off by, s.
    """

    channel: str
    kind: int
    t: Array
    value: Array
    sigma: float
    jitter: float = 0.0

    @cached_property
    def timing(self) -> Array:
        """What stamps that jitter add to the noise while the value changes, shape (n,): a standard deviation."""
        if not self.jitter or len(self.t) < 2:
            return np.zeros(len(self.t))
        return np.asarray(self.jitter * np.abs(rates(self.t, self.value[:, None])[:, 0]))

    @property
    def noise(self) -> float:
        """Standard deviation of its noise in the middle of all samples, whatever it is from."""
        return float(np.hypot(self.sigma, np.median(self.timing))) if len(self.t) else self.sigma

    @cached_property
    def spread(self) -> Array:
        """Standard deviation of each sample's noise, shape (n,)."""
        return np.asarray(np.hypot(np.hypot(self.sigma, self.slack), self.timing))

    @cached_property
    def slack(self) -> Array:
        """What an instant known to TIMING costs where the value jumps, shape (n,): a standard deviation beside `sigma`.

        When a wheel breaks away torques fall by twenty times their noise within a sample. Stamps, the smoothed
        rotations and the integration steps are not sure to a few milliseconds when that was.
        """
        if len(self.t) < 3 or not np.isfinite(self.sigma):
            return np.zeros(len(self.t))
        slope = np.abs(np.diff(self.value) / np.maximum(np.diff(self.t), 1e-4))
        jump = np.abs(np.diff(self.value)) > _JUMP * np.sqrt(2.0) * self.sigma
        slope = np.where(jump, slope, 0.0)
        steepest = np.maximum(np.append(slope, 0.0), np.insert(slope, 0, 0.0))
        limit = np.append(np.abs(np.diff(self.value)), 0.0)
        return np.minimum(TIMING * steepest, np.maximum(limit, np.insert(limit[:-1], 0, 0.0)))


@dataclass(frozen=True)
class Stretch:
    """A part of a recording through which the motors were measured without a gap.

    Attributes
    ----------
    experiment : Experiment
    measured : Measured
        Of its segment.
    inputs : MotorInputs
        Knots through the stretch.
    series : tuple of MeasuredSeries
    half_width : float
        s around an instant whose encoder positions gave the inputs.
    behind : int
        Joints behind the first.
    """

    experiment: Experiment
    measured: Measured
    inputs: MotorInputs
    series: tuple[MeasuredSeries, ...]
    half_width: float = HALF_WIDTH
    behind: int = 0

    @cached_property
    def motion(self) -> tuple[Array, Array]:
        """Times (m,), PAST s apart, and the motion then, (m, 8) in the order of `MeasuredMotion`.

        Angle and rate of each joint behind the first follow.
        """
        times = np.arange(self.inputs.t[0], self.inputs.t[-1], PAST)
        return times, np.hstack([self.measured.along(times), self.measured.behind_along(times, self.behind)])

    def table(self, kappa: float | None) -> MotorTable:
        """How the motors turned, as the model takes it."""
        turned = np.isfinite(self.inputs.velocity).all(axis=0)
        return MotorTable(
            self.inputs.dt,
            np.ascontiguousarray(np.where(turned, self.inputs.position, 0.0)),
            np.ascontiguousarray(np.where(turned, self.inputs.velocity, 0.0)),
            np.ascontiguousarray(self.inputs.torque), self.inputs.modes, kappa, self.inputs.from_speeds,
        )  # fmt: skip


def stretches(experiment: Experiment, robot: Robot, half_width: float = HALF_WIDTH) -> list[Stretch]:
    """The stretches of a recording, noise levels estimated from its own samples, motors smoothed over `half_width` s.

    Raises
    ------
    ArtibotError
        If the recording has no motor rotations, no source of where the rover went, or nothing of both at once.
    """
    found = list(_every_stretch(experiment, robot, half_width))
    if not found:
        raise _nothing_together(experiment)
    return with_pooled_noise(found)


def require_stretch(experiment: Experiment, robot: Robot) -> None:
    """Refuse what `stretches` refuses, which takes a first stretch and not all of them.

    Raises
    ------
    ArtibotError
        As `stretches`.
    """
    if next(_every_stretch(experiment, robot, HALF_WIDTH), None) is None:
        raise _nothing_together(experiment)


def _every_stretch(experiment: Experiment, robot: Robot, half_width: float) -> Iterator[Stretch]:
    """Stretches with the noise of their own samples."""
    motors = experiment.require("motor_torques")
    if Measured(experiment, 0.0, 0.0).position_source is None:
        experiment.require("total_station")
    for t_start, t_end in experiment.segments:
        measured = Measured(experiment, t_start, t_end)
        times = motors.between(t_start - 1e-6, t_end + 1e-6).t
        series = _series(measured, robot)
        for a, b in filter(is_stretch, unbroken(times)):
            if any(((s.t >= a) & (s.t <= b)).sum() >= 2 for s in series if s.channel == "position"):
                inputs = rotations(experiment, robot, a, b, half_width)
                yield Stretch(experiment, measured, inputs, tuple(series), half_width, len(robot.trailing))


def _nothing_together(experiment: Experiment) -> ArtibotError:
    motors = experiment.require("motor_torques")
    topic, spans = motors.topic, [span for a, b in experiment.segments for span in unbroken(motors.between(a, b).t)]
    if spans and len(motors) >= _FEW and not any(map(is_stretch, spans)):
        return ArtibotError(
            f"{experiment.path}: {topic} has gaps everywhere: {len(spans) - 1} of more than {MOTOR_GAP:g} s in "
            f"{experiment.duration:.0f} s; the machine was too slow or too busy, record again"
        )
    return ArtibotError(
        f"{experiment.path}: {topic} and positions are never measured at the same time; check the recording's stamps"
    )


def _series(measured: Measured, robot: Robot) -> list[MeasuredSeries]:
    """Everything measured in a segment; noise as its own samples show it, NaN where they are too few."""
    tables = {"position": [measured.position()], "yaw": [measured.yaw()], "yaw_rate": [measured.yaw_rate()]}
    tables["articulation_yaw"] = [measured.articulation(joint) for joint in range(len(robot.modules) - 1)]
    for channel in ("torque_front", "torque_back"):
        tables[channel] = [measured.torques(pair) for pair in motor_pairs(robot, channel)]
    deviation = {channel: measured.torque_deviation(pairs[0]) for channel in ("torque_front", "torque_back")
                 if (pairs := motor_pairs(robot, channel))}  # fmt: skip
    wanted, found = sampled(robot), []
    for channel, parts in tables.items():
        columns = [(t, column) for t, values in parts for column in values.T]
        for (t, column), name in zip(columns, wanted.get(channel, ()), strict=False):
            if len(t):
                kind = kind_of("heading" if name == "yaw" and not measured.late_heading else name)
                sigma = deviation.get(channel, np.nan)
                sigma = sigma if np.isfinite(sigma) else noise_of(t, column)
                found.append(MeasuredSeries(channel, kind, t, np.ascontiguousarray(column), sigma))
    return found


def motor_pairs(robot: Robot, channel: str) -> list[tuple[str, str]]:
    """The motors of each module whose torques are a channel's: of the front one, or of all driven ones behind it."""
    motors = robot.motors if robot.articulated else robot.motors[:2]
    pairs = list(zip(motors[::2], motors[1::2], strict=True))
    return pairs[:1] if channel == "torque_front" else pairs[1:]


def sampled(robot: Robot) -> dict[str, tuple[str, ...]]:
    """What is sampled for each channel of a robot, see `window_inputs.kind_of`.

    Angles of all its joints are one channel, and so are the torques of all motors behind the front module.
    """
    found = dict(CHANNELS)
    found["articulation_yaw"] = robot.articulation_joints[::2]
    found["torque_back"] = tuple(f"torque_{motor}" for pair in motor_pairs(robot, "torque_back") for motor in pair)
    return {channel: names for channel, names in found.items() if names}


def with_pooled_noise(found: Sequence[Stretch]) -> list[Stretch]:
    """Stretches with one noise level a channel: the median over all series that have one; of poses see `pose_noise`."""
    segments = {(id(one.experiment), one.measured.t_start): one.measured for one in found}
    levels, poses = noise_levels(found), pose_noise(list(segments.values()))
    own = _own_noise(found, poses) if poses is not None else {}
    jitter = poses.jitter if poses is not None else 0.0
    return [replace(stretch, series=tuple(
        replace(s, sigma=own[s.channel], jitter=jitter) if s.channel in own else replace(s, sigma=levels[s.channel])
        for s in stretch.series
    )) for stretch in found]  # fmt: skip


def _own_noise(found: Sequence[Stretch], poses: PoseNoise) -> dict[str, float]:
    """Constant noise of channels of which `poses` tells more than single series: stamps jitter, or series are short."""
    own = {"position": poses.place} | ({"yaw": poses.heading} if np.isfinite(poses.heading) else {})
    sigmas = [(s.channel, s.sigma) for stretch in found for s in stretch.series]
    told = {channel for channel, sigma in sigmas if np.isfinite(sigma)}
    return {
        channel: max(value, _LEAST[channel]) for channel, value in own.items() if poses.jitter or channel not in told
    }


def noise_levels(found: Sequence[Stretch]) -> dict[str, float]:
    """Noise of each measured channel (standard deviation of one sample, SI)."""
    levels: dict[str, list[float]] = {}
    for stretch in found:
        for series in stretch.series:
            levels.setdefault(series.channel, []).append(series.noise)
    pooled = {}
    for channel, values in levels.items():
        known = [value for value in values if np.isfinite(value)]
        unit = _largest_torque(found) if channel in _TORQUES else 1.0
        pooled[channel] = max(float(np.median(known)) if known else unit * _GUESS[channel], unit * _LEAST[channel])
    return pooled


def _largest_torque(found: Sequence[Stretch]) -> float:
    """Of all motors, N m; 1 where none ever pulls."""
    torques = [np.abs(series.value) for stretch in found for series in stretch.series if series.channel in _TORQUES]
    known = np.concatenate(torques)
    known = known[np.isfinite(known)]
    return (float(np.quantile(known, _LARGEST)) if len(known) else 0.0) or 1.0


def missing(found: Sequence[Stretch], robot: Robot) -> list[str]:
    """Channels that a rover like this could have and that nothing measured."""
    present = {series.channel for stretch in found for series in stretch.series}
    wanted = list(sampled(robot))
    if "position" in present and "yaw" not in present:
        wanted.remove("yaw")
    return [channel for channel in wanted if channel not in present]


def other_robot(experiment: Experiment, robot: Robot) -> Iterator[str]:
    """A sentence where a recording says that it is of another robot than `robot`."""
    named = experiment.metadata.get("robot")
    if named and named != robot.name:
        yield f"was recorded with robot '{named}', and is taken for '{robot.name}'"
