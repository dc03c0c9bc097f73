"""What a trial gave, and many of them as a table."""

from __future__ import annotations

import math
import statistics
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from typing import Any

from artibot_driver.master import Reason

_TIMES = ("reaction", "standing", "rejoined")


class NotReady(RuntimeError):
    """The loop did not come up, or stopped before anything was done to it."""


@dataclass
class Outcome:
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
    reason: Reason | None = None
    complaints: list[str] = field(default_factory=list)
    void: int = 0
    judged: bool = True

    def as_json(self) -> dict[str, Any]:
        """As JSON has it: NaN is null, and a reason its name."""
        found = asdict(self) | {"reason": self.reason and self.reason.name}
        return found | {name: None if math.isnan(found[name]) else found[name] for name in _TIMES}

    @classmethod
    def from_json(cls, found: Mapping[str, Any]) -> Outcome:
        """The inverse of :meth:`as_json`; raises KeyError or TypeError for something else."""
        given = {each.name: found[each.name] for each in fields(cls)}
        given |= {name: math.nan if given[name] is None else float(given[name]) for name in _TIMES}
        return cls(**given | {"reason": Reason[given["reason"]] if given["reason"] else None})


def table(outcomes: Sequence[Outcome]) -> Iterator[str]:
    """The summary, line by line: times in s, median and most of those that stopped."""
    groups: dict[str, list[Outcome]] = defaultdict(list)
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
