"""Motors of rovers side by side (`lanes`): commands, and eqs 21 to 23 and 26 to 30.

Loops run over four motors × LANES in one piece: one over eight lanes would be written out before it is looked at.
"""

from __future__ import annotations

import math

from artibot_sim.model.compiled import inlined
from artibot_sim.model.effects import hooks
from artibot_sim.model.lane_layout import AT, LANES, MOTORS, effects_at, four, put4
from artibot_sim.model.layout import MOTOR
from artibot_sim.model.transmission import TORQUE, rolling_sign


@inlined
def follow_command(S, j, s):
    """A motor's command `s` seconds after the knot, and what it does if it follows (eqs 26 to 28, or a velocity loop).

    Returns the speed of its wheels, rad/s.
    """
    c_0, c_1, c_2, c_3 = S[AT.P_0 + j], S[AT.V_0 + j], S[AT.C_2 + j], S[AT.C_3 + j]
    d = c_0 + s * (c_1 + s * (c_2 + s * c_3))
    d_dot = c_1 + s * (2.0 * c_2 + 3.0 * s * c_3)
    d_ddot = 2.0 * c_2 + 6.0 * s * c_3
    speed = S[AT.V_S + MOTORS + j]
    behind, back = d_dot - speed, d - S[AT.Q_S + MOTORS + j]
    S[AT.ACC + MOTORS + j] = d_ddot + S[AT.DAMPING + j] * behind + S[AT.STIFFNESS + j] * back
    omega = S[AT.TAU + j] * speed
    S[AT.RIM + j], S[AT.SIGN + j] = S[AT.R_W + j] * omega, math.copysign(1.0, omega)
    return omega


@inlined
def drag_motors(S, fx, t):
    """With effects: drag on all motors, at the stage."""
    for e in range(LANES):
        effects = effects_at(S, fx, e, t)
        right_f, left_f, right_b, left_b = four(S, AT.V_S + MOTORS + e)
        put4(
            S, AT.DRAG + e, hooks.drag(effects, MOTOR[0], right_f), hooks.drag(effects, MOTOR[1], left_f),
            hooks.drag(effects, MOTOR[2], right_b), hooks.drag(effects, MOTOR[3], left_b),
        )  # fmt: skip


@inlined
def smooth_signs(S):
    """Signs of rolling resistance where not all wheels turn fast, by an exponential for each."""
    for j in range(4 * LANES):
        S[AT.SIGN + j] = rolling_sign(S[AT.TAU + j] * S[AT.V_S + MOTORS + j])


@inlined
def turn_motors(S, fx):
    """Torques of all motors (eq. 21), and what those that are not prescribed do, at the stage.

    Of all motors: a loop over the back ones only is so short that it is written out, without vectors, and slower.
    """
    for j in range(4 * LANES):
        rolling = S[AT.ROLLS + j] * S[AT.U_F_N + j] * S[AT.SIGN + j]
        load = S[AT.GEARED + j] * (S[AT.LEVER + j] * S[AT.PULL + j] + rolling)  # eq. 22, motor side
        if fx is not None:
            load += S[AT.DRAG + j]
        wish, limit, held = S[AT.ACC + MOTORS + j], S[AT.TORQUE_MAX + j], S[AT.HELD + j]
        needed = S[AT.INERTIA + j] * wish + load
        M_m = min(max(held if held == held else needed, -limit), limit)
        S[AT.ACC + MOTORS + j] = wish if M_m == needed else (M_m - load) * S[AT.INV_J + j]
        S[AT.TORQUE + j] = M_m


@inlined
def hold_torques(S):
    """Held through a step: torques, commanded ones or eq. 30 from the step before (NaN commands it), and inertias."""
    for e in range(LANES):
        shared = S[AT.SHARE + e] * (S[AT.PREVIOUS + e] + S[AT.PREVIOUS + LANES + e])
        hold_motor(S, e, 0.0)
        hold_motor(S, e + LANES, 0.0)
        hold_motor(S, e + 2 * LANES, shared)
        hold_motor(S, e + 3 * LANES, shared)


@inlined
def hold_motor(S, j, shared):
    """As `hold_torques` for one motor of a lane."""
    given, tau = S[AT.GIVEN + j], S[AT.TAU + j]
    torque, gear = given if given == given else shared, tau * S[AT.GEAR + j]
    inertia = S[AT.J_M + j] + S[AT.J_W + j] * tau * gear
    S[AT.HELD + j] = torque if S[AT.MODE + j] == TORQUE else math.nan
    S[AT.GEARED + j], S[AT.INERTIA + j], S[AT.INV_J + j] = gear, inertia, 1.0 / inertia


@inlined
def feed_back(S, fx):
    """What the next step takes from the start of this one: torques (eq. 30) and efficiencies (eq. 23)."""
    for j in range(4 * LANES):
        torque = S[AT.TORQUE + j]
        through_gear = torque - S[AT.DRAG + j] if fx is not None else torque
        drives = 1.0 if through_gear * S[AT.V + MOTORS + j] >= 0.0 else 0.0  # a choice of places is no vector code
        S[AT.PREVIOUS + j] = torque
        S[AT.GEAR + j] = drives * S[AT.DRIVING + j] + (1.0 - drives) * S[AT.BRAKING + j]


@inlined
def next_knot(S, e, position, velocity, row, turned):
    """A lane's commands at the knot in `row`; recorded rotations are `turned` times the true ones."""
    for motor in range(4):
        j = motor * LANES + e
        if turned != 1.0:
            S[AT.P_1 + j], S[AT.V_1 + j] = position[row, motor] / turned, velocity[row, motor] / turned
        else:
            S[AT.P_1 + j], S[AT.V_1 + j] = position[row, motor], velocity[row, motor]


@inlined
def leave_knot(S):
    """The knot ahead is the one behind."""
    for j in range(4 * LANES):
        S[AT.P_0 + j], S[AT.V_0 + j] = S[AT.P_1 + j], S[AT.V_1 + j]


@inlined
def cubics(S):
    """Coefficients of the commands' cubics (see `loop.hermite`)."""
    for j in range(4 * LANES):
        going, a, b = S[AT.GOING + j], S[AT.V_0 + j], S[AT.V_1 + j]
        rise = (S[AT.P_1 + j] - S[AT.P_0 + j]) * going
        S[AT.C_2 + j], S[AT.C_3 + j] = (3.0 * rise - 2.0 * a - b) * going, (a + b - 2.0 * rise) * (going * going)
