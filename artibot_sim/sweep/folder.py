"""The folder of a sweep: manifest, finished parts, the Parquet table; safe against being killed at any time."""

from __future__ import annotations

import contextlib
import fcntl
import io
import json
import math
import os
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from artibot_sim.cluster import identity
from artibot_sim.errors import ArtibotError
from artibot_sim.sweep.axes import Value, unit_of
from artibot_sim.sweep.measures import MEASURES
from artibot_sim.sweep.plan import SweepPlan

# ----------------------------------------------------------------------
# The results as a Parquet table: one row a run.
# ----------------------------------------------------------------------


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


def groups(path: Path) -> Iterator[dict[str, Any]]:
    """The table in pieces of at most `ROWS` rows: columns as NumPy arrays, by name (null numbers are NaN)."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with pq.ParquetFile(path) as file:
            for i in range(file.num_row_groups):
                table = file.read_row_group(i)
                yield {name: table[name].to_numpy() for name in table.column_names}
    except (pa.ArrowInvalid, FileNotFoundError) as error:
        raise ArtibotError(f"{path}: not a table of a sweep ({str(error).splitlines()[0]})") from error


# ----------------------------------------------------------------------
# The folder of a sweep: manifest, finished parts, the table; safe against being killed at any time.
#
# ``sweep.json`` says what is computed and by which artibot, ``parts/`` holds finished chunks, ``runs.parquet`` the
# whole when all are done. Every file is written under another name and renamed, so what is there is whole.
# ----------------------------------------------------------------------


SCHEMA = "artibot/sweep/1"
MANIFEST, TABLE, PARTS, LOCK = "sweep.json", "runs.parquet", "parts", ".lock"
_PART = re.compile(r"(\d{10})-(\d{10})\.parquet")
_PARTS_AT_MOST = 4000
_CHUNK = (16, 4096)
"""Runs of a chunk, at least and at most."""


def chunk_size(count: int) -> int:
    """Runs of a chunk: small ones, so that little is lost when killed, but not too many files."""
    return min(max(_CHUNK[0], math.ceil(count / _PARTS_AT_MOST)), _CHUNK[1])


class Folder:
    """A sweep's folder, locked for this process while it is open.

    Raises
    ------
    ArtibotError
        When it holds another sweep or other things, is in use, or cannot be made.
    """

    def __init__(self, path: Path, plan: SweepPlan) -> None:
        self.path = path
        self._plan = plan
        self._lock = -1

    def __enter__(self) -> Folder:
        manifest = read_manifest(self.path) if (self.path / MANIFEST).exists() else None
        if manifest is None:
            self._refuse_strangers()
        else:
            _refuse_another(self.path, manifest, self._plan)
        try:
            (self.path / PARTS).mkdir(parents=True, exist_ok=True)
            self._lock = _locked(self.path / LOCK)
            for left in [*self.path.glob(".*.part"), *(self.path / PARTS).glob(".*.part")]:
                left.unlink()
        except BlockingIOError as error:
            raise ArtibotError(
                f"{self.path}: another sweep is at work there; wait for it, or give another --out"
            ) from error
        except OSError as error:
            raise ArtibotError(f"{self.path}: cannot be used: {error.strerror}; give another --out") from error
        if manifest is None:
            text = json.dumps(_manifest(self._plan), indent=1, ensure_ascii=False)
            self._write(self.path / MANIFEST, (text + "\n").encode())
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        (self.path / LOCK).unlink(missing_ok=True)
        os.close(self._lock)

    @property
    def table(self) -> Path:
        """The finished table."""
        return self.path / TABLE

    @property
    def complete(self) -> bool:
        """Whether the table is there."""
        return self.table.exists()

    def done(self) -> list[tuple[int, int]]:
        """First run and number of runs of every finished part, in order."""
        if self.complete:
            return [(0, self._plan.count)]
        found = (_PART.fullmatch(path.name) for path in (self.path / PARTS).iterdir())
        return sorted((int(match[1]), int(match[2])) for match in found if match)

    def missing(self, size: int) -> Iterator[tuple[int, int]]:
        """First run and number of runs of the chunks that are not done."""
        at = 0
        for first, count in [*self.done(), (self._plan.count, 0)]:
            while at < first:
                step = min(size, first - at)
                yield at, step
                at += step
            at = max(at, first + count)

    def add(self, first: int, count: int, data: bytes) -> None:
        """Keep a finished chunk."""
        self._write(self.path / PARTS / f"{first:010d}-{count:010d}.parquet", data)

    def finish(self) -> None:
        """Make the table of the parts, and remove them."""
        parts = self.path / PARTS
        if not self.complete:
            names = [parts / f"{first:010d}-{count:010d}.parquet" for first, count in self.done()]
            temporary = self.path / f".{TABLE}.part"
            try:
                merge(names, temporary)
                _to_disk(temporary)
                os.replace(temporary, self.table)
            except OSError as error:
                raise _full(self.table, error) from error
        shutil.rmtree(parts, ignore_errors=True)

    def _write(self, target: Path, data: bytes) -> None:
        temporary = target.with_name(f".{target.name}.part")
        try:
            with open(temporary, "wb") as stream:
                stream.write(data)
                stream.flush()
                os.fsync(stream.fileno())
            os.replace(temporary, target)
        except OSError as error:
            temporary.unlink(missing_ok=True)
            raise _full(target, error) from error

    def _refuse_strangers(self) -> None:
        if self.path.exists() and not self.path.is_dir():
            raise ArtibotError(f"{self.path}: is a file; expected a folder to make, give another --out")
        if self.path.is_dir() and any(entry.name not in (LOCK, PARTS) for entry in self.path.iterdir()):
            raise ArtibotError(f"{self.path}: holds other files and no sweep; give another --out, or an empty folder")


def _locked(path: Path) -> int:
    """A descriptor of a lock file, made and locked; raises BlockingIOError where another process has it.

    Who ends removes the file. A lock on one that was removed meanwhile would keep nobody out: then it is made anew.
    """
    while True:
        lock = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            with contextlib.suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(lock), path.stat()):
                    return lock
        except BaseException:
            os.close(lock)
            raise
        os.close(lock)


def read_manifest(folder: Path) -> dict[str, Any]:
    """What a sweep's folder says of itself (ArtibotError where it is no such folder)."""
    path = folder / MANIFEST
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ArtibotError(f"{path}: not readable as a sweep's description; is {folder} a sweep's folder?") from error
    if not isinstance(manifest, dict) or manifest.get("schema") != SCHEMA:
        raise ArtibotError(f"{path}: not of the schema {SCHEMA}; was it made by another version of artibot?")
    return manifest


def _manifest(plan: SweepPlan) -> dict[str, Any]:
    keys = [axis.key for axis in plan.axes]
    return {
        "schema": SCHEMA, "artibot": identity(), "digest": plan.digest, "runs": plan.count,
        "parameters": {key: unit_of(key, plan.base) for key in keys},
        "text": [axis.key for axis in plan.axes if axis.is_text],
        "measures": {name: MEASURES[name][0] for name in plan.measures}, "plan": _plain(plan.as_dict()),
    }  # fmt: skip


def _plain(node: Any) -> Any:
    """JSON has no infinity."""
    if isinstance(node, dict):
        return {key: _plain(value) for key, value in node.items()}
    if isinstance(node, list):
        return [_plain(value) for value in node]
    return str(node) if isinstance(node, float) and math.isinf(node) else node


def _refuse_another(path: Path, manifest: dict[str, Any], plan: SweepPlan) -> None:
    """Another plan, or another artibot, would mix results that do not belong together."""
    if manifest["digest"] != plan.digest:
        old, new = manifest["plan"], _plain(plan.as_dict())
        differ = [word for word in new if json.dumps(old.get(word)) != json.dumps(new[word])]  # also in its order
        what = ", ".join(differ) or "the robot's or the manoeuvre's content"
        raise ArtibotError(f"{path}: holds a sweep that differs in {what}; give another --out, or remove that folder")
    if manifest["artibot"] != identity() and not (path / TABLE).exists():
        raise ArtibotError(
            f"{path}: was begun by artibot {manifest['artibot']}, this is {identity()}; go on with that one, or give "
            "another --out"
        )


def _to_disk(path: Path) -> None:
    with open(path, "rb") as stream:
        os.fsync(stream.fileno())


def _full(target: Path, error: OSError) -> ArtibotError:
    why = error.strerror or str(error)
    return ArtibotError(
        f"{target}: cannot be written: {why}; finished runs are kept: make room and repeat the command to go on"
    )
