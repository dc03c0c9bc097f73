"""The streams of a recording held against each other, and what may be found wrong with one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from artibot_sim.estimation.streams import (
    LAGS,
    Delay,
    StreamSegment,
    advancing,
    delay_of,
    reach,
    segments_of,
    turning,
)
from artibot_sim.experiment import Channel, Experiment

Array = NDArray[np.float64]

AGREES = 0.6
"""Share of the variance from which two streams are said to show the same motion."""


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong with a recording.

    Attributes
    ----------
    name : str
        `pose_delay`, `rotation_delay`, `gyro_delay`, `articulation_delay`, `clock_skew`, `held_samples`, `gyro_flip`,
        `gyro_axis`, `gyro_scale`, `gyro_bias`, `imu_tilt`, `pose_flip`, `side_swap`, `reversed_wheel`, `wheel_units`,
        `set_points`, `pose_leap` or `in_air`.
    topic : str
    value : float or None
        Its size, in `unit`.
    interval : (float, float) or None
        95 %.
    unit : str
    text : str
        What is wrong, for a person.
    evidence : str
        What shows it.
    mend : str
        What to do about it.
    serious : bool
        Whether nothing that is fitted means anything before it is mended.
    columns : mapping of str to mapping
        Channel → column → the column that holds its values, and their factor; empty where that does not mend it.
    """

    name: str
    topic: str
    value: float | None
    interval: tuple[float, float] | None
    unit: str
    text: str
    evidence: str
    mend: str
    serious: bool = False
    columns: Mapping[str, Mapping[str, tuple[str, float]]] = field(default_factory=dict)

    def __str__(self) -> str:
        return f"{self.text} ({self.evidence}); {self.mend}"

    def as_dict(self) -> dict[str, object]:
        """For a file."""
        return {
            "name": self.name, "topic": self.topic, "value": self.value,
            "ci95": list(self.interval) if self.interval else None, "unit": self.unit, "text": self.text,
            "evidence": self.evidence, "mend": self.mend,
        }  # fmt: skip


@dataclass(frozen=True)
class StreamComparisons:
    """All comparisons of a recording's streams; None where there is nothing to compare.

    Attributes
    ----------
    turn : Delay or None
        Heading after wheels.
    forward : Delay or None
        Positions after wheels.
    gyro : Delay or None
        Heading after gyroscope.
    gyro_wheels : Delay or None
        Gyroscope after wheels.
    response : Delay or None
        Wheels after commands.
    seed : int
        Of the draws that intervals come from.
    """

    experiment: Experiment
    segments: tuple[StreamSegment, ...]
    turn: Delay | None
    forward: Delay | None
    gyro: Delay | None
    gyro_wheels: Delay | None
    response: Delay | None
    seed: int = 0

    @property
    def pose_topic(self) -> str:
        """Where positions come from."""
        source = pose_channel(self.experiment)
        return source.topic if source is not None else ""


def pose_channel(experiment: Experiment) -> Channel | None:
    """Where a recording's positions come from; None where it has none."""
    return experiment.channels.get("ground_truth_odom") or experiment.channels.get("total_station")


def compare_streams(experiment: Experiment, seed: int = 0) -> StreamComparisons:
    """Hold the streams of a recording against each other; takes a second or two.

    Parameters
    ----------
    experiment : Experiment
    seed : int
        Of the draws that the delays' intervals come from.
    """
    segments = segments_of(experiment)
    _, most = reach(segments)

    def of(pieces: Sequence[object], **options: object) -> Delay | None:
        rng = np.random.default_rng(seed)
        return delay_of(list(pieces), most, rng, **options) if most > 0.1 else None  # type: ignore[arg-type]

    return StreamComparisons(
        experiment, tuple(segments),
        of(list(turning(segments, "heading", "wheels")), lags=LAGS),
        of(list(advancing(segments)), lags=LAGS),
        of(list(turning(segments, "heading", "gyro")), trend=True),
        of(list(turning(segments, "gyro", "wheels")), lags=LAGS),
        of(list(turning(segments, "wheels", "command")), lags=LAGS),
        seed,
    )  # fmt: skip


def agreeing(delay: Delay | None) -> Delay | None:
    """A comparison of two streams that move alike; None for another one."""
    return delay if delay is not None and delay.agreement >= AGREES else None
