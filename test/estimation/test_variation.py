"""A parameter's spread from window to window: found where it is, not where noise alone is large or heavy-tailed."""

import numpy as np
import pytest

from artibot_sim.estimation.variation import Distances, ParameterSpread, Windows, correlation_of, spread_of

COUNT = 24
"""Samples of a window."""


def windows(seed, spread, noise, number=160, size=0.6):
    """Windows with samples r = J delta + e, noise e of size `noise` (number,) and delta normal of width `spread`."""
    rng = np.random.default_rng(seed)
    J = size * rng.standard_normal((number, COUNT)) * rng.uniform(0.3, 1.5, (number, 1))
    r = J * spread * rng.standard_normal((number, 1)) + noise[:, None] * rng.standard_normal((number, COUNT))
    return Windows((J * J).sum(axis=1), (J * r).sum(axis=1), (r * r).sum(axis=1), np.full(number, float(COUNT)))


def heavy(seed, number=160):
    """Noise that is several times as large in some windows as in others."""
    return 1.0 / np.sqrt(np.random.default_rng(seed).gamma(2.0, 0.5, number))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("spread", [0.8, 3.0])
def test_a_spread_is_found(seed, spread):
    found = spread_of(windows(seed, spread, np.ones(160)))
    assert found.spread == pytest.approx(spread, rel=0.25)
    assert found.nats > 20.0
    assert found.gained(windows(seed + 100, spread, np.ones(160))).sum() > 20.0


@pytest.mark.parametrize("noise", [lambda seed: np.ones(160), lambda seed: np.full(160, 3.0), heavy])
def test_noise_of_any_size_is_no_spread(noise):
    """Half of the likelihood ratio of one more parameter at its bound: more than 3 nats in 0.7 % of cases."""
    gained = [spread_of(windows(seed, 0.0, noise(seed))).nats for seed in range(30)]
    assert np.mean(np.array(gained) > 3.0) <= 0.1


def test_a_middle_elsewhere_is_no_spread():
    """A common shift of the coordinate is the middle's, whatever the fit says."""
    one = windows(3, 0.0, np.ones(160))
    moved = Windows(one.information, one.gradient + 2.0 * one.information, one.squares + 4.0 * one.gradient
                    + 4.0 * one.information, one.counts)  # fmt: skip
    first, second = spread_of(one), spread_of(moved)
    assert second.nats == pytest.approx(first.nats, abs=0.1)
    assert second.shift == pytest.approx(first.shift - 2.0, abs=0.02)


T = 4.0 * np.arange(80)
PLACE = np.column_stack([6.0 * np.cos(0.31 * T), 4.0 * np.sin(0.17 * T)])
"""A drive that comes back to where it was."""
FAR = Distances.of(np.repeat([0, 1], 80), np.tile(T, 2), np.tile(PLACE, (2, 1)))


def with_values(seed, correlation):
    """Windows of two recordings in which a parameter has values of width 1 with this correlation; and their spread."""
    rng = np.random.default_rng(seed)
    value = np.linalg.cholesky(correlation + 1e-9 * np.eye(160)) @ rng.standard_normal(160)
    J = 0.3 * rng.standard_normal((160, COUNT))
    r = J * value[:, None] + rng.standard_normal((160, COUNT))
    seen = Windows((J * J).sum(axis=1), (J * r).sum(axis=1), (r * r).sum(axis=1), np.full(160, float(COUNT)))
    return seen, ParameterSpread(1.0, 1.0, 0.0, 0.0, (1.0, 0.0))


@pytest.mark.parametrize(("over", "length"), [("time", 40.0), ("place", 3.0), ("recording", np.inf)])
def test_where_values_are_alike_is_found(over, length):
    away = getattr(FAR, over)
    correlation = (away == 0.0).astype(float) if over == "recording" else np.exp(-away / length)
    lengths = []
    for seed in range(6):
        seen, spread = with_values(seed, correlation)
        found = correlation_of(seen, FAR, spread)
        if found is not None and found.nats > 6.0 and found.over == over:
            lengths.append(found.length)
            later, _ = with_values(seed + 100, correlation)
            assert over == "recording" or found.gained(later, FAR, spread).sum() > 0.0
    assert len(lengths) >= 5
    assert over == "recording" or length / 2.0 < np.median(lengths) < 2.0 * length


def test_values_of_their_own_are_not_alike():
    found = [correlation_of(*(lambda one: (one[0], FAR, one[1]))(with_values(seed, np.eye(160)))) for seed in range(20)]
    assert sum(one is not None and one.nats > 6.0 for one in found) == 0


def test_likelihood_integrates_over_the_value():
    """The closed form is the integral over the window's own value of the likelihood with it."""
    from scipy.integrate import quad
    from scipy.stats import norm

    one = windows(5, 1.0, np.ones(160), number=1)
    # of normal noise; the tails' likelihood is compared by its squares alone
    h, g, s = one.information[0], one.gradient[0], one.squares[0]
    spread = 0.7
    inside, _ = quad(
        lambda d: np.exp(-0.5 * (2 * g * d + h * d * d)) * norm.pdf(d, scale=spread), -8, 8, points=[-g / h]
    )
    wider = 1.0 + spread**2 * h
    assert np.log(inside) == pytest.approx(-0.5 * np.log(wider) + 0.5 * spread**2 * g**2 / wider, rel=1e-6)
    tails = 4.0
    left = s - spread**2 * g**2 / wider
    wanted = one.log_likelihood(0.0, 1.0, 0.0) + 0.5 * (tails + COUNT) * (np.log1p(s / tails) - np.log1p(left / tails))
    assert one.log_likelihood(spread, 1.0, 0.0) == pytest.approx(wanted - 0.5 * np.log(wider), rel=1e-9)
