"""``artibot odometry`` and ``ros2 run artibot_sim odometry``: odometry through the model, live or on a recording."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from artibot_sim.errors import ArtibotError
from artibot_sim.exchange.own_effects import effects_option
from artibot_sim.nodes.common.options import BoundedNumber, parameter_files
from artibot_sim.nodes.common.process import built, node_main, run_events
from artibot_sim.report.files import OutputFile, json_bytes, write_files

_DELAY = BoundedNumber(min=-1.0, max=1.0)
_OFFLINE = ("fit", "window", "pose_delay", "as_json", "renames", "joints", "namespace")


@click.command("odometry", context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.argument("bag", required=False, type=click.Path(path_type=Path))
@effects_option
@click.option("--robot", help="Robot as identified: a name, or a robot file.  [default: agriq; with BAG: its own]")
@click.option(
    "--kappa", type=BoundedNumber(min=0, max=1), help="Front share of the torque, where back rotations are unknown."
)
@click.option(
    "--rotation-delay", type=_DELAY, help="By which rotations are stamped late, s.  [default: the robot file's]"
)
@click.option("--gyro-delay", type=_DELAY, help="By which yaw rates are stamped late, s.  [default: the robot file's]")
@click.option("--fit", type=click.Path(path_type=Path), help="With BAG: fit track and covariance here.  [first half]")
@click.option("--window", type=BoundedNumber(min=0, min_open=True), help="With BAG: way of a window, m.  [default: 10]")
@click.option(
    "--pose-delay",
    type=_DELAY,
    help="With BAG: by which reference poses are stamped late, s.  [default: the robot file's]",
)
@click.option("--json", "as_json", type=OutputFile(), help="With BAG: write the table as JSON.")
@click.option("--topic", "renames", multiple=True, metavar="WANTED=FOUND", help="With BAG: the name of a topic in it.")
@click.option("--joint", "joints", multiple=True, metavar="WANTED=FOUND[,FOUND]", help="With BAG: joints of a motor.")
@click.option("--namespace", metavar="NAME", help="With BAG: of the rover, where there are several.")
@click.option("--params", multiple=True, metavar="FILE", help="Live: parameter file.")
@click.option("--publish-tf/--no-tf", default=None, help="Live: publish odom -> base_link.  [default: no]")
@click.pass_obj
def command(ros_args: list[str] | None, bag: Path | None, params: tuple[str, ...], **given: Any) -> int:
    """Say where a rover is from its motors' rotations, through its identified model.

    Live it listens to motor_torques, imu/data and joint_states, and publishes odom_model with covariance. With BAG, a
    recording with a reference, it measures how far odometry goes astray: by wheels with nominal and with fitted track,
    and through the model, without gyroscope and with it.

    \b
    Examples:
      artibot odometry --robot identified.yaml --publish-tf
      artibot odometry run7 --robot identified.yaml --fit run6
      artibot odometry --robot agriq --ros-args -r __ns:=/rover1 -p frame_prefix:=rover1/
    """
    if bag is None:
        used = [name for name in _OFFLINE if given[name] not in (None, ())]
        if used:
            option = {"as_json": "json", "renames": "topic", "joints": "joint"}.get(used[0], used[0]).replace("_", "-")
            raise click.UsageError(f"--{option} needs a recording: artibot odometry BAG --{option} …")
        live = ("robot", "kappa", "rotation_delay", "gyro_delay", "publish_tf")
        overrides = {name: given[name] for name in live if given[name] is not None}
        return run(overrides, [*parameter_files(params), *(ros_args or [])])
    if params or given["publish_tf"] is not None:
        raise click.UsageError("--params and --publish-tf are for the node: leave the recording out")
    return measure(bag, given)


def run(overrides: dict[str, Any], ros_args: Sequence[str] = ()) -> int:
    """Run the node until SIGINT or SIGTERM; return the exit status 0.

    Raises
    ------
    ArtibotError
        When a parameter or the robot is refused.
    """

    def make(asked: list[int]) -> Any:
        from artibot_sim.nodes.odometry.node import OdometryNode

        return built(OdometryNode, overrides, asked)

    return run_events("odometry", ros_args, make)


def measure(bag: Path, given: dict[str, Any]) -> int:
    """Print the errors of odometry on a recording, each beside the others; return the exit status 0.

    Raises
    ------
    ArtibotError
        When the recording has no rotations, no reference, or too few windows to fit and to measure.
    """
    from artibot_sim.estimation import odometry_check as check
    from artibot_sim.estimation.checks.recordings import require_fitting_wheels
    from artibot_sim.estimation.model_odometry import ModelOdometry, StreamProperties
    from artibot_sim.experiment import open_recording
    from artibot_sim.experiment.resimulate import robot_of
    from artibot_sim.progress import Bar

    named = {"topics": given["renames"], "joints": given["joints"], "namespace": given["namespace"]}
    experiment = open_recording(bag, **named)
    robot = robot_of(experiment, given["robot"])
    require_fitting_wheels([experiment], robot)
    delays = {
        name: getattr(robot.sensors, name) if given[name] is None else given[name]
        for name in ("rotation_delay", "gyro_delay", "pose_delay")
    }
    streams = StreamProperties(
        rotation_delay=delays["rotation_delay"], gyro_delay=delays["gyro_delay"],
        articulation_delay=robot.sensors.articulation_delay,
    )  # fmt: skip
    settings = check.OdometrySettings(
        given["window"] or check.LENGTH, streams, delays["pose_delay"], None, given["kappa"]
    )
    with Bar() as bar:
        found = check.pieces(experiment, robot, settings, bar.stage(f"odometry of {bag.name}", 1.0))
        if given["fit"] is not None:
            other = open_recording(given["fit"], **named)
            fit = check.pieces(other, robot, settings, bar.stage(f"odometry of {given['fit'].name}", 1.0))
        else:
            other = experiment
            fit, found = found[: len(found) // 2], found[len(found) // 2 :]
        if not fit or not found:
            raise ArtibotError(f"{bag}: only one window; give a shorter --window, or another recording with --fit")
        short = check.windows_for_covariance(other, robot, settings, fit, bar.stage("shorter windows", 1.0))
    track, factors = check.fitted_track(fit, robot), check.fitted_factors(short)
    sides = check.fitted_sides(short, robot)
    rows = check.rows(found, robot, track, sides, factors)
    slip = ModelOdometry.SLIP.times(factors["model"])
    click.echo(check.as_text(rows, len(found), len(fit), len(short)))
    for remark in check.remarks(fit, found, robot, track, sides):
        click.echo(remark)
    click.echo(
        f"for the node: odometry.travel_slip {slip.travel:.3g}, odometry.turn_slip {slip.turn:.3g}, "
        f"odometry.side_slip {slip.side:.3g}"
    )
    if given["as_json"] is not None:
        table = {row.name: row.as_dict() for row in rows}
        counts = {"windows": len(found), "fitted_on": len(fit), "covariances_fitted_on": len(short)}
        text = {"recording": str(bag), **counts, "track": track, "odometry": table}
        write_files({given["as_json"]: json_bytes(text)})
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line `argv` (by default the process's own) and return the exit status."""
    return node_main(command, "odometry", argv)


if __name__ == "__main__":
    sys.exit(main())
