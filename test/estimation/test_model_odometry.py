"""Odometry through the model: right where the model is, better than wheels, and never astray by bad samples."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from report_helpers import recording
from scipy.stats import chi2

from artibot_sim.cli import main
from artibot_sim.errors import ArtibotError
from artibot_sim.estimation.model_odometry import ModelOdometry, StreamProperties
from artibot_sim.estimation.odometry import Slip
from artibot_sim.estimation.odometry_check import (
    ENOUGH,
    OdometrySettings,
    OdometryWindow,
    fitted_sides,
    fitted_track,
    gyro_bias,
    heading_walk,
    pieces,
    remarks,
    repeatability,
    windows_for_covariance,
)
from artibot_sim.experiment import read_bag, write_experiment
from artibot_sim.model import Commands, Mode, Robot, Rollout, State, load_robot, rollout
from artibot_sim.model.simulate.rollout import Status
from artibot_sim.model.simulate.stepper import PrescribedStepper
from artibot_sim.planning import load_manoeuvre, plan
from artibot_sim.resources import config_names

BAG = Path(__file__).parents[2] / "bags/table6_agriq"

RATE = 50.0


@pytest.fixture(scope="module", params=["agriq", "husky"])
def run(request: pytest.FixtureRequest) -> Rollout:
    return driven(load_robot(request.param))


def driven(robot: Robot, manoeuvre: str = "spiral") -> Rollout:
    """The first half, in which it turns to one side: errors of the heading do not make up for each other."""
    commands = plan(load_manoeuvre(manoeuvre), robot).commands()
    return rollout(robot, commands, every=20, duration=round(0.5 * commands.duration, 1))


def samples(result: Rollout) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, motor positions and speeds at 50 Hz."""
    motors = slice(0, 4 if result.robot.articulated else 2)
    return result.t, result.motor_position[:, motors], result.motor_velocity[:, motors]


def error(odometry: ModelOdometry, result: Rollout, row: int = -1) -> np.ndarray:
    found = np.array(odometry.pose) - result.pose[row]
    found[2] = math.remainder(found[2], math.tau)
    return found


def normalised(odometry: ModelOdometry, result: Rollout) -> float:
    found = error(odometry, result)
    return float(found @ np.linalg.solve(odometry.pose_covariance, found))


def test_with_the_right_robot_it_ends_where_the_rover_does(run: Rollout) -> None:
    odometry = ModelOdometry(run.robot)
    for t, position, velocity in zip(*samples(run), strict=True):
        odometry.update(t, position, velocity)
    way = np.abs(np.diff(run.pose[:, :2], axis=0)).sum()
    assert np.hypot(*error(odometry, run)[:2]) < 0.01 * way
    assert abs(error(odometry, run)[2]) < 0.02
    assert odometry.t == pytest.approx(run.t[-1])
    assert not odometry.remarks


def test_speeds_alone_will_do(run: Rollout) -> None:
    odometry = ModelOdometry(run.robot)
    for t, _, velocity in zip(*samples(run), strict=True):
        odometry.update(t, (), velocity)
    assert abs(error(odometry, run)[2]) < 0.03


BAD = {
    "held": "held sample",
    "nan": "sample without a number",
    "one motor": "",
    "reset": "jump of a rotation",
    "late": "sample not later than the one before",
    "spike": "",
}


@pytest.mark.parametrize("what", BAD)
def test_bad_samples_neither_lead_it_astray_nor_stay(run: Rollout, what: str) -> None:
    """A fifth of all samples, resets of the counter every two seconds; each is counted, and the pose stays a number."""
    odometry, rng = ModelOdometry(run.robot), np.random.default_rng(3)
    offset, last = 0.0, None
    for t, position, velocity in zip(*samples(run), strict=True):
        bad = t > 1.0 and rng.random() < (0.01 if what == "reset" else 0.2)
        position, velocity = position + offset, velocity.copy()
        if bad and what == "nan":
            position, velocity = position * math.nan, velocity * math.inf
        elif bad and what == "one motor":
            position[1], velocity[0] = math.nan, math.nan
        elif bad and what == "held" and last is not None:
            position, velocity = last
        elif what == "reset" and bad:
            position, offset = position - position, offset - position.max()
        elif bad and what == "late":
            odometry.update(t - 0.5, position + 3.0, velocity)
        elif bad and what == "spike":
            velocity[:] = 1e9
        odometry.update(t, position, velocity)
        last = (position, velocity)
        assert np.isfinite([*odometry.pose, *odometry.twist]).all()
        assert np.isfinite(odometry.pose_covariance).all()
    assert abs(error(odometry, run)[2]) < 0.1
    if BAD[what]:
        assert odometry.remarks[BAD[what]] > (3 if what == "reset" else 10)


def test_over_a_gap_it_knows_that_it_does_not_know(run: Rollout) -> None:
    odometry = ModelOdometry(run.robot)
    half = run.t[-1] / 2
    sure = 0.0
    for t, _, velocity in zip(*samples(run), strict=True):
        if not half < t < half + 2.0:
            odometry.update(t, (), velocity)
        if t <= half:
            sure = float(np.trace(odometry.pose_covariance))
    assert odometry.remarks["gap"] == 1
    assert np.trace(odometry.pose_covariance) > 2.0 * sure
    assert normalised(odometry, run) < chi2.ppf(0.9999, 3)


def test_a_clock_that_is_set_back_begins_anew_where_it_was() -> None:
    run = driven(load_robot("husky"))
    odometry = ModelOdometry(run.robot)
    t, position, velocity = samples(run)
    for row in range(len(t)):
        odometry.update(t[row], position[row], velocity[row])
    before = odometry.pose
    odometry.update(t[0], position[0], velocity[0])
    assert odometry.pose == before
    for row in range(1, 100):
        odometry.update(t[row], position[row], velocity[row])
    assert odometry.t == pytest.approx(t[99])
    moved = np.hypot(*(np.array(odometry.pose) - before)[:2])
    assert moved == pytest.approx(np.hypot(*run.pose[99, :2]), abs=0.02)


def test_delays_of_streams_are_taken_back() -> None:
    run = driven(load_robot("husky"))
    late = ModelOdometry(run.robot, streams=StreamProperties(rotation_delay=0.2))
    for t, position, velocity in zip(*samples(run), strict=True):
        late.update(t + 0.2, position, velocity)
    assert late.t == pytest.approx(run.t[-1])
    assert abs(error(late, run)[2]) < 0.02


@pytest.mark.parametrize("sign", [1.0, -1.0], ids=["upright", "upside-down"])
def test_a_gyroscope_rules_the_heading_and_shows_its_bias_at_rest(sign: float) -> None:
    """The model's ground is another than the rover's; the gyroscope has a bias, is late, and may be upside down."""
    run = driven(load_robot("husky"))
    other = run.robot.replace({"contact.mu_s": 0.5, "contact.mu_d": 0.3, "contact.k_t": 600.0})
    other = replace(other, sensors=replace(other.sensors, gyro_flip=float(sign < 0.0)))
    rng, wheels = np.random.default_rng(1), ModelOdometry(other)
    streams = StreamProperties(gyro_delay=0.04)
    odometry = ModelOdometry(other, streams=streams)
    for t in np.arange(-5.0, 0.0, 0.02):  # it stands first
        odometry.update(t, (0.0, 0.0), (0.0, 0.0))
        odometry.take_gyro(t + 0.04, sign * (0.008 + 0.01 * rng.standard_normal()))
    rate = run.twist[:, 2]
    for row, (t, position, velocity) in enumerate(zip(*samples(run), strict=True)):
        odometry.take_gyro(t + 0.04, sign * (rate[row] + 0.008 + 0.01 * rng.standard_normal()))
        odometry.update(t, position, velocity)
        wheels.update(t, position, velocity)
    assert abs(odometry.gyro.bias - 0.008) < 2.5 * odometry.gyro.deviation < 0.003
    assert abs(error(odometry, run)[2]) < 2.5 * math.sqrt(odometry.pose_covariance[2, 2]) < 0.15
    assert abs(error(odometry, run)[2]) < 0.3 * abs(error(wheels, run)[2])


@pytest.mark.long
def test_errors_of_other_soils_are_within_what_it_states() -> None:
    """The rover's soil differs from the model's by 12 %; the slip that is stated is what that makes of turns."""
    robot, bound = load_robot("husky"), float(chi2.ppf(0.95, 3))
    within = []
    for seed in range(12):
        k_l, k_t, mu_d = np.exp(0.12 * np.random.default_rng(seed).standard_normal(3)).tolist()
        soil = {"contact.k_l": k_l * robot.contact.k_l, "contact.k_t": k_t * robot.contact.k_t}
        run = driven(robot.replace(soil | {"contact.mu_d": min(mu_d * robot.contact.mu_d, robot.contact.mu_s)}))
        odometry = ModelOdometry(robot, Slip(0.01, 0.06, 0.01))
        for t, position, velocity in zip(*samples(run), strict=True):
            odometry.update(t, position, velocity)
        within.append(normalised(odometry, run) <= bound)
    assert np.mean(within) >= 0.9


@pytest.mark.long
def test_the_command_measures_it_beside_wheels(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of a turn that slips, a track that was fitted elsewhere knows less than half of what the model knows."""
    robot = load_robot("husky")
    for name in ("slalom", "table6_agriq"):
        planned = plan(load_manoeuvre(name), robot)
        write_experiment(tmp_path / name, rollout(robot, planned.commands()), planned, robot)
    words = ["odometry", str(tmp_path / "slalom"), "--fit", str(tmp_path / "table6_agriq"), "--window", "5"]
    assert main([*words, "--json", str(tmp_path / "table.json")]) == 0
    assert "wheels, nominal track" in capsys.readouterr().out
    table = json.loads((tmp_path / "table.json").read_text())["odometry"]
    heading = {name: row["heading_rms"]["value"] for name, row in table.items()}
    fitted = next(value for name, value in heading.items() if "fitted" in name)
    assert heading["model"] < 0.5 * fitted < 0.5 * heading["wheels, nominal track"]
    assert main(["odometry", "--fit", str(tmp_path / "slalom")]) == 2


def test_a_recording_of_another_robot_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    """The wheels of a robot without gears would have rolled forty times as far as the rover went."""
    assert main(["odometry", str(BAG), "--robot", "husky"]) == 2
    assert "give the right robot with --robot" in capsys.readouterr().err


def test_what_too_few_windows_tell_is_left_out(capsys: pytest.CaptureFixture[str]) -> None:
    """A recording of a single nearly straight window."""
    assert main(["odometry", str(BAG), "--robot", "agriq"]) == 0
    said = capsys.readouterr().out
    assert "for the node" in said
    assert "nan" not in said and "straight" not in said


def test_a_heading_s_walk_is_that_of_sides_on_grounds_of_their_own() -> None:
    """Turns and the constant error of unequal wheels are no part of it."""
    rng, track, walk, way = np.random.default_rng(3), 0.5, 0.03, 2.0
    found = []
    for number in range(400):
        turn = 1.2 if number % 2 else 0.01
        sides = np.array([[0.0, 0.0], [way + 0.5 * track * turn, way - 0.5 * track * turn]])
        yaw = turn + 0.02 * way + walk * math.sqrt(way) * rng.standard_normal() + (number % 2) * rng.standard_normal()
        found.append(OdometryWindow(0.0, 1.0, sides, np.array([way, 0.0, yaw]), {}, {}))
    size, straight = heading_walk(found, track)
    assert straight == 200
    assert size == pytest.approx(walk, rel=0.2)
    assert math.isnan(heading_walk(found[:4], track)[0])


def test_a_gyroscope_s_bias_is_said_where_windows_tell_it_surely() -> None:
    rng = np.random.default_rng(5)

    def windows(bias: float, noise: float) -> list[OdometryWindow]:
        sides = np.array([[0.0, 0.0], [10.0, 10.0]])
        return [
            OdometryWindow(0.0, 20.0, sides, np.zeros(3), {"model and gyro": np.array([0.0, 0.0, 20.0 * rate])}, {})
            for rate in bias + noise * rng.standard_normal(30)
        ]

    assert gyro_bias(windows(-0.015, 0.005)) == pytest.approx(-0.015, abs=0.004)
    assert gyro_bias(windows(0.0, 0.005)) is None
    assert gyro_bias(windows(0.002, 0.0001)) is None, "as much as gyroscopes have"
    assert gyro_bias(windows(-0.015, 0.005)[:3]) is None


def test_sides_that_differ_are_said_where_the_model_does_not_know_of_them() -> None:
    robot, rng, ratio = load_robot("husky"), np.random.default_rng(6), -0.05
    found, track = [], 0.9
    for turn in rng.normal(0.0, 2.0, 30):
        sides = np.array([[0.0, 0.0], [5.0 + 0.5 * track * turn, 5.0 - 0.5 * track * turn]])
        bare = OdometryWindow(0.0, 10.0, sides, np.zeros(3), {}, {})
        found.append(replace(bare, truth=bare.wheels(track, ratio), model={"model": bare.wheels(track)}))
    fitted = fitted_sides(found, robot)
    assert fitted == pytest.approx((track, ratio), rel=0.01)
    (said,) = (text for text in remarks(found, found, robot, track, fitted) if "sides differ" in text)
    assert "differ by -0.05," in said and "--fit soil,geometry" in said
    knows = replace(robot, effects={"wheel_radius_mismatch": {"relative": ratio}})
    assert not any("sides differ" in text for text in remarks(found, found, knows, track, fitted))


def test_how_well_driving_alike_repeats_is_said_of_windows_in_a_row() -> None:
    """Turns that differ are no pairs; what the track says of small differences is none of it."""
    rng, track, spread, way = np.random.default_rng(4), 0.5, 0.05, 2.0
    found = []
    for number in range(900):
        turn = (0.8, 0.81, -0.5)[number % 3]
        sides = np.array([[0.0, 0.0], [way + 0.5 * track * turn, way - 0.5 * track * turn]])
        yaw = turn + (spread if number % 3 < 2 else 1.0) * rng.standard_normal()
        found.append(OdometryWindow(0.0, 1.0, sides, np.array([way, 0.0, yaw]), {}, {}))
    size, pairs = repeatability(found, track)
    assert pairs == 300
    assert size == pytest.approx(0.6745 * spread, rel=0.15)
    assert math.isnan(repeatability(found[:30], track)[0])


def test_poses_of_a_segment_say_nothing_of_the_next_though_they_are_late(tmp_path: Path) -> None:
    """Each segment of 2 s has a frame of its own; poses half a second late reach beyond its end."""
    robot, delay, speed = load_robot("husky"), 0.5, 1.0
    t = np.concatenate([3.0 * k + np.arange(0.0, 2.0, 0.05) for k in range(6)])
    place = speed * t + 50.0 * np.floor(t / 3.0)
    turns = {f"{side}.velocity": np.full(len(t), speed / robot.wheel.r_w) for side in ("front_right", "front_left")}
    late = {"x": place - speed * delay, "y": 0.0 * t, "yaw": 0.0 * t}
    path = recording(tmp_path / "run", {"motor_torques": (t, turns), "ground_truth_odom": (t, late)}).path
    found = pieces(read_bag(path), robot, OdometrySettings(pose_delay=delay))
    assert len(found) == 6
    for one in found:
        assert one.end - one.begin == pytest.approx(2.0 - delay, abs=0.11)
        assert one.truth == pytest.approx((speed * (one.end - one.begin), 0.0, 0.0), abs=1e-6)


def test_covariances_are_fitted_on_windows_enough() -> None:
    """Of three windows of 10 m the 95 % quantile is the largest, by chance; of 20 shorter ones it is not."""
    experiment, robot, settings = read_bag(BAG), load_robot("agriq"), OdometrySettings()
    found = pieces(experiment, robot, settings)
    assert len(found) < ENOUGH
    short = windows_for_covariance(experiment, robot, settings, found)
    assert ENOUGH - 1 <= len(short) <= ENOUGH + 1
    assert sum(one.rolled for one in short) == pytest.approx(sum(one.rolled for one in found), rel=0.05)
    first = windows_for_covariance(experiment, robot, settings, found[:1])
    assert all(one.end <= found[0].end for one in first) and len(first) > 1
    assert windows_for_covariance(experiment, robot, settings, short) is short


def test_windows_that_follow_each_other_keep_the_motion_under_way() -> None:
    """An articulated rover's joint is bent where a window begins: put there straight, it turned by 1.4 rad a radian."""
    robot = load_robot("agriq")
    found = pieces(read_bag(BAG), robot, OdometrySettings(length=5.0))
    track = fitted_track(found, robot)
    by_wheels, by_model = (
        float(
            np.median(
                [abs(math.remainder(end[2] - one.truth[2], math.tau)) for one, end in zip(found, ends, strict=True)]
            )
        )
        for ends in ([one.wheels(track) for one in found], [one.model["model"] for one in found])
    )
    assert len(found) >= 6
    assert by_model < 0.5 * by_wheels and by_model < 0.005


def test_a_train_is_refused_by_name() -> None:
    train = next(robot for name in config_names("robots") if len((robot := load_robot(name)).modules) > 2)
    with pytest.raises(ArtibotError, match=f"'{train.name}'.* one or two"):
        ModelOdometry(train)


@pytest.mark.parametrize("back_seen", [True, False], ids=["all", "front"])
@pytest.mark.parametrize("name", [name for name in config_names("robots") if len(load_robot(name).modules) < 3])
def test_it_turns_the_model_as_a_rollout_does_to_the_bit(
    monkeypatch: pytest.MonkeyPatch, name: str, back_seen: bool
) -> None:
    robot, seen, turn = load_robot(name), [], PrescribedStepper.turn

    def beside(stepper: PrescribedStepper, width: float, velocity: np.ndarray, position: np.ndarray) -> Status:
        before = stepper.state
        found = turn(stepper, width, velocity, position)
        expected = rollout(
            stepper.robot, Commands(width, velocity, position), dt=width / math.ceil(width / stepper.step - 1e-9),
            integrator=stepper.integrator, modes=[Mode.PRESCRIBED] * 4 if back_seen or not robot.articulated else None,
            state=before,
        ).final_state  # fmt: skip
        assert expected is not None
        seen.append(bits(stepper.state) == bits(expected))
        return found

    monkeypatch.setattr(PrescribedStepper, "turn", beside)
    odometry = ModelOdometry(robot)
    fast = 4.0 / (robot.wheel.r_w * robot.drive.front.tau * 10.0)
    for i in range(100):
        speeds = fast * np.array([1.0, 0.8 - 0.4 * math.sin(0.1 * i), 1.0, 0.9])
        assert odometry.update(0.02 * i, (), speeds[: 4 if back_seen else 2]) or not i
    assert len(seen) == 100 and all(seen)
    assert not odometry.remarks


def bits(state: State) -> bytes:
    """All of a state but its time."""
    return b"".join(one.tobytes() for one in (state.q, state.v, state.eta, state.torque, state.behind, state.memory))


def test_tyres_that_relax_are_followed_at_any_speed() -> None:
    """What wheels remember wants shorter steps the faster they turn."""
    robot = replace(load_robot("husky"), effects={"tyre_relaxation": {"length": 0.005}})
    odometry = ModelOdometry(robot)
    for i in range(50):
        odometry.update(0.02 * i, (), (30.0 + 0.01 * i, 28.0))  # the same twice would be a held sample
    assert np.isfinite(odometry.pose).all() and odometry.pose[0] > 1.0
    assert not odometry.remarks
