"""``artibot replay``, ``ros2 run artibot_sim replay``: a recording published again, driven again, simulated again."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from artibot_sim.errors import ArtibotError
from artibot_sim.exchange.own_effects import effects_option
from artibot_sim.nodes.common.options import BoundedNumber
from artibot_sim.nodes.common.process import node_main
from artibot_sim.report.files import OutputFile

_POSITIVE = BoundedNumber(min=0, min_open=True)
_NOT_NEGATIVE = BoundedNumber(min=0)
_TOPICS_HELP = "Topic to publish, * and ? allowed; repeat, or separate by commas.  [default: all that move no rover]"
_WAIT_HELP = (
    "Begin when all who listen already are found and every topic has so many subscribers; 0: at once.  "
    "[default: 1, and topics that nobody wants hold nothing up]"
)
_DRIVE_HELP = "Move a rover: publish the recorded inputs with new stamps, and the planner's sign of life."

_ONLY = {
    "resimulate": ("robot", "ground", "horizon", "out", "back", "renames", "joints", "namespace", "residual"),
    "drive": ("delay", "use_sim_time", "request_from"),
    "play": ("rate", "start", "end", "loop", "clock", "restamp", "pause", "can"),
}
"""Options that belong to one of the three ways to replay."""
_WITH_CAN = ("can_interface", "can_frames", "can_topic", "can_params", "can_only")
_NOT_WITH_CAN_ONLY = ("topics", "exclude", "remap", "clock", "restamp", "pause", "wait")
_FRAMES_HELP = "With --can: what the drives sent, or commands, which MOVE MOTORS, or all.  [default: drives]"


@click.command("replay", context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.argument("bag", type=click.Path(path_type=Path))
@click.option("--rate", type=_POSITIVE, help="Recorded seconds a second.  [default: 1]")
@click.option("--start", type=_NOT_NEGATIVE, help="Begin here, s from the recording's beginning.")
@click.option("--end", type=_NOT_NEGATIVE, help="End here, s from the recording's beginning.")
@click.option("--loop", is_flag=True, help="Begin again at the end, until Ctrl-C.")
@click.option("--topics", "-t", multiple=True, metavar="NAME", help=_TOPICS_HELP)
@click.option("--exclude", "-x", multiple=True, metavar="NAME", help="Topic to leave out, * and ? allowed; repeatable.")
@click.option("--remap", "-m", multiple=True, metavar="A:=B", help="Publish topic A as B; repeatable.")
@click.option(
    "--clock", type=_NOT_NEGATIVE, help="Publish the recording's time on /clock, Hz; 0: do not.  [default: 100]"
)
@click.option("--restamp", is_flag=True, help="With --loop: move header stamps of later passes on, as /clock does.")
@click.option("--pause", is_flag=True, help="Begin paused; the services ~/pause and ~/step go on.")
@click.option("--wait", type=click.IntRange(min=0), help=_WAIT_HELP)
@click.option(
    "--wait-timeout", type=_POSITIVE, default=30.0, show_default=True, help="With --wait: for them at most so long, s."
)
@click.option("--stats", type=OutputFile(), help="Write counts and lateness to this JSON file.")
@click.option(
    "--can", metavar="CHANNEL", help="Play the recorded CAN frames on this bus (vcan0, ws://127.0.0.1:PORT/)."
)
@click.option("--can-interface", metavar="NAME", help="python-can's interface.  [default: socketcan; remote for ws://]")
@click.option("--can-frames", type=click.Choice(["drives", "commands", "all"]), help=_FRAMES_HELP)
@click.option("--can-topic", multiple=True, metavar="NAME", help="With --can: only this topic's frames; repeatable.")
@click.option("--can-params", metavar="FILE", help="With --can: driver parameters, for node ids.  [default: driver]")
@click.option("--can-only", is_flag=True, help="With --can: the frames alone: no topic, no /clock, no ROS.")
@click.option("--drive", is_flag=True, help=_DRIVE_HELP)
@click.option("--delay", type=_NOT_NEGATIVE, help="With --drive: start so long from now, s.  [default: 1]")
@click.option("--use-sim-time", is_flag=True, help="With --drive: take the time from a simulator's /clock.")
@click.option("--request-from", metavar="NAME", help="With --drive: publish this topic as motor_command_request.")
@click.option("--resimulate", type=click.Choice(["rotations", "commands"]), help="Feed this to the model, without ROS.")
@effects_option
@click.option("--robot", help="With --resimulate: a name or a robot file.  [default: the recording's]")
@click.option(
    "--ground", metavar="FILE|random:SEED", help="With --resimulate: uneven ground.  [default: the recording's]"
)
@click.option("--horizon", type=_POSITIVE, help="With --resimulate: start anew from the measurements so often, s.")
@click.option(
    "--out", "-o", type=click.Path(file_okay=False, path_type=Path), help="With --resimulate: folder for the results."
)
@click.option(
    "--back",
    type=click.Choice(["auto", "kappa", "effort"]),
    help="With commands: back motors by eq. 30, or as recorded.",
)
@click.option(
    "--topic",
    "renames",
    multiple=True,
    metavar="WANTED=FOUND",
    help="With --resimulate: the recording's name of a topic.",
)
@click.option(
    "--joint", "joints", multiple=True, metavar="WANTED=FOUND[,FOUND]", help="With --resimulate: joints of a motor."
)
@click.option(
    "--residual", type=click.Path(path_type=Path, dir_okay=False), metavar="FILE",
    help="With --resimulate: correct paths by residual.npz of a diagnosis.",
)  # fmt: skip
@click.option("--namespace", metavar="NAME", help="With --resimulate: of the rover, where there are several.")
@click.pass_obj
def command(ros_args: list[str] | None, bag: Path, resimulate: str | None, drive: bool, **given: Any) -> int:
    """Publish a recording again, drive it again, or simulate it again.

    Messages go out as they were recorded, byte for byte, with the recorded timing and quality of service, and /clock
    with the recording's time. What moves a rover (planned/front_velocity, motor_command_request, cmd_vel, …) stays out
    unless --drive is given; then nothing but that is published, with stamps from now on. CAN frames are played with
    --can alone, and of them only what the drives sent unless --can-frames says otherwise.

    \b
    Examples:
      artibot replay run7 --rate 2 --start 10 --end 30
      artibot replay run7 -t "/odom" -t "/planned/*" --remap /odom:=/recorded/odom --loop
      artibot replay run7 --can vcan0 --can-only
      artibot replay run7 --drive
      artibot replay run7 --resimulate rotations --horizon 5 --out again
    """
    _check_options(resimulate, drive, given)
    if resimulate:
        from artibot_sim.nodes.replay.resimulate import run_resimulation

        return run_resimulation(
            bag, resimulate, given["out"], robot=given["robot"], horizon=given["horizon"],
            back=given["back"] or "auto", renames=given["renames"], joints=given["joints"],
            namespace=given["namespace"], residual=given["residual"], ground=given["ground"],
        )  # fmt: skip
    if given["can_only"]:
        from artibot_sim.experiment.reader import bag_info
        from artibot_sim.nodes.replay.can import play_frames

        return play_frames(bag_info(bag), given, lambda text: click.echo(text, err=True))
    return run(bag, given, drive=drive, ros_args=ros_args or [])


def _check_options(resimulate: str | None, drive: bool, given: dict[str, Any]) -> None:
    """Refuse options that belong to another way to replay than the one asked for."""
    way = "resimulate" if resimulate else "drive" if drive else "play"
    if resimulate and drive:
        raise click.UsageError("--drive and --resimulate: give one of the two")
    for other, names in _ONLY.items():
        used = [name for name in names if given[name] not in (None, False, ())]
        if other != way and used:
            option = "--" + {"renames": "topic", "joints": "joint"}.get(used[0], used[0]).replace("_", "-")
            wanted = f"works only with --{other}" if other != "play" else f"does not work with --{way}"
            raise click.UsageError(f"{option} {wanted}")
    for needs, names in ((given["can"] is None, _WITH_CAN), (given["can_only"], _NOT_WITH_CAN_ONLY)):
        used = [name for name in names if given[name] not in (None, False, ())] if needs else []
        if used:
            wanted = "needs --can CHANNEL" if given["can"] is None else "does not work with --can-only"
            raise click.UsageError(f"--{used[0].replace('_', '-')} {wanted}")
    if resimulate and given["out"] is None:
        raise click.UsageError("--resimulate needs a folder for its results: --out DIR")


def _split(names: Sequence[str]) -> list[str]:
    return [name.strip() for text in names for name in text.split(",") if name.strip()]


def run(bag: Path, given: dict[str, Any], *, drive: bool, ros_args: Sequence[str] = ()) -> int:
    """Publish a recording; return the exit status: 0 at the end and after SIGINT or SIGTERM, 1 if /clock was lost.

    Parameters
    ----------
    bag : folder or file.
    given : options by name, None where absent.
    drive : whether inputs that move a rover are published.
    ros_args : for rclpy.

    Raises
    ------
    ArtibotError
        If the recording cannot be read, has nothing to publish, or subscribers do not come.
    """
    from artibot_sim.experiment.reader import bag_info
    from artibot_sim.nodes.common.process import destroyed, ros_process
    from artibot_sim.nodes.replay.selection import Wish

    info = bag_info(bag)
    if not info.message_count:
        raise ArtibotError(f"{bag}: the recording has no message; record anew, or try `artibot recover`")
    wish = Wish(_split(given["topics"]), _split(given["exclude"]), given["remap"], drive, given["request_from"])
    sim_time = ["--ros-args", "-p", "use_sim_time:=true", "--"] if given["use_sim_time"] else []
    with ros_process("replay", [*sim_time, *ros_args]) as asked:
        import rclpy

        from artibot_sim.nodes.replay.run import drive_again, play

        with destroyed(rclpy.create_node("replay", start_parameter_services=False)) as node:
            return (drive_again if drive else play)(node, info, wish, given, asked)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line `argv` (by default the process's own) and return the exit status."""
    return node_main(command, "replay", argv)


if __name__ == "__main__":
    sys.exit(main())
