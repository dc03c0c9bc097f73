"""Figures of merit of a recording: eqs 31 and 32 and radii, as numbers, in the terminal and for scripts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment import Experiment, metrics
from artibot_sim.report.paths import Track, find_track, find_truth, motion_window, whole_turns

if TYPE_CHECKING:
    from rich.table import Table

    from artibot_sim.experiment import Experiment

# ----------------------------------------------------------------------
# Figures of merit of a recording: eqs 31 and 32 and radii, for what the rover did and for what it believed.
#
# The formulas are in `experiment.metrics`; here is which samples of a recording go into them.
# ----------------------------------------------------------------------


Floats = NDArray[np.float64]
_LEAST_TURN = 0.35
"""Least yaw of an arc, rad."""
_STEADY = 0.03
"""Curvature of an arc varies by less than this fraction."""
_LATE = 0.1
"""A recording may end this long (s) before the plan without a remark."""


@dataclass(frozen=True)
class DrivenArc:
    """A part of the planned path that is a circle.

    Attributes
    ----------
    t_start, t_end : float
        When it is planned, s since the recording's start.
    turn : float
        Planned yaw over it, rad, positive to the left.
    radius : mapping
        ``planned``, ``odometric``, ``true`` → radius (m) of the circle fitted to what was driven in that time.
    """

    t_start: float
    t_end: float
    turn: float
    radius: Mapping[str, float]


@dataclass(frozen=True)
class Measures:
    """Figures of merit of one recording; what it does not allow to be computed is absent.

    Attributes
    ----------
    window : (t_start, t_end) or None
        Begin and end of the planned motion as far as it is recorded, s: eq. 31 integrates over it.
    e_gamma : mapping
        ``odometric``, ``true`` → relative yaw error (eq. 31), dimensionless.
    e_x : mapping
        The same for the final position (eq. 32).
    path_length : mapping
        ``planned``, ``odometric``, ``true`` → m over the window.
    arcs : tuple of DrivenArc
    radius : mapping
        Kind → mean over the arcs, m, where all have one.
    remarks : tuple of str
        Why something is absent.
    """

    window: tuple[float, float] | None
    e_gamma: Mapping[str, float]
    e_x: Mapping[str, float]
    path_length: Mapping[str, float]
    arcs: tuple[DrivenArc, ...]
    radius: Mapping[str, float]
    remarks: tuple[str, ...]

    def __post_init__(self) -> None:
        for name in ("e_gamma", "e_x", "path_length", "radius"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))

    def as_dict(self) -> dict[str, Any]:
        """Return all as JSON takes it; None where a value is absent."""
        three, two = ("planned", "odometric", "true"), ("odometric", "true")
        arcs = [
            {
                "t_start": arc.t_start,
                "t_end": arc.t_end,
                "turn": arc.turn,
                **{kind: arc.radius.get(kind) for kind in three},
            }
            for arc in self.arcs
        ]
        return {
            "window": {"unit": "s", "start": self.window and self.window[0], "end": self.window and self.window[1]},
            "e_gamma": {"unit": "1", **{kind: self.e_gamma.get(kind) for kind in two}},
            "e_x": {"unit": "1", **{kind: self.e_x.get(kind) for kind in two}},
            "radius": {"unit": "m", **{kind: self.radius.get(kind) for kind in three}, "arcs": arcs},
            "path_length": {"unit": "m", **{kind: self.path_length.get(kind) for kind in three}},
        }


def measure(experiment: Experiment) -> Measures:
    """Return the figures of merit of a recording.

    Notes
    -----
    The planned yaw and position are taken at the stamps of what is compared with them. Poses after a gap have no
    relation to those before it, so a recording of several segments has none of these figures.
    """
    planned = find_track(experiment, "planned")
    window = motion_window(planned) if planned else None
    why = _obstacle(experiment, planned, window)
    tracks = {"odometric": find_track(experiment, "odometric"), "true": find_truth(experiment)}
    present = {kind: track for kind, track in tracks.items() if track is not None and track.timed}
    if why or planned is None or window is None:
        return Measures(None, {}, {}, {}, (), {}, (why,))
    remarks = [f"{kind}: not recorded" for kind in tracks if kind not in present]
    last = min([window[1], *(float(track.t[-1]) for track in present.values())])
    if last < window[1] - _LATE:
        remarks.append(
            f"the recording ends {window[1] - last:.1f} s before the plan; the figures are for what there is"
        )
    window = (window[0], last)
    e_gamma: dict[str, float] = {}
    e_x: dict[str, float] = {}
    for kind, track in present.items():
        _try(e_gamma, kind, remarks, _yaw_error, track, planned, window)
        _try(e_x, kind, remarks, _position_error, track, planned, window)
    everyone = {"planned": planned, **present}
    length = {kind: metrics.path_length(*_within(track, *window)) for kind, track in everyone.items()}
    arcs = tuple(_radii(arc, everyone) for arc in planned_arcs(planned) if arc.t_end <= last + _LATE)
    if not arcs:
        remarks.append("radius: the plan has no circular arc")
    mean = {
        kind: float(np.mean([arc.radius[kind] for arc in arcs]))
        for kind in everyone
        if arcs and all(kind in arc.radius for arc in arcs)
    }
    return Measures(window, e_gamma, e_x, length, arcs, mean, tuple(remarks))


def _obstacle(experiment: Experiment, planned: Track | None, window: tuple[float, float] | None) -> str:
    """Return why a recording has no figures of merit, empty if it may have."""
    if len(experiment.segments) > 1:
        return f"the recording has {len(experiment.segments)} segments, whose poses have no relation to each other"
    if planned is None:
        return "errors and radii need a plan: there is no message on /planned/odom or /planned/path"
    if window is None:
        return f"errors and radii need a planned motion: {planned.channel.topic} does not move, or has no times"
    return ""


def _try(out: dict[str, float], kind: str, remarks: list[str], compute: Any, *arguments: Any) -> None:
    """Store a value, or the reason why there is none."""
    try:
        out[kind] = compute(*arguments)
    except ArtibotError as error:
        remarks.append(f"{kind}: {error}")


def _yaw_error(track: Track, planned: Track, window: tuple[float, float]) -> float:
    """Return e_gamma (eq. 31) over the window, at the track's stamps."""
    if track.yaw is None or planned.yaw is None:
        raise ArtibotError("no yaw, so eq. 31 has no value")
    rows = (track.t >= window[0]) & (track.t <= window[1])
    yaw = track.yaw + whole_turns(track.t, track.yaw, planned)
    t = track.t[rows]
    return metrics.yaw_error(yaw[rows], np.interp(t, planned.t, planned.yaw), t)


def _position_error(track: Track, planned: Track, window: tuple[float, float]) -> float:
    """Return e_x (eq. 32) at the window's end."""
    last = window[1]
    p_f, p_d = (np.array([np.interp(last, who.t, who.x), np.interp(last, who.t, who.y)]) for who in (track, planned))
    return metrics.position_error(p_f, p_d, metrics.path_length(*_within(planned, *window)))


def planned_arcs(planned: Track) -> tuple[DrivenArc, ...]:
    """Return the circular parts of a planned track: curvature steady, and at least 20 degrees turned."""
    if planned.yaw is None or not planned.timed:
        return ()
    length, turn = np.hypot(np.diff(planned.x), np.diff(planned.y)), np.diff(planned.yaw)
    moving = length > 1e-6
    curvature = np.where(moving, turn / np.where(moving, length, 1.0), 0.0)
    change = np.abs(np.diff(curvature)) > _STEADY * np.abs(curvature[1:]) + 1e-9
    bounds = np.concatenate([[0], np.flatnonzero(change) + 1, [len(curvature)]])
    arcs = []
    for first, end in zip(bounds[:-1], bounds[1:], strict=True):
        turned, bend = float(turn[first:end].sum()), curvature[first:end]
        if abs(turned) >= _LEAST_TURN and end - first > 2 and np.ptp(bend) < _STEADY * abs(bend.mean()):
            arcs.append(DrivenArc(float(planned.t[first]), float(planned.t[end]), turned, {}))
    return tuple(arcs)


def _radii(arc: DrivenArc, tracks: Mapping[str, Track]) -> DrivenArc:
    radius: dict[str, float] = {}
    for kind, track in tracks.items():
        _try(radius, kind, [], metrics.radius, *_within(track, arc.t_start, arc.t_end))
    return DrivenArc(arc.t_start, arc.t_end, arc.turn, MappingProxyType(radius))


def _within(track: Track, t_start: float, t_end: float) -> tuple[Floats, Floats]:
    """Return the points of a track between two times."""
    rows = (track.t >= t_start) & (track.t <= t_end)
    return track.x[rows], track.y[rows]


# ----------------------------------------------------------------------
# Figures of merit in the terminal, as in Table 5 of the paper, and for scripts.
# ----------------------------------------------------------------------


SCHEMA = "artibot/plot/1"
KINDS = ("planned", "odometric", "true")
NONE = "–"


def rows(measures: Measures) -> list[tuple[str, str, tuple[str, ...]]]:
    """Return the lines of a table: quantity, unit, and texts for planned, odometric and true."""
    out = [
        ("e_γ, yaw (eq. 31)", "%", _texts(measures.e_gamma, 100.0)),
        ("e_x, final position (eq. 32)", "%", _texts(measures.e_x, 100.0)),
    ]
    for number, arc in enumerate(measures.arcs, 1):
        side = "left" if arc.turn > 0 else "right"
        out.append((f"radius, arc {number} ({side})", "m", _texts(arc.radius)))
    if len(measures.arcs) > 1:
        out.append(("radius, mean", "m", _texts(measures.radius)))
    out.append(("path length", "m", _texts(measures.path_length)))
    return [row for row in out if set(row[2]) != {NONE}]


def terminal_table(names: Sequence[str], measured: Sequence[Measures]) -> Table:
    """Return a rich table of the figures of merit of some recordings, one without rows if they have none."""
    from rich.table import Table
    from rich.text import Text

    table = Table("", "", *KINDS, box=None, header_style="bold", pad_edge=False)
    for column in table.columns[2:]:
        column.justify = "right"
    for name, measures in zip(names, measured, strict=True):
        found = rows(measures)
        if found:
            table.add_row(Text(name, style="bold"))
        for what, unit, texts in found:
            table.add_row(f"  {what}", unit, *texts)
    return table


def summary(
    experiments: Sequence[Experiment], measured: Sequence[Measures], missing: Mapping[str, str]
) -> dict[str, Any]:
    """Return what the table says, as JSON takes it: SI units, null for what is absent."""
    bags = [
        {
            "name": experiment.name,
            "path": str(experiment.path),
            "metadata": dict(experiment.metadata),
            "duration": {"unit": "s", "value": experiment.duration},
            "segments": len(experiment.segments),
            "metrics": measures.as_dict(),
            "remarks": [*measures.remarks, *experiment.remarks],
        }
        for experiment, measures in zip(experiments, measured, strict=True)
    ]
    return {"schema": SCHEMA, "bags": bags, "not_drawn": dict(missing)}


def _texts(values: Mapping[str, float], factor: float = 1.0) -> tuple[str, ...]:
    return tuple(
        f"{round(factor * values[kind], 2) + 0.0:.2f}".replace("-", "−") if kind in values else NONE for kind in KINDS
    )
