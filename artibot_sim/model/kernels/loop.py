"""The compiled integration loop: the only place where speed beats looks."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from artibot_sim.model.effects import hooks
from artibot_sim.model.equations.dynamics import module_gravity
from artibot_sim.model.equations.transmission import PRESCRIBED, TORQUE, drives_next, driving, impulses, sticks
from artibot_sim.model.kernels.compilation import inlined, kernel
from artibot_sim.model.kernels.elementary import cubic_at, cubic_between
from artibot_sim.model.kernels.energy import powers
from artibot_sim.model.kernels.integrators import (
    D_DDOT,
    D_DOT,
    EFFICIENCY,
    GEAR,
    HELD,
    INERTIA,
    TORQUE_D,
    D,
    MotorAction,
    MotorCommands,
    accelerations,
    begin_loops,
    coordinate_of,
    hold_efficiencies,
    motor_count,
    motor_of,
    wind_up,
)
from artibot_sim.model.kernels.layout import ACC, BEHIND, BETA, ENERGIES, FRONT, M_D, M_M, M_R, MEMORY, NOUGHT, ROW, Z
from artibot_sim.model.kernels.steps import next_stage, next_stage_of_lag, semi_implicit, stage_time, stage_weight

OK, DIVERGED = 0, 1
STOPPED = 3
"""The ground ended a rollout: a wheel left the raster, or met a wall, see `ground.raster.Surface.found`."""
LIMIT = 1e6
"""A speed (m/s or rad/s) or angle beyond which a rollout has diverged; motors of Epi.q reach 3000 rad/s."""


class Workspace(NamedTuple):
    """Arrays that a loop works in, so that it allocates nothing."""

    w: NDArray[np.float64]
    drive: NDArray[np.float64]
    cubic: NDArray[np.float64]
    hold: NDArray[np.float64]
    eta_next: NDArray[np.float64]
    q: NDArray[np.float64]
    v: NDArray[np.float64]
    first: NDArray[np.float64]
    total: NDArray[np.float64]
    e: NDArray[np.float64]
    power: NDArray[np.float64]
    lag: NDArray[np.float64]
    sum_lag: NDArray[np.float64]


def workspace() -> Workspace:
    """A fresh one, for one loop at a time."""
    return Workspace(*map(np.zeros, (ROW, 12, 16, HELD, 4, 16, 16, 16, 16, ENERGIES, ENERGIES, 2 * MEMORY, MEMORY)))


@inlined
def hermite(position, velocity, knot, h, cubic):
    """Coefficients of the commands' cubic between two knots, motor by motor, into `cubic` (16,)."""
    last = position.shape[0] - 1
    i, j = min(knot, last), min(knot + 1, last)
    going = 1.0 / h if j > i else 0.0
    for motor in range(4):
        cubic[motor], cubic[4 + motor] = position[i, motor], velocity[i, motor]
        cubic[8 + motor], cubic[12 + motor] = cubic_between(
            position[i, motor], position[j, motor], velocity[i, motor], velocity[j, motor], going
        )


@inlined
def command_at(cubic, s, modes, drive):
    """Commanded angles, speeds and accelerations `s` seconds after the knot, into `drive` (12,)."""
    for motor in range(4):
        if modes[motor] == TORQUE:
            continue
        drive[D + motor], drive[D_DOT + motor], drive[D_DDOT + motor] = cubic_at(
            cubic[motor], cubic[4 + motor], cubic[8 + motor], cubic[12 + motor], s
        )


@inlined
def mean_acceleration(cubic, s, dt, drive):
    """Mean of the commanded accelerations from `s` to ``s + dt``, in place of the instant's."""
    for motor in range(4):
        drive[D_DDOT + motor] = 2.0 * cubic[8 + motor] + 3.0 * cubic[12 + motor] * (2.0 * s + dt)


@inlined
def commanded_torques(torque_d, knot, back_factor, previous, modes, hold):
    """Torques held through a step, of motors under torque: commanded ones, or eq. 30 from the step before (NaN).

    Of prescribed motors they are what was measured, if anything: see `transmission.drives_next`.
    """
    i = min(knot, torque_d.shape[0] - 1)
    shared = back_factor * (previous[0] + previous[1])
    for motor in range(4):
        given = torque_d[i, motor]
        torque = given if not math.isnan(given) else (shared if motor > 1 else 0.0)
        measured = given if modes[motor] == PRESCRIBED else math.nan
        hold[TORQUE_D + motor] = torque if modes[motor] == TORQUE else measured


@inlined
def feed_back(p, fx, v, w, modes, hold, dt, eta, previous):
    """What the next step takes from this one: efficiencies (eq. 23) and the torques of eq. 30 (Fig. 7)."""
    for motor in range(motor_count(p)):
        previous[motor], c = w[M_M + motor], coordinate_of(motor)
        acting = MotorAction(
            w[M_M + motor], w[M_R + motor], w[M_D + motor] if fx is not None else 0.0, w[ACC + c], v[c]
        )  # fmt: skip
        eta[motor] = next_efficiency(motor_of(p, motor), fx, acting, v[c], motor, modes, hold, dt)


@inlined
def next_efficiency(unit, fx, acting, theta_dot, motor, modes, hold, dt):
    """Efficiency of a motor for the next step (eq. 23), from what it does and how it turns in this one.

    It is that of a motor that drives its gear or of one that the gear brakes; of one that stands on ground that holds
    its wheels, between these.
    """
    through_gear, measured = acting.M_m - acting.drag, hold[TORQUE_D + motor] - acting.drag
    eta = hold[EFFICIENCY + motor]
    if modes[motor] == PRESCRIBED and measured == measured:
        drives = drives_next(
            through_gear, theta_dot, unit.J_m * acting.theta_ddot, 1.0 / eta, 1.0 / unit.eta_d, unit.eta_r, measured
        )
    else:  # one rover alone, with nothing measured, does not pay for what decides between two
        if holds_wheels(fx):
            brought, taken = impulses(
                through_gear, theta_dot, hold[GEAR + motor] * acting.M_r, unit.J_m, hold[INERTIA + motor], dt
            )
            # inverses times what is positive, which spares divisions
            if sticks(through_gear, brought, taken, unit.eta_d, eta, eta * (unit.eta_d * unit.eta_r)):
                return eta * taken / brought
        drives = driving(through_gear, theta_dot)
    return unit.eta_d if drives else 1.0 / unit.eta_r


@inlined
def holds_wheels(fx):
    """Whether bristles hold wheels at rest. By eq. 15 alone they creep, and no motor stands: then eq. 23 is all."""
    if fx is not None:
        stiff, _ = hooks.bristle(fx, 0.0)
        return stiff > 0.0
    return False


@inlined
def wind_all(p, fx, modes, q, drive, hold, behind):
    """With effects: `wind_up` of all motors."""
    for motor in range(motor_count(p)):
        wind_up(fx, modes[motor], q[coordinate_of(motor)], motor, drive, hold, behind)


@inlined
def sound(q, v):
    """Whether a state is finite and within what a rover can do."""
    for i in range(16):
        if not (abs(v[i]) < LIMIT and abs(q[i]) < 1e12):
            return False
    return True


@inlined
def prepare(p, inputs, grid, phase, knot, state, cubic, hold):
    """What is held through a step that begins `phase` steps after a knot; returns the time since the knot, s."""
    if phase == 0:
        hermite(inputs.position, inputs.velocity, knot, grid.knot_steps * grid.dt, cubic)
    commanded_torques(inputs.torque_d, knot, inputs.share, state.previous, inputs.modes, hold)
    hold_efficiencies(p, state.eta, hold)
    return phase * grid.dt


@inlined
def stopped_by(ground, t):
    """Whether uneven ground ends the rollout here, `t` (s) after its start, which is noted."""
    if len(ground) == 0:
        return False
    ground.found[3] = t
    return ground.found[0] != 0.0


@inlined
def accounted(out_e):
    """Whether energies are asked for: None says no at compile time, an array without rows when the loop runs."""
    if out_e is None:
        return False
    return out_e.shape[0] > 0


@inlined
def add_powers(q, v, p, fx, ground, w, weight, e, pw):
    """Accumulate `weight` (s) times the power of every contribution."""
    powers(q, v, p, fx, ground, w, pw)
    for i in range(ENERGIES):
        e[i] += weight * pw[i]


@inlined
def next_state(k, q, v, dt, w, q_s, v_s, first, total):
    """From stage `k` to the next; after the last one, advance (q, v)."""
    for i in range(16):
        q_s[i], v_s[i], first[i], total[i] = next_stage(k, dt, q[i], v[i], v_s[i], w[ACC + i], first[i], total[i])
        if k == 3:
            q[i], v[i] = q_s[i], v_s[i]


@inlined
def next_lag(k, count, memory, dt, lag, sum_lag):
    """What wheels remember, `count` numbers, from stage `k` to the next; after the last one advance `memory`.

    `lag` holds the stage's and then their rates.
    """
    if len(memory) == 0:
        return
    kept = memory[0]
    for i in range(count):
        lag[i], sum_lag[i] = next_stage_of_lag(k, dt, kept[i], lag[MEMORY + i], sum_lag[i])
        if k == 3:
            kept[i] = lag[i]


@inlined
def remembered(fx, wheels):
    """How many numbers so many `wheels` remember by the effects at work, of the first of `layout.MEMORY`."""
    if fx is not None:
        _, renewal = hooks.bristle(fx, 1.0)
        if renewal > 0.0:
            return 4 * wheels
        if hooks.windup(fx) > 0.0:
            return 2 * wheels
        return wheels if hooks.follow_rate(fx, 1.0) > 0.0 else 0
    return 0


@inlined
def start_lags(fx, memory, lag):
    """What wheels remember into `lag`; the time of the start (s), and how many numbers change (`remembered`)."""
    if fx is None:
        return 0.0, 0
    if len(memory) == 0:
        return fx.t, 0
    kept = memory[0]
    for i in range(MEMORY):
        lag[i] = kept[i]
    return fx.t, remembered(fx, 8)


@inlined
def lags_of(memory, lag):
    """What a right-hand side takes of `lag`: nothing, at compile time, for wheels that remember nothing."""
    if len(memory) == 0:
        return ()
    return (lag,)


@inlined
def lags_after(count, memory, dt, lag):
    """What wheels remember after a semi-implicit step."""
    if len(memory) == 0:
        return
    kept = memory[0]
    for i in range(count):
        kept[i] += dt * lag[MEMORY + i]
        lag[i] = kept[i]


@inlined
def keep(values, row, out):
    """Copy what is kept of an instant."""
    for i in range(len(values)):
        out[row, i] = values[i]


@inlined
def keep_row(q, v, w, e, row, out, out_e):
    """Copy all that is kept of an instant."""
    keep(q, row, out.q)
    keep(v, row, out.v)
    keep(w, row, out.w)
    if out_e is not None and accounted(out_e):
        keep(e, row, out_e)


@kernel
def integrate_rk4(state, p, inputs, grid, work, out, out_e, fx=None, memory=(), ground=()):
    """Advance the state in place by `steps` steps and keep every `every`-th row, the first and the last included.

    Parameters
    ----------
    state : layout.RunState
    p : record of PARAMS_DTYPE
    inputs : layout.MotorInputs
    grid : layout.Grid
    work : Workspace
    out : layout.Rows
    out_e : array, shape (rows, ENERGIES), or None
        None leaves the energies out, at compile time; an array without rows does when the loop runs.
    fx : record, optional
        Effects' parameters, with the time of the start in ``fx.t`` (see `effects.record`); without it, at compile time,
        it is the paper's model.
    memory : tuple of no or one array, shape (MEMORY,)
        What wheels remember, see `layout`; advanced in place, too. Where it is empty, at compile time, they remember
        nothing.
    ground : ground.raster.Surface
        An empty tuple, at compile time, for flat ground.

    Returns
    -------
    tuple of int
        OK, DIVERGED or STOPPED, and the number of rows written.
    """
    (q, v, eta, previous, behind), (dt, steps, every, _) = state, grid
    w, drive, cubic, hold, eta_next, q_s, v_s, first, total, e, pw, lag, sum_lag = work
    (start, count), lags, energies = start_lags(fx, memory, lag), lags_of(memory, lag), accounted(out_e)
    begin_loops(hold)
    commands = MotorCommands(inputs.modes, drive, hold)
    for i in range(16):
        q_s[i], v_s[i] = q[i], v[i]
    module_gravity(p.front, p, FRONT, w)
    if p.two:
        module_gravity(p.back, p, BEHIND, w)
    row = NOUGHT
    for step in range(steps + 1):
        s = prepare(p, inputs, grid, step % grid.knot_steps, step // grid.knot_steps, state, cubic, hold)
        for k in range(4):
            if k != 2:
                command_at(cubic, s + stage_time(k, dt), inputs.modes, drive)
            if fx is not None:
                fx.t = start + (dt * step + stage_time(k, dt))
                if k == 0:
                    wind_all(p, fx, inputs.modes, q, drive, hold, behind)
            accelerations(q_s, v_s, p, fx, ground, commands, lags, None, w)
            if k == 0:
                stopped = stopped_by(ground, dt * step)
                if step == steps or step % every == 0 or stopped:
                    if not sound(q, v):
                        return DIVERGED, row
                    keep_row(q, v, w, e, row, out, out_e)
                    row += 1
                if step == steps or stopped:
                    return (STOPPED if stopped else OK), row
                feed_back(p, fx, v, w, inputs.modes, hold, dt, eta_next, previous)
            if out_e is not None and energies:
                add_powers(q_s, v_s, p, fx, ground, w, stage_weight(k) * dt, e, pw)
            next_state(k, q, v, dt, w, q_s, v_s, first, total)
            if fx is not None:
                next_lag(k, count, memory, dt, lag, sum_lag)
        for motor in range(motor_count(p)):
            eta[motor] = eta_next[motor]
    return OK, row


@kernel
def integrate_semi_implicit(state, p, inputs, grid, work, out, out_e, fx=None, memory=(), ground=()):
    """Advance the state in place by semi-implicit steps, for the same arguments as `integrate_rk4`.

    A row's contributions are those that act from its state to the next.
    """
    (q, v, eta, previous, behind), (dt, steps, every, _) = state, grid
    w, drive, cubic, hold, _, q_old, v_old, _, _, e, pw, lag, _ = work
    (start, count), lags, energies = start_lags(fx, memory, lag), lags_of(memory, lag), accounted(out_e)
    begin_loops(hold)
    commands = MotorCommands(inputs.modes, drive, hold)
    module_gravity(p.front, p, FRONT, w)
    if p.two:
        module_gravity(p.back, p, BEHIND, w)
    row = NOUGHT
    for step in range(steps + 1):
        s = prepare(p, inputs, grid, step % grid.knot_steps, step // grid.knot_steps, state, cubic, hold)
        command_at(cubic, s, inputs.modes, drive)
        mean_acceleration(cubic, s, dt, drive)
        for i in range(16):
            q_old[i], v_old[i] = q[i], v[i]
        if fx is not None:
            fx.t = start + dt * step
            wind_all(p, fx, inputs.modes, q, drive, hold, behind)
        accelerations(q, v, p, fx, ground, commands, lags, dt, w)
        for i in range(16):
            q[i], v[i] = semi_implicit(dt, q[i], v[i], w[ACC + i], Z <= i % 8 <= BETA)
        if step == steps or step % every == 0 or stopped_by(ground, dt * step):
            if not sound(q_old, v_old):
                return DIVERGED, row
            keep_row(q_old, v_old, w, e, row, out, out_e)
            row += 1
            if stopped_by(ground, dt * step):
                return STOPPED, row
        if step == steps:
            for i in range(16):
                q[i], v[i] = q_old[i], v_old[i]
            break
        feed_back(p, fx, v, w, inputs.modes, hold, dt, eta, previous)
        if fx is not None:
            lags_after(count, memory, dt, lag)
        if out_e is not None and energies:
            for i in range(16):
                v_old[i] = 0.5 * (v_old[i] + v[i])
            add_powers(q_old, v_old, p, fx, ground, w, dt, e, pw)
    return OK, row
