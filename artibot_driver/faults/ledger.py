"""Outcomes of trials in a file, a line of JSON each as they come: a campaign that was broken off goes on from there."""

from __future__ import annotations

import json
from pathlib import Path

from artibot_driver.faults.outcome import Outcome
from artibot_sim.errors import ArtibotError

Key = tuple[int, str]
"""Number of a trial, and what it was drawn from."""

_BEGIN = '{"seed": '


class Ledger:
    """The trials of one seed on one bus.

    Parameters
    ----------
    path : Path or None
        The file; others' trials in it are left alone. None keeps nothing.
    seed : int
    bus : str

    Attributes
    ----------
    done : dict
        Outcomes that are in it already, but for those that could not be judged.

    Raises
    ------
    ArtibotError
        When the file cannot be read or is something else.
    """

    def __init__(self, path: Path | None, seed: int, bus: str) -> None:
        self._path, self._about = path, {"seed": seed, "bus": bus}
        self.done: dict[Key, Outcome] = {}
        text = self._text()
        self._before = "\n" if text and not text.endswith("\n") else ""  # the last line was cut off
        for number, line in enumerate(text.splitlines(), 1):
            self._take(number, line)

    def _text(self) -> str:
        if self._path is None or not self._path.exists():
            return ""
        try:
            return self._path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise ArtibotError(f"{self._path}: cannot be read: {error}") from error

    def _take(self, number: int, line: str) -> None:
        try:
            found = json.loads(line)
            ours = {name: found[name] for name in self._about} == self._about
            key, outcome = (found["number"], found["drawn_from"]), Outcome.from_json(found)
        except (ValueError, KeyError, TypeError) as error:
            if line.startswith(_BEGIN) and isinstance(error, json.JSONDecodeError):
                return  # cut off: that trial is made again
            raise ArtibotError(
                f"{self._path}: line {number}: found no trial ({error!r}), expected a file that a campaign wrote; "
                "name another one"
            ) from error
        if ours and outcome.judged:
            self.done[key] = outcome

    def write(self, key: Key, outcome: Outcome) -> None:
        """Add a trial; it is in the file when this returns."""
        if self._path is None:
            return
        number, drawn_from = key
        line = json.dumps({**self._about, "number": number, "drawn_from": drawn_from, **outcome.as_json()})
        try:
            with self._path.open("a", encoding="utf-8") as file:
                file.write(f"{self._before}{line}\n")
        except OSError as error:
            raise ArtibotError(f"{self._path}: cannot be written: {error.strerror}") from error
        self._before = ""
