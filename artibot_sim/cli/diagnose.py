"""`artibot diagnose`: what a simulation gets wrong on recordings, why, and what it is worth; as files and a table."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import click

from artibot_sim.cli.options import GivenRecordings, gathered, holdout_share_option, reading_options
from artibot_sim.errors import ArtibotError
from artibot_sim.exchange.own_effects import effects_option
from artibot_sim.report.files import fault_of_folder, write_folder

_BAG = click.Path(path_type=Path)
_READING = 0.05
"""Share of the time that reading one recording takes, of that for diagnosing."""


@click.command("diagnose")
@click.argument("recordings", nargs=-1, required=True, metavar="BAG [BAG…]", type=_BAG)
@effects_option
@click.option("--robot", required=True, help="Robot name or file: what the recordings are held against.")
@click.option("--out", required=True, type=_BAG, help="Folder for the results; made if it is not there.")
@click.option(
    "--holdout", multiple=True, metavar="BAG", type=_BAG,
    help="Recording to predict, not to fit; repeatable [the last of several, or the last third of a single one].",
)  # fmt: skip
@holdout_share_option
@click.option("--horizon", default=5.0, show_default=True, help="How far predictions look ahead in fits and gains, s.")
@reading_options
@click.option("--seed", default=0, show_default=True, help="Of the searches; the same data and seed, the same answer.")
@click.option("--workers", type=click.IntRange(1), help="Threads [as many as cores]; the result is the same.")
@click.option("--scheduler", metavar="tcp://HOST:PORT", help="Fit effects on the workers of this Dask cluster.")
@click.option(
    "--prior-odds", type=click.FloatRange(0.0, min_open=True),
    help="Odds assumed beforehand that some effect is at work [1].",
)  # fmt: skip
@click.option(
    "--false-alarms", "false_alarm_rate", type=click.FloatRange(0.0, 1.0, min_open=True, max_open=True),
    help="Share of recordings with nothing hidden in which an effect may be named, at most [0.01].",
)  # fmt: skip
@click.option("--residual", is_flag=True, help="Write residual.npz, learned without physics, if it predicts better.")
@click.option(
    "--budget",
    type=click.FloatRange(0.0, min_open=True),
    metavar="SECONDS",
    help="Time for all of it, about; what was not tried for it is said [none].",
)
@gathered(GivenRecordings, "given")
def command(given: GivenRecordings, robot: str, out: Path, scheduler: str | None, **asked: Any) -> int:
    """Find what the simulation gets wrong on recordings, where and when, which physical effect it is, how sure that
    is, and what it gains.

    The soil is identified first, so that only what no soil explains counts. Then every effect of the vocabulary is
    tried. Writes into the folder: report.html (open it in a browser), diagnosis.json, extended.yaml (a robot file:
    artibot sim --robot OUT/extended.yaml), baseline.yaml (the same without effects), best.yaml (what predicts held-out
    recordings best, whatever is claimed) and details.npz. Several
    recordings of different manoeuvres tell more than one long one. With scikit-learn it says as well how much any
    model could explain. Exit status 0 when a diagnosis was made, whatever it says; 2 for unusable input.

    \b
    Examples:
      artibot diagnose run0 run1 run2 --robot agriq --out found
      artibot diagnose run0 run1 --holdout run2 --robot field.yaml --out found --horizon 3
      artibot diagnose run0 --holdout-share 0.5 --robot field.yaml --out found
      artibot diagnose husky_a --holdout husky_b --robot husky --horizon 2 --out husky
    """
    from rich.console import Console

    from artibot_sim.checkpoints import Checkpoints
    from artibot_sim.cluster import check_address
    from artibot_sim.diagnose import Options, diagnose
    from artibot_sim.estimation.boosting import MISSING, can_grow
    from artibot_sim.model import load_robot
    from artibot_sim.progress import Bar
    from artibot_sim.report.diagnosis.files import files_of
    from artibot_sim.report.diagnosis.page import page_of
    from artibot_sim.report.diagnosis.terminal import printed
    from artibot_sim.version import __version__

    if why := fault_of_folder(out):
        raise ArtibotError(f"--out {out}: cannot be written: {why}")
    rover, parts = load_robot(robot), Checkpoints(out.with_name(f"{out.name}.unfinished"))
    options = Options(
        scheduler=scheduler and check_address(scheduler), parts=parts,
        **{name: value for name, value in asked.items() if value is not None},
    )  # fmt: skip
    with parts.announced(partial(click.echo, err=True)), Bar(total=1.0 + _READING * given.count, kept=True) as bar:
        used, held = given.read(rover, bar, _READING)
        found = diagnose(used, rover, holdout=held, options=options, progress=bar.stages(1.0))
    write_folder(out, files_of(found, page_of(found, __version__)))
    parts.done()
    if parts.taken:
        click.echo(f"note: went on from what an earlier call had finished ({parts.taken} of its parts)", err=True)
    console = Console(highlight=False)
    console.print(printed(found))
    if not can_grow():
        click.echo(f"note: how much is explainable at all is not said: {MISSING}", err=True)
    if options.residual and found.residual is None:
        click.echo("note: no residual.npz: nothing that was learned surely predicts better", err=True)
    beside = "diagnosis.json, extended.yaml and best.yaml" if found.best_robot else "diagnosis.json and extended.yaml"
    console.print(f"wrote {out / 'report.html'} and, beside it, {beside}", soft_wrap=True)
    return 0
