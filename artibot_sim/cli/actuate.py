"""``artibot actuate``: torque-sharing laws side by side on one trajectory."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from artibot_sim.errors import ArtibotError

if TYPE_CHECKING:
    from artibot_sim.actuate import TrajectoryRun

USUAL = ("constant:kappa=1", "constant:kappa=0.65", "by_curvature", "relieve", "vectoring")
"""Laws that are compared unless others are named."""
SCHEMA = "artibot/actuation/1"


@click.command("actuate", context_settings={"max_content_width": 110})
@click.argument("manoeuvre", default="table6_agriq")
@click.option("--robot", default="agriq", show_default=True, help="Name of a robot, or a robot file.")
@click.option(
    "--law", "laws", multiple=True, metavar="NAME[:PARAMETER=VALUE,…]",
    help="A law to compare; may be repeated. NAME is one of those listed by --list, or a Python file with a LAW.  "
    "[default: the five usual ones]",
)  # fmt: skip
@click.option("--limited", is_flag=True, help="Hold the front motors to their torque_max.")
@click.option("--out", type=click.Path(file_okay=False, path_type=Path), help="Folder for actuation.png and .json.")
@click.option("--list", "list_laws", is_flag=True, help="Print the laws with their parameters, and stop.")
def command(manoeuvre: str, robot: str, laws: tuple[str, ...], limited: bool, out: Path | None, list_laws: bool) -> int:
    """Compare torque-sharing laws: how well the path is kept, and what it takes.

    Every law drives MANOEUVRE, a name that `artibot planner` knows or a YAML file; it decides every 10 ms from what
    the drives measure, as `artibot driver --law …` does on a real rover.

    \b
    Examples:
      artibot actuate --list
      artibot actuate table6_agriq --out laws
      artibot actuate slalom --law constant:kappa=0.8 --law vectoring:gain=0.5 --law mine.py
    """
    from rich.console import Console

    console = Console(highlight=False)
    if list_laws:
        console.print(_laws())
        return 0
    found = _compare(manoeuvre, robot, laws or USUAL, limited)
    console.print(_table(found, manoeuvre, robot))
    if out is not None:
        for path in _write(found, out, robot, manoeuvre):
            console.print(f"wrote {path}", markup=False, soft_wrap=True)
    return 0


def _compare(manoeuvre: str, name: str, texts: Sequence[str], limited: bool) -> list[TrajectoryRun]:
    from artibot_sim.actuate import actuate
    from artibot_sim.model import load_robot
    from artibot_sim.planning import load_manoeuvre, plan
    from artibot_sim.progress import Bar
    from artibot_sim.sharing import load_law

    robot = load_robot(name)
    laws = [load_law(text) for text in texts]
    planned = plan(load_manoeuvre(manoeuvre), robot)
    with Bar(len(laws)) as bar:
        return [actuate(robot, planned, law, limited=limited, progress=bar.stage(str(law), 1.0)) for law in laws]


def _laws() -> Any:
    from rich.table import Table

    from artibot_sim.sharing import LAWS

    table = Table("law", "parameters and defaults", "what it does", box=None, header_style="bold", pad_edge=False)
    for law in LAWS.values():
        values = ", ".join(f"{name}={value:g}" for name, value in law.defaults.items())
        table.add_row(law.id, values.replace("=nan", "=the robot's"), law.doc)
    return table


def figures(found: TrajectoryRun) -> dict[str, tuple[float, str]]:
    """Figures of merit by name, with their units."""
    return {
        "e_gamma": (100 * found.e_gamma, "%"), "e_x": (100 * found.e_x, "%"),
        "peak_front_torque": (found.peak_front, "N·m"), "rms_front_torque": (found.rms_front, "N·m"),
        "peak_back_torque": (found.peak_back, "N·m"), "energy": (found.energy, "J"),
    }  # fmt: skip


def _table(found: Sequence[TrajectoryRun], manoeuvre: str, robot: str) -> Any:
    from rich.table import Table

    plan = found[0].plan
    table = Table(
        title=f"{robot} on {manoeuvre}: {plan.path_length:.1f} m in {plan.duration:.1f} s", title_justify="left",
        title_style="bold", box=None, header_style="bold", pad_edge=False,
        caption="peak: largest mean over 0.1 s; at jumps of the path's curvature torques are larger for an instant",
        caption_justify="left",
    )  # fmt: skip
    table.add_column("law", no_wrap=True)
    names = figures(found[0])
    for name, (_, unit) in names.items():
        table.add_column(f"{name.replace('_', ' ')} ({unit})", justify="right")
    best = {name: min(abs(figures(each)[name][0]) for each in found) for name in names}
    for each in found:
        cells = []
        for name, (value, unit) in figures(each).items():
            text = f"{value:.2f}" if unit != "J" else f"{value:.0f}"
            cells.append(f"[bold]{text}[/bold]" if abs(value) <= best[name] * (1 + 1e-9) else text)
        table.add_row(str(each.law), *cells)
    return table


def _write(found: Sequence[TrajectoryRun], out: Path, robot: str, manoeuvre: str) -> list[Path]:
    from artibot_sim.actuate import sheet
    from artibot_sim.report.files import json_bytes, write_files
    from artibot_sim.reproduce.page import render_sheet

    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ArtibotError(f"{out}: cannot be made: {error.strerror}; give another folder by --out") from error
    numbers = {
        "schema": SCHEMA, "robot": robot, "manoeuvre": manoeuvre,
        "laws": [
            {"law": str(each.law), **{name: {"value": v, "unit": unit} for name, (v, unit) in figures(each).items()}}
            for each in found
        ],
    }  # fmt: skip
    files = {
        out / "actuation.png": render_sheet(sheet(found, robot, manoeuvre)),
        out / "actuation.json": json_bytes(numbers),
    }
    write_files(files)
    return list(files)
