"""Is this a whole recording? What to say when it is not."""

from __future__ import annotations

import sqlite3
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from artibot_sim.errors import ArtibotError

MAGIC = b"\x89MCAP0\r\n"
_FOOTER = struct.Struct("<QQI")  # start of the summary, of its offsets, and the summary's checksum
_SQLITE_MAGIC = b"SQLite format 3\x00"
# what decoders raise on bytes that make no sense: a length of 2**63, a name that is not UTF-8, an unknown id
_DAMAGE = (struct.error, LookupError, ValueError, ArithmeticError, RuntimeError, MemoryError, OSError)
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_OTHERS = {
    b"#ROSBAG V": "a ROS 1 bag; convert it with `rosbags-convert`",
    ZSTD_MAGIC: "a zstd-compressed file; decompress it with `zstd -d` first",
    b"PK\x03\x04": "a zip archive; unpack it first",
    b"\x1f\x8b": "a gzip archive; unpack it first",
}


def check_file(file: Path) -> str:
    """Look at both ends of a file and return `mcap` or `sqlite3`.

    Raises
    ------
    ArtibotError
        If it is empty, cut short, or of another format; the message says what to do.
    """
    try:
        with open(file, "rb") as stream:
            head = stream.read(16)
            size = stream.seek(0, 2)
            stream.seek(max(0, size - len(MAGIC)))
            tail = stream.read()
    except OSError as error:
        raise ArtibotError(f"{file}: cannot be read: {error.strerror}") from error
    if not size:
        raise ArtibotError(f"{file}: the file is empty; expected a recording (.mcap)")
    if head == _SQLITE_MAGIC:
        return "sqlite3"
    if not head.startswith(MAGIC):
        for magic, what in _OTHERS.items():
            if head.startswith(magic):
                raise ArtibotError(f"{file}: this is {what}")
        raise ArtibotError(f"{file}: not a recording: begins with {head[:8]!r}, expected MCAP's {MAGIC!r}")
    if tail != MAGIC or size < 2 * len(MAGIC) + 29:
        raise ArtibotError(
            f"{file}: cut short or still being written (no MCAP end mark in {size} bytes); run `artibot recover {file}`"
        )
    if not _index_is_whole(file, size):
        raise ArtibotError(f"{file}: damaged: the index's checksum does not fit; run `artibot recover {file}`")
    return "mcap"


def _index_is_whole(file: Path, size: int) -> bool:
    """Say whether the checksum of the summary section, if the file has one, fits: it guides all reading."""
    with open(file, "rb") as stream:
        stream.seek(size - len(MAGIC) - _FOOTER.size)
        start, _, expected = _FOOTER.unpack(stream.read(_FOOTER.size))
        if not start or not expected or start >= size:
            return start < size
        stream.seek(start)
        return zlib.crc32(stream.read(size - len(MAGIC) - 4 - start)) == expected


@contextmanager
def clear_errors(file: Path) -> Iterator[None]:
    """Turn what the libraries raise on damaged bytes into one sentence naming the file and the mend."""
    from mcap.exceptions import McapError, UnsupportedCompressionError
    from mcap.stream_reader import CRCValidationError
    from zstandard import ZstdError

    try:
        yield
    except ArtibotError:
        raise
    except UnsupportedCompressionError as error:
        raise ArtibotError(f"{file}: {error}; `pip install lz4 zstandard` to read it") from error
    except sqlite3.Error as error:
        raise ArtibotError(f"{file}: damaged SQLite recording: {error}") from error
    except CRCValidationError as error:
        raise ArtibotError(f"{file}: damaged: {error}; run `artibot recover {file}`") from error
    except (*_DAMAGE, McapError, ZstdError) as error:
        said = f"{type(error).__name__} {error}".strip()
        raise ArtibotError(f"{file}: damaged: {said}; run `artibot recover {file}`") from error
