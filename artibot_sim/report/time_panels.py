"""Quantities over time as panels: yaw, speed, motors, articulation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from artibot_sim.experiment import Channel, Experiment
from artibot_sim.report import style
from artibot_sim.report.panels import Floats, Level, Line, Panel, extent
from artibot_sim.report.paths import TOPICS, broken, find_track, pieces, whole_turns

if TYPE_CHECKING:
    from artibot_sim.model import Robot

TIME = ("time", "s")
CROWD = 12
"""From this many segments on their lines are drawn finer."""
_LEVEL_IN_SIGHT = 4.0
"""A limit is drawn if it is below this many times what was reached: else it would flatten the curves."""
_ALIKE = 2e-3
_COMMON = 0.8
"""Curves sampled differently are compared where both are; that must be this much of the longer one."""


@dataclass(frozen=True)
class DrawnRecording:
    """A recording as it is drawn.

    Attributes
    ----------
    experiment : Experiment
    label : str
        Its name in legends.
    number : int or None
        Its place among several; None where it is alone.
    robot : Robot or None
        Whose sizes and limits hold; None if unknown.
    zero : float
        What to subtract from its times, s.
    """

    experiment: Experiment
    label: str
    number: int | None = None
    robot: Robot | None = None
    zero: float = 0.0

    @property
    def bag(self) -> str | None:
        """Label of the recording in a line that is its own; None where there is only one."""
        return None if self.number is None else self.label

    def named(self, name: str) -> str:
        """What a legend says."""
        return name if self.number is None else f"{self.label}, {name}"


def time_panels(sources: Sequence[DrawnRecording]) -> tuple[list[Panel], dict[str, str]]:
    """Return the panels over time that have anything to draw, and what is missing → why."""
    found: list[Panel] = []
    missing: dict[str, str] = {}
    makers: list[Callable[[Sequence[DrawnRecording]], Made]] = [_yaw, _speed, *_motor_panels(sources), _articulation]
    for make in makers:
        panel, why = make(sources)
        if panel is not None:
            found.append(panel)
        elif why:
            missing[why[0]] = why[1]
    return found, missing


Made = tuple[Panel | None, tuple[str, str] | None]


def _yaw(sources: Sequence[DrawnRecording]) -> Made:
    lines = []
    for source in sources:
        planned = find_track(source.experiment, "planned")
        for kind, channel in _track_channels(source.experiment):
            for line in _lines(source, channel, "yaw", kind, style.track_stroke(kind, source.number)):
                t, yaw = channel.series("yaw")
                lines.append(replace(line, y=line.y + whole_turns(t, yaw, planned)))
    return _panel("yaw", "Yaw of the front module", ("yaw", "rad"), lines), (
        "yaw", f"no orientation on {TOPICS['true']}, {TOPICS['odometric']} or /planned/odom")  # fmt: skip


def _speed(sources: Sequence[DrawnRecording]) -> Made:
    lines = []
    for source in sources:
        for kind, channel in _track_channels(source.experiment):
            lines += _lines(source, channel, "vx", kind, style.track_stroke(kind, source.number))
    return _panel("speed", "Forward speed of the front module", ("speed", "m/s"), lines), (
        "speed", f"no twist on {TOPICS['true']}, {TOPICS['odometric']} or /planned/odom")  # fmt: skip


def _track_channels(experiment: Experiment) -> list[tuple[str, Channel]]:
    """Return the odometry channels there are, the planned one first so that it lies below."""
    keys = (("planned", "planned_odom"), ("odometric", "odom"), ("true", "ground_truth_odom"))
    return [(kind, experiment.channels[key]) for kind, key in keys if key in experiment.channels]


def _motor_panels(sources: Sequence[DrawnRecording]) -> list[_Motors]:
    """Return what makes the motors' panels: two sides in one, or one panel a motor where recordings are compared."""
    alone = len(sources) == 1
    wanted = [("velocity", "front"), ("effort", "front"), ("effort", "back")]
    sides = [("right", "left")] if alone else [("right",), ("left",)]
    return [_Motors(quantity, end, chosen) for quantity, end in wanted for chosen in sides]


@dataclass(frozen=True)
class _Motors:
    """Makes the panel of one quantity of one module's motors."""

    quantity: str
    end: str
    sides: tuple[str, ...]

    def __call__(self, sources: Sequence[DrawnRecording]) -> Made:
        lines = []
        for kind, key in (("measured", "motor_torques"), ("commanded", "motor_command")):
            for source in sources:
                channel = source.experiment.channels.get(key)
                for side in self.sides if channel is not None else ():
                    stroke = style.motor_stroke(kind, side, source.number)
                    lines += _lines(
                        source, channel, f"{self.end}_{side}.{self.quantity}", kind, stroke, self._side(side)
                    )
        word = "torque" if self.quantity == "effort" else self.quantity
        one = f" {self.sides[0]}" if len(self.sides) == 1 else ""
        key = f"{word}_{self.end}{one.replace(' ', '_')}"
        title = f"{self.end.capitalize()}{one} motor{'' if one else 's'}, {word}"
        unit = ("torque", "N·m") if word == "torque" else ("velocity", "rad/s")
        panel = _panel(key, title, unit, lines)
        if panel is not None and word == "torque":
            panel = replace(panel, levels=self._limits(sources, panel))
        return panel, self._missing(sources, word)

    def _side(self, side: str) -> str:
        return side if len(self.sides) > 1 else ""

    def _missing(self, sources: Sequence[DrawnRecording], word: str) -> tuple[str, str] | None:
        robots = [source.robot for source in sources]
        if self.end == "back" and all(robot is not None and not robot.articulated for robot in robots):
            return None  # there are no back motors to be missed
        what = f"{self.end} {'right and left' if len(self.sides) > 1 else self.sides[0]} motor {word}"
        return what.replace(" right and left", ""), f"no {self.quantity} on /motor_torques or /motor_command"

    def _limits(self, sources: Sequence[DrawnRecording], panel: Panel) -> tuple[Level, ...]:
        """Return ±torque_max where all robots agree on one that is not far beyond what was reached."""
        found = set()
        for source in sources:
            drive = source.robot and (source.robot.drive_front if self.end == "front" else source.robot.drive_back)
            found.add(drive.torque_max if drive else np.inf)
        limit = found.pop() if len(found) == 1 else np.inf
        low, high = extent([line.y for line in panel.lines])
        near = [sign for sign, peak in ((1, high), (-1, -low)) if _LEVEL_IN_SIGHT * peak > limit]
        name = f"limit ±{limit:g} N·m"
        return tuple(Level(name if i == 0 else "", sign * limit, style.LIMIT) for i, sign in enumerate(near))


def _articulation(sources: Sequence[DrawnRecording]) -> Made:
    lines = []
    for source in sources:
        channel = source.experiment.channels.get("joint_states")
        if channel is not None:
            stroke = style.track_stroke("true", source.number)
            lines += _lines(source, channel, "articulation_yaw.position", "measured", stroke)
    rigid = all(source.robot is not None and not source.robot.articulated for source in sources)
    panel = _panel("articulation", "Articulation angle, back minus front yaw", ("angle", "rad"), lines)
    return panel, None if rigid else ("articulation angle", "no articulation_yaw on /joint_states")


def _lines(
    source: DrawnRecording, channel: Channel | None, column: str, kind: str, stroke: style.Stroke, side: str = ""
) -> list[Line]:
    """Return a column over time as a line, none where it was not measured."""
    if channel is None or column not in channel:
        return []
    t, values = channel.series(column)
    if not len(t):
        return []
    piece = pieces(t, source.experiment.segments)
    t, values = broken(piece, t - source.zero, values)
    if len(source.experiment.segments) > CROWD:
        stroke = style.crowded(stroke)
    name = source.named(f"{side}, {kind}" if side else kind)
    return [Line(name, kind, source.bag, t, values, stroke, side)]


def _panel(key: str, title: str, y: tuple[str, str], lines: list[Line]) -> Panel | None:
    return Panel(key, title, TIME, y, tuple(merged(lines))) if lines else None


def merged(lines: Sequence[Line]) -> list[Line]:
    """Return the lines with what all recordings were given alike (a plan, a command) drawn once, in no one's hue."""
    out: list[Line] = []
    for kind in dict.fromkeys(line.kind for line in lines):
        alike = [line for line in lines if line.kind == kind]
        if kind in ("planned", "commanded") and len(alike) > 1 and alike[0].bag and _equal(alike):
            alike = [replace(alike[0], name=kind, bag=None, stroke=style.shared(alike[0].stroke))]
        out += alike
    return out


def _equal(lines: Sequence[Line]) -> bool:
    """Whether curves coincide where they overlap, to a fraction of their range that no one sees."""
    first = lines[0]
    return len({line.bag for line in lines}) == len(lines) and all(_close(first, line) for line in lines[1:])


def _close(a: Line, b: Line) -> bool:
    if a.x.shape == b.x.shape and _same(a.x, b.x) and _same(a.y, b.y):
        return True
    first, last = max(a.x[0], b.x[0]), min(a.x[-1], b.x[-1])
    long_enough = last - first > _COMMON * max(a.x[-1] - a.x[0], b.x[-1] - b.x[0])
    if not long_enough or not all((np.diff(line.x) > 0).all() for line in (a, b)):
        return False
    inside = (a.x >= first) & (a.x <= last)
    return _same(a.y[inside], np.interp(a.x[inside], b.x, b.y))


def _same(p: Floats, q: Floats) -> bool:
    low, high = extent([p])
    return bool(np.allclose(p, q, rtol=0.0, atol=_ALIKE * (high - low) + 1e-9, equal_nan=True))
