"""What a rover on a plane writes down of an instant: the row of `layout.COLUMNS`, as in space."""

from __future__ import annotations

from artibot_sim.model.compiled import inlined
from artibot_sim.model.integrators import EFFICIENCY
from artibot_sim.model.layout import (
    ACC,
    BACK,
    BEHIND,
    ETA,
    F_L,
    F_N,
    F_T,
    FRONT,
    GAMMA,
    LAMBDA,
    M_M,
    M_R,
    MOTOR_COORDINATES,
    P_X,
    P_Y,
    Q_C,
    Q_J,
    SAT,
    X,
    Y,
    Z,
)
from artibot_sim.model.planar import module_pairs

PLACES = (X, Y, GAMMA, BACK + X, BACK + Y, BACK + GAMMA, *MOTOR_COORDINATES)
"""Where the coordinates that move on a plane stand in q."""


@inlined
def unload(values, two, out):
    """Coordinates, rates or accelerations that move on a plane (10) into `out` (16,)."""
    out[0], out[1], out[5], out[6], out[7] = values[0], values[1], values[2], values[6], values[7]
    if two:
        out[8], out[9], out[13], out[14], out[15] = values[3], values[4], values[5], values[8], values[9]


@inlined
def pair_row(pair, pull, i, w):
    """What two wheels meet and do; `i` is the front one's number."""
    w[P_X + i] = w[P_X + i + 1] = pair.p_x
    w[P_Y + i], w[P_Y + i + 1] = pair.p_yf, pair.p_yb
    w[F_N + i], w[F_N + i + 1] = pair.F_nf, pair.F_nb
    w[F_L + i], w[F_L + i + 1], w[F_T + i], w[F_T + i + 1] = pull.F_lf, pull.F_lb, pull.F_tf, pull.F_tb
    w[SAT + i] = 1.0 if pull.held_f != 1.0 else 0.0
    w[SAT + i + 1] = 1.0 if pull.held_b != 1.0 else 0.0


@inlined
def module_row(body, ground, at, s_g, c_g, module, right, left, contact, l_x, l_y, turn, w):
    """Wheels, contact forces and the joint's force (l_x, l_y N, turn N m) of one module."""
    pair_r, pair_l, _, _ = module_pairs(body, ground, None, at, s_g, c_g)
    pair_row(pair_r, right, 4 * module, w)
    pair_row(pair_l, left, 4 * module + 2, w)
    c, j = Q_C + 6 * module, Q_J + 6 * module
    w[c], w[c + 1], w[c + 5] = contact
    on_right, on_left = body.F_rf + body.F_rb, body.F_lf + body.F_lb
    w[c + Z], w[c + 3] = on_right + on_left, body.half_y * (on_left - on_right)
    w[j], w[j + 1], w[j + 5] = l_x, l_y, turn


@inlined
def write_row(at, two, motions, trig, a, acting, M_m, M_r, hold, w):
    """All of an instant but gravity, which never changes, into `w` (ROW,).

    Parameters
    ----------
    motions : tuple of 2 Motion
    trig : tuple of 4 floats
        Sine and cosine of yaw, front and back.
    a : tuple of 10 floats
        Accelerations.
    acting : tuple
        See `level_step.level_accelerations`.
    M_m, M_r : tuple of 4 floats
        Torques, N m.
    """
    pulls, contacts, joint = acting
    l_x, l_y, turn_f, turn_b = joint
    unload(a, two, w[ACC : ACC + 16])
    w[M_M], w[M_M + 1], w[M_R], w[M_R + 1] = M_m[0], M_m[1], M_r[0], M_r[1]
    w[ETA], w[ETA + 1] = hold[EFFICIENCY], hold[EFFICIENCY + 1]
    module_row(
        at.front, at.ground, motions[0], trig[0], trig[1], FRONT, pulls[0], pulls[1], contacts[0], -l_x, -l_y, turn_f, w
    )
    if two:
        w[LAMBDA], w[LAMBDA + 1] = l_x, l_y
        w[M_M + 2], w[M_M + 3], w[M_R + 2], w[M_R + 3] = M_m[2], M_m[3], M_r[2], M_r[3]
        w[ETA + 2], w[ETA + 3] = hold[EFFICIENCY + 2], hold[EFFICIENCY + 3]
        module_row(
            at.back, at.ground, motions[1], trig[2], trig[3], BEHIND, pulls[2], pulls[3], contacts[1], l_x, l_y, turn_b,
            w,
        )  # fmt: skip
