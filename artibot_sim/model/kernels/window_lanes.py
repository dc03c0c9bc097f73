"""Windows in lanes: the compiled loop below `windows.WindowBatch`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from artibot_sim.model.kernels.compilation import inlined, kernel, line_up_stack
from artibot_sim.model.kernels.lane_layout import AT, BLOCK, EFFECT_VALUES, LANES, aligned, effects_at
from artibot_sim.model.kernels.lane_loading import load_lane, load_motors
from artibot_sim.model.kernels.lanes import (
    check,
    cubics,
    end_stage,
    leave_knot,
    leave_out_back,
    motors_of,
    next_knot,
    sound_rows,
    stage,
)
from artibot_sim.model.kernels.layout import MEMORY
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

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


STAGES, TURNING = range(2)
"""Places in the settings of `run_windows`."""


class WindowItems(NamedTuple):
    """What items run on, as compiled code takes it; n items, r robots, m samples asked for.

    Attributes
    ----------
    records : array of PARAMS_DTYPE, shape (r,)
    eta : array, shape (r, 4)
        Efficiencies of a first step.
    effects : array, shape (r, EFFECT_VALUES)
        Empty where none is at work.
    sensors : array, shape (r, 8)
        Rows of SensorErrors.
    position, velocity, torque : array, shape (k, 4)
        Knots of all tables, one after the other.
    behind : array, shape (k, 8)
        By how much angles and speeds there trail for each second of a low-pass: see `MotorTable.behind`.
    modes : array of int, shape (n, 4)
    share : array, shape (n,)
        Eq. 30's factor.
    robot, first, knots : array of int, shape (n,)
        First knot in `position`, and how many intervals follow.
    q, v : array, shape (n, 16)
    t : array, shape (n,)
    memory : array, shape (n, MEMORY)
    plan_first, plan_last : array of int, shape (n,)
        Where an item's samples stand in `at` and `kind`.
    at, kind : array, shape (m,)
    to : array of int, shape (n,)
        Where an item's results begin in `out`.
    """

    records: NDArray[np.void]
    eta: Array
    effects: Array
    sensors: Array
    position: Array
    velocity: Array
    torque: Array
    behind: Array
    modes: Indices
    share: Array
    robot: Indices
    first: Indices
    knots: Indices
    q: Array
    v: Array
    t: Array
    memory: Array
    plan_first: Indices
    plan_last: Indices
    at: Array
    kind: Indices
    to: Indices


class Buffers(NamedTuple):
    """What one thread writes into: a block, and its rows."""

    S: Array
    rows: Array


def buffers(rows: int) -> Buffers:
    """Fresh ones, for items of at most `rows` rows."""
    return Buffers(aligned(BLOCK), aligned(rows * COLUMNS * LANES))


@inlined
def load_block(S, work, order, block, fx, rigid):
    """Items into lanes."""
    for e in range(LANES):
        i = item_of(order, block, e)
        r = work.robot[i]
        if fx is not None:
            for k in range(EFFECT_VALUES):
                S[AT.EFFECTS + k * LANES + e] = work.effects[r, k]
            S[AT.EFFECTS + e], S[AT.LAWS + e] = work.t[i], r
        load_motors(S, e, work.records[r], work.modes, i, work.eta, r, work.share[i])
        load_lane(S, e, work.records[r], effects_at(S, fx, e, 0.0), work.q, work.v, i)
        for k in range(MEMORY):
            S[AT.LAG + k * LANES + e] = S[AT.LAG_S + k * LANES + e] = work.memory[i, k]
        load_motion(S, e, work, i, 0, rigid)


@inlined
def item_of(order, block, e):
    """The item in lane `e` of a block; lanes that are left over repeat the block's first one."""
    place = block * LANES + e
    return order[place if place < order.shape[0] else block * LANES]


@inlined
def load_motion(S, e, work, i, knot, rigid):
    """Rotations of item `i` at one of its knots, as they were where the sensors of its robot have recorded them."""
    first, sensors = work.first[i], work.sensors[work.robot[i]]
    next_knot(
        S, e, work.position, work.velocity, work.behind, first, first + knot, sensors[ENCODER_SCALE],
        sensors[VELOCITY_FILTER], rigid,
    )  # fmt: skip


@inlined
def load_knot(S, work, order, block, knot, h, rigid):
    """All lanes' commands from a knot to the next, `h` seconds later; lanes that have ended stay at their last."""
    leave_knot(S)
    for e in range(LANES):
        i = item_of(order, block, e)
        pulled, last = work.sensors[work.robot[i], TORQUE_SCALE], work.knots[i]
        load_motion(S, e, work, i, min(knot + 1, last), rigid)
        going = 1.0 / h if knot < last else 0.0
        for motor in range(motors_of(rigid)):
            S[AT.GOING + motor * LANES + e] = going
        row = work.first[i] + min(knot, last)
        for motor in range(motors_of(rigid)):
            given = work.torque[row, motor]
            if pulled != 1.0:
                given /= pulled
            S[AT.GIVEN + motor * LANES + e] = given
    cubics(S)


@inlined
def keep_rows(S, row, rows):
    """What can be sampled of all lanes at a row."""
    o = row * COLUMNS * LANES
    for j in range(3 * LANES):
        rows[o + POSE_AT * LANES + j], rows[o + SPEED_AT * LANES + j] = S[AT.Q + j], S[AT.V + j]
    for e in range(LANES):
        rows[o + YAW_BACK_AT * LANES + e] = S[AT.Q + 5 * LANES + e]
        rows[o + TURN_BACK_AT * LANES + e] = S[AT.V + 5 * LANES + e]
    for j in range(2 * LANES):
        rows[o + PUSH_AT * LANES + j] = S[AT.ACC + j]
    for j in range(4 * LANES):
        rows[o + TORQUE_AT * LANES + j] = S[AT.TORQUE + j]
    check(S)


@inlined
def simulate(S, rows, work, order, block, fx, dt, knot_steps, settings, rigid, laws):
    """Run a block, a row at each knot."""
    if rigid is not None:
        leave_out_back(S)
    steps = work.knots[order[block * LANES]] * knot_steps
    for step in range(steps + 1):
        knot, phase = step // knot_steps, step % knot_steps
        if phase == 0:
            load_knot(S, work, order, block, knot, knot_steps * dt, rigid)
        for k in range(settings[STAGES] if step < steps else 1):
            stage(S, fx, k, phase * dt, dt * step, dt, settings[TURNING], rigid, laws)
            if k + phase == 0:  # asked apart, the compiler would make a version for each answer
                keep_rows(S, knot, rows)
            end_stage(S, fx, k, dt)


@inlined
def sample_plans(S, rows, work, order, block, h, out):
    """What each item's plan asks for, into its part of `out`; NaN from where it diverged."""
    for e in range(LANES):
        place = block * LANES + e
        if place >= order.shape[0]:
            return
        i = order[place]
        count = min(sound_rows(S, e), work.knots[i] + 1)
        if count > 1:
            of = LaneRows(rows, e, LANES, h, count, work.records[work.robot[i]].two)
            wanted = Wanted(work.at, work.kind, work.plan_first[i], work.plan_last[i])
            sample_lane(of, wanted, work.sensors, work.robot[i], out, work.to[i])


@kernel
def run_windows(work, order, first, stride, dt, knot_steps, settings, buffer, out, fx, rigid, laws):
    """Blocks `first`, `first` + `stride`, … of the items in `order`, those with most knots first; samples into `out`.

    Parameters
    ----------
    work : WindowItems
    knot_steps : int
        Steps of `dt` (s) from a knot to the next, for all items in `order`.
    settings : array of int, shape (2,)
        4, the stages of a step; at how many of them torques are computed, see `lanes.stage`.
    fx : tuple or None
        One of EXTENDED for the extended model (`lane_layout`).
    rigid : bool or None
        Given, all items are of rigid robots (see `lanes`).
    laws : array of LAW_DTYPE, shape (r,), or None
        With `fx`: laws of all robots, as `effects` has the rest, where all items are of robots that have some.
        What rovers do at an instant is noted there: no other thread may have the same.
    """
    line_up_stack()
    S, rows = buffer
    for block in range(first, (order.shape[0] + LANES - 1) // LANES, stride):
        load_block(S, work, order, block, fx, rigid)
        simulate(S, rows, work, order, block, fx, dt, knot_steps, settings, rigid, laws)
        sample_plans(S, rows, work, order, block, knot_steps * dt, out)
