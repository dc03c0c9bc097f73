"""The universal joint (eqs 13, 14) against a symbolic derivation that starts from eq. 2 and eq. 13 alone."""

from __future__ import annotations

import numpy as np
import pytest
import sympy as sp

from artibot_sim.model.kinematics import constraint, constraint_bias, constraint_jacobian


@pytest.fixture(scope="module")
def symbolic():
    """Phi, Phi_x and (d/dt Phi_x) v as functions of (q, v, l_f, l_b, O_zf, O_zb)."""
    q, v = sp.symbols("q:16", real=True), sp.symbols("v:16", real=True)
    geometry = sp.symbols("l_f l_b O_zf O_zb", real=True)

    def rotation(alpha, beta, gamma):
        ca, sa, cb, sb, cg, sg = (f(angle) for angle in (alpha, beta, gamma) for f in (sp.cos, sp.sin))
        R_x = sp.Matrix([[1, 0, 0], [0, ca, -sa], [0, sa, ca]])
        R_y = sp.Matrix([[cb, 0, sb], [0, 1, 0], [-sb, 0, cb]])
        R_z = sp.Matrix([[cg, -sg, 0], [sg, cg, 0], [0, 0, 1]])
        return R_z * R_y * R_x

    R_f, R_b = rotation(*q[3:6]), rotation(*q[11:14])
    O_f, O_b = sp.Matrix([-geometry[0], 0, geometry[2]]), sp.Matrix([geometry[1], 0, geometry[3]])
    meet = sp.Matrix(q[0:3]) + R_f * O_f - sp.Matrix(q[8:11]) - R_b * O_b
    square = (sp.Matrix([[0, 0, 1]]) * R_f.T * R_b * sp.Matrix([1, 0, 0]))[0]
    Phi = sp.Matrix([*meet, square])
    Phi_x = Phi.jacobian(q)
    bias = (Phi_x * sp.Matrix(v)).jacobian(q) * sp.Matrix(v)  # (d/dt Phi_x) v with v held
    args = (q, v, geometry)
    return tuple(sp.lambdify(args, expression, "numpy", cse=True) for expression in (Phi, Phi_x, bias))


def robots(agriq):
    """Robots whose joint lies in general places; a joint above the origins makes every term count."""
    yield agriq
    yield agriq.replace({"front.l": 0.31, "back.l": 0.77, "front.O_z": 0.12, "back.O_z": -0.07})


def geometry_of(robot):
    return robot.front.l, robot.back.l, robot.front.O_z, robot.back.O_z


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
