"""Kinks of sampled positions: found where a speed jumps, nowhere else, and fitted on either side."""

from __future__ import annotations

import numpy as np
import pytest

from artibot_sim.experiment.smoothing import fit_around_kinks, kinks, local_fit

COUNT = 2 * np.pi / 2048
HALF_WIDTH = 0.04


def encoder(t: np.ndarray, jumps: dict[float, float]) -> np.ndarray:
    """Angles (rad) of a motor whose speed changes smoothly about 60 rad/s and jumps at some times (s)."""
    angle = 60.0 * t + 12.0 * np.sin(0.9 * t)
    for at, change in jumps.items():
        angle = angle + change * np.maximum(t - at, 0.0)
    return np.round(angle / COUNT) * COUNT


@pytest.fixture
def t() -> np.ndarray:
    stamps = np.arange(0.0, 8.0, 0.01)
    return stamps + 2e-4 * np.random.default_rng(1).standard_normal(len(stamps))


def test_jumps_are_placed_to_a_few_milliseconds(t: np.ndarray) -> None:
    jumps = {1.2345: 8.0, 3.71: -15.0, 5.0: 4.0}
    assert kinks(t, encoder(t, jumps)) == pytest.approx(list(jumps), abs=0.003)


def test_a_smooth_motion_has_none(t: np.ndarray) -> None:
    braked = encoder(t, {}) - 20.0 * (np.maximum(t - 6.0, 0.0) ** 2 - np.maximum(t - 7.0, 0.0) ** 2)  # no jump of speed
    assert not len(kinks(t, encoder(t, {})))
    assert not len(kinks(t, np.round(braked / COUNT) * COUNT))
    assert not len(kinks(t, np.zeros(len(t))))


def test_speeds_beside_a_jump_are_those_of_their_own_side(t: np.ndarray) -> None:
    y, at = encoder(t, {3.0: 10.0}), np.arange(2.9, 3.1, 0.01) + 0.004
    true = 60.0 + 10.8 * np.cos(0.9 * at) + 10.0 * (at > 3.0)
    across = local_fit(t, y, at, HALF_WIDTH)
    _, rate = fit_around_kinks(t, y, at, HALF_WIDTH)
    assert np.abs(across[1] - true).max() > 3.0
    assert np.abs(rate - true).max() < 0.4


def test_without_a_jump_nothing_changes(t: np.ndarray) -> None:
    y, at = encoder(t, {}), np.arange(0.5, 7.0, 0.01)
    across = local_fit(t, y, at, HALF_WIDTH)
    assert all(np.array_equal(a, b) for a, b in zip(fit_around_kinks(t, y, at, HALF_WIDTH), across, strict=True))
