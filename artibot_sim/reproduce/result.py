"""What a section's reproduction gives: comparisons, statements and figure data, free of any way to show them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from artibot_sim.report import style
from artibot_sim.report.panels import Level, Line, Panel

# ----------------------------------------------------------------------
# What a section's reproduction gives: comparisons, statements and figure data, free of any way to show them.
# ----------------------------------------------------------------------


CALIBRATED = "calibration"
"""The number was fitted to the very one it is compared with."""
PREDICTED = "prediction"
"""It was not."""
TAKEN = "input"
"""The robot file holds the printed number itself, or says why it does not."""
_NAMES = {TAKEN: "input", CALIBRATED: "calibrated", PREDICTED: "predicted"}
_ASSUMPTION = {TAKEN: "taken from it", CALIBRATED: "fitted to the printed number"}


@dataclass(frozen=True)
class PaperComparison:
    """One number of the paper and ours.

    Attributes
    ----------
    what : str
    unit : str
        The numbers are in it; empty where they have none.
    place : str
        Where the paper prints it.
    paper, ours : float
    within : float
        Largest difference that counts as agreement: of percentages in points, else relative to the paper's number.
    basis : str
        ``input``, ``calibration`` or ``prediction``.
    assumes : str
        What the paper leaves open and had to be taken.
    """

    what: str
    unit: str
    place: str
    paper: float
    ours: float
    within: float
    basis: str
    assumes: str = ""

    @property
    def difference(self) -> float:
        """Ours less the paper's: points for percentages, else a fraction of the paper's."""
        return self.ours - self.paper if self.unit == "%" else self.ours / self.paper - 1.0

    @property
    def agrees(self) -> bool:
        """Whether the difference is within what is allowed."""
        return bool(abs(self.difference) <= self.within)

    def text(self, value: float) -> str:
        """A number of this quantity as written, with its unit."""
        number = f"{value:.2f}" if self.unit in ("%", "m") and self.basis != TAKEN else f"{value:.6g}"
        return f"{number} {self.unit}".strip().replace("-", "−")

    @property
    def difference_text(self) -> str:
        """The difference as written."""
        if self.unit == "%":
            return f"{self.difference:+.2f} points".replace("-", "−")
        return f"{round(100 * self.difference, 1) + 0.0:+.1f} %".replace("-", "−")

    @property
    def within_text(self) -> str:
        """The allowed difference as written."""
        return f"{self.within:.3g} points" if self.unit == "%" else f"{100 * self.within:.2g} %"


@dataclass(frozen=True)
class Statement:
    """A sentence of the paper, or about it, and whether our numbers bear it out.

    Attributes
    ----------
    claim : str
    holds : bool
        Computed, as is every number in `evidence`.
    evidence : str
    place : str
        Where the paper says or shows it; empty for what is not in the paper.
    """

    claim: str
    holds: bool
    evidence: str
    place: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "holds", bool(self.holds))  # NumPy's are no JSON


@dataclass(frozen=True)
class TextTable:
    """Lines of texts under headings."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""


@dataclass(frozen=True, eq=False)
class HeatMap:
    """A quantity over two others, with the curve where it vanishes.

    Attributes
    ----------
    x, y : (m,), (n,) arrays
    z : (n, m) array
    zero : tuple of (x, y) arrays
    marks : tuple of (x, text)
        Vertical lines.
    scale : float
        The colours reach from −scale to scale.
    """

    title: str
    x_label: str
    y_label: str
    unit: str
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    z: NDArray[np.float64]
    zero: tuple[tuple[NDArray[np.float64], NDArray[np.float64]], ...]
    marks: tuple[tuple[float, str], ...]
    scale: float


@dataclass(frozen=True, eq=False)
class Sheet:
    """Rows of charts that belong together: one picture."""

    key: str
    title: str
    caption: str
    rows: tuple[tuple[Panel | HeatMap, ...], ...]
    heights: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class Section:
    """A section of the paper, reproduced."""

    number: int
    title: str
    sheets: tuple[Sheet, ...]
    tables: tuple[TextTable, ...]
    comparisons: tuple[PaperComparison, ...]
    statements: tuple[Statement, ...]
    notes: tuple[str, ...] = field(default=())
    short: tuple[str, ...] = field(default=())
    """What agrees, what does not and why, in a few sentences."""

    @property
    def verdict(self) -> str:
        """How much of it agrees, in a sentence."""
        parts = []
        for basis, name in _NAMES.items():
            of_it = [c for c in self.comparisons if c.basis == basis]
            if of_it:
                parts.append(f"{sum(c.agrees for c in of_it)} of {len(of_it)} {name} numbers agree")
        if self.statements:
            parts.append(f"{sum(s.holds for s in self.statements)} of {len(self.statements)} statements hold")
        return "; ".join(parts) + "."


def percent(value: float, digits: int = 2) -> str:
    """A fraction as percent, with a true minus sign."""
    return f"{100 * value:.{digits}f} %".replace("-", "−")


def comparison_table(title: str, comparisons: Sequence[PaperComparison], note: str = "") -> TextTable:
    """The comparisons as a table."""
    columns = ("quantity", "paper", "artibot", "difference", "allowed", "agrees", "basis", "place in the paper")
    rows = tuple(
        (
            c.what, c.text(c.paper), c.text(c.ours), c.difference_text,
            c.within_text, "yes" if c.agrees else "no", c.basis, c.place,
        )
        for c in comparisons
    )  # fmt: skip
    return TextTable(title, columns, rows, note)


def the_paper(sections: Sequence[Section]) -> TextTable:
    """Every number and statement of the paper beside the model's, by figure and table, with what each assumes."""
    rows: list[tuple[str, ...]] = []
    for section in sections:
        for c in section.comparisons:
            assumes = "; ".join(part for part in (c.assumes, _ASSUMPTION.get(c.basis, "")) if part)
            rows.append((c.place, c.what, c.text(c.paper), c.text(c.ours), c.difference_text, assumes))
        for s in section.statements:
            if s.place:
                rows.append((s.place, s.claim, "holds", "holds" if s.holds else "does not hold", "", ""))
    rows.sort(key=lambda row: [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", row[0])])
    note = (
        "Differences are artibot's less the paper's, with their sign: points of percentages, else percent. Figs 1 to "
        "5, 7 and 8 are sketches, photographs and a flow chart: they print nothing to compare. Table 1 is lost."
    )
    return TextTable(
        "The paper", ("place in the paper", "quantity", "paper", "artibot", "difference", "assumes"), tuple(rows), note
    )


def count(comparisons: Sequence[PaperComparison]) -> str:
    """How many of the comparisons agree, in words."""
    return f"{sum(c.agrees for c in comparisons)} of {len(comparisons)}"


def worst(comparisons: Sequence[PaperComparison]) -> str:
    """How far the worst comparison is off, in words."""
    return f"(at most {max(abs(c.difference) for c in comparisons):.2f} points off)"


# ----------------------------------------------------------------------
# Panels of the sections' figures: curves with a legend entry each.
# ----------------------------------------------------------------------


Array = NDArray[np.float64]

PLANNED = style.Stroke(style.MUTED, 1.5, "dash")
ODOMETRIC = style.Stroke(style.ODOMETRIC, 1.5, "dot")
SIMULATED = style.Stroke(style.TRUE, 1.9)
MEASURED = style.Stroke(style.INK, 1.3, "dot")
DRIVEN = style.Stroke(style.POINTS, 1.7)
TIME = ("time", "s")
BY_KAPPA = dict(zip((0.6, 0.8, 1.0), ("#0072b2", "#d55e00", "#44aa99"), strict=True))
"""One hue a kappa."""


def curve(name: str, x: Array, y: Array, stroke: style.Stroke) -> Line:
    """A curve with its own entry in the legend."""
    return Line(name, name, None, np.asarray(x, float), np.asarray(y, float), stroke)


def over_kappa(kappa: float, x: Array, y: Array) -> Line:
    """A curve of one kappa, in its hue."""
    near = min(BY_KAPPA, key=lambda known: abs(known - kappa))
    return curve(f"κ = {kappa:g}", x, y, style.Stroke(BY_KAPPA[near], 1.5))


def level(name: str, value: float, colour: str = style.INK) -> Level:
    """A horizontal line: what the paper prints."""
    return Level(name, value, style.Stroke(colour, 1.2, "dot"))


def panel(
    key: str, title: str, x: tuple[str, str], y: tuple[str, str], lines: Sequence[Line], levels: Sequence[Level] = ()
) -> Panel:  # fmt: skip
    """A chart; positions (x and y in m) have equal axes."""
    return Panel(key, title, x, y, tuple(lines), tuple(levels), equal=x == ("x", "m"))


def without_peaks(lines: Sequence[Line], room: float = 1.6) -> tuple[list[Line], float]:
    """Curves without their short peaks, which would flatten all else, and the largest value that was there.

    What exceeds `room` times the 98 % quantile of the magnitudes is left out.
    """
    sizes = np.concatenate([np.abs(line.y[np.isfinite(line.y)]) for line in lines])
    most = room * float(np.quantile(sizes, 0.98))
    cut = [
        Line(line.name, line.kind, line.bag, line.x, np.where(np.abs(line.y) > most, np.nan, line.y), line.stroke)
        for line in lines
    ]
    return cut, float(sizes.max())
