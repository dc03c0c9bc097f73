"""Which rovers stand level, and what of a module matters on a plane (`planar`)."""

from __future__ import annotations

from artibot_sim.model.compiled import inlined
from artibot_sim.model.contact import normal_force
from artibot_sim.model.effects import hooks
from artibot_sim.model.layout import ALPHA, BACK, BEHIND, BETA, FRONT, Z
from artibot_sim.model.planar import Body

_STILL = 1e-12
"""m, rad and per second, within which a rover stands level and still: what rounding leaves."""

_BALANCED = 1e-9
"""Vertical and roll accelerations (m/s², rad/s²) that move nobody from there."""


@inlined
def static_loads(body, p, fx, module, z):
    """Normal forces (N) of a level module's wheels: right in front and behind, left in front and behind."""
    return (
        normal_force(body, p, fx, module, 1.0, -1.0, 0.0, 0.0, 0.0, 1.0, z),
        normal_force(body, p, fx, module, -1.0, -1.0, 0.0, 0.0, 0.0, 1.0, z),
        normal_force(body, p, fx, module, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0, z),
        normal_force(body, p, fx, module, -1.0, 1.0, 0.0, 0.0, 0.0, 1.0, z),
    )


@inlined
def module_level(body, p, fx, module, q, v):
    """Whether a module stands level, and its wheels carry it so."""
    b = BACK * module
    for c in (Z, ALPHA, BETA):
        if abs(v[b + c]) > _STILL or (c != Z and abs(q[b + c]) > _STILL):
            return False
    right_f, right_b, left_f, left_b = static_loads(body, p, fx, module, q[b + Z])
    left = 0.0
    if fx is not None:
        _, left = hooks.centre(fx, module)
    rising = p.g_z + body.inverse[2] * ((right_f + right_b) + (left_f + left_b))
    rolling = body.inverse[3] * (body.half_y * ((left_f + left_b) - (right_f + right_b)) + body.m * p.g_z * left)
    return abs(rising) < _BALANCED and abs(rolling) < _BALANCED


@inlined
def level(p, fx, q, v):
    """Whether a rover at q and v (16,) moves on a plane only."""
    if not module_level(p.front, p, fx, FRONT, q, v):
        return False
    if not p.two:
        return True
    coplanar = p.front.O_z == 0.0 and p.back.O_z == 0.0 and abs(q[Z] - q[BACK + Z]) < _STILL
    return coplanar and module_level(p.back, p, fx, BEHIND, q, v)


@inlined
def standing(body, p, fx, module, z):
    """A level module's numbers (`planar.Body`), its origin at height `z` (m)."""
    F_rf, F_rb, F_lf, F_lb = static_loads(body, p, fx, module, z)
    return Body(
        body.inverse[0], body.inverse[5], body.half_x, body.half_y, body.O_x, body.k_l, body.k_t, body.mu_s, body.mu_d,
        F_rf, F_rb, F_lf, F_lb,
    )  # fmt: skip
