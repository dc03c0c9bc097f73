"""A recording as tables for other programs: CSV or Parquet, one a topic with its own stamps, or one at a rate."""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from artibot_sim.errors import ArtibotError
from artibot_sim.exchange.columns import STAMP, columns_file
from artibot_sim.experiment.columns import SEGMENT_GAP, Channel, Experiment, Floats
from artibot_sim.experiment.messages import ONE_ROW, READABLE, Decoder, decoder, time_ns, unit_of
from artibot_sim.experiment.reader import bag_info
from artibot_sim.experiment.storage import ChannelInfo, iter_messages
from artibot_sim.experiment.topics import BY_KEY

if TYPE_CHECKING:
    import pyarrow as pa

FORMATS = ("csv", "parquet")
"""Formats of tables."""

TIME = "time"
"""First column of every table, s since the recording's start; the second is the header stamp in ns."""

COLUMNS_FILE = "columns.yaml"
"""What is written beside the tables of a recording: `artibot import` makes the bag again with it."""

HELD = ("motor_command", "motor_command_request", "cmd_vel")
"""Channels that are given rather than measured: a value counts until the next."""

_PROFILES = ("planned_path", "planned_front_velocity", "clock", "diagnostics")
"""Channels that are no samples in time of something continuous: left out of a joined table."""

_LONGEST_ARRAY = 64
"""Numbers of an array field of a message that artibot has no columns for; longer ones (images, scans) are left out."""


# ----------------------------------------------------------------------
# Topics that artibot does not read, as columns named after their fields.
# ----------------------------------------------------------------------


def raw_channels(path: Path | str, topics: Iterable[str] | None = None) -> list[Channel]:
    """Return the numbers of any topics as channels whose columns are named after the message's fields.

    Parameters
    ----------
    path : recording.
    topics : names as recorded; all if None.

    Returns
    -------
    list of Channel
        Units are those of types that artibot knows, else empty. Times are header stamps, of reception where there is
        none. `t` counts from the first stamp of all. Topics without a number are left out.
    """
    info = bag_info(path)
    wanted = {channel.topic for channel in info.channels if channel.encoding == "cdr"}
    if topics is not None:
        wanted &= set(topics)
    decoders: dict[ChannelInfo, Decoder] = {}
    rows: dict[str, list[tuple[int, int, dict[str, float]]]] = {}
    known: dict[str, bool] = {}
    for message in iter_messages(path, wanted):
        channel = message.channel
        if channel not in decoders:
            decoders[channel] = decoder(
                channel.ros_type, channel.definition, channel.definition_encoding, channel.type_hash
            )
        content = decoders[channel](message.data)
        known[channel.topic] = channel.ros_type in ONE_ROW
        row = ONE_ROW[channel.ros_type](content) if known[channel.topic] else numbers_of(content)
        header = getattr(content, "header", None)
        stamp = time_ns(header.stamp) if header is not None else 0
        if row:
            rows.setdefault(channel.topic, []).append((stamp or message.log_ns, message.log_ns, row))
    start = min((stamp for table in rows.values() for stamp, _, _ in table), default=0)
    return [_raw_channel(topic, rows[topic], start, known[topic]) for topic in sorted(rows)]


def _raw_channel(topic: str, rows: list[tuple[int, int, dict[str, float]]], start: int, known: bool) -> Channel:
    rows = sorted(rows, key=lambda row: row[0])
    names = list(dict.fromkeys(name for _, _, row in rows for name in row))
    columns = {name: np.array([row.get(name, np.nan) for _, _, row in rows]) for name in names}
    stamps = np.array([stamp for stamp, _, _ in rows], np.int64)
    units = {name: unit_of(name) if known else "" for name in names}
    received = np.array([log for _, log, _ in rows], np.int64)
    return Channel(topic, stamps, (stamps - start) / 1e9, received, columns, units)


def numbers_of(message: Any, prefix: str = "") -> dict[str, float]:
    """Return every number of a message, named by its path: `twist.linear.x`, `ranges[0]`; headers are left out."""
    found: dict[str, float] = {}
    for entry in dataclasses.fields(message):
        if entry.name in ("header", "__msgtype__"):
            continue
        _add(found, f"{prefix}{entry.name}", getattr(message, entry.name))
    return found


def _add(found: dict[str, float], name: str, value: Any) -> None:
    if isinstance(value, bool | int | float | np.number):
        found[name] = float(value)
    elif dataclasses.is_dataclass(value):
        found |= numbers_of(value, f"{name}.")
    elif isinstance(value, list | np.ndarray) and len(value) <= _LONGEST_ARRAY:
        for i, each in enumerate(value):
            _add(found, f"{name}[{i}]", each)


# ----------------------------------------------------------------------
# Tables.
# ----------------------------------------------------------------------


def table_of(channel: Channel) -> pa.Table:
    """Return a channel as a table: time, stamp and its columns; NaN is empty, units stand in the fields' metadata."""
    return _table({STAMP: channel.t_ns}, channel.t, channel.columns, channel.units)


def _table(
    before: Mapping[str, np.ndarray], t: Floats, columns: Mapping[str, Floats], units: Mapping[str, str]
) -> pa.Table:
    import pyarrow as pa

    names = [TIME, *before, *columns]
    arrays = [pa.array(t), *(pa.array(values) for values in before.values())]
    arrays += [pa.array(values, from_pandas=True) for values in columns.values()]  # NaN: not measured
    of = {TIME: "s", STAMP: "ns", **units}
    fields = [
        pa.field(name, array.type, metadata={"unit": of.get(name, "")})
        for name, array in zip(names, arrays, strict=True)
    ]
    return pa.Table.from_arrays(arrays, schema=pa.schema(fields))


def joined(experiment: Experiment, rate: float) -> pa.Table:
    """Return all measured channels at common times, `rate` a second, within the recording's segments.

    Measured quantities are linear between their samples; commands hold the value given last. Where a topic was silent
    for more than 0.5 s there is no value. Columns are named `channel/quantity`; `segment` counts from 0.

    Raises
    ------
    ArtibotError
        If the rate is not positive.
    """
    if not (np.isfinite(rate) and rate > 0):
        raise ArtibotError(f"--rate {rate:g}: expected a positive number of rows a second")
    grids = [first + np.arange(int((last - first) * rate + 1e-6) + 1) / rate for first, last in experiment.segments]
    t = np.concatenate(grids)
    segment = np.repeat(np.arange(len(grids)), [len(grid) for grid in grids])
    columns: dict[str, Floats] = {}
    units: dict[str, str] = {}
    for key, channel in experiment.channels.items():
        if key in _PROFILES:
            continue
        for name in channel.columns:
            times, values = channel.series(name)
            if len(times):
                columns[f"{key}/{name}"] = resampled(times, values, t, segment, experiment.segments, key in HELD)
                units[f"{key}/{name}"] = channel.units.get(name, "")
    stamps = experiment.start_ns + np.rint(t * 1e9).astype(np.int64)
    return _table({STAMP: stamps, "segment": segment}, t, columns, units)


def resampled(
    times: Floats, values: Floats, at: Floats, segment: np.ndarray, segments: Iterable[tuple[float, float]], held: bool
) -> Floats:
    """Return the values (m,) of samples (n,) at times `at`, each within its segment; NaN where there are none."""
    found = np.full(len(at), np.nan)
    for number, (first, last) in enumerate(segments):
        mine = (times >= first - 1e-6) & (times <= last + 1e-6)
        wanted = segment == number
        if mine.any():
            found[wanted] = interpolated(times[mine], values[mine], at[wanted], held)
    return found


def interpolated(times: Floats, values: Floats, at: Floats, held: bool = False) -> Floats:
    """Return samples (n,) at other times (m,): linear, or the last one given; NaN in silences of more than 0.5 s."""
    right = np.clip(np.searchsorted(times, at, side="left"), 0, len(times) - 1)
    left = np.clip(np.searchsorted(times, at + 1e-9, side="right") - 1, 0, len(times) - 1)
    outside = (at < times[0] - 1e-6) | (at > times[-1] + (SEGMENT_GAP if held else 1e-6))
    silent = (at - times[left] if held else times[right] - times[left]) > SEGMENT_GAP
    value = values[left] if held else np.interp(at, times, values)
    return np.where(outside | silent, np.nan, value)


def encoded(table: pa.Table, form: str, metadata: Mapping[str, str]) -> bytes:
    """Return a table as the bytes of a file.

    Parameters
    ----------
    table : as `table_of` and `joined` make them.
    form : `csv` (the header says `name [unit]`) or `parquet` (each field has a `unit` in its metadata).
    metadata : strings kept in a Parquet file's own metadata.
    """
    sink = io.BytesIO()
    if form == "csv":
        import pyarrow.csv as pc

        pc.write_csv(table.rename_columns([_titled(entry) for entry in table.schema]), sink)
    else:
        import pyarrow.parquet as pq

        pq.write_table(table.replace_schema_metadata(dict(metadata)), sink, compression="zstd")
    return sink.getvalue()


def _titled(entry: pa.Field) -> str:
    unit = entry.metadata[b"unit"].decode()
    return f"{entry.name} [{unit}]" if unit else str(entry.name)


# ----------------------------------------------------------------------
# Files of a recording.
# ----------------------------------------------------------------------


def tables_of_topics(experiment: Experiment, form: str, others: Iterable[Channel] = ()) -> dict[str, bytes]:
    """Return the files of a recording by name: one a topic, and the columns file that makes a bag of them again.

    Parameters
    ----------
    experiment : the recording.
    form : one of FORMATS.
    others : channels of topics that artibot does not read.
    """
    _check_form(form)
    kept = {"recording": experiment.name, "start_ns": str(experiment.start_ns), **experiment.metadata}
    files: dict[str, bytes] = {}
    for key, channel in experiment.channels.items():
        files[f"{key}.{form}"] = encoded(table_of(channel), form, kept | {"topic": channel.topic})
    for channel in others:
        name = channel.topic.strip("/").replace("/", "_")
        files[f"{name}.{form}"] = encoded(table_of(channel), form, kept | {"topic": channel.topic})
    files[COLUMNS_FILE] = columns_file(experiment, form).encode()
    return files


def joined_table(experiment: Experiment, form: str, rate: float) -> bytes:
    """Return the file of a joined table."""
    _check_form(form)
    kept = {"recording": experiment.name, "start_ns": str(experiment.start_ns), **experiment.metadata}
    return encoded(joined(experiment, rate), form, kept | {"rate": f"{rate:g}"})


def _check_form(form: str) -> None:
    if form not in FORMATS:
        raise ArtibotError(f"format '{form}': unknown for a recording; expected one of {', '.join(FORMATS)}")


assert set(HELD) | set(_PROFILES) <= set(BY_KEY)
assert set(ONE_ROW) <= READABLE
