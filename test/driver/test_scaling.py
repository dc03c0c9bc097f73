"""Scaling is exact to rounding, its own inverse, loud where it saturates, and refuses what is no number."""

from __future__ import annotations

import math
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from artibot_driver.scaling import INT32, OBJECTS, MotorScaling, Scale, motor_scaling, unwrap, wrap
from artibot_sim.errors import ArtibotError
from artibot_sim.model import MOTORS, load_robot

AGRIQ = load_robot("agriq")


def scaling(motor: str = "front_left", exponent: int = -3, max_speed: float = math.inf) -> MotorScaling:
    return motor_scaling(AGRIQ, motor, counts_per_turn=4096, velocity_exponent=exponent, max_speed=max_speed)


SCALES = [
    getattr(scaling(motor, exponent), name)
    for motor in ("front_right", "back_left")
    for exponent in (0, -3)
    for name in sorted(set(OBJECTS.values()))
]
IDS = [f"{scale.what} in {scale.step:.3g} {scale.unit}".replace(" ", "-") for scale in SCALES]


@pytest.mark.parametrize("scale", SCALES, ids=IDS)
@given(data=st.data())
def test_every_integer_comes_back(scale: Scale, data: st.DataObject) -> None:
    raw = data.draw(st.integers(scale.low, scale.high))
    assert scale.raw(scale.si(raw)) == (raw, False)


@pytest.mark.parametrize("scale", SCALES, ids=IDS)
@given(value=st.floats(allow_nan=False))
def test_the_nearest_integer_or_the_limit_and_then_it_says_so(scale: Scale, value: float) -> None:
    raw, saturated = scale.raw(value)
    if math.isinf(value):
        exact = Fraction(2) ** 2000 * int(math.copysign(1, value)) * int(math.copysign(1, scale.step))
    else:
        exact = Fraction(value) / Fraction(scale.step)
    nearest = min(max(exact, Fraction(scale.low)), Fraction(scale.high))
    assert scale.low <= raw <= scale.high
    assert abs(raw - nearest) <= Fraction(1, 2) + Fraction(1, 2**20)  # the quotient itself is a rounded double
    beyond = max(scale.low - exact, exact - scale.high)  # how far outside; at a half either answer is right
    assert saturated or beyond <= Fraction(1, 2) + Fraction(1, 2**20)
    assert not saturated or beyond >= Fraction(1, 2) - Fraction(1, 2**20)


def test_half_goes_to_even() -> None:
    step_of_half = Scale("N m", 0.5, -10, 10, "a torque")
    assert [step_of_half.raw(value).raw for value in (0.25, 0.75, 1.25, -0.25, -0.75)] == [0, 2, 2, 0, -2]


@pytest.mark.parametrize("scale", SCALES, ids=IDS)
@given(a=st.floats(-1e6, 1e6), b=st.floats(-1e6, 1e6))
def test_order_is_kept_or_turned_by_polarity(scale: Scale, a: float, b: float) -> None:
    low, high = scale.raw(min(a, b)).raw, scale.raw(max(a, b)).raw
    assert low <= high if scale.step > 0 else low >= high


@pytest.mark.parametrize("motor", MOTORS)
def test_polarity_turns_what_has_a_direction_and_nothing_else(motor: str) -> None:
    sign = -1 if motor.endswith("right") else 1  # config/agriq.yaml: mirrored mounting
    mine = scaling(motor)
    assert {math.copysign(1, getattr(mine, name).step) for name in ("position", "velocity", "torque")} == {sign}
    for name in ("acceleration", "torque_slope", "torque_limit", "speed_limit"):
        assert getattr(mine, name).step > 0


def test_the_units_are_those_of_the_standard() -> None:
    mine = scaling("front_left", exponent=-1)
    assert mine.position.raw(2 * math.pi).raw == 4096
    assert mine.velocity.raw(2 * math.pi * 50).raw == 30000  # 3000 rpm in tenths
    assert mine.speed_limit.raw(2 * math.pi * 50).raw == 3000
    assert mine.acceleration.raw(2 * math.pi).raw == 600
    assert (mine.rated_torque, mine.rated_current) == (600, 10000)  # 0.6 N m; at 0.06 N m/A
    assert mine.torque.raw(0.3) == (500, False)
    assert mine.torque_slope.raw(1.2).raw == 2000


def test_the_motor_s_limits_cut_set_points_off() -> None:
    mine = scaling("back_right", max_speed=100.0)
    assert mine.torque.raw(0.6) == (-1000, False)
    assert mine.torque.raw(0.7) == (-1000, True)
    assert mine.torque_limit.raw(math.inf) == (1000, True)
    assert mine.velocity.si(mine.velocity.raw(-1e9).raw) == pytest.approx(-100.0, abs=abs(mine.velocity.step))
    assert abs(mine.velocity.si(mine.velocity.low)) <= 100.0 * (1 + 1e-12)


def test_without_a_largest_torque_the_rated_one_is_the_limit() -> None:
    free = AGRIQ.replace({"drive.front.torque_max": math.inf})
    mine = motor_scaling(free, "front_left", counts_per_turn=4096, velocity_exponent=-3)
    assert mine.torque.si(mine.torque.raw(100.0).raw) == pytest.approx(free.drive.front.rated_torque)
    assert mine.torque_limit.raw(math.inf) == (1000, True)


@pytest.mark.parametrize("scale", SCALES, ids=IDS)
def test_nan_is_refused_by_name(scale: Scale) -> None:
    with pytest.raises(ArtibotError, match=f"^{scale.what}: found NaN"):
        scale.raw(math.nan)


@given(start=st.integers(-(2**40), 2**40), moves=st.lists(st.integers(-(2**31), 2**31 - 1), max_size=20))
def test_positions_count_on_through_the_wrap(start: int, moves: list[int]) -> None:
    true = known = start
    for move in moves:
        true += move
        raw = wrap(true)
        assert INT32[0] <= raw <= INT32[1]
        known = unwrap(raw, known)
        assert known == true


@pytest.mark.parametrize(
    ("robot", "motor", "message"),
    [
        ("husky", "front_left", "robot 'husky': drive.front.rated_torque: missing"),
        ("husky", "back_left", "motor back_left: robot 'husky' is rigid"),
        ("agriq", "middle_left", "motor 'middle_left': unknown; expected one of front_right"),
    ],
)
def test_a_robot_that_does_not_fit_is_refused(robot: str, motor: str, message: str) -> None:
    with pytest.raises(ArtibotError, match=message):
        motor_scaling(load_robot(robot), motor, counts_per_turn=4096, velocity_exponent=0)


@pytest.mark.parametrize("rated", [1e-4, 1e8])
def test_a_rated_torque_that_no_drive_holds_is_refused(rated: float) -> None:
    robot = AGRIQ.replace({"drive.front.rated_torque": rated})
    with pytest.raises(ArtibotError, match=r"drive.front.rated_torque: .* a drive holds 0.001 to"):
        motor_scaling(robot, "front_left", counts_per_turn=4096, velocity_exponent=0)
