"""The recordings in ``bags/``: small, simulated, and always the same.

>>> python -m artibot_sim.experiment.reference_bags bags              # doctest: +SKIP
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import click

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment.rollout_bag import write_experiment

COMMAND: Final = "python -m artibot_sim.experiment.reference_bags bags"
KAPPA: Final = 0.8
STEP: Final = 1e-3
"""Integration step, s."""
EVERY: Final = 20
"""Steps between two rows: 50 Hz keeps both bags small and shows everything the model does on the path."""
PROFILE_DT: Final = 0.02
"""Interval of the planned profile's points, s: the rows' own."""
REST: Final = 1.0
"""How long the rover stands at the end, s: it is there where eq. 32 compares it."""


class ReferenceBag(NamedTuple):
    """A recording in ``bags/``."""

    robot: str
    manoeuvre: str
    description: str


REFERENCES: Final = {
    "table6_agriq": ReferenceBag("agriq", "table6_agriq", "Table 6 trajectory of Agri.q, simulated on flat ground"),
    "table6_epiq": ReferenceBag("epiq", "table6_epiq", "Table 6 trajectory of Epi.q, simulated on flat ground"),
}
"""Folder's name → what is in it."""


def write_reference(name: str, folder: Path) -> Path:
    """Simulate and write one reference recording.

    Parameters
    ----------
    name : str
        Key of `REFERENCES`.
    folder : Path
        Made anew.

    Raises
    ------
    ArtibotError
        If the folder exists, or the rollout did not end well.
    """
    from artibot_sim.model import Status, load_robot, rollout
    from artibot_sim.planning import load_manoeuvre, plan

    reference = REFERENCES[name]
    robot = load_robot(reference.robot).replace({"control.kappa": KAPPA})
    planned = plan(load_manoeuvre(reference.manoeuvre), robot, dt=PROFILE_DT)
    result = rollout(robot, planned.commands(), dt=STEP, every=EVERY, duration=round(planned.duration + REST, 2))
    if result.status is not Status.OK:
        raise ArtibotError(f"{name}: the rollout ended as {result.status.name} ({result.message})")
    return write_experiment(folder, result, planned, robot, metadata={"description": reference.description})


def write_all(folder: Path) -> list[Path]:
    """Write all reference recordings into `folder`, each in place of the one that is there.

    An old one goes only when its successor is whole.
    """
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    with tempfile.TemporaryDirectory(dir=folder, prefix=".new-") as scratch:
        for name in REFERENCES:
            made = write_reference(name, Path(scratch) / name)
            shutil.rmtree(folder / name, ignore_errors=True)
            written.append(made.rename(folder / name))
    return written


@click.command("reference_bags", context_settings={"help_option_names": ["-h", "--help"]})
@click.argument("folder", type=click.Path(file_okay=False, path_type=Path))
def command(folder: Path) -> None:
    """Make the reference recordings again, in FOLDER.

    \b
    Example:
      python -m artibot_sim.experiment.reference_bags bags
    """
    for bag in write_all(folder):
        size = sum(path.stat().st_size for path in bag.iterdir())
        click.echo(f"{bag}: {size / 1e6:.2f} MB, {REFERENCES[bag.name].description}")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    try:
        command.main(args=list(sys.argv[1:] if argv is None else argv), standalone_mode=False)
    except ArtibotError as error:
        print(f"reference_bags: {error}", file=sys.stderr)
        return 2
    except click.ClickException as error:
        error.show()
        return error.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(main())
