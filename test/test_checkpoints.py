"""Finished parts of a computation: taken by the same computation, and by no other."""

from __future__ import annotations

import json
import os
from pathlib import Path
from types import MappingProxyType
from typing import Any

import pytest

from artibot_sim.checkpoints import Checkpoints
from artibot_sim.errors import ArtibotError


class Course:
    """A computation of three parts, each made from the one before; `made` counts those that were."""

    def __init__(self, folder: Path, key: str = "a") -> None:
        self.parts, self.made = Checkpoints(folder), 0
        self.large = object()
        self.parts.begin(key, [self.large])

    def __call__(self, stop: int = 3, names: str = "xyz") -> list[Any]:
        found: list[Any] = []
        for number in range(stop):
            found.append(self.parts.once(names[number], lambda n=number: self._make(n)))  # type: ignore[misc]
        return found

    def _make(self, number: int) -> Any:
        self.made += 1
        return number, self.large, MappingProxyType({"n": number})


def test_the_same_computation_takes_what_was_finished(tmp_path: Path) -> None:
    Course(tmp_path / "kept")(stop=2)
    again = Course(tmp_path / "kept")
    found = again()
    assert again.made == 1 and again.parts.taken == 2
    assert [number for number, _, _ in found] == [0, 1, 2]
    assert all(large is again.large for _, large, _ in found)  # it was not read but is this computation's own
    assert found[0][2]["n"] == 0 and isinstance(found[0][2], MappingProxyType)
    again.parts.done()
    assert not (tmp_path / "kept").exists()


def test_other_inputs_begin_anew(tmp_path: Path) -> None:
    Course(tmp_path / "kept")()
    other = Course(tmp_path / "kept", key="b")
    other()
    assert other.made == 3 and other.parts.taken == 0


def test_what_follows_another_course_is_made_again(tmp_path: Path) -> None:
    """A part by another name was made of something else, and so was everything after it."""
    Course(tmp_path / "kept")()
    other = Course(tmp_path / "kept")
    other(names="xwz")
    assert other.made == 2 and other.parts.taken == 1


@pytest.mark.parametrize("damage", [b"", b"\x80\x05nothing", None])
def test_a_part_that_was_cut_off_or_damaged_is_made_again(tmp_path: Path, damage: bytes | None) -> None:
    Course(tmp_path / "kept")()
    part = tmp_path / "kept" / "001"
    part.write_bytes(part.read_bytes()[:-9] if damage is None else damage)
    again = Course(tmp_path / "kept")
    assert [number for number, _, _ in again()] == [0, 1, 2] and again.made == 2


def test_what_cannot_be_kept_costs_nothing_else(tmp_path: Path) -> None:
    parts = Checkpoints(tmp_path / "kept")
    parts.begin("a")
    assert parts.once("x", lambda: lambda: 7)() == 7
    assert not parts.kept
    assert Checkpoints().once("x", lambda: 5) == 5


def test_time_spent_before_counts(tmp_path: Path) -> None:
    first = Checkpoints(tmp_path / "kept")
    first.begin("a")
    first._begun -= 100.0  # as if it had begun earlier
    first.once("x", lambda: 1)
    again = Checkpoints(tmp_path / "kept")
    again.begin("a")
    assert again.elapsed < 50.0
    again.once("x", lambda: 2)
    assert again.elapsed >= 100.0


@pytest.mark.parametrize(
    ("pid", "left", "told"),
    [
        (
            2**22 + 1,
            None,
            "process 4194305) was killed after 7 s or more, perhaps for lack of memory: it had taken 80 MB",
        ),
        (os.getppid(), None, ""),  # it still runs
        (2**22 + 1, '{"pid": 4194305, "sec', ""),  # cut off
    ],
)
def test_who_was_killed_is_told(tmp_path: Path, pid: int, left: str | None, told: str) -> None:
    """By what its process left: no process has a number beyond 4194304."""
    (tmp_path / "running").write_text(left or json.dumps({"pid": pid, "seconds": 7, "megabytes": 80}))
    assert told in Checkpoints(tmp_path).killed and bool(Checkpoints(tmp_path).killed) == bool(told)


def test_who_computes_says_so_and_takes_it_back_at_the_end(tmp_path: Path) -> None:
    parts, said = Checkpoints(tmp_path / "kept"), []
    running = tmp_path / "kept" / "running"
    with pytest.raises(ArtibotError), parts.announced(said.append):
        parts.begin("a")
        assert json.loads(running.read_text())["pid"] == os.getpid()
        raise ArtibotError("unusable")
    assert not running.exists() and not said
