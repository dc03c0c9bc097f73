"""The planar check model against Lagrange's equations: the yardstick must itself be straight."""

from __future__ import annotations

import numpy as np
import pytest
import sympy as sp
from model.planar import GRAVITY, _accelerations, _hermite

BODY = (59.0, 10.5, 0.45, 0.72, 0.21, 28.0, 5.5, 0.4, 0.7, 0.83, 2.0)
SLIPPERY = (1.0, 1.0, 0.0, 0.0, 0.008, 0.2)  # mu = 0: no contact force at all
GRIPPING = (2900.0, 2000.0, 1e9, 1e9, 0.008, 0.2)


@pytest.fixture(scope="module")
def lagrange():
    """M(q) and h(q, q') of M q'' + h = Q from the kinetic energy of both modules."""
    t = sp.Symbol("t")
    q = [f(t) for f in sp.symbols("x y f b", cls=sp.Function)]
    m_f, J_f, _, _, l_f, m_b, J_b, _, _, l_b, _ = BODY
    p_f = sp.Matrix(q[:2])
    p_b = p_f - sp.Matrix([l_f * sp.cos(q[2]) + l_b * sp.cos(q[3]), l_f * sp.sin(q[2]) + l_b * sp.sin(q[3])])
    T = (m_f * p_f.diff(t).dot(p_f.diff(t)) + m_b * p_b.diff(t).dot(p_b.diff(t))) / 2
    T += (J_f * q[2].diff(t) ** 2 + J_b * q[3].diff(t) ** 2) / 2
    a, v, c = sp.symbols("a:4"), sp.symbols("v:4"), sp.symbols("c:4")
    rows = [T.diff(x.diff(t)).diff(t) - T.diff(x) for x in q]
    plain = [(x.diff(t, 2), a[i]) for i, x in enumerate(q)] + [(x.diff(t), v[i]) for i, x in enumerate(q)]
    rows = sp.Matrix(rows).subs(plain + [(x, c[i]) for i, x in enumerate(q)])
    M = rows.jacobian(a)
    return sp.lambdify((c, v), (M, rows.subs([(x, 0) for x in a])), "numpy")


def samples(n):
    rng = np.random.default_rng(11)
    for _ in range(n):
        yield rng.uniform(-3, 3, 4), rng.normal(0, 1, 4), rng.uniform(-5, 5, 4)


def test_free_motion_obeys_lagrange(lagrange):
    for q, v, omega in samples(10):
        acc, _ = _accelerations(BODY, SLIPPERY, q, v, omega, np.array([0.0, 0.0, GRAVITY]))
        M, h = lagrange(q, v)
        np.testing.assert_allclose(M @ acc, -h.ravel(), atol=1e-11, err_msg="inertia of the planar rover")


def test_contact_forces_do_virtual_work(lagrange):
    """M q'' + h equals sum of (d p_w / d q)^T F_w with p_w the points u_w ahead of the wheels, by complex step."""
    k_l, k_t, _, _, u_w, r_w = GRIPPING
    for q, v, omega in samples(10):
        Q = np.zeros(4)
        for module, (i_x, i_y) in enumerate(((BODY[2], BODY[3]), (BODY[7], BODY[8]))):
            for side in (0, 1):
                for end in (-0.5, 0.5):
                    y_w = (side - 0.5) * i_y
                    e = np.array([np.cos(q[2 + module]), np.sin(q[2 + module])])
                    n = np.array([-e[1], e[0]])
                    slip = _velocity(q, v, module, end * i_x, y_w)
                    F = k_l * (r_w * omega[2 * module + side] - slip @ e) * e - k_t * (slip @ n) * n
                    Q += [_velocity(q, unit, module, end * i_x + u_w, y_w) @ F for unit in np.eye(4)]
        acc, _ = _accelerations(BODY, GRIPPING, q, v, omega, np.array([0.0, 0.0, GRAVITY]))
        M, h = lagrange(q, v)
        np.testing.assert_allclose(M @ acc + h.ravel(), Q, rtol=1e-10, err_msg="generalised contact forces")


def _point(q, module, x, y):
    e_f, e_b = (np.array([np.cos(g), np.sin(g)]) for g in q[2:4])
    origin, e = (q[0:2], e_f) if module == 0 else (q[0:2] - BODY[4] * e_f - BODY[9] * e_b, e_b)
    return origin + x * e + y * np.array([-e[1], e[0]])


def _velocity(q, rates, module, x, y):
    return _point(q + 1e-30j * rates, module, x, y).imag / 1e-30


def test_hermite_meets_its_knots():
    p0, p1, d0, d1, h = 1.0, -2.0, 0.3, 4.0, 0.25
    assert _hermite(p0, p1, d0, d1, h, 0.0)[:2] == (p0, d0)
    np.testing.assert_allclose(_hermite(p0, p1, d0, d1, h, 1.0)[:2], (p1, d1), rtol=1e-14)
    before, after = (_hermite(p0, p1, d0, d1, h, s) for s in (0.499999, 0.500001))
    np.testing.assert_allclose((after[1] - before[1]) / (2e-6 * h), _hermite(p0, p1, d0, d1, h, 0.5)[2], rtol=1e-6)
