"""``artibot reproduce``: the paper as a page and pictures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from artibot_sim.errors import ArtibotError
from artibot_sim.report.files import fault_of_folder

if TYPE_CHECKING:
    from rich.console import Console

    from artibot_sim.reproduce.calibration import Calibration
    from artibot_sim.reproduce.result import Section

INPUTS = 3
"""The section that compares what the paper is given, not what it finds."""
SECTIONS = ("3", "5", "6", "7")
_WEIGHTS = {"calibrate": 60.0, "3": 0.1, "5": 1.0, "6": 5.0, "7": 6.0, "draw": 3.0}
"""How long each part takes, relative to the others."""


@click.command("reproduce", context_settings={"max_content_width": 110})
@click.option("--section", "sections", multiple=True, type=click.Choice(SECTIONS), help="Only this; may be repeated.")
@click.option(
    "--out", type=click.Path(file_okay=False, path_type=Path), default=Path("reproduction"), show_default=True,
    help="Folder for the page, the pictures and the numbers.",
)  # fmt: skip
@click.option("--calibrate", is_flag=True, help="Search the best-fit geometries again (many minutes) and use them.")
@click.option("--quick", is_flag=True, help="Coarser maps and sweeps; with --calibrate, a short search.")
def command(sections: tuple[str, ...], out: Path, calibrate: bool, quick: bool) -> int:
    """Reproduce the paper: every figure and table with numbers beside the model's.

    Writes OUT/reproduction.html, the same as PNG (a picture for each figure, one for each section's statements and
    tables) and OUT/reproduction.json. With --calibrate it also writes
    the robot files agriq_best_fit.yaml and epiq_best_fit.yaml, which `artibot sim --robot` loads.

    \b
    Examples:
      artibot reproduce
      artibot reproduce --section 7 --out table7
      artibot reproduce --calibrate --out calibrated
    """
    wanted = [name for name in SECTIONS if name in (sections or SECTIONS)]
    if why := fault_of_folder(out):
        raise ArtibotError(f"--out {out}: cannot be written: {why}")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ArtibotError(f"{out}: cannot be made: {error.strerror}; give another folder by --out") from error
    found, written = _reproduce(wanted, out, calibrate, quick)
    _print(found, written)
    return 0


def _reproduce(wanted: Sequence[str], out: Path, calibrate: bool, quick: bool) -> tuple[list[Section], list[Path]]:
    """Compute and write, with a bar on standard error that is gone afterwards."""
    from artibot_sim.progress import Bar

    parts = [*(["calibrate"] if calibrate else []), *wanted, "draw"]
    with Bar(sum(_WEIGHTS[part] for part in parts)) as bar:

        def begin(part: str) -> Callable[[float], None]:
            return bar.stage(f"section {part}" if part in SECTIONS else part, _WEIGHTS[part])

        calibrations = _calibrations(begin("calibrate"), quick) if calibrate else None
        sections = [_section(name, quick, begin(name), calibrations) for name in wanted]
        return sections, _write(sections, out, calibrations, begin("draw"))


def _calibrations(progress: Callable[[float], None], quick: bool) -> Mapping[str, Calibration]:
    from artibot_sim.reproduce.calibration import PROBLEMS, calibrate

    found = {}
    for i, (name, problem) in enumerate(PROBLEMS.items()):

        def advance(share: float, done: int = i) -> None:
            progress((done + share) / len(PROBLEMS))

        found[name] = calibrate(problem, 2, advance) if quick else calibrate(problem, progress=advance)
    return found


def _section(
    name: str, quick: bool, progress: Callable[[float], None], calibrations: Mapping[str, Calibration] | None
) -> Section:
    if name == "3":
        from artibot_sim.reproduce.section3 import section3

        return section3()
    if name == "5":
        from artibot_sim.reproduce.section5 import section5

        return section5(quick, progress)
    if name == "6":
        from artibot_sim.reproduce.section6 import section6

        return section6(quick, progress)
    from artibot_sim.reproduce.calibration import CALIBRATIONS
    from artibot_sim.reproduce.section7 import section7

    return section7(quick, progress, calibrations or CALIBRATIONS)


def _write(
    sections: Sequence[Section], out: Path, calibrations: Mapping[str, Calibration] | None,
    progress: Callable[[float], None],
) -> list[Path]:  # fmt: skip
    """Draw everything, then write all files or none."""
    from artibot_sim.model import save_robot
    from artibot_sim.report.files import json_bytes, write_files
    from artibot_sim.reproduce.page import render, render_sheet, render_summary
    from artibot_sim.version import __version__

    files = {out / "reproduction.html": render(sections, __version__)}
    sheets = [sheet for section in sections for sheet in section.sheets]
    for i, sheet in enumerate(sheets):
        files[out / f"{sheet.key}.png"] = render_sheet(sheet)
        progress((i + 1) / len(sheets))
    for section in sections:
        files[out / f"section{section.number}.png"] = render_summary(section)
    files[out / "reproduction.json"] = json_bytes(as_json(sections, calibrations))
    write_files(files)
    paths = list(files)
    for name, found in (calibrations or {}).items():
        paths.append(out / f"{name}_best_fit.yaml")
        save_robot(found.apply(), paths[-1])
    return paths


def as_json(sections: Sequence[Section], calibrations: Mapping[str, Calibration] | None = None) -> dict[str, Any]:
    """Comparisons and statements for scripts; of a new calibration also its numbers."""
    import dataclasses

    from artibot_sim.reproduce.result import the_paper

    out: dict[str, Any] = {
        str(section.number): {
            "title": section.title,
            "verdict": section.verdict,
            "comparisons": [dataclasses.asdict(c) | {"agrees": c.agrees} for c in section.comparisons],
            "statements": [dataclasses.asdict(s) for s in section.statements],
        }
        for section in sections
    }
    table = the_paper(sections)
    out["the_paper"] = [dict(zip(table.columns, row, strict=True)) for row in table.rows]
    if calibrations:
        out["calibrations"] = {name: dataclasses.asdict(found) for name, found in calibrations.items()}
    return out


def _print(sections: Sequence[Section], written: Sequence[Path]) -> None:
    from rich.console import Console

    console = Console(highlight=False, markup=False)
    for section in sections:
        console.print(f"Section {section.number}, {section.title}: {section.verdict}", style="bold")
        for comparison in section.comparisons:
            if not comparison.agrees:
                here, there = comparison.text(comparison.ours), comparison.text(comparison.paper)
                console.print(f"  {comparison.what}: {here} here, {there} in the paper ({comparison.difference_text})")
        for statement in section.statements:
            if not statement.holds:
                console.print(f"  does not hold: {statement.claim}")
                console.print(f"    {statement.evidence}", style="dim")
    _print_the_paper(console, sections)
    for path in written:
        console.print(f"wrote {path}", soft_wrap=True)


def _print_the_paper(console: Console, sections: Sequence[Section]) -> None:
    """Every result of the paper beside ours, with what each reading assumes; the page has inputs and statements, too.

    Assumptions are numbered and listed below: many rows share them, and none fits beside the numbers in 80 columns.
    """
    from rich.table import Table as Shown

    from artibot_sim.reproduce.result import the_paper

    table = the_paper([section for section in sections if section.number != INPUTS])
    rows = [row[1:] for row in table.rows if row[4]]
    if not rows:
        return
    numbers: dict[str, int] = {}
    shown = Shown(title=table.title, title_justify="left", box=None)
    for column in table.columns[1:]:
        left = column in ("quantity", "assumes")
        shown.add_column(column, overflow="fold", justify="left" if left else "right", no_wrap=column != "quantity")
    for *cells, assumes in rows:
        said = [numbers.setdefault(text, len(numbers) + 1) for text in assumes.split("; ") if text]
        shown.add_row(*cells, ", ".join(map(str, sorted(said))))
    console.print(shown)
    console.print("Assumed:")
    for text, number in numbers.items():
        console.print(f" {number}. {text}")
    console.print(table.note, style="dim")
