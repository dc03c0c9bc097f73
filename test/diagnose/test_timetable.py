"""How far a diagnosis is: stages are named, nothing is taken back, the end is the end, and times are measured."""

import math
import random

import pytest

from artibot_sim.diagnose.timetable import Task, TimeLimit, Timetable
from artibot_sim.estimation.parallel import check_time


def test_what_is_done_grows_and_ends_at_all() -> None:
    """However many searches follow on one another, and with as many parts as there may be."""
    for searches in range(5):
        told: list[tuple[float, str]] = []
        table = Timetable(lambda share, what, _left: told.append((share, what)))  # noqa: B023  called in here
        number = random.Random(searches)
        found: list[str] = []
        for task in (Task.COMMANDS, Task.SOIL):
            table.begin(task)
        for _ in range(searches):
            table.begin(Task.SEARCH, f"beside {found}")
            for _ in range(number.randrange(200)):
                table()
            table.begin(Task.WINDOWS)
            found.append("one more")
        for task in (Task.FORCES, Task.INTERVALS, Task.FORCES, Task.PREDICTIONS, Task.MODELS, Task.ERRORS):
            table.begin(task)
        shares = [share for share, _ in told]
        assert shares == sorted(shares) and shares[0] >= 0.0 and shares[-1] < 1.0
        table.done()
        assert told[-1][0] == 1.0


def test_a_stage_has_its_name_and_one_more_search_is_expected() -> None:
    told: list[tuple[float, str]] = []
    table = Timetable(lambda share, what, _left: told.append((share, what)))
    table.begin(Task.SEARCH, "beside slope")
    table()
    assert {what for _, what in told} == {"looking for effects beside slope"}
    table.begin(Task.SEARCH, "beside slope, gear drag")
    more = told[-1][0]
    table.begin(Task.LEAVING_OUT)
    assert told[-1][0] > more + Task.SEARCH.duration / sum(task.duration for task in Task) / 2.0


@pytest.mark.parametrize("pace", [0.01, 1.0, 30.0])
def test_the_time_left_follows_from_what_searches_take_here(pace: float) -> None:
    """On a machine, or with recordings, that take `pace` times as long, and whatever compiling takes beside."""
    now, told = 0.0, list[str]()
    table = Timetable(lambda _share, _what, left: told.append(left), clock=lambda: now)
    table.leave_out(Task.WINDOWS, Task.EXPLAINABLE)
    now += 1000.0  # reading, compiling and the soil tell nothing
    table.begin(Task.SOIL)
    assert table.left is None and "left" not in told[-1]
    table.begin(Task.SEARCH)
    for part in range(50):
        table.compiling(True)
        now += 5.0
        table.compiling(False)
        now += pace * Task.SEARCH.duration / 50
        table()
        if part == 30:
            search = pace * Task.SEARCH.duration * 19 / 50
            later = (Task.FORCES, Task.INTERVALS, Task.PREDICTIONS, Task.MODELS, Task.ERRORS)
            assert table.left == pytest.approx(search + pace * sum(task.unnamed for task in later))
            assert "left" in told[-1] and "more for each effect found" in told[-1]
    table.begin(Task.SEARCH, "beside slope, gear drag", named=3)
    now += pace * Task.SEARCH.duration
    table.begin(Task.LEAVING_OUT, parts=2)
    rest = (Task.LEAVING_OUT, Task.LEAVING_OUT, Task.FORCES, Task.INTERVALS, Task.PREDICTIONS, Task.MODELS, Task.ERRORS)
    assert table.left == pytest.approx(pace * sum(task.duration for task in rest))
    table.begin(Task.INTERVALS)
    rest = (Task.INTERVALS, Task.PREDICTIONS, Task.MODELS, Task.ERRORS)
    assert table.left == pytest.approx(pace * sum(task.duration for task in rest))
    now += pace * Task.INTERVALS.duration
    assert table.left == pytest.approx(pace * sum(task.duration for task in rest[1:]))
    assert "more for" not in told[-1]


def test_work_that_is_not_over_in_time_is_said_to_be_untried() -> None:
    """Whatever there is time for is made; what is stopped gives nothing, and is named after what was untried before."""
    left = iter((math.inf, -1.0))
    limit = TimeLimit(lambda: next(left), ["a search"])

    def work() -> str:
        check_time()
        return "made"

    assert limit.within("the first", work) == "made"
    assert limit.within("the second", work) is None
    assert limit.untried == ["a search", "the second"]
