"""Cases: what recordings hold, what they must not tell, and when an effect counts as absent."""

from __future__ import annotations

import json
from dataclasses import asdict

import numpy as np
import pytest
from diagnose.hidden import LISTED, OTHER_GROUND, UNLISTED, Noise, case, write
from diagnose.hidden.effects import MOTORS
from diagnose.hidden.logged import VARYING
from diagnose.hidden.unlisted import LAWS

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment import Experiment, read_bag
from artibot_sim.model import load_robot
from artibot_sim.model.effects import EFFECTS

SHORT = {"runs": 1, "held_out": 1, "duration": 10.0}


def columns(recording: Experiment) -> dict[str, np.ndarray]:
    return {f"{key}.{name}": v for key, channel in recording.channels.items() for name, v in channel.columns.items()}


LEFT_OUT = {"stribeck": {"early"}, "bulldozing": {"load"}}
"""The rover that hides effects loses friction once a wheel slides, not before, and all its wheels push soil alike."""


def test_every_effect_of_the_vocabulary_can_be_hidden():
    assert len(LISTED) == 27
    for name, recipe in LISTED.items():
        values = recipe.draw(np.random.default_rng(1), 1.0, np.zeros((5, 2)))
        if name in EFFECTS:
            assert set(values) == set(EFFECTS[name].parameters) - LEFT_OUT.get(name, set())


@pytest.mark.parametrize(
    ("name", "parameter", "neutral", "at_one"),
    [
        ("speed_loop_lag", "time_constant", 0.0, 0.25),
        ("back_friction", "scale", 1.0, 0.6),
        ("slope", "grade", 0.0, 0.05),
    ],
)
def test_severity_scales_the_departure_from_neutral(name, parameter, neutral, at_one):
    for severity in (0.3, 1.0, 2.0):
        value = LISTED[name].draw(np.random.default_rng(1), severity, np.zeros((5, 2)))[parameter]
        assert value - neutral == pytest.approx(severity * (at_one - neutral))


def test_limits_move_so_that_they_still_bite():
    for name, parameter, at_one, power in (
        ("torque_limit", "front_max", 0.36, -0.2),
        ("joint_stop", "angle", 0.35, -0.4),
    ):
        values = LISTED[name].draw(np.random.default_rng(1), 0.3, np.zeros((5, 2)))
        assert values[parameter] == pytest.approx(at_one * 0.3**power)


def test_same_seed_same_recordings_and_another_seed_others():
    first, again, other = (columns(case(("slope",), seed=seed, **SHORT).recordings[0]) for seed in (3, 3, 4))
    for name, values in first.items():
        np.testing.assert_array_equal(values, again[name])
    assert not np.array_equal(first["motor_command.front_right.velocity"], other["motor_command.front_right.velocity"])


def test_a_recording_does_not_say_what_is_hidden_in_it():
    """Names, metadata, commands and all shapes are those of a recording in which nothing is hidden."""
    clean = case((), seed=5, **SHORT)
    for name in ("motor_drag", "yaw_drag"):
        hidden = case((name,), seed=5, **SHORT)
        for a, b in zip(clean.recordings + clean.holdout, hidden.recordings + hidden.holdout, strict=True):
            assert (a.name, a.path, dict(a.metadata), a.start_ns) == (b.name, b.path, dict(b.metadata), b.start_ns)
            assert {k: v.shape for k, v in columns(a).items()} == {k: v.shape for k, v in columns(b).items()}
            commanded = [k for k in columns(a) if k.startswith("motor_command.front")]
            assert commanded and all(np.array_equal(columns(a)[k], columns(b)[k]) for k in commanded)


def test_the_truth_is_plain_data():
    truth = asdict(case(("friction_patch", "ridges"), seed=2, **SHORT).truth)
    assert json.loads(json.dumps(truth))["effects"] == truth["effects"]


def test_what_never_acts_is_not_there():
    weak = case(("torque_limit",), severity=1e-4, seed=1, **SHORT).truth
    assert not weak.effects and "torque_limit" in weak.idle and weak.nats["torque_limit"] == 0.0
    strong = case(("torque_limit",), severity=30.0, seed=1, **SHORT).truth
    assert "torque_limit" in strong.effects and not strong.idle


@pytest.mark.parametrize("name", ["encoder_scale", "pose_delay", "speed_loop_lag", "payload"])
def test_the_larger_the_plainer(name):
    small, large = (case((name,), severity=s, seed=6, **SHORT).truth.nats[name] for s in (0.3, 1.0))
    assert 5.0 * small < large < 30.0 * small


def test_pairs_act_each_on_its_own():
    truth = case(("payload", "gyro_bias"), seed=8, **SHORT).truth
    assert set(truth.effects) == {"payload", "gyro_bias"}
    alone = case(("gyro_bias",), seed=8, **SHORT).truth
    assert truth.nats["gyro_bias"] == pytest.approx(alone.nats["gyro_bias"], rel=0.05)


def test_noise_is_what_it_is_said_to_be():
    quiet, loud = (case((), seed=9, noise=Noise().scaled(f), **SHORT).recordings[0] for f in (0.0, 1.0))
    a, b = columns(quiet), columns(loud)
    sd = {
        "imu.yaw_rate": 0.004, "imu.ax": 0.05, "joint_states.articulation_yaw.position": 0.002,
        "motor_torques.front_left.velocity": 0.25,
    }  # fmt: skip
    for name, expected in sd.items():
        assert np.std(b[name] - a[name]) == pytest.approx(expected, rel=0.1), name
    count = 2 * np.pi / 2048
    for motor in MOTORS:
        angle = a[f"motor_torques.{motor}.position"] / count
        np.testing.assert_allclose(angle, np.round(angle), atol=1e-6)
        effort = a[f"motor_torques.{motor}.effort"]
        assert 0.02 <= np.std(b[f"motor_torques.{motor}.effort"] - effort) < 0.02 + 0.01 * np.abs(effort).max()


def test_the_total_station_loses_points_and_has_a_colour():
    long = {"runs": 1, "held_out": 0, "duration": 120.0, "seed": 10}
    whole = case(noise=Noise(lost=0.0).scaled(0.0), **long).recordings[0].channels["total_station"]
    found = case(noise=Noise(lost=0.1), **long).recordings[0].channels["total_station"]
    assert 0.05 < 1.0 - len(found) / len(whole) < 0.15
    rows = np.searchsorted(whole.t, found.t - 1e-6)
    error = np.concatenate([found[axis] - whole[axis][rows] for axis in "xy"])
    assert np.std(error) == pytest.approx(0.0035, rel=0.1)
    assert 0.08 < np.corrcoef(error[1:], error[:-1])[0, 1] < 0.4


def test_clocks():
    steady, jumpy = (case(noise=n, seed=11, **SHORT).recordings[0] for n in (Noise(), Noise(jitter=0.002, offset=0.02)))
    assert np.ptp(np.diff(steady.channels["imu"].t)) < 1e-6
    gaps = np.diff(jumpy.channels["imu"].t)
    assert 0.001 < np.std(gaps) < 0.005 and gaps.min() > 0.0
    assert min(channel.t[0] for channel in jumpy.channels.values()) == 0.0


def test_a_bag_holds_what_memory_holds(tmp_path):
    found = case(("motor_drag",), seed=12, noise=Noise(jitter=0.001), **SHORT).recordings[0]
    read = read_bag(write(found, tmp_path))
    assert read.name == found.name and read.start_ns == found.start_ns and read.segments == found.segments
    assert dict(read.metadata) == dict(found.metadata)
    for key, channel in found.channels.items():
        np.testing.assert_array_equal(read.channels[key].t_ns, channel.t_ns)
        for name, values in channel.columns.items():
            np.testing.assert_array_equal(read.channels[key][name], values)


@pytest.mark.long
def test_unlisted_things_act():
    for name in (*UNLISTED, *LAWS):
        truth = case((name,), seed=13, runs=1, held_out=0, duration=20.0).truth
        assert set(truth.unlisted) == {name}, truth.nats


def test_only_the_second_recording_is_on_another_soil():
    found = case((OTHER_GROUND,), seed=13, runs=3, held_out=0, duration=10.0)
    plain = case(seed=13, runs=3, held_out=0, duration=10.0)
    assert set(found.truth.unlisted) == {OTHER_GROUND} and found.truth.soil == plain.truth.soil
    same = [
        all(np.array_equal(one, columns(b)[name]) for name, one in columns(a).items())
        for a, b in zip(found.recordings, plain.recordings, strict=True)
    ]
    assert same == [True, False, True]


def test_a_train_has_all_its_joints_and_nothing_hidden():
    """The rover that makes the other recordings has two modules: one of three would be another robot than its file."""
    short = {"seed": 3, "runs": 1, "held_out": 0, "duration": 8.0, "robot": "train3"}
    found = case(**short)
    joints = set(found.recordings[0].channels["joint_states"].columns)
    assert joints == {f"{name}.position" for name in load_robot("train3").articulation_joints[::2]} and len(joints) == 2
    assert not found.truth.effects and not found.truth.idle
    with pytest.raises(ArtibotError, match="more than two modules"):
        case(("slope",), **short)


def test_a_rigid_robot_is_seen_by_poses_and_wheel_speeds_alone():
    """What is put in changes poses and nothing else; varying ground does, too, and is no effect."""
    short = {"seed": 3, "runs": 1, "held_out": 0, "duration": 8.0, "robot": "husky_driven"}
    clean, varying, arm = (case(e, **short) for e in ((), (VARYING,), ("pose_lever_arm",)))
    assert not clean.truth.effects and not varying.truth.effects and set(arm.truth.effects) == {"pose_lever_arm"}
    assert varying.truth.varies and not clean.truth.varies and clean.horizon == 2.0
    (first,) = clean.recordings
    assert set(first.channels) == {"motor_torques", "ground_truth_odom"}
    hardly = case(("wheel_resistance",), severity=0.02, **short).truth
    assert not hardly.effects and set(hardly.idle) == {"wheel_resistance"} and arm.truth.nats["pose_lever_arm"] > 100.0
    for other in (varying, arm):
        (second,) = other.recordings
        wheels = [recording.channels["motor_torques"]["front_left.velocity"] for recording in (first, second)]
        assert np.array_equal(*wheels)
        apart = first.channels["ground_truth_odom"]["x"] - second.channels["ground_truth_odom"]["x"]
        assert 0.01 < np.abs(apart).max() < 1.0
