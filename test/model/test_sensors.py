"""Effects on sensors: nothing when neutral, and otherwise what they say, in predictions and in starts."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from model.effects import SENSORS_1, with_effects

from artibot_sim.model import Mode, Robot, initial_state, load_robot, rollout
from artibot_sim.model.effects import EFFECTS
from artibot_sim.model.robot.parameters import NO_SENSOR_ERRORS, SensorErrors
from artibot_sim.model.simulate.commands import Commands
from artibot_sim.model.simulate.sensors import low_passed, measured_starts, sensor_errors, true_starts
from artibot_sim.model.simulate.window_inputs import KINDS, Items, MotorTable, SamplingPlan
from artibot_sim.model.simulate.windows import WindowBatch

ALL = (Mode.PRESCRIBED,) * 4
MEASURED = tuple(KINDS.index(k) for k in (
    "x", "y", "yaw", "yaw_rate", "torque_front_right", "torque_front_left", "torque_back_right", "torque_back_left",
))  # fmt: skip
T = np.round(np.arange(0.5, 2.9, 0.05), 9)
PLAN = SamplingPlan(np.tile(T, len(MEASURED)), np.repeat(MEASURED, len(T)))


def table(scale: float = 1.0) -> MotorTable:
    """Four motors that speed up in a curve, as encoders with a scale record them."""
    t = np.arange(0.0, 3.0 + 1e-9, 0.01)
    rise = 60.0 * np.sin(0.5 * np.pi * np.clip(t, 0, 1)) ** 2
    speed = np.column_stack([1.3 * rise, 0.7 * rise, 0.8 * rise, 0.5 * rise])
    angle = np.vstack([np.zeros(4), np.cumsum(0.005 * (speed[1:] + speed[:-1]), axis=0)])
    return MotorTable(0.01, scale * angle, scale * speed, np.full_like(speed, np.nan), ALL)


def predicted(robot: Robot, motors: MotorTable | None = None, yaw: float = 0.0, plan: SamplingPlan = PLAN) -> dict:
    """Kind → what the robot's sensors see at T, from rest."""
    state = initial_state(robot, x=1.0, y=-2.0, yaw=yaw)
    one, zero = np.ones(1, np.int64), np.zeros(1, np.int64)
    items = Items(zero, zero, zero, zero, 300 * one, state.q[None], state.v[None], np.zeros(1))
    (seen,) = WindowBatch([motors or table()], [plan], 2.5e-3, workers=1).run([robot], items)
    return dict(zip(MEASURED, seen.reshape(len(MEASURED), -1), strict=True))


@pytest.fixture(scope="module")
def agriq() -> Robot:
    return load_robot("agriq")


@pytest.fixture(scope="module")
def plain(agriq: Robot) -> dict:
    return predicted(agriq)


def test_every_effect_on_sensors_is_in_the_tests_table() -> None:
    assert {name for name, effect in EFFECTS.items() if effect.acts == "sensor"} == set(SENSORS_1)


@pytest.mark.parametrize("name", sorted(SENSORS_1))
def test_neutral_is_bit_identical(agriq: Robot, plain: dict, name: str) -> None:
    neutral = {key: parameter.neutral for key, parameter in EFFECTS[name].parameters.items()}
    robot = with_effects(agriq, **{name: neutral})
    assert sensor_errors(robot) == NO_SENSOR_ERRORS
    for kind, seen in predicted(robot).items():
        np.testing.assert_array_equal(seen, plain[kind])


@pytest.mark.parametrize("name", sorted(SENSORS_1))
def test_the_rover_itself_knows_nothing_of_its_sensors(agriq: Robot, name: str) -> None:
    commands = Commands(0.01, np.where([True, True, False, False], table().velocity, np.nan))
    robot = with_effects(agriq, name)
    np.testing.assert_array_equal(rollout(robot, commands).q, rollout(agriq, commands).q)


@pytest.mark.parametrize("yaw", [0.0, 2.1])
def test_a_lever_arm_turns_with_the_front_module(agriq: Robot, yaw: float) -> None:
    arm = SENSORS_1["pose_lever_arm"]
    seen, origin = predicted(with_effects(agriq, "pose_lever_arm"), yaw=yaw), predicted(agriq, yaw=yaw)
    heading = origin[2]
    c, s = np.cos(heading), np.sin(heading)
    np.testing.assert_allclose(seen[0] - origin[0], c * arm["x"] - s * arm["y"], atol=1e-12)
    np.testing.assert_allclose(seen[1] - origin[1], s * arm["x"] + c * arm["y"], atol=1e-12)
    for kind in MEASURED[2:]:
        np.testing.assert_array_equal(seen[kind], origin[kind])


def test_an_offset_of_headings_is_in_nothing_else(agriq: Robot, plain: dict) -> None:
    seen = predicted(with_effects(agriq, "pose_heading_offset"))
    np.testing.assert_allclose(seen[2] - plain[2], SENSORS_1["pose_heading_offset"]["angle"], atol=1e-12)
    for kind in {*MEASURED} - {2}:
        np.testing.assert_array_equal(seen[kind], plain[kind])


@pytest.mark.parametrize("delay", [0.12, 0.1037])
def test_a_delay_is_a_shift_of_positions_in_time(agriq: Robot, plain: dict, delay: float) -> None:
    late = predicted(with_effects(agriq, pose_delay={"delay": delay}))
    early = predicted(agriq, plan=SamplingPlan(np.tile(T - delay, len(MEASURED)), PLAN.kind))
    for kind in (0, 1, 2):
        np.testing.assert_allclose(late[kind], early[kind], rtol=0, atol=1e-12)
    for kind in MEASURED[3:]:
        np.testing.assert_array_equal(late[kind], plain[kind])


def test_a_low_pass_of_speeds_is_taken_off_motors_whose_angles_were_not_recorded(agriq: Robot, plain: dict) -> None:
    """What is seen is what was seen of the rover whose speeds came out of it; recorded angles need no mending."""
    smooth, true = 0.05, table()
    t = 0.01 * np.arange(len(true.velocity))
    seen = low_passed(t, true.velocity, smooth)
    angle = np.vstack([np.zeros(4), np.cumsum(0.005 * (seen[1:] + seen[:-1]), axis=0)])
    robot = with_effects(agriq, velocity_filter={"time_constant": smooth})
    filtered = dataclasses.replace(true, position=angle, velocity=seen, from_speeds=(True,) * 4)
    found, ignored = predicted(robot, filtered), predicted(agriq, filtered)
    for kind in MEASURED[:4]:
        off = np.abs(ignored[kind] - plain[kind]).max()
        assert off > 1e-4
        np.testing.assert_allclose(found[kind], plain[kind], rtol=0, atol=0.05 * off)
    for kind, value in predicted(robot).items():
        np.testing.assert_array_equal(value, plain[kind])


def test_before_a_window_the_rover_went_on_as_it_starts(agriq: Robot) -> None:
    """Positions in the first instants come from before the start: on the arc that leads there."""
    speed, rate, delay = 0.5, 0.4, 0.12
    state = initial_state(agriq)
    v = state.v.copy()
    v[[0, 5]] = speed, rate
    one, zero = np.ones(1, np.int64), np.zeros(1, np.int64)
    items = Items(zero, zero, zero, zero + 100, 100 * one, state.q[None], v[None], np.zeros(1))
    robot = with_effects(agriq, pose_delay={"delay": delay})
    plan = SamplingPlan(np.zeros(3), np.arange(3))
    (seen,) = WindowBatch([table()], [plan], 2.5e-3).run([robot], items)
    radius, angle = speed / rate, -rate * delay
    np.testing.assert_allclose(seen, [radius * np.sin(angle), radius * (1 - np.cos(angle)), angle], atol=5e-5)


def test_scales_and_bias_are_those_of_what_is_recorded(agriq: Robot, plain: dict) -> None:
    seen = predicted(with_effects(agriq, "torque_scale", "gyro_bias"))
    np.testing.assert_allclose(seen[4], plain[4] - 0.01, rtol=0, atol=1e-15)
    for kind in range(10, 14):
        np.testing.assert_allclose(seen[kind], 0.85 * plain[kind], rtol=1e-14)
    for kind in (0, 1, 2):
        np.testing.assert_array_equal(seen[kind], plain[kind])


def test_scaled_rotations_turn_a_rover_with_that_scale_as_the_true_ones_do(agriq: Robot, plain: dict) -> None:
    seen = predicted(with_effects(agriq, encoder_scale={"scale": 1.02}), table(1.02))
    for kind in MEASURED:
        np.testing.assert_allclose(seen[kind], plain[kind], rtol=0, atol=1e-9)


small = st.floats(-0.3, 0.3)


@given(
    errors=st.tuples(small, small, st.floats(0.0, 0.4), small, small), late=st.booleans(),
    start=st.tuples(*[st.floats(-3.0, 3.0)] * 3, *[st.floats(-1.0, 1.0)] * 5),
)  # fmt: skip
def test_starts_go_there_and_back(errors: tuple, late: bool, start: tuple) -> None:
    rows = np.array([SensorErrors(1.0, 1.0, *errors)])
    begun, flag = np.array([start]), np.array([late])
    true = true_starts(rows, begun, flag)
    np.testing.assert_allclose(measured_starts(rows, true, flag), begun, atol=1e-12)
    np.testing.assert_array_equal(true[:, 6:], begun[:, 6:])
    np.testing.assert_array_equal(true_starts(np.array([NO_SENSOR_ERRORS]), begun, flag), begun)


@given(
    arm_x=small, arm_y=small, delay=st.floats(0.0, 0.4), offset=small, rate=st.floats(-1.0, 1.0),
    yaw=st.floats(-3.0, 3.0),
)  # fmt: skip
def test_a_start_seen_on_a_circle_is_the_rovers_own(
    arm_x: float, arm_y: float, delay: float, offset: float, rate: float, yaw: float
) -> None:
    """A tracked point on a circle about the origin, seen late, belongs to a module on its own circle, now."""
    forward, left, bias = 0.5, 0.05, 0.02
    errors = SensorErrors(arm_x=arm_x, arm_y=arm_y, delay=delay, gyro_bias=bias, heading=offset)

    def module(t: float) -> np.ndarray:
        """Pose at `t` of a module that passes the origin at 0 at a constant twist."""
        steps = 2000
        headings = yaw + rate * (np.arange(steps) + 0.5) * t / steps
        x = np.sum(np.cos(headings) * forward - np.sin(headings) * left) * t / steps
        y = np.sum(np.sin(headings) * forward + np.cos(headings) * left) * t / steps
        return np.array([x, y, yaw + rate * t])

    x, y, heading = module(-delay)
    c, s = np.cos(heading), np.sin(heading)
    point = [x + c * arm_x - s * arm_y, y + s * arm_x + c * arm_y]
    velocity = [forward - rate * arm_y, left + rate * arm_x]
    c, s = np.cos(offset), np.sin(offset)
    along = [c * velocity[0] + s * velocity[1], c * velocity[1] - s * velocity[0]]  # of the measured heading
    seen = np.array([[*point, heading + offset, *along, rate + bias]])
    true = true_starts(np.array([errors]), seen, np.array([True]))[0]
    np.testing.assert_allclose(true, [0.0, 0.0, yaw, forward, left, rate], atol=1e-7)
    c, s = np.cos(heading - yaw), np.sin(heading - yaw)
    turned = [c * velocity[0] - s * velocity[1], s * velocity[0] + c * velocity[1]]
    undelayed = np.array([[*point, yaw, *turned, rate + bias]])
    np.testing.assert_allclose(true_starts(np.array([errors]), undelayed, np.array([False]))[0], true, atol=1e-7)
