"""The master's phases: what must hold of the table, whatever the facts are."""

from __future__ import annotations

import itertools

import pytest

from artibot_driver.master.phases import TABLE, Facts, Phase, next_phase

ALL_FACTS = [Facts(*bits) for bits in itertools.product((False, True), repeat=len(Facts._fields))]
RESTING = [phase for phase in Phase if not phase.moves]


def ends(start: Phase, **fixed: bool) -> set[Phase]:
    """Where the table can lead to from a phase, with some of the facts fixed."""
    return {next_phase(start, facts._replace(**fixed)) for facts in ALL_FACTS}


def test_every_name_in_the_table_is_a_fact() -> None:
    assert {name for row in TABLE for name in (*row.needs, *row.bars)} <= set(Facts._fields)


def test_enabling_begins_only_in_ready_and_only_when_asked_for() -> None:
    for start in Phase:
        if start is not Phase.ENABLING:
            assert (Phase.ENABLING in ends(start)) == (start is Phase.READY)
            assert Phase.ENABLING not in ends(start, enable=False)


def test_enabling_needs_a_bus_all_drives_and_no_fault() -> None:
    for missing in ({"carries": False}, {"alone": False}, {"complete": False}, {"faulted": True}):
        assert Phase.ENABLING not in ends(Phase.READY, **missing)


def test_enabled_comes_only_after_enabling_with_all_drives_enabled() -> None:
    for start in Phase:
        if start is not Phase.ENABLED:
            assert (Phase.ENABLED in ends(start)) == (start is Phase.ENABLING)
    assert Phase.ENABLED not in ends(Phase.ENABLING, all_enabled=False)


@pytest.mark.parametrize("start", [Phase.ENABLING, Phase.ENABLED])
def test_an_incident_always_stops_and_nothing_else_does(start: Phase) -> None:
    assert ends(start, incident=True) == {Phase.STOPPING}
    assert ends(start, incident=False) <= {Phase.ENABLING, Phase.ENABLED}


def test_stopping_ends_at_rest_and_not_before_it_has_stopped() -> None:
    assert ends(Phase.STOPPING, stopped=False) == {Phase.STOPPING}
    assert ends(Phase.STOPPING, stopped=True) <= set(RESTING)


@pytest.mark.parametrize("start", RESTING)
def test_a_resting_phase_says_what_is_there(start: Phase) -> None:
    for facts in (facts._replace(enable=False) for facts in ALL_FACTS):
        expected = Phase.LOCKED if facts.faulted else Phase.READY
        expected = expected if facts.complete else Phase.CONFIGURING
        expected = expected if facts.alone else Phase.LISTENING
        assert next_phase(start, facts) is (expected if facts.carries else Phase.OFFLINE)
