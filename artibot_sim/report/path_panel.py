"""The path from above: planned, believed and true, with the rover on it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment import Experiment
from artibot_sim.experiment.resimulate import ground_of
from artibot_sim.report import style
from artibot_sim.report.panels import Arrows, Floats, Line, Outline, Panel, extent
from artibot_sim.report.paths import KINDS, TOPICS, Track, broken, find_track, find_truth, outline, size
from artibot_sim.report.time_panels import CROWD, DrawnRecording, merged

_ARROWS = 7
_OUTLINES = 6
_APART = 2.5
"""Least distance along the path between drawn rovers, in rover lengths."""
_SAME_PLACE = 0.01
"""Starts closer than this (m) are one."""
_CONTOURS = 8
"""Lines of equal height at most."""
_GRID = 160
"""Points along the longer side of the picture at which heights are taken."""


def path_panel(sources: Sequence[DrawnRecording]) -> tuple[Panel | None, dict[str, str]]:
    """Return the panel of the paths, None where no recording has any, and what is missing → why."""
    lines: list[Line] = []
    missing: dict[str, str] = {}
    for kind in KINDS:
        found = [(source, find_track(source.experiment, kind, drawn=True)) for source in sources]
        lines += [_line(source, track) for source, track in found if track is not None]
        if kind != "total station" and all(track is None for _, track in found):
            missing[f"{kind} path"] = f"no position on {TOPICS[kind]}"
    if "true path" in missing and any(line.kind == "total station" for line in lines):
        missing["true pose"] = f"no position on {TOPICS['true']}; the total station's points stand in"
        del missing["true path"]
    if not lines:
        return None, missing
    contours, why = _contours(sources, lines)
    if why:
        missing["ground"] = why
    outlines, why = _outlines(sources)
    if why:
        missing["rover outline"] = why
    panel = Panel(
        "path", "Path of the front module", ("x", "m"), ("y", "m"), (*contours, *merged(lines)),
        arrows=tuple(filter(None, map(_arrows, sources))), outlines=outlines, starts=_starts(sources), equal=True,
    )  # fmt: skip
    return panel, missing


def _line(source: DrawnRecording, track: Track) -> Line:
    stroke = style.track_stroke(track.kind, source.number)
    if len(source.experiment.segments) > CROWD:
        stroke = style.crowded(stroke)
    x, y = (track.x, track.y) if stroke.dash == "points" else broken(track.piece, track.x, track.y)
    return Line(source.named(track.kind), track.kind, source.bag, x, y, stroke)


def _contours(sources: Sequence[DrawnRecording], lines: Sequence[Line]) -> tuple[list[Line], str]:
    """Lines of equal height of the ground that the first recording which knows any was driven over; or why none."""
    experiment = next((source.experiment for source in sources if source.experiment.metadata.get("ground")), None)
    if experiment is None:
        return [], ""
    try:
        ground = ground_of(experiment)
    except ArtibotError as error:
        return [], str(error)
    assert ground is not None
    from contourpy import contour_generator  # matplotlib's own

    spans = [extent([getattr(line, axis) for line in lines]) for axis in "xy"]
    margin = 0.1 * max(high - low for low, high in spans) + 0.5
    longest = max(high - low for low, high in spans) + 2 * margin
    x, y = (np.linspace(low - margin, high + margin, 2 + int(_GRID * (high - low + 2 * margin) / longest))
            for low, high in spans)  # fmt: skip
    height = ground.heights(*np.meshgrid(x, y))
    low, high = np.nanmin(height), np.nanmax(height)
    step = _round_step((high - low) / _CONTOURS)
    if not step > 0:
        return [], "" if high == low else "its raster does not reach the path"
    generator = contour_generator(x, y, np.ma.masked_invalid(height))
    found = []
    for level in step * np.arange(math.ceil(low / step), math.floor(high / step) + 1):
        pieces = [np.vstack([np.asarray(piece, float), [[np.nan, np.nan]]]) for piece in generator.lines(level)]
        if pieces:
            joined = np.concatenate(pieces)[:-1]
            name, kind = f"ground at {level:.4g} m", f"ground, every {step:g} m"
            found.append(Line(name, kind, None, joined[:, 0], joined[:, 1], style.GROUND))
    return found, ""


def _round_step(least: float) -> float:
    """The smallest of 1, 2 and 5 times a power of ten that is at least `least`."""
    if not least > 0:
        return 0.0
    power = 10.0 ** math.floor(math.log10(least))
    return next(times * power for times in (1.0, 2.0, 5.0, 10.0) if times * power >= least * (1 - 1e-9))


def main_track(experiment: Experiment) -> Track | None:
    """Return the track that says best where the rover was: the true one, else what there is."""
    return find_truth(experiment) or find_track(experiment, "odometric") or find_track(experiment, "planned")


def _starts(sources: Sequence[DrawnRecording]) -> Floats:
    """Return where the rovers start, (n, 2) in m, each place once."""
    places: list[Floats] = []
    for track in filter(None, (main_track(source.experiment) for source in sources)):
        first = np.flatnonzero(np.concatenate([[True], np.diff(track.piece) > 0]))
        for point in np.column_stack([track.x[first], track.y[first]]):
            if all(np.hypot(*(point - other)) > _SAME_PLACE for other in places):
                places.append(point)
    return np.array(places).reshape(-1, 2) if len(places) <= CROWD else np.empty((0, 2))


def _travelled(track: Track) -> Floats:
    """Return the length of the path so far (n,), m; jumps between pieces have none."""
    step = np.hypot(np.diff(track.x), np.diff(track.y))
    return np.concatenate([[0.0], np.cumsum(np.where(np.diff(track.piece) == 0, step, 0.0))])


def _arrows(source: DrawnRecording) -> Arrows | None:
    """Return marks of direction at even distances along the path, away from the ends of its pieces."""
    track = main_track(source.experiment)
    if track is None or track.piece[-1] - track.piece[0] >= CROWD:
        return None
    along = _travelled(track)
    across = np.hypot(np.ptp(track.x), np.ptp(track.y))
    wanted = along[-1] * (np.arange(_ARROWS) + 0.5) / _ARROWS
    rows = []
    for s in wanted:  # the chord over a hundredth of the picture has a direction even where samples are noisy
        a, b = np.searchsorted(along, [s - 0.01 * across, s + 0.01 * across])
        b = min(b, len(along) - 1)
        if across > 0 and track.piece[a] == track.piece[b] and along[b] > along[a]:
            rows.append((a, b))
    if not rows:
        return None
    a, b = np.array(rows).T
    heading = np.arctan2(track.y[b] - track.y[a], track.x[b] - track.x[a])
    middle = (a + b) // 2
    stroke = style.track_stroke(track.kind, source.number)._replace(dash="solid")
    return Arrows(track.x[middle], track.y[middle], heading, stroke)


def _outlines(sources: Sequence[DrawnRecording]) -> tuple[tuple[Outline, ...], str]:
    """Return the rover of the first recording that has its pose, at some instants; else why there is none."""
    why = ""
    for source in sources:
        track = main_track(source.experiment)
        if track is None or track.yaw is None or not track.timed:
            why = why or "no yaw beside the position"
        elif source.robot is None:
            why = "the robot is not known; name it with --robot"
        else:
            return tuple(_rovers(source, track)), ""
    return (), why


def _rovers(source: DrawnRecording, track: Track) -> list[Outline]:
    """Return the rover at even distances along the first piece of its path."""
    robot = source.robot
    assert robot is not None and track.yaw is not None
    rows = np.flatnonzero(track.piece == track.piece[0])
    along = _travelled(track)[rows]
    count = 1
    if track.piece[-1] - track.piece[0] < CROWD:
        count = int(np.clip(along[-1] / (_APART * size(robot)) + 1, 1, _OUTLINES))
    chosen = [int(np.searchsorted(along, s)) for s in np.linspace(0.0, along[-1], count)]
    t = track.t[rows[np.minimum(chosen, len(rows) - 1)]]
    if count > 1:
        t[0], t[-1] = track.t[rows[0]], track.t[rows[-1]]
    x, y, yaw = (np.interp(t, track.t, column) for column in (track.x, track.y, track.yaw))
    joints = robot.articulation_joints[::2]
    bends = [_articulation_at(source.experiment, t, joint) for joint in joints]
    return [outline(robot, x[i], y[i], yaw[i], [bend[i] for bend in bends], float(t[i])) for i in range(len(t))]


def _articulation_at(experiment: Experiment, t: Floats, joint: str) -> Floats:
    """Return the angle of an articulation joint at times t (n,), rad; NaN where it was not measured."""
    channel = experiment.channels.get("joint_states")
    if channel is None or f"{joint}.position" not in channel:
        return np.full(len(t), np.nan)
    times, angle = channel.series(f"{joint}.position")
    inside = (t >= times[0] - 0.5) & (t <= times[-1] + 0.5)
    return np.where(inside, np.interp(t, times, angle), np.nan)
