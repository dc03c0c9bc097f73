"""Identification: known soils are found whatever pose, heading and clock a recording has; what cannot be is said."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from io import StringIO
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from rich.console import Console

from artibot_sim.cli.identify import command
from artibot_sim.errors import ArtibotError
from artibot_sim.estimation.kinematic import FREE, ideal, kinematic_models
from artibot_sim.estimation.parameters import SOIL, ParameterSet
from artibot_sim.estimation.uncertainty import Distribution
from artibot_sim.experiment import Channel, Experiment, write_channels
from artibot_sim.identify import Effort, FitStatus, Prior, identify, parse_priors
from artibot_sim.identify.judgement import FittedMotion, estimates, open_reason, overall
from artibot_sim.identify.problems import enough_of, problem_of
from artibot_sim.identify.requested import parameter_set
from artibot_sim.identify.result import Estimate, number
from artibot_sim.identify.run import Work
from artibot_sim.identify.synthetic import Noise, random_manoeuvre, synthetic
from artibot_sim.identify.validation import hold_out, late_poses
from artibot_sim.model import Robot, load_robot, save_robot
from artibot_sim.planning import Arc, Dwell, Eight, Manoeuvre, Ramp, Slalom, Stop, Straight
from artibot_sim.report.identification import window_panels

QUICK = Effort(starts=1, finalists=1)
TRUTH = {
    "contact.k_l": 2650.0, "contact.k_t": 2200.0, "contact.mu_s": 0.58, "contact.mu_d": 0.33, "contact.u_w": 0.0075,
}  # fmt: skip
TURNS = Manoeuvre(
    "turns",
    (Dwell(0.5), Ramp(speed=0.6), Slalom(curvature=0.45, wavelength=5.0, periods=1.5),
     Arc(radius=1.6, angle=-2.5), Stop()),
    a_max=0.5,
)  # fmt: skip
STRAIGHT = Manoeuvre("straight", (Dwell(0.5), Ramp(speed=0.6), Straight(length=2.5), Stop()), a_max=0.5)


@pytest.fixture(scope="module")
def real() -> Robot:
    """A rover on a soil that is not the robot file's."""
    return load_robot("agriq").replace(TRUTH)


@pytest.fixture(scope="module")
def found(real: Robot) -> Work:
    """The soil identified from two recordings, another one predicted; no speed of a motor jumps, as in no real one."""
    drive, shares = replace(TURNS, blend=0.3), (0.7, 0.85, 1.0)
    recordings = [synthetic(real, drive, kappa=kappa, seed=k, name=f"run{k}") for k, kappa in enumerate(shares)]
    return identify(recordings[:2], load_robot("agriq"), holdout=recordings[2:], effort=QUICK)


def test_names_are_whole_on_a_narrow_terminal_and_what_is_not_known_is_no_number(found: Work) -> None:
    name = "effects.wheel_radius_mismatch.right"
    first, *others = found.result.estimates
    channels = {key: replace(fit, noise=math.nan) for key, fit in found.result.channels.items()}
    shown = replace(found.result, estimates=(replace(first, name=name), *others), channels=channels)
    out = StringIO()
    Console(file=out, width=80, highlight=False).print(shown)
    assert "wheel_radius_mismatch.right" in out.getvalue()
    assert "nan" not in out.getvalue()
    assert "…" not in out.getvalue().replace(" …", "").replace("… ", ""), "nothing is cut; only intervals have it"
    assert all(number(e.value) in out.getvalue() for e in shown.estimates)
    lines = out.getvalue().splitlines()
    assert all(len(line) <= 80 for line in lines)
    assert sum(e.status.value in line for e in shown.estimates for line in lines) >= len(shown.estimates)
    first_row = next(i for i, line in enumerate(lines) if line.startswith("wheel_radius_mismatch.right"))
    assert lines[first_row + 1].startswith(others[0].name), "a parameter takes one line"
    assert "prior" in str(shown)


def test_a_known_soil_is_found(found: Work) -> None:
    result = found.result
    assert result.status is FitStatus.CONVERGED
    inside = [e.ci95[0] <= TRUTH[e.key] <= e.ci95[1] for e in result.estimates]
    assert sum(inside) >= 4
    for e in result.estimates:
        assert e.value == pytest.approx(TRUTH[e.key], rel=0.04)
        assert e.ci95[0] < e.value < e.ci95[1]
    assert result.channels["yaw_rate"].excess == pytest.approx(1.0, abs=0.15)


def test_the_future_is_predicted(found: Work) -> None:
    """Position five seconds ahead within twice what the total station errs."""
    (prediction,) = found.result.predictions
    assert prediction.windows >= 1
    assert prediction.channels["position"].rmse < 2 * np.sqrt(2) * Noise().station
    assert set(prediction.free_run) >= {"position", "torque_front"}


def test_the_robot_file_is_one(found: Work, tmp_path: Path) -> None:
    save_robot(found.result.robot, tmp_path / "field.yaml")
    again = load_robot(tmp_path / "field.yaml")
    for e in found.result.estimates:
        assert again.as_vector([e.key]) == e.value
        assert again.sources[e.key].startswith("identified: from run0")
        assert again.intervals[e.key] == pytest.approx(e.ci95)
    assert again.sources["front.m"] == load_robot("agriq").sources["front.m"]


def test_it_prints_and_serialises(found: Work) -> None:
    import json

    text = str(found.result)
    assert all(name in text for name in ("k_l", "mu_s", "converged", "position"))
    document = json.loads(json.dumps(found.result.as_dict()))
    assert document["parameters"]["contact.k_l"]["ci95"][0] < document["parameters"]["contact.k_l"]["value"]


def test_the_page_shows_what_was_found(found: Work) -> None:
    from artibot_sim.report.identification import page_of, panels

    page = page_of(found).decode()
    assert all(said in page for said in ("k_l", "run2, held out", "free run", "error of torque front"))
    drawn = {panel.key for panel in panels(found)}
    assert {"run2_path", "run2_position", "run0_torque_back_fitted"} <= drawn
    for panel in panels(found):
        assert any(np.isfinite(line.y).any() for line in panel.lines)


def test_the_command_writes_its_files(real: Robot, tmp_path: Path) -> None:
    drive = synthetic(real, TURNS, kappa=0.7, seed=8, duration=8.0)
    tables = {key: (channel.t_ns, dict(channel.columns)) for key, channel in drive.channels.items()}
    write_channels(tmp_path / "run", tables, {**drive.metadata, "robot": "epiq"})
    names = {"--out": "soil.yaml", "--json": "soil.json", "--report": "soil.html"}
    wanted = [word for option, name in names.items() for word in (option, str(tmp_path / name))]
    given = [str(tmp_path / "run"), "--robot", "agriq", "--fit", "k_t", *wanted]
    done = CliRunner().invoke(command, given, catch_exceptions=False)
    assert done.exit_code == 0
    assert load_robot(tmp_path / "soil.yaml").contact.k_t != load_robot("agriq").contact.k_t
    assert "k_t" in done.output and "recorded with robot 'epiq', and is taken for 'agriq'" in done.output
    assert (tmp_path / "soil.json").stat().st_size > 100
    assert (tmp_path / "soil.html").stat().st_size > 10_000
    assert (tmp_path / "soil.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("folder", ["no", "/proc"])
def test_the_command_refuses_before_the_work(tmp_path: Path, folder: str) -> None:
    given = [str(tmp_path / "absent"), "--robot", "agriq", "--out", str(tmp_path / folder / "soil.yaml")]
    with pytest.raises(ArtibotError, match="cannot be written"):
        CliRunner().invoke(command, given, catch_exceptions=False)


def test_pose_heading_and_clock_do_not_matter(real: Robot) -> None:
    """The same drive elsewhere, in another direction, at another time of day: the same soil, within its interval."""
    values = []
    for start, ns in (((0.0, 0.0, 0.0), 10**9), ((250.0, -40.0, 2.6), 1_700_000_000 * 10**9)):
        drive = synthetic(real, TURNS, kappa=0.7, seed=5, start=start, start_ns=ns)
        values.append(identify([drive], load_robot("agriq"), fit=["k_t", "mu_d"], effort=QUICK).result)
    for a, b in zip(values[0].estimates, values[1].estimates, strict=True):
        assert a.value == pytest.approx(b.value, rel=0.02)


def test_a_part_of_the_parameters(real: Robot) -> None:
    """The rest keeps its value; geometry is fitted as well as soil, under its prior."""
    nominal = real.replace({"contact.k_t": 1800.0, "back.l": 1.05})
    drive = synthetic(real, TURNS, kappa=0.7, seed=2)
    work = identify([drive], nominal, fit=["k_t", "back.l"], priors={"back.l": Prior(1.05, 0.15)}, effort=QUICK)
    assert work.result["k_t"].value == pytest.approx(TRUTH["contact.k_t"], rel=0.04)
    assert work.result["back.l"].value == pytest.approx(real.back.l, rel=0.03)
    assert work.result.robot.contact.k_l == TRUTH["contact.k_l"]


def test_a_straight_drive_says_nothing_about_sideways_slip(real: Robot) -> None:
    drive = synthetic(real, STRAIGHT, kappa=0.8, seed=3)
    result = identify([drive], load_robot("agriq"), effort=QUICK).result
    assert result.status is FitStatus.NOT_IDENTIFIABLE
    for name in ("k_t", "mu_s", "mu_d"):
        estimate = result[name]
        assert estimate.status is FitStatus.NOT_IDENTIFIABLE
        assert estimate.note
        assert estimate.ci95[0] <= TRUTH[estimate.key] <= estimate.ci95[1]
    assert "slides" in result["mu_d"].note
    assert "hardly turns" in result["k_t"].note


def test_a_bound_is_said(real: Robot) -> None:
    """A prior that excludes the truth: the estimate stands at its bound and says so."""
    drive = synthetic(real, TURNS, kappa=0.7, seed=4)
    priors = {"k_t": Prior(1950.0, 15.0)}
    result = identify([drive], real, fit=["k_t"], priors=priors, effort=QUICK).result
    assert result["k_t"].status is FitStatus.AT_BOUND
    assert result["k_t"].value == pytest.approx(1950.0 * np.exp(5 * 15.0 / 1950.0), rel=1e-3)


GEOMETRY = {
    "wheel.r_w": 0.157,
    "effects.wheel_radius_mismatch.relative": -0.04,
    "effects.pose_lever_arm.x": 0.15,
    "effects.pose_lever_arm.y": 0.03,
    "effects.pose_heading_offset.angle": -0.02,
}


def test_geometry_that_no_data_sheet_has_is_found_beside_the_soil() -> None:
    """Sides of other radius, and a body tracked elsewhere; nothing is said of them. Torques are not recorded."""
    husky = load_robot("husky_driven")
    made = husky.replace({"wheel.r_w": GEOMETRY["wheel.r_w"]})
    for name, value in GEOMETRY.items():
        if name.startswith("effects."):
            _, effect, parameter = name.split(".")
            made = replace(made, effects={**made.effects, effect: {**made.effects.get(effect, {}), parameter: value}})
    drive = synthetic(made, replace(TURNS, blend=0.3), kappa=1.0, seed=1, noise=Noise(heading=0.003))
    motors = drive.channels["motor_torques"]
    speeds = {name: column for name, column in motors.columns.items() if not name.endswith(".effort")}
    drive = replace(drive, channels={**drive.channels, "motor_torques": replace(motors, columns=speeds)})
    result = identify([drive], husky, fit=["soil", "geometry"], window=2.0, effort=QUICK).result
    assert [e.key for e in result.estimates] == [*(f"contact.{name}" for name in SOIL), *GEOMETRY]
    for key, truth in GEOMETRY.items():
        (one,) = (e for e in result.estimates if e.key == key)
        low, high = one.ci95
        assert low - 0.5 * (high - low) <= truth <= high + 0.5 * (high - low), one
        assert high - low < 0.03


def test_what_is_known_of_geometry_goes_before_what_its_group_takes_for_granted() -> None:
    husky = load_robot("husky_driven")
    name, arm = "effects.wheel_radius_mismatch.relative", "effects.pose_lever_arm.x"
    own = parameter_set(husky, ["geometry"], {name: Prior(0.05, 0.01)})
    priors = {one.key: one.prior for one in own.parameters}
    assert priors[name] == Prior(0.05, 0.01)
    assert priors[arm] == Prior(0.0, 0.25 * husky.front.i_y)
    known = replace(husky, effects={"pose_lever_arm": {"x": 0.2, "y": 0.0}})
    assert {one.key: one.prior for one in parameter_set(known, ["geometry"]).parameters}[arm].value == 0.2


def test_nothing_has_no_sign() -> None:
    assert number(-0.0, 3) == number(0.0, 3)


def test_poses_may_be_late_without_a_prior_of_ones_own() -> None:
    (one,) = parameter_set(load_robot("husky"), ["timing"]).parameters
    assert one.key == "effects.pose_delay.delay" and one.prior.value > 0.0 and one.high > 0.5


def test_the_ground_may_resist_wheels_without_a_prior_of_ones_own() -> None:
    husky, name = load_robot("husky"), "effects.wheel_resistance.share"
    (one,) = parameter_set(husky, ["resistance"]).parameters
    assert one.key == name and one.prior.value > 0.0 and one.prior.sd >= one.prior.value
    (known,) = parameter_set(replace(husky, effects={"wheel_resistance": {"share": 0.1}}), ["resistance"]).parameters
    assert known.prior.value == 0.1
    with pytest.raises(ArtibotError, match="twice"):
        parameter_set(husky, ["resistance", name])


def test_inertias_of_a_fit_are_those_of_a_body() -> None:
    """None exceeds the sum of the other two: alone it ends there, and where all are fitted every place is a robot."""
    husky = load_robot("husky_driven")
    (one,) = parameter_set(husky, ("front.J_z",)).parameters
    assert one.high == pytest.approx(husky.front.J_x + husky.front.J_y)
    every = parameter_set(husky, ("front.J_x", "front.J_y", "front.J_z"))
    for coordinates in np.random.default_rng(0).normal(0.0, 1.5, (200, 3)):
        front = every.candidate(every.inside(coordinates)).front
        least, middle, most = sorted((front.J_x, front.J_y, front.J_z))
        assert most <= (least + middle) * (1.0 + 1e-9)


def _judged(mu_s: float, mu_d: float, fit: tuple[str, ...] = ("mu_s", "mu_d")) -> dict[str, Estimate]:
    """Estimates of a fit that ended at these values, whose curvature alone would let mu_d go to twice as much."""
    parameters = parameter_set(load_robot("agriq"), fit)
    value = {"mu_s": mu_s, "mu_d": mu_d}
    at = np.log([value[p.name] / p.prior.value for p in parameters.parameters])
    wide = np.array([np.log(2.0) if p.name == "mu_d" else 0.01 for p in parameters.parameters])
    spread = Distribution(at, np.diag(np.full(len(at), 1e-4)), at - 0.01, at + wide)
    motion = FittedMotion(sliding=0.2, grip=0.6, turning=0.3, torques=True)
    found = estimates(parameters, parameters.coordinates(np.exp(at) * _middles(parameters)), spread, spread, motion)
    return {estimate.name: estimate for estimate in found}


def _middles(parameters: ParameterSet) -> np.ndarray:
    return np.array([p.prior.value for p in parameters.parameters])


def test_a_parameter_at_another_ones_value_says_so() -> None:
    """mu_d cannot exceed mu_s: where both are the same it is not converged, nor can its interval reach beyond."""
    at, below = _judged(0.43, 0.43), _judged(0.43, 0.35)
    assert at["mu_d"].status is FitStatus.AT_BOUND
    assert "stands at mu_s, 0.43" in at["mu_d"].note
    assert at["mu_d"].ci95[0] <= at["mu_d"].value <= at["mu_d"].ci95[1] <= at["mu_s"].ci95[1]
    assert at["mu_s"].status is FitStatus.CONVERGED
    assert below["mu_d"].status is FitStatus.CONVERGED
    alone = _judged(0.43, load_robot("agriq").contact.mu_s, ("mu_d",))  # mu_s, not fitted, gives way to it
    assert alone["mu_d"].status is FitStatus.CONVERGED


def _with_gaps(drive: Experiment) -> Experiment:
    """Motors silent for 0.3 s, articulation held for three samples each, jitter, few positions."""
    channels = dict(drive.channels)
    motors, joint, station = (channels[key] for key in ("motor_torques", "joint_states", "total_station"))
    channels["motor_torques"] = _rows(motors, (motors.t < 6.0) | (motors.t > 6.3))
    held = joint["articulation_yaw.position"][(np.arange(len(joint)) // 3) * 3]
    channels["joint_states"] = replace(joint, columns={"articulation_yaw.position": held})
    channels["total_station"] = _rows(station, np.arange(len(station)) % 2 == 0)
    del channels["imu"]
    return replace(drive, channels=channels)


def _rows(channel: Channel, kept: np.ndarray) -> Channel:
    columns = {name: values[kept] for name, values in channel.columns.items()}
    return replace(
        channel, t_ns=channel.t_ns[kept], t=channel.t[kept], received_ns=channel.received_ns[kept], columns=columns
    )


def test_gaps_held_samples_and_rates(real: Robot) -> None:
    drive = _with_gaps(synthetic(real, TURNS, kappa=0.7, seed=6, noise=Noise(jitter=0.001, motor_rate=80.0)))
    result = identify([drive], load_robot("agriq"), fit=["k_t", "mu_d"], effort=QUICK).result
    assert result["k_t"].value == pytest.approx(TRUTH["contact.k_t"], rel=0.15)
    assert any("yaw_rate" in remark for remark in result.remarks)


@pytest.mark.parametrize(
    ("fit", "priors", "said"),
    [
        (["k_x"], {}, "no parameter"),
        (["contact.mus"], {}, "did you mean 'mu_s'"),
        (["geomtry"], {}, "did you mean 'geometry'"),
        (["effects.slop.grade"], {}, "unknown effect, did you mean 'slope'"),
        (["k_l", "contact.k_l"], {}, "twice"),
        ([], {}, "nothing named"),
        (["k_l"], {"k_t": Prior(1.0, 0.1)}, "not fitted"),
    ],
)
def test_wrong_parameters_are_refused(real: Robot, fit: list[str], priors: dict, said: str) -> None:
    drive = synthetic(real, STRAIGHT, duration=3.0)
    with pytest.raises(ArtibotError, match=said):
        identify([drive], real, fit=fit, priors=priors)


def test_an_effect_can_be_fitted_that_the_robot_does_not_have() -> None:
    """It begins at its prior's middle, and its other parameters are neutral."""
    key = "effects.pose_lever_arm.x"
    found = parameter_set(load_robot("husky"), ("k_l", key), {key: Prior(0.1, 0.05)})
    assert found.robot.effects["pose_lever_arm"] == {"x": 0.1, "y": 0.0}
    moved = found.robot_at(found.coordinates([1200.0, 0.2]))
    assert moved.as_vector(["contact.k_l", key]) == pytest.approx([1200.0, 0.2])


def test_a_rigid_rover_starts_no_faster_than_its_wheels() -> None:
    """A jump of the first pose looks like a speed that no wheel makes."""
    husky = load_robot("husky")
    t = np.arange(0.0, 2.0, 0.05)
    x = 0.165 * 3.0 * t
    x[0] -= 0.4
    pose = Channel("/ground_truth/odom", *_stamps(t), {"x": x, "y": 0.0 * t, "yaw": 0.0 * t})
    angle = {f"{m}.velocity": np.full(len(t), 3.0) for m in ("front_right", "front_left")}
    motors = Channel("/motor_torques", *_stamps(t), angle)
    jumped = Experiment(
        "jump", Path("jump"), {}, 0, {"motor_torques": motors, "ground_truth_odom": pose}, ((0.0, t[-1]),)
    )
    start = problem_of([jumped], parameter_set(husky, ("k_l",)), 2.0, 1).starts[0]
    assert abs(start[3]) < 1.11 * 0.165 * 3.0
    assert np.abs(start[4:6]).max() < 0.06


def test_separate_windows_that_are_predicted_worst_are_named() -> None:
    """Twenty-four straight drives of 2 s; in the sixth the measured position leaps by half a metre."""
    starts = 3.0 * np.arange(24)
    t = np.concatenate([start + np.arange(0.0, 2.01, 0.05) for start in starts])
    x = 0.165 * 3.0 * (t - 3.0 * np.floor(t / 3.0))
    x[(t > starts[5] + 1.0) & (t < starts[6])] += 0.5
    pose = Channel("/ground_truth/odom", *_stamps(t), {"x": x, "y": 0.0 * t, "yaw": 0.0 * t})
    angle = {f"{m}.velocity": np.full(len(t), 3.0) for m in ("front_right", "front_left")}
    channels = {"motor_torques": Channel("/motor_torques", *_stamps(t), angle), "ground_truth_odom": pose}
    segments = tuple((float(start), float(start + 2.0)) for start in starts)
    husky, leap = load_robot("husky"), Experiment("leap", Path("leap"), {}, 0, channels, segments)
    held = hold_out(leap, husky, 2.0, rivals={name: ideal(husky) for name in ("ideal", *FREE)})
    position = held.summary.outliers[0]
    assert position.startswith("the worst 1 of 24 windows hold 100 % of the squared error of position")
    assert "0.50 at 15 s*" in position
    assert held.summary.outliers[-1].startswith("*: measured positions leap")
    drawn = {panel.key: panel for panel in window_panels(held)}
    windows = ["leap_typical", "leap_bad", "leap_worst"]
    assert list(drawn) == ["leap_position_ends", "leap_yaw_ends", *windows, "leap_wheels"]
    assert "0.50 m off" in drawn["leap_worst"].title or "50." in drawn["leap_worst"].title
    assert {line.name for line in drawn["leap_position_ends"].lines} == {"ideal", *FREE, "this model"}
    worst = drawn["leap_worst"].lines[0]  # all begin at one place, so there is no map of them
    assert np.nanmax(worst.x) - np.nanmin(worst.x) == pytest.approx(
        0.165 * 3.0 * 1.95 + 0.5
    )  # the first sample is the start
    assert np.allclose(drawn["leap_wheels"].lines[0].x, 3.0, atol=0.01)


@pytest.mark.parametrize("heading", [0.01, None], ids=["poses", "points"])
def test_no_model_begins_where_another_one_led(heading: float | None) -> None:
    """What kinematic models predict of a recording in one piece is the same whatever stands beside them."""
    husky = load_robot("husky")
    made = random_manoeuvre(np.random.default_rng(5), 12.0)
    drive = synthetic(husky, made, noise=Noise(heading=heading), seed=5, duration=12.0)
    rivals = {"ideal": ideal(husky), "slow": replace(ideal(husky), scale=0.9)}
    beside = [husky, husky.replace({"contact.k_t": 100.0, "wheel.r_w": 0.9 * husky.wheel.r_w})]
    one, other = (hold_out(drive, robot, 2.0, rivals=rivals).summary for robot in beside)
    assert one.final["position"].rmse < 0.5 * other.final["position"].rmse
    assert one.rivals == other.rivals


@pytest.mark.parametrize("delay", [0.0, 0.3])
def test_poses_that_a_kinematic_model_has_late_are_said_to_be(delay: float) -> None:
    """By as much as they are; nothing is said of poses in time."""
    husky = load_robot("husky_driven")
    late = replace(husky, effects={"pose_delay": {"delay": delay}} if delay else {})
    made = random_manoeuvre(np.random.default_rng(5), 40.0)
    drive = synthetic(late, made, noise=Noise(heading=0.01), seed=5, duration=40.0)
    rivals = kinematic_models(problem_of([drive], parameter_set(husky), 2.0, 1))
    said = late_poses([hold_out(drive, husky, 2.0, rivals=rivals).summary], rivals)
    assert len(said) == (1 if delay else 0)
    for sentence in said:
        (found,) = re.findall(r"poses (\S+) s later than rotations; add timing to --fit", sentence)
        assert float(found) == pytest.approx(delay, abs=0.03)


def _stamps(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    stamps = np.round(t * 1e9).astype(np.int64)
    return stamps, t, stamps


def test_of_a_long_recording_windows_in_turn_are_fitted_and_that_is_said(real: Robot) -> None:
    """Windows as evenly spread as all are, at most as long together as was asked for; all where they are not more."""
    problem = problem_of([synthetic(real, TURNS)], parameter_set(real), 0.5, 1)
    seconds = float(problem.durations.sum())
    few, (said,) = enough_of(problem, seconds / 3.5)
    assert 0.8 * seconds / 3.5 < float(few.durations.sum()) <= seconds / 3.5 + 0.5
    steps = {int(b - a) for a, b in pairwise(problem.windows.index(window) for window in few.windows)}
    assert steps <= {3, 4}, "evenly"
    assert said.startswith(f"{len(few)} of {len(problem)} windows were fitted")
    assert enough_of(problem) == (problem, [])


def test_a_recording_without_positions_is_refused(real: Robot) -> None:
    drive = synthetic(real, STRAIGHT, duration=3.0)
    blind = replace(drive, channels={k: c for k, c in drive.channels.items() if k != "total_station"})
    with pytest.raises(ArtibotError, match="/total_station/point"):
        identify([blind], real)


def test_what_is_fitted_to_is_not_held_out(real: Robot) -> None:
    drive = synthetic(real, STRAIGHT, duration=3.0)
    with pytest.raises(ArtibotError, match=r"given twice; .*--holdout-share"):
        identify([drive], real, holdout=[drive])


def test_each_parameter_that_stays_open_has_a_reason_of_its_own() -> None:
    """Rolling resistance and a lever arm are no scale of forces, and torques would not tell a lever arm."""
    blind = FittedMotion(sliding=0.5, grip=0.6, turning=0.3, torques=False)
    reasons = {key: open_reason(key, blind) for key in ("contact.k_l", "contact.u_w", "effects.pose_lever_arm.x")}
    assert len(set(reasons.values())) == 3
    assert "common scale" in reasons["contact.k_l"] and "torques" not in reasons["effects.pose_lever_arm.x"]
    found = [
        Estimate(key, key, "-", 1.0, (0.5, 2.0), (0.5, 2.0), (0.5, 2.0), (1.0, 0.4), FitStatus.NOT_IDENTIFIABLE, reason)
        for key, reason in reasons.items()
    ]
    _, message = overall(found, True, "", 0.0)
    assert all(reason in message for reason in reasons.values())


def test_what_has_either_sign_is_found_with_either_sign(real: Robot) -> None:
    """A tracked point behind the origin, of which nothing is known beforehand but about how far it is."""
    key, truth = "effects.pose_lever_arm.x", -0.11
    drive = synthetic(replace(real, effects={"pose_lever_arm": {"x": truth}}), TURNS, kappa=0.7, seed=8)
    result = identify([drive], real, fit=["k_t", key], priors={key: Prior(0.0, 0.15)}, effort=QUICK).result
    assert result[key].value == pytest.approx(truth, abs=0.015)
    assert result[key].ci95[0] < result[key].value < result[key].ci95[1] < 0.0


@pytest.mark.long
def test_ground_that_is_stiffer_than_supposed_is_found_with_its_law() -> None:
    """Forces by slip ratio make the ground three times as stiff at low speed, where longer steps would chatter."""
    plain, key = load_robot("agriq"), "effects.slip_ratio.exponent"
    robot = replace(plain, effects={"slip_ratio": {"exponent": 0.7}})
    eights = [Eight(radius=r, smooth=True, end_speed=0.0) for r in (2.0, 2.5)]
    drives = [
        synthetic(
            robot,
            Manoeuvre("eights", (Dwell(1.0), *(replace(e, speed=v) for e in eights)), a_max=0.5, blend=0.3),
            duration=40.0, seed=seed, name=f"at {v:g} m/s",
        )
        for seed, v in enumerate((0.2, 0.4, 0.8))
    ]  # fmt: skip
    result = identify(drives, plain, fit=[*SOIL, key], priors={key: Prior(0.9, 0.3)}, window=5.0, effort=QUICK).result
    truth = {key: 0.7} | {f"contact.{name}": plain.as_vector([f"contact.{name}"])[0] for name in SOIL}
    for name, value in truth.items():
        low, high = result[name].ci95
        assert low - 0.5 * (high - low) < value < high + 0.5 * (high - low), (name, value, result[name])
    assert result[key].ci95[1] < 0.75


def test_signed_values_and_their_coordinates_are_inverse() -> None:
    key = "effects.pose_lever_arm.x"
    found = parameter_set(load_robot("husky"), ("k_l", key), {key: Prior(0.0, 0.15)})
    values = np.array([1200.0, -0.3])
    assert found.values(found.coordinates(values)) == pytest.approx(values)
    assert found.values(np.zeros(2))[1] == 0.0
    assert found.parameters[1].low < -0.5
    assert found.parameters[1].high > 0.5
    assert found.at_bound(found.coordinates([1200.0, found.parameters[1].low])) == [False, True]


def test_priors_are_read() -> None:
    assert parse_priors(["front.i_y=0.72±0.03", "k_l=3000+-500"]) == {
        "front.i_y": Prior(0.72, 0.03), "k_l": Prior(3000.0, 500.0),
    }  # fmt: skip
    for text in ("k_l", "k_l=1", "k_l=1±-2", "=1±2"):
        with pytest.raises(ArtibotError, match="MIDDLE±SD"):
            parse_priors([text])
