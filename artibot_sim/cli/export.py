"""`artibot export`: recordings as tables, for other programs."""

from __future__ import annotations

from pathlib import Path

import click

from artibot_sim.errors import ArtibotError

_TABLES = ("csv", "parquet")


@click.command("export", context_settings={"help_option_names": ["-h", "--help"]})
@click.argument("source", metavar="BAG")
@click.option("--to", "form", required=True, type=click.Choice(_TABLES), help="Format to write.")
@click.option("-o", "--out", type=click.Path(path_type=Path), help="Folder, or file with --rate [NAME_csv, NAME.csv].")
@click.option("--rate", type=float, help="One table at so many rows a second, instead of one a topic.")
@click.option(
    "--all", "everything", is_flag=True, help="Also topics that artibot does not read, by their fields' names."
)
@click.option(
    "--topic", "topics", multiple=True, metavar="WANTED=FOUND", help="Read topic FOUND as WANTED; repeatable."
)
@click.option("--namespace", metavar="NAME", help="Rover whose topics to read, where there are several: /rover1.")
def command(
    source: str, form: str, out: Path | None, rate: float | None, everything: bool, topics: tuple[str, ...],
    namespace: str | None,
) -> None:  # fmt: skip
    """Write a recording as tables: one a topic, each with its own stamps, or one joined at a rate.

    Every table begins with the time since the recording's start (s) and the header stamp (ns); all quantities are
    SI, with the unit in a CSV's header and in the metadata of a Parquet file's columns. Beside the tables of topics
    stands columns.yaml, with which `artibot import` makes the recording again.

    \b
    Examples:
      artibot export run7 --to csv                      # run7_csv/motor_torques.csv, …
      artibot export run7 --to parquet --rate 50 -o run7.parquet
      artibot export husky.db3 --to csv --all --topic /ground_truth/odom=/lidar/odom
    """
    _export_recording(Path(source), form, out, rate, everything, topics, namespace)


def _export_recording(
    path: Path, form: str, out: Path | None, rate: float | None, everything: bool, topics: tuple[str, ...],
    namespace: str | None,
) -> None:  # fmt: skip
    from artibot_sim.exchange.tables import joined_table, raw_channels, tables_of_topics
    from artibot_sim.experiment import parse_renames, read_bag
    from artibot_sim.experiment.storage import recording_name
    from artibot_sim.experiment.writer import whole_folder
    from artibot_sim.progress import Bar
    from artibot_sim.report.files import fault, write_files

    if rate is not None and everything:
        raise ArtibotError("--rate and --all: a joined table has only topics that artibot reads; leave one out")
    target = out or Path(f"{recording_name(path)}.{form}" if rate is not None else f"{recording_name(path)}_{form}")
    if rate is not None and (why := fault(target)):
        raise ArtibotError(f"{target}: cannot be written: {why}")
    with Bar() as bar:
        stage = bar.stage(f"reading {path.name}", 1.0)
        experiment = read_bag(path, parse_renames(topics), namespace=namespace, progress=stage)
    if rate is not None:
        write_files({target: joined_table(experiment, form, rate)})
        click.echo(f"wrote {target}")
        return
    read = {channel.topic for channel in experiment.channels.values()}
    others = raw_channels(path, set(experiment.topics) - read) if everything else []
    files = tables_of_topics(experiment, form, others)
    with whole_folder(target) as partial:
        partial.mkdir()
        for name, content in files.items():
            (partial / name).write_bytes(content)
    for name in files:
        click.echo(f"wrote {target / name}")
