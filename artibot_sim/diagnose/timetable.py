"""The stages of a diagnosis, and how much of its work is done as far as that is known."""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum

StageReport = Callable[[float, str], None]
"""Called with the share that is done, 0 to 1, and what is being done."""


class Task(Enum):
    """What a stage does, in the order in which stages are done, and how long it takes beside the others.

    That is s on two cores, between a Husky's 201 windows of 2 s and 2 × 45 s of Agri.q.
    """

    CLOCKS = "putting streams on one clock", 2.0
    COMMANDS = "holding motors against commands", 3.0
    SOIL = "identifying the soil", 3.0
    SEARCH = "looking for effects", 20.0
    WINDOWS = "asking all windows", 8.0
    LEAVING_OUT = "leaving out each effect", 2.0
    FORCES = "looking for forces on no list", 13.0
    INTERVALS = "how sure sizes are", 10.0
    PREDICTIONS = "predicting all recordings", 7.0
    MODELS = "models side by side", 3.0
    EXPLAINABLE = "how much is explainable", 9.0
    ERRORS = "where errors come from", 2.0

    def __init__(self, doing: str, duration: float) -> None:
        self.doing, self.duration = doing, duration


_ORDER = list(Task)
_TICKS = 40.0
"""Parts of a search, about; of other stages there are fewer."""


class Timetable:
    """Where a diagnosis is.

    How many searches there will be nobody knows: another one follows on each that finds an effect. So one more is
    always expected, until the next stage begins.

    Parameters
    ----------
    report : callable, optional
        Told after each part of the work.
    """

    def __init__(self, report: StageReport | None = None) -> None:
        self._report = report or (lambda _share, _what: None)
        self._task, self._doing = Task.CLOCKS, Task.CLOCKS.doing
        self._before, self._ticks, self._reported = 0.0, 0, 0.0

    def begin(self, task: Task, beside: str = "") -> None:
        """A stage begins, and the one before it is done; `beside` says what it is about.

        A stage that is under way goes on where it is only named again.
        """
        doing = f"{task.doing} {beside}".rstrip()
        if doing != self._doing:
            self._before += self._task.duration
            self._task, self._doing, self._ticks = task, doing, 0
        self._report_share()

    def __call__(self) -> None:
        """A part of the stage is done."""
        self._ticks += 1
        self._report_share()

    def done(self) -> None:
        """All of it is over."""
        self._report(1.0, self._doing)

    @property
    def share(self) -> float:
        """Share of the work that is done."""
        here = self._task.duration * min(self._ticks / _TICKS, 0.9)
        to_come = [one.duration for one in _ORDER[_ORDER.index(self._task) + 1 :]]
        if _ORDER.index(self._task) <= _ORDER.index(Task.WINDOWS):
            to_come += [Task.SEARCH.duration]
        return (self._before + here) / (self._before + self._task.duration + sum(to_come))

    def _report_share(self) -> None:
        """A search that nobody expected takes nothing back of what was said to be done."""
        self._reported = max(self._reported, self.share)
        self._report(self._reported, self._doing)
