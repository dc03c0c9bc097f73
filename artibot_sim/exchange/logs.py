"""`import_logs`: a contract bag from tables of other loggers, or from a bag with other names, by a columns file."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from artibot_sim.documents import did_you_mean
from artibot_sim.errors import ArtibotError
from artibot_sim.exchange.columns import NEEDED, SILENT, ColumnsFile, ColumnSource, Times
from artibot_sim.exchange.tables import interpolated, raw_channels
from artibot_sim.experiment.columns import Channel, Floats, Stamps
from artibot_sim.experiment.rollout_bag import write_channels
from artibot_sim.experiment.topics import Topic
from artibot_sim.progress import Report

if TYPE_CHECKING:
    import pyarrow as pa

# ----------------------------------------------------------------------
# Sources: tables and the topics of bags.
# ----------------------------------------------------------------------


class TableSource:
    """A CSV or Parquet file."""

    def __init__(self, path: Path) -> None:
        self.path, self.name = path, path.name
        self.table = _read_table(path)
        self.columns = tuple(self.table.column_names)

    def stamps(self, times: Times | None, start_ns: int) -> Stamps:
        """Return the stamps of its rows, ns."""
        import pyarrow as pa

        if times is None:
            raise ArtibotError(f"{self.path}: the columns file names no time; add time: {{column: NAME, unit: s}}")
        if times.column not in self.columns:
            raise ArtibotError(self.lacks(times.column, "time"))
        column = self.table.column(times.column)
        if times.ns == 0.0:
            if not pa.types.is_timestamp(column.type):
                raise ArtibotError(f"{self.path}: column {times.column}: found {column[0]}, expected dates (iso8601)")
            return self._ascending(np.asarray(column.cast(pa.timestamp("ns")).cast(pa.int64())), times.column)
        if pa.types.is_integer(column.type):
            stamps = np.asarray(column.cast(pa.int64())) * np.int64(times.ns)  # exact: 1.7e18 ns do not fit a double
        else:
            stamps = np.rint(self.values(times.column) * times.ns).astype(np.int64)
        return self._ascending(stamps if stamps[0] > 10**17 else stamps + start_ns, times.column)

    def _ascending(self, stamps: Stamps, column: str) -> Stamps:
        back = np.flatnonzero(np.diff(stamps) < 0)
        if len(back):
            row = int(back[0]) + 1
            raise ArtibotError(
                f"{self.path}: row {row + 1}: {column} goes back by {(stamps[row - 1] - stamps[row]) / 1e9:.6g} s; "
                "cut the log there, or sort it"
            )
        return stamps

    def values(self, column: str) -> Floats:
        """Return a column (n,); an empty cell is NaN."""
        import pyarrow as pa

        found = self.table.column(column)
        if not (pa.types.is_floating(found.type) or pa.types.is_integer(found.type) or pa.types.is_null(found.type)):
            row, text = next((i, v.as_py()) for i, v in enumerate(found) if not _is_number(v.as_py()))
            raise ArtibotError(f"{self.path}: row {row + 1}: column {column} is {text!r}; expected a number")
        return np.asarray(found.cast(pa.float64()).fill_null(np.nan))

    def lacks(self, column: str, key: str) -> str:
        """Return what to say where a column is not there."""
        found = ", ".join(self.columns)
        return f"{self.path}: no column '{column}' ({key}){did_you_mean(column, self.columns)}; it has {found}"


def _is_number(value: Any) -> bool:
    try:
        return value is None or math.isfinite(float(value)) or True
    except (TypeError, ValueError):
        return False


def _read_table(path: Path) -> pa.Table:
    """Read a file into a table, columns stripped of blanks.

    Raises
    ------
    ArtibotError
        If it is not there, empty, or no table.
    """
    import pyarrow as pa

    try:
        if path.suffix == ".parquet":
            import pyarrow.parquet as pq

            table = pq.read_table(path)
        else:
            table = _read_csv(path)
    except (pa.ArrowInvalid, UnicodeDecodeError) as error:
        raise ArtibotError(f"{path}: not a table: {error}") from error
    except OSError as error:
        raise ArtibotError(f"{path}: cannot be read: {error.strerror or error}") from error
    if not table.num_rows:
        raise ArtibotError(f"{path}: no row; expected a header line and numbers below it")
    names = [name.strip() for name in table.column_names]
    if twice := {name for name in names if names.count(name) > 1}:
        raise ArtibotError(f"{path}: column {', '.join(sorted(twice))} stands twice in the header")
    return table.rename_columns(names)


def _read_csv(path: Path) -> pa.Table:
    import pyarrow.csv as pc

    with open(path, encoding="utf-8-sig") as stream:
        head = next((line for line in stream if line.strip()), "")
    delimiter = max(",;\t", key=head.count)
    numbers = pc.ConvertOptions(decimal_point="," if delimiter == ";" and _has_commas(path) else ".",
                                null_values=["", "nan", "NaN", "NA", "null", "None"])  # fmt: skip
    return pc.read_csv(path, parse_options=pc.ParseOptions(delimiter=delimiter), convert_options=numbers)


def _has_commas(path: Path) -> bool:
    """Whether numbers of a table with semicolons are written with a comma, as spreadsheets of half of Europe do."""
    with open(path, encoding="utf-8-sig") as stream:
        return any("," in line for _, line in zip(range(20), stream, strict=False))


class TopicSource:
    """One topic of a bag."""

    def __init__(self, path: Path, channel: Channel) -> None:
        self.path, self.name, self.channel = path, channel.topic, channel
        self.columns = tuple(channel.columns)

    def stamps(self, times: Times | None, start_ns: int) -> Stamps:
        """Return the stamps of its messages, ns: a bag has its own."""
        return self.channel.t_ns

    def values(self, column: str) -> Floats:
        """Return a column (n,)."""
        return self.channel[column]

    def lacks(self, column: str, key: str) -> str:
        """Return what to say where a column is not there."""
        close, found = did_you_mean(column, self.columns), ", ".join(self.columns)
        return f"{self.path}: topic {self.name} has no '{column}' ({key}){close}; it has {found}"


Source = TableSource | TopicSource


def _sources(paths: Sequence[Path]) -> list[Source]:
    found: list[Source] = []
    for path in paths:
        if path.is_dir() or path.suffix in (".mcap", ".db3"):
            found += [TopicSource(path, channel) for channel in raw_channels(path)]
        else:
            found.append(TableSource(path))
    return found


# ----------------------------------------------------------------------
# The bag.
# ----------------------------------------------------------------------


@dataclass(frozen=True)
class Imported:
    """What was written: the folder, and rows by topic."""

    folder: Path
    rows: Mapping[str, int]


def import_logs(
    paths: Sequence[Path], columns: ColumnsFile, folder: Path, *, progress: Report | None = None
) -> Imported:
    """Write a contract bag from tables or bags.

    Parameters
    ----------
    paths : CSV or Parquet files, or bags whose topics are called otherwise.
    columns : what their columns are.
    folder : made anew; whole, or not there at all.
    progress : is called now and then with the share that is done.

    Raises
    ------
    ArtibotError
        Naming the file, the column or row, what was found and what was expected.

    Notes
    -----
    Where quantities of one topic come from several sources, those of the others are interpolated to the stamps of the
    first; rows in silences of more than 0.5 s are left out.
    """
    sources = _sources(paths)
    tables = {topic.key: _topic_table(sources, columns, topic, entries) for topic, entries in columns.topics.items()}
    write_channels(folder, tables, {"contract": "2", **columns.metadata}, progress=progress)
    return Imported(folder, {topic.name: len(tables[topic.key][0]) for topic in columns.topics})


def _topic_table(
    sources: Sequence[Source], columns: ColumnsFile, topic: Topic, entries: Mapping[str, ColumnSource]
) -> tuple[Stamps, dict[str, Floats]]:
    """Return the stamps and SI columns of one topic."""
    times = columns.times.get(topic, columns.time)
    places = {name: _place(sources, entry) for name, entry in entries.items()}
    stamps = {id(source): source.stamps(times, columns.start_ns) for source in places.values()}
    base = stamps[id(next(iter(places.values())))]
    found: dict[str, Floats] = {}
    for name, entry in entries.items():
        source = places[name]
        values = entry.factor * (source.values(entry.column) + entry.offset)
        mine = stamps[id(source)]
        if mine is not base:
            there = np.isfinite(values)
            if not there.any():
                raise ArtibotError(f"{entry.key}: column {entry.column} of {source.name} has no number")
            values = interpolated((mine[there] - base[0]) / 1e9, values[there], (base - base[0]) / 1e9)
        found[name] = values
    needed = NEEDED.get(topic.ros_type, ())
    finite = [np.isfinite(found[name]) for name in (needed or found)]
    kept = np.logical_and.reduce(finite) if needed else np.logical_or.reduce(finite)
    if not kept.any():
        raise ArtibotError(f"topics.{topic.name}: no row has {' and '.join(needed) or 'a number'}")
    found |= {name: np.full(len(base), np.nan) for name in SILENT.get(topic.ros_type, ()) if name not in found}
    return base[kept], {name: values[kept] for name, values in found.items()}


def _place(sources: Sequence[Source], entry: ColumnSource) -> Source:
    """Return the source that has an entry's column.

    Raises
    ------
    ArtibotError
        If none has it, or several and none is named.
    """
    named = [source for source in sources if entry.source in ("", source.name)]
    if not named:
        there = ", ".join(source.name for source in sources)
        raise ArtibotError(f"{entry.key}.from: found '{entry.source}', expected one of {there}")
    having = [source for source in named if entry.column in source.columns]
    if len(having) == 1:
        return having[0]
    if having:
        raise ArtibotError(
            f"{entry.key}: column '{entry.column}' is in {', '.join(source.name for source in having)}; "
            "say which with from: NAME"
        )
    if len(named) == 1:
        raise ArtibotError(named[0].lacks(entry.column, entry.key))
    columns = [column for source in named for column in source.columns]
    there = "; ".join(f"{source.name}: {', '.join(source.columns[:6])}" for source in named[:4])
    raise ArtibotError(
        f"{entry.key}: no column '{entry.column}'{did_you_mean(entry.column, columns)}; there are {there}"
    )
