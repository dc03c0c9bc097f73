"""Arbitration between command topics and the rules of silence, without ROS."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace as Record

import pytest
from hypothesis import given
from hypothesis import strategies as st

from artibot_sim.nodes.common import arbiter
from artibot_sim.nodes.common.arbiter import Commanding, CommandSource, PeriodCommands, Rules, decide, parse_sources
from artibot_sim.nodes.common.profile import Pair, Profile, Refused, parse_profile

METRES = 0.2 / 47.64
RULES = Rules(metres_per_radian=METRES, track=0.72)
STEP = 10_000_000
NAN = (math.nan, math.nan)

speeds = st.floats(-200.0, 200.0)
pairs = st.tuples(speeds, speeds)


def stamp(ns: int) -> Record:
    return Record(sec=ns // 10**9, nanosec=ns % 10**9)


def profile(start_ns: int, velocities: list[Pair], spacing: int = STEP) -> Profile:
    points = [
        Record(time_from_start=stamp(i * spacing), velocities=list(pair), positions=[])
        for i, pair in enumerate(velocities)
    ]
    names = ["front_right", "front_left"]
    return parse_profile(Record(header=Record(stamp=stamp(start_ns)), joint_names=names, points=points))


def ramped(start_ns: int, seconds: float, top: float = 100.0) -> Profile:
    """Up to `top` rad/s and down again, the left motor at half of it, acceleration far above the limits of others."""
    n = round(seconds * 1e9) // STEP
    shape = [top * math.sin(math.pi * i / n) ** 2 for i in range(n)] + [0.0]
    return profile(start_ns, [(s, 0.5 * s) for s in shape])


def run(state: Commanding, rules: Rules, steps: int, t_ns: int, now: float, alive: bool = False):
    """Some periods in real time; with `alive` the planner is heard before each."""
    decisions: list[PeriodCommands] = []
    for _ in range(steps):
        if alive:
            state = arbiter.take_sign_of_life(state, now)
        state, decision = decide(state, rules, t_ns, STEP, 1, now)
        decisions.append(decision)
        t_ns, now = t_ns + STEP, now + STEP * 1e-9
    return state, decisions, t_ns, now


def ends(decisions: list[PeriodCommands]) -> list[Pair]:
    return [decision.velocity[-1] for decision in decisions]


def speed(pair: Pair) -> float:
    return METRES * max(map(abs, pair))


@given(velocity=pairs, deceleration=st.floats(0.1, 20.0), knots=st.integers(1, 5))
def test_silence_is_a_ramp_on_the_same_curve_within_the_deceleration(
    velocity: Pair, deceleration: float, knots: int
) -> None:
    rules = replace(RULES, stop_deceleration=deceleration)
    state = Commanding(velocity=velocity, source=CommandSource.LIVE)
    for step in range(5000):
        state, decision = decide(state, rules, step * STEP, STEP // knots, knots, 0.01 * step)
        assert len(decision.velocity) == knots + 1
        for before, after in zip(decision.velocity, decision.velocity[1:], strict=False):
            assert speed(before) - speed(after) <= deceleration * STEP / knots * 1e-9 * (1 + 1e-9)
            assert speed(after) <= speed(before)
            assert after[0] * velocity[1] == pytest.approx(after[1] * velocity[0], rel=1e-9, abs=1e-12)
        if state.velocity == (0.0, 0.0):
            break
    assert state.velocity == (0.0, 0.0)
    expected = speed(velocity) / (deceleration * STEP * 1e-9)
    assert abs(step + 1 - expected) <= 1.01


@given(velocity=pairs, seen=st.lists(pairs, max_size=8))
def test_what_is_published_next_begins_where_the_last_ended(velocity: Pair, seen: list[Pair]) -> None:
    state, decisions, t_ns, now = run(Commanding(velocity=velocity), RULES, 3, 0, 0.0)
    for pair in seen:
        state = arbiter.take_live(state, pair, NAN, now)
        state, more, t_ns, now = run(state, RULES, 2, t_ns, now)
        decisions += more
    for before, after in zip(decisions, decisions[1:], strict=False):
        assert before.velocity[-1] == after.velocity[0]
        assert before.position[-1] == after.position[0]


def test_live_requests_hold_for_the_timeout_and_no_longer() -> None:
    state = arbiter.take_live(Commanding(), (80.0, 40.0), (1.0, -1.0), 5.0)
    state, decision = decide(state, RULES, 0, STEP, 1, 5.0)
    assert (decision.source, decision.velocity[-1], decision.effort) == (CommandSource.LIVE, (80.0, 40.0), (1.0, -1.0))
    state, decision = decide(state, RULES, STEP, STEP, 1, 5.1)
    assert decision.source is CommandSource.LIVE
    state, decision = decide(state, RULES, 2 * STEP, STEP, 1, 5.1001)
    assert decision.source is CommandSource.NONE and "motor_command_request" in decision.notice
    assert 0 < decision.velocity[-1][0] < 80.0 and all(map(math.isnan, decision.effort))


def test_a_profile_is_followed_to_the_bit_and_ends_at_its_rotation() -> None:
    plan = ramped(50 * STEP, 1.0)
    state = arbiter.take_profile(Commanding(), plan, RULES, 0, 0.0)
    state, decisions, _, _ = run(state, RULES, 200, 0, 0.0, alive=True)
    told = [pair for decision in decisions for pair in decision.velocity[:1]]
    assert told[:50] == [(0.0, 0.0)] * 50
    assert told[50:151] == list(plan.velocity)
    assert state.pending is None and state.velocity == (0.0, 0.0)
    assert state.position == pytest.approx(plan.position[-1], rel=1e-12)


@given(phase=st.integers(1, STEP - 1))
def test_a_profile_off_the_grid_is_followed_too(phase: int) -> None:
    plan = ramped(3 * STEP + phase, 1.0)
    state = arbiter.take_profile(Commanding(), plan, RULES, 0, 0.0)
    state, decisions, t_ns, _ = run(state, RULES, 60, 0, 0.0, alive=True)
    assert decisions[-1].velocity[-1] == plan.sample(t_ns)[0]
    state, decisions, _, _ = run(state, RULES, 60, t_ns, 0.6, alive=True)
    assert state.position == pytest.approx(plan.position[-1], rel=1e-9)


@given(late_ns=st.integers(1, arbiter.STALE_NS))
def test_a_late_profile_catches_up_at_the_acceleration_limit(late_ns: int) -> None:
    plan = ramped(0, 6.0)
    state = arbiter.take_profile(Commanding(), plan, RULES, late_ns, 0.0)
    _, decisions, _, _ = run(state, RULES, 150, late_ns, 0.0, alive=True)
    velocities = [(0.0, 0.0), *ends(decisions)]
    caught = False
    for i, (before, after) in enumerate(zip(velocities, velocities[1:], strict=False)):
        on = after == plan.sample(late_ns + (i + 1) * STEP)[0]
        if not (caught or on):
            change = METRES * max(abs(after[0] - before[0]), abs(after[1] - before[1]))
            assert change <= RULES.acceleration_limit * STEP * 1e-9 * (1 + 1e-9)
        assert on or not caught
        caught = caught or on
    assert caught


def test_a_stale_profile_and_one_on_another_clock_are_refused() -> None:
    at = 10**18
    arbiter.take_profile(Commanding(), ramped(at - arbiter.STALE_NS, 1.0), RULES, at, 0.0)
    with pytest.raises(Refused, match=r"1\.000 s in the past.*clock"):
        arbiter.take_profile(Commanding(), ramped(at - arbiter.STALE_NS - 1, 1.0), RULES, at, 0.0)
    with pytest.raises(Refused, match=r"ahead.*use_sim_time"):
        arbiter.take_profile(Commanding(), ramped(at, 1.0), RULES, STEP, 0.0)
    with pytest.raises(Refused, match="max_speed"):
        arbiter.take_profile(Commanding(), ramped(at, 1.0, top=1e6), RULES, at, 0.0)


def test_without_a_sign_of_life_the_profile_ends_in_a_ramp_and_is_not_taken_up_again() -> None:
    plan = ramped(0, 4.0)
    state = arbiter.take_profile(Commanding(), plan, RULES, 0, 0.0)
    state, _, t_ns, now = run(state, RULES, 100, 0, 0.0, alive=True)
    state, decisions, t_ns, now = run(state, RULES, 12, t_ns, now)
    sources = [decision.source for decision in decisions]
    assert sources[:9] == [CommandSource.PROFILE] * 9 and sources[-1] is CommandSource.NONE
    assert any("sign of life" in decision.notice for decision in decisions)
    state, decisions, t_ns, now = run(state, RULES, 100, t_ns, now, alive=True)
    assert state.velocity == (0.0, 0.0)
    again = arbiter.take_profile(state, plan, RULES, t_ns - STEP, now)
    assert again.pending is None


def test_a_planner_silent_before_its_start_is_not_followed() -> None:
    state = arbiter.take_profile(Commanding(), ramped(100 * STEP, 1.0), RULES, 0, 0.0)
    state, _, t_ns, now = run(state, RULES, 30, 0, 0.0, alive=True)
    state, decisions, _, _ = run(state, RULES, 120, t_ns, now)
    assert set(ends(decisions)) == {(0.0, 0.0)}
    assert any("silent before" in decision.notice for decision in decisions)


def test_a_planner_never_heard_is_followed_for_the_timeout_only() -> None:
    state = arbiter.take_profile(Commanding(), ramped(10 * STEP, 4.0), RULES, 0, 0.0)
    _, decisions, _, _ = run(state, RULES, 60, 0, 0.0)
    followed = [decision.source for decision in decisions].count(CommandSource.PROFILE)
    assert 0 < followed <= 12


def test_as_fast_as_it_goes_needs_no_sign_of_life() -> None:
    plan = ramped(0, 2.0)
    rules = replace(RULES, needs_sign_of_life=False)
    state = arbiter.take_profile(Commanding(), plan, rules, 0, 0.0)
    state, decisions, _, _ = run(state, rules, 199, 0, 0.0)
    assert ends(decisions) == list(plan.velocity[1:-1])


def test_the_same_profile_again_changes_nothing() -> None:
    plan = ramped(20 * STEP, 2.0)
    state = arbiter.take_profile(Commanding(), plan, RULES, 0, 0.0)
    state, _, t_ns, now = run(state, RULES, 80, 0, 0.0, alive=True)
    assert arbiter.take_profile(state, ramped(20 * STEP, 2.0), RULES, t_ns, now) is state


def test_default_precedence() -> None:
    state = arbiter.take_twist(Commanding(), (10.0, 10.0), 0.0)
    state, decisions, t_ns, now = run(state, RULES, 20, 0, 0.0)
    assert decisions[-1].source is CommandSource.CMD_VEL
    state = arbiter.take_profile(state, ramped(t_ns, 2.0), RULES, t_ns, now)
    state, decisions, t_ns, now = run(state, RULES, 20, t_ns, now, alive=True)
    assert decisions[-1].source is CommandSource.PROFILE
    state = arbiter.take_live(state, (5.0, 5.0), NAN, now)
    state, decisions, t_ns, now = run(state, RULES, 1, t_ns, now, alive=True)
    assert decisions[-1].source is CommandSource.LIVE and "profile under way is dropped" in decisions[-1].notice
    state, decisions, t_ns, now = run(state, RULES, 60, t_ns, now, alive=True)
    assert decisions[-1].source is CommandSource.NONE, "neither the dropped profile nor the old twist come back"


@pytest.mark.parametrize("order", ["cmd_vel,live", "live,cmd_vel", "cmd_vel", "live", "none"])
def test_precedence_is_a_parameter(order: str) -> None:
    rules = replace(RULES, sources=parse_sources(order))
    state = arbiter.take_live(arbiter.take_twist(Commanding(), (10.0, 10.0), 0.0), (5.0, 5.0), NAN, 0.0)
    state = arbiter.take_profile(state, ramped(0, 1.0), rules, 0, 0.0)
    _, decision = decide(state, rules, 0, STEP, 1, 0.0)
    assert decision.source.value == order.split(",")[0]


@given(events=st.lists(st.tuples(st.sampled_from(["live", "twist", "profile", "sign", "wait"]), pairs), max_size=12))
def test_nothing_heard_makes_a_command_that_is_not_finite_or_moves_after_long_silence(
    events: list[tuple[str, Pair]],
) -> None:
    state, t_ns, now = Commanding(), 10**9, 100.0
    for kind, pair in events:
        if kind == "live":
            state = arbiter.take_live(state, pair, NAN, now)
        elif kind == "twist":
            state = arbiter.take_twist(state, pair, now)
        elif kind == "profile":
            state = arbiter.take_profile(state, profile(t_ns, [(0.0, 0.0), pair, (0.0, 0.0)]), RULES, t_ns, now)
        elif kind == "sign":
            state = arbiter.take_sign_of_life(state, now)
        state, decisions, t_ns, now = run(state, RULES, 3, t_ns, now)
        for decision in decisions:
            assert all(math.isfinite(v) for knot in (*decision.velocity, *decision.position) for v in knot)
    state, decisions, _, _ = run(state, RULES, 120, t_ns, now)
    assert state.velocity == (0.0, 0.0) and decisions[-1].source is CommandSource.NONE


@pytest.mark.parametrize(("source", "hear"), [(CommandSource.LIVE, "live"), (CommandSource.CMD_VEL, "twist")])
@pytest.mark.parametrize("refused", [True, False])
def test_only_a_source_that_asked_for_motion_is_silenced(source: CommandSource, hear: str, refused: bool) -> None:
    def heard(state: Commanding, velocity: Pair, now: float) -> Commanding:
        if hear == "live":
            return arbiter.take_live(state, velocity, NAN, now)
        return arbiter.take_twist(state, velocity, now)

    timeout = RULES.command_timeout if hear == "live" else RULES.cmd_vel_timeout
    for velocity in ((80.0, 40.0), (0.0, 0.0)):
        state, decisions, t_ns, now = run(heard(Commanding(), velocity, 5.0), RULES, 5, 0, 5.0)
        assert not any(each.silenced for each in decisions)
        if refused:
            state = arbiter.take_refusal(state, source)
        state, decisions, *_ = run(state, RULES, 60, t_ns, now)
        first = next((k for k, each in enumerate(decisions) if each.silenced), None)
        if velocity == (0.0, 0.0):
            assert first is None
        elif refused:
            assert first == 0, "a refused message ends what came before it at once"
        else:
            assert 0.01 * first + 0.05 == pytest.approx(timeout, abs=0.011)
        assert sum(each.silenced for each in decisions) <= 1, "said once"


def test_a_refused_message_leaves_other_sources_and_a_profile_alone() -> None:
    state = arbiter.take_twist(arbiter.take_live(Commanding(), (1.0, 1.0), NAN, 0.0), (2.0, 2.0), 0.0)
    state = arbiter.take_profile(state, ramped(10**9, 1.0), RULES, 0, 0.0)
    assert arbiter.take_refusal(state, CommandSource.LIVE) == replace(state, live=None)
    assert arbiter.take_refusal(state, CommandSource.CMD_VEL) == replace(state, twist=None)
    assert arbiter.take_refusal(state, CommandSource.PROFILE) == state


def test_a_planner_that_dies_silences_its_profile_and_one_that_is_over_does_not() -> None:
    for dies in (True, False):
        state = arbiter.take_profile(Commanding(), ramped(0, 1.0), RULES, 0, 0.0)
        state, decisions, t_ns, now = run(state, RULES, 40, 0, 0.0, alive=True)
        state, more, *_ = run(state, RULES, 100, t_ns, now, alive=not dies)
        assert not any(each.silenced for each in decisions)
        assert sum(each.silenced for each in more) == dies
