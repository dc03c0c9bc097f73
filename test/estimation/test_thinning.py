"""How many samples are worth one: the value of known noise, and no jump between fits that end close to each other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnose.turns import TURNS
from scipy.signal import lfilter

from artibot_sim.estimation.loss import correlation_time, thinning
from artibot_sim.estimation.windows import Window
from artibot_sim.identify.problems import problem_of
from artibot_sim.identify.requested import parameter_set
from artibot_sim.identify.synthetic import synthetic
from artibot_sim.model import load_robot

ROBOT = load_robot("agriq")
COUNT, LENGTH = 40, 400


@pytest.fixture(scope="module")
def windows() -> list[Window]:
    """Windows with one channel of many samples."""
    like = problem_of([synthetic(ROBOT, TURNS, kappa=0.8, seed=6)], parameter_set(ROBOT), 3.0, 1).windows[0]
    kind = np.zeros(LENGTH, np.int64)
    plan = type(like.plan)(np.arange(LENGTH) * 0.01, kind)
    one = replace(like, plan=plan, value=np.zeros(LENGTH), sigma=np.ones(LENGTH), channel=kind)
    return [one] * COUNT


def coloured(shared: float, seed: int = 0) -> list[np.ndarray]:
    """Noise of unit variance whose autocorrelation falls by the factor `shared` from sample to sample."""
    rng, found = np.random.default_rng(seed), []
    for _ in range(COUNT):
        driving = np.sqrt(1.0 - shared**2) * rng.standard_normal(LENGTH)
        driving[0] = rng.standard_normal()
        found.append(lfilter([1.0], [1.0, -shared], driving))
    return found


@pytest.mark.parametrize("shared", [-0.5, 0.0, 0.4, 0.8])
def test_of_known_noise_it_is_the_known_number(windows: list[Window], shared: float) -> None:
    """(1 + rho) / (1 - rho) where neighbours err alike; noise that alternates is worth no more than white noise."""
    expected = max(1.0, (1.0 + shared) / (1.0 - shared))
    found = np.mean([thinning(windows, coloured(shared, seed))[0] for seed in range(3)])
    assert found == pytest.approx(expected, rel=0.1)


def test_windows_that_are_not_explained_hardly_count(windows: list[Window]) -> None:
    residuals = coloured(0.4)
    before = thinning(windows, residuals)[0]
    for one in residuals[:6]:
        one += 3.5
    assert thinning(windows, residuals)[0] == pytest.approx(before, rel=0.05)


def test_between_two_fits_it_goes_evenly(windows: list[Window]) -> None:
    """From one set of residuals to another, in small steps: no step changes it by much more than the one before."""
    a, b = coloured(0.7, 1), coloured(0.7, 2)
    b[0] += 2.0
    path = [thinning(windows, [np.cos(x) * p + np.sin(x) * q for p, q in zip(a, b, strict=True)])[0]
            for x in np.linspace(0.0, 0.5 * np.pi, 151)]  # fmt: skip
    assert np.ptp(path) > 0.2
    assert np.abs(np.diff(path, 2)).max() < 0.01


def test_a_time_that_vanishes_does_so_continuously() -> None:
    """An autocorrelation that touches zero for a moment, a little above and a little below it."""
    slow = np.exp(-np.arange(40) / 20.0)

    def touching(level: float) -> float:
        return correlation_time(np.where(np.isin(np.arange(40), (8, 9)), level, slow))

    assert touching(1e-6) == pytest.approx(touching(-1e-6), abs=1e-4)
    assert touching(0.2) > touching(0.1) > touching(0.0)
