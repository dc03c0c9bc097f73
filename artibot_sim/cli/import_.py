"""`artibot import`: a recording from tables of other loggers, or from a bag with other names."""

from __future__ import annotations

from pathlib import Path

import click


@click.command("import")
@click.argument("logs", nargs=-1, required=True, metavar="LOG [LOG…]", type=click.Path(path_type=Path))
@click.option("--columns", required=True, help="Columns file: what the logs' columns are and their units.")
@click.option("-o", "--out", type=click.Path(path_type=Path), help="Folder to write [name of the first log].")
def command(logs: tuple[Path, ...], columns: str, out: Path | None) -> None:
    """Make a recording of CSV or Parquet files, or of a bag whose topics, joints or types are other ones.

    The columns file says for each topic and quantity which column it comes from, in which unit; the time of CSV files
    is a column, too. Columns of a bag are the fields of its messages (`data`, `front_left_wheel.velocity`, as
    `artibot export --all` shows them), and `from: /topic` says of which. What comes from several logs is brought to the
    stamps of the first.

    \b
    Examples:
      artibot import log.csv --columns columns.yaml --out run7
      artibot import motors.csv station.csv --columns rover_log --out run8   # config/columns/rover_log.yaml
      artibot import run7_csv/*.csv --columns run7_csv/columns.yaml --out again
      artibot import husky.db3 --columns joints.yaml --out husky_named
    """
    from artibot_sim.errors import ArtibotError
    from artibot_sim.exchange.columns import load_columns
    from artibot_sim.exchange.logs import import_logs
    from artibot_sim.progress import Bar

    target = out or Path(logs[0].stem)
    if target.exists():
        raise ArtibotError(f"{target}: exists already; recordings are never overwritten, give another name with --out")
    with Bar() as bar:
        found = import_logs(logs, load_columns(columns), target, progress=bar.stage("writing", 1.0))
    for topic, rows in found.rows.items():
        click.echo(f"{topic:28}{rows:9} messages")
    click.echo(f"wrote {found.folder}; see what it is good for: artibot inspect {found.folder}")
