"""A run as named, timed columns with units: what every other part of artibot reads experiments from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment.topics import BY_KEY

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]
SEGMENT_GAP = 0.5
"""Silence of all measured topics, in s, after which a new segment begins."""
SILENT_PERIODS = 8.0
"""Usual periods of one topic for which it is silent where that is said."""


def read_only(values: ArrayLike, dtype: type = float) -> NDArray:
    """Return `values` as an array that nobody can write to (a copy unless it already is one)."""
    array: NDArray = np.asarray(values, dtype=dtype)
    if array.flags.writeable:
        array = array.copy()
        array.setflags(write=False)
    return array


@dataclass(frozen=True)
class Channel:
    """One topic as columns over time.

    Attributes
    ----------
    topic : name of the topic it was read from.
    t_ns : (n,) int64, header stamps in ns, strictly increasing (planned paths: as they came).
    t : (n,) seconds since the experiment's `start_ns`.
    received_ns : (n,) int64, when the recorder received the message.
    columns : name → (n,) array; NaN where a message did not carry the quantity.
    units : name → unit, SI.

    Notes
    -----
    JointState messages may each carry some of the joints only. Then a column has NaN in the rows of the
    other messages, and `series` gives the joint's own times and values.
    """

    topic: str
    t_ns: Stamps
    t: Floats
    received_ns: Stamps
    columns: Mapping[str, Floats]
    units: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, dtype in (("t_ns", np.int64), ("t", float), ("received_ns", np.int64)):
            object.__setattr__(self, name, read_only(getattr(self, name), dtype))
        columns = {name: read_only(values) for name, values in self.columns.items()}
        for name, values in columns.items():
            if values.shape != self.t_ns.shape:
                raise ArtibotError(f"{self.topic}: column '{name}' has shape {values.shape}, stamps {self.t_ns.shape}")
        object.__setattr__(self, "columns", MappingProxyType(columns))
        object.__setattr__(self, "units", MappingProxyType(dict(self.units)))

    def __len__(self) -> int:
        return len(self.t_ns)

    def __contains__(self, name: str) -> bool:
        return name in self.columns

    def __getitem__(self, name: str) -> Floats:
        """Return a column (n,), in `units[name]`.

        Raises
        ------
        ArtibotError
            If there is no such column; the message lists those there are.
        """
        try:
            return self.columns[name]
        except KeyError:
            raise ArtibotError(
                f"topic {self.topic} has no '{name}'; it has {', '.join(sorted(self.columns)) or 'nothing'}"
            ) from None

    def __repr__(self) -> str:
        span = f"{self.t[0]:.2f}–{self.t[-1]:.2f} s" if len(self) else "empty"
        return f"Channel({self.topic}, {len(self)} rows, {span}: {', '.join(self.columns)})"

    def series(self, name: str) -> tuple[Floats, Floats]:
        """Return the times (m,) in s and the values (m,) of a column where it is finite (m ≤ n)."""
        values = self[name]
        present = np.isfinite(values)
        return self.t[present], values[present]

    def between(self, t_start: float, t_end: float) -> Channel:
        """Return the rows with `t_start` ≤ t ≤ `t_end` (s since the experiment's start)."""
        kept = (self.t >= t_start) & (self.t <= t_end)
        columns = {name: values[kept] for name, values in self.columns.items()}
        return replace(self, t_ns=self.t_ns[kept], t=self.t[kept], received_ns=self.received_ns[kept], columns=columns)


@dataclass(frozen=True)
class Experiment:
    """A recorded or simulated run.

    Attributes
    ----------
    name : the recording's name.
    path : where it was read from.
    metadata : strings of the `artibot` record: `robot`, `kappa`, `surface`, …, all optional.
    start_ns : first header stamp of the measured topics; the zero of every channel's `t`.
    channels : key (`motor_torques`, `ground_truth_odom`, …) → `Channel`; a topic without a message is absent.
    segments : (t_start, t_end) in s, split where all measured topics are silent for more than 0.5 s.
    topics : every topic of the recording → its type, also those that artibot does not read.
    remarks : what was repaired or left out while reading, one sentence each.
    fitted_part : of a part that is held out, the part of the same recording that is fitted; else None.
    """

    name: str
    path: Path
    metadata: Mapping[str, str]
    start_ns: int
    channels: Mapping[str, Channel]
    segments: tuple[tuple[float, float], ...]
    topics: Mapping[str, str] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    fitted_part: Experiment | None = field(default=None, repr=False, compare=False)

    def __post_init__(self) -> None:
        for name in ("metadata", "channels", "topics"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))

    @property
    def duration(self) -> float:
        """From the first to the last stamp of the measured topics, in s."""
        return self.segments[-1][1] - self.segments[0][0] if self.segments else 0.0

    def require(self, key: str, *names: str) -> Channel:
        """Return a channel that must be there, with the columns `names`.

        Raises
        ------
        ArtibotError
            Naming file, topic, what the recording has, and the option that renames a topic.
        """
        topic = BY_KEY[key].name
        if key not in self.channels:
            present = ", ".join(sorted(self.topics)) or "no topic"
            raise ArtibotError(
                f"{self.path}: no message on {topic}; the recording has {present}; "
                f"if one of them is it, say --topic {topic}=FOUND"
            )
        channel = self.channels[key]
        absent = [name for name in names if name not in channel]
        if absent:
            raise ArtibotError(
                f"{self.path}: topic {channel.topic} has no {', '.join(absent)}; "
                f"it has {', '.join(sorted(channel.columns)) or 'nothing measured'}"
            )
        return channel

    def between(self, t_start: float, t_end: float) -> Experiment:
        """Return the part of every channel with `t_start` ≤ t ≤ `t_end`; time keeps its zero."""
        parts = {key: channel.between(t_start, t_end) for key, channel in self.channels.items()}
        parts = {key: channel for key, channel in parts.items() if len(channel)}
        segments = [(max(a, t_start), min(b, t_end)) for a, b in self.segments if a <= t_end and b >= t_start]
        return replace(self, channels=parts, segments=tuple(segments))


def measured_stamps(channels: Mapping[str, Channel]) -> Stamps:
    """Return all stamps of the measured topics, sorted, ns; of all topics where none is measured."""
    measured = [channel.t_ns for key, channel in channels.items() if BY_KEY[key].measured]
    stamps = measured or [channel.t_ns for channel in channels.values()]
    return np.unique(np.concatenate(stamps)) if stamps else np.empty(0, np.int64)


def find_segments(stamps: Stamps, start_ns: int) -> tuple[tuple[float, float], ...]:
    """Split sorted stamps (n,) in ns where they are more than `SEGMENT_GAP` s apart; return (t_start, t_end) in s."""
    if not len(stamps):
        return ()
    breaks = np.flatnonzero(np.diff(stamps) > round(SEGMENT_GAP * 1e9))
    firsts = stamps[np.concatenate(([0], breaks + 1))]
    lasts = stamps[np.concatenate((breaks, [len(stamps) - 1]))]
    return tuple(
        ((a - start_ns) / 1e9, (b - start_ns) / 1e9) for a, b in zip(firsts.tolist(), lasts.tolist(), strict=True)
    )


def silences(channel: Channel, segments: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Start and length (s) of a topic's silences within segments: of SILENT_PERIODS usual periods, and SEGMENT_GAP."""
    usual = float(np.median(np.diff(channel.t))) if len(channel) > 2 else 0.0
    found = []
    for first, last in segments:
        t = channel.t[(channel.t >= first - 1e-6) & (channel.t <= last + 1e-6)]
        step = np.diff(t)
        far = np.flatnonzero(step > max(SEGMENT_GAP, SILENT_PERIODS * usual))
        found += [(float(t[i]), float(step[i])) for i in far]
    return found
