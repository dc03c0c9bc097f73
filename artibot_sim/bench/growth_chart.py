"""The picture of how things grow: time and memory over sizes, on logarithmic scales."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

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
    "effects": ("A rollout of 28.85 s, RK4 at 1 ms", "effects"),
    "cores": ("A sweep of 512 runs", "processes"),
}


WHAT = {"seconds": "time", "cpu": "processor time", "bytes": "peak of memory"}


def _time(kind: str) -> str:
    """Processor time, which others on the machine disturb least; the clock's where several processes share the work."""
    return "seconds" if kind == "cores" else "cpu"


def chart(points: Sequence[Point]) -> bytes:
    """PNG: a row a kind, time at the left, the process's peak of memory at the right; grey is linear growth."""
    import matplotlib
    from matplotlib.ticker import LogLocator

    from artibot_sim.bench.growth import lines

    kinds = list(dict.fromkeys(point.kind for point in points))
    with matplotlib.rc_context(style.matplotlib_style()):
        canvas = new_canvas(10.0, 2.7 * len(kinds), layout="constrained")
        grid = canvas.add_gridspec(len(kinds), 2)
        for row, kind in enumerate(kinds):
            title, unit = TITLES[kind]
            for column, (name, label, scale) in enumerate(((_time(kind), "s", 1.0), ("bytes", "MB", 1e-6))):
                axes = canvas.add_subplot(grid[row, column])
                mine = [(operation, found) for of, operation, found in lines(points) if of == kind]
                for colour, (operation, found) in zip(COLOURS, mine, strict=False):
                    x = [point.size for point in found]
                    y = [scale * getattr(point, name) for point in found]
                    axes.plot(x, y, "o-", color=colour, ms=4, label=operation)
                    if kind not in ("effects", "cores") and name != "bytes":
                        axes.plot(x, [y[0] * size / x[0] for size in x], color=style.GRID, zorder=0)
                if kind not in ("effects", "cores"):
                    axes.set_xscale("log")
                    axes.set_yscale("log")
                    if name == "bytes":
                        axes.yaxis.set_minor_locator(LogLocator(subs=(2.0, 5.0)))
                        axes.yaxis.set_major_formatter("{x:g}")
                        axes.yaxis.set_minor_formatter("{x:g}")
                else:
                    axes.set_ylim(bottom=0)
                sizes = sorted({point.size for _, found in mine for point in found})
                axes.set_xticks(sizes, [f"{size:g}" for size in sizes])
                axes.set_xticks([], minor=True)
                axes.set_xlabel(unit)
                axes.set_ylabel(label)
                axes.set_title(f"{title}: {WHAT[name]}")
                axes.legend(ncols=3)
        return to_png(canvas, 110)
