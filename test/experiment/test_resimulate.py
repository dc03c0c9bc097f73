"""Recordings simulated again: a simulation gives itself back, and the results are the contract's."""

from __future__ import annotations

import filecmp
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from bag_helpers import EPOCH, foreign, mcap_file, small_bag
from hypothesis import given, settings
from hypothesis import strategies as st

from artibot_sim.errors import ArtibotError
from artibot_sim.estimation.measurements import stretches
from artibot_sim.estimation.windows import measured_start
from artibot_sim.experiment import Experiment, read_bag, write_channels, write_experiment
from artibot_sim.experiment.metrics import UNITS
from artibot_sim.experiment.resimulate import ground_of, resimulate, robot_of
from artibot_sim.experiment.smoothing import fresh, local_fit, noise_of, smoothed
from artibot_sim.model import Commands, Robot, Rollout, load_ground, load_robot, rollout

SOILS = {
    "contact.k_l": 2920.7,
    "contact.k_t": 1795.4,
    "contact.mu_s": 0.677,
    "contact.mu_d": 0.320,
    "contact.u_w": 0.0084,
}
"""The soil of field_examples/none (its README)."""


def bump(duration: float = 4.0) -> Commands:
    """From rest to a left turn and back to rest, in knots of 10 ms; motor-side."""
    t = np.arange(0.0, duration + 5e-3, 0.01)
    shape = 100.0 * np.sin(np.pi * t / duration) ** 2
    velocity = np.full((len(t), 4), np.nan)
    velocity[:, 0], velocity[:, 1] = shape, 0.8 * shape
    return Commands(0.01, velocity)


def simulated(folder: Path, robot: Robot, commands: Commands) -> tuple[Experiment, Rollout]:
    result = rollout(robot, commands)
    return read_bag(write_experiment(folder, result, None, robot, commands=commands)), result


@pytest.fixture(scope="module")
def agriq(tmp_path_factory: pytest.TempPathFactory) -> tuple[Experiment, Rollout, Robot]:
    robot = load_robot("agriq")
    return (*simulated(tmp_path_factory.mktemp("bags") / "run", robot, bump()), robot)


def test_a_rover_that_is_moved_as_a_whole_keeps_its_joint_and_its_rates(agriq: tuple) -> None:
    experiment, _, robot = agriq
    (piece,) = resimulate(experiment, robot, "rotations", horizon=2.0).pieces

    def offset(run: Rollout, before: Rollout) -> np.ndarray:
        assert not len(before.t) or before.t[-1] == pytest.approx(run.t[0])
        since = (run.t - run.t[0])[:, None]
        return since * [0.1, -0.2, 0.3]

    moved, t = piece.moved(offset), np.arange(0.1, 1.9, 0.05)
    old, new = piece.at(t), moved.at(t)
    assert new.pose - old.pose == pytest.approx(t[:, None] * [0.1, -0.2, 0.3], abs=1e-6)
    assert new.articulation_yaw == pytest.approx(old.articulation_yaw, abs=1e-9)
    slope = (moved.at(t + 1e-3).q - moved.at(t - 1e-3).q) / 2e-3
    assert new.v[:, [0, 1, 5, 8, 9, 13]] == pytest.approx(slope[:, [0, 1, 5, 8, 9, 13]], abs=2e-3)
    joint = np.hypot(*(new.q[:, 8:10] - new.q[:, :2]).T)
    assert joint == pytest.approx(np.hypot(*(old.q[:, 8:10] - old.q[:, :2]).T), abs=1e-6)


def test_commands_give_the_simulation_back_to_rounding(agriq: tuple) -> None:
    experiment, _, robot = agriq
    result = resimulate(experiment, robot, "commands")
    assert result.windows == 1
    assert not result.remarks
    for channel, limit in (("position", 1e-9), ("yaw", 1e-9), ("yaw_rate", 1e-7), ("articulation_yaw", 1e-9),
                           ("front_velocity", 1e-9), ("torque_front", 1e-7), ("torque_back", 1e-7)):  # fmt: skip
        assert result.metrics[channel].rmse < limit, channel
    assert set(result.metrics) == set(UNITS)


@pytest.mark.parametrize("name", ["agriq", "epiq"])
def test_rotations_give_the_simulation_back(tmp_path: Path, name: str) -> None:
    robot = load_robot(name)
    experiment, _ = simulated(tmp_path / name, robot, bump())
    metrics = resimulate(experiment, robot, "rotations").metrics
    travelled = np.hypot(*(np.ptp(experiment.channels["ground_truth_odom"][axis]) for axis in "xy"))
    assert metrics["position"].rmse < 1e-3 * travelled
    assert metrics["yaw"].rmse < 1e-3
    assert metrics["articulation_yaw"].rmse < 1e-3


@pytest.mark.parametrize("drive", ["rotations", "commands"])
def test_every_window_starts_from_the_measurements(agriq: tuple, drive: str) -> None:
    experiment, _, robot = agriq
    wrong = robot.replace({"contact.k_t": 0.5 * robot.contact.k_t, "contact.mu_s": 0.8 * robot.contact.mu_s})
    free = resimulate(experiment, wrong, drive)
    often = resimulate(experiment, wrong, drive, horizon=0.5)
    assert (free.windows, often.windows) == (1, 8)
    assert often.metrics["position"].rmse < 0.5 * free.metrics["position"].rmse
    (part,) = often.compared["position"]
    miss = np.hypot(*(part.simulated - part.recorded).T)
    starts = np.isin(np.rint((part.t - part.t[0]) / 0.01).astype(int) % 50, (1, 2))  # one and two rows after each start
    assert miss[starts].max() < 0.25 * miss.max()


def test_segments_start_where_they_were_measured(tmp_path: Path, agriq: tuple) -> None:
    experiment, _, robot = agriq
    tables = {}
    for key in ("ground_truth_odom", "motor_torques", "joint_states", "motor_command"):
        channel = experiment.channels[key]
        columns = {}
        for name, values in channel.columns.items():
            moved = values + 7.0 if key == "ground_truth_odom" and name in "xy" else values
            columns[name] = np.concatenate([values, moved])
        tables[key] = (EPOCH + np.concatenate([channel.t_ns, channel.t_ns + 10_000_000_000]), columns)
    twice = read_bag(write_channels(tmp_path / "twice", tables, {"robot": "agriq", "kappa": "0.8"}))
    assert len(twice.segments) == 2
    for drive in ("rotations", "commands"):
        result = resimulate(twice, robot, drive)
        assert result.windows == 2
        assert len(result.compared["position"]) == 2
        assert result.metrics["position"].rmse < 1e-3


def test_the_bag_has_the_recorded_stamps_and_the_metrics_are_the_contracts(tmp_path: Path, agriq: tuple) -> None:
    experiment, _, robot = agriq
    result = resimulate(experiment, robot, "rotations", horizon=1.0)
    assert result.write(tmp_path / "out") == tmp_path / "out"
    again = read_bag(tmp_path / "out" / "simulated")
    assert again.metadata["robot"] == "agriq"
    assert set(again.topics) == {"/ground_truth/odom", "/motor_torques", "/joint_states"}
    for key in again.channels:
        assert np.array_equal(again.channels[key].t_ns, experiment.channels[key].t_ns)
        assert set(again.channels[key].columns) == set(experiment.channels[key].columns)
        assert all(np.isfinite(values).all() for values in again.channels[key].columns.values())
    numbers = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert list(numbers) == [name for name in UNITS if name in numbers]
    assert all({"unit", "rmse", "median", "p90", "noise"} <= set(entry) for entry in numbers.values())
    truth, simulation = experiment.channels["ground_truth_odom"], again.channels["ground_truth_odom"]
    miss = np.hypot(simulation["x"] - truth["x"], simulation["y"] - truth["y"])
    assert numbers["position"]["rmse"] == pytest.approx(np.sqrt(np.mean(miss[1:] ** 2)), rel=1e-6)  # no start
    assert numbers["position"]["p90"] == pytest.approx(np.quantile(miss[1:], 0.9), rel=1e-6)
    with pytest.raises(ArtibotError, match="never overwritten"):
        result.write(tmp_path / "out")


def test_equal_recordings_give_equal_bytes(tmp_path: Path, agriq: tuple) -> None:
    experiment, _, robot = agriq
    for name in ("one", "two"):
        resimulate(experiment, robot, "rotations").write(tmp_path / name)
    files = [mcap_file(tmp_path / name / "simulated") for name in ("one", "two")]
    assert filecmp.cmp(*files, shallow=False)
    assert filecmp.cmp(tmp_path / "one/metrics.json", tmp_path / "two/metrics.json", shallow=False)


def test_a_rigid_rover_by_speeds_alone(tmp_path: Path) -> None:
    robot = load_robot("husky")
    t = np.arange(0.0, 4.005, 0.01)
    velocity = np.full((len(t), 4), np.nan)
    velocity[:, 0], velocity[:, 1] = 3 * np.sin(np.pi * t / 4) ** 2, np.sin(np.pi * t / 4) ** 2
    experiment, _ = simulated(tmp_path / "full", robot, Commands(0.01, velocity))
    torques, truth = experiment.channels["motor_torques"], experiment.channels["ground_truth_odom"]
    every = slice(None, None, 5)
    tables = {
        "motor_torques": (torques.t_ns[every], {n: torques[n][every] for n in torques.columns if "velocity" in n}),
        "ground_truth_odom": (truth.t_ns[every], {n: truth[n][every] for n in ("x", "y", "yaw")}),
    }
    sparse = read_bag(write_channels(tmp_path / "sparse", tables, {"robot": "husky"}))
    result = resimulate(sparse, robot_of(sparse), "rotations")
    assert {"position", "yaw", "front_velocity"} <= set(result.metrics)
    assert not {"articulation_yaw", "torque_front", "torque_back"} & set(result.metrics)
    assert result.metrics["position"].rmse < 5e-3
    assert result.metrics["yaw"].rmse < 1e-2


def test_a_window_starts_as_an_identification_starts_it_where_poses_leap(tmp_path: Path) -> None:
    robot = load_robot("husky")
    t = np.arange(0.0, 6.005, 0.01)
    velocity = np.full((len(t), 4), np.nan)
    velocity[:, 0], velocity[:, 1] = 3 * np.sin(np.pi * t / 6) ** 2, 2 * np.sin(np.pi * t / 6) ** 2
    experiment, _ = simulated(tmp_path / "full", robot, Commands(0.01, velocity))
    torques, truth = experiment.channels["motor_torques"], experiment.channels["ground_truth_odom"]
    leap = np.where(truth.t > 2.02, -1.5, 0.0)
    tables = {
        "motor_torques": (torques.t_ns, {n: torques[n] for n in torques.columns if "velocity" in n}),
        "ground_truth_odom": (truth.t_ns, {"x": truth["x"] + leap, "y": truth["y"], "yaw": truth["yaw"]}),
    }
    bag = read_bag(write_channels(tmp_path / "leap", tables, {"robot": "husky"}))
    made = resimulate(bag, robot, "rotations", horizon=2.0).tables["ground_truth_odom"]
    stretch = stretches(bag, robot)[0]
    for knot in (200, 400):
        start = measured_start(stretch, robot, knot)
        t0 = float(stretch.inputs.t[knot])
        # the first stamp after a start: the velocity with which the window began still stands
        row = int(np.argmax((made[0] - bag.start_ns) / 1e9 > t0 + 1e-6))
        rim = robot.wheel.r_w * float(np.abs(stretch.inputs.velocity[knot, :2]).max())
        assert np.hypot(made[1]["vx"][row], made[1]["vy"][row]) < 1.3 * rim
        assert made[1]["vx"][row] == pytest.approx(start.mean[3], abs=0.3 * rim)
        assert made[1]["yaw_rate"][row] == pytest.approx(start.mean[5], abs=0.2)


def test_heading_and_velocity_are_found_from_points_gyroscope_and_accelerometer(tmp_path: Path) -> None:
    robot = load_robot("agriq")
    t = np.arange(0.0, 20.005, 0.01)
    ramp = np.clip(t / 2.0, 0, 1) * np.clip((20.0 - t) / 2.0, 0, 1)
    velocity = np.full((len(t), 4), np.nan)
    bend = 0.15 * np.sin(2 * np.pi * np.clip(t - 5.0, 0, None) / 7.5)
    velocity[:, 0], velocity[:, 1] = 120 * ramp * (1 + bend), 120 * ramp * (1 - bend)
    experiment, result = simulated(tmp_path / "run", robot, Commands(0.01, velocity))
    random = np.random.default_rng(4)
    turn, shift = 1.1, np.array([3.0, -2.0])
    c, s = np.cos(turn), np.sin(turn)
    points = result.pose[:, :2] @ np.array([[c, s], [-s, c]]) + shift + 0.003 * random.standard_normal((len(t), 2))
    v = np.gradient(result.v[:, :2], result.t, axis=0)
    cg, sg = np.cos(result["gamma_f"]), np.sin(result["gamma_f"])
    imu = {
        "ax": cg * v[:, 0] + sg * v[:, 1] + 0.05 * random.standard_normal(len(t)),
        "ay": cg * v[:, 1] - sg * v[:, 0] + 0.05 * random.standard_normal(len(t)),
        "yaw_rate": result["gamma_f_dot"] + 0.004 * random.standard_normal(len(t)),
    }
    stamps = experiment.channels["ground_truth_odom"].t_ns
    tables = {
        key: (experiment.channels[key].t_ns, experiment.channels[key].columns)
        for key in ("motor_torques", "joint_states")
    }
    tables |= {"imu": (stamps, imu), "total_station": (stamps[::10], {"x": points[::10, 0], "y": points[::10, 1]})}
    seen = read_bag(write_channels(tmp_path / "seen", tables, {"robot": "agriq", "kappa": "0.8"}))
    free = resimulate(seen, robot, "rotations")
    assert free.metrics["position"].noise == pytest.approx(0.003 * np.sqrt(2), rel=0.2)
    assert free.metrics["position"].rmse < 0.08, "10 m of path; a hundredth of a radian is 10 cm at its end"
    assert "yaw" not in free.metrics
    windows = resimulate(seen, robot, "rotations", horizon=2.0)
    assert windows.metrics["position"].median < 0.02


def test_a_recording_over_uneven_ground_is_simulated_over_it(tmp_path: Path) -> None:
    """The ground that its metadata name gives the run back; flat ground does not."""
    robot, ground = load_robot("agriq"), load_ground("random:6,rms=0.15,size=12.8")
    result = rollout(robot, bump(), ground=ground)
    experiment = read_bag(write_experiment(tmp_path / "run", result, None, robot, commands=bump()))
    assert experiment.metadata["ground"] == ground.name
    same = resimulate(experiment, robot, "commands", ground=ground_of(experiment))
    flat = resimulate(experiment, robot, "commands")
    assert same.metrics["position"].rmse < 1e-6 < 1e-4 < flat.metrics["position"].rmse
    same.write(tmp_path / "again")
    assert read_bag(tmp_path / "again" / "simulated").metadata["ground"] == ground.name
    with pytest.raises(ArtibotError, match="no such ground file"):
        ground_of(experiment, "nowhere.yaml")


def test_what_is_missing_is_said(tmp_path: Path, agriq: tuple) -> None:
    experiment, _, robot = agriq
    silent = read_bag(small_bag(tmp_path / "small"))
    with pytest.raises(ArtibotError, match=r"does not say which robot.*--robot"):
        robot_of(silent)
    with pytest.raises(ArtibotError, match=r"front_left.*--joint.*commands"):
        resimulate(silent, robot, "rotations")
    with pytest.raises(ArtibotError, match="/motor_command"):
        resimulate(silent, robot, "commands")
    with pytest.raises(ArtibotError, match="expected one of rotations, commands"):
        resimulate(experiment, robot, "telepathy")
    with pytest.raises(ArtibotError, match=r"at least 0\.1 s"):
        resimulate(experiment, robot, horizon=0.0)
    motors = experiment.channels["motor_torques"]
    bad = {"motor_torques": (motors.t_ns, motors.columns)}
    with pytest.raises(ArtibotError, match=r"kappa is '1\.5'"):
        resimulate(read_bag(write_channels(tmp_path / "kappa", bad, {"kappa": "1.5"})), robot)


def test_another_robot_than_the_recording_names_is_said(agriq: tuple) -> None:
    (remark,) = resimulate(agriq[0], load_robot("epiq"), "rotations").remarks
    assert remark == "recorded with robot 'agriq', simulated as 'epiq'"


def test_the_command_needs_no_ros(tmp_path: Path, agriq: tuple) -> None:
    experiment, _, _ = agriq
    code = (
        "import sys; sys.modules['rclpy'] = None\n"
        "from artibot_sim.cli import main\n"
        "sys.exit(main(['replay', sys.argv[1], '--resimulate', 'commands', '--out', sys.argv[2]]))"
    )
    words = [sys.executable, "-c", code, str(experiment.path), str(tmp_path / "o")]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "position" in done.stdout
    assert (tmp_path / "o" / "metrics.json").is_file()
    assert (tmp_path / "o" / "simulated" / "metadata.yaml").is_file()


@pytest.mark.parametrize("run", ["run0", "run1", "run2"])
def test_a_rover_of_another_program_stays_near_with_its_true_soil(run: str) -> None:
    experiment = read_bag(foreign(f"field_examples/none/{run}"))
    robot = robot_of(experiment).replace(SOILS)
    metrics = resimulate(experiment, robot, "rotations").metrics
    assert metrics["position"].rmse < 0.2, "45 s without a new start; what is left is the heading at the start"
    for channel in ("yaw_rate", "articulation_yaw", "torque_front", "torque_back"):
        assert metrics[channel].rmse < 1.6 * metrics[channel].noise, channel


def test_a_real_rigid_rover_is_simulated_window_by_window() -> None:
    experiment = read_bag(foreign("husky_a"))
    result = resimulate(experiment, robot_of(experiment), "rotations")
    assert result.windows == len(experiment.segments) == 204
    assert result.metrics["position"].median < 0.2
    assert result.metrics["yaw"].median < 0.3


@given(st.integers(5, 60), st.floats(0.005, 0.2), st.integers(0, 2**31))
@settings(max_examples=50, deadline=None)
def test_local_fits_reproduce_cubics_at_any_spacing(count: int, spacing: float, seed: int) -> None:
    random = np.random.default_rng(seed)
    t = np.sort(spacing * (np.arange(count) + 0.3 * random.random(count)))
    c = random.normal(size=4) / (count * spacing) ** np.arange(4)
    at = random.uniform(t[0], t[-1], 7)
    value, rate = local_fit(t, np.polynomial.polynomial.polyval(t, c), at, 2.5 * spacing)
    assert value == pytest.approx(np.polynomial.polynomial.polyval(at, c), abs=1e-8)
    assert rate * count * spacing == pytest.approx(
        np.polynomial.polynomial.polyval(at, np.polynomial.polynomial.polyder(c)) * count * spacing, abs=1e-5
    )


def test_noise_is_found_under_motion_outliers_and_held_samples() -> None:
    random = np.random.default_rng(1)
    t = np.arange(0, 40, 0.1)
    y = 3 * np.sin(0.5 * t) + 0.02 * random.standard_normal(len(t))
    y[::50] += 1.0
    assert noise_of(t, y) == pytest.approx(0.02, rel=0.25)
    held = np.repeat(y, 2)
    assert noise_of(np.arange(len(held)) * 0.05, held) == pytest.approx(0.02, rel=0.25)
    assert np.isnan(noise_of(t[:10], y[:10]))


@pytest.mark.parametrize("spacing", [0.01, 0.03, 0.05])
def test_speeds_lose_noise_and_keep_their_ramps(spacing: float) -> None:
    random = np.random.default_rng(3)
    t = np.arange(0.0, 60.0, spacing)
    true = np.interp(t, np.arange(0.0, 61.0, 2.0), np.repeat(random.uniform(-6.0, 6.0, 16), 2)[:31])
    assert np.array_equal(smoothed(t, true), true)
    for noise in (0.03, 0.1, 0.3):
        seen = true + noise * random.standard_normal(len(t))
        assert np.std(smoothed(t, seen) - true) < 0.85 * noise


def test_speeds_that_waver_stay_as_they_are() -> None:
    random = np.random.default_rng(4)
    t = np.arange(0.0, 60.0, 0.05)
    seen = np.cumsum(0.05 * random.standard_normal(len(t)))
    assert np.array_equal(smoothed(t, seen), seen)


def test_a_standstill_is_no_held_sample() -> None:
    assert fresh([1.0, 1.0, 2.0, 2.0, 2.0, 3.0]).tolist() == [True, False, True, False, False, True]
    assert fresh([0.0] * 20).all()
    assert fresh([]).shape == (0,)


@pytest.mark.parametrize("name", ["train3", "train5"])
def test_a_train_gives_its_simulation_back(tmp_path: Path, name: str) -> None:
    """Commands to rounding; windows from measurements in the middle of a bend know the angles of all joints."""
    robot = load_robot(name)
    experiment, result = simulated(tmp_path / name, robot, bump())
    for channel, metric in resimulate(experiment, robot, "commands").metrics.items():
        assert metric.rmse < 1e-7, channel
    metrics = resimulate(experiment, robot, "rotations", horizon=1.0).metrics
    assert np.abs(result.articulations[:, 1:, 0]).max() > 0.02, "the joints behind must bend for this to mean anything"
    assert metrics["position"].rmse < 1e-3
    assert metrics["articulation_yaw"].rmse < 1e-3
    again = resimulate(experiment, robot, "rotations", horizon=1.0).tables["joint_states"][1]
    recorded = experiment.channels["joint_states"]
    for joint in robot.articulation_joints[::2]:
        gap = again[f"{joint}.position"] - recorded[f"{joint}.position"][-len(again[f"{joint}.position"]) :]
        assert np.sqrt(np.mean(gap**2)) < 2e-3, joint
