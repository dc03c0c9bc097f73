"""Writing that waits for no reader."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from artibot_sim.nodes.common.process import never_held_up

MUCH = bytes(100_000)
"""More than a pipe keeps."""


@pytest.fixture
def pipe() -> Iterator[tuple[int, int]]:
    reader, writer = os.pipe()
    yield reader, writer
    os.close(reader)
    os.close(writer)


def test_a_full_pipe_is_not_waited_for_and_those_who_share_it_see_no_change(pipe: tuple[int, int]) -> None:
    reader, writer = pipe
    shared = os.dup(writer)
    with never_held_up(writer):
        written = os.write(writer, MUCH)
        assert 0 < written < len(MUCH)
        with pytest.raises(BlockingIOError):
            os.write(writer, MUCH)
        assert not fcntl.fcntl(shared, fcntl.F_GETFL) & os.O_NONBLOCK
    assert not fcntl.fcntl(writer, fcntl.F_GETFL) & os.O_NONBLOCK
    os.close(shared)
    assert len(os.read(reader, len(MUCH))) == written


def test_the_pipe_ends_for_its_reader_when_the_last_writer_closes_it() -> None:
    reader, writer = os.pipe()
    with never_held_up(writer):
        os.write(writer, b"said")
    os.close(writer)
    assert os.read(reader, 10) == b"said"
    assert os.read(reader, 10) == b""
    os.close(reader)


def test_files_stay_as_they_are(tmp_path: Path) -> None:
    path = tmp_path / "log"
    path.write_text("before\n")
    with open(path, "a", encoding="utf-8") as log:
        with never_held_up(log.fileno()):
            os.write(log.fileno(), b"meanwhile\n")
        log.write("after\n")
    assert path.read_text() == "before\nmeanwhile\nafter\n"
