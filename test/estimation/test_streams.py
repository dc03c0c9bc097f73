"""Clocks, signs and units of recordings: what a logger did to a drive of the simulator is found, and nothing else."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bag_helpers import foreign
from click.testing import CliRunner
from estimation.logger import BESIDE, FLAWS, WANTED, Logger, drive, recorded, size_is_right, trial

from artibot_sim.cli.check import command
from artibot_sim.errors import ArtibotError
from artibot_sim.estimation.alignment import on_one_clock, what_is_wrong
from artibot_sim.estimation.checks.comparisons import compare_streams
from artibot_sim.estimation.checks.findings import findings
from artibot_sim.estimation.checks.recordings import require_usable
from artibot_sim.estimation.checks.report import check
from artibot_sim.estimation.streams import holding
from artibot_sim.experiment import read_bag, write_channels
from artibot_sim.experiment.smoothing import fresh
from artibot_sim.identify import identify
from artibot_sim.model import load_robot


@pytest.mark.parametrize("name", list(FLAWS))
def test_each_flaw_is_found_with_its_size_and_no_other(name: str) -> None:
    _, _, found = trial(name, 11)
    wanted = WANTED.get(name, name)
    mine = [one for one in found if one.name == wanted]
    others = {one.name for one in found} - {wanted, "held_samples"} - BESIDE.get(name, set())
    assert bool(mine) == (name != "none"), found
    assert not others, found
    assert name == "none" or size_is_right(name, mine[0]), mine


def test_a_drift_of_a_clock_is_found_within_its_interval() -> None:
    _, _, found = trial("clock_skew", 3)
    (skew,) = (one for one in found if one.name == "clock_skew")
    assert skew.interval[0] <= 2000.0 <= skew.interval[1]
    assert skew.interval[1] - skew.interval[0] < 2000.0


def test_delays_of_every_stream_are_told_together() -> None:
    """All three late by different amounts: two findings are enough, against the gyroscope."""
    rng = np.random.default_rng(5)
    robot = load_robot("husky_driven")
    logger = Logger(polled=0.0, delays={"motor_torques": 0.35, "ground_truth_odom": 0.6, "imu": 0.1})
    found = {one.name: one for one in findings(recorded(drive(robot, rng), logger, rng), robot)}
    assert found["pose_delay"].value == pytest.approx(0.5, abs=0.02)
    assert found["rotation_delay"].value == pytest.approx(0.25, abs=0.05)


def test_late_speeds_may_be_smoothed_ones_where_no_angles_are_recorded() -> None:
    rng = np.random.default_rng(11)
    robot = load_robot("husky_driven")
    run = recorded(drive(robot, rng), Logger(polled=0.0, delays={"motor_torques": 0.3}), rng)
    motors = run.channels["motor_torques"]
    spoken = {name: values for name, values in motors.columns.items() if not name.endswith("position")}
    turned = spoken | {f"{motor}.position": np.array(motors.t) for motor in ("front_right", "front_left")}
    for columns, said in ((spoken, True), (turned, False)):
        channels = {**run.channels, "motor_torques": replace(motors, columns=columns)}
        streams = compare_streams(run)  # the same motion: only which columns there are is asked
        found = findings(run, robot, replace(streams, experiment=replace(run, channels=channels)))
        (late,) = (one for one in found if one.name == "rotation_delay")
        assert ("velocity_filter" in late.text) == said


def test_held_samples_count_once_and_standstill_stays() -> None:
    t = np.arange(0.0, 40.0, 0.05)
    for rows in (1, 5, 12):
        value = np.where(t < 30.0, np.floor(np.arange(len(t)) / rows), -1.0)
        new = fresh(value)
        assert new[t < 30.0].mean() == pytest.approx(1.0 / rows, abs=0.01)
        assert new[t >= 30.0].all()
        lost = value.copy()
        lost[4 * rows : 6 * rows] = lost[4 * rows]
        assert (fresh(lost) == (new & ((t < t[5 * rows]) | (t >= t[6 * rows])))).all()  # a message that never came
    rng = np.random.default_rng(1)
    robot = load_robot("husky_driven")
    slow = Logger(rates={"motor_torques": 5.0, "ground_truth_odom": 18.0, "imu": 50.0}, lost=0.0)
    channel = recorded(drive(robot, rng, 30.0), slow, rng).channels["motor_torques"]
    found = holding(channel, ["front_right.velocity", "front_left.velocity"])
    assert found.share == pytest.approx(0.75, abs=0.02) and found.period == pytest.approx(0.2, abs=0.01)


def test_without_a_heading_and_without_a_gyroscope_what_can_be_told_is_told() -> None:
    rng = np.random.default_rng(8)
    robot = load_robot("husky_driven")
    done = drive(robot, rng)
    late = recorded(done, Logger(delays={"ground_truth_odom": 0.3}), rng)
    alone = replace(late, channels={key: c for key, c in late.channels.items() if key != "imu"})
    (found,) = (one for one in findings(alone, robot) if one.name == "pose_delay")
    assert found.interval[0] <= 0.33 and found.value == pytest.approx(0.3, abs=0.06)
    motors = {key: c for key, c in late.channels.items() if key == "motor_torques"}
    assert compare_streams(replace(late, channels=motors)).turn is None


def test_a_robot_off_the_ground_is_refused_as_such() -> None:
    robot, experiment, _ = trial("in_air", 2)
    with pytest.raises(ArtibotError, match="lifted off the ground"):
        require_usable([experiment], robot)


def test_a_robot_off_the_ground_whose_factor_looks_like_a_unit_is_refused_as_such() -> None:
    """The wheels roll about 12 times as far as the pose goes, which could be rpm for rad/s."""
    with pytest.raises(ArtibotError, match="lifted off the ground"):
        require_usable([read_bag(foreign("real/husky_in_air"))], load_robot("husky_driven"))


def test_identify_refuses_millimetres_and_says_first_what_is_wrong() -> None:
    rng = np.random.default_rng(4)
    robot = load_robot("husky_driven")
    flipped = recorded(drive(robot, rng, 60.0), Logger(flaws=frozenset({"gyro_flip"})), rng)
    pose = flipped.channels["ground_truth_odom"]
    columns = {name: values * (1e3 if name in "xy" else 1.0) for name, values in pose.columns.items()}
    wrong = replace(flipped, channels={**flipped.channels, "ground_truth_odom": replace(pose, columns=columns)})
    with pytest.raises(ArtibotError, match="a factor of"):
        identify([wrong], robot, fit=["k_l"])
    work = identify([flipped], robot, fit=["k_l"], window=4.0)
    assert "upside down" in work.result.findings[0]
    text = str(work.result)
    assert text.index("upside down") < text.index("k_l"), "what is wrong with a recording is said first"


def written(folder: Path, experiment) -> Path:
    tables = {key: (channel.t_ns, channel.columns) for key, channel in experiment.channels.items()}
    return write_channels(folder, tables)


def test_the_command_says_what_has_to_be_mended(tmp_path: Path) -> None:
    robot, experiment, _ = trial("side_swap", 1)
    bag, out = written(tmp_path / "swapped", experiment), tmp_path / "found.json"
    status = command.main([str(bag), "--robot", robot.name, "--json", str(out)], standalone_mode=False)
    (found,) = json.loads(out.read_text())[:1]
    assert status == 1 and not found["usable"]
    assert "side_swap" in [one["name"] for one in found["findings"]]
    (first, *_) = what_is_wrong(on_one_clock([experiment], robot, 0), [])
    assert "left and right wheels" in first and "the sides were exchanged beforehand" in first
    robot, experiment, _ = trial("gyro_axis", 1)
    first, *rest = what_is_wrong(on_one_clock([experiment], robot, 0), [])
    assert first.startswith("mend this first") and "IMU is turned" in first
    assert not any(said.startswith("mend this first") for said in rest)
    robot, experiment, _ = trial("none", 1)
    bag = written(tmp_path / "good", experiment)
    done = CliRunner().invoke(command, [str(bag), "--robot", robot.name], catch_exceptions=False)
    assert "good: can be used" in done.output


def test_nan_two_robots_and_standing_still_are_said() -> None:
    rng = np.random.default_rng(6)
    robot = load_robot("husky_driven")
    experiment = recorded(drive(robot, rng, 60.0), Logger(), rng)
    pose = experiment.channels["ground_truth_odom"]

    def with_x(values: np.ndarray):
        columns = {**pose.columns, "x": values}
        return replace(
            experiment, channels={**experiment.channels, "ground_truth_odom": replace(pose, columns=columns)}
        )

    lost = pose["x"].copy()
    lost[::4] = np.nan
    two = pose["x"].copy()
    two[::2] += 30.0
    assert any("25 % of x is NaN" in said for said in check([with_x(lost)], robot)[0].doubts)
    assert any("two robots in one recording?" in said for said in check([with_x(two)], robot)[0].doubts)
    assert not any("two robots" in said or "NaN" in said for said in check([experiment], robot)[0].doubts)


@pytest.mark.parametrize(
    ("name", "robot", "wanted"),
    [
        ("husky_in_air", "husky_driven", {"in_air"}),
        ("warthog_gravel", "warthog", {"gyro_flip", "pose_delay", "held_samples"}),
        ("husky_wetgrass", "husky_driven", {"pose_leap", "held_samples"}),
        ("warthog_asphalt", "warthog", {"pose_delay", "rotation_delay", "held_samples"}),
    ],
)
def test_real_recordings(name: str, robot: str, wanted: set[str]) -> None:
    found = findings(read_bag(foreign(f"real/{name}")), load_robot(robot))
    assert wanted <= {one.name for one in found}
