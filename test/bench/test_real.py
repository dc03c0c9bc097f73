"""Models judged on real recordings: on a robot whose truth is known each model finds what it can know, and no more."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bag_helpers import FOREIGN
from click.testing import CliRunner

from artibot_sim.bench import real
from artibot_sim.bench.real import RecordingPart, RobotOnGround
from artibot_sim.errors import ArtibotError
from artibot_sim.estimation.kinematic import FREE, Kinematic, driven_windows, fit_kinematic, kinematic_models
from artibot_sim.experiment import Experiment, read_bag, write_channels, write_experiment
from artibot_sim.identify.problems import problem_of
from artibot_sim.identify.requested import parameter_set
from artibot_sim.identify.validation import deviations, kinematic_residuals
from artibot_sim.model import Commands, Rollout, load_robot, rollout

ROBOT = load_robot("husky_driven")
TRUTH = Kinematic(ROBOT.wheel.r_w, 1.1, 0.8, 0.1, 0.12)


def written(folder: Path, name: str, seed: int, duration: float = 120.0, leap_at: float | None = None) -> None:
    """A recording of a robot that moves as TRUTH does, at random commands of 4 s, by a logger at 20 Hz."""
    rng = np.random.default_rng(seed)
    fine = np.arange(0.0, duration, 0.01)
    target = rng.uniform(-4.0, 5.0, (int(duration / 4.0) + 1, 2))[(fine // 4.0).astype(int)]
    speed = np.empty_like(target)
    now = np.zeros(2)
    for i, wanted in enumerate(target):
        now = now + 0.01 / 0.3 * (wanted - now)
        speed[i] = now
    forward, left, turn = replace(TRUTH, delay=0.0).rates(speed).T
    yaw = np.cumsum(turn) * 0.01
    x = np.cumsum(np.cos(yaw) * forward - np.sin(yaw) * left) * 0.01
    y = np.cumsum(np.sin(yaw) * forward + np.cos(yaw) * left) * 0.01
    t = np.arange(1.0, duration, 0.05)
    pose = np.column_stack([np.interp(np.floor(t * 10) / 10 - TRUTH.delay, fine, c) for c in (x, y, yaw)])
    if leap_at is not None:
        pose[t > leap_at, 0] += 5.0
    stamps = np.round(t * 1e9).astype(np.int64)
    wheels = np.column_stack([np.interp(t, fine, c) for c in speed.T])
    write_channels(
        folder / name,
        {
            "motor_torques": (stamps, {"front_right.velocity": wheels[:, 0], "front_left.velocity": wheels[:, 1]}),
            "ground_truth_odom": (stamps, {"x": pose[:, 0], "y": pose[:, 1], "yaw": pose[:, 2]}),
        },
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("real")
    written(made, "one", 1)
    written(made, "two", 2)
    written(made, "leaps", 3, leap_at=63.2)
    return made


def parts(folder: Path, *names: str) -> list[RecordingPart]:
    return real.parts_of(RobotOnGround("made", "husky_driven", names), folder, ROBOT)


def test_each_kinematic_model_finds_on_one_recording_what_predicts_another(folder: Path) -> None:
    one, two = parts(folder, "one", "two")
    errors = {}
    for name, free in FREE.items():
        found = fit_kinematic(one.windows, ROBOT, free)
        errors[name] = np.median(real.errors_of(found(two.windows), two.windows)["position"])
    assert errors["ICR with timing"] < 0.5 * errors["ICR"] < 0.5 * errors["effective track"]
    assert found.track == pytest.approx(TRUTH.track, rel=0.03)
    assert found.scale == pytest.approx(TRUTH.scale, rel=0.03)
    assert found.delay == pytest.approx(TRUTH.delay, abs=0.03)


def test_identify_fits_its_kinematic_models_to_the_ends_as_well(folder: Path) -> None:
    one, two = (real.read_bag(folder / name) for name in ("one", "two"))
    fitted, other = (problem_of([part], parameter_set(ROBOT, ("k_l",)), 2.0, 1) for part in (one, two))
    found = kinematic_models(fitted)
    late = found["ICR with timing"]
    assert late.track == pytest.approx(TRUTH.track, rel=0.03) and late.scale == pytest.approx(TRUTH.scale, rel=0.03)
    assert late.delay == pytest.approx(TRUTH.delay, abs=0.03)
    windows = driven_windows(other)
    errors = {name: np.median(real.errors_of(model(windows), windows)["position"]) for name, model in found.items()}
    assert list(errors) == ["ideal", "effective track", "ICR", "ICR with timing"]
    assert errors["ICR with timing"] < 0.5 * errors["ICR"] < 0.5 * errors["effective track"]
    along_the_path = [
        np.median([deviations(w, r, 0)[1][-1] for w, r in zip(other.windows, residuals, strict=True)])
        for residuals in (kinematic_residuals(model, other, other.starts) for model in found.values())
    ]
    assert along_the_path == pytest.approx(list(errors.values()), rel=0.1, abs=0.003)


def test_a_window_whose_pose_leaps_is_not_judged_and_is_counted(folder: Path) -> None:
    (first, second) = parts(folder, "leaps")
    assert first.leaps + second.leaps == 1
    (first, second) = parts(folder, "one")
    assert first.leaps + second.leaps == 0


def test_halves_share_no_time_and_lose_none(folder: Path) -> None:
    halves = parts(folder, "one")
    spans = sorted(span for half in halves for span in half.experiments[0].segments)
    assert all(a[1] <= b[0] for a, b in zip(spans, spans[1:], strict=False))
    assert sum(b - a for a, b in spans) == pytest.approx(119.0, abs=0.5)
    of = [set(np.round(half.windows.t, 3)) for half in halves]
    assert not of[0] & of[1]
    assert min(map(len, of)) > 0.4 * max(map(len, of))


def test_scores_compare_models_on_the_same_windows(folder: Path) -> None:
    ground = RobotOnGround("made", "husky_driven", ("one", "two"))
    scores = {s.model: s for s in real.judge(ground, folder, ("ideal", "ICR", "ICR with timing"))}
    assert len({score.windows for score in scores.values()}) == 1
    for score in scores.values():
        for error in (score.position, score.yaw):
            assert all(low <= value <= high for value, low, high in error.values())
            assert error["median"][0] <= error["p90"][0]
        kept, reversed_ = (score.turns[name] for name in ("kept", "reversed"))
        both = np.hypot(kept[0] * np.sqrt(kept[1]), reversed_[0] * np.sqrt(reversed_[1])) / np.sqrt(score.windows)
        assert kept[1] + reversed_[1] == score.windows and both == pytest.approx(score.yaw["rmse"][0])
    assert scores["ICR with timing"].against["position median"][2] < 1.0 < scores["ideal"].against["position median"][1]
    assert "| made |" in real.table_of(list(scores.values()))
    assert "| made |" in real.turns_table(list(scores.values()))


def test_a_regressor_predicts_at_least_what_its_base_does(folder: Path) -> None:
    pytest.importorskip("sklearn")
    one, two = parts(folder, "one", "two")
    trees = real.fit_regressor(one.windows, ROBOT)
    base = fit_kinematic(one.windows, ROBOT, FREE["ICR"])
    mine, simple = (real.errors_of(model(two.windows), two.windows)["position"] for model in (trees, base))
    assert np.sqrt(np.mean(mine**2)) < np.sqrt(np.mean(simple**2))


@pytest.fixture(scope="module")
def driven(tmp_path_factory: pytest.TempPathFactory) -> tuple[Experiment, Rollout]:
    """A recording of a simulation whose wheels turn at speeds drawn at random, and the simulation."""
    rng = np.random.default_rng(5)
    knots = np.repeat(rng.uniform(-3.0, 4.0, (12, 2)), 400, axis=0)
    smooth = np.column_stack([np.convolve(np.pad(c, 50, mode="edge"), np.ones(101) / 101, "valid") for c in knots.T])
    commands = Commands(0.01, np.column_stack([smooth, np.full_like(smooth, np.nan)]))
    run = rollout(ROBOT, commands)
    path = tmp_path_factory.mktemp("driven") / "run"
    write_experiment(path, run, None, ROBOT, commands=commands)
    return read_bag(path), run


def test_the_models_own_simulation_is_predicted_from_nothing_but_wheel_speeds(
    driven: tuple[Experiment, Rollout],
) -> None:
    """Windows that start at a measured pose and roll: what slips is left to the model, which is the right one here."""
    experiment, _ = driven
    windows, leaps = real.windows_of(experiment, ROBOT.wheel.r_w)
    rolling = fit_kinematic(windows, ROBOT, FREE["ICR"])
    own = real.errors_of(real.predict_artibot(ROBOT, 0.0, RecordingPart((experiment,), windows), rolling), windows)
    simple = real.errors_of(rolling(windows), windows)
    assert leaps == 0
    assert np.median(own["position"]) < 0.5 * np.median(simple["position"])


@pytest.mark.parametrize("delay", [0.4, -0.3])
def test_where_poses_are_late_the_model_starts_as_much_earlier(
    driven: tuple[Experiment, Rollout], delay: float
) -> None:
    """It then predicts as well as without a delay, and later where rotations are late."""
    experiment, run = driven
    windows, _ = real.windows_of(experiment, ROBOT.wheel.r_w)
    windows = windows[np.flatnonzero(windows.t + windows.length - delay <= run.t[-1])]
    rolling = fit_kinematic(windows, ROBOT, FREE["ICR"])
    pose = np.column_stack([run.pose[:, :2], np.unwrap(run.pose[:, 2])])

    def measured(t: np.ndarray) -> np.ndarray:
        return np.column_stack([np.interp(t - delay, run.t, column) for column in pose.T])

    late = replace(windows, start=measured(windows.t), end=measured(windows.t + windows.length))
    on_time = real.errors_of(real.predict_artibot(ROBOT, 0.0, RecordingPart((experiment,), windows), rolling), windows)
    part = RecordingPart((experiment,), late)
    own, unaware = (real.errors_of(real.predict_artibot(ROBOT, d, part, rolling), late) for d in (delay, 0.0))
    assert np.median(own["position"]) < 1e-3 + np.median(on_time["position"])
    assert np.median(own["position"]) < 0.1 * np.median(unaware["position"])


def test_absent_data_is_said(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(real.DATA, raising=False)
    with pytest.raises(ArtibotError, match=f"--data FOLDER, or {real.DATA}"):
        real.data_folder(None)
    with pytest.raises(ArtibotError, match="no such folder"):
        real.data_folder(tmp_path / "nothing")
    monkeypatch.setenv(real.DATA, str(folder))
    assert real.data_folder(None) == folder
    found, said = real.usable(folder, ())
    assert not found and len(said) == len(real.GROUNDS) and "husky_deflated" in said[0]
    with pytest.raises(ArtibotError, match="none of the recordings"):
        CliRunner().invoke(real.command, ["--data", str(folder)], catch_exceptions=False)


REAL = Path(os.environ.get(real.DATA) or FOREIGN / "real")


@pytest.mark.parametrize(
    ("name", "rmse", "median", "p90"),
    [
        ("husky_deflated", 0.039, 0.026, 0.060),
        pytest.param("warthog_gravel", 1.40, 0.80, 2.25, marks=pytest.mark.long),
        pytest.param("husky_drive_a", 0.23, 0.16, 0.37, marks=pytest.mark.long),
    ],
)
def test_three_parameters_leave_on_real_recordings_what_an_independent_analysis_found(
    name: str, rmse: float, median: float, p90: float
) -> None:
    if not (REAL / name).exists():
        pytest.skip(f"{REAL / name} is not there: recordings of real robots are no part of the project")
    ground = next(g for g in real.GROUNDS if name in g.recordings)
    (score,) = real.judge(ground, REAL, ("ICR",))
    assert score.position["rmse"][0] == pytest.approx(rmse, rel=0.12)
    assert score.position["median"][0] == pytest.approx(median, rel=0.15)
    assert score.position["p90"][0] == pytest.approx(p90, rel=0.12)


def test_what_stamps_were_shifted_by_is_in_the_predicting_robot() -> None:
    """Only how much later poses are than rotations matters, be it fitted or taken off the stamps."""
    for effects, shifts, delay in (
        ({}, {"rotation_delay": -0.14, "pose_delay": -0.26}, 0.12),
        ({"pose_delay": {"delay": 0.26}}, {"rotation_delay": -0.14}, 0.12),
        ({}, {"rotation_delay": -0.2}, -0.2),
        ({}, {"gyro_delay": 0.17}, 0.0),
    ):
        robot, late = real.as_recorded(replace(ROBOT, effects=effects), shifts)
        assert late == pytest.approx(delay) and "pose_delay" not in robot.effects
