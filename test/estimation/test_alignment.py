"""Streams on one clock: what a logger did to stamps is taken off before anything is fitted, and nothing else is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bag_helpers import foreign
from estimation.logger import FLAWS, Logger, age, drive, recorded, robot_of

from artibot_sim.estimation import alignment
from artibot_sim.estimation.alignment import aligned, restamped, what_is_left, what_was_mended
from artibot_sim.estimation.checks.comparisons import compare_streams
from artibot_sim.estimation.checks.findings import leaps_of
from artibot_sim.estimation.checks.wheels import clock_faults
from artibot_sim.estimation.streams import segments_of
from artibot_sim.experiment import read_bag
from artibot_sim.experiment.blocks import in_turn
from artibot_sim.identify import identify
from artibot_sim.model import load_robot


def logged(logger: Logger, seed: int, robot=None):
    """A robot, and a drive of it as a logger wrote it."""
    rng = np.random.default_rng(seed)
    robot = robot or robot_of(rng)
    return robot, recorded(drive(robot, rng), logger, rng)


@pytest.mark.parametrize("polled", [pytest.param(0.0, marks=pytest.mark.long), 20.0])
@pytest.mark.parametrize(("key", "by"), [("imu", 0.15), ("imu", -0.2), ("motor_torques", 0.2),
                                         ("ground_truth_odom", 0.25), ("ground_truth_odom", -0.15)])  # fmt: skip
def test_stamps_are_shifted_by_what_the_logger_added(key: str, by: float, polled: float) -> None:
    """Polling adds half of its period, or of a stream's own, to every stream alike within that."""
    logger = Logger(polled=polled, delays={key: by})
    robot, raw = logged(logger, 21)
    found = aligned(raw, robot)
    assert len(found.mended) == 1 and found.mended[0].topic == "/" + key
    moved = {name: float(np.median(channel.t - raw.channels[name].t)) for name, channel in
             found.experiment.channels.items()}  # fmt: skip
    assert moved.pop(key) == pytest.approx(-by, abs=0.02 + age(logger, key, polled))
    assert not any(moved.values())
    channel = found.experiment.channels[key]
    assert np.array_equal(channel.t_ns - raw.start_ns, np.round(1e9 * channel.t).astype(np.int64))
    shift = f"{-found.mended[0].value:+.2f}".replace("-", "−")
    assert f"stamps were shifted by {shift} s before" in what_was_mended([found])[0]
    again = compare_streams(found.experiment)
    assert abs(again.gyro.value) < 0.03


def test_a_drift_is_taken_off_around_the_middle() -> None:
    robot, raw = logged(FLAWS["clock_skew"], 3)
    found = aligned(raw, robot)
    assert "clock_skew" in {one.name for one in found.mended}
    before, after = raw.channels["ground_truth_odom"].t, found.experiment.channels["ground_truth_odom"].t
    drift = (before[-1] - before[0]) / (after[-1] - after[0]) - 1.0
    assert drift == pytest.approx(2e-3, rel=0.25)
    assert abs(compare_streams(found.experiment).gyro.skew) < 5e-4


@pytest.mark.parametrize("seed", range(4))
def test_clean_recordings_stay_as_they_are(seed: int) -> None:
    robot, raw = logged(Logger(polled=20.0 * (seed % 2), lost=0.03), 40 + seed)
    found = aligned(raw, robot)
    assert not found.mended and found.experiment is raw


def test_a_late_pose_may_be_left_to_the_model_and_an_early_one_may_not() -> None:
    """The effect `pose_delay` knows late poses only."""
    robot, late = logged(Logger(delays={"ground_truth_odom": 0.25}), 5)
    found = aligned(late, robot, poses=False)
    assert found.experiment is late and found.pose_delay is not None
    assert found.pose_delay.value == pytest.approx(0.25, abs=0.04)
    assert "shift their stamps by -0." in " ".join(what_is_left([found]))
    robot, early = logged(Logger(delays={"ground_truth_odom": -0.15}), 5)
    assert [one.name for one in aligned(early, robot, poses=False).mended] == ["pose_delay"]


def test_a_late_pose_is_not_left_behind_by_rotations_that_are_shifted() -> None:
    """Both are late against the gyroscope: shifted are both, or the pose would be later against the rotations."""
    robot, alone = logged(Logger(delays={"ground_truth_odom": 0.25}), 5)
    assert not aligned(alone, robot, poses=None).mended
    robot, both = logged(Logger(delays={"ground_truth_odom": 0.3, "motor_torques": 0.15}, polled=0.0), 5)
    found = aligned(both, robot, poses=None)
    assert {one.name for one in found.mended} == {"rotation_delay", "pose_delay"}
    turn = compare_streams(found.experiment).turn
    assert abs(turn.value) < abs(compare_streams(aligned(both, robot, poses=False).experiment).turn.value)


def test_a_gyroscope_that_is_upside_down_is_turned() -> None:
    robot, raw = logged(FLAWS["gyro_flip"], 4)
    found = aligned(raw, robot)
    assert "gyro_flip" in {one.name for one in found.mended} and compare_streams(raw).gyro.coefficients[0] < 0.0
    assert compare_streams(found.experiment).gyro.coefficients[0] > 0.9
    assert any("upside down" in said and "the sign was turned" in said for said in what_was_mended([found]))


LATE = Logger(delays={"ground_truth_odom": 0.3, "motor_torques": 0.2}, polled=0.0)


def test_a_part_that_is_held_out_has_the_clock_of_the_part_that_is_fitted() -> None:
    """Its own poses, wherever they are, change nothing of what is done to its stamps."""
    robot, raw = logged(LATE, 5)
    parts = in_turn(raw)
    pose = parts[1].channels["ground_truth_odom"]
    lost = replace(pose, columns={**pose.columns, "x": 0.0 * pose["x"], "yaw": 0.0 * pose["yaw"]})
    parts = (*parts, replace(parts[1], channels={**parts[1].channels, "ground_truth_odom": lost}))
    found = [aligned(one, robot) for one in parts]
    assert found[0].mended and all(one.mended == found[0].mended for one in found)
    for key in ("ground_truth_odom", "motor_torques"):
        shifts = [float(np.median(of.experiment.channels[key].t - one.channels[key].t)) for of, one in
                  zip(found, parts, strict=True)]  # fmt: skip
        assert shifts[0] < -0.1 and np.ptp(shifts) < 1e-6


def test_streams_stay_together_where_one_delay_is_not_sure(monkeypatch: pytest.MonkeyPatch) -> None:
    """Poses that are surely late go with rotations that are late by nobody knows how much: the gyroscope moves."""
    robot, raw = logged(LATE, 5)
    known = alignment.shiftable
    monkeypatch.setattr(alignment, "shiftable", lambda one: one.name != "rotation_delay" and known(one))
    found = aligned(raw, robot)
    assert [one.name for one in found.mended] == ["gyro_delay"]
    moved = {key: float(np.median(one.t - raw.channels[key].t)) for key, one in found.experiment.channels.items()}
    assert moved.pop("imu") == pytest.approx(0.3, abs=0.03) and not any(moved.values())
    assert abs(compare_streams(found.experiment).gyro.value) < 0.02


@pytest.mark.parametrize("flaw", ["pose_flip", "y_flip", "frame_flip", "side_swap", "reversed_wheel"])
@pytest.mark.parametrize("robot", ["husky_driven", "agriq"])
def test_signs_and_sides_that_are_the_wrong_way_round_are_turned(flaw: str, robot: str) -> None:
    """The columns are those of the same drive without the flaw, commands too, and nothing is found in them."""
    made = load_robot(robot)
    of = drive(made, np.random.default_rng(8), 60.0)
    raw, right = (recorded(of, replace(FLAWS[name], mount=None), np.random.default_rng(9)) for name in (flaw, "none"))
    found = aligned(raw, made)
    assert [one.name for one in found.mended] == ["pose_flip" if flaw.endswith("flip") else flaw]
    assert not any(one.serious for one in found.found)
    assert any("beforehand" in said for said in what_was_mended([found]))
    for key, names in (("ground_truth_odom", ("x", "y", "yaw")), ("motor_torques", ("front_right.velocity",))):
        seen, true = (np.column_stack([one.channels[key][name] for name in names]) for one in (found.experiment, right))
        assert (np.nanstd(seen - true, axis=0) < 0.2 * np.nanstd(true, axis=0)).all()
    command = found.experiment.channels["motor_command"]
    if flaw in ("side_swap", "reversed_wheel"):  # of the rotations only: commands had the right sides and signs
        assert command is raw.channels["motor_command"]


def test_commands_are_exchanged_with_the_sides_that_they_are_of() -> None:
    made = load_robot("husky_driven")
    raw = recorded(drive(made, np.random.default_rng(8), 60.0), FLAWS["side_swap"], np.random.default_rng(9))
    command = raw.channels["motor_command"]
    names = [f"front_{side}.velocity" for side in ("right", "left")]
    swapped = dict(command.columns) | dict(zip(names, [command[name] for name in names[::-1]], strict=True))
    both = replace(raw, channels={**raw.channels, "motor_command": replace(command, columns=swapped)})
    mended = aligned(both, made).experiment.channels["motor_command"]
    assert all(np.array_equal(mended[name], command[name], equal_nan=True) for name in names)


def test_a_place_that_is_lost_for_long_is_cut_out() -> None:
    """Positions before and after are as late as without it, and no window holds a leap."""
    robot, raw = logged(FLAWS["lost_place"], 7)
    found = aligned(raw, robot)
    assert [one.name for one in found.mended] == ["pose_leap"]
    assert not leaps_of(segments_of(found.experiment), robot)
    kept = sum(b - a for a, b in found.experiment.segments)
    assert 60.0 < kept < 80.0  # of 90 s, of which it was lost for 15


@pytest.mark.parametrize("mount", [(0.05, -0.15), (0.5 * np.pi, 0.0), (0.0, -1.2)])
def test_an_imu_is_turned_until_gravity_is_along_z(mount: tuple[float, float]) -> None:
    """Rates that stood in other axes then are the yaw rate, and nothing is said of them any more."""
    robot, raw = logged(Logger(mount=mount), 12)
    found = aligned(raw, robot)
    assert {one.name for one in found.mended} == {"imu_tilt"}
    assert not {"imu_tilt", "gyro_axis", "gyro_scale"} & {one.name for one in found.found}
    _, level = logged(Logger(mount=(0.0, 0.0)), 12)
    seen, true = (one.channels["imu"]["yaw_rate"] for one in (found.experiment, level))
    assert np.std(seen - true) < 0.03 < np.std(true)


def test_a_level_imu_stays_as_it_is() -> None:
    robot, raw = logged(Logger(mount=(0.0, 0.0)), 12)
    assert aligned(raw, robot).experiment.channels["imu"] is raw.channels["imu"]


@pytest.mark.parametrize("late", [0.0, 0.25])
def test_a_recording_is_cut_where_its_pose_leaps(late: float) -> None:
    """No piece holds a leap, also where poses were shifted, and hardly anything is lost."""
    robot, raw = logged(replace(FLAWS["pose_leap"], delays={"ground_truth_odom": late}), 7)
    assert leaps_of(segments_of(raw), robot)
    found = aligned(raw, robot)
    assert ("pose_delay" in {one.name for one in found.mended}) == bool(late)
    assert not leaps_of(segments_of(found.experiment), robot)
    assert "pose_leap" not in {one.name for one in aligned(found.experiment, robot).mended}
    lasted = [sum(b - a for a, b in one.segments) for one in (raw, found.experiment)]
    assert lasted[1] > 0.9 * lasted[0]
    assert any("the recording was cut there" in said for said in what_was_mended([found]))


def test_intervals_are_drawn_from_the_callers_seed() -> None:
    robot, raw = logged(Logger(delays={"imu": 0.15}), 8)
    one, same, other = (compare_streams(raw, seed).gyro for seed in (1, 1, 2))
    assert one.skew_interval == same.skew_interval != other.skew_interval
    assert one.interval == same.interval and one.value == other.value
    again = [aligned(raw, robot, seed).mended[0].interval for seed in (1, 1)]
    assert again[0] == again[1]


@pytest.mark.long
def test_wheels_that_are_late_cost_an_identification_nothing() -> None:
    """Speeds 0.2 s late and a gyroscope 0.15 s early: shifted first, soil and errors are those of good stamps."""
    robot = load_robot("husky_driven")
    flaws = {"motor_torques": 0.2, "imu": -0.15}
    good, bad = (logged(Logger(polled=0.0, delays=delays), 6, robot)[1] for delays in ({}, flaws))
    found = [identify([one], robot, fit=["k_t", "mu_s"], window=4.0).result for one in (good, bad)]
    shifts = [said for said in found[1].findings if "stamps were shifted by" in said]
    assert list(found[1].findings[: len(shifts)]) == shifts and len(shifts) == 2
    assert not any("stamps were shifted" in said for said in found[0].findings)
    for channel in ("position", "yaw", "yaw_rate"):
        assert found[1].channels[channel].rmse < 1.5 * found[0].channels[channel].rmse
    one, other = (result.estimates[0] for result in found)
    assert other.value == pytest.approx(one.value, rel=0.15)


def test_other_stamps_make_no_clock_run_apart_from_arrivals() -> None:
    _, raw = logged(Logger(), 1, load_robot("husky_driven"))
    imu = raw.channels["imu"]
    moved = restamped(imu, imu.t + 0.125)
    assert np.array_equal(moved.t_ns - imu.t_ns, np.full(len(imu), 125_000_000))
    assert np.allclose(moved.t - imu.t, 0.125)
    drifting = restamped(imu, imu.t * (1.0 + 2e-3))
    for each in (moved, drifting):
        assert not list(clock_faults(replace(raw, channels={**raw.channels, "imu": each})))


@pytest.mark.parametrize("name", ["husky_drive_a", pytest.param("husky_drive_b", marks=pytest.mark.long)])
def test_the_gyroscope_of_a_real_husky_is_early(name: str) -> None:
    """Poses and wheels fit each other; the gyroscope fits neither until its stamps are shifted."""
    found = aligned(read_bag(foreign(f"real/{name}")), load_robot("husky_driven"))
    (gyro,) = found.mended
    assert gyro.name == "gyro_delay" and gyro.value == pytest.approx(-0.17, abs=0.02)
    assert abs(compare_streams(found.experiment).gyro.value) < 0.02


def test_what_is_mended_is_said_of_every_recording_and_first() -> None:
    robot, raw = logged(Logger(delays={"imu": 0.15}, gyro_bias=0.05), 9)
    found = aligned(raw, robot)
    assert [one.name for one in found.mended] == ["gyro_delay"]
    assert "gyro_bias" in {one.name for one in found.found}
    assert "gyro_delay" not in {one.name for one in aligned(replace(found.experiment), robot).mended}


@pytest.mark.parametrize(
    "what",
    ["slope", *(pytest.param(one, marks=pytest.mark.long) for one in ("none", "joint_friction", "speed_loop_lag"))],
)
def test_stamps_that_are_right_stay_where_physics_is_missing(what: str) -> None:
    """Slopes, friction and slow drives make streams differ; none of these is a clock."""
    for run in range(3):
        part = read_bag(foreign(f"field_examples/{what}/run{run}")).between(20.0, 40.0)
        timed = aligned(part, load_robot("agriq"))
        assert timed.mended == ()
        assert timed.experiment is part


def test_what_is_wrong_with_several_recordings_alike_is_said_once() -> None:
    robot, late = logged(Logger(delays={"imu": 0.15}), 21)
    _, early = logged(Logger(delays={"imu": -0.2}), 21, robot)
    timed = [aligned(replace(one, name=name), robot) for one, name in ((late, "a"), (late, "b"), (early, "c"))]
    alike, other = what_was_mended(timed)
    size = timed[1].mended[0].value
    assert alike.startswith("a: ") and f"; likewise b {size:.2f} s (" in alike
    assert other.startswith("c: ") and "likewise" not in other


def test_tyres_that_answer_a_turn_early_do_not_move_the_wheels_stamps() -> None:
    """How the rover advances tells when its wheels turned, whatever lateral forces make of its turning."""
    husky = load_robot("husky_driven")
    robot = replace(husky, effects={**husky.effects, "tyre_relaxation": {"length": 0.05}})
    rotations, poses = 0.27, 0.18
    _, raw = logged(Logger(polled=0.0, delays={"motor_torques": rotations, "ground_truth_odom": poses}), 2, robot)
    late = {one.name: one for one in aligned(raw, robot).mended}
    assert set(late) == {"rotation_delay", "pose_delay"}
    assert late["pose_delay"].value == pytest.approx(poses, abs=0.01)
    low, high = late["rotation_delay"].interval
    assert low < rotations < high and late["rotation_delay"].value == pytest.approx(rotations, abs=0.05)
