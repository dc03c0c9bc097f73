"""Logs of `candump -l` and `candump -L` as frames, line by line."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment.can_frames import LONGEST, CanFrame

_LINE: Final = re.compile(
    r"\((?P<sec>\d+)\.(?P<fraction>\d{1,9})\)\s+(?P<channel>\S+)\s+(?P<id>[0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})"
    r"(?P<kind>##?)(?P<data>[0-9A-Fa-f]*|R[0-9A-Fa-f]?)(?:_(?P<dlc>[9A-Fa-f]))?(?:\s+[RT])?\s*"
)
_ERROR, _EXTENDED, _STANDARD = 0x20000000, 0x1FFFFFFF, 0x7FF
_LOOKED_AT: Final = 256


def is_candump(file: Path) -> bool:
    """Whether a file begins as such a log does."""
    try:
        with open(file, "rb") as stream:
            head = stream.read(_LOOKED_AT)
    except OSError:
        return False
    return re.match(rb"\s*\(\d+\.\d+\)\s+\S+\s+[0-9A-Fa-f]+#", head) is not None


def frame_of(line: str) -> CanFrame | None:
    """The frame in a line; None for one of CAN FD, which has no place in a recording.

    Raises
    ------
    ArtibotError
        If the line is none of candump's.
    """
    found = _LINE.fullmatch(line)
    text = found["data"] if found else ""
    if found is not None and found["kind"] == "##":
        return None
    if found is None or (not text.startswith("R") and len(text) % 2):
        raise ArtibotError(
            f"found '{line.strip()[:60]}', expected a line such as (1700000000.123456) can0 181#3702E803"
        )
    remote = text.startswith("R")
    data = b"" if remote else bytes.fromhex(text)
    if len(data) > LONGEST:
        raise ArtibotError(f"found {len(data)} data bytes in '{line.strip()[:60]}', expected at most {LONGEST}")
    dlc = int(text[1:] or "0", 16) if remote else len(data)
    number = int(found["id"], 16)
    error = len(found["id"]) == 8 and bool(number & _ERROR)
    extended = len(found["id"]) == 8 and not error
    return CanFrame(
        stamp_ns=int(found["sec"]) * 1_000_000_000 + int(found["fraction"].ljust(9, "0")),
        can_id=number & (_EXTENDED if extended else _STANDARD),
        data=data,
        dlc=int(found["dlc"], 16) if found["dlc"] else dlc,
        is_extended=extended,
        is_remote=remote,
        is_error=error,
    )


def line_of(frame: CanFrame, channel: str = "can0") -> str:
    """A frame as candump writes it to a log, microseconds in its stamp."""
    number = frame.can_id | (_ERROR if frame.is_error else 0)
    width = 8 if frame.is_extended or frame.is_error else 3
    data = f"R{frame.dlc or ''}" if frame.is_remote else frame.data.hex().upper()
    longer = f"_{frame.dlc:X}" if len(frame.data) == LONGEST < frame.dlc else ""
    sec, rest = divmod(frame.stamp_ns // 1000, 1_000_000)
    return f"({sec}.{rest:06d}) {channel} {number:0{width}X}#{data}{longer}"


def iter_candump(lines: Iterable[str], name: str) -> Iterator[CanFrame]:
    """Stream the frames of a log's lines; empty lines, comments (`#`) and CAN FD frames are passed over.

    Raises
    ------
    ArtibotError
        While iterating, naming the file and the line.
    """
    for number, line in enumerate(lines, 1):
        if not line.strip() or line.startswith("#"):
            continue
        try:
            frame = frame_of(line)
        except ArtibotError as error:
            raise ArtibotError(f"{name}: line {number}: {error}") from error
        if frame is not None:
            yield frame
