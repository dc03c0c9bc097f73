"""CAN frames from wherever they were written down: a recording, a log of candump, standard input."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain, takewhile
from pathlib import Path
from typing import Final

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment.can_frames import CanFrame, can_topics, iter_frames
from artibot_sim.experiment.candump import is_candump, iter_candump
from artibot_sim.experiment.reader import bag_info

_SECOND: Final = 1_000_000_000
_STDIN: Final = "-"


@dataclass(frozen=True)
class Frames:
    """Frames to go through.

    Attributes
    ----------
    name : of the recording.
    stream : the frames.
    start_ns, end_ns : first and last stamp of the recording; None where only reading tells (the last of a log).
    robot : as the recording says, or None.
    """

    name: str
    stream: Iterator[CanFrame]
    start_ns: int | None
    end_ns: int | None
    robot: str | None


def open_frames(source: str, topics: tuple[str, ...], start: float | None, end: float | None) -> Frames:
    """Open a recording, a log of candump or standard input (`-`).

    Parameters
    ----------
    source : folder, file or `-`.
    topics : of a recording, which to read; all that carry frames if empty.
    start, end : s from the beginning, or None.

    Raises
    ------
    ArtibotError
        If there are no frames in it. While iterating, where it is damaged.
    """
    if start is not None and end is not None and not start <= end:
        raise ArtibotError(f"--start {start:g} --end {end:g}: nothing lies between them")
    path = Path(source)
    if source == _STDIN:
        return _from_log("standard input", iter_candump(sys.stdin, "standard input"), start, end)
    if path.is_file() and is_candump(path):
        return _from_log(source, _log(path), start, end)
    info = bag_info(path)
    found = can_topics(info, topics)
    begin = info.start_ns + round((start or 0.0) * _SECOND)
    last = info.end_ns if end is None else min(info.end_ns, info.start_ns + round(end * _SECOND))
    stream = iter_frames(path, found, begin, last + 1) if begin <= last else iter(())
    return Frames(source, stream, info.start_ns, last, info.metadata.get("robot"))


def _log(path: Path) -> Iterator[CanFrame]:
    with open(path, encoding="ascii", errors="replace") as stream:
        yield from iter_candump(stream, str(path))


def _from_log(name: str, frames: Iterator[CanFrame], start: float | None, end: float | None) -> Frames:
    """The frames between two times from the first one on; the first is read at once."""
    head = next(frames, None)
    if head is None:
        return Frames(name, iter(()), None, None, None)
    begin = head.stamp_ns + round((start or 0.0) * _SECOND)
    last = None if end is None else head.stamp_ns + round(end * _SECOND)
    stream = (frame for frame in chain((head,), frames) if frame.stamp_ns >= begin)
    cut = stream if last is None else takewhile(lambda frame: frame.stamp_ns <= last, stream)
    return Frames(name, cut, head.stamp_ns, None, None)
