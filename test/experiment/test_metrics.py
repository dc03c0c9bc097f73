"""Eqs 31 and 32, radii and lengths: by their properties."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment.measured import dead_reckon
from artibot_sim.experiment.metrics import fit_circle, path_length, position_error, radius, yaw_error

numbers = st.floats(-100, 100)
angles = st.floats(-math.pi, math.pi)


def arc(x: float, y: float, r: float, start: float, sweep: float, n: int = 60) -> tuple[np.ndarray, np.ndarray]:
    phi = start + np.linspace(0, sweep, n)
    return x + r * np.cos(phi), y + r * np.sin(phi)


@given(st.floats(-0.9, 3), st.floats(0.1, 2), st.integers(5, 200))
def test_yaw_error_of_a_scaled_yaw_is_its_scale(error: float, rate: float, n: int) -> None:
    t = np.cumsum(np.random.default_rng(n).uniform(0.01, 0.1, n))
    gamma_d = rate * (t - t[0]) ** 2
    assert yaw_error((1 + error) * gamma_d, gamma_d, t) == pytest.approx(error, abs=1e-12)


def test_yaw_error_is_an_integral_over_time_not_over_samples() -> None:
    t = np.concatenate([np.linspace(0, 5, 5000), np.linspace(5, 10, 11)[1:]])
    assert yaw_error(1.1 * t + 0.5, t, t) == pytest.approx((0.05 * 100 + 0.5 * 10) / 50, rel=1e-6)


def test_understeer_is_negative() -> None:
    t = np.linspace(0, 1, 11)
    assert yaw_error(0.8 * t, t, t) < 0
    assert yaw_error(-0.8 * t, -t, t) < 0


@pytest.mark.parametrize(
    ("gamma_f", "gamma_d", "t", "said"),
    [
        ([0, 1], [0, 0], [0, 1], "integrates to zero"),
        ([0, 1, 2], [0, 1], [0, 1], "lengths"),
        ([0, math.nan], [0, 1], [0, 1], "gamma_f"),
        ([0, 1], [0, 1], [1, 0], "not increasing"),
        ([0, 1, 0], [1, 0, -1], [0, 1, 2], "integrates to zero"),
    ],
)
def test_yaw_error_refuses(gamma_f: list, gamma_d: list, t: list, said: str) -> None:
    with pytest.raises(ArtibotError, match=said):
        yaw_error(gamma_f, gamma_d, t)


@given(st.tuples(numbers, numbers), st.tuples(numbers, numbers), st.floats(0.1, 100), angles)
def test_position_error_is_a_distance_over_a_length(p: tuple, q: tuple, sigma: float, turn: float) -> None:
    error = position_error(p, q, sigma)
    assert error >= 0
    assert error == pytest.approx(position_error(q, p, sigma))
    assert error * sigma == pytest.approx(math.dist(p, q), abs=1e-9)
    c, s = math.cos(turn), math.sin(turn)
    turned = [(c * x - s * y, s * x + c * y) for x, y in (p, q)]
    assert position_error(*turned, sigma) == pytest.approx(error, abs=1e-9)


@pytest.mark.parametrize("sigma", [0.0, -1.0, math.nan, math.inf])
def test_position_error_refuses_a_length_that_is_none(sigma: float) -> None:
    with pytest.raises(ArtibotError, match="sigma"):
        position_error((0, 0), (1, 1), sigma)


@given(numbers, numbers, st.floats(0.05, 200), angles, st.floats(0.2, 2 * math.pi))
def test_points_of_a_circle_give_the_circle(x: float, y: float, r: float, start: float, sweep: float) -> None:
    circle = fit_circle(*arc(x, y, r, start, sweep))
    tolerance = 1e-7 * (r + abs(x) + abs(y)) / min(1.0, sweep) ** 2
    assert circle.radius == pytest.approx(r, abs=tolerance)
    assert circle.x == pytest.approx(x, abs=tolerance)
    assert circle.y == pytest.approx(y, abs=tolerance)
    assert circle.rmse < tolerance


@given(st.integers(0, 10**6), st.floats(1.5, 6), st.floats(0.5, 30))
def test_the_fit_is_a_minimum_of_the_geometric_distances(seed: int, sweep: float, r: float) -> None:
    rng = np.random.default_rng(seed)
    x, y = arc(3.0, -2.0, r, 0.3, sweep, 40)
    x, y = x + 0.02 * r * rng.standard_normal(40), y + 0.02 * r * rng.standard_normal(40)
    circle = fit_circle(x, y)

    def cost(a: float, b: float, c: float) -> float:
        return float(((np.hypot(x - a, y - b) - c) ** 2).sum())

    best = cost(circle.x, circle.y, circle.radius)
    for step in 1e-3 * r * np.vstack([np.eye(3), -np.eye(3)]):
        assert cost(circle.x + step[0], circle.y + step[1], circle.radius + step[2]) >= best * (1 - 1e-9)
    assert abs(circle.radius - r) < 0.2 * r


def test_short_arcs_are_not_biased_towards_small_circles() -> None:
    """Kåsa's simple algebraic fit halves the radius here; the geometric one does not."""
    rng = np.random.default_rng(1)
    found = []
    for _ in range(200):
        x, y = arc(0, 0, 3.0, 0.0, 0.6, 200)
        found.append(radius(x + 0.01 * rng.standard_normal(200), y + 0.01 * rng.standard_normal(200)))
    assert np.median(found) == pytest.approx(3.0, rel=0.02)


@given(numbers, numbers, angles, st.floats(0.1, 10))
def test_the_radius_does_not_depend_on_where_the_circle_lies(x: float, y: float, turn: float, scale: float) -> None:
    rng = np.random.default_rng(7)
    u, v = arc(0, 0, 2.0, 0.0, 3.0)
    u, v = u + 0.01 * rng.standard_normal(60), v + 0.01 * rng.standard_normal(60)
    c, s = math.cos(turn), math.sin(turn)
    moved = radius(x + scale * (c * u - s * v), y + scale * (s * u + c * v))
    assert moved == pytest.approx(scale * radius(u, v), rel=1e-6)


def test_a_circle_needs_a_curve() -> None:
    with pytest.raises(ArtibotError, match="line"):
        fit_circle([0, 1, 2, 3], [0, 2, 4, 6])
    with pytest.raises(ArtibotError, match="at least 3"):
        fit_circle([0, 1, math.nan], [0, 1, 5])


@given(st.floats(0.1, 50), st.floats(0.1, 6))
def test_the_length_of_an_arc(r: float, sweep: float) -> None:
    x, y = arc(1, 2, r, 0.5, sweep, 2001)
    assert path_length(x, y) == pytest.approx(r * sweep, rel=1e-5)
    x[7] = math.nan
    assert path_length(x, y) == pytest.approx(r * sweep, rel=1e-5)


@given(st.floats(-3, 3), st.floats(-0.5, 0.5), st.integers(2, 50), st.tuples(numbers, numbers, angles))
def test_dead_reckoning_of_constant_rotations_is_exact(step: float, turn: float, n: int, start: tuple) -> None:
    assume(abs(turn) > 1e-3 and abs(step) > 1e-3)
    k = np.arange(n)
    pose = dead_reckon(step * k, turn * k, start)
    r = step / turn
    yaw = start[2] + turn * k
    assert np.allclose(pose[:, 2], yaw, atol=1e-9)
    assert np.allclose(pose[:, 0], start[0] + r * (np.sin(yaw) - math.sin(start[2])), atol=1e-9 * (1 + abs(r)) * 100)
    assert np.allclose(pose[:, 1], start[1] - r * (np.cos(yaw) - math.cos(start[2])), atol=1e-9 * (1 + abs(r)) * 100)
