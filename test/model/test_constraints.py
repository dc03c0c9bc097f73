"""The universal joint (eqs 13, 14) against a symbolic derivation that starts from eq. 2 and eq. 13 alone."""

from __future__ import annotations

import numpy as np
import pytest
from model.symbolic import geometry_of, joint

from artibot_sim.model.equations.kinematics import constraint, constraint_bias, constraint_jacobian


@pytest.fixture(scope="module")
def symbolic():
    return joint()


def robots(agriq):
    """Robots whose joint lies in general places; a joint above the origins makes every term count."""
    yield agriq
    yield agriq.replace({"front.l": 0.31, "back.l": 0.77, "front.O_z": 0.12, "back.O_z": -0.07})


def random_states(seed, n):
    """States with angles far from small, as the equations hold for any."""
    rng = np.random.default_rng(seed)
    for _ in range(n):
        q, v = rng.uniform(-1.2, 1.2, 16), rng.normal(0.0, 2.0, 16)
        q[[5, 13]] *= 3.0
        yield q, v


def assert_close(actual, expected, what):
    actual, expected = np.asarray(actual, dtype=float), np.asarray(expected, dtype=float).reshape(np.shape(actual))
    scale = 1.0 + np.abs(expected).max()
    assert np.abs(actual - expected).max() <= 1e-13 * scale, f"{what}: off by {actual - expected}"


def test_joint_constraint_is_equation_13(agriq, symbolic):
    for robot in robots(agriq):
        for q, v in random_states(1, 20):
            assert_close(constraint(robot, q), symbolic[0](q, v, geometry_of(robot)), "Phi")


def test_jacobian_is_the_derivative_of_the_constraint(agriq, symbolic):
    for robot in robots(agriq):
        for q, v in random_states(2, 20):
            actual = constraint_jacobian(robot, q)
            assert actual.shape == (4, 16)
            assert_close(actual, symbolic[1](q, v, geometry_of(robot)), "Phi_x")


def test_bias_is_the_time_derivative_of_the_jacobian_times_velocity(agriq, symbolic):
    for robot in robots(agriq):
        for q, v in random_states(3, 20):
            actual = constraint_bias(robot, q, v)
            assert_close(actual, symbolic[2](q, v, geometry_of(robot)), "(d/dt Phi_x) v")


def test_bias_is_what_a_straight_line_in_the_coordinates_shows(agriq):
    """Without sympy as well: along q + v t the second derivative of Phi is (d/dt Phi_x) v."""
    h = 1e-4
    for q, v in random_states(4, 5):
        second = (constraint(agriq, q + h * v) - 2 * constraint(agriq, q) + constraint(agriq, q - h * v)) / h**2
        np.testing.assert_allclose(constraint_bias(agriq, q, v), second, atol=1e-5 * (1 + v @ v))


def test_jacobian_ignores_motor_angles(agriq):
    columns = [6, 7, 14, 15]
    for q, _ in random_states(5, 3):
        assert not constraint_jacobian(agriq, q)[:, columns].any(), "the joint does not touch the motors"
