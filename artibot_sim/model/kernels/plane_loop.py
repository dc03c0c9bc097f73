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
    hermite,
    keep_row,
    lags_of,
    next_efficiency,
    next_lag,
    next_semi_lag,
    prepare,
    restore,
    save,
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
from artibot_sim.model.kernels.steps import (
    FINER,
    implicit_over,
    next_semi_implicit,
    next_stage,
    semi_implicit_time,
    semi_implicit_weight,
    stage_time,
    stage_weight,
)

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
def next_semi_ten(k, dt, q, v, a, first):
    """`steps.next_semi_implicit` of ten coordinates."""
    c_0 = next_semi_implicit(k, dt, q[0], v[0], a[0], first[0])
    c_1 = next_semi_implicit(k, dt, q[1], v[1], a[1], first[1])
    c_2 = next_semi_implicit(k, dt, q[2], v[2], a[2], first[2])
    c_3 = next_semi_implicit(k, dt, q[3], v[3], a[3], first[3])
    c_4 = next_semi_implicit(k, dt, q[4], v[4], a[4], first[4])
    c_5 = next_semi_implicit(k, dt, q[5], v[5], a[5], first[5])
    c_6 = next_semi_implicit(k, dt, q[6], v[6], a[6], first[6])
    c_7 = next_semi_implicit(k, dt, q[7], v[7], a[7], first[7])
    c_8 = next_semi_implicit(k, dt, q[8], v[8], a[8], first[8])
    c_9 = next_semi_implicit(k, dt, q[9], v[9], a[9], first[9])
    x = c_0[0], c_1[0], c_2[0], c_3[0], c_4[0], c_5[0], c_6[0], c_7[0], c_8[0], c_9[0]
    rate = c_0[1], c_1[1], c_2[1], c_3[1], c_4[1], c_5[1], c_6[1], c_7[1], c_8[1], c_9[1]
    return x, rate


@inlined
def feed_torques(p, fx, now, modes, hold, dt, eta, previous):
    """What the next step takes from this one, see `loop.feed_back`."""
    right, left, right_b, left_b = now.acting
    feed_torque(p.right_front, fx, right, MOTOR[0], modes, hold, dt, eta, previous)
    feed_torque(p.left_front, fx, left, MOTOR[1], modes, hold, dt, eta, previous)
    if p.two:
        feed_torque(p.right_back, fx, right_b, MOTOR[2], modes, hold, dt, eta, previous)
        feed_torque(p.left_back, fx, left_b, MOTOR[3], modes, hold, dt, eta, previous)


@inlined
def feed_torque(unit, fx, acting, motor, modes, hold, dt, eta, previous):
    """What the next step takes from one motor: its torque (eq. 30) and its efficiency (eq. 23)."""
    previous[motor] = acting.M_m
    eta[motor] = next_efficiency(unit, fx, acting, acting.speed, motor, modes, hold, dt)


@inlined
def sliding(now, two):
    """Which wheels slide, by the bits of a number, see `loop.sliding`."""
    front_r, front_l, back_r, back_l = now.forces
    wheels = slides(front_r) * 4 + slides(front_l)
    return wheels * 16 + slides(back_r) * 4 + slides(back_l) if two else wheels * 16


@inlined
def slides(forces):
    """Which of a motor's two wheels slide."""
    return (2 if forces.held_f != 1.0 else 0) + (1 if forces.held_b != 1.0 else 0)


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
    w, drive, cubic, hold, eta_next, _, _, _, _, e, _, lag, sum_lag, _ = work
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
                feed_torques(p, fx, now, inputs.modes, hold, dt, eta_next, previous)
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
    w, drive, cubic, hold, _, _, _, _, _, e, _, lag, first_lag, saved = work
    at, here, rate = begin(q, v, p, fx, w)
    (start, count), lags, energies = start_lags(fx, memory, lag), lags_of(memory, lag), accounted(out_e)
    begin_loops(hold)
    commands = MotorCommands(inputs.modes, drive, hold)
    row = step = part = slid = phase = knot = since = NOUGHT
    parts, settled, begun = NOUGHT + 1, True, (here, rate)
    trig = heading(here)
    while True:
        h, again = dt / parts, False
        s = prepare(p, inputs, grid, phase, knot, state, cubic, hold) + part * h
        q_k, v_k, first = here, rate, NOTHING
        for k in range(2):
            command_at(cubic, s + semi_implicit_time(k, h), inputs.modes, drive)
            if k > 0 and near(here, q_k):
                trig = turned(trig, here, q_k)
            else:
                trig = heading(q_k)
            if fx is not None:
                fx.t = start + (dt * step + part * h + semi_implicit_time(k, h))
                if k == 0:
                    wind_level(p, fx, inputs.modes, here, drive, hold, behind)
            over, torques = implicit_over(k, h), k == 0 or energies
            a, now = level_accelerations(at, p, fx, q_k, v_k, trig, commands, lags, over, torques)
            if k == 0 and parts == 1:
                slide = sliding(now, p.two)
                again = slide != slid and not settled
                if again:
                    break
                slid, begun = slide, (here, rate)
                if since == 0 or step == steps:
                    write_row(at, p.two, fx, motions(q_k, v_k), trig, a, now, hold, w)
                    unload(here, p.two, q)
                    unload(rate, p.two, v)
                    if not sound(q, v):
                        return DIVERGED, row
                    keep_row(q, v, w, e, row, out, out_e)
                    row += 1
                if step == steps:
                    return OK, row
                save(fx, eta, previous, hold, behind, memory, e, energies, saved)
            if k == 0:
                feed_torques(p, fx, now, inputs.modes, hold, h, eta, previous)
            if out_e is not None and energies:
                weight = semi_implicit_weight(k) * h
                level_powers(at, p, fx, motions(q_k, v_k), trig, q_k, v_k, now, hold, Account(weight, e))
            q_k, v_k = next_semi_ten(k, h, here, rate, a, first)
            first = a
            if fx is not None:
                next_semi_lag(k, count, memory, h, lag, first_lag)
        if again:
            restore(fx, eta, previous, hold, behind, memory, lag, e, energies, saved)
            here, rate = begun
            step, part, parts, settled = step - 1, NOUGHT, FINER, True
            phase, knot, since = step % knot_steps, step // knot_steps, step % every
            hermite(inputs.position, inputs.velocity, knot, knot_steps * dt, cubic)
            continue
        here, rate, part = q_k, v_k, part + 1
        if part == parts:
            settled = parts > 1
            step, part, parts = step + 1, NOUGHT, NOUGHT + 1
            phase, since = phase + 1, since + 1
            if phase == knot_steps:
                phase, knot = NOUGHT, knot + 1
            if since == every:
                since = NOUGHT
