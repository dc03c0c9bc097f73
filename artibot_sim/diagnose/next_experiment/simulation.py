"""What a rover would measure on a manoeuvre, and how well another one would explain it, by simulation alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.next_experiment.manoeuvres import KAPPA, Entry
from artibot_sim.experiment import Channel, Experiment
from artibot_sim.experiment.recorded_as import recorded_motors
from artibot_sim.identify.sensing import CHANNELS
from artibot_sim.identify.starts import postures, states
from artibot_sim.model import MOTORS, Mode, Robot, Rollout, Status, initial_state, rollout
from artibot_sim.model.command_way import as_executed
from artibot_sim.model.params import params
from artibot_sim.model.rollout_checks import default_modes
from artibot_sim.model.sensors import measured_starts, sensor_errors
from artibot_sim.model.stability import largest_step
from artibot_sim.model.windows import KINDS, Items, MotorTable, Plan, WindowBatch, window_step
from artibot_sim.planning import Plan as Planned
from artibot_sim.planning import plan

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
_KNOT = 0.01


@dataclass(frozen=True)
class Trial:
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
    planned: Planned
    result: Rollout
    channels: tuple[str, ...]

    @cached_property
    def table(self) -> MotorTable:
        """How the motors turned, as recorded."""
        position, velocity, _ = recorded_motors(self.result, self.robot)
        count = 4 if self.robot.articulated else 2
        modes = tuple(Mode.PRESCRIBED if i < count else Mode.TORQUE for i in range(4))
        turned = np.arange(4) < count
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
    def plans(self) -> list[Plan]:
        """When and what is measured in each window."""
        found = []
        for k, (a, b) in enumerate(zip(self.edges[:-1], self.edges[1:], strict=True)):
            length, times, kinds = (b - a) * _KNOT, [], []
            for channel in self.channels:
                t = np.arange(LEAD if k else 0.05, length - 1e-6, 1.0 / RATES[channel])
                for name in CHANNELS[channel]:
                    times.append(t)
                    kinds.append(np.full(len(t), KINDS.index(name)))
            found.append(Plan(np.concatenate(times), np.concatenate(kinds).astype(np.int64)))
        return found

    def sigma(self, noise: Mapping[str, float]) -> list[Array]:
        """Noise of each sample, window by window."""
        level = {KINDS.index(name): noise[c] for c in self.channels for name in CHANNELS[c]}
        return [np.array([level[int(kind)] for kind in plan.kind]) for plan in self.plans]

    @cached_property
    def starts(self) -> Array:
        """What sensors make of the windows' starts, shape (windows, 8 or 6): see `identify.starts`."""
        rows = self.edges[:-1]
        pose, twist = self.result.pose[rows], self.result.twist[rows]
        columns = [pose, twist]
        if self.robot.articulated:
            rate = self.result["gamma_b_dot"][rows] - self.result["gamma_f_dot"][rows]
            columns.append(np.column_stack([self.result.articulation_yaw[rows], rate]))
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
        motors = np.zeros((2, len(window), 16))
        motors[0], motors[1] = scale * self.result.q[rows], scale * self.result.v[rows]
        q, v = states(postures(robots), robot, motors[0], motors[1], starts, late)
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
        t, count = self.result.t, 4 if self.robot.articulated else 2
        columns: dict[str, Array] = {}
        for i, motor in enumerate(MOTORS[:count]):
            columns |= {f"{motor}.position": position[:, i], f"{motor}.velocity": velocity[:, i]}
            columns[f"{motor}.effort"] = torque[:, i]
        told = {f"{motor}.velocity": self.planned.at(t).velocity[:, i] for i, motor in enumerate(MOTORS[:2])}
        if count == 4:
            told |= {f"{motor}.effort": self.result.motor_torque[:, i] for i, motor in enumerate(MOTORS) if i >= 2}
        stamps = np.round(t * 1e9).astype(np.int64)
        channels = {
            "motor_torques": Channel("/motor_torques", stamps, t, stamps, columns),
            "motor_command": Channel("/motor_command", stamps, t, stamps, told),
        }
        return Experiment("trial", Path("trial"), {}, 0, channels, ((0.0, float(t[-1])),))


def trial(robot: Robot, entry: Entry, place: tuple[float, float], channels: Sequence[str]) -> Trial | None:
    """A manoeuvre driven by a robot from a place in `map` (m); None where it cannot be simulated."""
    planned = plan(entry.manoeuvre, robot, start=(*place, entry.yaw))
    modes = default_modes(robot)
    integrator = "rk4" if largest_step(params(robot), "rk4", modes)[0] >= _STEP else "semi_implicit"
    result = rollout(
        robot, as_executed(robot, planned.commands()), dt=_STEP, every=round(_KNOT / _STEP), kappa=KAPPA,
        integrator=integrator, state=initial_state(robot, *planned.start),
    )  # fmt: skip
    if result.status is not Status.OK:
        return None
    known = [c for c in channels if c in RATES and (robot.articulated or c not in ("articulation_yaw", "torque_back"))]
    return Trial(robot, planned, result, tuple(known))


def with_effect(robot: Robot, effect: str, values: Mapping[str, float | str]) -> Robot:
    """The robot with other parameters of one of its effects."""
    return replace(robot, effects=dict(robot.effects) | {effect: dict(robot.effects[effect]) | dict(values)})
