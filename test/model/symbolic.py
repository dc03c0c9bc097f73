"""The universal joint derived by sympy from eqs 2 and 13 alone."""

from __future__ import annotations

import functools

import sympy as sp


@functools.cache
def joint():
    """Phi (4, 1), Phi_x (4, 16) and (d/dt Phi_x) v (4, 1) as functions of (q, v, (l_f, l_b, O_zf, O_zb))."""
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


def geometry_of(robot):
    """The joint's place in both modules, as `joint`'s functions take it."""
    return robot.front.l, robot.back.l, robot.front.O_z, robot.back.O_z
