"""The recordings in ``bags/`` are read, are what the command makes, and stay small."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from artibot_sim.experiment import Experiment, metrics, read_bag
from artibot_sim.experiment import reference_bags as bags
from artibot_sim.model import load_robot
from artibot_sim.planning import load_manoeuvre, plan

FOLDER = Path(__file__).resolve().parents[2] / "bags"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All recordings, made anew."""
    folder = tmp_path_factory.mktemp("bags")
    bags.write_all(folder)
    return folder


def figures(experiment: Experiment, name: str) -> tuple[float, float]:
    """Eqs 31 and 32 of a reference recording."""
    reference = bags.REFERENCES[name]
    planned = plan(load_manoeuvre(reference.manoeuvre), load_robot(reference.robot))
    truth = experiment.channels["ground_truth_odom"]
    driven = truth.t <= planned.duration
    desired = planned.at(truth.t)
    last = [truth["x"][-1], truth["y"][-1]]
    return (
        metrics.yaw_error(truth["yaw"][driven], desired.pose[driven, 2], truth.t[driven]),
        metrics.position_error(last, desired.pose[-1, :2], planned.path_length),
    )


def test_the_folder_holds_what_the_command_makes_and_says_so() -> None:
    assert {path.name for path in FOLDER.iterdir() if path.is_dir()} == set(bags.REFERENCES)
    rows = [line.split("|") for line in (FOLDER / "README.md").read_text().splitlines() if line.startswith("| `")]
    stated = {row[1].strip(" `"): (row[2].strip(), float(row[3]), row[5].strip(" `")) for row in rows}
    assert stated == {name: (ref.robot, bags.KAPPA, bags.COMMAND) for name, ref in bags.REFERENCES.items()}


def test_they_are_small() -> None:
    assert sum(path.stat().st_size for path in FOLDER.rglob("*") if path.is_file()) < 2_000_000


@pytest.mark.parametrize("name", bags.REFERENCES)
def test_what_is_kept_is_what_is_made(name: str, made: Path) -> None:
    kept, new = read_bag(FOLDER / name), read_bag(made / name)
    assert kept.metadata == new.metadata
    assert kept.metadata["robot"] == bags.REFERENCES[name].robot
    assert float(kept.metadata["kappa"]) == bags.KAPPA
    assert set(kept.channels) == set(new.channels)
    # another processor's mathematical functions may round otherwise, and eq. 16's jump makes more of it
    np.testing.assert_allclose(figures(kept, name), figures(new, name), rtol=1e-6)
    for key, channel in kept.channels.items():
        assert channel.t_ns.tolist() == new.channels[key].t_ns.tolist()
        for column in ("x", "y", "yaw"):
            if column in channel:
                np.testing.assert_allclose(channel[column], new.channels[key][column], atol=1e-5, err_msg=key)


@pytest.mark.parametrize("name", bags.REFERENCES)
def test_they_follow_the_contract(name: str) -> None:
    channels = read_bag(FOLDER / name).channels
    assert {"odom", "ground_truth_odom", "joint_states", "motor_torques", "motor_command"} <= set(channels)
    assert {"planned_path", "planned_front_velocity"} <= set(channels)
    assert np.diff(channels["planned_odom"].t).max() <= 0.05 + 1e-9  # 20 Hz or more
    assert np.isfinite(channels["motor_torques"]["back_left.effort"]).all()
    truth = channels["ground_truth_odom"]
    assert abs(truth["vx"][-1]) < 1e-3  # it stands at the end


def test_making_them_again_gives_the_same_bytes_and_replaces_what_is_there(made: Path, tmp_path: Path) -> None:
    stale = tmp_path / "table6_agriq" / "stale.txt"
    stale.parent.mkdir()
    stale.write_text("an older recording")
    assert bags.main([str(tmp_path)]) == 0
    files = {path.relative_to(made): path.read_bytes() for path in made.rglob("*") if path.is_file()}
    assert {path.relative_to(tmp_path): path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == files
    assert len(files) == 2 * len(bags.REFERENCES)
