"""The picture of how things grow: time and memory over sizes, on logarithmic scales."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np

from artibot_sim.bench.results import machine
from artibot_sim.errors import ArtibotError
from artibot_sim.model.simulate.batch import available_cores
from artibot_sim.report import style
from artibot_sim.report.png import new_canvas, to_png

COLOURS = (*style.BAGS, style.MUTED)
TITLES = {
    "runs": ("A sweep, one process", "runs"),
    "table": ("Its table and summary", "runs"),
    "length": ("A recording", "minutes"),
    "identification": ("Identification of two parameters", "minutes recorded"),
    "diagnosis": ("Diagnosis, one effect at work", "minutes recorded"),
    "hidden": ("Diagnosis of 2 × 30 s", "effects at work"),
    "effects": ("A rollout of 28.85 s", "effects"),
    "modules": ("A rollout of 28.85 s", "modules"),
    "cores": ("512 runs, identification", "processes of a sweep, threads of an identification"),
}
FEW = ("hidden", "effects", "cores")
"""Kinds whose sizes are small numbers, 0 among them."""

WHAT = {"cpu": "processor time", "bytes": "memory"}


def chart(points: Sequence[GrowthPoint]) -> bytes:
    """PNG: a row a kind, time at the left, the process's peak of memory at the right; grey is linear growth.

    Time is the processor's, which others on the machine disturb least; where several share the work the clock's beside.
    """
    import matplotlib

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


def _draw(axes: Any, kind: str, mine: Sequence[tuple[str, Sequence[GrowthPoint]]], name: str) -> None:
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


# ----------------------------------------------------------------------
# ``python -m artibot_sim.bench.growth OUT``: time and memory against runs, length of a recording, effects and
# cores.
#
# Every size is measured in a process of its own, so that peaks of memory are its own. Writes OUT/growth.json and
# OUT/growth.png and prints how each operation grows.
# ----------------------------------------------------------------------


SIZES: dict[str, tuple[float, ...]] = {
    "runs": (100, 1_000, 10_000, 100_000),
    "table": (10_000, 100_000, 1_000_000),
    "length": (1, 4, 15, 60, 120),
    "identification": (1, 4, 15),
    "diagnosis": (1, 2, 4),
    "hidden": (0, 1, 2, 3),
    "effects": (0, 1, 2, 5, 10, 21),
    "modules": (2, 3, 5, 10, 20, 40),
    "cores": (),
}
"""Kind → sizes: runs, runs, minutes three times, effects twice, modules; cores are those there are."""
QUICK: dict[str, tuple[float, ...]] = {
    "runs": (50, 200), "table": (5_000, 20_000), "length": (0.5, 2), "identification": (0.5, 1), "diagnosis": (0.5, 1),
    "hidden": (0, 1), "effects": (0, 3, 21), "modules": (2, 8), "cores": (),
}  # fmt: skip
SECONDS = {
    "runs": 2e-3, "table": 4e-5, "length": 6.0, "identification": 8.0, "diagnosis": 30.0, "hidden": 15.0,
    "effects": 0.3, "modules": 0.5, "cores": 10.0,
}  # fmt: skip
"""About how long a measurement takes for one of its size, for the progress bar."""
UNITS = {
    "runs": "runs", "table": "runs", "length": "minutes", "identification": "minutes", "diagnosis": "minutes",
    "hidden": "effects", "effects": "effects", "modules": "modules", "cores": "cores",
}  # fmt: skip
FILE, PICTURE = "growth.json", "growth.png"
LINEAR = 1.15
"""Greatest power of the size that counts as linear."""


@dataclass(frozen=True)
class GrowthPoint:
    """One measurement: of what kind, which operation, for which size; wall time and processor time in s."""

    kind: str
    operation: str
    size: float
    seconds: float
    cpu: float
    bytes: float


def measured(kind: str, size: float) -> list[GrowthPoint]:
    """Measure in a fresh process (ArtibotError where it fails)."""
    with tempfile.TemporaryDirectory(prefix="artibot-growth-") as folder:
        command = [sys.executable, "-m", "artibot_sim.bench.growth_tasks", kind, str(size), folder]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise ArtibotError(f"growth: {kind} of {size:g} failed: {done.stderr.strip().splitlines()[-1:]}")
    found = json.loads(done.stdout.splitlines()[-1])
    return [
        GrowthPoint(kind, name, size, *(figures[key] for key in ("seconds", "cpu", "bytes")))
        for name, figures in found.items()
    ]


def lines(points: Sequence[GrowthPoint]) -> Iterator[tuple[str, str, list[GrowthPoint]]]:
    """Kind, operation and its measurements, in the order of their sizes."""
    for kind, operation in dict.fromkeys((point.kind, point.operation) for point in points):
        mine = [point for point in points if (point.kind, point.operation) == (kind, operation)]
        yield kind, operation, sorted(mine, key=lambda point: point.size)


def power(mine: Sequence[GrowthPoint], name: str = "cpu") -> float:
    """Power of the size with which a figure grows over the upper half of the sizes; NaN where there are too few."""
    kept = [point for point in mine if point.size > 0][-3:]
    if len(kept) < 2:
        return float("nan")
    x, y = np.log([point.size for point in kept]), np.log([getattr(point, name) for point in kept])
    return float(np.polyfit(x, y, 1)[0])


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.argument("out", type=click.Path(file_okay=False, path_type=Path))
@click.option("--only", multiple=True, type=click.Choice(list(SIZES)), help="Only this kind; may be repeated.")
@click.option("--most", type=float, default=np.inf, help="Leave larger sizes out.")
@click.option("--quick", is_flag=True, help="Small sizes: to see that everything works.")
def command(out: Path, only: tuple[str, ...], most: float, quick: bool) -> None:
    """Measure how time and memory grow; writes OUT/growth.json and OUT/growth.png.

    What OUT holds of other sizes stays, and all that was measured before somebody stops it.

    \b
    Example:
      python -m artibot_sim.bench.growth growth --only length
    """
    from artibot_sim.progress import Bar
    from artibot_sim.report.files import write_files

    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ArtibotError(f"{out}: cannot be made: {error.strerror}") from error
    known = read(out / FILE)
    jobs = [(kind, size) for kind in SIZES if not only or kind in only for size in _sizes(kind, quick) if size <= most]
    with Bar(sum(SECONDS[kind] * size + 3.0 for kind, size in jobs)) as bar:
        for kind, size in jobs:
            bar.stage(f"{kind} {size:g}", SECONDS[kind] * size + 3.0)
            known = joined(known, measured(kind, size))
            content = {"machine": machine(), "points": [asdict(point) for point in known]}
            write_files({out / FILE: (json.dumps(content, indent=1) + "\n").encode()})
    write_files({out / PICTURE: chart(known)})
    for kind, operation, mine in lines(known):
        last, by = mine[-1], power(mine)
        what = f"{kind:15} {operation:11} {last.size:9g} {UNITS[kind]:8}"
        said = f"{what} {last.seconds:9.2f} s ({last.cpu:.2f} s CPU) {last.bytes / 1e6:7.0f} MB"
        grows = "" if np.isnan(by) else f"  time ~ size^{by:.2f}, memory ~ size^{power(mine, 'bytes'):.2f}"
        print(said + grows + ("  MORE THAN LINEAR" if by > LINEAR else ""))
    print(f"wrote {out / FILE}, {out / PICTURE}")


def read(path: Path) -> list[GrowthPoint]:
    """What a file of `command` holds; nothing where there is none."""
    if not path.exists():
        return []
    try:
        return [GrowthPoint(**entry) for entry in json.loads(path.read_text(encoding="utf-8"))["points"]]
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise ArtibotError(f"{path}: not what `make growth` writes; remove it, or give another OUT") from error


def joined(known: Sequence[GrowthPoint], new: Sequence[GrowthPoint]) -> list[GrowthPoint]:
    """Measurements with others over them, kinds in the order of SIZES."""
    again = {(point.kind, point.operation, point.size) for point in new}
    both = [point for point in known if (point.kind, point.operation, point.size) not in again] + list(new)
    return sorted(both, key=lambda point: list(SIZES).index(point.kind))


def _sizes(kind: str, quick: bool) -> tuple[float, ...]:
    if kind == "cores":
        return tuple(float(2**i) for i in range(available_cores().bit_length()) if 2**i <= available_cores())
    return (QUICK if quick else SIZES)[kind]


if __name__ == "__main__":
    try:
        command()
    except ArtibotError as error:
        sys.exit(f"artibot: {error}")
