"""The results as a Parquet table: one row a run."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from artibot_sim.errors import ArtibotError
from artibot_sim.sweep.axes import Value

RUN, STATUS, MESSAGE = "run", "status", "message"
OK = "ok"
ROWS = 50_000
"""Rows of a group in the finished table."""
_OPTIONS: dict[str, Any] = {"compression": "zstd", "version": "2.6"}


def table_bytes(
    first: int,
    columns: Mapping[str, Sequence[Value]],
    text: Sequence[str],
    measures: Sequence[str],
    found: Sequence[Mapping[str, float]],
    status: Sequence[str],
    message: Sequence[str],
) -> bytes:
    """Runs from number `first` on as Parquet: their number, parameters, measures (null where absent), status."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    count = len(status)
    arrays = {RUN: pa.array(range(first, first + count), pa.int64())}
    for key, values in columns.items():
        arrays[key] = pa.array(values, pa.string() if key in text else pa.float64())
    for name in measures:
        arrays[name] = pa.array([row.get(name) for row in found], pa.float64())
    arrays |= {STATUS: pa.array(status, pa.string()), MESSAGE: pa.array(message, pa.string())}
    stream = io.BytesIO()
    pq.write_table(pa.table(arrays), stream, **_OPTIONS)
    return stream.getvalue()


def merge(parts: Sequence[Path], target: Path) -> None:
    """Write the parts' rows, in order, as one table with groups of `ROWS` rows: the same bytes however it was cut.

    Raises
    ------
    ArtibotError
        Naming a part that is damaged.
    OSError
        Where the target cannot be written.
    """
    import pyarrow.parquet as pq

    with open(target, "wb") as stream:
        writer = None
        for table in _regrouped(parts):
            writer = writer or pq.ParquetWriter(stream, table.schema, **_OPTIONS)
            writer.write_table(table, row_group_size=ROWS)
        if writer is not None:
            writer.close()


def _regrouped(parts: Sequence[Path]) -> Iterator[Any]:
    """The rows of all parts in tables of `ROWS` rows."""
    import pyarrow as pa

    held: list[Any] = []
    rows = 0
    for part in parts:
        table = _read(part)
        held.append(table)
        rows += table.num_rows
        while rows >= ROWS:
            joined = pa.concat_tables(held).combine_chunks()
            yield joined.slice(0, ROWS)
            held, rows = [joined.slice(ROWS)], rows - ROWS
    if rows:
        yield pa.concat_tables(held).combine_chunks()


def _read(path: Path) -> Any:
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        return pq.read_table(path)
    except (pa.ArrowInvalid, OSError) as error:
        raise ArtibotError(
            f"{path}: damaged ({str(error).splitlines()[0]}); remove it and run the sweep again, which makes it anew"
        ) from error


def groups(path: Path, columns: Sequence[str] | None = None) -> Iterator[dict[str, Any]]:
    """The table in pieces of at most `ROWS` rows: columns as NumPy arrays, by name (null numbers are NaN)."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with pq.ParquetFile(path) as file:
            for i in range(file.num_row_groups):
                table = file.read_row_group(i, columns=None if columns is None else list(columns))
                yield {name: table[name].to_numpy() for name in table.column_names}
    except (pa.ArrowInvalid, FileNotFoundError) as error:
        raise ArtibotError(f"{path}: not a table of a sweep ({str(error).splitlines()[0]})") from error
