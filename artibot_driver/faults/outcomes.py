"""What trials gave: as a table, and in a file from which a campaign that was broken off goes on."""

from __future__ import annotations

import json
import math
import statistics
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from artibot_driver.master import StopReason
from artibot_sim.errors import ArtibotError

# ----------------------------------------------------------------------
# What a trial gave, and many of them as a table.
# ----------------------------------------------------------------------


_TIMES = ("reaction", "standing", "rejoined")


class NotReady(RuntimeError):
    """The loop did not come up, or stopped before anything was done to it."""


@dataclass
class TrialOutcome:
    """What a trial gave.

    Attributes
    ----------
    stopped : bool
        Whether the rover stopped; else it went on as commanded.
    reaction, standing, rejoined : float
        After the fault (or, where it had not to stop, after the reason was noticed): the last front motor was slowed
        down; all were at standstill or without torque. After its end: all drives were set up. s; NaN where not so.
    complaints : list of str
        What was not as it must be.
    void : int
        How often it was void and made again, because the machine held it up.
    judged : bool
        False where it was void each time: nothing is known then.
    """

    fault: str
    group: str
    motor: str
    stopped: bool = False
    reaction: float = math.nan
    standing: float = math.nan
    rejoined: float = math.nan
    reason: StopReason | None = None
    complaints: list[str] = field(default_factory=list)
    void: int = 0
    judged: bool = True

    def as_json(self) -> dict[str, Any]:
        """As JSON has it: NaN is null, and a reason its name."""
        found = asdict(self) | {"reason": self.reason and self.reason.name}
        return found | {name: None if math.isnan(found[name]) else found[name] for name in _TIMES}

    @classmethod
    def from_json(cls, found: Mapping[str, Any]) -> TrialOutcome:
        """The inverse of :meth:`as_json`; raises KeyError or TypeError for something else."""
        given = {each.name: found[each.name] for each in fields(cls)}
        given |= {name: math.nan if given[name] is None else float(given[name]) for name in _TIMES}
        return cls(**given | {"reason": StopReason[given["reason"]] if given["reason"] else None})


def table(outcomes: Sequence[TrialOutcome]) -> Iterator[str]:
    """The summary, line by line: times in s, median and most of those that stopped."""
    groups: dict[str, list[TrialOutcome]] = defaultdict(list)
    for outcome in outcomes:
        groups[outcome.group].append(outcome)
    heads = ("trials", "stopped", "went on", "reaction", "most", "at rest", "back", "most", "void", "wrong")
    yield f"{'fault':<28}" + "".join(f"{head:>9}" for head in heads)
    for name, group in groups.items():
        judged = [each for each in group if each.judged]
        stopped = [each for each in judged if each.stopped]
        reaction, standing, back = ([getattr(each, what) for each in stopped] for what in _TIMES)
        cells = (
            len(judged), len(stopped), len(judged) - len(stopped),
            _of(statistics.median, reaction), _of(max, reaction), _of(max, standing),
            _of(statistics.median, back), _of(max, back),
            sum(each.void for each in group), sum(bool(each.complaints) for each in judged),
        )  # fmt: skip
        yield f"{name:<28}" + "".join(f"{cell:>9}" for cell in cells)


def _of(what: Any, values: Sequence[float]) -> str:
    known = [value for value in values if not math.isnan(value)]
    return f"{what(known):.3f}" if known else "–"


# ----------------------------------------------------------------------
# Outcomes of trials in a file, a line of JSON each as they come: a campaign that was broken off goes on from
# there.
# ----------------------------------------------------------------------


Key = tuple[int, str]
"""Number of a trial, and what it was drawn from."""

_BEGIN = '{"seed": '


class TrialLog:
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
        self.done: dict[Key, TrialOutcome] = {}
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
            key, outcome = (found["number"], found["drawn_from"]), TrialOutcome.from_json(found)
        except (ValueError, KeyError, TypeError) as error:
            if line.startswith(_BEGIN) and isinstance(error, json.JSONDecodeError):
                return  # cut off: that trial is made again
            raise ArtibotError(
                f"{self._path}: line {number}: found no trial ({error!r}), expected a file that a campaign wrote; "
                "name another one"
            ) from error
        if ours and outcome.judged:
            self.done[key] = outcome

    def write(self, key: Key, outcome: TrialOutcome) -> None:
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
