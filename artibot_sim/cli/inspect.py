"""`artibot inspect`: what is in a recording, what it is good for, and what is missing."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from artibot_sim.cli.options import ReadingOptions, gathered, reading_options
from artibot_sim.model import MOTORS
from artibot_sim.report.files import OutputFile

if TYPE_CHECKING:
    from rich.console import Console

    from artibot_sim.exchange.inspection import Inspection, TopicView, Use

_HALF = 0.5
"""Share of a recording's time below which it is ready in part only."""
_HELD = 0.05
"""Share of repeated samples that is said."""
_NAMES = 7
"""Columns that are listed by name."""
_METADATA = ("kappa", "surface", "operator", "description")
"""Strings of a recording's record that are shown."""
_COMMANDS = ("/motor_command", "/motor_command_request", "/cmd_vel")
"""What is given, and so is held by its nature."""
_SHOWN = 18
"""Topics that fit on a screen beside the rest; `--all` shows the others."""


@click.command("inspect")
@click.argument("recording", metavar="BAG", type=click.Path(path_type=Path))
@reading_options
@click.option("--all", "everything", is_flag=True, help="Also all topics that artibot does not read.")
@click.option("--json", "as_json", type=OutputFile(), help="The same as JSON, in SI units.")
@gathered(ReadingOptions, "reading")
def command(reading: ReadingOptions, recording: Path, everything: bool, as_json: Path | None) -> None:
    """Show what is in a recording (folder or file), what it is good for, and what is missing.

    Any rosbag2 recording is read, MCAP or SQLite. Topics under other names are listed with what to type. Exit status
    0 whatever it holds; 2 where it cannot be read at all, with one line that says what to do.

    \b
    Examples:
      artibot inspect run7
      artibot inspect husky.db3 --topic /ground_truth/odom=/lidar/odom
      artibot inspect two_rovers --namespace /rover1 --json rover1.json
    """
    from artibot_sim.exchange.inspection import inspect_recording
    from artibot_sim.experiment import parse_renames
    from artibot_sim.experiment.wheels import parse_joints
    from artibot_sim.progress import Bar
    from artibot_sim.report.files import json_bytes, write_files

    with Bar() as bar:
        stage = bar.stage(f"reading {recording.name}", 1.0)
        found = inspect_recording(
            recording, parse_renames(reading.topics), namespace=reading.namespace,
            joints=parse_joints(reading.joints), progress=stage,
        )  # fmt: skip
    if as_json is not None:
        write_files({as_json: json_bytes(found.as_dict())})
    _print(found, everything)
    if as_json is not None:
        click.echo(f"wrote {as_json}")


def _print(found: Inspection, everything: bool) -> None:
    """Print the screen."""
    from rich.console import Console

    console = Console(highlight=False, markup=False)
    console.print(_headline(found), style="bold", soft_wrap=True)
    console.print(_robot(found), no_wrap=True, overflow="ellipsis")
    _print_topics(found, console, everything)
    for remark in found.remarks:
        console.print(remark, style="dim")
    console.print()
    for use in found.uses:
        mark, style = _mark(use)
        console.print(f"{use.name:11}", style="bold", end="")
        console.print(mark, style=style, end=" ")
        console.print("; ".join(use.lacks) if not use.ready else use.command, soft_wrap=True)
        for limit in _limits(found, use):
            console.print(f"{'':20}{limit}", style="dim")
    for line in found.advice:
        console.print(f"→ {line}", soft_wrap=True)


def _mark(use: Use) -> tuple[str, str]:
    """Word and colour of a use: ready, ready for a part of the recording only, or not."""
    if not use.ready:
        return "missing", "red"
    return ("ready  ", "green") if use.share > _HALF else ("partly ", "yellow")


def _limits(found: Inspection, use: Use) -> tuple[str, ...]:
    """Limits of a use that is ready; a diagnosis's but for those that identify, printed just above, has as well."""
    if not use.ready:
        return ()
    above = {limit for other in found.uses if other.name == "identify" for limit in other.lacks}
    return tuple(limit for limit in use.lacks if use.name != "diagnose" or limit not in above)


def _headline(found: Inspection) -> str:
    parts = len(found.segments)
    count = f", {parts} segments" if parts > 1 else ""
    size = f"{found.size / 1e6:.1f} MB {found.storage}"
    return f"{found.path}: {found.duration:.1f} s{count}, {len(found.topics)} topics, {size}"


def _robot(found: Inspection) -> str:
    from datetime import datetime, timezone

    when = datetime.fromtimestamp(found.started_ns / 1e9, tz=timezone.utc)
    started = f", recorded {when:%Y-%m-%d %H:%M} UTC" if when.year > 1990 else ""
    said = [f"{key} {value}" for key, value in found.metadata.items() if key in _METADATA]
    robot = found.robot or "not said (give --robot)"
    return f"robot {robot}{started}{''.join(f', {word}' for word in said)}"


def _print_topics(found: Inspection, console: Console, everything: bool) -> None:
    from rich.table import Table

    table = Table("topic", "messages", "Hz", "what", box=None, header_style="bold", pad_edge=False)
    for column in (1, 2):
        table.columns[column].justify = "right"
    read = [view for view in found.topics if view.read_as]
    others = [view for view in found.topics if not view.read_as]
    shown = others if everything else others[: max(3, _SHOWN - len(read))]
    for view in [*read, *shown]:
        rate = f"{view.rate:.3g}" if view.rate == view.rate else ""
        name = view.topic if view.read_as in ("", view.topic) else f"{view.topic} as {view.read_as}"
        table.add_row(name, str(view.messages), rate, _what(view), style=None if view.read_as else "dim")
    console.print(table)
    if left := len(others) - len(shown):
        console.print(f"and {left} more that artibot does not read (--all lists them)", style="dim")


def _what(view: TopicView) -> str:
    """Return the quantities of a topic and what is wrong with its samples."""
    if not view.read_as:
        return f"not read: {view.ros_type}"
    if not view.messages or not view.columns:
        return "no message" if not view.messages else "no finite value"
    words = [_quantities(view.columns)]
    if view.held > _HELD and view.read_as not in _COMMANDS:
        words.append(f"{100 * view.held:.0f} % of the samples held: {view.distinct:.2g} Hz in effect")
    if view.gaps:
        start, length = max(view.gaps, key=lambda gap: gap[1])
        more = f" and {len(view.gaps) - 1} shorter" if len(view.gaps) > 1 else ""
        words.append(f"silent for {length:.1f} s from {start:.1f} s on{more}")
    return "; ".join(words)


def _quantities(columns: tuple[str, ...]) -> str:
    """Return columns in few words: joints by quantity."""
    plain = [name for name in columns if "." not in name]
    words = [", ".join(plain[:_NAMES]) + (", …" if len(plain) > _NAMES else "")] if plain else []
    joints: dict[str, list[str]] = {}
    for joint, _, quantity in (name.rpartition(".") for name in columns if "." in name):
        joints.setdefault(quantity, []).append(joint)
    groups: dict[tuple[str, ...], list[str]] = {}
    for quantity, named in joints.items():
        groups.setdefault(tuple(named), []).append(quantity)
    for names, quantities in groups.items():
        few = ", ".join(names) if len(names) <= len(MOTORS) else f"{len(names)} joints"
        listed = "the four motors" if names == tuple(MOTORS) else few
        words.append(f"{', '.join(quantities)} of {listed}")
    return "; ".join(words)
