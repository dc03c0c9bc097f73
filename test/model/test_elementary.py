"""Elementary functions of the model against exact ones."""

from __future__ import annotations

import math

import numpy as np
import pytest
from mpmath import mp

from artibot_sim.model.kernels import elementary
from artibot_sim.model.kernels.compilation import kernel

mp.prec = 200


@kernel
def _roots(x, out):
    for i in range(x.shape[0]):
        out[i] = elementary.inverse_root(x[i])


@kernel
def _logarithms(x, out):
    for i in range(x.shape[0]):
        out[i] = elementary.log(x[i])


@kernel
def _every(x, sine, cosine, exp, tanh):
    for i in range(x.shape[0]):
        sine[i], cosine[i] = elementary.sincos(x[i])
        exp[i], tanh[i] = elementary.exp(x[i]), elementary.tanh(x[i])


def of(x):
    """Sine, cosine, exponential and hyperbolic tangent of an array."""
    out = [np.empty(len(x)) for _ in range(4)]
    _every(np.asarray(x, dtype=float), *out)
    return out


def errors(found, function, x):
    """In units of the last place of the exact value."""
    exact = [function(mp.mpf(float(a))) for a in x]
    return np.array([abs(float((f - e) / mp.mpf(math.ulp(float(e))))) for f, e in zip(found, exact, strict=True)])


@pytest.fixture(scope="module")
def numbers():
    rng = np.random.default_rng(0)
    size = 10.0 ** rng.uniform(-12, 2, 3000)
    return np.concatenate([rng.choice([-1.0, 1.0], 3000) * size, np.linspace(-20, 20, 2001)])


def test_exponential_and_tangent_are_exact_to_two_rounding_errors(numbers):
    _, _, exp, tanh = of(numbers)
    assert errors(exp, mp.exp, numbers).max() < 1.5
    assert errors(tanh, mp.tanh, numbers).max() < 2.5


def test_logarithm_is_exact_to_two_rounding_errors():
    rng = np.random.default_rng(4)
    near = 1.0 + rng.choice([-1.0, 1.0], 2000) * 10.0 ** rng.uniform(-15, -0.5, 2000)
    x = np.concatenate([10.0 ** rng.uniform(-300, 300, 2000), near, [1.0, 2.0, 0.5, math.sqrt(2.0)]])
    found = np.empty(len(x))
    _logarithms(x, found)
    away = x != 1.0
    assert errors(found[away], mp.log, x[away]).max() < 2.5
    assert (found[~away] == 0.0).all()


def test_sine_and_cosine_are_exact_to_rounding(numbers):
    sine, cosine, _, _ = of(np.concatenate([numbers, 1e4 * numbers / 100.0]))
    x = np.concatenate([numbers, 1e4 * numbers / 100.0])
    for found, function in ((sine, mp.sin), (cosine, mp.cos)):
        exact = np.array([float(function(mp.mpf(float(a)))) for a in x])
        np.testing.assert_allclose(found, exact, rtol=0, atol=4e-16)


def test_far_out_and_special_numbers():
    sine, cosine, exp, tanh = of([0.0, math.nan, -1e9, -720.0, 720.0, math.inf, -math.inf])
    assert (sine[0], cosine[0], exp[0], tanh[0]) == (0.0, 1.0, 1.0, 0.0)
    assert np.isnan([sine[1], cosine[1], exp[1], tanh[1]]).all()
    assert exp[2] < 1e-300 and exp[3] < 1e-300 and exp[6] < 1e-300
    assert exp[4] > 1e300 and exp[5] > 1e300
    np.testing.assert_array_equal(tanh[2:], [-1.0, -1.0, 1.0, 1.0, -1.0])


def test_quadrants_join():
    """Around whole multiples of a quarter turn, where the reduction changes over."""
    x = (np.arange(-40, 41)[:, None] * math.pi / 4 + np.array([-1e-9, 0.0, 1e-9])).ravel()
    sine, cosine, _, _ = of(x)
    np.testing.assert_allclose(sine, np.sin(x), rtol=0, atol=3e-16)
    np.testing.assert_allclose(cosine, np.cos(x), rtol=0, atol=3e-16)


def test_inverse_roots_to_rounding() -> None:
    x = 10.0 ** np.random.default_rng(0).uniform(-30.0, 37.0, 20000)
    found = np.empty_like(x)
    _roots(x, found)
    np.testing.assert_allclose(found, 1.0 / np.sqrt(x), rtol=5e-16)
