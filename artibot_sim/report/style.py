"""One look for every picture and page: colours, strokes, type.

The hues are distinguished with any of the common colour vision deficiencies; dashes say the same once more, so that
prints in grey remain readable. Planned and commanded are dashed, believed (odometric) is dotted, what was measured
is solid.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

INK: Final = "#1f2933"
MUTED: Final = "#59636e"
GRID: Final = "#e6e9ed"
PAPER: Final = "#ffffff"
BODY: Final = "#cdd5dd"
"""Fill of a rover's modules."""
WHEEL: Final = "#46525e"

TRUE: Final = "#0072b2"
ODOMETRIC: Final = "#d55e00"
POINTS: Final = "#44aa99"
"""Single measured positions (total station)."""
RIGHT: Final = "#5b4b9a"
LEFT: Final = "#c98a00"
BAGS: Final = ("#0072b2", "#d55e00", "#44aa99", "#e6b422", "#6b2d73")
"""One hue a recording, where several are drawn together."""

VEIL: Final = "rgba(255,255,255,0.75)"
"""Behind labels that stand on a picture."""
FAINT: Final = "#dfe5ea"
"""Where a map of errors has none."""

DARK: Final = {
    INK: "#e3e8ed", MUTED: "#a3afbb", GRID: "#2d363f", PAPER: "#12171c", BODY: "#3a444f", WHEEL: "#8e9aa6",
    TRUE: "#5883ff", ODOMETRIC: "#f65e3e", POINTS: "#44ad7f", RIGHT: "#a795f0", LEFT: "#e3ab2c", "#6b2d73": "#d1a9d2",
    VEIL: "rgba(18,23,28,0.75)", FAINT: "#27303a", "#440154": "#9a6cc0", "#482173": "#8b78cc", "#433e85": "#7a8ad6",
    "#38588c": "#669fd9",
}  # fmt: skip
"""Colour on paper → on a dark screen. What is not here does for both."""

PNG_FONTS: Final = ("DejaVu Sans",)
"""Comes with matplotlib, so a picture looks the same everywhere."""
WEB_FONTS: Final = "system-ui, -apple-system, 'Segoe UI', Roboto, 'Noto Sans', 'DejaVu Sans', Arial, sans-serif"


class Stroke(NamedTuple):
    """How a line is drawn.

    Attributes
    ----------
    colour : str
        As ``#rrggbb``.
    width : float
        In points.
    dash : str
        ``solid``, ``dash``, ``dot``, or ``points`` for single points that no line joins.
    opacity : float
        From 0 to 1.
    """

    colour: str
    width: float = 1.6
    dash: str = "solid"
    opacity: float = 1.0


_TRACKS: Final = {
    "planned": Stroke(MUTED, 1.5, "dash"),
    "odometric": Stroke(ODOMETRIC, 1.5, "dot"),
    "true": Stroke(TRUE, 1.9),
    "total station": Stroke(POINTS, 3.0, "points"),
}
GROUND: Final = Stroke("#b08d57", 0.7, "solid", 0.8)
"""Lines of equal height."""
_SIDES: Final = {"right": RIGHT, "left": LEFT}
LIMIT: Final = Stroke(INK, 1.0, "dot", 0.8)
"""A bound that a quantity may reach."""


def track_stroke(kind: str, bag: int | None) -> Stroke:
    """Stroke of where a rover was.

    Parameters
    ----------
    kind : {"planned", "odometric", "true", "total station"}
    bag : int or None
        Number of the recording where several are drawn together; None where there is one, or for what they share.
    """
    stroke = _TRACKS[kind]
    return stroke if bag is None else stroke._replace(colour=BAGS[bag])


def motor_stroke(kind: str, side: str, bag: int | None) -> Stroke:
    """Stroke of a motor's quantity.

    Parameters
    ----------
    kind : {"measured", "commanded"}
    side : {"right", "left"}
    bag : int or None
        As in :func:`track_stroke`.
    """
    colour = _SIDES[side] if bag is None else BAGS[bag]
    return Stroke(colour, 1.2) if kind == "measured" else Stroke(colour, 1.2, "dash")


def shared(stroke: Stroke) -> Stroke:
    """The stroke of what several recordings have in common: no recording's hue."""
    return stroke._replace(colour=MUTED)


def crowded(stroke: Stroke) -> Stroke:
    """The stroke where very many short pieces lie on each other."""
    return stroke._replace(width=max(0.7, 0.5 * stroke.width), opacity=0.55)


def matplotlib_style() -> Any:
    """Settings for ``matplotlib.rc_context``."""
    return {
        "font.family": list(PNG_FONTS), "font.size": 9.5, "text.color": INK, "mathtext.default": "regular",
        "axes.edgecolor": "#9aa5b1", "axes.labelcolor": INK, "axes.labelsize": 9.5, "axes.linewidth": 0.8,
        "axes.titlesize": 10.5, "axes.titleweight": "bold", "axes.titlelocation": "left", "axes.titlecolor": INK,
        "axes.spines.top": False, "axes.spines.right": False, "axes.axisbelow": True, "axes.facecolor": PAPER,
        "axes.grid": True, "grid.color": GRID, "grid.linewidth": 0.8, "axes.unicode_minus": True,
        "axes.xmargin": 0.02, "axes.ymargin": 0.07, "axes.formatter.useoffset": False,
        "xtick.color": MUTED, "ytick.color": MUTED, "xtick.labelsize": 9, "ytick.labelsize": 9,
        "xtick.major.size": 3.0, "ytick.major.size": 0.0, "xtick.major.width": 0.8,
        "legend.fontsize": 9, "legend.frameon": False, "legend.handlelength": 2.1, "legend.borderaxespad": 0.0,
        "figure.facecolor": PAPER, "savefig.facecolor": PAPER, "lines.solid_capstyle": "round", "agg.path.chunksize": 0,
    }  # fmt: skip


DASHES: Final = {"solid": "-", "dash": (0, (4.5, 2.2)), "dot": (0, (1.1, 1.5)), "points": "none"}
"""Dash → matplotlib's line style."""
WEB_DASHES: Final = {"solid": "solid", "dash": "7px,4px", "dot": "2px,3px", "points": "solid"}
"""Dash → plotly's."""
