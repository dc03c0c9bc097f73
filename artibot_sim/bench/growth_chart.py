"""The picture of how things grow: time and memory over sizes, on logarithmic scales."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from artibot_sim.report import style
from artibot_sim.report.png import new_canvas, to_png

if TYPE_CHECKING:
    from artibot_sim.bench.growth import Point

COLOURS = (*style.BAGS, style.MUTED)
TITLES = {
    "runs": ("A sweep, one process", "runs"),
    "table": ("Its table and summary", "runs"),
    "length": ("A recording", "minutes"),
    "identification": ("Identification of two parameters", "minutes recorded"),
    "diagnosis": ("Diagnosis, one effect at work", "minutes recorded"),
    "hidden": ("Diagnosis of 2 × 30 s", "effects at work"),
    "effects": ("A rollout of 28.85 s", "effects"),
    "cores": ("512 runs, identification", "processes of a sweep, threads of an identification"),
}
FEW = ("hidden", "effects", "cores")
"""Kinds whose sizes are small numbers, 0 among them."""

WHAT = {"cpu": "processor time", "bytes": "memory"}


def chart(points: Sequence[Point]) -> bytes:
    """PNG: a row a kind, time at the left, the process's peak of memory at the right; grey is linear growth.

    Time is the processor's, which others on the machine disturb least; where several share the work the clock's beside.
    """
    import matplotlib

    from artibot_sim.bench.growth import lines

    kinds = list(dict.fromkeys(point.kind for point in points))
    with matplotlib.rc_context(style.matplotlib_style()):
        canvas = new_canvas(10.0, 2.7 * len(kinds), layout="constrained")
        grid = canvas.add_gridspec(len(kinds), 2)
        for row, kind in enumerate(kinds):
            title, unit = TITLES[kind]
            mine = [(operation, found) for of, operation, found in lines(points) if of == kind]
            for column, name in enumerate(("cpu", "bytes")):
                axes = canvas.add_subplot(grid[row, column])
                _draw(axes, kind, mine, name)
                axes.set_xlabel(unit)
                axes.set_title(f"{title}: {WHAT[name]}")
                axes.legend(ncols=3 if kind == "length" else 2, loc="upper left")
        return to_png(canvas, 110)


def _draw(axes: Any, kind: str, mine: Sequence[tuple[str, Sequence[Point]]], name: str) -> None:
    """The lines of a kind's operations."""
    scale, label = (1.0, "s") if name == "cpu" else (1e-6, "MB")
    for colour, (operation, found) in zip(COLOURS, mine, strict=False):
        x = [point.size for point in found]
        y = [scale * getattr(point, name) for point in found]
        axes.plot(x, y, "o-", color=colour, ms=4, label=operation)
        if kind == "cores" and name == "cpu":
            clock = [point.seconds for point in found]
            axes.plot(x, clock, "o:", color=colour, ms=4, mfc="none", label=f"{operation}, by the clock")
        if kind not in FEW and name == "cpu":
            axes.plot(x, [y[0] * size / x[0] for size in x], color=style.GRID, zorder=0)
    axes.set_ylabel(label)
    if kind in FEW:
        axes.set_ylim(0.0, 1.25 * axes.get_ylim()[1])  # the legend stands above
    else:
        _logarithmic(axes, name)
    sizes = sorted({point.size for _, found in mine for point in found})
    axes.set_xticks(sizes, [f"{size:g}" for size in sizes])
    axes.set_xticks([], minor=True)


def _logarithmic(axes: Any, name: str) -> None:
    """Both axes, with numbers that people read; memory from what an interpreter takes to a gigabyte at least."""
    from matplotlib.ticker import LogLocator

    axes.set_xscale("log")
    axes.set_yscale("log")
    low, high = axes.get_ylim()
    if name == "bytes":
        axes.set_ylim(100.0, max(high, 1000.0))
    wide = high > 30.0 * low and name != "bytes"
    axes.yaxis.set_minor_locator(LogLocator(subs=() if wide else (2.0, 5.0)))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter("{x:g}")
