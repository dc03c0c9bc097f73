"""How far a diagnosis is: stages are named, nothing is taken back, and the end comes when all is done."""

import random

from artibot_sim.diagnose.timetable import Task, Timetable


def test_what_is_done_grows_and_ends_at_all() -> None:
    """However many searches follow on one another, and with as many parts as there may be."""
    for searches in range(5):
        told: list[tuple[float, str]] = []
        table = Timetable(lambda share, what: told.append((share, what)))  # noqa: B023  called in here
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
    table = Timetable(lambda share, what: told.append((share, what)))
    table.begin(Task.SEARCH, "beside slope")
    table()
    assert {what for _, what in told} == {"looking for effects beside slope"}
    table.begin(Task.SEARCH, "beside slope, gear drag")
    more = told[-1][0]
    table.begin(Task.LEAVING_OUT)
    assert told[-1][0] > more + Task.SEARCH.duration / sum(task.duration for task in Task) / 2.0
