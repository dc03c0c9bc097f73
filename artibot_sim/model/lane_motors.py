"""Motors of rovers side by side (`lanes`): commands, and eqs 21 to 23 and 26 to 30.

Loops run over four motors × LANES in one piece: one over eight lanes would be written out before it is looked at.
"""

from __future__ import annotations

import math

from artibot_sim.model.compiled import inlined
from artibot_sim.model.effects import hooks
from artibot_sim.model.lane_layout import AT, LANES, MOTORS, effects_at, four, put4
from artibot_sim.model.layout import MOTOR
from artibot_sim.model.transmission import DRIVEN, PRESCRIBED, ROLLING_WIDTH, follow, rolling_sign


@inlined
def follow_commands(S, s, free):
    """Commands `s` seconds after the knot, and what prescribed motors do (eqs 26 to 28)."""
    for j in range(4 * LANES):
        c_0, c_1, c_2, c_3 = S[AT.P_0 + j], S[AT.V_0 + j], S[AT.C_2 + j], S[AT.C_3 + j]
        d = c_0 + s * (c_1 + s * (c_2 + s * c_3))
        d_dot = c_1 + s * (2.0 * c_2 + 3.0 * s * c_3)
        speed = S[AT.V_S + MOTORS + j]
        d_ddot = 2.0 * c_2 + 6.0 * s * c_3
        S[AT.ACC + MOTORS + j] = follow(S[AT.A_MOTOR + j], S[AT.Q_S + MOTORS + j], speed, d, d_dot, d_ddot)
        S[AT.RIM + j] = S[AT.R_W + j] * (S[AT.TAU + j] * speed)
    if free:
        for j in range(4 * LANES):
            c_2, c_3 = S[AT.C_2 + j], S[AT.C_3 + j]
            S[AT.D_DOT + j] = S[AT.V_0 + j] + s * (2.0 * c_2 + 3.0 * s * c_3)
            S[AT.D_DDOT + j] = 2.0 * c_2 + 6.0 * s * c_3


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
def all_roll(S):
    """Whether all wheels turn so fast that `rolling_sign` is ±1 to the bit, which spares an exponential for each."""
    count = 0
    for j in range(4 * LANES):
        count += abs(S[AT.TAU + j] * S[AT.V_S + MOTORS + j]) > 20.0 * ROLLING_WIDTH
    return count == 4 * LANES


@inlined
def plain_sign(omega):
    """`rolling_sign` of a wheel that turns."""
    return math.copysign(1.0, omega)


@inlined
def load_at(S, fx, j, sign):
    """Load on a motor of a lane (eq. 22 and drag, motor side), N m, and its inertia, kg m²."""
    F_l, gear = S[AT.PULL + j], S[AT.TAU + j] * S[AT.GEAR + j]
    rolling = S[AT.U_F_N + j] * sign(S[AT.TAU + j] * S[AT.V_S + MOTORS + j])
    literal = S[AT.LITERAL + j]
    load = gear * (S[AT.R_W + j] * F_l + (literal * F_l if literal != 0.0 else rolling))
    if fx is not None:
        load += S[AT.DRAG + j]
    return load, S[AT.J_M + j] + S[AT.J_W + j] * S[AT.TAU + j] * gear


@inlined
def measure_motors(S, fx):
    """Torques that it takes to turn prescribed motors (eq. 21)."""
    for j in range(4 * LANES):
        load, J = load_at(S, fx, j, rolling_sign)
        S[AT.TORQUE + j] = J * S[AT.ACC + MOTORS + j] + load


@inlined
def turn_motors(S, fx):
    """Torques of all motors (eq. 21), and what those that are not prescribed do, at the stage."""
    if all_roll(S):
        turn_with(S, fx, plain_sign)
    else:
        turn_with(S, fx, rolling_sign)


@inlined
def turn_with(S, fx, sign):
    """As `turn_motors`, with the function of a wheel's speed (rad/s) that gives the sign of rolling resistance.

    Of all motors: a loop over the back ones only is so short that it is written out, without vectors, and slower.
    """
    for j in range(4 * LANES):
        load, J = load_at(S, fx, j, sign)
        behind = S[AT.D_DOT + j] - S[AT.V_S + MOTORS + j]
        driven = J * (S[AT.D_DDOT + j] + S[AT.GAIN + j] * behind) + load
        M_m = driven if S[AT.MODE + j] == DRIVEN else S[AT.HELD + j]
        M_m = min(max(M_m, -S[AT.TORQUE_MAX + j]), S[AT.TORQUE_MAX + j])
        acceleration = S[AT.ACC + MOTORS + j]
        follows = S[AT.MODE + j] == PRESCRIBED
        S[AT.ACC + MOTORS + j] = acceleration if follows else (M_m - load) * S[AT.INV_J + j]
        S[AT.TORQUE + j] = J * acceleration + load if follows else M_m


@inlined
def hold_torques(S):
    """Held through a step: torques, commanded ones or eq. 30 from the step before (NaN commands it), and inertias."""
    for e in range(LANES):
        shared = S[AT.SHARE + e] * (S[AT.PREVIOUS + e] + S[AT.PREVIOUS + LANES + e])
        S[AT.SHARED + e] = S[AT.SHARED + LANES + e] = shared
    for j in range(2 * LANES):
        front, back = S[AT.GIVEN + j], S[AT.GIVEN + 2 * LANES + j]
        S[AT.HELD + j] = front if front == front else 0.0
        S[AT.HELD + 2 * LANES + j] = back if back == back else S[AT.SHARED + j]
    for j in range(4 * LANES):
        gear = S[AT.TAU + j] * S[AT.GEAR + j]
        S[AT.INV_J + j] = 1.0 / (S[AT.J_M + j] + S[AT.J_W + j] * S[AT.TAU + j] * gear)


@inlined
def feed_back(S, fx):
    """What the next step takes from the start of this one: torques (eq. 30) and efficiencies (eq. 23)."""
    for j in range(4 * LANES):
        torque = S[AT.TORQUE + j]
        through_gear = torque - S[AT.DRAG + j] if fx is not None else torque
        driving = through_gear * S[AT.V + MOTORS + j] >= 0.0
        S[AT.PREVIOUS + j], S[AT.NEXT_GEAR + j] = torque, S[AT.DRIVING + j] if driving else S[AT.BRAKING + j]


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
