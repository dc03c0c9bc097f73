"""The compiled loops of `loop` for a rover that stays on a plane, which most do: a third of the work a step.

They take what those take and give the same to rounding. A rover that does not start level is left to them.
"""

from __future__ import annotations

from artibot_sim.model.equations.dynamics import module_gravity
from artibot_sim.model.kernels.compilation import inlined, kernel
from artibot_sim.model.kernels.energy import Account, level_powers
from artibot_sim.model.kernels.integrators import MotorCommands, begin_loops, wind_up
from artibot_sim.model.kernels.layout import BEHIND, FRONT, MOTOR, NOUGHT
from artibot_sim.model.kernels.loop import (
    DIVERGED,
    OK,
    accounted,
    command_at,
    keep_row,
    lags_after,
    lags_of,
    mean_acceleration,
    next_efficiency,
    next_lag,
    prepare,
    sound,
    start_lags,
)
from artibot_sim.model.kernels.plane_step import (
    heading,
    level,
    level_accelerations,
    motions,
    near,
    stand,
    turned,
    unload,
    write_row,
)
from artibot_sim.model.kernels.steps import next_stage, semi_implicit, stage_time, stage_weight

NOTHING = (0.0,) * 10

LEAVES = 2
"""The status of a rover that does not stand level; nothing has been done then."""


@inlined
def load(q):
    """Of q or v (16,), those that move on a plane."""
    return q[0], q[1], q[5], q[8], q[9], q[13], q[6], q[7], q[14], q[15]


@inlined
def next_ten(k, dt, q, v, speed, a, first, total):
    """`steps.next_stage` of ten coordinates."""
    c_0 = next_stage(k, dt, q[0], v[0], speed[0], a[0], first[0], total[0])
    c_1 = next_stage(k, dt, q[1], v[1], speed[1], a[1], first[1], total[1])
    c_2 = next_stage(k, dt, q[2], v[2], speed[2], a[2], first[2], total[2])
    c_3 = next_stage(k, dt, q[3], v[3], speed[3], a[3], first[3], total[3])
    c_4 = next_stage(k, dt, q[4], v[4], speed[4], a[4], first[4], total[4])
    c_5 = next_stage(k, dt, q[5], v[5], speed[5], a[5], first[5], total[5])
    c_6 = next_stage(k, dt, q[6], v[6], speed[6], a[6], first[6], total[6])
    c_7 = next_stage(k, dt, q[7], v[7], speed[7], a[7], first[7], total[7])
    c_8 = next_stage(k, dt, q[8], v[8], speed[8], a[8], first[8], total[8])
    c_9 = next_stage(k, dt, q[9], v[9], speed[9], a[9], first[9], total[9])
    x = c_0[0], c_1[0], c_2[0], c_3[0], c_4[0], c_5[0], c_6[0], c_7[0], c_8[0], c_9[0]
    rate = c_0[1], c_1[1], c_2[1], c_3[1], c_4[1], c_5[1], c_6[1], c_7[1], c_8[1], c_9[1]
    first = c_0[2], c_1[2], c_2[2], c_3[2], c_4[2], c_5[2], c_6[2], c_7[2], c_8[2], c_9[2]
    total = c_0[3], c_1[3], c_2[3], c_3[3], c_4[3], c_5[3], c_6[3], c_7[3], c_8[3], c_9[3]
    return x, rate, first, total


@inlined
def after_step(dt, q, v, a):
    """`steps.semi_implicit` of ten coordinates: on a plane none is held by a spring of the ground."""
    c_0 = semi_implicit(dt, q[0], v[0], a[0], False)
    c_1 = semi_implicit(dt, q[1], v[1], a[1], False)
    c_2 = semi_implicit(dt, q[2], v[2], a[2], False)
    c_3 = semi_implicit(dt, q[3], v[3], a[3], False)
    c_4 = semi_implicit(dt, q[4], v[4], a[4], False)
    c_5 = semi_implicit(dt, q[5], v[5], a[5], False)
    c_6 = semi_implicit(dt, q[6], v[6], a[6], False)
    c_7 = semi_implicit(dt, q[7], v[7], a[7], False)
    c_8 = semi_implicit(dt, q[8], v[8], a[8], False)
    c_9 = semi_implicit(dt, q[9], v[9], a[9], False)
    return (c_0[0], c_1[0], c_2[0], c_3[0], c_4[0], c_5[0], c_6[0], c_7[0], c_8[0], c_9[0]), (
        c_0[1],
        c_1[1],
        c_2[1],
        c_3[1],
        c_4[1],
        c_5[1],
        c_6[1],
        c_7[1],
        c_8[1],
        c_9[1],
    )


@inlined
def middle(a, b):
    """The mean of ten and ten."""
    return (
        0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1]), 0.5 * (a[2] + b[2]), 0.5 * (a[3] + b[3]), 0.5 * (a[4] + b[4]),
        0.5 * (a[5] + b[5]), 0.5 * (a[6] + b[6]), 0.5 * (a[7] + b[7]), 0.5 * (a[8] + b[8]), 0.5 * (a[9] + b[9]),
    )  # fmt: skip


@inlined
def feed_torques(p, fx, now, v, modes, hold, dt, eta, previous):
    """What the next step takes from this one, see `loop.feed_back`."""
    right, left, right_b, left_b = now.acting
    feed_torque(p.right_front, fx, right, v[6], MOTOR[0], modes, hold, dt, eta, previous)
    feed_torque(p.left_front, fx, left, v[7], MOTOR[1], modes, hold, dt, eta, previous)
    if p.two:
        feed_torque(p.right_back, fx, right_b, v[8], MOTOR[2], modes, hold, dt, eta, previous)
        feed_torque(p.left_back, fx, left_b, v[9], MOTOR[3], modes, hold, dt, eta, previous)


@inlined
def feed_torque(unit, fx, acting, theta_dot, motor, modes, hold, dt, eta, previous):
    """What the next step takes from one motor: its torque (eq. 30) and its efficiency (eq. 23)."""
    previous[motor] = acting.M_m
    eta[motor] = next_efficiency(unit, fx, acting, theta_dot, motor, modes, hold, dt)


@inlined
def wind_level(p, fx, modes, here, drive, hold, behind):
    """With effects: `integrators.wind_up` of all motors, whose angles are the last four of the ten coordinates."""
    wind_up(fx, modes[0], here[6], MOTOR[0], drive, hold, behind)
    wind_up(fx, modes[1], here[7], MOTOR[1], drive, hold, behind)
    if p.two:
        wind_up(fx, modes[2], here[8], MOTOR[2], drive, hold, behind)
        wind_up(fx, modes[3], here[9], MOTOR[3], drive, hold, behind)


@inlined
def begin(q, v, p, fx, w):
    """Gravity into the row; a rover at q and v; its coordinates and rates as tuples."""
    module_gravity(p.front, p, FRONT, w)
    if p.two:
        module_gravity(p.back, p, BEHIND, w)
    return stand(p, fx, q), load(q), load(v)


@kernel
def level_rk4(state, p, inputs, grid, work, out, out_e, fx=None, memory=()):
    """RK4 steps of a rover that stands level, for the same arguments as `loop.integrate_rk4`; LEAVES for another."""
    (q, v, eta, previous, behind), (dt, steps, every, knot_steps) = state, grid
    if not level(p, fx, q, v):
        return LEAVES, 0
    w, drive, cubic, hold, eta_next, _, _, _, _, e, _, lag, sum_lag = work
    at, here, rate = begin(q, v, p, fx, w)
    (start, count), lags, energies = start_lags(fx, memory, lag), lags_of(memory, lag), accounted(out_e)
    begin_loops(hold)
    commands = MotorCommands(inputs.modes, drive, hold)
    row = phase = knot = since = NOUGHT
    begun, known = here, (0.0, 1.0, 0.0, 1.0)
    for step in range(steps + 1):
        s = prepare(p, inputs, grid, phase, knot, state, cubic, hold)
        q_k, v_k, first, total = here, rate, NOTHING, NOTHING
        for k in range(4):
            if k != 2:
                command_at(cubic, s + stage_time(k, dt), inputs.modes, drive)
            if k > 0 and near(begun, q_k):
                trig = turned(known, begun, q_k)
            else:
                begun, trig = q_k, heading(q_k)
                known = trig
            if fx is not None:
                fx.t = start + (dt * step + stage_time(k, dt))
                if k == 0:
                    wind_level(p, fx, inputs.modes, here, drive, hold, behind)
            a, now = level_accelerations(at, p, fx, q_k, v_k, trig, commands, lags, None, k == 0 or energies)
            kept = k == 0 and (since == 0 or step == steps)
            if kept:
                write_row(at, p.two, fx, motions(q_k, v_k), trig, a, now, hold, w)
            if k == 0:
                if kept:
                    unload(here, p.two, q)
                    unload(rate, p.two, v)
                    if not sound(q, v):
                        return DIVERGED, row
                    keep_row(q, v, w, e, row, out, out_e)
                    row += 1
                if step == steps:
                    return OK, row
                feed_torques(p, fx, now, v_k, inputs.modes, hold, dt, eta_next, previous)
            if out_e is not None and energies:
                level_powers(at, p, fx, motions(q_k, v_k), trig, q_k, v_k, now, hold, Account(stage_weight(k) * dt, e))
            q_k, v_k, first, total = next_ten(k, dt, here, rate, v_k, a, first, total)
            if fx is not None:
                next_lag(k, count, memory, dt, lag, sum_lag)
        here, rate = q_k, v_k
        for motor in range(4 if p.two else 2):
            eta[motor] = eta_next[motor]
        phase, since = phase + 1, since + 1
        if phase == knot_steps:
            phase, knot = 0, knot + 1
        if since == every:
            since = 0
    return OK, row


@kernel
def level_semi(state, p, inputs, grid, work, out, out_e, fx=None, memory=()):
    """Semi-implicit steps of a rover that stands level, arguments as `loop.integrate_rk4` has; LEAVES for another."""
    (q, v, eta, previous, behind), (dt, steps, every, knot_steps) = state, grid
    if not level(p, fx, q, v):
        return LEAVES, 0
    w, drive, cubic, hold, _, _, _, _, _, e, _, lag, _ = work
    at, here, rate = begin(q, v, p, fx, w)
    (start, count), lags, energies = start_lags(fx, memory, lag), lags_of(memory, lag), accounted(out_e)
    begin_loops(hold)
    commands = MotorCommands(inputs.modes, drive, hold)
    row = phase = knot = since = NOUGHT
    for step in range(steps + 1):
        s = prepare(p, inputs, grid, phase, knot, state, cubic, hold)
        command_at(cubic, s, inputs.modes, drive)
        mean_acceleration(cubic, s, dt, drive)
        trig = heading(here)
        if fx is not None:
            fx.t = start + dt * step
            wind_level(p, fx, inputs.modes, here, drive, hold, behind)
        a, now = level_accelerations(at, p, fx, here, rate, trig, commands, lags, dt, True)
        there, new = after_step(dt, here, rate, a)
        kept = since == 0 or step == steps
        if kept:
            write_row(at, p.two, fx, motions(here, rate), trig, a, now, hold, w)
        if kept:
            unload(here, p.two, q)
            unload(rate, p.two, v)
            if not sound(q, v):
                return DIVERGED, row
            keep_row(q, v, w, e, row, out, out_e)
            row += 1
        if step == steps:
            break
        feed_torques(p, fx, now, new, inputs.modes, hold, dt, eta, previous)
        if fx is not None:
            lags_after(count, memory, dt, lag)
        if out_e is not None and energies:
            level_powers(at, p, fx, motions(here, rate), trig, here, middle(rate, new), now, hold, Account(dt, e))
        here, rate = there, new
        phase, since = phase + 1, since + 1
        if phase == knot_steps:
            phase, knot = 0, knot + 1
        if since == every:
            since = 0
    return OK, row
