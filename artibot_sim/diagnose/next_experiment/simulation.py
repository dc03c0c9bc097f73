"""What a rover would measure on a manoeuvre, and how well another one would explain it, by simulation alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import pi
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from artibot_sim.estimation.measurements import sampled
from artibot_sim.estimation.problem import start_steps
from artibot_sim.estimation.windows import for_starts, postures, states
from artibot_sim.experiment import Channel, Experiment
from artibot_sim.experiment.inputs import recorded_motors
from artibot_sim.model import MOTORS, Mode, Robot, Rollout, Status, initial_state, rollout
from artibot_sim.model.effects import EFFECTS
from artibot_sim.model.effects.base import Choice
from artibot_sim.model.simulate.commands import as_executed
from artibot_sim.model.simulate.rollout import integration
from artibot_sim.model.simulate.sensors import measured_starts, sensor_errors
from artibot_sim.model.simulate.window_inputs import KINDS, Items, MotorTable, SamplingPlan, kind_of
from artibot_sim.model.simulate.windows import WindowBatch, window_step
from artibot_sim.planning import Arc, Dwell, Eight, Manoeuvre, Plan, Ramp, Repeat, Segment, Slalom, Stop, Straight, plan

# ----------------------------------------------------------------------
# Manoeuvres that a next experiment is chosen from: each brings out something else.
# ----------------------------------------------------------------------


KAPPA = 0.65
"""Front share of all of them: back motors whose torque is commanded show what torque sensors make of it."""
_BLEND = 0.3
"""m over which curvature changes."""


@dataclass(frozen=True)
class LibraryManoeuvre:
    """A manoeuvre of the library.

    Attributes
    ----------
    name : str
    what : str
        What to do, for a person, to follow "drive".
    manoeuvre : Manoeuvre
    yaw : float
        Heading at the start in `map`, rad.
    """

    name: str
    what: str
    manoeuvre: Manoeuvre
    yaw: float = 0.0


def _entry(name: str, what: str, *segments: Segment, a_max: float = 0.5, yaw: float = 0.0) -> LibraryManoeuvre:
    return LibraryManoeuvre(name, what, Manoeuvre(name, (Dwell(0.5), *segments), a_max=a_max, blend=_BLEND), yaw)


_FORTH_AND_BACK = (
    Straight(length=2.5, speed=0.6, end_speed=0.0), Dwell(0.5), Straight(length=2.5, speed=-0.6, end_speed=0.0),
)  # fmt: skip
_BENDS = (Ramp(speed=0.5), Arc(radius=1.8, angle=1.6), Arc(radius=1.8, angle=-1.6), Stop())

LIBRARY: tuple[LibraryManoeuvre, ...] = (
    _entry("forth_and_back", "2.5 m straight ahead and 2.5 m back", *_FORTH_AND_BACK),
    _entry(
        "forth_and_back_turned", "2.5 m straight ahead and 2.5 m back, headed 90° to the left of the last recordings",
        *_FORTH_AND_BACK, yaw=pi / 2,
    ),
    _entry(
        "jerks", "four short straights with hard starts and stops",
        Repeat(4, (Straight(length=0.8, speed=0.8, end_speed=0.0), Dwell(0.5))), a_max=2.0,
    ),
    _entry(
        "creep", "slowly, up to 0.25 m/s and down again, in a bend to the left, in one to the right, and straight",
        Ramp(speed=0.25, curvature=0.4, a_max=0.08), Stop(curvature=0.4, a_max=0.08), Dwell(0.5),
        Ramp(speed=0.25, curvature=-0.4, a_max=0.08), Stop(curvature=-0.4, a_max=0.08), Dwell(0.5),
        Ramp(speed=0.25, a_max=0.08), Stop(a_max=0.08),
    ),
    _entry("bends", "a bend to the left and one to the right, both of 1.8 m radius", *_BENDS),
    _entry(
        "bends_turned", "a bend to the left and one to the right, headed 90° to the left of the last recordings",
        *_BENDS, yaw=pi / 2,
    ),
    _entry(
        "stop_and_go", "stop and go: straight, in a left turn and in a right turn",
        Straight(length=1.5, speed=0.8, end_speed=0.0), Dwell(0.5),
        Arc(radius=2.5, angle=0.8, speed=0.8, end_speed=0.0), Dwell(0.5),
        Arc(radius=2.5, angle=-0.8, speed=0.8, end_speed=0.0), a_max=0.8,
    ),
    _entry(
        "slow_and_fast", "4 m at 0.25 m/s and 6 m at 0.9 m/s, in a wide bend",
        Ramp(speed=0.25, curvature=0.15), Arc(radius=1 / 0.15, angle=0.6), Ramp(speed=0.9, curvature=0.15),
        Arc(radius=1 / 0.15, angle=0.9), Stop(curvature=0.15),
    ),
    _entry(
        "slalom", "a slalom of three waves",
        Ramp(speed=0.6), Slalom(curvature=0.25, wavelength=5.0, periods=0.5),
        Slalom(curvature=-0.5, wavelength=5.0, periods=3.0), Stop(),
    ),
    _entry(
        "square", "a square with sides of 2 m, corners rounded, to the left",
        Ramp(speed=0.5), Repeat(4, (Straight(length=1.2), Arc(radius=1.3, angle=pi / 2))), Stop(),
    ),
    _entry("eight", "a figure of eight of 2 m radius", Eight(radius=2.0, smooth=True, speed=0.6, end_speed=0.0)),
    _entry(
        "circles", "a whole circle to the left and one to the right, both of 1.8 m radius",
        Ramp(speed=0.6), Arc(radius=1.8, angle=2 * pi), Arc(radius=1.8, angle=-2 * pi), Stop(),
    ),
    _entry(
        "eights", "two figures of eight of 2 m radius without a pause",
        Repeat(2, (Eight(radius=2.0, smooth=True, speed=0.6),)), Stop(),
    ),
)  # fmt: skip
"""All of them."""


# ----------------------------------------------------------------------
# What a rover would measure on a manoeuvre, and how well another one would explain it, by simulation alone.
# ----------------------------------------------------------------------


Array = NDArray[np.float64]
Indices = NDArray[np.int64]

WINDOW = 5.0
"""s of a window: each has a start of its own, as in a diagnosis."""
LEAD = 0.3
"""s at the beginning of a window that are not compared."""
RATES = {"position": 10.0, "yaw": 10.0, "yaw_rate": 20.0, "articulation_yaw": 20.0, "torque_front": 20.0,
         "torque_back": 20.0}  # fmt: skip
"""Samples a second that count, Hz: faster ones err alike."""
_STEP = 1e-3
"""Integration step, s."""
_KNOT = 0.01
"""s between knots of the commands."""


@dataclass(frozen=True)
class TriedManoeuvre:
    """A manoeuvre as a robot drives it, without noise.

    Attributes
    ----------
    robot : Robot
    planned : Plan
    result : Rollout
        Rows every 10 ms.
    channels : tuple of str
        Measured ones.
    """

    robot: Robot
    planned: Plan
    result: Rollout
    channels: tuple[str, ...]

    @cached_property
    def table(self) -> MotorTable:
        """How the motors turned, as recorded."""
        position, velocity, _ = recorded_motors(self.result, self.robot)
        motors = len(self.robot.motors)
        turned = np.arange(motors) < (motors if self.robot.articulated else 2)
        modes = tuple(Mode.PRESCRIBED if own else Mode.TORQUE for own in turned)
        return MotorTable(
            _KNOT, np.where(turned, position, 0.0), np.where(turned, velocity, 0.0), np.full(position.shape, np.nan),
            modes, KAPPA,
        )  # fmt: skip

    @cached_property
    def edges(self) -> NDArray[np.int64]:
        """Knots at which windows begin, and the last one."""
        knots = len(self.result.t) - 1
        return np.linspace(0, knots, max(1, round(knots * _KNOT / WINDOW)) + 1).round().astype(np.int64)

    @cached_property
    def plans(self) -> list[SamplingPlan]:
        """When and what is measured in each window."""
        found = []
        for k, (a, b) in enumerate(zip(self.edges[:-1], self.edges[1:], strict=True)):
            length, times, kinds = (b - a) * _KNOT, [], []
            for channel in self.channels:
                t = np.arange(LEAD if k else 0.05, length - 1e-6, 1.0 / RATES[channel])
                for name in sampled(self.robot)[channel]:
                    times.append(t)
                    kinds.append(np.full(len(t), kind_of(name)))
            found.append(SamplingPlan(np.concatenate(times), np.concatenate(kinds).astype(np.int64)))
        return found

    def sigma(self, noise: Mapping[str, float]) -> list[Array]:
        """Noise of each sample, window by window."""
        level = {kind_of(name): noise[c] for c in self.channels for name in sampled(self.robot)[c]}
        return [np.array([level[int(kind)] for kind in plan.kind]) for plan in self.plans]

    @cached_property
    def starts(self) -> Array:
        """What sensors make of the windows' starts, shape (windows, 8 or 6): see `estimation.windows`."""
        rows = self.edges[:-1]
        pose, twist = self.result.pose[rows], self.result.twist[rows]
        columns = [pose, twist]
        if self.robot.articulated:
            yaws = self.result.v[rows, 5::8]
            bends = self.result.articulations[rows, :, 0], np.diff(yaws, axis=1)
            columns.append(np.stack(bends, axis=2).reshape(len(rows), -1))
        errors = np.array([sensor_errors(self.robot)])
        return measured_starts(errors, np.hstack(columns), np.zeros(len(rows), bool))

    @cached_property
    def batch(self) -> WindowBatch:
        """Runs the windows."""
        return WindowBatch([self.table], self.plans, window_step(self.robot, [self.table]))

    def predicted(self, robots: Sequence[Robot], robot: Indices, window: Indices, starts: Array) -> list[Array]:
        """What robots' sensors see in windows that begin as `starts` say; rows of (which robot, window, start)."""
        rows, late = self.edges[window], np.zeros(len(window), bool)
        scale = sensor_errors(self.robot).encoder_scale
        q, v = scale * self.result.q[rows], scale * self.result.v[rows]
        q, v = states(postures(robots), robot, q, v, starts, late)
        knots = np.diff(self.edges)[window]
        zero = np.zeros(len(window), np.int64)
        return self.batch.run(robots, Items(robot, zero, window, rows, knots, q, v, self.result.t[rows]))

    @cached_property
    def measured(self) -> list[Array]:
        """What is measured, window by window."""
        count = len(self.plans)
        return self.predicted([self.robot], np.zeros(count, np.int64), np.arange(count, dtype=np.int64), self.starts)

    @cached_property
    def recording(self) -> Experiment:
        """Commands and motors as they are recorded, for the command view."""
        position, velocity, torque = recorded_motors(self.result, self.robot)
        t, motors = self.result.t, self.robot.motors if self.robot.articulated else MOTORS[:2]
        columns: dict[str, Array] = {}
        for i, motor in enumerate(motors):
            columns |= {f"{motor}.position": position[:, i], f"{motor}.velocity": velocity[:, i]}
            columns[f"{motor}.effort"] = torque[:, i]
        stated = {f"{motor}.velocity": self.planned.at(t).velocity[:, i] for i, motor in enumerate(MOTORS[:2])}
        stated |= {f"{motor}.effort": self.result.motor_torque[:, i] for i, motor in enumerate(motors) if i >= 2}
        stamps = np.round(t * 1e9).astype(np.int64)
        channels = {
            "motor_torques": Channel("/motor_torques", stamps, t, stamps, columns),
            "motor_command": Channel("/motor_command", stamps, t, stamps, stated),
        }
        return Experiment("trial", Path("trial"), {}, 0, channels, ((0.0, float(t[-1])),))


def trial(
    robot: Robot, entry: LibraryManoeuvre, place: tuple[float, float], channels: Sequence[str]
) -> TriedManoeuvre | None:
    """A manoeuvre driven by a robot from a place in `map` (m); None where it cannot be simulated."""
    planned = plan(entry.manoeuvre, robot, start=(*place, entry.yaw))
    integrator, step = integration(robot, _STEP, kappa=KAPPA)
    result = rollout(
        robot, as_executed(robot, planned.commands()), dt=step, every=round(_KNOT / step), kappa=KAPPA,
        integrator=integrator, state=initial_state(robot, *planned.start),
    )  # fmt: skip
    if result.status is not Status.OK:
        return None
    known = [c for c in channels if c in RATES and c in sampled(robot)]
    return TriedManoeuvre(robot, planned, result, tuple(known))


def with_effect(robot: Robot, effect: str, values: Mapping[str, float | str]) -> Robot:
    """The robot with other parameters of one of its effects."""
    return replace(robot, effects=dict(robot.effects) | {effect: dict(robot.effects[effect]) | dict(values)})


# ----------------------------------------------------------------------
# What another robot may change to explain a trial, and what is left then.
# ----------------------------------------------------------------------


SOIL = ("contact.k_l", "contact.k_t", "contact.mu_s", "contact.mu_d", "contact.u_w")
SOIL_SD = 0.05
"""By how much (as logarithms) the soil may differ from the one that earlier recordings gave."""
SIZE_SD = 0.2
"""By how much, as a share, an effect's size may differ from what earlier recordings gave."""
_PLACES = {"rad": 0.3, "m": 0.3}
"""By how much an effect's places and directions may differ from what earlier recordings gave, by unit."""
_STARTS = np.array([0.03, 0.03, 0.1, 0.03, 0.03, 0.015, 0.01, 0.05])
"""Standard deviations of a window's start, in the order of `estimation.windows.START`."""
_ROUNDS = 8
"""Gauss-Newton steps of a rival, at most."""
_FALL = (0.5, 0.05)
"""Fall of the loss in a round, nats and over what is left, under which it has ended."""
_FREEDOM = 5.0
"""Degrees of freedom of Student's distribution, in which residuals are judged."""
_LOST = 50.0
"""Residual, in units of noise, of a sample that the simulation never reached."""


@dataclass(frozen=True)
class NuisanceParameter:
    """A parameter that may change: coordinates are in standard deviations."""

    key: str
    sd: float
    effect: str = ""

    def shifted(self, robot: Robot, by: float) -> Robot:
        """The robot with this parameter changed by so many standard deviations, within its bounds."""
        if not by:
            return robot
        if not self.effect:
            value = float(robot.as_vector([self.key])[0]) * float(np.exp(by * self.sd))
            other = {"contact.mu_s": "contact.mu_d", "contact.mu_d": "contact.mu_s"}.get(self.key)
            changes = {self.key: value}
            if other is not None:  # mu_d is never above mu_s
                bound = float(robot.as_vector([other])[0])
                changes[self.key] = max(value, bound) if other == "contact.mu_d" else min(value, bound)
            return robot.replace(changes)
        quantity = EFFECTS[self.effect].parameters[self.key].quantity
        assert not isinstance(quantity, Choice)
        value = float(robot.effects[self.effect][self.key]) + by * self.sd
        span = 1e-9 * max(1.0, abs(value))
        return with_effect(robot, self.effect, {self.key: float(np.clip(value, quantity.low + span, quantity.high))})


def nuisance_parameters(robot: Robot) -> list[NuisanceParameter]:
    """What may change of a robot: its soil, and its effects' numbers."""
    found = [NuisanceParameter(key, SOIL_SD) for key in SOIL]
    for name, values in robot.effects.items():
        effect = EFFECTS[name]
        for k, (key, parameter) in enumerate(effect.parameters.items()):
            if isinstance(parameter.quantity, Choice) or not np.isfinite(float(values[key])):
                continue
            if k < effect.sizes:
                neutral = float(parameter.neutral) if np.isfinite(float(parameter.neutral)) else 0.0
                sd = SIZE_SD * abs(float(values[key]) - neutral)
            else:
                sd = _PLACES.get(parameter.quantity.unit, 0.0)
            if sd > 0.0:
                found.append(NuisanceParameter(key, sd, name))
    return found


@dataclass(frozen=True)
class TrialExplanation:
    """A robot that is to explain a trial of another one.

    Attributes
    ----------
    trial : TriedManoeuvre
    robot : Robot
    noise : mapping of str to float
        Standard deviation of a sample, by channel (SI).
    """

    trial: TriedManoeuvre
    robot: Robot
    noise: Mapping[str, float]

    @cached_property
    def _nuisance(self) -> list[NuisanceParameter]:
        return nuisance_parameters(self.robot)

    @cached_property
    def _sigma(self) -> list[Array]:
        return self.trial.sigma(self.noise)

    def nats(self) -> float:
        """Log-likelihood that it loses against the robot that drove, everything that may change at its best."""
        count = len(self.trial.plans)
        size = self.trial.starts.shape[1]
        shifts, moves = np.zeros(len(self._nuisance)), np.zeros((count, size))
        least = self._cost(shifts, moves, self._residuals([shifts], moves[None])[0])
        for _ in range(_ROUNDS):
            step, move = self._step(shifts, moves)
            shares = (1.0, 0.5, 0.2)
            tried = [(shifts + share * step, moves + share * move) for share in shares]
            found = self._residuals([t for t, _ in tried], np.array([m for _, m in tried]))
            costs = [self._cost(t, m, r) for (t, m), r in zip(tried, found, strict=True)]
            best = int(np.argmin(costs))
            if costs[best] >= least:
                break
            fallen = least - costs[best]
            least, (shifts, moves) = costs[best], tried[best]
            if fallen < max(_FALL[0], _FALL[1] * least):
                break
        return least

    def _robot_at(self, shifts: Array) -> Robot:
        robot = self.robot
        for parameter, by in zip(self._nuisance, shifts.tolist(), strict=True):
            robot = parameter.shifted(robot, by)
        return robot

    def _residuals(self, shifts: Sequence[Array], moves: Array) -> list[list[Array]]:
        """Residuals, window by window, for several sets of changes; `moves` is (sets, windows, size of a start)."""
        count = len(self.trial.plans)
        robots = [self._robot_at(t) for t in shifts]
        size = moves.shape[-1]
        starts = (self.trial.starts + moves * for_starts(_STARTS, size)).reshape(-1, size)
        each = np.arange(count, dtype=np.int64)
        robot, window = np.repeat(np.arange(len(robots), dtype=np.int64), count), np.tile(each, len(robots))
        flat = self.trial.predicted(robots, robot, window, starts)
        return [[self._residual(i, flat[k * count + i]) for i in range(count)] for k in range(len(robots))]

    def _residual(self, number: int, predicted: Array) -> Array:
        difference = predicted - self.trial.measured[number]
        turned = self.trial.plans[number].kind == KINDS.index("yaw")
        difference[turned] = np.arctan2(np.sin(difference[turned]), np.cos(difference[turned]))
        residual: Array = difference / self._sigma[number]
        return np.where(np.isfinite(residual), np.clip(residual, -1e4, 1e4), _LOST)

    def _cost(self, shifts: Array, moves: Array, residuals: Sequence[Array]) -> float:
        lost = sum(float(np.log1p(r**2 / _FREEDOM).sum()) for r in residuals)
        return 0.5 * ((_FREEDOM + 1.0) * lost + float(shifts @ shifts) + float((moves**2).sum()))

    def _step(self, shifts: Array, moves: Array) -> tuple[Array, Array]:
        """Gauss–Newton with the weights of heavy tails; starts are eliminated window by window."""
        count, size = moves.shape
        eye = 0.05 * np.eye(len(shifts))
        sets = [shifts, *(shifts + row for row in eye), *(shifts for _ in range(size))]
        starts = np.repeat(moves[None], len(sets), axis=0)
        steps = start_steps(size) / for_starts(_STARTS, size)
        for k in range(size):
            starts[1 + len(shifts) + k, :, k] += steps[k]
        found = self._residuals(sets, starts)
        A, g = np.eye(len(shifts)), shifts.copy()
        solved = []
        for i in range(count):
            r = found[0][i]
            J = _clipped(np.column_stack([(found[1 + k][i] - r) / 0.05 for k in range(len(shifts))]))
            S = _clipped(np.column_stack([(found[1 + len(shifts) + k][i] - r) / steps[k] for k in range(size)]))
            w = (_FREEDOM + 1.0) / (_FREEDOM + r**2)
            known = (S.T * w) @ S + np.eye(size)
            own = np.linalg.solve(known, np.column_stack([(S.T * w) @ J, (S.T * w) @ r + moves[i]]))
            solved.append(own)
            A += (J.T * w) @ J - (J.T * w) @ S @ own[:, :-1]
            g += (J.T * w) @ r - (J.T * w) @ S @ own[:, -1]
        step = np.clip(-np.linalg.solve(A, g), -3.0, 3.0)
        move = np.array([-(own[:, -1] + own[:, :-1] @ step) for own in solved])
        return step, np.clip(move, -3.0, 3.0)


def _clipped(columns: Array) -> Array:
    """Sensitivities without what switches of eq. 16 make of finite differences."""
    limit = 3.0 * np.quantile(np.abs(columns), 0.99, axis=0)
    return np.clip(columns, -limit, limit)
