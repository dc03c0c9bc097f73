"""Forces that a fit does not know of, wherever they come from: normal equations for them in short windows.

Over seconds a rover's motion may take another branch of eq. 16 for every small push, and no linear answer holds. So the
recordings are cut into windows of a few tenths of a second. In each, forces that grow linearly with time are fitted,
simulated by the model: together with the torques these are all that a planar rover's motion can show. Around this
common point, where what was measured is reproduced, everything that a force may follow is compared linearly.

Around a fit whole windows answer linearly, too: to forces that are small (`whole_answers`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.candidates.screening import Around
from artibot_sim.diagnose.sizes import scale_of
from artibot_sim.estimation.kernels import Parts
from artibot_sim.estimation.loss import Loss, spread
from artibot_sim.estimation.parallel import side_by_side
from artibot_sim.estimation.problem import Problem, Sensitivity, clip, start_steps
from artibot_sim.estimation.solver import eliminated
from artibot_sim.estimation.windows import CHANNEL_NAMES, Window, window_at
from artibot_sim.model import Robot
from artibot_sim.model.effects.residual_force import forces_of
from artibot_sim.model.robot.robot import unchecked
from artibot_sim.model.simulate.window_inputs import kind_of

Array = NDArray[np.float64]

LENGTH = 0.3
"""s that a window is compared."""
LEAD = 0.1
"""s before, in which its start is forgotten."""
WINDOWS = 150
"""Windows, at most."""
KNOTS = 2
"""Where forces of a window are given: at its beginning and its end."""
_WIDE_FORCE, _WIDE_MOMENT, _WIDE_TORQUE = 80.0, 40.0, 0.15
"""Standard deviations of forces, moments and motors' torques beforehand for Agri.q, N and N m; other robots' are as
their `sizes.Scale`."""
_PROBE_FORCE, _PROBE_MOMENT = 6.0, 3.0
"""Changes of forces and moments for their finite differences, for Agri.q."""
_PARAMETER_STEP = 0.04
_ROUNDS = 3
_TALLEST = 3.0
"""Largest column that counts, over what nine of ten have."""


def components_of(robot: Robot) -> tuple[str, ...]:
    """What a force on a robot is made of: `residual_force.forces_of`, then its motors, whose torques they are."""
    return (*forces_of(len(robot.modules)), *robot.motors)


def moved_by(robot: Robot) -> int:
    """How many of the components move the robot; the motors' torques stand behind them."""
    return len(forces_of(len(robot.modules)))


@dataclass(frozen=True)
class Answers:
    """What forces, parameters and starts do to the residuals of every window, starts eliminated.

    Attributes
    ----------
    matrix : array, shape (windows, f + p, f + p)
        Information about the f forces (component by component, its values at all instants) and the parameters.
    rhs : array, shape (windows, f + p)
        Right-hand side: matrix · x = rhs where a window is explained best; forces are counted from zero, parameters
        from the fit.
    misfit : array, shape (windows,)
        Weighted sum of squares without any force: misfit − 2 rhs · x + x · matrix · x with x.
    forces : int
        How many unknowns are forces.
    """

    matrix: Array
    rhs: Array
    misfit: Array
    forces: int


def short(problem: Problem, most: int = WINDOWS) -> Problem:
    """A problem's recordings in short windows, `most` at most, taken evenly."""
    places: list[tuple[int, int, int, int]] = []
    for i, stretch in enumerate(problem.stretches):
        dt = stretch.inputs.dt
        size, lead = round(LENGTH / dt), round(LEAD / dt)
        places += [(i, a, size, lead) for a in range(lead, len(stretch.inputs.t) - 1 - size, size)]
    windows = [
        window_at(problem.stretches[i], i, problem.parameters.robot, a - lead, size + lead, lead)
        for i, a, size, lead in places[:: -(-len(places) // most)]
    ]
    return replace(problem, windows=[w for w in windows if len(w) >= 2 * problem.size])


def ends(problem: Problem) -> Array:
    """Where forces are given: when the compared part of each window begins and ends, shape (windows, KNOTS), s."""
    end = np.array([w.t for w in problem.windows]) + problem.durations
    return np.column_stack([end - LENGTH, end])


def force_scale(robot: Robot) -> Array:
    """Sizes of the forces that move a robot over Agri.q's, shape (c,)."""
    return np.where(_moments(robot), scale_of(robot).torque, scale_of(robot).mass)


def _moments(robot: Robot) -> NDArray[np.bool_]:
    """Which of the forces that move a robot are moments, shape (c,)."""
    return np.array([name.endswith("turn") for name in forces_of(len(robot.modules))])


def _probe(robot: Robot) -> Array:
    """Changes of forces for their finite differences, shape (c,)."""
    return np.asarray(np.where(_moments(robot), _PROBE_MOMENT, _PROBE_FORCE) * force_scale(robot))


@dataclass
class _State:
    """Where the windows' fits stand: starts (windows, s), forces (windows, c, KNOTS), torques (windows, m · KNOTS)."""

    starts: Array
    forces: Array
    torques: Array


def answers(problem: Problem, coordinates: Array) -> Answers:
    """Fit starts and forces of every short window, and the normal equations there."""
    count, robot = len(problem), problem.parameters.robot
    state = _State(
        problem.starts.copy(), np.zeros((count, moved_by(robot), KNOTS)), np.zeros((count, len(robot.motors) * KNOTS))
    )  # fmt: skip
    for _ in range(_ROUNDS):
        linear = _linearised(problem, coordinates, state, ())
        state = _moved(problem, state, linear)
    return _eliminated(problem, state, _linearised(problem, coordinates, state, range(len(coordinates))))


def instants(problem: Problem) -> Array:
    """Where forces in whole windows are given, evenly and at most `LENGTH` apart, shape (windows, k), s."""
    share = np.linspace(0.0, 1.0, int(np.ceil(problem.durations.max() / LENGTH)) + 1)
    return np.array([w.t for w in problem.windows])[:, None] + problem.durations[:, None] * share


def whole_answers(base: Around, at: Array) -> Answers:
    """Normal equations of whole windows for forces given at the instants `at` (windows, k), linear between them.

    Forces and parameters are counted from the fit around which sensitivities are known; parameters are its free ones.
    """
    problem = base.problem
    weight = base.loss.weights(problem.samples, base.point.residuals.flat)
    each = side_by_side(partial(_whole_window, base, at, weight), range(len(problem)), problem.workers)
    matrices, sides, misfits = (np.array(part) for part in zip(*each, strict=True))
    return Answers(matrices, sides, misfits, at.shape[1] * len(components_of(problem.parameters.robot)))


def _whole_window(base: Around, at: Array, weight: Array, w: int) -> tuple[Array, Array, float]:
    """Of one window what `Answers` has of each, from pulses of every force at every instant, to either side."""
    part, point, t = base.problem.part([w]), base.point, at[w]
    robot = part.parameters.robot_at(point.coordinates)
    mine = slice(base.problem.samples.begin[w], base.problem.samples.begin[w + 1])
    pulses = [
        pulse(robot, c, side, instant, t[1] - t[0]) for side in (1, -1) for c in range(moved_by(robot)) for instant in t
    ]
    starts, residuals = point.starts[w : w + 1], point.residuals.flat[mine]
    every = np.repeat(starts[None], len(pulses), axis=0)
    flat = part.compare(part.predictions(pulses, np.arange(len(pulses))[:, None], every))
    more, less = (flat - residuals).reshape(2, -1, len(residuals)) / np.repeat(_probe(robot), len(t))[:, None]
    forces = limited(more, -less)
    clip(part.samples, forces)
    rows = forces, _torques(robot, part.windows[0], t).T, base.sensitivity.parameters[:, mine]
    sensitivity = Sensitivity(np.concatenate(rows), base.sensitivity.starts[:, mine])
    reduced, squares = eliminated(part, weight[mine], part.parts(residuals), sensitivity, starts)
    return reduced.matrices[0], -reduced.gradient[0], float(squares[0])


def limited(one: Array, other: Array) -> Array:
    """The smaller of differences to either side, 0 where their signs differ (the minmod limiter).

    Where a wheel breaks away (eq. 16) for a pulse to one side and not for that to the other, neither says how forces
    add up: laws are sums of many pulses, and would be sums of such jumps.
    """
    return np.where(one * other > 0.0, np.where(np.abs(one) < np.abs(other), one, other), 0.0)


def pulse(robot: Robot, component: int, side: int, t: float, width: float) -> Robot:
    """A robot with a force that is as large at `t` as differences take it, and falls to nothing within `width`, s.

    `side` is its sign.
    """
    force = {forces_of(len(robot.modules))[component]: side * float(_probe(robot)[component])}
    return unchecked(robot, dict(robot.effects) | {"residual_force": force | {"since": float(t), "fall": 1.0 / width}})


@dataclass(frozen=True)
class _Linear:
    """Residuals of the windows, and their columns by forces (n, c · KNOTS), starts and parameters."""

    residuals: list[Array]
    forces: list[Array]
    starts: list[Array]
    parameters: list[Array]


def pushed(robot: Robot, forces: Array, t: Array) -> Robot:
    """A robot with `forces` (c, KNOTS) at the times `t` (KNOTS,), linear between."""
    rate, names = (forces[:, 1] - forces[:, 0]) / (t[1] - t[0]), forces_of(len(robot.modules))
    values = dict(zip(names, forces[:, 0].tolist(), strict=True))
    values |= {f"{name}_rate": r for name, r in zip(names, rate.tolist(), strict=True)}
    return unchecked(robot, dict(robot.effects) | {"residual_force": values | {"since": float(t[0])}})


def _linearised(problem: Problem, coordinates: Array, state: _State, free: Sequence[int]) -> _Linear:
    """Residuals and columns by finite differences; those of the parameters numbered `free`."""
    plain, others = problem.parameters.robot_at(coordinates), []
    for i in free:
        moved = coordinates.copy()
        moved[i] -= _PARAMETER_STEP
        others.append(problem.parameters.robot_at(moved))
    t, size, count = ends(problem), problem.size, len(problem)
    variants = [_variants(plain, others, state.forces[w], t[w]) for w in range(count)]
    each = len(variants[0])
    robots = [robot for mine in variants for robot in mine]
    robot = each * np.arange(count) + np.concatenate([np.arange(each), np.zeros(size, int)])[:, None]
    starts = np.repeat(state.starts[None], each + size, axis=0)
    starts[each:] += start_steps(size)[:, None, None] * np.eye(size)[:, None]
    flat = problem.compare(problem.predictions(robots, robot, starts))
    steps = np.concatenate(
        [
            np.repeat(_probe(plain), KNOTS),
            np.full(len(others), -_PARAMETER_STEP),
            start_steps(size),
        ]
    )
    table, n = (flat[1:] - flat[0]) / steps[:, None], moved_by(plain) * KNOTS
    forces, parameters, moves = (
        [part.T for part in np.split(table[a:b], problem.samples.begin[1:-1], axis=1)]
        for a, b in ((0, n), (n, n + len(others)), (n + len(others), None))
    )
    found = _Linear(list(problem.parts(flat[0])), forces, moves, parameters)
    for part in (found.forces, found.parameters, found.starts):
        _clip(problem.windows, part)
    return found


def _variants(plain: Robot, others: Sequence[Robot], forces: Array, t: Array) -> list[Robot]:
    """A robot with its forces, with each of them changed at each knot, and other robots with the same forces."""
    changed, probe = [], _probe(plain)
    for c in range(len(probe)):
        for k in range(KNOTS):
            more = forces.copy()
            more[c, k] += probe[c]
            changed.append(pushed(plain, more, t))
    return [pushed(plain, forces, t), *changed, *(pushed(other, forces, t) for other in others)]


def _clip(windows: Sequence[Window], columns: list[Array]) -> None:
    """Limit columns in place, channel by channel, to a few times what nine of ten have.

    A finite difference across a switch of eq. 16 is as large as its step is small, and none of it is true.
    """
    channel, table = np.concatenate([w.channel for w in windows]), np.abs(np.concatenate(columns))
    for c in np.unique(channel):
        limit = _TALLEST * np.quantile(table[channel == c], 0.9, axis=0)
        for window, part in zip(windows, columns, strict=True):
            mine = window.channel == c
            part[mine] = np.clip(part[mine], -limit, limit)


def _weights(problem: Problem, residuals: Sequence[Array]) -> Parts:
    """How much each sample counts, by the loss that these residuals ask for."""
    loss = Loss(spread(problem.windows, residuals), np.ones(len(CHANNEL_NAMES)))
    return problem.parts(loss.weights(problem.samples, np.concatenate(residuals)))


def _explained(problem: Problem, state: _State, linear: _Linear) -> list[Array]:
    """Residuals once the motors' torques are taken off: what samples are trusted by."""
    t = ends(problem)
    return [
        residual + _torques(problem.parameters.robot, window, t[w]) @ state.torques[w]
        for w, (window, residual) in enumerate(zip(problem.windows, linear.residuals, strict=True))
    ]


def _moved(problem: Problem, state: _State, linear: _Linear) -> _State:
    """A damped step of every window's start and forces; torques, in which residuals are linear, as they are best."""
    trusted = _explained(problem, state, linear)
    weights, t = _weights(problem, trusted), ends(problem)
    new = _State(state.starts.copy(), state.forces.copy(), state.torques.copy())
    robot = problem.parameters.robot
    widths = np.where(_moments(robot), _WIDE_MOMENT, _WIDE_FORCE) * force_scale(robot)
    wide, torque = np.repeat(widths, KNOTS), _WIDE_TORQUE * scale_of(robot).motor
    n, m = len(wide), len(wide) + len(robot.motors) * KNOTS
    for w, (residual, G, S) in enumerate(zip(linear.residuals, linear.forces, linear.starts, strict=True)):
        weight = weights[w]
        J = np.hstack([G, _torques(robot, problem.windows[w], t[w]), S])
        known = np.zeros((J.shape[1], J.shape[1]))
        known[:m, :m] = np.diag(np.concatenate([wide, np.full(m - n, torque)]) ** -2.0)
        known[m:, m:] = problem.start_weight[w].T @ problem.start_weight[w]
        away = np.concatenate([state.forces[w].ravel(), np.zeros(m - n), state.starts[w] - problem.starts[w]])
        H = (J.T * weight) @ J + known
        move = -np.linalg.solve(H + 1e-3 * np.diag(np.diag(H)), J.T @ (weight * residual) + known @ away)
        new.forces[w] += np.clip(move[:n], -wide, wide).reshape(-1, KNOTS)
        new.torques[w] = move[n:m]
        limit = 2.0 * problem.start_sd[w]
        new.starts[w] += np.clip(move[m:], -limit, limit)
    return new


def _eliminated(problem: Problem, state: _State, linear: _Linear) -> Answers:
    trusted = _explained(problem, state, linear)
    weights = _weights(problem, trusted)
    matrices, sides, misfits = [], [], []
    t, robot = ends(problem), problem.parameters.robot
    for w, window in enumerate(problem.windows):
        weight = weights[w]
        G = np.hstack([linear.forces[w], _torques(robot, window, t[w])])
        X, S, r = np.hstack([G, linear.parameters[w]]), linear.starts[w], linear.residuals[w]
        known = problem.start_weight[w].T @ problem.start_weight[w]
        away = state.starts[w] - problem.starts[w]
        A, B = (S.T * weight) @ S + known, (S.T * weight) @ X
        g = S.T @ (weight * r) + known @ away
        solved = np.linalg.solve(A, np.column_stack([B, g]))
        matrix = (X.T * weight) @ X - B.T @ solved[:, :-1]
        rhs = -(X.T @ (weight * r) - B.T @ solved[:, -1])
        n, f = state.forces[w].size, state.forces[w].ravel()
        misfit = float(weight @ r**2 + away @ known @ away - g @ solved[:, -1])
        misfits.append(misfit + 2.0 * rhs[:n] @ f + f @ matrix[:n, :n] @ f)
        rhs += matrix[:, :n] @ f
        matrices.append(matrix)
        sides.append(rhs)
    return Answers(np.array(matrices), np.array(sides), np.array(misfits), KNOTS * len(components_of(robot)))


def _torques(robot: Robot, window: Window, t: Array) -> Array:
    """Columns (n, m · k) of torques in the motors at times (k,), which nothing but their own sensors notice."""
    columns = np.zeros((len(window), len(robot.motors), len(t)))
    at = window.t + window.plan.t
    for m, motor in enumerate(robot.motors):
        mine = window.plan.kind == kind_of(f"torque_{motor}")
        hats = np.column_stack([np.interp(at[mine], t, one) for one in np.eye(len(t))])
        columns[mine, m] = hats / window.sigma[mine, None]
    return columns.reshape(len(window), -1)
