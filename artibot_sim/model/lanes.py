"""Many rovers side by side: RK4 steps of LANES rovers at once, in the processor's vector units.

All numbers of a block of rovers stand in one flat array `S`, quantity by quantity: component i of lane e at
``S[AT.quantity + i * LANES + e]``. Loops over lanes are innermost and their bodies have no branches and no calls, which
is what compilers make vector code of (short bodies over all motors at once: a loop over eight lanes would be written
out before it is looked at). Lanes know nothing of each other: results do not depend on which rovers share a
block, and one that diverges disturbs no other.

`fx` is None for the paper's model. In the extended one it is LIGHT or FULL (`lane_effects`), whose lengths the compiler
knows, and effects' parameters are in `S`.
"""

from __future__ import annotations

from collections import namedtuple
from typing import Any

import numpy as np

from artibot_sim.model.compiled import inlined
from artibot_sim.model.effects import hooks
from artibot_sim.model.lane_effects import EFFECT_VALUES, reader
from artibot_sim.model.planar import Body, Ground, Motion, planar_accelerations
from artibot_sim.model.transmission import DRIVEN, PRESCRIBED, follow, rolling_sign

LANES = 8
"""Rovers in a block."""

SIZE = 10
"""Coordinates that move on a plane: x, y, gamma of the front module, of the back one, and the motors' angles."""

MOTORS = 6 * LANES
"""Where the motors begin among them."""

_SIZES = {
    # state; stage and sums of RK4; the same of lateral forces that lag (N)
    "Q": SIZE, "V": SIZE, "ACC": SIZE, "Q_S": SIZE, "V_S": SIZE, "SUM_Q": SIZE, "SUM_V": SIZE,
    "LAG": 8, "LAG_S": 8, "LAG_RATE": 8, "SUM_LAG": 8,
    # commands: angles and speeds at both ends of a cubic, its last coefficients, speed and acceleration now; the
    # inverse of its length, 0 after the last one
    "P_0": 4, "V_0": 4, "P_1": 4, "V_1": 4, "C_2": 4, "C_3": 4, "D_DOT": 4, "D_DDOT": 4,
    "GOING": 4,
    # commanded torque (NaN: eq. 30), what is held through a step, eq. 30's factor of the front
    # motors' sum and what comes of it
    "GIVEN": 4, "HELD": 4, "SHARE": 1, "SHARED": 2,
    # motors: speed of their wheels' rims, sums over the two wheels of F_l and u F_n, drag, torque now and a step
    # before, inverse efficiency for this step and the next, inverse inertia
    "RIM": 4, "PULL": 4, "U_F_N": 4, "DRAG": 4, "TORQUE": 4, "PREVIOUS": 4, "GEAR": 4, "NEXT_GEAR": 4, "INV_J": 4,
    "MODE": 4, "TAU": 4, "R_W": 4, "J_M": 4, "J_W": 4, "DRIVING": 4, "BRAKING": 4, "TORQUE_MAX": 4, "A_MOTOR": 4,
    "GAIN": 4, "LITERAL": 4,
    "BODY_F": len(Body._fields), "BODY_B": len(Body._fields), "GROUND": len(Ground._fields),
    # whether a coordinate is sound, and in how many rows it was
    "SOUND": SIZE, "KEPT": SIZE,
    "EFFECTS": EFFECT_VALUES,
}  # fmt: skip

_BEGINS = [LANES * sum(list(_SIZES.values())[:k]) for k in range(len(_SIZES))]

AT: Any = namedtuple("At", list(_SIZES))(*_BEGINS)  # type: ignore[arg-type]  # mypy knows no fields from a list
"""Where each quantity begins in a block."""

BLOCK = LANES * sum(_SIZES.values())
"""Size of a block."""

MOTOR = tuple(map(np.int64, range(4)))
"""Numbers of the motors, as hooks take them."""

LIMIT_V, LIMIT_Q = 1e6, 1e12
"""Beyond, a rover has diverged, as in `loop`."""

light_effects, all_effects = reader(LANES, full=False), reader(LANES, full=True)


@inlined
def effects_at(S, fx, e, t):
    """With effects: those of a lane at `t` (s) since its start."""
    if fx is not None:
        at = AT.EFFECTS + e
        if len(fx) == 1:
            return light_effects(S, at, S[at] + t)
        return all_effects(S, at, S[at] + t)
    return None


@inlined
def body_of(S, at):
    """A module of the lane whose numbers begin at `at`."""
    return Body(
        S[at], S[at + LANES], S[at + 2 * LANES], S[at + 3 * LANES], S[at + 4 * LANES], S[at + 5 * LANES],
        S[at + 6 * LANES], S[at + 7 * LANES], S[at + 8 * LANES], S[at + 9 * LANES], S[at + 10 * LANES],
        S[at + 11 * LANES], S[at + 12 * LANES],
    )  # fmt: skip


@inlined
def motion_of(S, q, v):
    """A module's motion from coordinates at `q` and rates at `v`."""
    return Motion(S[q], S[q + LANES], S[q + 2 * LANES], S[v], S[v + LANES], S[v + 2 * LANES])


@inlined
def four(S, at):
    """Four numbers of a lane."""
    return S[at], S[at + LANES], S[at + 2 * LANES], S[at + 3 * LANES]


@inlined
def put4(S, at, a, b, c, d):
    """Write four numbers of a lane."""
    S[at], S[at + LANES], S[at + 2 * LANES], S[at + 3 * LANES] = a, b, c, d


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
def move_modules(S, fx, t):
    """Accelerations of both modules, and what the motors' wheels meet, at the stage."""
    for e in range(LANES):
        g = AT.GROUND + e
        ground = Ground(S[g], S[g + LANES], S[g + 2 * LANES], S[g + 3 * LANES], S[g + 4 * LANES])
        q, v, lag = AT.Q_S + e, AT.V_S + e, AT.LAG_S + e
        on_f, on_b, pulls = planar_accelerations(
            body_of(S, AT.BODY_F + e), body_of(S, AT.BODY_B + e), ground, effects_at(S, fx, e, t),
            motion_of(S, q, v), motion_of(S, q + 3 * LANES, v + 3 * LANES), four(S, AT.RIM + e),
            four(S, lag), four(S, lag + 4 * LANES),
        )  # fmt: skip
        a = AT.ACC + e
        S[a], S[a + LANES], S[a + 2 * LANES] = on_f
        S[a + 3 * LANES], S[a + 4 * LANES], S[a + 5 * LANES] = on_b
        right_f, left_f, right_b, left_b = pulls
        put4(S, AT.PULL + e, right_f.F_l, left_f.F_l, right_b.F_l, left_b.F_l)
        put4(S, AT.U_F_N + e, right_f.u_F_n, left_f.u_F_n, right_b.u_F_n, left_b.u_F_n)
        if fx is not None and len(fx) > 1:
            lag = AT.LAG_RATE + e
            put4(S, lag, right_f.rate_f, right_f.rate_b, left_f.rate_f, left_f.rate_b)
            put4(S, lag + 4 * LANES, right_b.rate_f, right_b.rate_b, left_b.rate_f, left_b.rate_b)


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
def load_at(S, fx, j):
    """Load on a motor of a lane (eq. 22 and drag, motor side), N m, and its inertia, kg m²."""
    F_l, gear = S[AT.PULL + j], S[AT.TAU + j] * S[AT.GEAR + j]
    rolling = S[AT.U_F_N + j] * rolling_sign(S[AT.TAU + j] * S[AT.V_S + MOTORS + j])
    literal = S[AT.LITERAL + j]
    load = gear * (S[AT.R_W + j] * F_l + (literal * F_l if literal != 0.0 else rolling))
    if fx is not None:
        load += S[AT.DRAG + j]
    return load, S[AT.J_M + j] + S[AT.J_W + j] * S[AT.TAU + j] * gear


@inlined
def measure_motors(S, fx):
    """Torques that it takes to turn prescribed motors (eq. 21)."""
    for j in range(4 * LANES):
        load, J = load_at(S, fx, j)
        S[AT.TORQUE + j] = J * S[AT.ACC + MOTORS + j] + load


@inlined
def turn_motors(S, fx):
    """Torques of all motors (eq. 21), and what those that are not prescribed do, at the stage.

    Of all: a loop over the back ones only is so short that it is written out, without vectors, and slower.
    """
    for j in range(4 * LANES):
        load, J = load_at(S, fx, j)
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
def feed_back(S):
    """What the next step takes from the start of this one: torques (eq. 30) and efficiencies (eq. 23)."""
    for j in range(4 * LANES):
        torque = S[AT.TORQUE + j]
        driving = torque * S[AT.V + MOTORS + j] >= 0.0
        S[AT.PREVIOUS + j], S[AT.NEXT_GEAR + j] = torque, S[AT.DRIVING + j] if driving else S[AT.BRAKING + j]


@inlined
def next_stage(S, k, dt):
    """From stage `k` of the classical Runge-Kutta method to the next; after the last one, advance the state."""
    h = dt if k == 2 else 0.5 * dt
    if k == 0:
        for j in range(SIZE * LANES):
            speed, acceleration = S[AT.V_S + j], S[AT.ACC + j]
            S[AT.SUM_Q + j], S[AT.SUM_V + j] = speed, acceleration
            S[AT.Q_S + j], S[AT.V_S + j] = S[AT.Q + j] + h * speed, S[AT.V + j] + h * acceleration
    elif k < 3:
        for j in range(SIZE * LANES):
            speed, acceleration = S[AT.V_S + j], S[AT.ACC + j]
            S[AT.SUM_Q + j] += 2.0 * speed
            S[AT.SUM_V + j] += 2.0 * acceleration
            S[AT.Q_S + j], S[AT.V_S + j] = S[AT.Q + j] + h * speed, S[AT.V + j] + h * acceleration
    else:
        for j in range(SIZE * LANES):
            q = S[AT.Q + j] + dt / 6.0 * (S[AT.SUM_Q + j] + S[AT.V_S + j])
            v = S[AT.V + j] + dt / 6.0 * (S[AT.SUM_V + j] + S[AT.ACC + j])
            S[AT.Q + j], S[AT.Q_S + j], S[AT.V + j], S[AT.V_S + j] = q, q, v, v


@inlined
def next_lag(S, k, dt):
    """As `next_stage` for the lateral forces that lag."""
    h = dt if k == 2 else 0.5 * dt
    weight = 1.0 if k == 0 or k == 3 else 2.0
    for j in range(8 * LANES):
        rate = S[AT.LAG_RATE + j]
        total = weight * rate + (S[AT.SUM_LAG + j] if k > 0 else 0.0)
        S[AT.SUM_LAG + j] = total
        S[AT.LAG + j] += dt / 6.0 * total if k == 3 else 0.0
        S[AT.LAG_S + j] = S[AT.LAG + j] if k == 3 else S[AT.LAG + j] + h * rate


@inlined
def begin_step(S, free):
    """What is held through a step."""
    if free:
        hold_torques(S)


@inlined
def stage(S, fx, k, s, elapsed, dt, free, torques):
    """Stage `k` of a step that begins `s` seconds after a knot and `elapsed` seconds after the start.

    `free` says whether any motor is not prescribed, `torques` whether anybody asks for torques.
    """
    late = 0.0 if k == 0 else 1.0 if k == 3 else 0.5
    follow_commands(S, s + late * dt, free)
    move_modules(S, fx, elapsed + late * dt)
    if fx is not None and (free or (k == 0 and torques)):
        drag_motors(S, fx, elapsed + late * dt)
    if free:
        turn_motors(S, fx)
    elif k == 0 and torques:
        measure_motors(S, fx)
    if k == 0 and (free or torques):
        feed_back(S)


@inlined
def end_stage(S, fx, k, dt, geared):
    """To the next stage, and after the last one to the next step; `geared` where torques are computed."""
    next_stage(S, k, dt)
    if fx is not None and len(fx) > 1:
        next_lag(S, k, dt)
    if k == 3 and geared:
        for j in range(4 * LANES):
            S[AT.GEAR + j] = S[AT.NEXT_GEAR + j]


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


@inlined
def check(S):
    """Count the rows that are sound so far, coordinate by coordinate: finite, and within what a rover can do."""
    for j in range(SIZE * LANES):
        fine = abs(S[AT.V + j]) < LIMIT_V and abs(S[AT.Q + j]) < LIMIT_Q
        sound = S[AT.SOUND + j] if fine else 0.0
        S[AT.SOUND + j], S[AT.KEPT + j] = sound, S[AT.KEPT + j] + sound


@inlined
def sound_rows(S, e):
    """How many rows of a lane are sound, from the first on."""
    kept = S[AT.KEPT + e]
    for i in range(1, SIZE):
        kept = min(kept, S[AT.KEPT + i * LANES + e])
    return int(kept)
