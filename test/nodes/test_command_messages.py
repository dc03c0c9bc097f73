"""What is refused before it can move the rover."""

from __future__ import annotations

import math
from types import SimpleNamespace as Record

import pytest
from hypothesis import given
from hypothesis import strategies as st

from artibot_sim.nodes.common.arbiter import CommandSource, Rules, parse_request, parse_sources, parse_twist
from artibot_sim.nodes.common.profile import Refused, parse_profile

NAN = math.nan
RULES = Rules(metres_per_radian=0.01, track=0.5, torque_max=2.0)
FRONT = ["front_right", "front_left"]
ALL = [*FRONT, "back_right", "back_left"]


def request(name=FRONT, velocity=(1.0, 2.0), effort=()):
    return Record(name=name, velocity=velocity, effort=effort, position=())


def twist(*numbers: float) -> Record:
    fields = [Record(x=0.0, y=0.0, z=0.0), Record(x=0.0, y=0.0, z=0.0)]
    for i, number in enumerate(numbers):
        setattr(fields[i // 3], "xyz"[i % 3], number)
    return Record(linear=fields[0], angular=fields[1])


def trajectory(names=FRONT, points=((0, (0.0, 0.0)), (1, (1.0, 2.0))), positions=None) -> Record:
    made = [
        Record(
            time_from_start=Record(sec=t, nanosec=0),
            velocities=v,
            positions=() if positions is None else positions[i],
        )
        for i, (t, v) in enumerate(points)
    ]
    return Record(header=Record(stamp=Record(sec=5, nanosec=7)), joint_names=names, points=made)


def test_a_request_is_taken_by_names_in_any_order() -> None:
    front, effort, remark = parse_request(request(FRONT[::-1], (1.0, 2.0)), RULES)
    assert front == (2.0, 1.0) and all(map(math.isnan, effort)) and not remark


def test_back_efforts_are_optional_each_and_cut_to_the_motors_limit() -> None:
    _, effort, _ = parse_request(request(ALL, (1.0, 2.0, NAN, NAN), (NAN, NAN, 5.0, NAN)), RULES)
    assert effort[0] == RULES.torque_max and math.isnan(effort[1])
    _, effort, _ = parse_request(request(ALL, (1.0, 2.0, NAN, NAN), (NAN, NAN, -5.0, 0.5)), RULES)
    assert effort == (-RULES.torque_max, 0.5)


def test_what_cannot_be_commanded_is_said() -> None:
    _, _, remark = parse_request(request(ALL, (1.0, 2.0, 3.0, 0.0), (0.1, NAN, NAN, NAN)), RULES)
    assert "back_right.velocity" in remark and "front_right.effort" in remark and "back_left" not in remark


@pytest.mark.parametrize(
    "message",
    [
        request(velocity=(NAN, 1.0)),
        request(velocity=(1.0, math.inf)),
        request(velocity=()),
        request(velocity=(1.0,)),
        request(velocity=(1.0, 2.0, 3.0)),
        request(effort=(1.0,)),
        request(name=["front_right", "front_wrong"]),
        request(name=["front_right"], velocity=(1.0,)),
        request(name=["front_right", "front_right"]),
        request(name=[], velocity=()),
        request(name=ALL, velocity=(1.0, 2.0, NAN, NAN), effort=(NAN, NAN, math.inf, NAN)),
        request(velocity=(1e6, 0.0)),
    ],
)
def test_bad_requests_are_refused_with_a_reason(message: Record) -> None:
    with pytest.raises(Refused) as refusal:
        parse_request(message, RULES)
    assert len(str(refusal.value)) > 20


@given(v=st.floats(-3.0, 3.0), w=st.floats(-3.0, 3.0))
def test_a_twist_goes_through_inverse_kinematics(v: float, w: float) -> None:
    right, left = parse_twist(twist(v, 0, 0, 0, 0, w), RULES)
    assert RULES.metres_per_radian * (right + left) / 2 == pytest.approx(v, abs=1e-12)
    assert RULES.metres_per_radian * (right - left) / RULES.track == pytest.approx(w, abs=1e-12)


@pytest.mark.parametrize("place", range(6))
@pytest.mark.parametrize("bad", [NAN, math.inf, -math.inf])
def test_a_twist_with_anything_not_finite_is_refused(place: int, bad: float) -> None:
    numbers = [0.1] * 6
    numbers[place] = bad
    with pytest.raises(Refused):
        parse_twist(twist(*numbers), RULES)


def test_a_twist_faster_than_any_rover_is_refused() -> None:
    with pytest.raises(Refused, match="max_speed"):
        parse_twist(twist(19.9, 0, 0, 0, 0, 1.0), RULES)


def test_a_profile_is_taken_by_names_with_its_stamp() -> None:
    profile = parse_profile(trajectory(FRONT[::-1]))
    assert profile.start_ns == 5_000_000_007
    assert profile.velocity[1] == (2.0, 1.0)
    assert profile.position[1] == (1.0, 0.5)


@given(t=st.floats(0.0, 1.0))
def test_velocities_without_positions_are_linear_between_points(t: float) -> None:
    profile = parse_profile(trajectory())
    velocity, position = profile.sample(profile.start_ns + round(t * 1e9))
    assert velocity == pytest.approx((t, 2 * t), abs=1e-8)
    assert position == pytest.approx((t * t / 2, t * t), abs=1e-8)


@pytest.mark.parametrize(
    "message",
    [
        trajectory(points=()),
        trajectory(names=["front_right", "back_left"]),
        trajectory(names=["front_right"], points=((0, (1.0,)),)),
        trajectory(names=ALL, points=((0, (1.0,) * 4),)),
        trajectory(points=((0, (0.0, 0.0)), (0, (1.0, 1.0)))),
        trajectory(points=((2, (0.0, 0.0)), (1, (1.0, 1.0)))),
        trajectory(points=((-1, (0.0, 0.0)), (1, (1.0, 1.0)))),
        trajectory(points=((0, (0.0, 0.0)), (1, (NAN, 1.0)))),
        trajectory(points=((0, (0.0,)), (1, (1.0, 1.0)))),
        trajectory(points=((0, ()), (1, ()))),
        trajectory(positions=((0.0, 0.0), ())),
        trajectory(positions=((0.0, 0.0), (0.0, NAN))),
        trajectory(points=((0, (10.0, 10.0)), (1, (10.0, 10.0))), positions=((0.0, 0.0), (0.0, 0.0))),
    ],
)
def test_bad_profiles_are_refused_with_a_reason(message: Record) -> None:
    with pytest.raises(Refused) as refusal:
        parse_profile(message)
    assert len(str(refusal.value)) > 20


def test_sources_by_name() -> None:
    assert parse_sources("auto") == (CommandSource.LIVE, CommandSource.PROFILE, CommandSource.CMD_VEL)
    assert parse_sources("none") == ()
    assert parse_sources("cmd_vel, live") == (CommandSource.CMD_VEL, CommandSource.LIVE)
    for bad in ("", "live,live", "joystick", "auto,live"):
        with pytest.raises(Refused):
            parse_sources(bad)
