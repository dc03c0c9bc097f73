"""The file under an MCAP writer: written a whole chunk at a time, cut back to the last one when a write fails."""

from __future__ import annotations

import errno
import os
import struct
from pathlib import Path

from artibot_sim.errors import ArtibotError

_MAGIC = b"\x89MCAP0\r\n"
_DATA_END, _FOOTER = 0x0F, 0x02
# the shortest valid end of a file: no index, so readers go through it from the start
_END = struct.pack("<BQI", _DATA_END, 4, 0) + struct.pack("<BQQQI", _FOOTER, 20, 0, 0, 0) + _MAGIC

RESERVE_BYTES = 1 << 18
"""Space that is kept for the end of a recording: a metadata.yaml of some 300 topics and the file's last records."""


class Reserve:
    """A hidden file in a recording's folder that holds space on the disk, given back when the disk is full."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / ".reserve"
        try:
            self._path.write_bytes(bytes(RESERVE_BYTES))  # not a hole: its blocks must be taken
        except OSError:
            self.release()

    def release(self) -> None:
        """Give the space back; again is allowed."""
        self._path.unlink(missing_ok=True)


class Sink:
    """What `mcap.writer.Writer` writes to: bytes wait here until `commit` puts them into the file in one go.

    Attributes
    ----------
    committed : bytes that are in the file, always a whole number of records.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.committed = 0
        self._waiting = bytearray()
        try:
            self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        except OSError as error:
            raise ArtibotError(f"{path}: cannot be made: {error.strerror}") from error

    def write(self, data: bytes) -> int:
        """Take bytes; they reach the file with the next `commit`."""
        self._waiting += data
        return len(data)

    def tell(self) -> int:
        """Return where in the file the next byte will stand."""
        return self.committed + len(self._waiting)

    def flush(self) -> None:
        """Do nothing: `commit` decides when bytes go out."""

    def commit(self) -> None:
        """Write everything that waits.

        Raises
        ------
        OSError
            If the disk is full or broken; call `abandon` then.
        """
        rest = memoryview(bytes(self._waiting))
        while rest:
            rest = rest[os.write(self._file, rest) :]
        self.committed += len(self._waiting)
        self._waiting.clear()

    def abandon(self) -> bool:
        """Cut the file back to `committed` and end it validly without an index; say whether that succeeded."""
        self._waiting.clear()
        try:
            os.ftruncate(self._file, self.committed)
            if os.pwrite(self._file, _END, self.committed) != len(_END):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError:
            os.ftruncate(self._file, self.committed)
            return False
        return True

    def sync(self) -> None:
        """Ask the system to put the file on the disk."""
        os.fdatasync(self._file)

    def close(self) -> None:
        """Close the file; again is allowed."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1
