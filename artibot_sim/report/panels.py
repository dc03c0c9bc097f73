"""Figure data: what is to be drawn, free of any plotting library."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from artibot_sim.report.style import Stroke, shared

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Line:
    """A curve, or a cloud of points where the stroke says so.

    Attributes
    ----------
    name : str
        Which recording, motor and kind.
    kind : str
        ``planned``, ``odometric``, ``true``, ``total station``, ``measured`` or ``commanded``.
    bag : str or None
        Label of the recording it is from; None for what several have in common.
    x, y : (n,) arrays
        In the panel's units. A row of NaN separates pieces that nothing joins.
    stroke : Stroke
    side : str
        ``right`` or ``left`` where a panel has both motors, else empty.
    """

    name: str
    kind: str
    bag: str | None
    x: Floats
    y: Floats
    stroke: Stroke
    side: str = ""


@dataclass(frozen=True)
class LegendEntry:
    """An entry of a legend, for one line or for all lines of a kind.

    Attributes
    ----------
    name : str
    kind : str
        As in :class:`Line`.
    side : str
        Of the motor, where lines of a kind differ in it.
    stroke : Stroke
    """

    name: str
    kind: str
    side: str
    stroke: Stroke


@dataclass(frozen=True)
class Level:
    """A horizontal line across a panel, at `value` in the panel's unit; nameless ones have no legend entry."""

    name: str
    value: float
    stroke: Stroke


@dataclass(frozen=True, eq=False)
class Arrows:
    """Marks of direction: positions x, y (n,) in m and headings (n,) in rad, 0 along x, positive to the left."""

    x: Floats
    y: Floats
    heading: Floats
    stroke: Stroke


@dataclass(frozen=True, eq=False)
class Outline:
    """A rover at an instant, in the panel's coordinates (m).

    Attributes
    ----------
    t : float
        When, s.
    bodies, wheels : tuples of (k, 2) arrays
        Closed polygons.
    """

    t: float
    bodies: tuple[Floats, ...]
    wheels: tuple[Floats, ...]


@dataclass(frozen=True, eq=False)
class Panel:
    """One set of axes.

    Attributes
    ----------
    key : str
        Stable name: ``path``, ``yaw``, ``velocity_front``, …
    title : str
    x, y : (quantity, unit)
    lines : tuple of Line
        In drawing order.
    equal : bool
        One metre is as long along x as along y.
    part : str
        Which part of a page it stands in; empty for the charts that every page begins with.
    names : tuple of str
        Of the places 1, 2, … from the top down along y, where these are no numbers.
    """

    key: str
    title: str
    x: tuple[str, str]
    y: tuple[str, str]
    lines: tuple[Line, ...]
    levels: tuple[Level, ...] = ()
    arrows: tuple[Arrows, ...] = ()
    outlines: tuple[Outline, ...] = ()
    starts: Floats = field(default_factory=lambda: np.empty((0, 2)))
    equal: bool = False
    part: str = ""
    names: tuple[str, ...] = ()

    @property
    def timed(self) -> bool:
        """Whether it is over time: such panels share their axis."""
        return self.x == ("time", "s")

    @property
    def legend(self) -> tuple[LegendEntry, ...]:
        """What the strokes mean.

        What was measured has an entry a line, or none where the figure's key tells recordings apart; what was
        planned, believed or commanded has one for all its lines, in no one's hue where there are several.
        """
        entries = []
        for kind in dict.fromkeys(line.kind for line in self.lines):
            lines = [line for line in self.lines if line.kind == kind]
            if kind in ("true", "measured"):
                entries += [
                    LegendEntry(line.side or kind, kind, line.side, line.stroke) for line in lines if not line.bag
                ]
            else:
                alone = len({(line.bag, line.stroke) for line in lines}) == 1 and not lines[0].bag
                stroke = lines[0].stroke if alone else shared(lines[0].stroke)
                entries.append(LegendEntry(kind, kind, "", stroke))
        return tuple(replace(entry, stroke=entry.stroke._replace(opacity=1.0)) for entry in entries)

    @property
    def x_label(self) -> str:
        """Quantity and unit, as written under the axis."""
        return f"{self.x[0]} ({self.x[1]})"

    @property
    def y_label(self) -> str:
        """Quantity and unit, as written beside the axis; empty where names are."""
        return "" if self.names else f"{self.y[0]} ({self.y[1]})"


@dataclass(frozen=True, eq=False)
class Figure:
    """Everything of one picture or page.

    Attributes
    ----------
    title, subtitle : str
        What, and when, which robot, which kappa.
    panels : tuple of Panel
        In reading order; those without anything to draw are absent.
    missing : mapping of str to str
        What could not be drawn → why.
    key : tuple of (label, colour)
        Whose hue is whose, where there are several recordings.
    """

    title: str
    subtitle: str
    panels: tuple[Panel, ...]
    missing: Mapping[str, str] = field(default_factory=dict)
    key: tuple[tuple[str, str], ...] = ()

    @property
    def time_span(self) -> tuple[float, float]:
        """First and last time of all panels over time, s: they share their axis."""
        return extent([line.x for panel in self.panels if panel.timed for line in panel.lines])

    def __getitem__(self, key: str) -> Panel:
        """The panel with this key; KeyError if it is absent."""
        for panel in self.panels:
            if panel.key == key:
                return panel
        raise KeyError(key)

    def __contains__(self, key: str) -> bool:
        return any(panel.key == key for panel in self.panels)


ROUNDING = 1e-9
"""Span over the larger of 1 and what is drawn, up to which a curve is one number and its shape is rounding."""


def constant_range(low: float, high: float) -> tuple[float, float] | None:
    """Return the range of an axis along which all that is drawn is one number but for rounding; None of any other."""
    size = max(1.0, abs(low), abs(high))
    return (low - 0.05 * size, high + 0.05 * size) if 0.0 < high - low <= ROUNDING * size else None


def extent(values: Sequence[Floats]) -> tuple[float, float]:
    """Return the least and greatest finite value of several arrays (0, 0 where there is none)."""
    finite = [column[np.isfinite(column)] for column in values]
    joined = np.concatenate(finite) if finite else np.empty(0)
    return (float(joined.min()), float(joined.max())) if len(joined) else (0.0, 0.0)
