"""Doubts about recordings: each fault is said with its topic, a good recording has none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from artibot_sim.diagnose.checks.recordings import data_warnings, require_usable
from artibot_sim.diagnose.checks.sensors import lag
from artibot_sim.errors import ArtibotError
from artibot_sim.experiment import Channel, Experiment
from artibot_sim.identify.synthetic import synthetic
from artibot_sim.model import Robot, load_robot
from artibot_sim.planning import Arc, Dwell, Manoeuvre, Ramp, Slalom, Stop, Straight

BOTH_WAYS = Manoeuvre(
    "both ways",
    (Dwell(0.5), Ramp(speed=0.6), Slalom(curvature=0.45, wavelength=5.0, periods=2.0), Stop(), Ramp(speed=0.5),
     Straight(length=2.0), Stop(), Ramp(speed=0.5), Straight(length=2.0), Stop(), Dwell(1.0)),
    a_max=0.5, blend=0.3,
)  # fmt: skip
LEFT = Manoeuvre("left", (Dwell(0.5), Ramp(speed=0.6), Arc(radius=2.0, angle=4.0), Stop()), a_max=0.5)
AHEAD = Manoeuvre("ahead", (Dwell(0.5), Ramp(speed=0.6), Straight(length=10.0), Stop()), a_max=0.5)
SHORT = Manoeuvre("short", (Dwell(0.5), Ramp(speed=0.6), Straight(length=1.0), Stop(), Dwell(20.0)), a_max=0.5)


@pytest.fixture(scope="module")
def agriq() -> Robot:
    return load_robot("agriq")


@pytest.fixture(scope="module")
def good(agriq: Robot) -> Experiment:
    return synthetic(agriq, BOTH_WAYS, seed=1, name="good")


def changed(run: Experiment, key: str, **columns: np.ndarray) -> Experiment:
    """The recording with other columns in one channel."""
    channel = run.channels[key]
    return replace(run, channels={**run.channels, key: replace(channel, columns={**channel.columns, **columns})})


def shifted(run: Experiment, key: str, by: float) -> Experiment:
    """The recording with one topic stamped later, s."""
    channel = run.channels[key]
    stamps = channel.t_ns + round(by * 1e9)
    moved = Channel(channel.topic, stamps, channel.t + by, channel.received_ns, channel.columns)
    return replace(run, channels={**run.channels, key: moved})


def without(run: Experiment, key: str, first: float, last: float) -> Experiment:
    """The recording with a hole in one topic."""
    channel = run.channels[key]
    kept = (channel.t < first) | (channel.t > last)
    columns = {name: values[kept] for name, values in channel.columns.items()}
    cut = Channel(channel.topic, channel.t_ns[kept], channel.t[kept], channel.received_ns[kept], columns)
    return replace(run, channels={**run.channels, key: cut})


def said(run: Experiment, robot: Robot) -> str:
    return "\n".join(data_warnings([run], robot))


def test_a_good_recording_leaves_only_what_it_does_not_measure(good: Experiment, agriq: Robot) -> None:
    found = data_warnings([good], agriq)
    assert all("/motor_command" in warning for warning in found), found
    require_usable([good], agriq)


def test_a_gap_is_said_with_topic_and_time(good: Experiment, agriq: Robot) -> None:
    assert "/total_station/point is silent for 3.2 s from 5." in said(without(good, "total_station", 5.85, 8.95), agriq)


def test_repeated_samples_are_said(good: Experiment, agriq: Robot) -> None:
    channel = good.channels["total_station"]
    held = {name: np.repeat(values[::2], 2)[: len(values)] for name, values in channel.columns.items()}
    assert "/total_station/point: 50 % of its samples repeat" in said(changed(good, "total_station", **held), agriq)


@pytest.mark.parametrize(("key", "by"), [("imu", 0.15), ("imu", -0.1), ("total_station", 0.2)])
def test_a_clock_that_is_off_is_said_with_its_offset(good: Experiment, agriq: Robot, key: str, by: float) -> None:
    text = said(shifted(good, key, by), agriq)
    topic = good.channels[key].topic
    found = [line for line in text.splitlines() if f"{topic} is " in line and " against /motor_torques" in line]
    assert len(found) == 1, text
    ms = float(found[0].partition(f"{topic} is ")[2].split()[0])
    assert ms == pytest.approx(1e3 * abs(by), abs=30.0)
    assert ("late" if by > 0 else "early") in found[0]


def test_a_clock_that_runs_away_is_said(good: Experiment, agriq: Robot) -> None:
    channel = good.channels["imu"]
    stamps = channel.t_ns + np.round(1e9 * 0.002 * channel.t).astype(np.int64)
    drifted = Channel(channel.topic, stamps, (stamps - good.start_ns) / 1e9, channel.received_ns, channel.columns)
    text = said(replace(good, channels={**good.channels, "imu": drifted}), agriq)
    assert "the clock of /imu/data gains" in text


def test_a_simulator_that_runs_faster_than_time_has_one_clock(good: Experiment, agriq: Robot) -> None:
    hasty = {
        key: replace(channel, received_ns=good.start_ns + (channel.t_ns - good.start_ns) // 4)
        for key, channel in good.channels.items()
    }
    assert "the clock of" not in said(replace(good, channels=hasty), agriq)


def test_a_saturated_gyroscope_is_said(good: Experiment, agriq: Robot) -> None:
    rate = good.channels["imu"]["yaw_rate"]
    limit = 0.6 * float(np.abs(rate).max())
    text = said(changed(good, "imu", yaw_rate=np.clip(rate, -limit, limit)), agriq)
    assert "/imu/data: yaw_rate stands at ±" in text


def test_a_rover_that_does_not_turn_is_said(agriq: Robot) -> None:
    assert "hardly turns" in said(synthetic(agriq, AHEAD, seed=2), agriq)


def test_turning_one_way_only_is_said(agriq: Robot) -> None:
    assert "turns to the left only" in said(synthetic(agriq, LEFT, seed=2), agriq)


def test_too_little_motion_is_said(agriq: Robot) -> None:
    assert "s of motion; little can be told apart" in said(synthetic(agriq, SHORT, seed=2), agriq)


def test_a_rover_that_stands_most_of_the_time_is_said_so(good: Experiment, agriq: Robot) -> None:
    """Whatever the noise of its motors' speeds: one that never stands is not said to, be it now fast and now slow."""
    motors = good.channels["motor_torques"]
    rng = np.random.default_rng(4)

    def turning(speed: np.ndarray, noise: float) -> str:
        columns = {f"{name}.velocity": speed + noise * rng.standard_normal(len(speed))
                   for name in ("front_right", "front_left", "back_right", "back_left")}  # fmt: skip
        return said(changed(good, "motor_torques", **columns), agriq)

    phase = np.linspace(0.0, 12.0, len(motors))
    slow_and_fast = 30.0 + 90.0 * np.sin(phase) ** 8
    mostly_still = np.where(np.linspace(0.0, 1.0, len(motors)) > 0.56, 100.0, 0.0)
    for noise in (0.0, 0.25, 4.0):
        assert "stands for" not in turning(slow_and_fast, noise)
        share = float(turning(mostly_still, noise).partition("the rover stands for ")[2].split()[0])
        assert share == pytest.approx(56.0, abs=1.0)


def test_sides_taken_for_each_other_are_said(good: Experiment, agriq: Robot) -> None:
    motors = good.channels["motor_torques"]
    swapped = {
        f"{end}_{side}.{what}": motors[f"{end}_{other}.{what}"]
        for end in ("front", "back") for side, other in (("right", "left"), ("left", "right"))
        for what in ("position", "velocity", "effort")
    }  # fmt: skip
    assert "turns against its wheels" in said(changed(good, "motor_torques", **swapped), agriq)


def test_units_that_contradict_each_other_are_said(good: Experiment, agriq: Robot) -> None:
    rpm = good.channels["motor_torques"]["front_left.velocity"] * 60 / (2 * np.pi)
    text = said(changed(good, "motor_torques", **{"front_left.velocity": rpm}), agriq)
    assert "positions of front_left change by 0.105 times its velocities" in text


def test_another_robots_name_is_said(good: Experiment, agriq: Robot) -> None:
    other = replace(good, metadata={"robot": "epiq"})
    assert "recorded with robot 'epiq'" in said(other, agriq)
    assert "recorded with robot 'epiq'" in " ".join(data_warnings([good], agriq, held=[other]))


@pytest.mark.parametrize(("factor", "words"), [(60 / (2 * np.pi), "rpm"), (None, "gear ratio")])
def test_a_wrong_robot_is_refused_with_what_it_looks_like(
    good: Experiment, agriq: Robot, factor: float | None, words: str
) -> None:
    times = agriq.drive.front.tau if factor is None else factor
    motors = good.channels["motor_torques"]
    columns = {name: values * times for name, values in motors.columns.items() if not name.endswith("effort")}
    with pytest.raises(ArtibotError, match=words) as error:
        require_usable([changed(good, "motor_torques", **columns)], agriq)
    assert "good" in str(error.value) and "--robot" in str(error.value)


def test_a_rover_that_never_moves_is_refused(good: Experiment, agriq: Robot) -> None:
    columns = {name: np.zeros_like(values) for name, values in good.channels["motor_torques"].columns.items()}
    still = changed(good, "motor_torques", **columns)
    point = {name: np.full_like(values, 1.0) for name, values in good.channels["total_station"].columns.items()}
    with pytest.raises(ArtibotError, match="never moves"):
        require_usable([changed(still, "total_station", **point)], agriq)


def test_no_recording_is_refused(agriq: Robot) -> None:
    with pytest.raises(ArtibotError, match="no recording"):
        require_usable([], agriq)


@pytest.mark.parametrize("by", [-0.31, -0.004, 0.0, 0.083, 0.4])
def test_a_lag_is_found_to_a_few_milliseconds(by: float) -> None:
    t = np.arange(0.0, 40.0, 0.02)
    rng = np.random.default_rng(5)
    phases = rng.uniform(0, 6, 5)

    def signal(at: np.ndarray) -> np.ndarray:
        return sum(np.sin((0.5 + 0.4 * k) * at + phases[k]) for k in range(5))

    offset, sd = lag(t, signal(t), signal(t - by) + 0.02 * rng.standard_normal(len(t)))
    assert offset == pytest.approx(by, abs=0.004)
    assert 0 < sd < 0.01


def test_what_is_unrelated_has_no_lag() -> None:
    rng = np.random.default_rng(1)
    assert lag(np.arange(0.0, 20.0, 0.02), *rng.standard_normal((2, 1000))) is None


def test_a_joint_that_rests_bent_is_not_saturated(good: Experiment, agriq: Robot) -> None:
    """At a standstill an exact angle stays what it is, at its largest perhaps."""
    joint = good.channels["joint_states"]
    angle = np.sin(0.3 * np.minimum(joint.t, joint.t[-1] - 0.8))
    bent = np.where(joint.t > joint.t[-1] - 0.6, 1.5, angle)  # when it stands for a second
    assert "saturated" not in said(changed(good, "joint_states", **{"articulation_yaw.position": bent}), agriq)
    held = np.clip(1.3 * angle, -1.0, 1.0)
    assert "articulation_yaw.position stands at ±1.00" in said(
        changed(good, "joint_states", **{"articulation_yaw.position": held}), agriq
    )


def test_motors_without_a_gear_move_as_well() -> None:
    """A rigid robot's motors are its wheels: some rad/s are a drive."""
    husky = load_robot("husky")
    drive = synthetic(husky, BOTH_WAYS, seed=1, name="husky")
    assert "of motion" not in said(drive, husky)
