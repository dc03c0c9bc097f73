"""A rover at rest on uneven ground: what its wheels' springs do, as Newton's method asks for it."""

from __future__ import annotations

from artibot_sim.model.equations import uneven
from artibot_sim.model.equations.contact import PairForces
from artibot_sim.model.equations.kinematics import attitude
from artibot_sim.model.kernels.compilation import inlined, kernel
from artibot_sim.model.kernels.layout import BACK, BEHIND, BETA, FRONT, X, Y, Z

_NONE, _AT_REST = (0.0, 0.0), (0.0,) * 6
SPRINGS_ALONE = PairForces(*(0.0,) * 19, _NONE, _NONE, 0.0, 0.0, _NONE, _NONE)
"""Of a motor's two wheels that neither turn nor slip."""


@kernel
def spring_forces(q, p, fx, ground, w):
    """Generalised forces of the wheels' springs on both modules into the row `w`, at coordinates `q` (16,)."""
    s_f, c_f, sg_f, cg_f, s_b, c_b, sg_b, cg_b = attitude(q)
    _on_module(p.front, p, fx, ground, FRONT, q, (s_f, c_f, sg_f, cg_f), w)
    if p.two:
        _on_module(p.back, p, fx, ground, BEHIND, q, (s_b, c_b, sg_b, cg_b), w)


@inlined
def _on_module(body, p, fx, ground, module, q, trig, w):
    (s_a, c_a, s_g, c_g), b = trig, BACK * module
    at = uneven.attitude_of(p, s_a, c_a, q[b + BETA], s_g, c_g)
    x, y, z = q[b + X], q[b + Y], q[b + Z]
    sides = (
        uneven.standing(body, p, fx, ground, module, -1.0, at, x, y, z, _AT_REST),
        uneven.standing(body, p, fx, ground, module, 1.0, at, x, y, z, _AT_REST),
    )
    uneven.generalised_forces(p, fx, at, sides, SPRINGS_ALONE, SPRINGS_ALONE, module, w)
