"""``artibot sweep``: many simulations over parameters, a table, a page and a summary."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from artibot_sim.cli import EXIT_INTERRUPTED
from artibot_sim.cli.options import gathered
from artibot_sim.errors import ArtibotError
from artibot_sim.exchange.own_effects import effects_option

if TYPE_CHECKING:
    from artibot_sim.progress import Bar
    from artibot_sim.sweep import SweepOutcome, SweepPlan

PAGE = "sweep.html"


@dataclass(frozen=True)
class Asked:
    """What flags say of a plan."""

    axes: tuple[str, ...]
    settings: tuple[str, ...]
    robot: str | None
    manoeuvre: str | None
    latin: int | None
    seed: int | None
    dt: float | None
    integrator: str | None
    no_energy: bool

    def document(self) -> dict[str, Any]:
        """In a plan file's words, without what is not said."""
        from artibot_sim.sweep import axis_from_text, setting_from_text

        given = [axis_from_text(text) for text in self.axes]
        twice = [axis.key for i, axis in enumerate(given) if any(other.key == axis.key for other in given[:i])]
        if twice:
            raise ArtibotError(f"--axis {twice[0]}: given twice; list all its values in one")
        stated: dict[str, Any] = {
            "robot": self.robot, "manoeuvre": self.manoeuvre, "runs": self.latin,
            "method": "latin" if self.latin else None, "seed": self.seed, "dt": self.dt, "integrator": self.integrator,
            "energy": False if self.no_energy else None, "axes": {axis.key: axis.as_dict() for axis in given} or None,
            "set": dict(map(setting_from_text, self.settings)) or None,
        }  # fmt: skip
        return {word: value for word, value in stated.items() if value is not None}


@click.command("sweep", context_settings={"max_content_width": 110})
@click.argument("file", required=False, metavar="[PLAN.yaml]")
@click.option(
    "--axis", "axes", multiple=True, metavar="KEY=FROM:TO:COUNT[:log] | KEY=A,B,C", help="What to vary; repeatable."
)
@click.option("--set", "settings", multiple=True, metavar="KEY=VALUE", help="What to set in every run; repeatable.")
@effects_option
@click.option("--robot", help="Robot name or file [agriq].")
@click.option("--manoeuvre", help="Manoeuvre name or file [table6_agriq].")
@click.option("--latin", type=click.IntRange(1), metavar="RUNS", help="A Latin hypercube of so many runs, not a grid.")
@click.option("--seed", type=int, help="Of the hypercube [0].")
@click.option("--dt", type=float, help="Integration step, s [0.001].")
@click.option("--integrator", help="rk4 or semi_implicit [rk4].")
@click.option(
    "--no-energy", is_flag=True, help="Leave the energies out, which are an eighth to three fifths of the time."
)
@click.option("--out", type=click.Path(path_type=Path), default=Path("sweep"), show_default=True, help="Folder.")
@click.option("--workers", type=click.IntRange(1), help="Processes [as many as cores]; results are the same.")
@click.option("--scheduler", metavar="tcp://HOST:PORT", help="Run on this Dask cluster; results are the same.")
@click.option("--keys", is_flag=True, help="List what can be varied, with the robot's values, and end.")
@gathered(Asked, "asked")
def command(
    file: str | None, asked: Asked, out: Path, workers: int | None, scheduler: str | None, keys: bool
) -> int:  # fmt: skip
    """Simulate a grid or a Latin hypercube of parameters of robot, kappa, manoeuvre and effects.

    Writes OUT/runs.parquet (one row a run: parameters, measures, status) and OUT/sweep.html. Interrupted or killed,
    the same command goes on where it stopped. A plan file holds the same words as the flags, which go over it.

    \b
    Examples:
      artibot sweep --axis contact.mu_s=0.4:0.9:20 --axis kappa=0.65:1:15 --out grip
      artibot sweep --latin 2000 --axis contact.k_l=1500:3500 --axis effects.slope.grade=-0.1:0.1 --out soil
      artibot sweep --axis manoeuvre=eight,slalom --axis effects.payload.mass=0,10,20 --out load
      artibot sweep soil --out soil           # config/sweeps/soil.yaml; a file of yours: soil.yaml
      artibot sweep soil --scheduler tcp://127.0.0.1:8786 --out soil
    """
    from artibot_sim.cluster import check_address

    extra = asked.document()
    if keys:
        return _list_keys(extra)
    if scheduler is not None:
        check_address(scheduler)
    return _sweep(_plan(file, extra), out, workers, scheduler)


def _plan(file: str | None, extra: dict[str, Any]) -> SweepPlan:
    from artibot_sim.sweep import load_plan, plan_from_dict

    return load_plan(file, extra) if file else plan_from_dict(extra)


def _list_keys(extra: dict[str, Any]) -> int:
    """Print every key with its unit and present value."""
    from artibot_sim.model import load_robot
    from artibot_sim.sweep.axes import known_keys, unit_of
    from artibot_sim.sweep.plan import base_of_document

    base = base_of_document(extra)
    values = {key: value for key, _, value in load_robot(extra.get("robot", "agriq")).quantities()}
    for key in known_keys(base):
        click.echo(f"{key:48} {f'{values[key]:g}' if key in values else '':>12} {unit_of(key, base)}".rstrip())
    return 0


def _sweep(plan: SweepPlan, out: Path, workers: int | None, scheduler: str | None) -> int:
    from artibot_sim.progress import Bar
    from artibot_sim.report.files import write_files
    from artibot_sim.report.sweep import sweep_page
    from artibot_sim.sweep import sweep
    from artibot_sim.sweep.summary import summarise

    clock = _Clock()
    try:
        with Bar(total=float(plan.count), kept=True) as bar:
            done = sweep(plan, out, workers=workers, scheduler=scheduler, progress=clock.report_to(bar))
            bar.show(float(plan.count), "drawing", note="")
            summary = summarise(done.folder)
            write_files({out / PAGE: sweep_page(summary, f"Sweep {out.resolve().name}")})
    except KeyboardInterrupt:
        click.echo(
            f"interrupted: {clock.done} of {plan.count} runs are kept in {out}; the same command goes on", err=True
        )
        return EXIT_INTERRUPTED
    _print(summary, done, clock)
    return 0


class _Clock:
    """How fast it goes."""

    def __init__(self) -> None:
        self.done = self.before = 0
        self._began = time.monotonic()
        self.seconds = 0.0

    def report_to(self, bar: Bar) -> Any:
        """What the sweep tells how far it is."""

        def advance(done: int, before: int) -> None:
            if done == before:
                self._began = time.monotonic()
            self.done, self.before, self.seconds = done, before, time.monotonic() - self._began
            total = int(bar.total or 0)
            left = round((total - done) / self.rate) if self.rate else 0
            hours = (
                f"{left // 3600}:{left // 60 % 60:02d}:{left % 60:02d}"
                if left >= 3600
                else f"{left // 60}:{left % 60:02d}"
            )
            note = f"{done}/{total}, {self.rate:.3g} runs/s, {hours} left" if self.rate else f"{done}/{total}"
            bar.show(float(done), "simulating", note=note)

        return advance

    @property
    def rate(self) -> float:
        """Runs per second, those of before left out."""
        return (self.done - self.before) / self.seconds if self.seconds > 0 else 0.0


def _print(summary: Any, done: SweepOutcome, clock: _Clock) -> None:
    """The summary in the terminal."""
    from rich.console import Console
    from rich.table import Table

    from artibot_sim.report.sweep import follows, headlines

    console = Console(highlight=False, markup=False)
    for line in headlines(summary):
        console.print(line)
    table = Table(box=None, header_style="bold", pad_edge=False)
    for column in ("measure", "unit", "least", "median", "greatest", "follows"):
        numbers = column in ("least", "median", "greatest")
        table.add_column(column, justify="right" if numbers else "left", no_wrap=column == "measure")
    for name, values in summary.spread.items():
        table.add_row(name, summary.unit(name), *(f"{value:.4g}" for value in values), follows(summary, name))
    console.print(table)
    if done.before == done.count:
        said = "all runs were there already"
    else:
        before = f", {done.before} were there" if done.before else ""
        said = f"{done.count - done.before} runs in {clock.seconds:.1f} s, {clock.rate:.3g} runs/s{before}"
    console.print(said, style="dim")
    for path in (done.runs, done.folder / PAGE):
        console.print(f"wrote {path}", soft_wrap=True)
