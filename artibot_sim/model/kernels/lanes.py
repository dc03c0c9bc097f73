"""Motors of rovers side by side (`lanes`): commands, and eqs 21 to 23 and 26 to 30.

Loops run over four motors × LANES in one piece: one over eight lanes would be written out before it is looked at.
"""

from __future__ import annotations

import math
from typing import Any

from numba.core import types
from numba.extending import overload

from artibot_sim.model.effects import hooks
from artibot_sim.model.effects.force_law import (
    ACROSS_AT,
    ALONG_AT,
    FORCES,
    JOINT_AT,
    SHAFT_AT,
    LawForces,
    LocalMotion,
    bent,
    range_of,
    value,
)
from artibot_sim.model.equations.contact import pair_forces, within_friction_lanes
from artibot_sim.model.equations.plane import (
    Body,
    CommonTerms,
    Motion,
    module_wheels,
    planar_accelerations,
    rigid_accelerations,
)
from artibot_sim.model.equations.transmission import (
    DRIVEN,
    PRESCRIBED,
    ROLLING_WIDTH,
    TORQUE,
    axle_torque,
    drives_next,
    follow,
    impulses,
    motor_equation,
    reflect,
    rolling_sign,
    sticks,
)
from artibot_sim.model.kernels.compilation import called, inlined
from artibot_sim.model.kernels.elementary import cubic_at, cubic_between, sincos, turn_by
from artibot_sim.model.kernels.lane_layout import (
    AT,
    BRISTLED,
    LAGGING,
    LANES,
    LIMIT_Q,
    LIMIT_V,
    LIMITED,
    MOTORS,
    SIZE,
    WOUND,
    effects_at,
    four,
    lane_effects,
    put4,
    with_forces,
)
from artibot_sim.model.kernels.layout import BEHIND, FRONT, MEMORY, MOTOR
from artibot_sim.model.kernels.plane_step import note_level
from artibot_sim.model.kernels.steps import STAGE, next_stage, next_stage_of_lag, stage_time


@inlined
def follow_command(S, fx, j, s):
    """A motor's command `s` seconds after the knot, and what it does if it follows (eqs 26 to 28, or a velocity loop).

    Returns the speed of its wheels, rad/s.
    """
    c_0, c_1, c_2, c_3 = S[AT.P_0 + j], S[AT.V_0 + j], S[AT.C_2 + j], S[AT.C_3 + j]
    d, d_dot, d_ddot = cubic_at(c_0, c_1, c_2, c_3, s)
    theta, speed = S[AT.Q_S + MOTORS + j], S[AT.V_S + MOTORS + j]
    S[AT.ACC + MOTORS + j] = follow(S[AT.DAMPING + j], S[AT.STIFFNESS + j], theta, speed, d, d_dot, d_ddot)
    if fx is not None and LIMITED[len(fx)]:
        S[AT.ERROR + j], S[AT.TRAIL_S + j] = d_dot - speed, d - theta
    omega = S[AT.TAU + j] * speed
    S[AT.RIM + j], S[AT.SIGN + j] = S[AT.R_W + j] * omega, math.copysign(1.0, omega)
    return omega


@inlined
def drag_motors(S, fx, laws, k, t, rigid):
    """With effects: drag on all motors, what velocity loops ask for, and between what torques stay, at stage `k`.

    Of one or two modules each motor has a gear.
    """
    for e in range(LANES):
        effects = effects_and_forces(S, fx, laws, e, t)
        right_f, left_f, right_b, left_b = four(S, AT.V_S + MOTORS + e)
        put4(
            S, AT.DRAG + e,
            hooks.drag(effects, MOTOR[0], right_f) + hooks.gear(effects, right_f),
            hooks.drag(effects, MOTOR[1], left_f) + hooks.gear(effects, left_f),
            hooks.drag(effects, MOTOR[2], right_b) + hooks.gear(effects, right_b),
            hooks.drag(effects, MOTOR[3], left_b) + hooks.gear(effects, left_b),
        )  # fmt: skip
        if laws is not None:
            for motor in range(motors_of(rigid)):
                j = motor * LANES + e
                S[AT.DRAG + j] += S[AT.LAW_FORCES + SHAFT_AT * LANES + j]
        if LIMITED[len(fx)]:
            for motor in range(4):
                j = motor * LANES + e
                most = S[AT.TORQUE_MAX + j]
                S[AT.LOW + j], S[AT.HIGH + j] = hooks.limits(effects, S[AT.V_S + MOTORS + j], -most, most)
                ask_loop(S, effects, k, j)


@inlined
def ask_loop(S, effects, k, j):
    """What the velocity loop of a motor of a lane asks for; at the first stage its integral is brought up to date."""
    driven, trail, before = S[AT.MODE + j] == DRIVEN, S[AT.TRAIL_S + j], S[AT.TRAIL + j]
    if k == 0:
        grown = trail - before if before == before else 0.0
        S[AT.BEHIND + j] = hooks.wound(effects, S[AT.BEHIND + j] + grown) if driven else 0.0
        S[AT.TRAIL + j] = trail
    behind = hooks.wound(effects, S[AT.BEHIND + j] + (trail - S[AT.TRAIL + j]))
    asked = hooks.loop(effects, S[AT.ERROR + j], behind)
    S[AT.HELD + j] = asked if driven and asked == asked else S[AT.HELD + j]


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
        M_r = axle_torque(S[AT.LEVER + j], S[AT.AT_RIM + j], S[AT.ROLLS + j] * S[AT.U_F_N + j], S[AT.SIGN + j])
        load = S[AT.LOAD + j] = S[AT.GEARED + j] * M_r
        low, high = -S[AT.TORQUE_MAX + j], S[AT.TORQUE_MAX + j]
        if fx is not None:
            load += S[AT.DRAG + j]
        if fx is not None and LIMITED[len(fx)]:
            low, high = S[AT.LOW + j], S[AT.HIGH + j]
        S[AT.TORQUE + j], S[AT.ACC + MOTORS + j] = motor_equation(
            S[AT.INERTIA + j], S[AT.INV_J + j], load, S[AT.ACC + MOTORS + j], S[AT.HELD + j], low, high
        )


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
    """Fix for a step what eq. 21 makes of a motor's efficiency, and its torque: the commanded one, or eq. 30's."""
    given = S[AT.GIVEN + j]
    torque = given if given == given else shared
    gear, inertia = reflect(S[AT.TAU + j], S[AT.J_M + j], S[AT.J_W + j], S[AT.GEAR + j])
    S[AT.HELD + j] = torque if S[AT.MODE + j] == TORQUE else math.nan
    S[AT.GEARED + j], S[AT.INERTIA + j], S[AT.INV_J + j] = gear, inertia, 1.0 / inertia


@inlined
def feed_back(S, fx, dt):
    """What the next step takes from the start of this one: torques (eq. 30) and efficiencies (eq. 23)."""
    stand = 0
    if fx is not None and BRISTLED[len(fx)]:
        stand = standing_motors(S, fx, dt)
    for j in range(4 * LANES):
        torque = S[AT.TORQUE + j]
        drag = S[AT.DRAG + j] if fx is not None else 0.0
        measured = S[AT.GIVEN + j] if S[AT.MODE + j] == PRESCRIBED else math.nan
        drives = 1.0 if drives_next(  # a choice of places is no vector code
            torque - drag, S[AT.V + MOTORS + j], S[AT.J_M + j] * S[AT.ACC + MOTORS + j], S[AT.GEAR + j],
            S[AT.DRIVING + j], S[AT.BRAKING + j], measured - drag,
        ) else 0.0  # fmt: skip
        S[AT.PREVIOUS + j] = torque
        S[AT.GEAR + j] = drives * S[AT.DRIVING + j] + (1.0 - drives) * S[AT.BRAKING + j]
    if stand > 0:
        for j in range(4 * LANES):
            S[AT.GEAR + j] = S[AT.BETWEEN + j] if S[AT.STANDS + j] > 0.0 else S[AT.GEAR + j]


@inlined
def standing_motors(S, fx, dt):
    """How many motors their gears hold at rest; which ones, and by which inverse efficiency (`loop.next_efficiency`).

    Of motors that do not stand the last is no number of use.
    """
    stand = 0
    for motor in range(4):
        for e in range(LANES):
            j = motor * LANES + e
            stiff, _ = hooks.bristle(effects_at(S, fx, e, 0.0), 0.0)
            M_gear, (brought, taken) = weighed(S, j, dt)
            measured = S[AT.GIVEN + j] == S[AT.GIVEN + j] and S[AT.MODE + j] == PRESCRIBED
            stands = sticks(M_gear, brought, taken, S[AT.GEAR + j], S[AT.DRIVING + j], S[AT.BRAKING + j])
            S[AT.STANDS + j] = 1.0 if stands and not measured and stiff > 0.0 else 0.0
            stand += S[AT.STANDS + j] > 0.0
    if stand > 0:
        for j in range(4 * LANES):
            _, (brought, taken) = weighed(S, j, dt)
            S[AT.BETWEEN + j] = S[AT.GEAR + j] * brought / taken
    return stand


@inlined
def weighed(S, j, dt):
    """With effects: torque of a motor less what drags on its shaft, and `transmission.impulses`."""
    M_gear = S[AT.TORQUE + j] - S[AT.DRAG + j]
    return M_gear, impulses(M_gear, S[AT.V + MOTORS + j], S[AT.LOAD + j], S[AT.J_M + j], S[AT.INERTIA + j], dt)


@inlined
def next_knot(S, e, position, velocity, behind, first, row, turned, filtered, rigid=None):
    """A lane's commands at the knot in `row`.

    Recorded rotations are `turned` times the true ones, and trail them by what is `behind` (n, 8: angles and speeds)
    for each second of a low-pass of `filtered` s; angles count from the knot in `first`, where both are the same.
    """
    for motor in range(motors_of(rigid)):
        j = motor * LANES + e
        p, v = position[row, motor], velocity[row, motor]
        if filtered != 0.0:
            p += filtered * (behind[row, motor] - behind[first, motor])
            v += filtered * behind[row, 4 + motor]
        if turned != 1.0:
            p, v = p / turned, v / turned
        S[AT.P_1 + j], S[AT.V_1 + j] = p, v


@inlined
def leave_knot(S):
    """The knot ahead is the one behind."""
    for j in range(4 * LANES):
        S[AT.P_0 + j], S[AT.V_0 + j] = S[AT.P_1 + j], S[AT.V_1 + j]


@inlined
def cubics(S):
    """Coefficients of the commands' cubics (see `loop.hermite`)."""
    for j in range(4 * LANES):
        S[AT.C_2 + j], S[AT.C_3 + j] = cubic_between(
            S[AT.P_0 + j], S[AT.P_1 + j], S[AT.V_0 + j], S[AT.V_1 + j], S[AT.GOING + j]
        )  # fmt: skip


# ----------------------------------------------------------------------
# Many rovers side by side: RK4 steps of LANES rovers at once, in the processor's vector units.
#
# All numbers of a block of rovers stand in one flat array `S`, quantity by quantity: component i of lane e at
# ``S[AT.quantity + i * LANES + e]``. Loops over lanes are innermost and their bodies have no branches and no calls,
# which is what compilers make vector code of (short bodies over all motors at once: a loop over eight lanes would
# be written out before it is looked at). Lanes know nothing of each other: results do not depend on which rovers
# share a block, and one that diverges disturbs no other.
#
# `fx` is None for the paper's model. In the extended one it is one of EXTENDED (`lane_layout`), whose lengths the
# compiler knows, and effects' parameters are in `S`. `rigid` is None, or anything else in what is compiled for rigid
# robots: these have no back module, and computing its four wheels as well took half as long again.
# ----------------------------------------------------------------------


NEAR = 0.05
"""How far a module may turn (rad) until sine and cosine of its yaw are taken anew: what `turn_by` knows."""


@inlined
def body_of(S, at):
    """A module of the lane whose numbers begin at `at`."""
    return Body(
        S[at], S[at + LANES], S[at + 2 * LANES], S[at + 3 * LANES], S[at + 4 * LANES], S[at + 5 * LANES],
        S[at + 6 * LANES], S[at + 7 * LANES], S[at + 8 * LANES], S[at + 9 * LANES], S[at + 10 * LANES],
        S[at + 11 * LANES], S[at + 12 * LANES],
    )  # fmt: skip


@inlined
def forces_now(body, fx, pair, soil, motor, rim, angle, kept_f, kept_b):
    """`contact.pair_forces` at an instant."""
    return pair_forces(within_friction_lanes, body, fx, pair, soil, motor, rim, angle, kept_f, kept_b, None)


@inlined
def ground_of(S, at):
    """What the modules of the lane whose numbers begin at `at` share."""
    return CommonTerms(
        S[at], S[at + LANES], S[at + 2 * LANES], S[at + 3 * LANES], S[at + 4 * LANES], S[at + 5 * LANES],
        S[at + 6 * LANES],
    )  # fmt: skip


@inlined
def motion_of(S, q, v):
    """A module's motion from coordinates at `q` and rates at `v`."""
    return Motion(S[q], S[q + LANES], S[q + 2 * LANES], S[v], S[v + LANES], S[v + 2 * LANES])


@inlined
def modules_of(rigid):
    """How many modules each of the rovers has."""
    return 2 if rigid is None else 1


@inlined
def motors_of(rigid):
    """How many motors each of the rovers has."""
    return 4 if rigid is None else 2


@inlined
def face(S, least, rigid):
    """Sines and cosines of yaws that have turned by `least` (rad) since they were last taken.

    In between, `turn_by` does the rest. A lane's depend on its own yaws only, whoever else has turned.
    """
    for e in range(LANES):
        for module in range(modules_of(rigid)):
            j, yaw = module * LANES + e, S[AT.Q_S + (3 * module + 2) * LANES + e]
            s, c = sincos(yaw)
            before, s_0, c_0 = S[AT.FACING + j], S[AT.SINE + j], S[AT.COSINE + j]
            turned = abs(yaw - before) >= least
            S[AT.FACING + j] = yaw if turned else before
            S[AT.SINE + j], S[AT.COSINE + j] = s if turned else s_0, c if turned else c_0


# ----------------------------------------------------------------------
# Laws: they branch, so that what they do at a stage is found lane after lane, before the loops that have no branches.
# ----------------------------------------------------------------------


@inlined
def six(S, at):
    """Six numbers of a lane."""
    a, b, c, d = four(S, at)
    return a, b, c, d, S[at + 4 * LANES], S[at + 5 * LANES]


def effects_and_forces(S: Any, fx: Any, laws: Any, e: int, t: float) -> Any:
    """With effects: those of a lane at `t` (s) since its start, and what its laws do where there are `laws`."""
    raise NotImplementedError("only for compiled code")


@overload(effects_and_forces, jit_options={"forceinline": True}, strict=False)
def _effects_and_forces(S: Any, fx: Any, laws: Any, e: int, t: float) -> Any:
    if not isinstance(laws, types.Array):
        return lambda S, fx, laws, e, t: effects_at(S, fx, e, t)

    def both(S, fx, laws, e, t):
        at = AT.LAW_FORCES + e
        wheels = at + ACROSS_AT * LANES
        forces = LawForces(
            six(S, at), S[at + JOINT_AT * LANES], four(S, wheels) + four(S, wheels + 4 * LANES),
            four(S, at + ALONG_AT * LANES), four(S, at + SHAFT_AT * LANES),
        )  # fmt: skip
        return with_forces(lane_effects(fx, S, AT.EFFECTS + e, S[AT.EFFECTS + e] + t), forces)

    return both


@inlined
def facing(S, e, module):
    """Sine and cosine of a module's yaw at the stage."""
    j = module * LANES + e
    turn = S[AT.Q_S + (3 * module + 2) * LANES + e] - S[AT.FACING + j]
    return turn_by(turn, S[AT.SINE + j], S[AT.COSINE + j])


@inlined
def note_lane(S, e, motion, rigid):
    """Note what laws see of a lane's rover."""
    front, behind = motion_of(S, AT.Q_S + e, AT.V_S + e), motion_of(S, AT.Q_S + 3 * LANES + e, AT.V_S + 3 * LANES + e)
    th, ta = four(S, AT.Q_S + MOTORS + e), four(S, AT.TAU + e)
    turned = ta[0] * th[0], ta[1] * th[1], ta[2] * th[2], ta[3] * th[3]
    note_level(motion, rigid is None, turned, front, behind, facing(S, e, FRONT) + facing(S, e, BEHIND))


@inlined
def where_it_acts(S, e, motion, number):
    """The module and the motion of what the force at `number` among `LawForces` acts on."""
    if number < ACROSS_AT:
        module = 1 if number >= 3 and number < JOINT_AT else 0
        own = motion.forward[module], motion.left[module], 0.0, 0.0, motion.x[module], motion.y[module], 0.0
        return module, LocalMotion(own[0], own[1], own[2], own[3], own[4], own[5], own[6])
    if number >= SHAFT_AT:
        motor = number - SHAFT_AT
        module = motor // 2
        rim, angle = S[AT.RIM + motor * LANES + e], motion.angle[motor]
        return module, LocalMotion(rim, 0.0, 0.0, angle, motion.x[module], motion.y[module], 0.0)
    alone = number < ALONG_AT
    wheel = number - ACROSS_AT if alone else 2 * (number - ALONG_AT)
    motor, module = wheel // 2, wheel // 4
    body = body_of(S, (AT.BODY_F if module == 0 else AT.BODY_B) + e)
    side, end = 1.0 if motor % 2 == 1 else -1.0, (1.0 if wheel % 2 == 0 else -1.0) if alone else 0.0
    s_g, c_g = facing(S, e, module)
    p_x = motion.forward[module] - side * (motion.turn[module] * body.half_y)
    p_y = motion.left[module] + end * (motion.turn[module] * body.half_x)
    x = motion.x[module] - side * s_g * body.half_y + end * (c_g * body.half_x)
    y = motion.y[module] + side * c_g * body.half_y + end * (s_g * body.half_x)
    F_f, F_b = (body.F_rf, body.F_rb) if side < 0.0 else (body.F_lf, body.F_lb)
    load = F_f + F_b if end == 0.0 else (F_f if end > 0.0 else F_b)
    return module, LocalMotion(p_x, p_y, S[AT.RIM + motor * LANES + e] - p_x, motion.angle[motor], x, y, load)


@called
def add_law(S, e, law, motion, t):
    """Add what a law of a lane does at `t` (s)."""
    first, count = range_of(int(law.where))
    for number in range(first, first + count):
        module, own = where_it_acts(S, e, motion, number)
        S[AT.LAW_FORCES + number * LANES + e] += value(law, motion, bent(motion), t, module, own)


@inlined
def find_forces(S, laws, t, rigid):
    """What laws do in all lanes (`force_law.LawForces`) at the stage, `t` seconds after their starts."""
    for j in range(FORCES * LANES):
        S[AT.LAW_FORCES + j] = 0.0
    for e in range(LANES):
        own, now = laws[int(S[AT.LAWS + e])], S[AT.EFFECTS + e] + t
        motion = own.motion
        note_lane(S, e, motion, rigid)
        for law in (own.force_law, own.force_law_2, own.force_law_3):
            if law.size != 0.0:
                add_law(S, e, law, motion, now)


@inlined
def begin_stage(S, fx, s, rigid):
    """Motors' commands `s` seconds after the knot, and what motors do that follow them.

    Returns
    -------
    rolls : bool
        Whether all wheels turn so fast that `rolling_sign` is ±1 to the bit, which spares an exponential for each.
    near : bool
        Whether no module has turned too far for `turn_by` since its sine and cosine were last taken.
    """
    rolls, near = 0, 0
    for e in range(LANES):
        for motor in range(motors_of(rigid)):
            rolls += abs(follow_command(S, fx, motor * LANES + e, s)) > 20.0 * ROLLING_WIDTH
        for module in range(modules_of(rigid)):
            yaw = S[AT.Q_S + (3 * module + 2) * LANES + e]
            near += abs(yaw - S[AT.FACING + module * LANES + e]) < NEAR
    return rolls == motors_of(rigid) * LANES, near == modules_of(rigid) * LANES


@inlined
def kept_of(S, at):
    """What the four wheels of a module remember (see `layout.MEMORY`)."""
    lags, wound = four(S, at), four(S, at + 8 * LANES)
    along, across = four(S, at + 16 * LANES), four(S, at + 24 * LANES)
    return (
        (lags[0], wound[0], along[0], across[0]), (lags[1], wound[1], along[1], across[1]),
        (lags[2], wound[2], along[2], across[2]), (lags[3], wound[3], along[3], across[3]),
    )  # fmt: skip


@inlined
def put_rates(S, fx, at, right, left):
    """How fast what the wheels of a module remember changes."""
    put4(S, at, right.rate_f, right.rate_b, left.rate_f, left.rate_b)
    if WOUND[len(fx)]:
        put4(S, at + 8 * LANES, right.wound_f, right.wound_b, left.wound_f, left.wound_b)
    if BRISTLED[len(fx)]:
        put4(S, at + 16 * LANES, right.bent_f[0], right.bent_b[0], left.bent_f[0], left.bent_b[0])
        put4(S, at + 24 * LANES, right.bent_f[1], right.bent_b[1], left.bent_f[1], left.bent_b[1])


@inlined
def move_modules(S, fx, laws, t):
    """Accelerations of both modules, and what the motors' wheels meet, at the stage."""
    for e in range(LANES):
        ground = ground_of(S, AT.GROUND + e)
        q, v, lag = AT.Q_S + e, AT.V_S + e, AT.LAG_S + e
        f, b = motion_of(S, q, v), motion_of(S, q + 3 * LANES, v + 3 * LANES)
        turn_f, turn_b = f.gamma - S[AT.FACING + e], b.gamma - S[AT.FACING + LANES + e]
        s_f, c_f = turn_by(turn_f, S[AT.SINE + e], S[AT.COSINE + e])
        s_b, c_b = turn_by(turn_b, S[AT.SINE + LANES + e], S[AT.COSINE + LANES + e])
        front, back = body_of(S, AT.BODY_F + e), body_of(S, AT.BODY_B + e)
        effects = effects_and_forces(S, fx, laws, e, t)
        rims, angles = four(S, AT.RIM + e), (0.0, 0.0, 0.0, 0.0)
        if fx is not None:
            th, ta = four(S, q + MOTORS), four(S, AT.TAU + e)
            angles = th[0] * ta[0], th[1] * ta[1], th[2] * ta[2], th[3] * ta[3]
        right_f, left_f = module_wheels(
            forces_now,
            front,
            ground,
            effects,
            FRONT,
            f,
            s_f,
            c_f,
            rims[:2],
            angles[:2],
            kept_of(S, lag),
        )
        right_b, left_b = module_wheels(
            forces_now,
            back,
            ground,
            effects,
            BEHIND,
            b,
            s_b,
            c_b,
            rims[2:],
            angles[2:],
            kept_of(S, lag + 4 * LANES),
        )
        on_f, on_b, _, _, _ = planar_accelerations(
            front, back, ground, effects, f, b, (s_f, c_f, s_b, c_b), (right_f, left_f, right_b, left_b)
        )
        a = AT.ACC + e
        S[a], S[a + LANES], S[a + 2 * LANES] = on_f
        S[a + 3 * LANES], S[a + 4 * LANES], S[a + 5 * LANES] = on_b
        put4(S, AT.AT_RIM + e, right_f.at_rim, left_f.at_rim, right_b.at_rim, left_b.at_rim)
        if fx is not None and LAGGING[len(fx)]:
            put4(S, AT.U_F_N + e, right_f.u_F_n, left_f.u_F_n, right_b.u_F_n, left_b.u_F_n)
            put_rates(S, fx, AT.LAG_RATE + e, right_f, left_f)
            put_rates(S, fx, AT.LAG_RATE + 4 * LANES + e, right_b, left_b)


@inlined
def move_rigid(S, fx, laws, t):
    """Forces and accelerations at a stage of rigid robots: of the one module that they have."""
    for e in range(LANES):
        ground, body = ground_of(S, AT.GROUND + e), body_of(S, AT.BODY_F + e)
        q, v = AT.Q_S + e, AT.V_S + e
        at, effects = motion_of(S, q, v), effects_and_forces(S, fx, laws, e, t)
        s, c = turn_by(at.gamma - S[AT.FACING + e], S[AT.SINE + e], S[AT.COSINE + e])
        rims, angles = (S[AT.RIM + e], S[AT.RIM + LANES + e]), (0.0, 0.0)
        if fx is not None:
            th = q + MOTORS
            angles = S[th] * S[AT.TAU + e], S[th + LANES] * S[AT.TAU + LANES + e]
        kept = kept_of(S, AT.LAG_S + e)
        right, left = module_wheels(forces_now, body, ground, effects, FRONT, at, s, c, rims, angles, kept)
        a = AT.ACC + e
        S[a], S[a + LANES], S[a + 2 * LANES] = rigid_accelerations(body, ground, effects, at, s, c, right, left)
        S[AT.AT_RIM + e], S[AT.AT_RIM + LANES + e] = right.at_rim, left.at_rim
        if fx is not None and LAGGING[len(fx)]:
            S[AT.U_F_N + e], S[AT.U_F_N + LANES + e] = right.u_F_n, left.u_F_n
            put_rates(S, fx, AT.LAG_RATE + e, right, left)


@inlined
def leave_out_back(S):
    """Accelerations, forces and memory of a back module and its motors, which rigid robots do not have."""
    for j in range(3 * LANES):
        S[AT.ACC + 3 * LANES + j] = 0.0
    for j in range(2 * LANES):
        S[AT.AT_RIM + 2 * LANES + j] = S[AT.ACC + MOTORS + 2 * LANES + j] = 0.0
    for k in range(4, MEMORY, 8):
        for j in range(4 * LANES):
            S[AT.LAG_RATE + k * LANES + j] = 0.0


@inlined
def next_state(S, k, dt):
    """From stage `k` to the next; after the last one, advance the state.

    Each branch has a loop of its own, in which the stage's number is known and what it does not need is left out.
    """
    if k == 0:
        for j in range(SIZE * LANES):
            step_lane(S, STAGE[0], dt, j)
    elif k < 3:
        for j in range(SIZE * LANES):
            step_lane(S, k, dt, j)
    else:
        for j in range(SIZE * LANES):
            step_lane(S, STAGE[3], dt, j)
            S[AT.Q + j], S[AT.V + j] = S[AT.Q_S + j], S[AT.V_S + j]


@inlined
def step_lane(S, k, dt, j):
    """`steps.next_stage` of a coordinate of a lane."""
    S[AT.Q_S + j], S[AT.V_S + j], S[AT.FIRST + j], S[AT.SUM + j] = next_stage(
        k, dt, S[AT.Q + j], S[AT.V + j], S[AT.V_S + j], S[AT.ACC + j], S[AT.FIRST + j], S[AT.SUM + j]
    )


@inlined
def next_lag(S, count, k, dt):
    """The first `count` numbers of what wheels remember from stage `k` to the next; after the last one advance them."""
    for j in range(count * LANES):
        x, total = next_stage_of_lag(k, dt, S[AT.LAG + j], S[AT.LAG_RATE + j], S[AT.SUM_LAG + j])
        S[AT.LAG_S + j], S[AT.SUM_LAG + j] = x, total
        S[AT.LAG + j] = x if k == 3 else S[AT.LAG + j]


@inlined
def stage(S, fx, k, s, elapsed, dt, turning, rigid=None, laws=None):
    """Stage `k` of a step that begins `s` seconds after a knot and `elapsed` seconds after the start.

    Motors' torques are computed at the first `turning` stages: at all where one is not prescribed, at the first where
    anybody asks for torques. `laws` are as in `window_lanes.run_windows`.
    """
    if k == 0:  # whoever turns: of what it knows to stay, the compiler makes a version of everything
        hold_torques(S)
    late = stage_time(k, dt)
    rolls, near = begin_stage(S, fx, s + late, rigid)
    at_knot = k == 0 and s == 0.0
    if at_knot or not near:
        face(S, 0.0 if at_knot else NEAR, rigid)
    if laws is not None:
        find_forces(S, laws, elapsed + late, rigid)
    if rigid is None:
        move_modules(S, fx, laws, elapsed + late)
    else:
        move_rigid(S, fx, laws, elapsed + late)
    if k < turning:
        if fx is not None:
            drag_motors(S, fx, laws, k, elapsed + late, rigid)
        if not rolls:
            smooth_signs(S)
        turn_motors(S, fx)
        if k == 0:
            feed_back(S, fx, dt)


@inlined
def end_stage(S, fx, k, dt):
    """To the next stage, and after the last one to the next step."""
    next_state(S, k, dt)
    if fx is not None and LAGGING[len(fx)]:
        next_lag(S, MEMORY if BRISTLED[len(fx)] else 16 if WOUND[len(fx)] else 8, k, dt)


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
