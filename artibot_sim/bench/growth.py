"""``python -m artibot_sim.bench.growth OUT``: time and memory against runs, length of a recording, effects and cores.

Every size is measured in a process of its own, so that peaks of memory are its own. Writes OUT/growth.json and
OUT/growth.png and prints how each operation grows.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import click
import numpy as np

from artibot_sim.bench.results import machine
from artibot_sim.errors import ArtibotError
from artibot_sim.model.batch import available_cores

SIZES: dict[str, tuple[float, ...]] = {
    "runs": (100, 1_000, 10_000, 100_000),
    "table": (10_000, 100_000, 1_000_000),
    "length": (1, 4, 15, 60, 120),
    "identification": (1, 4, 15),
    "diagnosis": (1, 2, 4),
    "hidden": (0, 1, 2, 3),
    "effects": (0, 1, 2, 5, 10, 21),
    "cores": (),
}
"""Kind → sizes: runs, runs, minutes three times, effects twice; cores are those there are."""
QUICK: dict[str, tuple[float, ...]] = {
    "runs": (50, 200), "table": (5_000, 20_000), "length": (0.5, 2), "identification": (0.5, 1), "diagnosis": (0.5, 1),
    "hidden": (0, 1), "effects": (0, 3, 21), "cores": (),
}  # fmt: skip
SECONDS = {
    "runs": 2e-3, "table": 4e-5, "length": 6.0, "identification": 8.0, "diagnosis": 30.0, "hidden": 15.0,
    "effects": 0.3, "cores": 10.0,
}  # fmt: skip
"""About how long a measurement takes for one of its size, for the progress bar."""
UNITS = {
    "runs": "runs", "table": "runs", "length": "minutes", "identification": "minutes", "diagnosis": "minutes",
    "hidden": "effects", "effects": "effects", "cores": "cores",
}  # fmt: skip
FILE, PICTURE = "growth.json", "growth.png"
LINEAR = 1.15
"""Greatest power of the size that counts as linear."""


@dataclass(frozen=True)
class Point:
    """One measurement: of what kind, which operation, for which size; wall time and processor time in s."""

    kind: str
    operation: str
    size: float
    seconds: float
    cpu: float
    bytes: float


def measured(kind: str, size: float) -> list[Point]:
    """Measure in a fresh process (ArtibotError where it fails)."""
    with tempfile.TemporaryDirectory(prefix="artibot-growth-") as folder:
        command = [sys.executable, "-m", "artibot_sim.bench.growth_tasks", kind, str(size), folder]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise ArtibotError(f"growth: {kind} of {size:g} failed: {done.stderr.strip().splitlines()[-1:]}")
    found = json.loads(done.stdout.splitlines()[-1])
    return [
        Point(kind, name, size, *(figures[key] for key in ("seconds", "cpu", "bytes")))
        for name, figures in found.items()
    ]


def lines(points: Sequence[Point]) -> Iterator[tuple[str, str, list[Point]]]:
    """Kind, operation and its measurements, in the order of their sizes."""
    for kind, operation in dict.fromkeys((point.kind, point.operation) for point in points):
        mine = [point for point in points if (point.kind, point.operation) == (kind, operation)]
        yield kind, operation, sorted(mine, key=lambda point: point.size)


def power(mine: Sequence[Point], name: str = "cpu") -> float:
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
    from artibot_sim.bench.growth_chart import chart
    from artibot_sim.progress import Bar
    from artibot_sim.report.output import write_files

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


def read(path: Path) -> list[Point]:
    """What a file of `command` holds; nothing where there is none."""
    if not path.exists():
        return []
    try:
        return [Point(**entry) for entry in json.loads(path.read_text(encoding="utf-8"))["points"]]
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise ArtibotError(f"{path}: not what `make growth` writes; remove it, or give another OUT") from error


def joined(known: Sequence[Point], new: Sequence[Point]) -> list[Point]:
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
