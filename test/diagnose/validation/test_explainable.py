"""How much is explainable: what repeats is learned from other recordings, and of noise alone nothing is."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from artibot_sim.diagnose.records import LAST_THIRD
from artibot_sim.diagnose.validation.explainable import explainable, folds, model_of
from artibot_sim.errors import ArtibotError
from artibot_sim.estimation.boosting import Boosted
from artibot_sim.estimation.residual_model import ResidualModel
from artibot_sim.experiment import Experiment, read_bag, write_experiment
from artibot_sim.experiment.resimulate import resimulate
from artibot_sim.identify.synthetic import synthetic
from artibot_sim.identify.validation import hold_out
from artibot_sim.model import Commands, Robot, load_robot, rollout
from artibot_sim.nodes.replay.resimulate import with_residual
from artibot_sim.planning import Dwell, Eight, Manoeuvre

EIGHT = Manoeuvre("eight", (Dwell(0.5), Eight(radius=1.8, smooth=True, speed=0.6)), a_max=0.5, blend=0.3)
HORIZON = 4.0


def drives(robot: Robot) -> list[Experiment]:
    return [synthetic(robot, EIGHT, seed=seed, name=f"run{seed}", duration=25.0) for seed in range(3)]


@pytest.fixture(scope="module")
def tilted() -> list[Experiment]:
    """The same eight three times on a slope, with other noise."""
    pytest.importorskip("sklearn")
    level = load_robot("agriq")
    return drives(replace(level, effects={"slope": {"grade": 0.06, "heading": 1.0}}))


def noise_of(recordings: list[Experiment], robot: Robot) -> dict[str, float]:
    return {name: fit.noise for name, fit in hold_out(recordings[0], robot, HORIZON).summary.channels.items()}


@pytest.mark.long
def test_a_model_of_level_ground_could_be_much_better_on_a_slope(tilted: list[Experiment]) -> None:
    robot = load_robot("agriq")
    held = [hold_out(one, robot, HORIZON) for one in tilted]
    found, _ = explainable(held, robot, noise_of(tilted, robot), 0)
    position = found["position"]
    assert position.better and position.learned < 0.6 * position.model
    assert position.model > 3.0 * position.noise
    assert "yaw" not in found  # only points are measured, no heading


@pytest.mark.long
def test_what_was_learned_mends_a_simulation_of_a_recording_that_it_never_saw(tmp_path: Path) -> None:
    """Headings are measured here; one that comes from the course over ground has taken in a part of what is missing."""
    pytest.importorskip("sklearn")
    level = load_robot("agriq")
    tilted = replace(level, effects={"slope": {"grade": 0.06, "heading": 1.0}})
    recordings = []
    for k, share in enumerate((0.8, 0.72, 0.76)):
        commands = winding(share)
        path = write_experiment(tmp_path / f"run{k}", rollout(tilted, commands), None, tilted, commands=commands)
        recordings.append(read_bag(path))
    held = [hold_out(one, level, HORIZON) for one in recordings[:2]]
    _, some = explainable(held, level, noise_of(recordings, level), 0)
    model = model_of(some, held, level, HORIZON, 0)
    plain = resimulate(recordings[2], level, "rotations", horizon=HORIZON)
    mended = with_residual(plain, model)
    for channel in ("position", "yaw"):
        assert mended.metrics[channel].rmse < 0.7 * plain.metrics[channel].rmse
    assert mended.metrics["articulation_yaw"].rmse == pytest.approx(plain.metrics["articulation_yaw"].rmse, rel=1e-6)
    assert "no cause is claimed" in mended.remarks[-1]


def test_where_no_heading_is_measured_nothing_is_corrected() -> None:
    robot = load_robot("agriq")
    plain = resimulate(synthetic(robot, EIGHT, seed=0, name="points", duration=6.0), robot, "rotations", horizon=2.0)
    trees = np.zeros((3, 0, 1), np.int64)
    adds_nothing = Boosted(np.zeros(3), trees, trees.astype(float), trees, trees, trees.astype(float))
    model = ResidualModel(adds_nothing, (0, 1, 2, 3), robot.name, 2.0)
    with pytest.raises(ArtibotError, match="points measures no heading"):
        with_residual(plain, model)


def winding(share: float) -> Commands:
    """Left and right turns of 6 s, the inner wheels at this share of the outer ones' speed."""
    t = np.arange(0.0, 36.0, 0.01)
    velocity = np.full((len(t), 4), np.nan)
    side = 0.5 * (1.0 + np.tanh(4.0 * np.sin(2.0 * np.pi * t / 12.0)))
    fast = 100.0 * np.minimum(t / 2.0, 1.0)
    velocity[:, 0], velocity[:, 1] = fast * (share + (1 - share) * side), fast * (1.0 - (1 - share) * side)
    return Commands(0.01, velocity)


@pytest.mark.long
def test_where_nothing_is_hidden_nothing_better_is_said_to_be_possible() -> None:
    pytest.importorskip("sklearn")
    robot = load_robot("agriq")
    recordings = drives(robot)
    held = [hold_out(one, robot, HORIZON) for one in recordings]
    found, _ = explainable(held, robot, noise_of(recordings, robot), 0)
    assert not found["position"].better
    assert found["position"].model < 2.0 * found["position"].noise


def test_folds_are_recordings_and_blocks_of_a_single_one() -> None:
    assert folds(("a", "b", "c"), (2, 1, 2)).tolist() == [0, 0, 1, 2, 2]
    blocks = folds(("a", f"a{LAST_THIRD}"), (12, 6))
    assert len(set(blocks.tolist())) == 5 and (np.diff(blocks) >= 0).all()
    many = folds([f"run{k}" for k in range(12)], [3] * 12)
    assert len(set(many.tolist())) <= 5 and all(len(set(many[i : i + 3])) == 1 for i in range(0, 36, 3))
