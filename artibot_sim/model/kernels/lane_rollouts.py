"""Whole rollouts in lanes: the compiled loops below `batch.rollout_batch`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from artibot_sim.model.equations.dynamics import module_gravity
from artibot_sim.model.kernels.compilation import inlined, kernel, line_up_stack
from artibot_sim.model.kernels.integrators import TRAIL, MotorCommands, accelerations, hold_efficiencies
from artibot_sim.model.kernels.lane_layout import AT, EFFECT_VALUES, LANES, SIZE, effects_at
from artibot_sim.model.kernels.lane_loading import PLACES, load_lane, load_motors
from artibot_sim.model.kernels.lanes import check, cubics, end_stage, leave_knot, next_knot, sound_rows, stage
from artibot_sim.model.kernels.layout import BACK, BEHIND, FRONT, MEMORY
from artibot_sim.model.kernels.loop import command_at, commanded_torques, hermite, keep, wind_all

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

KEPT_SIZE = 2 * SIZE + 16 + MEMORY
"""Numbers of a row in lanes: coordinates, rates, inverse efficiencies, torques of the step before, what velocity loops
hold and how far motors were behind their commands then, wheels' memories."""


class Lot(NamedTuple):
    """Up to LANES rollouts of equal length; arrays as `layout.RunState` and `layout.MotorInputs` have them, a row each.

    Attributes
    ----------
    records : array of PARAMS_DTYPE, shape (n,)
    effects : array, shape (n, EFFECT_VALUES)
        Flat records of effects, their times those of the starts.
    modes : array of int, shape (n, 4)
    share : array, shape (n,)
    q, v : array, shape (n, 16)
    eta, torque, behind : array, shape (n, 4)
    memory : array, shape (n, MEMORY)
    position, velocity, torque_d : array, shape (k, 4)
        Knots of all commands, one after the other.
    first, last : array of int, shape (n,)
        First and last knot of each rollout's.
    """

    records: NDArray[np.void]
    effects: Array
    modes: Indices
    share: Array
    q: Array
    v: Array
    eta: Array
    torque: Array
    behind: Array
    memory: Array
    position: Array
    velocity: Array
    torque_d: Array
    first: Indices
    last: Indices


@inlined
def load_lot(S, lot, fx):
    """Rollouts into lanes; lanes that are left over repeat the first."""
    for e in range(LANES):
        i = e if e < lot.share.shape[0] else 0
        if fx is not None:
            for k in range(EFFECT_VALUES):
                S[AT.EFFECTS + k * LANES + e] = lot.effects[i, k]
        load_motors(S, e, lot.records[i], lot.modes, i, lot.eta, i, lot.share[i])
        load_lane(S, e, lot.records[i], effects_at(S, fx, e, 0.0), lot.q, lot.v, i)
        for motor in range(4):
            S[AT.PREVIOUS + motor * LANES + e] = lot.torque[i, motor]
            S[AT.BEHIND + motor * LANES + e] = lot.behind[i, motor]
        for k in range(MEMORY):
            S[AT.LAG + k * LANES + e] = S[AT.LAG_S + k * LANES + e] = lot.memory[i, k]
        next_knot(S, e, lot.position, lot.velocity, lot.position, 0, lot.first[i], 1.0, 0.0)


@inlined
def load_knot(S, lot, knot, h):
    """All lanes' commands from a knot to the next, `h` seconds later; after the last one they stay."""
    leave_knot(S)
    for e in range(LANES):
        i = e if e < lot.share.shape[0] else 0
        here, ahead = min(lot.first[i] + knot, lot.last[i]), min(lot.first[i] + knot + 1, lot.last[i])
        next_knot(S, e, lot.position, lot.velocity, lot.position, 0, ahead, 1.0, 0.0)
        for motor in range(4):
            S[AT.GIVEN + motor * LANES + e] = lot.torque_d[here, motor]
            S[AT.GOING + motor * LANES + e] = 1.0 / h if ahead > here else 0.0
    cubics(S)


@inlined
def keep_state(S, row, kept):
    """All that a step begins with, into `kept`."""
    o = row * KEPT_SIZE * LANES
    for j in range(2 * SIZE * LANES):
        kept[o + j] = S[AT.Q + j]
    o += 2 * SIZE * LANES
    for j in range(4 * LANES):
        kept[o + j], kept[o + 4 * LANES + j] = S[AT.GEAR + j], S[AT.PREVIOUS + j]
        kept[o + 8 * LANES + j], kept[o + 12 * LANES + j] = S[AT.BEHIND + j], S[AT.TRAIL + j]
    for j in range(MEMORY * LANES):
        kept[o + 16 * LANES + j] = S[AT.LAG + j]
    check(S)


@kernel
def run_lot(lot, grid, settings, S, kept, rows, fx=None):
    """Advance all rollouts of a lot; keep what each `every`-th step begins with, and the end.

    Parameters
    ----------
    lot : Lot
    grid : layout.Grid
    settings : array of int, shape (2,)
        As in `window_lanes.run_windows`.
    S : array, shape (BLOCK,)
    kept : array, shape (rows · KEPT_SIZE · LANES,)
    rows : array of int, shape (LANES,)
        How many rows of each are sound: an output.
    """
    line_up_stack()
    dt, steps, every, knot_steps = grid
    load_lot(S, lot, fx)
    for step in range(steps):
        phase = step % knot_steps
        if phase == 0:
            load_knot(S, lot, step // knot_steps, knot_steps * dt)
        if step % every == 0:
            keep_state(S, step // every, kept)
        for k in range(settings[0]):
            stage(S, fx, k, phase * dt, dt * step, dt, settings[1])
            end_stage(S, fx, k, dt)
    keep_state(S, (steps + every - 1) // every, kept)
    for e in range(LANES):
        rows[e] = sound_rows(S, e)


@inlined
def unpack(kept, row, e, two, q, v, eta, previous, behind, hold, memory):
    """A row of lane `e`, into the planar coordinates of q and v (16,), eta, previous and behind (4,), memory (MEMORY,).

    Into `hold` goes how far motors were behind their commands a step before.
    """
    o = row * KEPT_SIZE * LANES + e
    for i in range(SIZE):
        if not two and PLACES[i] >= BACK:
            continue
        q[PLACES[i]], v[PLACES[i]] = kept[o + i * LANES], kept[o + (SIZE + i) * LANES]
    o += 2 * SIZE * LANES
    for motor in range(4 if two else 2):
        eta[motor], previous[motor] = 1.0 / kept[o + motor * LANES], kept[o + (4 + motor) * LANES]
        behind[motor], hold[TRAIL + motor] = kept[o + (8 + motor) * LANES], kept[o + (12 + motor) * LANES]
    for k in range(MEMORY):
        memory[k] = kept[o + (16 + k) * LANES]


@kernel
def fill_rows(lot, lane, grid, kept, rows, work, tables, fx=None):
    """Rows of a lane as `loop.integrate_rk4` keeps them, contributions and all.

    Parameters
    ----------
    lot : Lot
        Its states are those of the starts; then that of the lane is the last row's.
    grid : layout.Grid
    kept : array
        What `run_lot` has kept.
    rows : int
        How many.
    work : loop.Workspace
    tables : tuple of 3 arrays, shapes (rows, 16), (rows, 16), (rows, ROW)
        An output: q, v and the named contributions.
    fx : record, optional
        Effects, with the time of the start.
    """
    w, drive, cubic, hold, _, _, _, _, _, _, _, lag, _ = work
    p, modes, share = lot.records[lane], lot.modes[lane], lot.share[lane]
    q, v, eta, previous, memory = lot.q[lane], lot.v[lane], lot.eta[lane], lot.torque[lane], lot.memory[lane]
    behind = lot.behind[lane]
    first, end = lot.first[lane], lot.last[lane] + 1
    position, velocity, torque_d = lot.position[first:end], lot.velocity[first:end], lot.torque_d[first:end]
    start = 0.0
    if fx is not None:
        start = fx.t
    module_gravity(p.front, p, FRONT, w)
    if p.two:
        module_gravity(p.back, p, BEHIND, w)
    for row in range(rows):
        step = min(row * grid.every, grid.steps)
        knot, s = step // grid.knot_steps, (step % grid.knot_steps) * grid.dt
        unpack(kept, row, lane, p.two, q, v, eta, previous, behind, hold, memory)
        for k in range(MEMORY):
            lag[k] = memory[k]
        hermite(position, velocity, knot, grid.knot_steps * grid.dt, cubic)
        commanded_torques(torque_d, knot, share, previous, modes, hold)
        hold_efficiencies(p, eta, hold)
        command_at(cubic, s, modes, drive)
        if fx is not None:
            fx.t = start + grid.dt * step
            wind_all(p, fx, modes, q, drive, hold, behind)
        accelerations(q, v, p, fx, (), MotorCommands(modes, drive, hold), (lag,), None, w)
        keep(q, row, tables[0])
        keep(v, row, tables[1])
        keep(w, row, tables[2])
