"""`artibot replay BAG --resimulate …`: the command around `experiment.resimulate`, without ROS."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from artibot_sim.errors import ArtibotError
from artibot_sim.estimation.alignment import on_one_clock, what_was_mended
from artibot_sim.estimation.measurements import noise_levels, stretches
from artibot_sim.estimation.residual_model import MotorSpeeds, Predicted, ResidualModel, grid, load_residual
from artibot_sim.experiment import open_recording, read_bag
from artibot_sim.experiment.columns import Experiment, Floats
from artibot_sim.experiment.measured import Measured
from artibot_sim.experiment.resimulate import Resimulation, StartedWindow, anew, ground_of, resimulate, robot_of
from artibot_sim.experiment.wheels import with_odometry_wheels
from artibot_sim.identify.validation import windows_to_resimulate
from artibot_sim.model import Ground, Robot, Rollout
from artibot_sim.progress import Bar, Report

_SIZES = {"reading": 18.0, "simulating": 9.0, "writing": 6.0, "reading back": 8.0, "drawing": 3.0}
"""Stages, and about how long they take to each other, for the progress bar."""


def run_resimulation(
    bag: Path, drive: str, out: Path, *, robot: str | None = None, horizon: float | None = None, back: str = "auto",
    renames: Sequence[str] = (), joints: Sequence[str] = (), namespace: str | None = None,
    residual: Path | None = None, ground: str | None = None,
) -> int:  # fmt: skip
    """Simulate a recording again, write and print the results; return the exit status 0.

    Parameters
    ----------
    bag : folder or file.
    drive : `rotations` or `commands`.
    out : folder for `simulated` and `metrics.json`.
    robot : name or file; the recording's own if None.
    horizon : s; None for free runs.
    back : `auto`, `kappa` or `effort`.
    renames, joints : `WANTED=FOUND` texts.
    namespace : of the rover, where the recording has several.
    residual : file of a residual model, whose corrections are added to the simulated paths; None for none.
    ground : file or `random:SEED`; the recording's own if None, and flat if it names none.

    Raises
    ------
    ArtibotError
        If the recording or the robot cannot be used, or results exist.
    """
    for made in (out / "metrics.json", out / "simulated"):
        if made.exists():
            raise ArtibotError(f"{made}: exists already; results are never overwritten, give another folder with --out")
    corrections = None if residual is None else load_residual(residual)
    with Bar(sum(_SIZES.values())) as bar:
        reading = _stage(bar, "reading")
        experiment = open_recording(bag, topics=renames, joints=joints, namespace=namespace, progress=reading)
        found = robot_of(experiment, robot)
        experiment = with_odometry_wheels(experiment, found)
        under = ground_of(experiment, ground)
        result = simulated(experiment, found, drive, horizon, back, _stage(bar, "simulating"), under)
        if corrections is not None:
            result = with_residual(result, corrections)
        result.write(out, progress=_stage(bar, "writing"))
        picture = _draw(result, out, bar)
    _print(result)
    for remark in (*experiment.remarks, *result.remarks):
        click.echo(f"note: {remark}", err=True)
    click.echo(f"wrote {out}/simulated, {out}/metrics.json, {picture}")
    return 0


def simulated(
    experiment: Experiment, robot: Robot, drive: str, horizon: float | None, back: str, progress: Report | None = None,
    ground: Ground | None = None,
) -> Resimulation:  # fmt: skip
    """A recording simulated again as `identify` does it, so that both have the same figures.

    Where rotations are given, stamps that are late or early are shifted beforehand, and windows are cut, begun and
    counted as the predictions of a held-out recording. Drives over uneven ground, which `identify` does not fit, begin
    as measured.

    Raises
    ------
    ArtibotError
        As `resimulate`.
    """
    if drive != "rotations" or ground is not None or not _has_both(experiment):
        return resimulate(experiment, robot, drive, horizon=horizon, back=back, ground=ground, progress=progress)
    (timed,) = on_one_clock([experiment], robot, poses="pose_delay" not in robot.effects)
    said = tuple(what_was_mended([timed]))
    begun: list[StartedWindow] | None = None
    if horizon is None:
        noise = noise_levels(stretches(timed.experiment, robot))
    else:
        begun, noise = windows_to_resimulate(timed.experiment, robot, horizon)
    result = resimulate(timed.experiment, robot, drive, horizon=horizon, begun=begun, progress=progress)
    levels = {name: level * (np.sqrt(2.0) if name == "position" else 1.0) for name, level in noise.items()}
    metrics = {name: replace(one, noise=float(levels.get(name, one.noise))) for name, one in result.metrics.items()}
    return replace(result, metrics=metrics, remarks=(*said, *result.remarks))


def _has_both(experiment: Experiment) -> bool:
    """Whether rotations and a way are measured; what a recording without them lacks is said by `resimulate`."""
    return "motor_torques" in experiment.channels and Measured(experiment, 0.0, 0.0).position_source is not None


def with_residual(result: Resimulation, model: ResidualModel) -> Resimulation:
    """A simulation whose paths a residual model corrects: a prediction, of which no cause is known.

    Raises
    ------
    ArtibotError
        If the model corrects another robot, or the recording has no measured heading: simulations then begin with
        courses over ground, which have taken in a part of what is missing, and corrections add it once more.
    """
    if "yaw" not in result.metrics:
        raise ArtibotError(
            f"--residual: {result.experiment.path} measures no heading, and where that comes from the course over "
            "ground corrections make paths worse; do without --residual"
        )
    if model.robot != result.robot.name:
        raise ArtibotError(f"--residual: learned for robot '{model.robot}', but '{result.robot.name}' is simulated")

    def offsets(run: Rollout, before: Rollout) -> Floats:
        joined = [np.concatenate([getattr(one, name) for one in (before, run)]) for name in ("t", "motor_velocity")]
        t = grid(float(run.t[0]), float(run.t[-1]))
        pose, bend = (
            np.column_stack([np.interp(t, run.t, column) for column in table.T])
            for table in (run.pose, run.articulation_yaw[:, None])
        )
        found = model.offsets(MotorSpeeds(joined[0], joined[1][:, list(model.motors)]), Predicted(t, pose, bend[:, 0]))
        return np.column_stack([np.interp(run.t, t, column) for column in found.T])

    pieces = tuple(piece.moved(offsets) for piece in result.pieces)
    remark = "paths are corrected by a residual model: for prediction only, no cause is claimed"
    if result.horizon is None or abs(result.horizon - model.horizon) > 0.5 * model.horizon:
        remark += f"; it was learned from predictions {model.horizon:g} s ahead"
    return anew(result, pieces, remark)


def _stage(bar: Bar, name: str) -> Report:
    return bar.stage(name, _SIZES[name])


def _draw(result: Resimulation, out: Path, bar: Bar) -> Path:
    """Draw the recording and its simulation on top of each other."""
    from artibot_sim.report.figures import experiment_figure
    from artibot_sim.report.files import write_files
    from artibot_sim.report.png import render_png

    simulated = read_bag(out / "simulated", progress=_stage(bar, "reading back"))
    bar.stage("drawing", _SIZES["drawing"])
    figure = experiment_figure([result.experiment, simulated], [result.robot, result.robot])
    write_files({out / "compared.png": render_png(figure)})
    return out / "compared.png"


def _print(result: Resimulation) -> None:
    from rich.console import Console
    from rich.table import Table

    how = "free run" if result.horizon is None else f"windows of {result.horizon:g} s"
    title = f"{result.experiment.name}, {result.robot.name} by its {result.drive}: {how}, {result.windows} starts"
    table = Table(title=title, title_justify="left")
    for column in ("channel", "unit", "rmse", "median", "p90", "noise"):
        table.add_column(column, justify="left" if column in ("channel", "unit") else "right")
    for channel, metric in result.metrics.items():
        numbers: Any = (f"{x:.4g}" for x in (metric.rmse, metric.median, metric.p90, metric.noise))
        table.add_row(channel, metric.unit, *numbers)
    Console().print(table)
