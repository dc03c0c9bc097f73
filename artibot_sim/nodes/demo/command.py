"""``artibot demo``: what a newcomer sees first. Real nodes in processes of their own drive, record and replay."""

from __future__ import annotations

import contextlib
import os
import shlex
import shutil
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from artibot_sim.errors import ArtibotError
from artibot_sim.nodes.child_processes import ChildFailed, ChildProcesses, Interrupted, noted_signals
from artibot_sim.nodes.common.options import BoundedNumber
from artibot_sim.nodes.demo.domain import reserved_domain
from artibot_sim.nodes.demo.drive import (
    START,
    VCAN,
    DemoSettings,
    begin,
    drive_by_topics,
    drive_over_can,
    has_drives,
    is_free,
)

if TYPE_CHECKING:
    from rich.console import Console

    from artibot_sim.nodes.demo.echo import Steps

OTHERS: Final = 90.0
"""How long replay, and the picture, may take, s."""
STRAGGLERS: Final = 3.0
"""How long after a replay's end its last messages may still come, s."""
REPLAY_RATE: Final = 3
"""Of the recorder's time."""


@click.command("demo", context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.option("--out", type=click.Path(path_type=Path), help="Folder for the results.  [default: demo, demo_2, …]")
@click.option("--robot", default="agriq", show_default=True, help="Robot: agriq, epiq, husky, or a robot file.")
@click.option("--kappa", type=BoundedNumber(0, 1, min_open=True), help="Front share of traction.  [the robot's]")
@click.option("--short", is_flag=True, help="Drive ten seconds instead of the paper's trajectory.")
@click.option("--domain", type=click.IntRange(0, 232), help="ROS_DOMAIN_ID.  [default: one that nobody uses]")
def command(out: Path | None, robot: str, kappa: float | None, short: bool, domain: int | None) -> int:
    """Plan the paper's trajectory, drive, record and replay it with real ROS 2 nodes, and show what happened.

    Planner, driver, CAN bus, drives and model form the loop that a real rover has; a robot whose file has no data of
    its drives is moved by topics. Takes about a minute and ends every process it starts.

    \b
    Examples:
      artibot demo
      artibot demo --robot epiq --kappa 0.6 --out epiq_demo
      artibot demo --short
    """
    from rich.console import Console

    from artibot_driver.master import check_kappa
    from artibot_sim.model import load_robot
    from artibot_sim.planning import load_manoeuvre, plan

    console = Console(highlight=False)
    rover = load_robot(robot)
    share = rover.control.kappa if kappa is None else kappa
    if has_drives(rover):
        check_kappa(rover, share)
    manoeuvre = "short" if short else "table6_epiq" if rover.name == "epiq" else "table6_agriq"
    planned = plan(load_manoeuvre(manoeuvre), rover)
    try:
        with noted_signals() as asked, reserved_domain(domain) as free, _new_folder(out) as folder:
            return _run(DemoSettings(rover, robot, share, manoeuvre, planned, folder, free), asked, console)
    except Interrupted as signal:
        console.print(f"ended by {signal}; nothing is left running, and no results are kept", style="bold")
        return 128 + signal.number


@contextlib.contextmanager
def _new_folder(out: Path | None) -> Iterator[Path]:
    """Make the folder for the results: the one named, else the next that is free.

    Removed again when a signal ends the demo; kept with its logs when something fails.
    """
    names = [out] if out else [Path("demo"), *(Path(f"demo_{n}") for n in range(2, 1000))]
    folder = next((folder for folder in names if not folder.exists()), None)
    if folder is None:
        raise ArtibotError(
            f"{names[-1]}: exists already; results are never overwritten, name another folder with --out"
        )
    try:
        (folder / "logs").mkdir(parents=True)
    except OSError as error:
        raise ArtibotError(f"{folder}: cannot be made: {error.strerror}; name another folder with --out") from error
    try:
        yield folder
    except Interrupted:
        shutil.rmtree(folder, ignore_errors=True)
        raise


def _run(settings: DemoSettings, asked: list[int], console: Console) -> int:
    """Go through all steps and return the exit status; no child is left, whatever happens."""
    from artibot_sim.nodes.demo.echo import Steps

    began = time.monotonic()
    logs = settings.out / "logs"
    os.environ.update(settings.environment)  # for the listener in this process, too
    quiet = {
        "ROS_LOG_DIR": str((logs / "ros").resolve()),
        "RCUTILS_COLORIZED_OUTPUT": "0",
        "RCUTILS_CONSOLE_OUTPUT_FORMAT": "[{severity}] [{name}]: {message}",
        "PYTHONUNBUFFERED": "1",
    }
    over_can = has_drives(settings.robot)
    channel = VCAN if over_can and is_free(VCAN) else ""
    children = ChildProcesses(logs, {**os.environ, **quiet}, asked)
    steps = Steps(console, (6 if channel else 7) if over_can else 5)
    try:
        _introduce(settings, console)
        if over_can:
            drive_over_can(settings, children, steps, channel)
        else:
            drive_by_topics(settings, children, steps)
        _replay(settings, children, steps)
        _draw(settings, children, steps)
        return _conclude(settings, console, began)
    except ChildFailed as failure:
        steps.stop()
        console.print(f"\n{failure}. Its last words:\n", style="bold red", markup=False, soft_wrap=True)
        console.print(failure.child.last_lines(), markup=False, soft_wrap=True)
        console.print(f"\nAll that was said is in {logs}", markup=False, soft_wrap=True)
        return 1
    finally:
        steps.stop()
        children.end()


def _introduce(settings: DemoSettings, console: Console) -> None:
    plan = settings.plan
    console.print(
        f"{settings.robot.name} drives {settings.manoeuvre}: {plan.path_length:.2f} m in {plan.duration:.2f} s, "
        f"κ = {settings.kappa:g}. Each step shows what you would type yourself, after",
        markup=False,
    )
    # a profile keeps the demo's nodes to this machine; whoever joins them without it does so by the range
    variables = f"ROS_DOMAIN_ID={settings.domain} ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST"
    console.print(f"        export {variables}\n", style="cyan", markup=False, soft_wrap=True)


def _replay(settings: DemoSettings, children: ChildProcesses, steps: Steps) -> None:
    """Publish the recording again and compare what comes with it."""
    from artibot_sim.nodes.demo.echo import listening

    with listening(settings.recording, settings.domain) as echo:
        words = ["replay", str(settings.recording), "--rate", str(REPLAY_RATE), "--wait", "1"]
        replay = begin(children, steps, "Replay", words, note=lambda: f"{echo.count} of {echo.expected} messages")

        def listen() -> None:
            echo.take()
            steps.tick()

        children.wait_for_end(replay, START + OTHERS, listen)
        children.pause(lambda: echo.count >= echo.expected, STRAGGLERS, listen)
        difference = echo.difference()
        if difference:
            raise ChildFailed(replay, f"did not publish what was recorded: {difference}")
        steps.done(f"{echo.count} messages came again on {len(echo.received)} topics, each the same to the byte")


def _draw(settings: DemoSettings, children: ChildProcesses, steps: Steps) -> None:
    """Draw the recording."""
    files = ["--png", str(settings.out / "drive.png"), "--html", str(settings.out / "drive.html")]
    words = ["plot", str(settings.recording), "--robot", settings.robot_name, *files]
    children.wait_for_end(begin(children, steps, "Picture", words), OTHERS, steps.tick)
    steps.done("drawn")


def _conclude(settings: DemoSettings, console: Console, began: float) -> int:
    """Show the figures, where the files are, and what to type next; return the exit status."""
    from artibot_sim.nodes.demo.result import lacks, note, read_result, result_table

    result, plan = read_result(settings.recording), settings.plan
    missing = lacks(result, plan.duration)
    if missing:
        console.print(f"\n{settings.recording}: {missing}. Is this machine very busy? Try again.", style="bold red")
        return 1
    paper = settings.manoeuvre.startswith("table6")
    console.print()
    console.print(result_table(result, settings.robot.name, settings.kappa, plan.duration, plan.path_length, paper))
    if paper:
        console.print(note(has_drives(settings.robot)), style="dim", markup=False)
    out, bag = shlex.quote(str(settings.out)), shlex.quote(str(settings.recording))
    results = {
        f"{out}/drive.png": "the picture",
        f"{out}/drive.html": "the same to zoom into, in a browser",
        bag: "the recording (rosbag2, MCAP)",
        f"{out}/logs": "what every node said",
    }
    further = {
        "artibot planner --list": "other manoeuvres",
        f"artibot sim --robot {shlex.quote(settings.robot_name)}": "a rover in real time, waiting for commands",
        f"artibot plot {bag} --json figures.json": "the figures of the table, for scripts",
        f"artibot replay {bag} --resimulate rotations --out {out}/again": "the recorded rotations through the model",
    }
    text = f"""
{_columns(results)}

Next:
{_columns(further)}

Took {time.monotonic() - began:.0f} s. Nothing is left running."""
    console.print(text, markup=False, soft_wrap=True)
    return 0


def _columns(rows: dict[str, str]) -> str:
    width = max(map(len, rows)) + 4
    return "\n".join(f"    {left:{width}}{right}" for left, right in rows.items())


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line `argv` (by default the process's own) and return the exit status."""
    args = list(sys.argv[1:] if argv is None else argv)
    return int(command.main(args=args, prog_name="artibot demo", standalone_mode=False) or 0)


if __name__ == "__main__":
    sys.exit(main())
