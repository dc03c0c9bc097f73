"""The simulated rover between publications: the same as one long rollout, to the bit, and what its sensors say."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from artibot_sim.errors import ArtibotError
from artibot_sim.estimation.odometry import Odometry
from artibot_sim.experiment.rollout_bag import rollout_columns
from artibot_sim.model import Commands, initial_state, load_robot, rollout
from artibot_sim.model.simulate.commands import as_executed
from artibot_sim.model.simulate.motion import joint_motion
from artibot_sim.nodes.common.arbiter import NAN_PAIR, CommandSource, PeriodCommands
from artibot_sim.nodes.common.rotations import quaternion, rotation
from artibot_sim.nodes.sim.engine import Diverged, Engine, Periods, StartPose, TrueState
from artibot_sim.nodes.sim.sensors import SensorModel, SimulatedSensors

AGRIQ = load_robot("agriq")
METRES = AGRIQ.wheel.r_w * AGRIQ.drive.front.tau
TIMING = Periods.of(100.0, 1e-3)
angles = st.floats(-1.0, 1.0)


def driven(seconds: float, timing: Periods = TIMING) -> tuple[np.ndarray, np.ndarray]:
    """Velocity and rotation of both front motors at the knots: a bend with a smooth beginning."""
    t = np.arange(round(seconds * 1e9 / timing.knot_ns) + 1) * timing.knot_ns * 1e-9
    shape = np.where(t < 1.0, 3 * t**2 - 2 * t**3, 1.0)
    velocity = np.column_stack([0.6 * shape, 0.45 * shape]) / METRES
    steps = 0.5 * timing.knot_ns * 1e-9 * (velocity[1:] + velocity[:-1])
    return velocity, np.vstack([np.zeros(2), np.cumsum(steps, axis=0)])


def decisions(velocity: np.ndarray, position: np.ndarray, knots: int = 1) -> list[PeriodCommands]:
    pairs, places = list(map(tuple, velocity)), list(map(tuple, position))
    return [
        PeriodCommands(
            tuple(pairs[i : i + knots + 1]), tuple(places[i : i + knots + 1]), NAN_PAIR, CommandSource.PROFILE
        )
        for i in range(0, len(pairs) - 1, knots)
    ]


def drive(engine: Engine, velocity: np.ndarray, position: np.ndarray, kappa: float = 0.8) -> list[TrueState]:
    return [engine.step(decision, kappa) for decision in decisions(velocity, position, engine.timing.knots)]


def long_run(velocity: np.ndarray, position: np.ndarray, spacing: float, every: int = 10, **options):
    absent = np.full_like(velocity, np.nan)
    commands = Commands(spacing, np.hstack([velocity, absent]), position=np.hstack([position, absent]))
    return rollout(AGRIQ, commands, kappa=0.8, every=every, **options)


@pytest.mark.parametrize("integrator", ["rk4", "semi_implicit"])
def test_period_by_period_is_one_long_rollout_to_the_bit(integrator: str) -> None:
    velocity, position = driven(3.0)
    samples = drive(Engine(AGRIQ, TIMING, StartPose(), integrator), velocity, position)
    whole = long_run(velocity, position, 0.01, integrator=integrator)
    for name in ("motor_position", "motor_velocity", "motor_torque", "twist"):
        together = np.array([getattr(sample, name) for sample in samples])
        np.testing.assert_array_equal(together, getattr(whole, name)[:-1], err_msg=name)
    np.testing.assert_array_equal([sample.position for sample in samples], whole.q[:-1, :3])
    assert np.hypot(*samples[-1].position[:2]) > 0.5 and abs(samples[-1].articulation[0, 0]) > 0.05


def test_the_articulation_is_that_of_a_recorded_rollout_when_a_module_rolls_and_pitches() -> None:
    engine = Engine(AGRIQ, TIMING, StartPose(articulation_yaw=0.4))
    tossed = engine.state.v.copy()
    tossed[[3, 4]] = 0.3, 0.1  # rates of the front module's roll and pitch, rad/s
    start = engine.state = replace(engine.state, v=tossed)
    velocity, position = driven(1.0)
    samples = np.array([sample.articulation for sample in drive(engine, velocity, position)])
    absent = np.full_like(velocity, np.nan)
    commands = Commands(0.01, np.hstack([velocity, absent]), position=np.hstack([position, absent]))
    recorded = rollout_columns(rollout(AGRIQ, commands, kappa=0.8, state=start), AGRIQ)["joint_states"]
    for i, joint in enumerate(("articulation_yaw", "articulation_roll")):
        np.testing.assert_array_equal(samples[:, 0, i], recorded[f"{joint}.position"][:-1])
        np.testing.assert_array_equal(samples[:, 1, i], recorded[f"{joint}.velocity"][:-1])
    fine = rollout(AGRIQ, commands, kappa=0.8, state=start, every=1)
    rate = np.gradient(joint_motion(fine.q, fine.v)[0][:, 1], 1e-3)[::10]
    np.testing.assert_allclose(samples[1:, 1, 1], rate[1:-1], atol=0.02 * np.abs(rate).max())
    assert np.abs(rate).max() > 0.1


def test_a_slower_publication_keeps_the_knots_fine() -> None:
    timing = Periods.of(20.0, 1e-3)
    assert (timing.knots, timing.knot_ns) == (5, 10_000_000)
    velocity, position = driven(2.0)
    samples = drive(Engine(AGRIQ, timing, StartPose()), velocity, position)
    whole = long_run(velocity, position, 0.01, every=50)
    np.testing.assert_array_equal([sample.position for sample in samples], whole.q[:-1, :3])


@pytest.mark.parametrize(("rate", "dt"), [(100.0, 0.003), (100.0, 0.02), (30.0, 0.001), (1000.0, 1e-10)])
def test_steps_that_do_not_fit_are_refused(rate: float, dt: float) -> None:
    with pytest.raises(ArtibotError, match="dt"):
        Periods.of(rate, dt)


@given(rate=st.sampled_from([1.0, 10.0, 25.0, 50.0, 100.0, 125.0, 200.0, 500.0, 1000.0]))
def test_periods_are_whole_knots_of_whole_steps(rate: float) -> None:
    timing = Periods.of(rate, 1e-3)
    assert timing.knots * timing.knot_ns == timing.period_ns == round(1e9 / rate)
    assert timing.knot_ns % timing.dt_ns == 0 and timing.knot_ns <= 10_000_000


def test_reset_is_the_start_at_rest_and_runs_on_like_the_first_time() -> None:
    start = StartPose(1.0, -2.0, 0.7, 0.3)
    engine = Engine(AGRIQ, TIMING, start)
    velocity, position = driven(1.5)
    first = drive(engine, velocity, position)
    engine.reset()
    np.testing.assert_array_equal(engine.state.q, initial_state(AGRIQ, 1.0, -2.0, 0.7, 0.3).q)
    assert not engine.state.v.any()
    second = drive(engine, velocity, position)
    np.testing.assert_array_equal([s.motor_torque for s in first], [s.motor_torque for s in second])
    np.testing.assert_array_equal([s.acceleration for s in first], [s.acceleration for s in second])
    assert tuple(first[0].position[:2]) == (1.0, -2.0) and first[0].articulation[0, 0] == pytest.approx(0.3)


def test_divergence_is_said_and_leaves_no_nan() -> None:
    engine = Engine(AGRIQ, TIMING, StartPose())
    far = PeriodCommands(((0.0, 0.0), (1e9, 1e9)), ((0.0, 0.0), (1e7, 1e7)), NAN_PAIR, CommandSource.LIVE)
    with pytest.raises(Diverged, match="diverged"):
        for _ in range(100):
            engine.step(far, 0.8)
    assert np.isfinite(engine.state.q).all()


def test_driven_front_motors_fall_behind_at_their_torque_limit() -> None:
    weak = AGRIQ.replace({"drive.front.torque_max": 0.05})
    velocity, position = driven(2.0)
    held, led = (
        drive(Engine(robot, TIMING, StartPose(), driven=True), velocity, position)[-1] for robot in (weak, AGRIQ)
    )
    assert abs(held.motor_torque[:2]).max() <= 0.05
    assert held.motor_velocity[0] < 0.8 * velocity[-1, 0]
    assert led.motor_velocity[0] == pytest.approx(velocity[-1, 0], rel=0.1)


def test_at_rest_an_accelerometer_feels_gravity_and_on_a_bend_the_centre() -> None:
    velocity, position = driven(4.0)
    samples = drive(Engine(AGRIQ, TIMING, StartPose()), velocity, position)
    np.testing.assert_allclose(samples[0].acceleration, [0, 0, 9.81], atol=1e-6)
    late = np.mean([sample.acceleration for sample in samples[-20:]], axis=0)
    forward, _, yaw_rate = samples[-1].twist
    assert late[1] == pytest.approx(forward * yaw_rate, rel=0.05)


@given(angles, angles, angles)
def test_quaternion_and_matrix_are_the_same_rotation(roll: float, pitch: float, yaw: float) -> None:
    x, y, z, w = quaternion(roll, pitch, yaw)
    matrix = rotation(roll, pitch, yaw)
    assert x * x + y * y + z * z + w * w == pytest.approx(1.0)
    assert [matrix[0, 0], matrix[1, 0], matrix[2, 0]] == pytest.approx(
        [1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)]
    )
    assert matrix[2, 1] == pytest.approx(2 * (y * z + x * w)) and matrix[2, 2] == pytest.approx(1 - 2 * (x * x + y * y))


def test_ideal_sensors_pass_the_truth_through_to_the_bit() -> None:
    sensors = SimulatedSensors(SensorModel(), 3)
    values = np.array([0.1, -2.0, 3.0, 4.0])
    for read in (sensors.encoders, sensors.torques, sensors.articulation):
        np.testing.assert_array_equal(read(values), values)
    np.testing.assert_array_equal(sensors.velocities(0, values), values)
    rates, felt = sensors.imu(values[1:], values[:3])
    np.testing.assert_array_equal(rates, values[1:])
    np.testing.assert_array_equal(sensors.orientation(values[:3]), values[:3])
    np.testing.assert_array_equal(felt, values[:3])


NOISY = SensorModel(2048, 0.25, 0.02, 0.01, 0.002, 0.004, 0.001, 0.05, 0.0035, 0.25, (0.1, 0.0, 0.5))


def readings(seed: int, model: SensorModel = NOISY, n: int = 4000) -> dict[str, np.ndarray]:
    sensors = SimulatedSensors(model, seed)
    truth = np.array([10.0, -20.0, 0.5, 0.0])
    station = [sensors.station(sensors.follow(0, np.zeros(3), np.eye(3))) for _ in range(n)]
    return {
        "velocity": np.array([sensors.velocities(k, truth) for k in range(n)]) - truth,
        "torque": np.array([sensors.torques(truth) for _ in range(n)]) - truth,
        "articulation": np.array([sensors.articulation(truth[:2]) for _ in range(n)]) - truth[:2],
        "gyro": np.array([sensors.imu(truth[1:], truth[:3])[0][2] for _ in range(n)]) - truth[3],
        "station": np.array([point for point in station if point is not None]),
    }


def test_noise_has_the_size_it_was_given() -> None:
    found = readings(1)
    assert found["velocity"].std(axis=0) == pytest.approx([0.25] * 4, rel=0.1)
    assert found["torque"].std(axis=0) == pytest.approx(np.hypot(0.02, [0.1, 0.2, 0.005, 0.0]), rel=0.1)
    assert found["articulation"].std() == pytest.approx(0.002, rel=0.1)
    assert (found["gyro"].mean(), found["gyro"].std()) == pytest.approx((0.001, 0.004), rel=0.2)
    assert len(found["station"]) == pytest.approx(3000, abs=150)
    np.testing.assert_allclose(found["station"].mean(axis=0), [0.1, 0.0, 0.5], atol=4e-4)
    np.testing.assert_allclose(found["station"].std(axis=0), 0.0035, rtol=0.1)


def test_same_seed_same_noise_and_other_sensors_do_not_matter() -> None:
    one, two, other = readings(5, n=50), readings(5, n=50), readings(6, n=50)
    for name in one:
        np.testing.assert_array_equal(one[name], two[name])
        assert not np.array_equal(one[name], other[name])
    quiet = readings(5, SensorModel(gyro=0.004, gyro_bias=0.001), n=50)
    np.testing.assert_array_equal(one["gyro"], quiet["gyro"])


@given(st.floats(-1e4, 1e4))
def test_encoders_count_whole_counts(position: float) -> None:
    count = 2 * math.pi / 2048
    found = SimulatedSensors(NOISY, 0).encoders(np.array([position]))[0]
    assert abs(found - position) <= count * 0.5001
    assert found / count == pytest.approx(round(found / count), abs=1e-6)


@given(radius=st.floats(0.5, 50.0), side=st.sampled_from([-1, 1]), steps=st.integers(5, 200))
def test_odometry_on_a_circle_is_the_circle(radius: float, side: int, steps: int) -> None:
    track, metres = 0.7, 0.004
    odometry = Odometry(metres, track)
    odometry.reset(0.0, 0.0, 0.0)
    turn = math.pi / steps
    for i in range(steps + 1):
        length = i * turn * radius
        right, left = length * (1 + side * track / 2 / radius), length * (1 - side * track / 2 / radius)
        odometry.update((right / metres, left / metres), (0.0, 0.0))
    assert odometry.pose == pytest.approx((0.0, side * 2 * radius, side * math.pi), abs=1e-6 * radius)


def test_odometry_starts_where_it_is_told_whatever_the_motors_show() -> None:
    odometry = Odometry(0.004, 0.7)
    odometry.reset(1.0, 2.0, math.pi / 2)
    odometry.update((500.0, -30.0), (10.0, 10.0))
    assert odometry.pose == (1.0, 2.0, math.pi / 2)
    assert odometry.twist == pytest.approx((0.04, 0.0))
    odometry.update((600.0, 70.0), (10.0, 10.0))
    assert odometry.pose == pytest.approx((1.0, 2.4, math.pi / 2))


def test_a_rover_with_effects_is_one_long_rollout_too() -> None:
    """On the way to the motors, in the contact with a memory, and in the drives: the node forgets none of them."""
    effects = {
        "command_delay": {"delay": 0.033},
        "speed_loop_lag": {"time_constant": 0.1},
        "tyre_relaxation": {"length": 0.3},
        "soil_softening": {"rate": 0.02},
        "torque_limit": {"front_max": 0.3},
    }
    robot = replace(AGRIQ, effects=effects)
    velocity, position = driven(2.0)
    samples = drive(Engine(robot, TIMING, StartPose()), velocity, position)
    absent = np.full_like(velocity, np.nan)
    commands = Commands(0.01, np.hstack([velocity, absent]), position=np.hstack([position, absent]))
    whole = rollout(robot, as_executed(robot, commands), kappa=0.8)
    for name in ("motor_position", "motor_velocity", "twist"):
        together = np.array([getattr(sample, name) for sample in samples])
        np.testing.assert_allclose(together, getattr(whole, name)[: len(samples)], rtol=0, atol=1e-8)
    late = np.array([sample.motor_velocity[0] for sample in samples])
    assert late[50] < 0.9 * velocity[50, 0]
