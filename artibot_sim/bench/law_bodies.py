"""The paper's contact law on the bodies of a library that is called from Python, RK4 around both.

Like any user of such a library's interface one calls its forward dynamics stage by stage. The law is the compiled one
that MuJoCo calls, so what differs is who solves the bodies, and the calls to it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from artibot_sim.bench import mujoco_law as law
from artibot_sim.bench.mujoco_runs import MujocoRun, law_numbers
from artibot_sim.model import Commands, Robot, initial_state
from artibot_sim.model.params import params

Array = NDArray[np.float64]

BODIES = (law.FRONT, law.BACK)


class LawOnBodies(ABC):
    """The paper's contact law on somebody's bodies.

    Equivalent and different as :class:`artibot_sim.bench.mujoco_runs.LawRun` says of MuJoCo. Coordinates are x, y, z,
    gamma, beta, alpha of the front module, yaw and roll of the joint, and four motors of unit inertia that turn alone.
    """

    def __init__(self, robot: Robot, commands: Commands, dt: float = 1e-3, stages: int = 4) -> None:
        self.dt, self.steps, self.every = dt, round(commands.duration / dt), round(commands.dt / dt)
        self.p = params(robot)
        self._height = float(initial_state(robot).q[2])
        self._numbers = law_numbers(robot, commands, dt, stages)
        self._command = np.ascontiguousarray(np.column_stack([commands.position[:, :2], commands.velocity[:, :2]]))
        self._memory = np.zeros(law.MEMORY)
        self._scratch = np.zeros((4, 2)), np.zeros(4)
        shapes = {"xpos": (3, 3), "xmat": (3, 9), "cvel": (3, 6), "com": (3, 3), "qfrc": (12,), "xfrc": (3, 6)}
        self.arrays = {name: np.zeros(shape) for name, shape in shapes.items()}

    @abstractmethod
    def look(self, q: Array, v: Array) -> list[tuple[Array, Array, Array, Array]]:
        """Origin (m), rotation (3, 3), velocity (m/s) and angular velocity (rad/s) of both modules in `map`."""

    def forces(self, q: Array, v: Array) -> tuple[Array, Array]:
        """What the law does: generalised forces (12,), and forces and moments at the modules' origins (2, 6)."""
        a = self.arrays
        places = self.look(q, v)
        common = places[0][0]  # MuJoCo gives all velocities at one point
        for body, (origin, rotation, velocity, turn) in zip(BODIES, places, strict=True):
            a["xpos"][body], a["xmat"][body], a["cvel"][body, :3] = origin, rotation.ravel(), turn
            a["cvel"][body, 3:] = velocity + np.cross(turn, common - origin)
        a["com"][law.FRONT], a["qfrc"][:] = common, 0.0
        law.apply(
            self._numbers, self._memory, self._command, *self._scratch, q, v, a["xpos"], a["xmat"], a["cvel"],
            a["com"], a["qfrc"], a["xfrc"],
        )  # fmt: skip
        return a["qfrc"], a["xfrc"][1:]

    def at_rest(self) -> tuple[Array, Array]:
        """Coordinates and rates of a start from rest, with nothing fed back."""
        q, drives = np.zeros(12), self._numbers[0]
        q[2] = self._height
        self._memory[:] = 0.0
        self._memory[law.ETA_NEXT : law.ETA_NEXT + 4] = [drives["eta_d_f"]] * 2 + [drives["eta_d_b"]] * 2
        return q, np.zeros(12)

    def run(self, rows: list[Any]) -> MujocoRun:
        """What came of it; `rows` are poses at the knots."""
        return MujocoRun(np.arange(len(rows), dtype=np.float64) * self.every * self.dt, np.array(rows), self.steps)


class StagedRun(LawOnBodies):
    """The same with RK4 around somebody's forward dynamics; call it for a rollout."""

    @abstractmethod
    def solve(self, q: Array, v: Array, torque: Array, wrench: Array) -> Array:
        """Accelerations (12,) under generalised forces `torque` (12,), and forces and moments (2, 6) at the origins."""

    def _acceleration(self, q: Array, v: Array) -> Array:
        return self.solve(q, v, *self.forces(q, v))

    def __call__(self) -> MujocoRun:
        """One rollout from rest."""
        (q, v), h = self.at_rest(), self.dt
        rows = [q[[0, 1, 3]]]
        for step in range(1, self.steps + 1):
            a1 = self._acceleration(q, v)
            v2 = v + 0.5 * h * a1
            a2 = self._acceleration(q + 0.5 * h * v, v2)
            v3 = v + 0.5 * h * a2
            a3 = self._acceleration(q + 0.5 * h * v2, v3)
            v4 = v + h * a3
            a4 = self._acceleration(q + h * v3, v4)
            q = q + h / 6.0 * (v + 2.0 * v2 + 2.0 * v3 + v4)
            v = v + h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
            if step % self.every == 0:
                rows.append(q[[0, 1, 3]])
        return self.run(rows)
