"""What a campaign has done so far: one line of JSON a case, which is there as a whole or not at all."""

from __future__ import annotations

import fcntl
import json
import os
from pathlib import Path
from types import TracebackType
from typing import Any

from artibot_sim.errors import ArtibotError


class Journal:
    """A file of results that a campaign adds to.

    Opening it takes away a line that was cut off when the machine stopped, and keeps others out meanwhile.

    Raises
    ------
    ArtibotError
        If another campaign writes to it, or a line in it is not a result.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self._file = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o644)
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            os.close(self._file)
            raise ArtibotError(
                f"{self.path}: another campaign writes to it; wait for it or name another --out"
            ) from error
        whole = self.path.read_bytes()
        end = whole.rfind(b"\n") + 1
        if end < len(whole):
            os.ftruncate(self._file, end)
        self.results = read_results(self.path)

    def __enter__(self) -> Journal:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        os.close(self._file)

    @property
    def done(self) -> set[str]:
        """Keys of the cases that are there."""
        return {result["key"] for result in self.results}

    def add(self, result: dict[str, Any]) -> None:
        """Write one result, in one piece, onto the disk."""
        line = (json.dumps(result, separators=(",", ":")) + "\n").encode()
        written = os.write(self._file, line)
        if written != len(line):
            raise ArtibotError(f"{self.path}: the disk is full; free some space and start the same campaign again")
        os.fsync(self._file)
        self.results.append(result)


def read_results(path: Path) -> list[dict[str, Any]]:
    """All whole lines of a journal."""
    results = []
    for number, line in enumerate(path.read_bytes().splitlines(keepends=True), 1):
        if not line.endswith(b"\n"):
            break
        try:
            result = json.loads(line)
            result["key"]
        except (ValueError, KeyError, TypeError) as error:
            raise ArtibotError(f"{path}:{number}: no result of a campaign; mend the line or take it out") from error
        results.append(result)
    return results
