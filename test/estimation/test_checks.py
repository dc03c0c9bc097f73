"""Doubts about recordings: each fault is said with its topic, a good recording has none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from artibot_sim.errors import ArtibotError
from artibot_sim.estimation.checks.findings import findings
from artibot_sim.estimation.checks.recordings import data_warnings, require_usable
from artibot_sim.estimation.checks.report import check
from artibot_sim.estimation.checks.wheels import scale_between
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
TWICE = replace(BOTH_WAYS, segments=2 * BOTH_WAYS.segments)
LEFT = Manoeuvre("left", (Dwell(0.5), Ramp(speed=0.6), Arc(radius=2.0, angle=4.0), Stop()), a_max=0.5)
AHEAD = Manoeuvre("ahead", (Dwell(0.5), Ramp(speed=0.6), Straight(length=10.0), Stop()), a_max=0.5)
SHORT = Manoeuvre("short", (Dwell(0.5), Ramp(speed=0.6), Straight(length=1.0), Stop(), Dwell(20.0)), a_max=0.5)


@pytest.fixture(scope="module")
def agriq() -> Robot:
    return load_robot("agriq")


@pytest.fixture(scope="module")
def good(agriq: Robot) -> Experiment:
    return synthetic(agriq, BOTH_WAYS, seed=1, name="good")


@pytest.fixture(scope="module")
def long(agriq: Robot) -> Experiment:
    return synthetic(agriq, TWICE, seed=1, duration=90.0, name="long")


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


def test_gaps_everywhere_are_said_to_be_gaps(good: Experiment, agriq: Robot) -> None:
    """As a simulator records that gets half of the time it needs: motors and positions are there, in pieces."""
    broken = good
    for begin in np.arange(0.0, good.duration, 0.5):
        broken = without(broken, "motor_torques", begin, begin + 0.25)
    with pytest.raises(ArtibotError, match=r"/motor_torques has gaps everywhere: .* of more than 0.2 s"):
        require_usable([broken], agriq)


def test_repeated_samples_are_said(good: Experiment, agriq: Robot) -> None:
    channel = good.channels["total_station"]
    held = {name: np.repeat(values[::2], 2)[: len(values)] for name, values in channel.columns.items()}
    assert "/total_station/point: 50 % of its samples repeat" in said(changed(good, "total_station", **held), agriq)


@pytest.mark.parametrize(
    ("key", "by", "name"),
    [
        ("imu", 0.15, "gyro_delay"),
        ("imu", -0.15, "gyro_delay"),
        ("total_station", 0.2, "pose_delay"),
        ("joint_states", 0.15, "articulation_delay"),
        ("joint_states", -0.15, "articulation_delay"),
    ],
)
def test_a_clock_that_is_off_is_said_with_its_offset(
    long: Experiment, agriq: Robot, key: str, by: float, name: str
) -> None:
    (found,) = findings(shifted(long, key, by), agriq)
    assert (found.name, found.topic) == (name, long.channels[key].topic)
    assert found.value == pytest.approx(by, abs=0.03)
    assert found.interval[0] <= by + 0.03 and found.interval[1] >= by - 0.03
    assert ("late" if by > 0 else "early") in found.text


def test_a_short_recording_claims_no_delay(good: Experiment, agriq: Robot) -> None:
    """Fewer than six stretches of 8 s do not show how delays scatter from one to the next."""
    for key in ("imu", "joint_states", "total_station"):
        assert not findings(shifted(good, key, 0.15), agriq)


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
    assert "s of motion; few parameters can be determined" in said(synthetic(agriq, SHORT, seed=2), agriq)


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
    assert "left and right wheels are taken for each other" in said(changed(good, "motor_torques", **swapped), agriq)


def test_units_that_contradict_each_other_are_said(good: Experiment, agriq: Robot) -> None:
    rpm = good.channels["motor_torques"]["front_left.velocity"] * 60 / (2 * np.pi)
    text = said(changed(good, "motor_torques", **{"front_left.velocity": rpm}), agriq)
    assert "positions of front_left change by 0.105 times its velocities" in text


def test_what_turned_in_a_gap_contradicts_nothing(good: Experiment, agriq: Robot) -> None:
    """A hole while the wheels change their speed: positions go on over it, velocities are not known there."""
    motors = good.channels["motor_torques"]
    speed = motors["front_left.velocity"]
    fastest = float(motors.t[np.argmax(np.abs(np.nan_to_num(speed)))])
    cut = without(good, "motor_torques", fastest - 4.0, fastest + 4.0)
    assert scale_between(cut.channels["motor_torques"], "front_left") == pytest.approx(1.0, abs=0.01)


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
    (checked,) = check([changed(still, "total_station", **point)], agriq)
    assert "never moves" in checked.refused
    assert not checked.findings and not checked.delays, "what never changes agrees at every delay and in every unit"


def test_no_recording_is_refused(agriq: Robot) -> None:
    with pytest.raises(ArtibotError, match="no recording"):
        require_usable([], agriq)
