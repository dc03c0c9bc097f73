"""`artibot identify`: a robot file with parameters identified from recordings, a table and a page."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from artibot_sim.cli.options import GivenRecordings, gathered, holdout_share_option, reading_options
from artibot_sim.errors import ArtibotError
from artibot_sim.exchange.own_effects import effects_option
from artibot_sim.report.files import fault

if TYPE_CHECKING:
    from artibot_sim.identify import Work

_BAG = click.Path(path_type=Path)
_FILE = click.Path(path_type=Path, dir_okay=False)
_READING = 0.1
"""Share of the time that reading one recording takes, of that for identifying."""

MOST = 400_000
"""Messages that are read at most: 22 minutes of three topics at 100 Hz, twice as long as what is fitted at most."""


@dataclass(frozen=True)
class Outputs:
    """Files to write.

    Attributes
    ----------
    out : Path
        The robot file.
    report, as_json : Path or None
    """

    out: Path
    report: Path | None
    as_json: Path | None

    @property
    def paths(self) -> list[Path]:
        """All of them; the page has a picture beside it."""
        picture = self.report.with_suffix(".png") if self.report else None
        return [path for path in (self.out, self.report, picture, self.as_json) if path is not None]

    def check(self) -> None:
        """Refuse before the work what could not be written after it."""
        for path in self.paths:
            if self.paths.count(path) > 1:
                raise ArtibotError(f"{path}: asked for twice; give each output its own name")
            if why := fault(path):
                raise ArtibotError(f"{path}: cannot be written: {why}")

    def write(self, work: Work) -> None:
        """Write the page, its picture and the JSON, all or none."""
        from artibot_sim.report.files import json_bytes, write_files
        from artibot_sim.report.identification import figure_of, page_of
        from artibot_sim.report.png import render_png

        files: dict[Path, bytes] = {}
        if self.report is not None:
            files[self.report] = page_of(work)
            files[self.report.with_suffix(".png")] = render_png(figure_of(work))
        if self.as_json is not None:
            files[self.as_json] = json_bytes(work.result.as_dict())
        write_files(files)


@click.command("identify")
@click.argument("recordings", nargs=-1, required=True, metavar="BAG [BAG…]", type=_BAG)
@effects_option
@click.option("--robot", required=True, help="Robot name or file; its values are what is assumed beforehand.")
@click.option("--out", required=True, type=_FILE, help="Robot file to write.")
@click.option(
    "--fit", "names", default="k_l,k_t,mu_s,mu_d,u_w", show_default=True,
    help="Parameters, with commas between, as in a robot file: front.i_x, wheel.r_w. 'soil' is the default, 'geometry' "
    "the wheels' radius, its difference between the sides, and where on the robot the tracked body is, 'resistance' "
    "that of the ground to each wheel's motion, 'timing' how late poses are.",
)  # fmt: skip
@click.option(
    "--prior", "priors", multiple=True, metavar="NAME=MIDDLE±SD",
    help="What is known beforehand, SI [the robot file's value ± 40 % for soil, 15 % for geometry]; repeatable.",
)  # fmt: skip
@click.option(
    "--holdout", multiple=True, metavar="BAG", type=_BAG, help="Recording to predict, not to fit; repeatable."
)
@holdout_share_option
@click.option("--window", default=5.0, show_default=True, help="Length of a window, and of a prediction, s.")
@reading_options
@click.option(
    "--report", type=_FILE, help="HTML page with residuals, predictions and free runs; its charts beside it as PNG."
)
@click.option("--json", "as_json", type=_FILE, help="Everything as JSON, in SI units.")
@click.option(
    "--seed", default=0, show_default=True, help="Of all random draws; the same data and seed, the same result."
)
@click.option("--starts", type=click.IntRange(1), help="Places that the search starts from [32].")
@click.option("--scheduler", metavar="tcp://HOST:PORT", help="Search from each on a worker of this Dask cluster.")
@click.option("--workers", type=click.IntRange(1), help="Threads [as many as cores]; the result is the same.")
@gathered(GivenRecordings, "given")
@gathered(Outputs, "outputs")
def command(
    given: GivenRecordings, outputs: Outputs, robot: str, names: str, priors: tuple[str, ...], window: float, seed: int,
    starts: int | None, scheduler: str | None, workers: int | None,
) -> int:  # fmt: skip
    """Identify soil (and geometry) from recordings: values with 95 % intervals, written as a robot file.

    The model is driven by the measured rotations of all motors and held against position, yaw rate, articulation
    and motor torques, whatever of these was recorded. Exit status 0 when parameters were estimated, whatever their
    status; 2 for unusable input.

    \b
    Examples:
      artibot identify run0 run1 --robot agriq --holdout run2 --out field.yaml --report field.html
      artibot identify run0 --robot agriq --fit k_l,k_t,front.i_y --prior front.i_y=0.72±0.03 --out track.yaml
      artibot identify husky_a --robot husky --window 2 --fit soil,geometry,resistance --holdout husky_b \\
        --out grass.yaml
      artibot identify husky_a --robot husky --window 2 --fit k_l,k_t,mu_s,mu_d,effects.motion_resistance.force \\
        --prior effects.motion_resistance.force=50±50 --holdout husky_b --out husky_soil.yaml
    """
    from rich.console import Console

    from artibot_sim.cluster import check_address
    from artibot_sim.identify import Effort, identify, parse_priors
    from artibot_sim.model import load_robot, save_robot
    from artibot_sim.progress import Bar

    effort = Effort(starts=starts or Effort().starts, scheduler=scheduler and check_address(scheduler))
    outputs.check()
    rover, known = load_robot(robot), parse_priors(priors)
    fitted = [name for name in names.split(",") if name.strip()]
    with Bar(total=1.0 + _READING * given.count) as bar:
        used, held = given.read(rover, bar, _READING, MOST)
        work = identify(
            used, rover, fit=fitted, priors=known, holdout=held, window=window, effort=effort,
            seed=seed, workers=workers, progress=bar.stage("identifying", 1.0),
        )  # fmt: skip
    save_robot(work.result.robot, outputs.out)
    outputs.write(work)
    console = Console(highlight=False)
    console.print(work.result)
    for path in outputs.paths:
        console.print(f"wrote {path}", soft_wrap=True)
    return 0
