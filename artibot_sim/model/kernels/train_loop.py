"""The integration loops of a robot of any number of modules in a row: each module's equations, and the chain of joints.

One and two modules are cases of it, for which `loop` and `plane_loop` have the joint's 4×4 system written out and keep
all of a step in registers. Arrays hold a row a module: ``q`` and ``v`` (n, 8), efficiencies and torques (n, 2), what
its four wheels remember (n, 16). A module computes with a row of contributions of its own, in which it stands in the
place of the front one (see `train_layout`).

The joints' multipliers solve S lambda = Phi_x M⁻¹ n + …, whose matrix couples only joints of one module: it is
block-tridiagonal, and a Cholesky factorisation from the front to the rear keeps it so. The cost of a step is linear in
the number of modules.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba.core import types
from numba.extending import overload
from numpy.typing import NDArray

from artibot_sim.model.effects.force_law import motion_in, note_angles, note_module
from artibot_sim.model.equations.contact import (
    generalised_forces,
    soil_under,
    wheel_pairs,
)
from artibot_sim.model.equations.dynamics import (
    back_to_origin,
    free_acceleration,
    joint_from_mass_centre,
    joint_torque,
    module_gravity,
    module_loads,
    write_loads,
)
from artibot_sim.model.equations.kinematics import joint, sincos_small
from artibot_sim.model.equations.transmission import PRESCRIBED, TORQUE, reflect
from artibot_sim.model.kernels.compilation import inlined, kernel
from artibot_sim.model.kernels.elementary import cubic_at, cubic_between, sincos
from artibot_sim.model.kernels.energy import motor_powers, wheel_powers
from artibot_sim.model.kernels.integrators import (
    D_DDOT,
    D_DOT,
    EFFICIENCY,
    GEAR,
    HELD,
    INERTIA,
    INVERSE,
    TORQUE_D,
    D,
    Footing,
    MotorAction,
    MotorCommands,
    MotorMotion,
    begin_loops,
    kept_by,
    loaded,
    motor_of,
    motor_with_wheels,
    step_ahead,
    turning,
    wind_up,
    write_motor,
    write_rates,
    write_wheels,
)
from artibot_sim.model.kernels.layout import (
    ACC,
    ALPHA,
    BACK,
    BEHIND,
    BETA,
    E_ARTICULATION,
    E_JOINT,
    E_PUSH,
    ENERGIES,
    FRONT,
    GAMMA,
    LAMBDA,
    LOAD,
    M_D,
    M_J,
    M_M,
    M_R,
    NOUGHT,
    PUSH,
    Q_J,
    ROW,
    THETA_L,
    THETA_R,
    X,
    Y,
    Z,
)
from artibot_sim.model.kernels.loop import DIVERGED, LIMIT, OK, next_efficiency, remembered
from artibot_sim.model.kernels.steps import (
    next_stage,
    next_stage_of_lag,
    semi_implicit,
    stage_time,
    stage_weight,
)
from artibot_sim.model.kernels.train_layout import KEPT, KEPT_ENERGIES

Array = NDArray[np.float64]

ROWS = 5
"""Rows of a joint: eq. 13's four, and the torque in its yaw, which only effects bring."""


class Chain(NamedTuple):
    """The joints' linear system, and the modules' accelerations without joints.

    `ahead` and `behind` (5, 3 each) are the columns of a joint's rows by alpha, beta and gamma of its two modules;
    `diagonal` and `coupling` (5, 5) are its blocks of S, the latter with the next joint, `right` its right-hand side,
    which becomes the multipliers.
    """

    trig: Array
    free: Array
    ahead: Array
    behind: Array
    diagonal: Array
    coupling: Array
    right: Array


class TrainWork(NamedTuple):
    """Arrays that a loop works in, so that it allocates nothing; a row a module each."""

    w: Array
    drive: Array
    cubic: Array
    hold: Array
    eta_next: Array
    q: Array
    v: Array
    first: Array
    total: Array
    e: Array
    power: Array
    lag: Array
    lag_rate: Array
    sum_lag: Array
    chain: Chain


def workspace(modules: int) -> TrainWork:
    """A fresh one for so many modules, for one loop at a time."""
    n = modules
    shapes = [(n, 4), (n, 6), (n, ROWS, 3), (n, ROWS, 3), (n, ROWS, ROWS), (n, ROWS, ROWS), (n, ROWS)]
    chain = Chain(*map(np.zeros, shapes))
    w, drive, cubic, hold, eta_next, q, v, first, total, e, power, lag, lag_rate, sum_lag = (
        np.zeros((n, width)) for width in (ROW, 12, 16, HELD, 2, 8, 8, 8, 8, ENERGIES, ENERGIES, 16, 16, 16)
    )
    return TrainWork(
        w, drive, cubic, hold, eta_next, q, v, first, total, e, power, lag, lag_rate, sum_lag, chain,
    )  # fmt: skip


# ----------------------------------------------------------------------
# A module: its motors, wheels and ground, as if it were alone.
# ----------------------------------------------------------------------


@inlined
def motor_at(p, fx, commands, side, i, theta, theta_dot):
    """A motor of a module (0 for the front one, else 1), with its number in the pair that effects see."""
    own = turning(p, fx, commands, side, theta, theta_dot)
    return MotorMotion(
        2 * i + side, own.mode, own.theta, own.theta_dot, own.wish, own.torque, own.gear, own.J, own.inverse_J,
        own.error, own.behind,
    )  # fmt: skip


@inlined
def side_forces(p, fx, unit, side, motor, on, lags, dt, hold, w):
    """A motor of a module (`motor_at`) and its wheels, into the module's row; returns `contact.PairForces`.

    The wheels stand `on` an `integrators.Footing`; `lags` are what they remember, and its rates.
    """
    (lag, lag_rate), a = lags, 2 * side
    kept, ahead = (kept_by((lag,), 4, a), kept_by((lag,), 4, a + 1)), None
    if dt is not None:
        ahead = step_ahead(p.front, p, fx, unit, motor, on, kept, dt)
    forces, acting = motor_with_wheels(p.front, p, fx, unit, motor, on, kept, dt, ahead, True)
    write_wheels(on.pair, forces, side, w)
    write_motor(fx, acting, side, hold, w)
    if fx is not None:
        write_rates(fx, forces, 4, a, (lag_rate,), 0)
    return forces


@inlined
def module_alone(p, fx, i, q, v, angles, commands, lags, dt, w, free):
    """A module without its joints (eqs 15 to 28): contributions into its row, accelerations into `free` (6,).

    For effects it is number `i` of a pair, see `effects.parts`: 0 for the front one, else 1. `angles` are sine and
    cosine of its roll and of its yaw (4,).
    """
    trig, body = (angles[0], angles[1], angles[2], angles[3]), p.front
    _, c_a, s_g, c_g = trig
    pair_r, pair_l = wheel_pairs(body, p, fx, q, v, FRONT, trig, i)
    soil_r = soil_under(body, p, fx, pair_r, q[X], q[Y], s_g, c_g, c_a, -1.0)
    soil_l = soil_under(body, p, fx, pair_l, q[X], q[Y], s_g, c_g, c_a, 1.0)
    met_r, met_l = pair_r, pair_l
    if fx is not None:
        units, turned = (p.right_front, p.left_front), (q[THETA_R], q[THETA_L], v[THETA_R], v[THETA_L])
        pairs, soils = (pair_r, pair_l), (soil_r, soil_l)
        met_r, met_l = loaded(body, p, fx, units, pairs, soils, 2 * i, turned, (lags[0],), 4, 0)
    turns_r = motor_at(p, fx, commands, FRONT, i, q[THETA_R], v[THETA_R])
    turns_l = motor_at(p, fx, commands, BEHIND, i, q[THETA_L], v[THETA_L])
    right = side_forces(p, fx, p.right_front, FRONT, turns_r, Footing(met_r, soil_r), lags, dt, commands.hold, w)
    left = side_forces(p, fx, p.left_front, BEHIND, turns_l, Footing(met_l, soil_l), lags, dt, commands.hold, w)
    forces = generalised_forces(body, p, fx, trig, right, left, (pair_r, pair_l), FRONT, w)
    loads = 0.0, 0.0, 0.0, 0.0, 0.0
    if fx is not None:
        forward = c_g * v[X] + s_g * v[Y]
        loads = module_loads(body, fx, i, forward, right, left, s_g, c_g, c_a)
        write_loads(loads, FRONT, w)
    free[X], free[Y], free[Z], free[ALPHA], free[GAMMA] = free_acceleration(body, p, fx, s_g, c_g, forces, loads, i)
    free[BETA] = 0.0


# ----------------------------------------------------------------------
# The joints.
# ----------------------------------------------------------------------


@inlined
def joint_rows(p, fx, j, q, v, trig, chain):
    """Columns and right-hand side of joint `j`, but for what accelerates its modules without it.

    `p` is the pair of neighbours as an articulated rover, `q` and `v` (16,) theirs, `trig` (8,) their angles'.
    """
    attitude = trig[0], trig[1], trig[2], trig[3], trig[4], trig[5], trig[6], trig[7]
    phi, bias, front, back = joint(q, v, p, attitude)
    A2 = p.A_joint * p.A_joint
    held = bias[0] + A2 * phi[0], bias[1] + A2 * phi[1], bias[2] + A2 * phi[2], bias[3] + A2 * phi[3]
    if fx is not None and j == 0:  # the front module is the only one whose mass can be off its origin
        held, gamma = joint_from_mass_centre(p, fx[0], v, held, front[2], FRONT, attitude[2], attitude[3])
        front = (front[0], front[1], gamma)
    ahead, behind, right = chain.ahead[j], chain.behind[j], chain.right[j]
    for r in range(4):
        right[r] = held[r]
        ahead[r, 0], ahead[r, 1] = front[0][r], front[1][r]
        behind[r, 0], behind[r, 1] = back[0][r], back[1][r]
    ahead[0, 2], ahead[1, 2], ahead[2, 2], ahead[3, 2] = front[2][0], front[2][1], 0.0, front[2][2]
    behind[0, 2], behind[1, 2], behind[2, 2], behind[3, 2] = back[2][0], back[2][1], 0.0, back[2][2]


@inlined
def yaw_torque(fx, j, q, v, dt, w, chain):
    """With effects: the torque in the yaw of joint `j` as a fifth row, (d/dt rate) − c T = −c T_0.

    Over a step `dt` friction is taken implicitly, by its secant s: T = T_0 + dt s (d/dt rate), c = 1 / (dt s). At an
    instant (`dt` None), or where the torque does not depend on the rate, T_0 acts as it is, and the row is empty.
    Returns T_0 and c, zero for an empty row.
    """
    torque, slope = joint_torque(fx, q[BACK + GAMMA] - q[GAMMA], v[BACK + GAMMA] - v[GAMMA], dt)
    c = 1.0 / slope if slope > 0.0 else 0.0
    w[M_J] = torque
    ahead, behind = chain.ahead[j], chain.behind[j]
    for k in range(3):
        ahead[4, k] = behind[4, k] = 0.0
    if c > 0.0:
        ahead[4, 2], behind[4, 2] = -1.0, 1.0
    return torque, c


@inlined
def inverse_of(body, k):
    """Inverse of a module's mass or inertia number `k`: x, y, z, alpha, beta, gamma."""
    return body.inverse[k]


@inlined
def fill_blocks(p, j, v, rows, c, torque, chain):
    """Blocks of S for joint `j`, and its right-hand side with the modules' free accelerations."""
    ahead, behind, S, right = chain.ahead[j], chain.behind[j], chain.diagonal[j], chain.right[j]
    front, back, A = chain.free[j], chain.free[j + 1], 2.0 * p.A_joint
    for r in range(rows):
        for s in range(r + 1):
            total = 0.0
            for k in range(3):
                total += ahead[r, k] * ahead[s, k] * inverse_of(p.front, 3 + k)
                total += behind[r, k] * behind[s, k] * inverse_of(p.back, 3 + k)
            S[r, s] = total
        damping = A if r < 4 else 0.0
        if r < 3:
            S[r, r] += inverse_of(p.front, r) + inverse_of(p.back, r)
            right[r] += front[r] - back[r] + A * (v[r] - v[BACK + r])
        elif r == 4:
            S[r, r] += c if c > 0.0 else 1.0
            right[r] = c * torque
        for k in range(3):
            right[r] += ahead[r, k] * (front[3 + k] + damping * v[3 + k])
            right[r] += behind[r, k] * (back[3 + k] + damping * v[BACK + 3 + k])


@inlined
def couple(body, j, rows, chain):
    """Block of S that couples joint `j` with the next, by the module between them."""
    behind, ahead, U = chain.behind[j], chain.ahead[j + 1], chain.coupling[j]
    for r in range(rows):
        for s in range(rows):
            total = -inverse_of(body, r) if r == s and r < 3 else 0.0
            for k in range(3):
                total += behind[r, k] * ahead[s, k] * inverse_of(body, 3 + k)
            U[r, s] = total


@inlined
def factor(S, rows):
    """Cholesky factor of a symmetric positive definite matrix in place, its lower triangle."""
    for r in range(rows):
        for s in range(r + 1):
            total = S[r, s]
            for k in range(s):
                total -= S[r, k] * S[s, k]
            S[r, s] = math.sqrt(total) if r == s else total / S[s, s]


@inlined
def solve_chain(joints, rows, chain):
    """The multipliers of all joints, in place of the right-hand sides: block Cholesky, front to rear and back."""
    for j in range(joints):
        C, y = chain.diagonal[j], chain.right[j]
        if j > 0:
            W, z = chain.coupling[j - 1], chain.right[j - 1]
            for r in range(rows):
                for k in range(rows):
                    y[r] -= W[k, r] * z[k]
                for s in range(r + 1):
                    for k in range(rows):
                        C[r, s] -= W[k, r] * W[k, s]
        factor(C, rows)
        for r in range(rows):
            for k in range(r):
                y[r] -= C[r, k] * y[k]
            y[r] /= C[r, r]
        if j < joints - 1:
            W = chain.coupling[j]
            for s in range(rows):
                for r in range(rows):
                    for k in range(r):
                        W[r, s] -= C[r, k] * W[k, s]
                    W[r, s] /= C[r, r]
    for j in range(joints - 1, -1, -1):
        C, y = chain.diagonal[j], chain.right[j]
        if j < joints - 1:
            for r in range(rows):
                for k in range(rows):
                    y[r] -= chain.coupling[j][r, k] * chain.right[j + 1][k]
        for r in range(rows - 1, -1, -1):
            for k in range(r + 1, rows):
                y[r] -= C[k, r] * y[k]
            y[r] /= C[r, r]


@inlined
def held_by_joints(body, i, joints, rows, chain, w):
    """Forces of the joints on module `i`, −Phi_xᵀ lambda, and its accelerations, into its row."""
    for k in range(6):
        force, torque = 0.0, 0.0
        if i < joints:
            multiplier, columns = chain.right[i], chain.ahead[i]
            if k < 3:
                force -= multiplier[k]
            else:
                for r in range(4):
                    force -= columns[r, k - 3] * multiplier[r]
                if rows > 4:
                    torque -= columns[4, k - 3] * multiplier[4]
        if i > 0:
            multiplier, columns = chain.right[i - 1], chain.behind[i - 1]
            if k < 3:
                force += multiplier[k]
            else:
                for r in range(4):
                    force -= columns[r, k - 3] * multiplier[r]
                if rows > 4:
                    torque -= columns[4, k - 3] * multiplier[4]
        w[Q_J + k] = force
        w[ACC + k] = chain.free[i, k] + inverse_of(body, k) * (force + torque)


@inlined
def note_pair(fx, i, modules, q, v, trig):
    """With effects: what laws of module `i` see: it and the front one, and the joint ahead, of the front one behind."""
    motion, k = motion_in(fx[i]), max(i, 1)
    front, back = modules[0], modules[k]
    for place in range(2):
        m = 0 if place == 0 else k
        s_g, c_g = trig[m, 2], trig[m, 3]
        forward, left = c_g * v[m, X] + s_g * v[m, Y], c_g * v[m, Y] - s_g * v[m, X]
        note_module(motion, place, q[m, X], q[m, Y], q[m, GAMMA], forward, left, v[m, GAMMA])
    note_angles(
        motion, front.right_front.tau * q[0, THETA_R], front.left_front.tau * q[0, THETA_L],
        back.right_front.tau * q[k, THETA_R], back.left_front.tau * q[k, THETA_L], q[k, GAMMA] - q[k - 1, GAMMA],
        v[k, GAMMA] - v[k - 1, GAMMA],
    )  # fmt: skip


def of_one(fx: Any, i: int) -> Any:
    """The effects of one module's pair; None, at compile time, where there are none."""
    return None if fx is None else fx[i]


@overload(of_one, jit_options={"forceinline": True}, strict=False)
def _of_one(fx: Any, i: int) -> Any:
    return (lambda fx, i: fx[i]) if isinstance(fx, types.Array) else (lambda fx, i: None)


@inlined
def begin_effects(fx, memory, lag):
    """What wheels remember into `lag`; the time of the start (s), and how many numbers of a module change."""
    start, count = 0.0, 0
    if fx is not None:
        start = fx[0].t
        copy_rows(memory, lag)
        for i in range(len(fx)):
            count = max(count, remembered(fx[i], 4))
    return start, count


@inlined
def set_time(fx, t):
    """With effects: the time of the instant, s."""
    for i in range(len(fx)):
        fx[i].t = t


@inlined
def accelerations(q, v, modules, joints_p, fx, commands, lags, dt, w, chain):
    """All of eq. 28 for every module and joint: contributions and accelerations into the modules' rows.

    At an instant (`dt` None), or as a semi-implicit step of `dt` (s) takes them.
    """
    count = len(modules)
    joints, rows = count - 1, 4
    if fx is not None:
        rows = 5
    for i in range(count):
        trig = chain.trig[i]
        trig[0], trig[1] = sincos_small(q[i, ALPHA])
        trig[2], trig[3] = sincos(q[i, GAMMA])
    for i in range(count):
        if fx is not None:
            note_pair(fx, i, modules, q, v, chain.trig)
        module_alone(
            modules[i], of_one(fx, i), min(i, 1), q[i], v[i], chain.trig[i],
            MotorCommands(commands.modes[i], commands.drive[i], commands.hold[i]), (lags[0][i], lags[1][i]), dt, w[i],
            chain.free[i],
        )  # fmt: skip
    flat_q, flat_v, flat_trig = q.reshape(8 * count), v.reshape(8 * count), chain.trig.reshape(4 * count)
    if fx is not None:
        for j in range(joints):
            p, q_j, v_j = joints_p[j], flat_q[8 * j : 8 * j + 16], flat_v[8 * j : 8 * j + 16]
            torque, c = yaw_torque(fx[j + 1], j, q_j, v_j, dt, w[j], chain)
            chain.right[j, 4] = torque
            chain.diagonal[j, 4, 4] = c
            if c == 0.0:
                chain.free[j, GAMMA] += p.front.inverse[5] * torque
                chain.free[j + 1, GAMMA] -= p.back.inverse[5] * torque
    for j in range(joints):
        p, q_j, v_j = joints_p[j], flat_q[8 * j : 8 * j + 16], flat_v[8 * j : 8 * j + 16]
        torque, c = chain.right[j, 4], chain.diagonal[j, 4, 4]
        joint_rows(p, fx, j, q_j, v_j, flat_trig[4 * j : 4 * j + 8], chain)
        fill_blocks(p, j, v_j, rows, c, torque, chain)
        if fx is not None and c > 0.0:
            w[j, M_J] = 0.0  # the multiplier takes its place below
        if j > 0:
            couple(p.front, j - 1, rows, chain)
    solve_chain(joints, rows, chain)
    for i in range(count):
        if i < joints:
            for r in range(4):
                w[i, LAMBDA + r] = chain.right[i, r]
            if fx is not None and chain.ahead[i, 4, 2] != 0.0:
                w[i, M_J] = chain.right[i, 4]
        held_by_joints(modules[i].front, i, joints, rows, chain, w[i])
    if fx is not None:
        back_to_origin(fx[0], v[0], chain.trig[0, 2], chain.trig[0, 3], FRONT, w[0])


# ----------------------------------------------------------------------
# What is held through a step, and what feeds back from it.
# ----------------------------------------------------------------------


@inlined
def hold_step(modules, inputs, knot, eta, previous, hold):
    """Fix for a step what eq. 21 makes of the efficiencies, and the torques: commanded ones, or (NaN) eq. 30's."""
    shared = previous[0, 0] + previous[0, 1]
    for i in range(len(modules)):
        p = modules[i]
        given = inputs.torque_d[i, min(knot, inputs.torque_d.shape[1] - 1)]
        for side in range(2):
            unit = motor_of(p, side)
            if hold[i, EFFICIENCY + side] != eta[i, side]:
                gear, J = reflect(unit.tau, unit.J_m, unit.J_w, 1.0 / eta[i, side])
                hold[i, EFFICIENCY + side], hold[i, GEAR + side] = eta[i, side], gear
                hold[i, INERTIA + side], hold[i, INVERSE + side] = J, 1.0 / J
            torque = given[side] if not math.isnan(given[side]) else inputs.share[i] * shared
            measured = given[side] if inputs.modes[i, side] == PRESCRIBED else math.nan
            hold[i, TORQUE_D + side] = torque if inputs.modes[i, side] == TORQUE else measured


@inlined
def meet_knots(position, velocity, knot, h, cubic):
    """Coefficients of the commands' cubics between two knots, module by module, into `cubic` (n, 16)."""
    last = position.shape[1] - 1
    a, b = min(knot, last), min(knot + 1, last)
    going = 1.0 / h if b > a else 0.0
    for i in range(position.shape[0]):
        for side in range(2):
            start, speed = position[i, a, side], velocity[i, a, side]
            cubic[i, side], cubic[i, 4 + side] = start, speed
            cubic[i, 8 + side], cubic[i, 12 + side] = cubic_between(
                start, position[i, b, side], speed, velocity[i, b, side], going
            )


@inlined
def commands_at(cubic, s, modes, drive):
    """Commanded angles, speeds and accelerations `s` seconds after the knot, into `drive` (n, 12)."""
    for i in range(cubic.shape[0]):
        for side in range(2):
            if modes[i, side] != TORQUE:
                drive[i, D + side], drive[i, D_DOT + side], drive[i, D_DDOT + side] = cubic_at(
                    cubic[i, side], cubic[i, 4 + side], cubic[i, 8 + side], cubic[i, 12 + side], s
                )


@inlined
def feed_back(modules, fx, v, w, modes, hold, dt, eta, previous):
    """What the next step takes from this one: efficiencies (eq. 23) and the torques of eq. 30 (Fig. 7)."""
    for i in range(len(modules)):
        for side in range(2):
            previous[i, side], c = w[i, M_M + side], THETA_R + side
            acting = MotorAction(
                w[i, M_M + side], w[i, M_R + side], w[i, M_D + side] if fx is not None else 0.0, w[i, ACC + c], v[i, c]
            )  # fmt: skip
            eta[i, side] = next_efficiency(
                motor_of(modules[i], side), of_one(fx, i), acting, v[i, c], side, modes[i], hold[i], dt
            )


@inlined
def wind_all(fx, modes, q, drive, hold, behind):
    """With effects: `integrators.wind_up` of all motors, module by module."""
    for i in range(len(fx)):
        for side in range(2):
            wind_up(fx[i], modes[i, side], q[i, THETA_R + side], side, drive[i], hold[i], behind[i])


@inlined
def copy_rows(values, out):
    """Copy a table."""
    for i in range(values.shape[0]):
        for c in range(values.shape[1]):
            out[i, c] = values[i, c]


@inlined
def sound(q, v):
    """Whether a state is finite and within what a rover can do."""
    for i in range(q.shape[0]):
        for c in range(8):
            if not (abs(v[i, c]) < LIMIT and abs(q[i, c]) < 1e12):
                return False
    return True


@inlined
def add_powers(q, v, modules, fx, w, weight, e, pw):
    """Accumulate `weight` (s) times the power of every contribution, module by module."""
    for i in range(len(modules)):
        p, power = modules[i], pw[i]
        own = of_one(fx, i)
        motor_powers(v[i], p, own, w[i], power)
        wheel_powers(p.front, p, own, q[i], v[i], 0, 0, min(i, 1), w[i], power)
        work, push = 0.0, 0.0
        for k in range(6):
            work += w[i, Q_J + k] * v[i, k]
        if fx is not None:
            push = w[i, LOAD] * v[i, X] + w[i, LOAD + 1] * v[i, Y] + w[i, LOAD + 2] * v[i, GAMMA]
            if i == 0:
                push += w[0, PUSH] * v[0, X] + w[0, PUSH + 1] * v[0, Y]
            if i < len(modules) - 1:
                power[E_ARTICULATION] = w[i, M_J] * (v[i + 1, GAMMA] - v[i, GAMMA])
        for k in range(ENERGIES):
            if k != E_JOINT and k != E_PUSH:
                e[i, k] += weight * power[k]
        e[0, E_JOINT] += weight * work
        e[0, E_PUSH] += weight * push


@inlined
def keep_row(q, v, w, e, row, out, out_e):
    """Copy what is kept of an instant."""
    for i in range(q.shape[0]):
        for c in range(8):
            out.q[row, 8 * i + c], out.v[row, 8 * i + c] = q[i, c], v[i, c]
        for k in range(len(KEPT)):
            out.w[row, len(KEPT) * i + k] = w[i, KEPT[k]]
        if out_e is not None:
            for k in range(len(KEPT_ENERGIES)):
                out_e[row, len(KEPT_ENERGIES) * i + k] = e[i, KEPT_ENERGIES[k]]


@inlined
def next_state(k, q, v, dt, w, q_s, v_s, first, total):
    """From stage `k` to the next; after the last one, advance (q, v)."""
    for i in range(q.shape[0]):
        for c in range(8):
            q_s[i, c], v_s[i, c], first[i, c], total[i, c] = next_stage(
                k, dt, q[i, c], v[i, c], v_s[i, c], w[i, ACC + c], first[i, c], total[i, c]
            )
            if k == 3:
                q[i, c], v[i, c] = q_s[i, c], v_s[i, c]


@inlined
def next_lag(k, count, memory, dt, lag, rate, sum_lag):
    """What wheels remember, `count` numbers a module, from stage `k` to the next; after the last, advance `memory`."""
    for i in range(memory.shape[0]):
        for c in range(count):
            lag[i, c], sum_lag[i, c] = next_stage_of_lag(k, dt, memory[i, c], rate[i, c], sum_lag[i, c])
            if k == 3:
                memory[i, c] = lag[i, c]


# ----------------------------------------------------------------------
# The loops.
# ----------------------------------------------------------------------


@kernel
def train_rk4(state, modules, joints, inputs, grid, work, out, out_e, fx=None, memory=None):
    """Advance the state in place by `steps` steps and keep every `every`-th row, the first and the last included.

    Parameters
    ----------
    state : layout.RunState
        Of n modules: q, v (n, 8) and eta, previous (n, 2).
    modules, joints : arrays of records
        See `parameters.Train`.
    inputs : layout.MotorInputs
        Of n modules: modes (n, 2), what is commanded (n, knots, 2), and shares (n,).
    grid : layout.Grid
    work : TrainWork
    out : layout.Rows
        Of n modules: q and v (rows, 8 n), and the contributions of `train_layout.KEPT` for each module.
    out_e : array or None
        None leaves the energies out, at compile time.
    fx : array of n records, optional
        Parameters of the effects in each module's pair (`effects.records`), with the time of the start.
    memory : array, shape (n, 16), where there is `fx`
        What each module's wheels remember, as `layout.MEMORY` has it; advanced in place, too.

    Returns
    -------
    tuple of int
        OK or DIVERGED, and the number of rows written.
    """
    (q, v, eta, previous, behind), (dt, steps, every, knot_steps) = state, grid
    w, drive, cubic, hold, eta_next, q_s, v_s, first, total, e, pw, lag, lag_rate, sum_lag, chain = work
    start, count = begin_effects(fx, memory, lag)
    commands = MotorCommands(inputs.modes, drive, hold)
    for i in range(len(modules)):
        begin_loops(hold[i])
    for i in range(len(modules)):
        module_gravity(modules[i].front, modules[i], FRONT, w[i])
        for c in range(8):
            q_s[i, c], v_s[i, c] = q[i, c], v[i, c]
    row = NOUGHT
    for step in range(steps + 1):
        phase, knot = step % knot_steps, step // knot_steps
        if phase == 0:
            meet_knots(inputs.position, inputs.velocity, knot, knot_steps * dt, cubic)
        hold_step(modules, inputs, knot, eta, previous, hold)
        for k in range(4):
            if k != 2:
                commands_at(cubic, phase * dt + stage_time(k, dt), inputs.modes, drive)
            if fx is not None:
                set_time(fx, start + (dt * step + stage_time(k, dt)))
                if k == 0:
                    wind_all(fx, inputs.modes, q, drive, hold, behind)
            accelerations(q_s, v_s, modules, joints, fx, commands, (lag, lag_rate), None, w, chain)
            if k == 0:
                if step == steps or step % every == 0:
                    if not sound(q, v):
                        return DIVERGED, row
                    keep_row(q, v, w, e, row, out, out_e)
                    row += 1
                if step == steps:
                    return OK, row
                feed_back(modules, fx, v, w, inputs.modes, hold, dt, eta_next, previous)
            if out_e is not None:
                add_powers(q_s, v_s, modules, fx, w, stage_weight(k) * dt, e, pw)
            next_state(k, q, v, dt, w, q_s, v_s, first, total)
            if fx is not None:
                next_lag(k, count, memory, dt, lag, lag_rate, sum_lag)
        for i in range(len(modules)):
            eta[i, 0], eta[i, 1] = eta_next[i, 0], eta_next[i, 1]
    return OK, row


@kernel
def train_semi_implicit(state, modules, joints, inputs, grid, work, out, out_e, fx=None, memory=None):
    """Advance the state in place by semi-implicit steps, for the same arguments as `train_rk4`.

    A row's contributions are those that act from its state to the next.
    """
    (q, v, eta, previous, behind), (dt, steps, every, knot_steps) = state, grid
    w, drive, cubic, hold, _, q_old, v_old, _, _, e, pw, lag, lag_rate, _, chain = work
    start, count = begin_effects(fx, memory, lag)
    commands = MotorCommands(inputs.modes, drive, hold)
    for i in range(len(modules)):
        begin_loops(hold[i])
    for i in range(len(modules)):
        module_gravity(modules[i].front, modules[i], FRONT, w[i])
    row = NOUGHT
    for step in range(steps + 1):
        phase, knot = step % knot_steps, step // knot_steps
        if phase == 0:
            meet_knots(inputs.position, inputs.velocity, knot, knot_steps * dt, cubic)
        hold_step(modules, inputs, knot, eta, previous, hold)
        s = phase * dt
        commands_at(cubic, s, inputs.modes, drive)
        for i in range(len(modules)):
            for side in range(2):  # the mean acceleration over the step
                drive[i, D_DDOT + side] = 2.0 * cubic[i, 8 + side] + 3.0 * cubic[i, 12 + side] * (2.0 * s + dt)
            for c in range(8):
                q_old[i, c], v_old[i, c] = q[i, c], v[i, c]
        if fx is not None:
            set_time(fx, start + dt * step)
            wind_all(fx, inputs.modes, q, drive, hold, behind)
        accelerations(q, v, modules, joints, fx, commands, (lag, lag_rate), dt, w, chain)
        if step == steps or step % every == 0:
            if not sound(q, v):
                return DIVERGED, row
            keep_row(q, v, w, e, row, out, out_e)
            row += 1
        if step == steps:
            break
        for i in range(len(modules)):
            for c in range(8):
                q[i, c], v[i, c] = semi_implicit(dt, q[i, c], v[i, c], w[i, ACC + c], Z <= c <= BETA)
        feed_back(modules, fx, v, w, inputs.modes, hold, dt, eta, previous)
        if fx is not None:
            for i in range(len(modules)):
                for c in range(count):
                    memory[i, c] += dt * lag_rate[i, c]
                    lag[i, c] = memory[i, c]
        if out_e is not None:
            for i in range(len(modules)):
                for c in range(8):
                    v_old[i, c] = 0.5 * (v_old[i, c] + v[i, c])
            add_powers(q_old, v_old, modules, fx, w, dt, e, pw)
    return OK, row
