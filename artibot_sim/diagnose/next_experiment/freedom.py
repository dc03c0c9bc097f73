"""What another robot may change to explain a trial, and what is left then."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.next_experiment.simulation import Trial, with_effect
from artibot_sim.model import Robot
from artibot_sim.model.effects import EFFECTS
from artibot_sim.model.effects.base import Choice
from artibot_sim.model.windows import KINDS

Array = NDArray[np.float64]

SOIL = ("contact.k_l", "contact.k_t", "contact.mu_s", "contact.mu_d", "contact.u_w")
SOIL_SD = 0.05
"""By how much (as logarithms) the soil may differ from the one that earlier recordings gave."""
SIZE_SD = 0.2
"""The same of an effect's size, over it."""
_PLACES = {"rad": 0.3, "m": 0.3}
"""The same of parameters that say where or whither, by unit."""
_STARTS = np.array([0.03, 0.03, 0.1, 0.03, 0.03, 0.015, 0.01, 0.05])
"""The same of a window's start: x, y, yaw, velocities, joint."""
_STEPS = np.array([1e-3, 1e-3, 1e-3, 3e-3, 3e-3, 3e-3, 1e-3, 3e-3])
_ROUNDS = 8
_FALL = (0.5, 0.05)
"""Fall of the loss in a round, nats and over what is left, under which it has ended."""
_FREEDOM = 5.0
_LOST = 50.0


@dataclass(frozen=True)
class Handle:
    """A parameter that may change: coordinates are in standard deviations."""

    key: str
    sd: float
    effect: str = ""

    def turned(self, robot: Robot, by: float) -> Robot:
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


def handles(robot: Robot) -> list[Handle]:
    """What may change of a robot: its soil, and its effects' numbers."""
    found = [Handle(key, SOIL_SD) for key in SOIL]
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
                found.append(Handle(key, sd, name))
    return found


@dataclass(frozen=True)
class Explanation:
    """A robot that is to explain a trial of another one.

    Attributes
    ----------
    trial : Trial
    robot : Robot
    noise : mapping of str to float
        Standard deviation of a sample, by channel (SI).
    """

    trial: Trial
    robot: Robot
    noise: Mapping[str, float]

    @cached_property
    def _handles(self) -> list[Handle]:
        return handles(self.robot)

    @cached_property
    def _sigma(self) -> list[Array]:
        return self.trial.sigma(self.noise)

    def nats(self) -> float:
        """Log-likelihood that it loses against the robot that drove, everything that may change at its best."""
        count = len(self.trial.plans)
        size = self.trial.starts.shape[1]
        turns, moves = np.zeros(len(self._handles)), np.zeros((count, size))
        least = self._cost(turns, moves, self._residuals([turns], moves[None])[0])
        for _ in range(_ROUNDS):
            step, move = self._step(turns, moves)
            shares = (1.0, 0.5, 0.2)
            tried = [(turns + share * step, moves + share * move) for share in shares]
            found = self._residuals([t for t, _ in tried], np.array([m for _, m in tried]))
            costs = [self._cost(t, m, r) for (t, m), r in zip(tried, found, strict=True)]
            best = int(np.argmin(costs))
            if costs[best] >= least:
                break
            fallen = least - costs[best]
            least, (turns, moves) = costs[best], tried[best]
            if fallen < max(_FALL[0], _FALL[1] * least):
                break
        return least

    def _robot_at(self, turns: Array) -> Robot:
        robot = self.robot
        for handle, by in zip(self._handles, turns.tolist(), strict=True):
            robot = handle.turned(robot, by)
        return robot

    def _residuals(self, turns: Sequence[Array], moves: Array) -> list[list[Array]]:
        """Residuals, window by window, for several sets of changes; `moves` is (sets, windows, 8 or 6)."""
        count = len(self.trial.plans)
        robots = [self._robot_at(t) for t in turns]
        sd = _STARTS[: moves.shape[-1]]
        starts = (self.trial.starts + moves * sd).reshape(-1, moves.shape[-1])
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

    def _cost(self, turns: Array, moves: Array, residuals: Sequence[Array]) -> float:
        lost = sum(float(np.log1p(r**2 / _FREEDOM).sum()) for r in residuals)
        return 0.5 * ((_FREEDOM + 1.0) * lost + float(turns @ turns) + float((moves**2).sum()))

    def _step(self, turns: Array, moves: Array) -> tuple[Array, Array]:
        """Gauss–Newton with the weights of heavy tails; starts are eliminated window by window."""
        count, size = moves.shape
        eye = 0.05 * np.eye(len(turns))
        sets = [turns, *(turns + row for row in eye), *(turns for _ in range(size))]
        starts = np.repeat(moves[None], len(sets), axis=0)
        steps = _STEPS[:size] / _STARTS[:size]
        for k in range(size):
            starts[1 + len(turns) + k, :, k] += steps[k]
        found = self._residuals(sets, starts)
        A, g = np.eye(len(turns)), turns.copy()
        solved = []
        for i in range(count):
            r = found[0][i]
            J = _clipped(np.column_stack([(found[1 + k][i] - r) / 0.05 for k in range(len(turns))]))
            S = _clipped(np.column_stack([(found[1 + len(turns) + k][i] - r) / steps[k] for k in range(size)]))
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
