"""The CiA 402 state machine has the standard's properties, whatever words it is given."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from artibot_driver.cia402 import (
    TARGETS,
    TRANSITIONS,
    Command,
    DriveEvent,
    DriveState,
    OperationMode,
    StatusBit,
    command_of,
    controlword_for,
    next_command,
    state_of,
    statusword,
    transition,
)

WORDS = st.integers(0, 0xFFFF)
STATES = st.sampled_from(DriveState)


def drive(state: DriveState, controlword: int, previous: int, holds: bool = False) -> DriveState:
    """Where a drive ends that works a controlword off as the standard says."""
    command = command_of(controlword, previous)
    while (taken := transition(state, command, holds=holds)) is not None:
        state = taken.end
    return state


def test_every_statusword_has_at_most_one_state() -> None:
    for word in range(0x10000):
        matching = [state for state in DriveState if state.value.matches(word)]
        assert len(matching) <= 1
        assert state_of(word) is (matching[0] if matching else None)


@given(STATES, WORDS)
def test_the_other_bits_do_not_touch_the_state(state: DriveState, bits: int) -> None:
    word = statusword(state, bits)
    assert state_of(word) is state
    assert word & StatusBit.REMOTE == bits & StatusBit.REMOTE


def test_the_standard_s_own_examples() -> None:
    # statuswords and controlwords as manuals of drives print them
    shown = {0x0250: "SWITCH_ON_DISABLED", 0x0231: "READY_TO_SWITCH_ON", 0x0233: "SWITCHED_ON"}
    shown |= {0x0237: "OPERATION_ENABLED", 0x0217: "QUICK_STOP_ACTIVE", 0x021F: "FAULT_REACTION_ACTIVE"}
    shown |= {0x0218: "FAULT", 0x0200: "NOT_READY_TO_SWITCH_ON"}
    assert {word: str(getattr(state_of(word), "name", None)) for word in shown} == shown
    sent = {0x06: Command.SHUTDOWN, 0x07: Command.SWITCH_ON, 0x0F: Command.ENABLE_OPERATION, 0x80: Command.FAULT_RESET}
    sent |= {
        0x00: Command.DISABLE_VOLTAGE,
        0x02: Command.QUICK_STOP,
        0x0B: Command.QUICK_STOP,
        0x80: Command.FAULT_RESET,
    }
    assert {word: command_of(word) for word in sent} == sent


def test_the_numbers_are_the_standard_s_and_no_trigger_is_ambiguous() -> None:
    assert {row.number for row in TRANSITIONS} == set(range(1, 17))
    triggers = [(row.start, trigger) for row in TRANSITIONS for trigger in row.triggers]
    assert len(triggers) == len(set(triggers))


@given(WORDS, WORDS)
def test_a_controlword_gives_at_most_one_command(word: int, previous: int) -> None:
    matching = [command for command in Command if command.value.matches(word)]
    assert len(matching) <= 1
    held = bool(word & previous & 0x80)
    assert command_of(word, previous) is (None if held or not matching else matching[0])


@pytest.mark.parametrize("holds", [False, True])
@given(word=WORDS, previous=WORDS)
def test_only_an_edge_of_fault_reset_leads_out_of_fault(holds: bool, word: int, previous: int) -> None:
    edge = bool(word & 0x80) and not previous & 0x80
    end = drive(DriveState.FAULT, word, previous, holds)
    assert end is (DriveState.SWITCH_ON_DISABLED if edge else DriveState.FAULT)


@given(st.sampled_from([DriveState.NOT_READY_TO_SWITCH_ON, DriveState.FAULT_REACTION_ACTIVE]), WORDS, WORDS)
def test_no_controlword_moves_a_drive_that_is_busy_with_itself(state: DriveState, word: int, previous: int) -> None:
    assert drive(state, word, previous) is state


@pytest.mark.parametrize("holds", [False, True])
@given(word=WORDS, previous=WORDS)
def test_disable_voltage_and_quick_stop_always_lead_away_from_enabled(holds: bool, word: int, previous: int) -> None:
    if not word & 0x80 and (not word & 0x02 or not word & 0x04):
        end = drive(DriveState.OPERATION_ENABLED, word, previous, holds)
        assert end is (DriveState.QUICK_STOP_ACTIVE if word & 0x02 else DriveState.SWITCH_ON_DISABLED)
    if not word & 0x82:
        for state in set(DriveState) - {
            DriveState.FAULT,
            DriveState.FAULT_REACTION_ACTIVE,
            DriveState.NOT_READY_TO_SWITCH_ON,
        }:
            assert drive(state, word, previous, holds) is DriveState.SWITCH_ON_DISABLED


@given(STATES, WORDS, WORDS)
def test_power_comes_only_by_enable_operation(state: DriveState, word: int, previous: int) -> None:
    end = drive(state, word, previous)
    if end is DriveState.OPERATION_ENABLED and state is not DriveState.OPERATION_ENABLED:
        assert word & 0x8F == 0x0F
        assert state in (DriveState.READY_TO_SWITCH_ON, DriveState.SWITCHED_ON)


@given(STATES)
def test_a_fault_is_noticed_in_every_state_and_no_event_enables(state: DriveState) -> None:
    faulted = (DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE)
    assert (transition(state, DriveEvent.FAULT) is None) is (state in faulted)
    for event in DriveEvent:
        taken = transition(state, event)
        assert taken is None or taken.end is not DriveState.OPERATION_ENABLED
        if event is DriveEvent.FAULT and taken is not None:
            assert taken.end is DriveState.FAULT_REACTION_ACTIVE


def test_a_held_quick_stop_stays_and_only_then_can_be_enabled_again() -> None:
    stopped = DriveState.QUICK_STOP_ACTIVE
    assert transition(stopped, DriveEvent.QUICK_STOP_DONE, holds=True) is None
    assert drive(stopped, 0x0F, 0x02, holds=True) is DriveState.OPERATION_ENABLED
    assert drive(stopped, 0x0F, 0x02, holds=False) is stopped
    done = transition(stopped, DriveEvent.QUICK_STOP_DONE)
    assert done is not None
    assert done.number == 12


def settle(state: DriveState) -> DriveState:
    """What a drive does by itself before the next controlword."""
    for event in (DriveEvent.INITIALISED, DriveEvent.FAULT_REACTION_DONE):
        taken = transition(state, event)
        state = taken.end if taken else state
    return state


def path(state: DriveState, target: DriveState, previous: int, holds: bool, reset: bool) -> list[DriveState]:
    """States on the way when a master leads a drive with `controlword_for`."""
    passed = [state]
    for _ in range(12):
        word = controlword_for(state, target, previous, reset_faults=reset)
        state, previous = drive(settle(state), word, previous, holds), word
        passed.append(state)
    return passed


@pytest.mark.parametrize("holds", [False, True])
@given(state=STATES, previous=WORDS)
def test_every_state_reaches_operation_enabled_and_stays(holds: bool, state: DriveState, previous: int) -> None:
    assert (
        path(state, DriveState.OPERATION_ENABLED, previous, holds, reset=True)[-3:]
        == [DriveState.OPERATION_ENABLED] * 3
    )


@given(state=STATES, target=st.sampled_from(TARGETS), previous=WORDS, reset=st.booleans())
def test_every_target_is_reached_without_enabling_on_the_way(
    state: DriveState, target: DriveState, previous: int, reset: bool
) -> None:
    passed = path(state, target, previous, holds=True, reset=reset)
    faulted = state in (DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE)
    if faulted and not reset:
        assert passed[-1] is DriveState.FAULT
    elif target is DriveState.QUICK_STOP_ACTIVE and state not in (DriveState.OPERATION_ENABLED, target):
        assert passed[-1] is (DriveState.FAULT if faulted else DriveState.SWITCH_ON_DISABLED)
    else:
        assert passed[-1] is target
    if target is not DriveState.OPERATION_ENABLED:
        assert DriveState.OPERATION_ENABLED not in passed[1:]


@pytest.mark.parametrize("target", sorted(set(DriveState) - set(TARGETS), key=str))
def test_what_a_master_cannot_ask_for_is_refused(target: DriveState) -> None:
    with pytest.raises(ValueError, match="a master cannot ask for"):
        next_command(DriveState.SWITCHED_ON, target)


def test_the_bits_of_supported_modes_are_the_standard_s() -> None:
    assert {int(mode): mode.supported_bit for mode in OperationMode} == {3: 0x4, 4: 0x8, 9: 0x100, 10: 0x200}
    assert [mode.is_velocity for mode in OperationMode] == [True, False, True, False]
