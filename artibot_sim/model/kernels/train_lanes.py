"""Windows of robots of three modules or more, side by side: semi-implicit steps on a plane, LANES rovers at once.

As `lanes` has it of two modules: numbers of a block of rovers stand in one flat array, loops over lanes are innermost,
and their bodies have no branches and no calls, so that compilers make vector code of them. Here a block holds what
`AT` says module after module. A module's equations are those of `equations.plane`; of each joint two rows are left on a
plane, x and y, and with effects the torque in its yaw as a third one. The joints' system is block-tridiagonal, as in
`train_loop`, whose semi-implicit steps these are to rounding.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba.core import types
from numba.extending import overload
from numpy.typing import NDArray

from artibot_sim.model.effects import hooks
from artibot_sim.model.effects.force_law import NotedMotion, numbers_of
from artibot_sim.model.equations.contact import load_transfer, pair_forces, within_friction_lanes
from artibot_sim.model.equations.dynamics import joint_torque
from artibot_sim.model.equations.plane import (
    Body,
    CommonTerms,
    from_origin,
    joint_end,
    module_forces,
    module_pairs,
)
from artibot_sim.model.equations.transmission import (
    PRESCRIBED,
    axle_torque,
    drives_next,
    follow,
    impulses,
    motor_equation,
    reflect,
    rolling_sign,
    sticks,
)
from artibot_sim.model.kernels.compilation import inlined, kernel, line_up_stack
from artibot_sim.model.kernels.elementary import cubic_at, cubic_between, sincos, turn_by
from artibot_sim.model.kernels.lane_layout import (
    BRISTLED,
    EFFECT_VALUES,
    LAGGING,
    LANES,
    LIMIT_Q,
    LIMIT_V,
    LIMITED,
    aligned,
    beginnings,
    lane_effects,
    put4,
    with_laws,
)
from artibot_sim.model.kernels.lanes import body_of, forces_now, ground_of, motion_of
from artibot_sim.model.kernels.layout import BEHIND, FRONT, GAMMA, THETA_L, THETA_R, X, Y, Z
from artibot_sim.model.kernels.plane_step import coplanar, module_level, standing
from artibot_sim.model.kernels.sampling import (
    COLUMNS,
    ENCODER_SCALE,
    POSE_AT,
    PUSH_AT,
    SPEED_AT,
    TORQUE_AT,
    TORQUE_SCALE,
    TURN_BACK_AT,
    VELOCITY_FILTER,
    YAW_BACK_AT,
    LaneRows,
    Wanted,
    sample_lane,
)
from artibot_sim.model.kernels.steps import semi_implicit
from artibot_sim.model.kernels.train_loop import of_one
from artibot_sim.model.kernels.window_lanes import item_of

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

SIZE = 5
"""Coordinates of a module that move on a plane: x, y, gamma, and its motors' angles."""

PLACES = (X, Y, GAMMA, THETA_R, THETA_L)
"""Where they stand among the eight in space."""

ANGLES = 3 * LANES
"""Where the motors begin among them."""

_SIZES = {
    # state, accelerations; what the wheels remember (`layout.MEMORY`, of four wheels), and its rates
    "Q": SIZE, "V": SIZE, "ACC": SIZE, "LAG": 16, "LAG_RATE": 16, "FACING": 1, "SINE": 1, "COSINE": 1,
    # commands: angles and speeds at both ends of a cubic, its last coefficients; the inverse of its length
    "P_0": 2, "V_0": 2, "P_1": 2, "V_1": 2, "C_2": 2, "C_3": 2, "GOING": 2,
    # commanded torque (NaN: eq. 30), eq. 30's factor, and the sum of the front motors' torques a step before
    "GIVEN": 2, "SHARE": 2, "FRONT": 2,
    # motors: torque now, drag in it, load of their wheels, inverse efficiency; constants
    "TORQUE": 2, "DRAG": 2, "LOAD": 2, "GEAR": 2, "STANDS": 2, "BETWEEN": 2,
    "MODE": 2, "TAU": 2, "R_W": 2, "J_M": 2, "J_W": 2, "DRIVING": 2, "BRAKING": 2, "TORQUE_MAX": 2,
    "DAMPING": 2, "STIFFNESS": 2, "LEVER": 2, "ROLLS": 2, "SHAFT": 2,
    "BODY": len(Body._fields), "GROUND": len(CommonTerms._fields),
    # the joint behind: where it sits in both modules, its columns of gamma, the root of what each rad/s² adds to its
    # torque; its block of the system, the one that couples it with the next joint, and its multipliers
    "O_AHEAD": 1, "O_BEHIND": 1, "AHEAD": 2, "BEHIND": 2, "ROOT": 1, "BLOCK": 6, "NEXT": 9, "RIGHT": 3,
    # whether a coordinate is sound, and in how many rows it was
    "SOUND": SIZE, "KEPT": SIZE,
    # parameters of effects; row of the robot's laws
    "EFFECTS": EFFECT_VALUES, "LAWS": 1,
}  # fmt: skip

AT = beginnings(_SIZES)
"""Where each quantity of a module begins, from where the module begins in a block."""

MODULE = LANES * sum(_SIZES.values())
"""Size of a module in a block."""


class TrainItems(NamedTuple):
    """What items run on, as compiled code takes it: n items, p prepared robots, k knots, m samples asked for.

    Attributes
    ----------
    modules, joints : arrays of PARAMS_DTYPE, shapes (p, modules) and (p, modules − 1)
    eta : array, shape (p, 2 modules)
        Efficiencies of a first step.
    effects : array, shape (r, modules, EFFECT_VALUES)
        Of r robots.
    sensors : array, shape (p, 8)
        Rows of SensorErrors.
    modes : array of int, shape (p, 2 modules)
    share : array, shape (p, modules)
        Eq. 30's factors.
    position, velocity, torque, late_angle, late_speed : array, shape (k, 2 modules)
        Knots of all tables, one after the other, side by side; for the last two see `MotorTable.behind`.
    robot, fx, first, knots : array of int, shape (n,)
        Which prepared robot, row of `effects`, first knot in `position`, and how many intervals follow.
    q, v : array, shape (n, modules, 8)
    t : array, shape (n,)
    memory : array, shape (n, modules, 16)
    plan : array of int, shape (n,)
        Row of `pairs`.
    pairs : array of int, shape (plans, modules)
        Where the samples of each pair of neighbours begin in `at`, and after the last one where they end.
    at, kind, place : array, shape (m,)
        When to sample what, plan after plan, pair after pair; and where it stands in its plan.
    to : array of int, shape (n,)
        Where an item's results begin in the output.
    """

    modules: NDArray[np.void]
    joints: NDArray[np.void]
    eta: Array
    effects: Array
    sensors: Array
    modes: Indices
    share: Array
    position: Array
    velocity: Array
    torque: Array
    late_angle: Array
    late_speed: Array
    robot: Indices
    fx: Indices
    first: Indices
    knots: Indices
    q: Array
    v: Array
    t: Array
    memory: Array
    plan: Indices
    pairs: Indices
    at: Array
    kind: Indices
    place: Indices
    to: Indices


class TrainBuffers(NamedTuple):
    """What one thread writes into: a block, its rows pair by pair, and the samples of an item."""

    S: Array
    rows: Array
    samples: Array


def buffers(modules: int, rows: int, samples: int) -> TrainBuffers:
    """Fresh ones, for items of at most `rows` rows and `samples` samples."""
    return TrainBuffers(
        aligned(modules * MODULE), aligned((modules - 1) * rows * COLUMNS * LANES), np.empty(samples)
    )  # fmt: skip


class JointPoint(NamedTuple):
    """Where a joint sits in a module: all that `plane.joint_end` asks of a body."""

    O_x: float


# ----------------------------------------------------------------------
# Which items stand on a plane, and items into lanes.
# ----------------------------------------------------------------------


@kernel
def find_level(work, fx, out):
    """Which items stand on a plane only, into `out` (n,); `fx` is None, or an array of their robots' effects."""
    for k in range(len(out)):
        r = work.robot[k]
        modules, joints, q, v = work.modules[r], work.joints[r], work.q[k], work.v[k]
        level = True
        for i in range(len(modules)):
            own = of_one(None if fx is None else fx[work.fx[k]], i)
            level = level and module_level(modules[i].front, modules[i], own, min(i, 1), q[i], v[i])
        for j in range(len(joints)):
            level = level and coplanar(joints[j], q[j, Z], q[j + 1, Z])
        out[k] = level


@inlined
def effects_of(S, fx, b, e, t):
    """With effects: those of the module at `b` in a lane, `t` seconds after its start."""
    if fx is not None:
        at = b + AT.EFFECTS + e
        return lane_effects(fx, S, at, S[at] + t)
    return None


@inlined
def noted(S, i, e):
    """What laws of module `i` of a lane see: as `train_loop.note_pair` notes it."""
    k = max(i, 1)
    f, b, ahead = e, k * MODULE + e, (k - 1) * MODULE + e
    front, back = motion_of(S, f + AT.Q, f + AT.V), motion_of(S, b + AT.Q, b + AT.V)
    (s_f, c_f), (s_b, c_b) = (S[f + AT.SINE], S[f + AT.COSINE]), (S[b + AT.SINE], S[b + AT.COSINE])
    yaw, turn, th = AT.Q + 2 * LANES, AT.V + 2 * LANES, AT.Q + ANGLES
    return NotedMotion(
        (front.x, back.x), (front.y, back.y), (front.gamma, back.gamma),
        (c_f * front.x_dot + s_f * front.y_dot, c_b * back.x_dot + s_b * back.y_dot),
        (c_f * front.y_dot - s_f * front.x_dot, c_b * back.y_dot - s_b * back.x_dot),
        (front.gamma_dot, back.gamma_dot),
        (
            S[f + AT.TAU] * S[f + th], S[f + AT.TAU + LANES] * S[f + th + LANES],
            S[b + AT.TAU] * S[b + th], S[b + AT.TAU + LANES] * S[b + th + LANES],
        ),
        (S[b + yaw] - S[ahead + yaw],), (S[b + turn] - S[ahead + turn],),
    )  # fmt: skip


def effects_and_laws(S: Any, fx: Any, laws: Any, i: int, e: int, t: float) -> Any:
    """With effects: those of module `i` in a lane `t` seconds after its start, with its laws.

    `laws` (r, modules) are those of all robots, or None: see `run_trains`.
    """
    raise NotImplementedError("only for compiled code")


@overload(effects_and_laws, jit_options={"forceinline": True}, strict=False)
def _effects_and_laws(S: Any, fx: Any, laws: Any, i: int, e: int, t: float) -> Any:
    if not isinstance(laws, types.Array):
        return lambda S, fx, laws, i, e, t: effects_of(S, fx, i * MODULE, e, t)

    def both(S, fx, laws, i, e, t):
        at, own = i * MODULE + AT.EFFECTS + e, laws[int(S[AT.LAWS + e]), i]
        three_laws = numbers_of(own.force_law), numbers_of(own.force_law_2), numbers_of(own.force_law_3)
        return with_laws(lane_effects(fx, S, at, S[at] + t), three_laws, noted(S, i, e))

    return both


@inlined
def load_module(S, e, b, work, k, i, fx):
    """Module `i` of item `k` into lane `e`, where the module begins at `b`."""
    r, at = work.robot[k], b + e
    p, q, v = work.modules[r, i], work.q[k, i], work.v[k, i]
    if fx is not None:
        for n in range(EFFECT_VALUES):
            S[at + AT.EFFECTS + n * LANES] = work.effects[work.fx[k], i, n]
        S[at + AT.EFFECTS], S[at + AT.LAWS] = work.t[k], work.fx[k]
    for c in range(SIZE):
        S[at + AT.Q + c * LANES], S[at + AT.V + c * LANES] = q[PLACES[c]], v[PLACES[c]]
        S[at + AT.SOUND + c * LANES], S[at + AT.KEPT + c * LANES] = 1.0, 0.0
    for n in range(16):
        S[at + AT.LAG + n * LANES] = work.memory[k, i, n]
    body = standing(p.front, p, effects_of(S, fx, b, e, 0.0), min(i, 1), q[Z])
    for n in range(len(body)):
        S[at + AT.BODY + n * LANES] = body[n]
    ground = CommonTerms(p.u_w, p.g_x, p.g_y, p.A_joint, 1.0, p.load, p.pitching)
    for n in range(len(ground)):
        S[at + AT.GROUND + n * LANES] = ground[n]
    for side in range(2):
        load_motor(S, at + side * LANES, p, p.right_front if side == 0 else p.left_front, work, r, 2 * i + side)
    if i < work.joints.shape[1]:
        joint = work.joints[r, i]
        S[at + AT.O_AHEAD], S[at + AT.O_BEHIND] = joint.front.O_x, joint.back.O_x


@inlined
def load_motor(S, j, p, unit, work, r, motor):
    """One motor of a module into a lane, where its numbers begin at `j`."""
    mode = work.modes[r, motor]
    S[j + AT.MODE], S[j + AT.TAU], S[j + AT.R_W], S[j + AT.SHAFT] = mode, unit.tau, unit.r_w, unit.geared
    S[j + AT.J_M], S[j + AT.J_W], S[j + AT.TORQUE_MAX] = unit.J_m, unit.J_w, unit.torque_max
    S[j + AT.DRIVING], S[j + AT.BRAKING], S[j + AT.GEAR] = 1.0 / unit.eta_d, unit.eta_r, 1.0 / work.eta[r, motor]
    S[j + AT.DAMPING], S[j + AT.STIFFNESS], S[j + AT.TORQUE] = 0.0, 0.0, 0.0
    if mode == PRESCRIBED:
        S[j + AT.DAMPING], S[j + AT.STIFFNESS] = 2.0 * p.A_motor, p.A_motor * p.A_motor
    S[j + AT.SHARE], S[j + AT.FRONT] = work.share[r, motor // 2], 0.0
    S[j + AT.LEVER], S[j + AT.ROLLS] = unit.r_w, 1.0
    if p.literal_eq22:
        S[j + AT.LEVER], S[j + AT.ROLLS] = unit.r_w + p.u_w, 0.0


@inlined
def next_knot(S, e, b, work, k, i, knot):
    """Module `i`'s commands of a lane at a knot of its item, as they were where its robot's sensors saw them so."""
    first, sensors = work.first[k], work.sensors[work.robot[k]]
    turned, filtered = sensors[ENCODER_SCALE], sensors[VELOCITY_FILTER]
    for side in range(2):
        j, row, c = b + e + side * LANES, first + knot, 2 * i + side
        p, v = work.position[row, c], work.velocity[row, c]
        if filtered != 0.0:
            p += filtered * (work.late_angle[row, c] - work.late_angle[first, c])
            v += filtered * work.late_speed[row, c]
        if turned != 1.0:
            p, v = p / turned, v / turned
        S[j + AT.P_1], S[j + AT.V_1] = p, v


@inlined
def load_knot(S, work, order, block, knot, h):
    """All commands from a knot to the next, `h` seconds later; lanes that have ended stay at their last."""
    going = 1.0 / h
    for i in range(work.modules.shape[1]):
        b = i * MODULE
        for j in range(b, b + 2 * LANES):
            S[j + AT.P_0], S[j + AT.V_0] = S[j + AT.P_1], S[j + AT.V_1]
        for e in range(LANES):
            k = item_of(order, block, e)
            last, pulled = work.knots[k], work.sensors[work.robot[k], TORQUE_SCALE]
            next_knot(S, e, b, work, k, i, min(knot + 1, last))
            for side in range(2):
                j = b + e + side * LANES
                given = work.torque[work.first[k] + min(knot, last), 2 * i + side]
                S[j + AT.GOING], S[j + AT.GIVEN] = (
                    going if knot < last else 0.0,
                    given / pulled if pulled != 1.0 else given,
                )
        for j in range(b, b + 2 * LANES):
            S[j + AT.C_2], S[j + AT.C_3] = cubic_between(
                S[j + AT.P_0], S[j + AT.P_1], S[j + AT.V_0], S[j + AT.V_1], S[j + AT.GOING]
            )


# ----------------------------------------------------------------------
# A module: its motors, wheels and ground, as if it were alone.
# ----------------------------------------------------------------------


@inlined
def forces_after(body, fx, pair, soil, motor, rim, angle, kept, dt):
    """`contact.pair_forces` of a motor's wheels as a step of `dt` takes them; at an instant where that is None."""
    return pair_forces(within_friction_lanes, body, fx, pair, soil, motor, rim, angle, kept[0], kept[1], dt)


@inlined
def dragging(S, fx, j, motor, speed):
    """With effects: what drags on a motor of a lane before its gear at a `speed` (rad/s), N m."""
    return hooks.drag(fx, motor, speed) + S[j + AT.SHAFT] * hooks.gear(fx, speed)


@inlined
def at_shaft(S, fx, j, motor, speed):
    """With effects: what laws ask of a motor of a lane at its shaft at a `speed` (rad/s), N m."""
    tau = S[j + AT.TAU]
    return hooks.shaft(fx, motor, tau * S[j + AT.Q + ANGLES], S[j + AT.R_W] * (tau * speed))


@inlined
def load_at(S, j, forces, omega):
    """M_r of eq. 22 for a motor of a lane whose wheels turn at `omega` (rad/s)."""
    return axle_torque(S[j + AT.LEVER], forces.at_rim, S[j + AT.ROLLS] * forces.u_F_n, rolling_sign(omega))


@inlined
def step_side(S, fx, effects, j, motor, on, kept, body, s, dt, free):
    """A motor of a module over a step, its numbers from `j` on; returns `contact.PairForces` of its wheels at the end.

    The wheels stand `on` a pair and a soil. A motor that is not prescribed, as some are where `free`, takes their slip
    implicitly, as `integrators.step_ahead` does.
    """
    theta, speed, tau, r_w = S[j + AT.Q + ANGLES], S[j + AT.V + ANGLES], S[j + AT.TAU], S[j + AT.R_W]
    c_2, c_3, angle = S[j + AT.C_2], S[j + AT.C_3], tau * theta
    d, d_dot, _ = cubic_at(S[j + AT.P_0], S[j + AT.V_0], c_2, c_3, s)
    d_ddot = 2.0 * c_2 + 3.0 * c_3 * (2.0 * s + dt)  # the mean over the step
    acceleration = follow(S[j + AT.DAMPING], S[j + AT.STIFFNESS], theta, speed, d, d_dot, d_ddot)
    gear, J = reflect(tau, S[j + AT.J_M], S[j + AT.J_W], S[j + AT.GEAR])
    prescribed, torque = S[j + AT.MODE] == PRESCRIBED, 0.0
    if free:
        now = forces_after(body, effects, on[0], on[1], motor, r_w * (tau * speed), angle, kept, None)
        load, inertia = gear * load_at(S, j, now, tau * speed), J + dt * gear * r_w * (now.slope * r_w) * tau
        low, high = -S[j + AT.TORQUE_MAX], S[j + AT.TORQUE_MAX]
        if effects is not None:
            drag = dragging(S, effects, j, motor, speed)
            load, inertia = load + drag, inertia + (dt * drag / speed if speed != 0.0 else 0.0)
            load += at_shaft(S, effects, j, motor, speed)
            if LIMITED[len(fx)]:
                low, high = hooks.limits(effects, speed, low, high)
        given = S[j + AT.GIVEN]
        held = given if given == given else S[j + AT.SHARE] * S[j + AT.FRONT]
        torque, own = motor_equation(inertia, 1.0 / inertia, load, None, held, low, high)
        acceleration = acceleration if prescribed else own
    new = speed + dt * acceleration
    forces = forces_after(body, effects, on[0], on[1], motor, r_w * (tau * new), angle, kept, dt)
    carried, drag = gear * load_at(S, j, forces, tau * new), 0.0
    needed = J * acceleration + carried
    if effects is not None:
        drag = dragging(S, effects, j, motor, new) + at_shaft(S, effects, j, motor, new)
        needed += drag
    S[j + AT.ACC + ANGLES], S[j + AT.DRAG], S[j + AT.LOAD] = acceleration, drag, carried
    S[j + AT.TORQUE] = (needed if prescribed else torque) if free else needed
    return forces


@inlined
def kept_of(S, at):
    """What the two wheels of a motor remember, the front one first (see `layout.MEMORY`)."""
    n = 4 * LANES
    front = S[at], S[at + n], S[at + 2 * n], S[at + 3 * n]
    at += LANES
    return front, (S[at], S[at + n], S[at + 2 * n], S[at + 3 * n])


@inlined
def put_rates(S, at, right, left):
    """How fast what the wheels of a module remember changes."""
    n = 4 * LANES
    put4(S, at, right.rate_f, right.rate_b, left.rate_f, left.rate_b)
    put4(S, at + n, right.wound_f, right.wound_b, left.wound_f, left.wound_b)
    put4(S, at + 2 * n, right.bent_f[0], right.bent_b[0], left.bent_f[0], left.bent_b[0])
    put4(S, at + 3 * n, right.bent_f[1], right.bent_b[1], left.bent_f[1], left.bent_b[1])


@inlined
def loaded(S, fx, j, number, body, ground, pairs, soils):
    """With effects: `contact.load_transfer` of a module whose lane begins at `j`, at the speeds of the step's start."""
    if hooks.height(fx) <= 0.0:
        return pairs
    tau_r, tau_l, r_r, r_l = S[j + AT.TAU], S[j + AT.TAU + LANES], S[j + AT.R_W], S[j + AT.R_W + LANES]
    angle, speed = j + AT.Q + ANGLES, j + AT.V + ANGLES
    rims = r_r * (tau_r * S[speed]), r_l * (tau_l * S[speed + LANES])
    angles = tau_r * S[angle], tau_l * S[angle + LANES]
    (r_f, r_b), (l_f, l_b) = kept_of(S, j + AT.LAG), kept_of(S, j + AT.LAG + 2 * LANES)
    return load_transfer(
        forces_now, body, fx, ground.pitching, pairs, soils, 2 * number, rims, angles, (r_f, r_b, l_f, l_b)
    )


@inlined
def step_module(S, fx, laws, i, s, t, dt, free):
    """Module `i` over a step without its joints."""
    b, number = i * MODULE, min(i, 1)  # of a pair, for effects: see `effects.parts`
    for e in range(LANES):
        j, effects = b + e, effects_and_laws(S, fx, laws, i, e, t)
        body, ground, at = body_of(S, j + AT.BODY), ground_of(S, j + AT.GROUND), motion_of(S, j + AT.Q, j + AT.V)
        s_g, c_g = S[j + AT.SINE], S[j + AT.COSINE]
        kept_r, kept_l = kept_of(S, j + AT.LAG), kept_of(S, j + AT.LAG + 2 * LANES)
        pair_r, pair_l, soil_r, soil_l = module_pairs(body, ground, effects, at, s_g, c_g)
        if fx is not None:
            pair_r, pair_l = loaded(S, effects, j, number, body, ground, (pair_r, pair_l), (soil_r, soil_l))
        on_r, on_l = (pair_r, soil_r), (pair_l, soil_l)
        right = step_side(S, fx, effects, j, 2 * number, on_r, kept_r, body, s, dt, free)
        left = step_side(S, fx, effects, j + LANES, 2 * number + 1, on_l, kept_l, body, s, dt, free)
        a, _, _ = module_forces(body, ground, effects, number, at, s_g, c_g, right, left)
        S[j + AT.ACC], S[j + AT.ACC + LANES], S[j + AT.ACC + 2 * LANES] = a
        if fx is not None and LAGGING[len(fx)]:
            put_rates(S, j + AT.LAG_RATE, right, left)


@inlined
def feed_back(S, fx, modules, dt, free):
    """What the next step takes from this one: the front motors' torques (eq. 30), and efficiencies (eq. 23).

    Motors turn as they do after the step.
    """
    for i in range(modules):
        for e in range(LANES if free[i] else 0):
            shared, j = S[AT.TORQUE + e] + S[AT.TORQUE + LANES + e], i * MODULE + AT.FRONT + e
            S[j], S[j + LANES] = shared, shared
    for i in range(modules):
        b = i * MODULE
        stand = 0
        if fx is not None and BRISTLED[len(fx)]:
            stand = standing_motors(S, fx, b, dt)
        for j in range(b, b + 2 * LANES):
            torque, drag = S[j + AT.TORQUE], S[j + AT.DRAG]
            measured = S[j + AT.GIVEN] if S[j + AT.MODE] == PRESCRIBED else math.nan
            drives = 1.0 if drives_next(  # a choice of places is no vector code
                torque - drag, S[j + AT.V + ANGLES], S[j + AT.J_M] * S[j + AT.ACC + ANGLES], S[j + AT.GEAR],
                S[j + AT.DRIVING], S[j + AT.BRAKING], measured - drag,
            ) else 0.0  # fmt: skip
            S[j + AT.GEAR] = drives * S[j + AT.DRIVING] + (1.0 - drives) * S[j + AT.BRAKING]
        if stand > 0:
            for j in range(b, b + 2 * LANES):
                S[j + AT.GEAR] = S[j + AT.BETWEEN] if S[j + AT.STANDS] > 0.0 else S[j + AT.GEAR]


@inlined
def standing_motors(S, fx, b, dt):
    """How many motors of the module at `b` their gears hold at rest; which ones, and by which inverse efficiency."""
    stand = 0
    for side in range(2):
        for e in range(LANES):
            j = b + side * LANES + e
            stiff, _ = hooks.bristle(effects_of(S, fx, b, e, 0.0), 0.0)
            M_gear, (brought, taken) = weighed(S, j, dt)
            measured = S[j + AT.GIVEN] == S[j + AT.GIVEN] and S[j + AT.MODE] == PRESCRIBED
            stands = sticks(M_gear, brought, taken, S[j + AT.GEAR], S[j + AT.DRIVING], S[j + AT.BRAKING])
            S[j + AT.STANDS] = 1.0 if stands and not measured and stiff > 0.0 else 0.0
            stand += S[j + AT.STANDS] > 0.0
    if stand > 0:
        for j in range(b, b + 2 * LANES):
            _, (brought, taken) = weighed(S, j, dt)
            S[j + AT.BETWEEN] = S[j + AT.GEAR] * brought / taken
    return stand


@inlined
def weighed(S, j, dt):
    """Torque of a motor less what drags on its shaft, and `transmission.impulses`."""
    M_gear = S[j + AT.TORQUE] - S[j + AT.DRAG]
    _, J = reflect(S[j + AT.TAU], S[j + AT.J_M], S[j + AT.J_W], S[j + AT.GEAR])
    return M_gear, impulses(M_gear, S[j + AT.V + ANGLES], S[j + AT.LOAD], S[j + AT.J_M], J, dt)


# ----------------------------------------------------------------------
# The joints. Of the torque T in a joint's yaw, T = T_0 + dt s (d/dt rate), the part that the step adds is the joint's
# third unknown over √(dt s): so its row is symmetric, and empty where the torque does not depend on the rate.
# ----------------------------------------------------------------------


@inlined
def inverses(S, j):
    """Inverses of mass and yaw inertia of the module whose lane begins at `j`."""
    return S[j + AT.BODY], S[j + AT.BODY + LANES]


@inlined
def twist(S, fx, laws, i, t, dt):
    """With effects: T_0 of the joint behind module `i`, which acts at once, and √(dt s)."""
    for e in range(LANES):
        f, k = i * MODULE + e, (i + 1) * MODULE + e
        yaw, turn, acc = AT.Q + 2 * LANES, AT.V + 2 * LANES, AT.ACC + 2 * LANES
        torque, slope = joint_torque(
            effects_and_laws(S, fx, laws, i + 1, e, t), S[k + yaw] - S[f + yaw], S[k + turn] - S[f + turn], dt
        )
        S[f + AT.ROOT] = math.sqrt(max(slope, 0.0))
        _, J_f = inverses(S, f)
        _, J_b = inverses(S, k)
        S[f + acc], S[k + acc] = S[f + acc] + J_f * torque, S[k + acc] - J_b * torque


@inlined
def joint_rows(S, fx, b, number, t):
    """Columns of gamma, block and right-hand side of the joint behind the module at `b`, `number` of its pair."""
    for e in range(LANES):
        f, k = b + e, b + e + MODULE
        (m_f, J_f), (m_b, J_b), A, root = inverses(S, f), inverses(S, k), S[f + AT.GROUND + 3 * LANES], S[f + AT.ROOT]
        at_f, at_b = motion_of(S, f + AT.Q, f + AT.V), motion_of(S, k + AT.Q, k + AT.V)
        rf_x, rf_y, biasf_x, biasf_y, gf_x, gf_y = joint_end(
            JointPoint(S[f + AT.O_AHEAD]), effects_of(S, fx, b, e, t), number, at_f, S[f + AT.SINE], S[f + AT.COSINE], A
        )
        rb_x, rb_y, biasb_x, biasb_y, gb_x, gb_y = joint_end(
            JointPoint(S[f + AT.O_BEHIND]), None, BEHIND, at_b, S[k + AT.SINE], S[k + AT.COSINE], A
        )
        gap_x, gap_y = at_f.x + rf_x - at_b.x - rb_x, at_f.y + rf_y - at_b.y - rb_y
        (af_x, af_y, af_g), (ab_x, ab_y, ab_g) = three(S, f + AT.ACC), three(S, k + AT.ACC)
        row_x = biasf_x - biasb_x + A * A * gap_x + af_x - ab_x + 2.0 * A * (at_f.x_dot - at_b.x_dot)
        row_y = biasf_y - biasb_y + A * A * gap_y + af_y - ab_y + 2.0 * A * (at_f.y_dot - at_b.y_dot)
        turn_f, turn_b = af_g + 2.0 * A * at_f.gamma_dot, ab_g + 2.0 * A * at_b.gamma_dot
        S[f + AT.AHEAD], S[f + AT.AHEAD + LANES] = gf_x, gf_y
        S[f + AT.BEHIND], S[f + AT.BEHIND + LANES] = -gb_x, -gb_y
        put3(
            S, f + AT.RIGHT, row_x + (gf_x * turn_f - gb_x * turn_b), row_y + (gf_y * turn_f - gb_y * turn_b),
            root * (ab_g - af_g),
        )  # fmt: skip
        m = m_f + m_b
        put3(
            S, f + AT.BLOCK, m + J_f * gf_x * gf_x + J_b * gb_x * gb_x, J_f * gf_x * gf_y + J_b * gb_x * gb_y,
            m + J_f * gf_y * gf_y + J_b * gb_y * gb_y,
        )  # fmt: skip
        put3(
            S, f + AT.BLOCK + 3 * LANES, -root * (J_f * gf_x + J_b * gb_x), -root * (J_f * gf_y + J_b * gb_y),
            1.0 + root * root * (J_f + J_b),
        )  # fmt: skip


@inlined
def three(S, at):
    """Three numbers of a lane."""
    return S[at], S[at + LANES], S[at + 2 * LANES]


@inlined
def put3(S, at, a, b, c):
    """Write three numbers of a lane."""
    S[at], S[at + LANES], S[at + 2 * LANES] = a, b, c


@inlined
def coupling(S, f):
    """Rows of the block that couples the joint behind module `f` of a lane with the next one, by the module between."""
    k = f + MODULE
    m, J = inverses(S, k)
    r_x, r_y, r_u = S[f + AT.BEHIND], S[f + AT.BEHIND + LANES], S[f + AT.ROOT]
    c_x, c_y, c_u = J * S[k + AT.AHEAD], J * S[k + AT.AHEAD + LANES], -J * S[k + AT.ROOT]
    return (
        (r_x * c_x - m, r_x * c_y, r_x * c_u), (r_y * c_x, r_y * c_y - m, r_y * c_u), (r_u * c_x, r_u * c_y, r_u * c_u)
    )  # fmt: skip


@inlined
def dot(a, b):
    """Of three numbers and three."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def reduce_block(S, b):
    """Take the joint ahead of the module at `b`, which is solved for, out of the block of the joint behind it."""
    for e in range(LANES):
        f, k = b - MODULE + e, b + e
        u_0, u_1, u_2 = coupling(S, f)
        x, y, u = (u_0[0], u_1[0], u_2[0]), (u_0[1], u_1[1], u_2[1]), (u_0[2], u_1[2], u_2[2])
        e_0, e_1, e_2 = three(S, f + AT.NEXT), three(S, f + AT.NEXT + 3 * LANES), three(S, f + AT.NEXT + 6 * LANES)
        z, (r_0, r_1, r_2) = three(S, f + AT.RIGHT), three(S, k + AT.RIGHT)
        put3(S, k + AT.RIGHT, r_0 - dot(x, z), r_1 - dot(y, z), r_2 - dot(u, z))
        (xx, xy, yy), (xu, yu, uu) = three(S, k + AT.BLOCK), three(S, k + AT.BLOCK + 3 * LANES)
        put3(S, k + AT.BLOCK, xx - dot(x, e_0), xy - dot(y, e_0), yy - dot(y, e_1))
        put3(S, k + AT.BLOCK + 3 * LANES, xu - dot(u, e_0), yu - dot(u, e_1), uu - dot(u, e_2))


@inlined
def solve3(factors, b):
    """Solve with the factors that `solve_block` takes of a symmetric 3×3 matrix."""
    l_10, l_20, l_21, i_0, i_1, i_2 = factors
    y_1 = b[1] - l_10 * b[0]
    x_2 = ((b[2] - l_20 * b[0]) - l_21 * y_1) * i_2
    x_1 = y_1 * i_1 - l_21 * x_2
    return b[0] * i_0 - l_10 * x_1 - l_20 * x_2, x_1, x_2


@inlined
def solve_block(S, b):
    """Solve for the multipliers of the joint behind the module at `b`, as they depend on those of the next one.

    Behind the last joint there is none: of it nothing is used then.
    """
    for e in range(LANES):
        f = b + e
        (xx, xy, yy), (xu, yu, uu) = three(S, f + AT.BLOCK), three(S, f + AT.BLOCK + 3 * LANES)
        i_0 = 1.0 / xx
        l_10, l_20 = xy * i_0, xu * i_0
        i_1, below = 1.0 / (yy - l_10 * xy), yu - l_10 * xu
        l_21 = below * i_1
        factors = l_10, l_20, l_21, i_0, i_1, 1.0 / (uu - l_20 * xu - l_21 * below)
        z = solve3(factors, three(S, f + AT.RIGHT))
        u_0, u_1, u_2 = coupling(S, f)
        e_0, e_1 = solve3(factors, (u_0[0], u_1[0], u_2[0])), solve3(factors, (u_0[1], u_1[1], u_2[1]))
        e_2 = solve3(factors, (u_0[2], u_1[2], u_2[2]))
        put3(S, f + AT.RIGHT, z[0], z[1], z[2])
        put3(S, f + AT.NEXT, e_0[0], e_0[1], e_0[2])
        put3(S, f + AT.NEXT + 3 * LANES, e_1[0], e_1[1], e_1[2])
        put3(S, f + AT.NEXT + 6 * LANES, e_2[0], e_2[1], e_2[2])


@inlined
def follow_next(S, b):
    """The multipliers of the joint behind the module at `b`, once those of the next one are known."""
    for e in range(LANES):
        f = b + e
        x, y, u = three(S, f + MODULE + AT.RIGHT)
        z = three(S, f + AT.RIGHT)
        e_0, e_1, e_2 = three(S, f + AT.NEXT), three(S, f + AT.NEXT + 3 * LANES), three(S, f + AT.NEXT + 6 * LANES)
        put3(
            S, f + AT.RIGHT, z[0] - (e_0[0] * x + e_1[0] * y + e_2[0] * u),
            z[1] - (e_0[1] * x + e_1[1] * y + e_2[1] * u), z[2] - (e_0[2] * x + e_1[2] * y + e_2[2] * u),
        )  # fmt: skip


@inlined
def hold_joint(S, b):
    """What the joint behind the module at `b` does to both of its modules."""
    for e in range(LANES):
        f, k = b + e, b + e + MODULE
        (m_f, J_f), (m_b, J_b), (l_x, l_y, u) = inverses(S, f), inverses(S, k), three(S, f + AT.RIGHT)
        more = S[f + AT.ROOT] * u
        on_f = S[f + AT.AHEAD] * l_x + S[f + AT.AHEAD + LANES] * l_y - more
        on_b = S[f + AT.BEHIND] * l_x + S[f + AT.BEHIND + LANES] * l_y + more
        (af_x, af_y, af_g), (ab_x, ab_y, ab_g) = three(S, f + AT.ACC), three(S, k + AT.ACC)
        put3(S, f + AT.ACC, af_x - m_f * l_x, af_y - m_f * l_y, af_g - J_f * on_f)
        put3(S, k + AT.ACC, ab_x + m_b * l_x, ab_y + m_b * l_y, ab_g - J_b * on_b)


@inlined
def join(S, fx, laws, modules, t, dt):
    """Accelerations of all modules from those without joints: block elimination, front to rear and back."""
    joints = modules - 1
    if fx is not None:
        for j in range(joints):
            twist(S, fx, laws, j, t, dt)
    for j in range(joints):
        joint_rows(S, fx, j * MODULE, min(j, 1), t)
    for j in range(joints):
        if j > 0:
            reduce_block(S, j * MODULE)
        solve_block(S, j * MODULE)
    for j in range(joints - 2, -1, -1):
        follow_next(S, j * MODULE)
    for j in range(joints):
        hold_joint(S, j * MODULE)
    if fx is not None:
        for e in range(LANES):
            at = motion_of(S, AT.Q + e, AT.V + e)
            a = from_origin(
                effects_of(S, fx, 0, e, t), FRONT, at, S[AT.SINE + e], S[AT.COSINE + e], three(S, AT.ACC + e)
            )
            put3(S, AT.ACC + e, a[0], a[1], a[2])


# ----------------------------------------------------------------------
# The loop.
# ----------------------------------------------------------------------


@inlined
def face(S, modules):
    """Sines and cosines of all yaws."""
    for i in range(modules):
        for j in range(i * MODULE, i * MODULE + LANES):
            S[j + AT.FACING] = S[j + AT.Q + 2 * LANES]
            S[j + AT.SINE], S[j + AT.COSINE] = sincos(S[j + AT.FACING])


@inlined
def turn(S, modules):
    """Sines and cosines of all yaws from those of a step before.

    A rover turns by far less in a step than `turn_by` knows.
    """
    for i in range(modules):
        for j in range(i * MODULE, i * MODULE + LANES):
            yaw = S[j + AT.Q + 2 * LANES]
            S[j + AT.SINE], S[j + AT.COSINE] = turn_by(yaw - S[j + AT.FACING], S[j + AT.SINE], S[j + AT.COSINE])
            S[j + AT.FACING] = yaw


@inlined
def advance(S, fx, modules, dt):
    """To the end of the step."""
    for i in range(modules):
        b = i * MODULE
        for j in range(b, b + SIZE * LANES):
            S[j + AT.Q], S[j + AT.V] = semi_implicit(dt, S[j + AT.Q], S[j + AT.V], S[j + AT.ACC], False)
        if fx is not None and LAGGING[len(fx)]:
            for j in range(b, b + 16 * LANES):
                S[j + AT.LAG] += dt * S[j + AT.LAG_RATE]


@inlined
def keep_rows(S, modules, row, rows):
    """What can be sampled of all lanes at a row, pair of neighbours by pair; sound rows are counted."""
    size = len(rows) // (modules - 1)
    for i in range(modules - 1):
        b, o = i * MODULE, i * size + row * COLUMNS * LANES
        for e in range(3 * LANES):
            rows[o + POSE_AT * LANES + e], rows[o + SPEED_AT * LANES + e] = S[b + AT.Q + e], S[b + AT.V + e]
        for e in range(LANES):
            rows[o + YAW_BACK_AT * LANES + e] = S[b + MODULE + AT.Q + 2 * LANES + e]
            rows[o + TURN_BACK_AT * LANES + e] = S[b + MODULE + AT.V + 2 * LANES + e]
        for e in range(2 * LANES):
            rows[o + PUSH_AT * LANES + e], at = S[b + AT.ACC + e], o + TORQUE_AT * LANES + e
            rows[at], rows[at + 2 * LANES] = S[b + AT.TORQUE + e], S[b + MODULE + AT.TORQUE + e]
    for i in range(modules):
        for j in range(i * MODULE, i * MODULE + SIZE * LANES):
            fine = abs(S[j + AT.V]) < LIMIT_V and abs(S[j + AT.Q]) < LIMIT_Q
            sound = S[j + AT.SOUND] if fine else 0.0
            S[j + AT.SOUND], S[j + AT.KEPT] = sound, S[j + AT.KEPT] + sound


@inlined
def simulate(S, rows, work, order, block, fx, laws, dt, knot_steps, free):
    """Run a block, a row at each knot."""
    modules, steps = work.modules.shape[1], work.knots[order[block * LANES]] * knot_steps
    for step in range(steps + 1):
        knot, phase, t = step // knot_steps, step % knot_steps, dt * step
        s = phase * dt
        if phase == 0:
            load_knot(S, work, order, block, knot, knot_steps * dt)
            face(S, modules)
        else:
            turn(S, modules)
        for i in range(modules):
            if free[i]:
                step_module(S, fx, laws, i, s, t, dt, True)
            else:
                step_module(S, fx, laws, i, s, t, dt, False)
        join(S, fx, laws, modules, t, dt)
        if phase == 0:
            keep_rows(S, modules, knot, rows)
        advance(S, fx, modules, dt)
        feed_back(S, fx, modules, dt, free)


@inlined
def sound_rows(S, modules, e):
    """How many rows of a lane are sound, from the first on."""
    kept = S[AT.KEPT + e]
    for i in range(modules):
        for c in range(SIZE):
            kept = min(kept, S[i * MODULE + AT.KEPT + c * LANES + e])
    return int(kept)


@inlined
def sample_plans(S, rows, samples, work, order, block, h, out):
    """What each item's plan asks for, into its part of `out`, left as it is from where the item diverged."""
    modules = work.modules.shape[1]
    size = len(rows) // (modules - 1)
    for e in range(LANES):
        if block * LANES + e >= len(order):
            return
        k = order[block * LANES + e]
        count = min(sound_rows(S, modules, e), work.knots[k] + 1)
        for pair in range(modules - 1 if count > 1 else 0):
            first, last = work.pairs[work.plan[k], pair], work.pairs[work.plan[k], pair + 1]
            for i in range(last - first):
                samples[i] = math.nan
            of = LaneRows(rows[pair * size : (pair + 1) * size], e, LANES, h, count, True)
            sample_lane(of, Wanted(work.at, work.kind, first, last), work.sensors, work.robot[k], samples, 0)
            for i in range(last - first):
                out[work.to[k] + work.place[first + i]] = samples[i]


@kernel
def run_trains(work, order, first, stride, dt, knot_steps, free, buffer, out, fx=None, laws=None):
    """Blocks `first`, `first` + `stride`, … of the items in `order`, those with most knots first; samples into `out`.

    Parameters
    ----------
    work : TrainItems
    knot_steps : int
        Steps of `dt` (s) from a knot to the next, for all items in `order`.
    free : array of bool, shape (modules,)
        Which modules have a motor that is not prescribed.
    fx : tuple, optional
        One of EXTENDED for the extended model (`lane_layout`).
    laws : array of LAW_DTYPE, shape (r, modules), optional
        With `fx`: laws of all robots, as `effects` has the rest. They branch, so that lanes with laws are computed one
        after the other.
    """
    line_up_stack()
    S, rows, samples = buffer
    modules = work.modules.shape[1]
    for block in range(first, (len(order) + LANES - 1) // LANES, stride):
        for i in range(modules):
            b = i * MODULE
            for e in range(LANES):
                k = item_of(order, block, e)
                load_module(S, e, b, work, k, i, fx)
                next_knot(S, e, b, work, k, i, 0)
        simulate(S, rows, work, order, block, fx, laws, dt, knot_steps, free)
        sample_plans(S, rows, samples, work, order, block, knot_steps * dt, out)
