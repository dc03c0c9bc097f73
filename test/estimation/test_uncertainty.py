"""Intervals of a mixture of normal distributions are those of draws from it."""

from __future__ import annotations

import numpy as np
import pytest

from artibot_sim.estimation.uncertainty import mixture


@pytest.mark.parametrize("apart", [0.0, 1.0, 6.0])
def test_moments_and_intervals_of_a_mixture_are_those_of_its_draws(apart):
    rng = np.random.default_rng(7)
    weight = np.array([0.2, 0.5, 0.3])
    means = apart * np.array([[-1.0, 0.5], [0.0, 0.0], [1.0, 1.5]])
    covariances = np.array([[[1.0, 0.3], [0.3, 0.5]], [[0.5, 0.0], [0.0, 1.0]], [[2.0, -0.4], [-0.4, 0.4]]])
    spread = mixture(weight, means, covariances)

    which = rng.choice(3, size=200_000, p=weight)
    noise = np.einsum("kij,kj->ki", np.linalg.cholesky(covariances)[which], rng.standard_normal((len(which), 2)))
    drawn = means[which] + noise
    sd = drawn.std(axis=0)
    np.testing.assert_allclose(spread.mean, drawn.mean(axis=0), atol=0.02 * sd.max())
    np.testing.assert_allclose(spread.covariance, np.cov(drawn.T), atol=0.02 * sd.max() ** 2)
    if apart == 0.0:  # where means differ, each also stands for the path around it
        np.testing.assert_allclose([spread.low, spread.high], np.quantile(drawn, [0.025, 0.975], axis=0), rtol=0.02)
    else:
        low, high = np.quantile(drawn, [0.025, 0.975], axis=0)
        assert (spread.low <= low + 0.05 * sd).all() and (spread.high >= high - 0.05 * sd).all()
