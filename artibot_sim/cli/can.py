"""`artibot can`: recorded CAN frames decoded, the bus's load, its DBC, and a loopback bus. Needs no ROS."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

import click

from artibot_sim.errors import ArtibotError
from artibot_sim.progress import Bar

if TYPE_CHECKING:
    from artibot_driver.explain import Explained, Explainer
    from artibot_driver.rig import Rig
    from artibot_driver.traffic import Traffic
    from artibot_sim.experiment.can_frames import CanFrame, FrameStream

_SECOND: Final = 1_000_000_000
_KINDS: Final = ("rpdo", "tpdo", "sync", "nmt", "heartbeat", "emcy", "sdo", "error", "malformed", "other")
_SETTINGS = {"max_content_width": 110}

_params = click.option("--params", metavar="FILE", default=None, help="Driver parameters.  [default: driver]")
_robot = click.option("--robot", help="Robot: a name or a robot file.  [default: the recording's, or the parameters']")
_topic = click.option("--topic", "topics", multiple=True, metavar="NAME", help="Topic with the frames; repeatable.")
_start = click.option("--start", type=float, help="Begin here, s from the recording's beginning.")
_end = click.option("--end", type=float, help="End here, s from the recording's beginning.")


@click.group("can", context_settings=_SETTINGS)
def command() -> None:
    """CAN frames: decode recorded ones, see how full the bus was, make a DBC or a loopback bus.

    \b
    Examples:
      artibot can decode run7 --node front_left
      artibot can load run7
      artibot can dbc > artibot.dbc
    """


def load_rig_for(params: str | None, robot: str | None, recorded: str | None) -> Rig:
    """Read driver parameters, robot and EDS.

    Parameters
    ----------
    params : name or path of a parameter file, None for the one shipped.
    robot : name or path, rules over all.
    recorded : what the recording says, which rules over the shipped parameters.
    """
    from artibot_driver.config import load_config
    from artibot_driver.rig import load_rig

    config = load_config(params or "driver")
    wanted = robot or (recorded if params is None else None)
    return load_rig(replace(config, robot=wanted) if wanted else config)


@command.command("decode", short_help="Print recorded CAN frames decoded.", context_settings=_SETTINGS)
@click.argument("bag", metavar="BAG|LOG|-")
@_params
@_robot
@click.option(
    "--node", "nodes", multiple=True, metavar="NAME", help="Only this motor, `driver`, `all` or id; repeatable."
)
@click.option("--kind", "kinds", multiple=True, type=click.Choice(_KINDS), help="Only this kind; repeatable.")
@_start
@_end
@_topic
@click.option("--raw", is_flag=True, help="Show identifiers, bytes and integers too.")
@click.option("--json", "form", flag_value="json", help="One JSON object a line.")
@click.option("--csv", "form", flag_value="csv", help="CSV with a row for each object.")
def decode(bag: str, params: str | None, robot: str | None, form: str | None, raw: bool, **given: Any) -> int:
    """Print the CAN frames of a recording decoded: time, drive, what, and each object with its SI value.

    BAG is a recording made with `artibot record --can`, or by anything that writes can_msgs/msg/Frame; LOG a file that
    `candump -l` or `candump -L` wrote; `-` reads such lines from standard input. Values are motor-side, with each
    motor's polarity. Times count from the recording's beginning, those of a log from its first frame.

    \b
    Examples:
      artibot can decode run7 --node front_left --kind tpdo --start 10 --end 12
      artibot can decode run7 --kind emcy --kind nmt --raw
      artibot can decode run7 --json | jq .values.torque_actual_value.value
      candump -L can0 | artibot can decode -
    """
    from artibot_driver.explain import Explainer
    from artibot_sim.experiment.can_frames import open_frames

    frames = open_frames(bag, given["topics"], given["start"], given["end"])
    explainer = Explainer(load_rig_for(params, robot, frames.robot))
    nodes = _checked_nodes(given["nodes"], explainer)
    with quiet_pipe():
        shown = _print(frames, explainer, nodes, frozenset(given["kinds"]), form, raw)
        if not shown and sys.stdout.isatty():
            click.echo("no frame matches these options", err=True)
    return 0


def _checked_nodes(nodes: tuple[str, ...], explainer: Explainer) -> frozenset[str]:
    from artibot_driver.explain import names

    known = list(names(explainer.rig))
    for node in nodes:
        if node not in known and not node.isdigit():
            raise ArtibotError(f"--node {node}: expected {', '.join(known)} or a node id")
    return frozenset(nodes)


def _print(
    frames: FrameStream, explainer: Explainer, nodes: frozenset[str], kinds: frozenset[str], form: str | None, raw: bool
) -> int:
    """Print the frames that match; return how many."""
    from artibot_driver.explain import COLUMNS, as_csv, as_json, for_reading, matches

    line = {"json": as_json, "csv": as_csv}.get(form or "", for_reading(raw))
    out, live, shown = sys.stdout, frames.end_ns is None, 0
    if form == "csv":
        out.write(",".join(COLUMNS) + "\n")
    for frame in with_progress(frames):
        found = explainer.explain(frame)
        if not matches(found, nodes, kinds):
            continue
        after = frame.stamp_ns - (frames.start_ns or 0)
        out.write(line(after / _SECOND, frame.stamp_ns, frame, found) + "\n")
        shown += 1
        if live:
            out.flush()
    out.flush()
    return shown


@contextmanager
def quiet_pipe() -> Iterator[None]:
    """Let the reader of standard output go away (`| head`) without a word."""
    try:
        yield
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # what is buffered has to go somewhere


def with_progress(frames: FrameStream) -> Iterator[CanFrame]:
    """The frames; where standard output goes elsewhere than to a terminal and takes its time, with a bar."""
    if frames.start_ns is None or frames.end_ns is None or sys.stdout.isatty():
        yield from frames.stream
        return
    with Bar(max(1, frames.end_ns - frames.start_ns)) as bar:
        for frame in frames.stream:
            bar.show(frame.stamp_ns - frames.start_ns, frames.name)
            yield frame


@command.command("load", short_help="Show how full the bus was.", context_settings=_SETTINGS)
@click.argument("bag", metavar="BAG|LOG|-")
@_params
@_robot
@_start
@_end
@_topic
@click.option("--bitrate", type=click.IntRange(min=1), help="Bit rate of the bus, bit/s.  [default: the parameters']")
def load(bag: str, params: str | None, robot: str | None, bitrate: int | None, **given: Any) -> int:
    """Show how full the bus was, and with what: frames, rate and longest gap of each identifier.

    The load is an upper bound: every frame counts with as many stuff bits as it could have.

    \b
    Example:
      artibot can load run7 --start 10 --end 20
    """
    from artibot_driver.explain import ALL, Explainer
    from artibot_driver.traffic import Traffic
    from artibot_sim.experiment.can_frames import open_frames

    frames = open_frames(bag, given["topics"], given["start"], given["end"])
    explainer = Explainer(load_rig_for(params, robot, frames.robot))
    traffic = Traffic()
    what: dict[tuple[int, bool, bool], tuple[str, str]] = {}
    for frame in with_progress(frames):
        traffic.add(frame, frame.stamp_ns)
        if len(what) < len(traffic.series):
            found = explainer.explain(frame)
            node = ALL if found.kind == "nmt" else found.node  # commands to single nodes have one identifier
            what[frame.can_id, frame.is_extended, frame.is_error] = (node, _service(found))
    if not traffic.count:
        raise ArtibotError(f"{bag}: no CAN frame in that time")
    with quiet_pipe():
        _show_load(traffic, what, bitrate or explainer.rig.config.bitrate)
    return 0


def _service(found: Explained) -> str:
    """What an identifier is used for: `TPDO1`, `SDO answer`."""
    words = (found.what or found.kind).split()
    return f"{words[0]} {words[-1]}" if found.kind == "sdo" else " ".join(words)


def _show_load(traffic: Traffic, what: dict[tuple[int, bool, bool], tuple[str, str]], bitrate: int) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table("id", "node", "what", "frames", "Hz", "longest gap, ms", "load, %", box=None, header_style="bold")
    for column in table.columns[3:]:
        column.justify = "right"
    seconds = max(traffic.seconds, 1.0)
    for key, series in traffic.in_order():
        share = 100 * series.bits / (bitrate * seconds)
        name = f"{key.can_id:08X}" if key.is_extended else f"{key.can_id:03X}"
        numbers = (f"{series.count}", f"{series.rate:.1f}", f"{series.longest_ns / 1e6:.1f}", f"{share:.2f}")
        table.add_row(name, *what[key], *numbers)
    console = Console(highlight=False)
    console.print(table)
    mean, busiest = traffic.load(bitrate)
    console.print(
        f"{traffic.count} frames in {traffic.seconds:.1f} s; at {bitrate} bit/s the bus was at most {100 * mean:.1f} % "
        f"full, {100 * busiest:.1f} % in the busiest second",
        soft_wrap=True,
    )


@command.command("dbc", short_help="Print a DBC of the bus.", context_settings=_SETTINGS)
@_params
@click.option("--robot", help="Robot: a name or a robot file.  [default: the parameters']")
def dbc(params: str | None, robot: str | None) -> int:
    """Print a DBC of the bus, with signals in SI units, for SavvyCAN, PlotJuggler, cantools and others.

    \b
    Example:
      artibot can dbc --params my_driver.yaml > my_rover.dbc
    """
    from artibot_driver.dbc import dbc_text

    text = dbc_text(load_rig_for(params, robot, None))
    with quiet_pipe():
        click.echo(text, nl=False)
    return 0


@command.command("settings", short_help="Show what the drives must be set to.", context_settings=_SETTINGS)
@_params
@click.option("--robot", help="Robot: a name or a robot file.  [default: the parameters']")
@click.option("--node", "motor", metavar="NAME", help="Only this motor.")
def settings(params: str | None, robot: str | None, motor: str | None) -> int:
    """Show every object that a drive must have, and whether the driver writes it or the drive must have it already.

    What is `compared` belongs to commissioning: set it with the drive's own tool. The driver reads it and refuses the
    drive where it differs.

    \b
    Example:
      artibot can settings --params my_rover.yaml --node front_right
    """
    from artibot_driver.explain import Explainer, setting_text

    explainer = Explainer(load_rig_for(params, robot, None))
    motors = list(explainer.rig.codec.nodes)
    if motor is not None and motor not in motors:
        raise ArtibotError(f"--node {motor}: expected {', '.join(motors)}")
    with quiet_pipe():
        for name in [motor] if motor else motors:
            click.echo(f"{name} (node {explainer.rig.codec.nodes[name]})")
            for each in explainer.rig.settings(name):
                value = explainer.value(name, each.index, each.subindex, each.value)
                click.echo(f"  {'written' if each.written else 'compared':8}  {setting_text(value)}")
    return 0


@command.command("loopback", short_help="Run a CAN bus between processes.", context_settings=_SETTINGS)
@click.option(
    "--port", type=click.IntRange(0, 65535), default=0, help="TCP port on 127.0.0.1.  [default: any free one]"
)
def loopback(port: int) -> int:
    """Run a CAN bus between processes where the kernel has none, until Ctrl-C; print its channel.

    \b
    Example:
      artibot can loopback --port 5900 &
      artibot record --can ws://127.0.0.1:5900/
    """
    from artibot_driver.loopback import main

    return main(["--port", str(port)])
