"""Rovers into lanes: which starts stay on a plane, and what a block holds of a robot."""

from __future__ import annotations

import math

from artibot_sim.model.equations.transmission import PRESCRIBED
from artibot_sim.model.kernels.compilation import inlined, kernel
from artibot_sim.model.kernels.integrators import motor_of
from artibot_sim.model.kernels.lane_layout import AT, LANES, SIZE
from artibot_sim.model.kernels.layout import BACK, BEHIND, FRONT, GAMMA, MEMORY, MOTOR_COORDINATES, X, Y, Z
from artibot_sim.model.kernels.plane_step import level, standing

PLACES = (X, Y, GAMMA, BACK + X, BACK + Y, BACK + GAMMA, *MOTOR_COORDINATES)
"""Where the coordinates that move on a plane stand in q."""


@kernel
def find_level(records, effects, robot, q, v, out):
    """Which items stay on a plane, into `out` (n,).

    Parameters
    ----------
    records : array of PARAMS_DTYPE, shape (r,)
    effects : array of RECORD_DTYPE, shape (r,), or None
    robot : array of int, shape (n,)
    q, v : array, shape (n, 16)
    """
    for i in range(robot.shape[0]):
        r = robot[i]
        if effects is not None:
            out[i] = level(records[r], effects[r], q[i], v[i])
        else:
            out[i] = level(records[r], None, q[i], v[i])


@inlined
def load_module(S, e, place, body, p, fx, module, z):
    """A module's numbers (`planar.Body`), which begin at `place` in a block, into lane `e`."""
    of, at = standing(body, p, fx, module, z), place + e
    S[at], S[at + LANES], S[at + 2 * LANES] = of.inv_m, of.inv_J, of.half_x
    S[at + 3 * LANES], S[at + 4 * LANES] = of.half_y, of.O_x
    S[at + 5 * LANES], S[at + 6 * LANES] = of.k_l, of.k_t
    S[at + 7 * LANES], S[at + 8 * LANES] = of.mu_s, of.mu_d
    S[at + 9 * LANES], S[at + 10 * LANES], S[at + 11 * LANES], S[at + 12 * LANES] = of.F_rf, of.F_rb, of.F_lf, of.F_lb
    right = AT.U_F_N + 2 * module * LANES + e  # what stays so, unless an effect moves the forces
    S[right], S[right + LANES] = p.u_w * (of.F_rf + of.F_rb), p.u_w * (of.F_lf + of.F_lb)
    S[AT.FACING + module * LANES + e] = 0.0


@inlined
def load_motors(S, e, p, modes, i, eta, r, share):
    """Motors into lane `e`: row `i` of `modes` (n, 4), row `r` of first efficiencies (r, 4), eq. 30's factor."""
    for motor in range(4):
        j, unit = motor * LANES + e, motor_of(p, motor)
        S[AT.MODE + j], S[AT.TAU + j], S[AT.R_W + j] = modes[i, motor], unit.tau, unit.r_w
        S[AT.J_M + j], S[AT.J_W + j], S[AT.TORQUE_MAX + j] = unit.J_m, unit.J_w, unit.torque_max
        S[AT.DRIVING + j], S[AT.BRAKING + j], S[AT.GEAR + j] = 1.0 / unit.eta_d, unit.eta_r, 1.0 / eta[r, motor]
        S[AT.DAMPING + j], S[AT.STIFFNESS + j] = p.velocity_gain, 0.0
        if modes[i, motor] == PRESCRIBED:
            S[AT.TORQUE_MAX + j], S[AT.DAMPING + j], S[AT.STIFFNESS + j] = math.inf, 2.0 * p.A_motor, p.A_motor**2
        S[AT.LEVER + j], S[AT.ROLLS + j] = unit.r_w, 1.0
        if p.literal_eq22:
            S[AT.LEVER + j], S[AT.ROLLS + j] = unit.r_w + p.u_w, 0.0
        S[AT.PREVIOUS + j] = S[AT.TORQUE + j] = S[AT.BEHIND + j] = 0.0
        S[AT.TRAIL + j] = math.nan
    S[AT.SHARE + e] = share


@inlined
def load_lane(S, e, p, fx, q, v, i):
    """A level rover whose state is row `i` of q and v (n, 16) into lane `e`; `load_motors` does the motors."""
    for k in range(SIZE):
        c, j = PLACES[k], k * LANES + e
        S[AT.Q + j] = S[AT.Q_S + j] = q[i, c]
        S[AT.V + j] = S[AT.V_S + j] = v[i, c]
        S[AT.SOUND + j], S[AT.KEPT + j] = 1.0, 0.0
    for k in range(MEMORY):
        S[AT.LAG + k * LANES + e] = S[AT.LAG_S + k * LANES + e] = 0.0
    load_module(S, e, AT.BODY_F, p.front, p, fx, FRONT, q[i, Z])
    load_module(S, e, AT.BODY_B, p.back, p, fx, BEHIND, q[i, BACK + Z])
    g = AT.GROUND + e
    S[g], S[g + LANES], S[g + 2 * LANES], S[g + 3 * LANES] = p.u_w, p.g_x, p.g_y, p.A_joint
    S[g + 4 * LANES], S[g + 5 * LANES], S[g + 6 * LANES] = 1.0 if p.two else 0.0, p.load, p.pitching
