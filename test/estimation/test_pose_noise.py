"""Noise of poses: a constant, and what stamps that jitter add with speed, each found from the recording itself."""

from __future__ import annotations

import numpy as np
import pytest
from bag_helpers import foreign
from estimation.logger import Drive, Logger, drive, recorded, robot_of

from artibot_sim.estimation.measurements import noise_levels, stretches
from artibot_sim.estimation.pose_noise import pose_noise
from artibot_sim.estimation.windows import cut
from artibot_sim.experiment import Experiment, read_bag
from artibot_sim.experiment.measured import Measured
from artibot_sim.model import Robot, load_robot

PLACE, HEADING = 0.01, 0.005
"""m and rad: the constants of the logger's poses."""
SCATTER = np.sqrt(4.0 / 2.0)
"""Standard deviation of a Student distribution with four degrees of freedom."""


def logged(jitter: float, seed: int, polled: float = 0.0) -> tuple[Robot, Drive, Experiment]:
    rng = np.random.default_rng(seed)
    robot = robot_of(rng)
    done = drive(robot, rng)
    scatter = {"ground_truth_odom": jitter} if jitter else {}
    return robot, done, recorded(done, Logger(polled=polled, jitter=scatter), rng)


def found_in(experiment: Experiment):
    return pose_noise([Measured(experiment, a, b) for a, b in experiment.segments])


@pytest.mark.parametrize("seed", range(4))
def test_constant_and_jitter_are_told_apart(seed: int) -> None:
    """The jitter is as large as the middle of its distribution says; its tails do not widen the constants."""
    for jitter in (0.02, 0.03):
        found = found_in(logged(jitter, seed)[2])
        assert found.jitter == pytest.approx(1.1 * jitter, rel=0.35)
        assert found.place == pytest.approx(PLACE, rel=0.4)
        assert found.heading == pytest.approx(HEADING, rel=0.6)


@pytest.mark.parametrize("polled", [0.0, 20.0])
@pytest.mark.parametrize("seed", range(3))
def test_stamps_that_are_right_or_polled_show_no_jitter(seed: int, polled: float) -> None:
    found = found_in(logged(0.0, 10 + seed, polled)[2])
    assert found.jitter == 0.0
    assert found.place == pytest.approx(PLACE, rel=0.2)


def test_residuals_of_the_truth_are_of_unit_size_slow_and_fast() -> None:
    """Every sample's own standard deviation is what it is off by, whether the robot creeps or rushes."""
    robot, done, experiment = logged(0.03, 2)
    (stretch,) = stretches(experiment, robot)
    truth = dict(zip(("position", "yaw"), (done.pose[:, :2], done.pose[:, 2:]), strict=True))
    for channel in ("position", "yaw"):
        sizes, rates = [], []
        for column, series in enumerate(s for s in stretch.series if s.channel == channel):
            true = truth[channel][:, column]
            sizes.append(np.abs(np.interp(series.t, done.t, true) - series.value) / series.spread)
            rates.append(np.abs(np.interp(series.t, done.t, np.gradient(true, done.t))))
        size, rate = np.concatenate(sizes), np.concatenate(rates)
        for rows in (rate < np.quantile(rate, 0.3), rate > np.quantile(rate, 0.7)):
            assert 1.4826 * np.median(size[rows]) == pytest.approx(1.0, abs=0.35)


def test_windows_weigh_fast_samples_less_and_levels_stay_apart() -> None:
    robot, _, experiment = logged(0.03, 2)
    found = stretches(experiment, robot)
    windows = cut(found, robot, 4.0)
    place = np.concatenate([w.sigma[w.channel == 0] for w in windows])
    assert place.max() > 2.0 * place.min() >= 2.0 * 0.6 * PLACE
    assert all(np.array_equal(w.sigma, w.sensor) for w in windows)
    assert noise_levels(found)["position"] > next(s.sigma for s in found[0].series if s.channel == "position")
    robot, _, steady = logged(0.0, 2)
    (stretch,) = stretches(steady, robot)
    for series in stretch.series:
        assert not series.timing.any()


@pytest.mark.parametrize(("name", "least", "most"), [("husky_drive_a", 0.02, 0.04), ("warthog_gravel", 0.03, 0.08),
                                                     ("optiodom_diff_1", 0.0, 0.0)])  # fmt: skip
def test_real_poses(name: str, least: float, most: float) -> None:
    """Lidar poses jitter by hundredths of a second; motion capture that was resampled does not."""
    found = found_in(read_bag(foreign(f"real/{name}")))
    assert least <= found.jitter <= most


def test_too_few_samples_say_nothing() -> None:
    robot = load_robot("husky_driven")
    rng = np.random.default_rng(1)
    experiment = recorded(drive(robot, rng, 20.0), Logger(), rng)
    assert pose_noise([Measured(experiment, 2.0, 4.0)]) is None
