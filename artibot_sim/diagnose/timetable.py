"""The stages of a diagnosis, how much of its work is done, how long the rest takes, and what there was no time for."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from enum import Enum
from typing import TypeVar

from artibot_sim.estimation.parallel import TimeIsUp, until

Result = TypeVar("Result")

StageReport = Callable[[float, str, str], None]
"""Called with the share that is done, 0 to 1, what is being done, and how long the rest takes, in words."""


class Task(Enum):
    """What a stage does, in the order in which stages are done, and how long it takes beside the others.

    The first duration is s on two cores, between a Husky's 201 windows of 2 s and 2 × 45 s of Agri.q, where effects are
    named. The second one is where none is: beside a search of 20 s again (Table 6, 29 s of Agri.q). Each effect but the
    last is left out once: that takes 7 s, with fits of all windows after it (`husky_deflated`, seven effects).
    """

    CLOCKS = "putting streams on one clock", 2.0, 2.0
    COMMANDS = "holding motors against commands", 3.0, 3.0
    SOIL = "identifying the soil", 3.0, 3.0
    SEARCH = "looking for effects", 20.0, 20.0
    WINDOWS = "asking all windows", 8.0, 8.0
    LEAVING_OUT = "leaving out each effect", 7.0, 0.0
    FORCES = "looking for forces on no list", 13.0, 13.0
    INTERVALS = "how sure sizes are", 10.0, 1.5
    PREDICTIONS = "predicting all recordings", 7.0, 2.0
    MODELS = "models side by side", 3.0, 0.5
    EXPLAINABLE = "how much is explainable", 9.0, 9.0
    ERRORS = "where errors come from", 2.0, 0.5

    def __init__(self, doing: str, duration: float, unnamed: float) -> None:
        self.doing, self.duration, self.unnamed = doing, duration, unnamed


_ORDER = list(Task)
_PARTS = 50
"""Parts of a first search, about: an effect that is screened is one, and so is a fit. Other stages have fewer."""

_KNOWN = 0.2
"""So much of the first search is done before a time is said: how long it takes nothing before it tells."""


class Timetable:
    """Where a diagnosis is.

    How many searches there will be nobody knows: another one follows on each that finds an effect. The share that is
    done takes one more for granted, until the next stage begins. The time that is left does not: beside it is said what
    each effect adds that is found. It follows from what searches of these recordings take on this machine, of the one
    that is under way by its parts; before the first one has told, none is said.

    Parameters
    ----------
    report : callable, optional
        Told after each part of the work.
    clock : callable
        Steady time, s.
    """

    def __init__(self, report: StageReport | None = None, clock: Callable[[], float] = time.monotonic) -> None:
        self._report = report or (lambda _share, _what, _left: None)
        self._clock, self._stages = clock, [*_ORDER]
        self._task, self._doing, self._named = Task.CLOCKS, Task.CLOCKS.doing, 0
        self._before, self._parts, self._expected, self._reported = 0.0, 0, _PARTS, 0.0
        self._begun, self._compiled, self._compiling_since = clock(), 0.0, 0.0
        self._searches: list[tuple[float, int]] = []  # s and parts of those that are over

    def leave_out(self, *tasks: Task) -> None:
        """There are no such stages: nothing for them to do, or no library to do it with."""
        self._stages = [one for one in self._stages if one not in tasks]

    def begin(self, task: Task, beside: str = "", *, named: int | None = None, parts: int | None = None) -> None:
        """A stage begins, and the one before it is done; `beside` says what it is about.

        A stage that is under way goes on where it is only named again.

        Parameters
        ----------
        named : int, optional
            How many effects are named by now; as many as before unless given.
        parts : int, optional
            How many the stage has, where that is known.
        """
        self._named = self._named if named is None else named
        doing = f"{task.doing} {beside}".rstrip()
        if doing != self._doing:
            if self._task is Task.SEARCH:
                self._searches.append((self._spent, self._parts))
            self._before += self._task.duration
            self._task, self._doing, self._parts = task, doing, 0
            self._expected = self._searches[-1][1] if task is Task.SEARCH and self._searches else _PARTS
            self._expected = self._expected if parts is None else parts
            self._begun, self._compiled = self._clock(), 0.0
        self._report_share()

    def __call__(self) -> None:
        """A part of the stage is done."""
        self._parts += 1
        self._report_share()

    def done(self) -> None:
        """All of it is over."""
        self._report(1.0, self._doing, "")

    def compiling(self, begins: bool) -> None:
        """The model is compiled, once on a machine, or is so now: that tells nothing of other stages."""
        if begins:
            self._compiling_since = self._clock()
        else:
            self._compiled += self._clock() - self._compiling_since

    @property
    def share(self) -> float:
        """Share of the work that is done."""
        here = self._task.duration * self._part
        to_come = sum(one.duration for one in self._later)
        if self._searching:
            to_come += Task.SEARCH.duration
        return (self._before + here) / (self._before + self._task.duration + to_come)

    @property
    def left(self) -> float | None:
        """How long the rest takes, s, where no effect more is found; None where that is not known."""
        search = self._search_takes
        if search is None:
            return None
        if self._task is Task.SEARCH:
            here = search * (1.0 - self._part)
        else:
            here = max(self._durations(self._task) * search - self._spent, 0.0)
        return here + sum(map(self._durations, self._later)) * search

    @property
    def _search_takes(self) -> float | None:
        """s, by the searches that are over and by the parts of the one under way."""
        found = [spent for spent, _ in self._searches]
        if self._task is Task.SEARCH and (self._part >= _KNOWN or not found):
            if self._part < _KNOWN:
                return None
            found.append(self._spent / self._part)
        return sum(found) / len(found) if found else None

    def _durations(self, task: Task) -> float:
        """How long a stage takes beside a search."""
        times = max(self._named - 1, 0) if task is Task.LEAVING_OUT else int(task in self._stages)
        return times * (task.duration if self._named else task.unnamed) / Task.SEARCH.duration

    @property
    def _spent(self) -> float:
        """In this stage, s, but for compiling."""
        return self._clock() - self._begun - self._compiled

    @property
    def _part(self) -> float:
        """Share of the stage that is done."""
        return min(self._parts / max(self._expected, 1), 0.9)

    @property
    def _searching(self) -> bool:
        """Whether another search may follow."""
        return _ORDER.index(self._task) <= _ORDER.index(Task.WINDOWS)

    @property
    def _later(self) -> list[Task]:
        """Stages that are to come."""
        return [one for one in self._stages if _ORDER.index(one) > _ORDER.index(self._task)]

    def _report_share(self) -> None:
        """A search that nobody expected takes nothing back of what was said to be done."""
        self._reported = max(self._reported, self.share)
        self._report(self._reported, self._doing, self._words())

    def _words(self) -> str:
        """Share and time, for a person."""
        said, left, search = f"{self._reported:.0%}", self.left, self._search_takes
        if left is None or search is None:
            return said
        beside = [one.duration for one in (Task.WINDOWS, Task.LEAVING_OUT) if one in self._stages]
        one_more = search * (1.0 + sum(beside) / Task.SEARCH.duration)
        more = f", {_minutes(one_more)} more for each effect found" if self._searching else ""
        return f"{said}, {_minutes(left)} left{more}"


def _minutes(seconds: float) -> str:
    return f"{round(seconds) // 60}:{round(seconds) % 60:02d}"


class TimeLimit:
    """A time in which work has to be over, and what there was none for.

    Parameters
    ----------
    left : callable
        Gives how much of it is left, s.
    untried : sequence of str
        What there was no time for before.

    Attributes
    ----------
    untried : list of str
        What there was no time for.
    """

    def __init__(self, left: Callable[[], float], untried: Sequence[str] = ()) -> None:
        self._left, self.untried = left, list(untried)

    def within(self, what: str, make: Callable[[], Result]) -> Result | None:
        """What `make` returns; None where that is not over in time: then `what` is one more that is untried."""
        try:
            with until(time.perf_counter() + self._left()):
                return make()
        except TimeIsUp:
            self.untried.append(what)
            return None
