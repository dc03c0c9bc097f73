"""What all benchmarks of the model run: Agri.q on the trajectory of Table 6."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from artibot_sim.model import Commands, Robot, Rollout, load_robot, rollout
from artibot_sim.planning import Plan, load_manoeuvre, plan

KEPT_EVERY = 0.01
"""Outputs are kept at 100 Hz."""


@dataclass(frozen=True, eq=False)
class Scenario:
    """Robot, plan and commands, and how much to measure.

    Attributes
    ----------
    quick : bool
        Fewer runs and a shorter trajectory: to see that everything works.
    tick : callable
        To be called now and then, so that the progress shows.
    rover : Robot, optional
        In place of Agri.q as shipped.
    """

    quick: bool = False
    tick: Callable[[], None] = lambda: None
    rover: Robot | None = None

    def runs(self, full: int) -> int:
        """How often to measure: `full`, or twice when in a hurry."""
        return min(full, 2) if self.quick else full

    @cached_property
    def robot(self) -> Robot:
        """Agri.q as shipped, unless there is another."""
        return self.rover or load_robot("agriq")

    @cached_property
    def plan(self) -> Plan:
        """Table 6."""
        return plan(load_manoeuvre("table6_agriq"), self.robot, dt=KEPT_EVERY)

    @cached_property
    def commands(self) -> Commands:
        """Those of the plan; its first 8 s when in a hurry."""
        whole = self.plan.commands()
        if not self.quick:
            return whole
        end = round(8.0 / whole.dt) + 1
        return Commands(whole.dt, whole.velocity[:end], position=whole.position[:end])

    def rollout(self, integrator: str, dt: float, every: float = KEPT_EVERY) -> Rollout:
        """One rollout, rows kept each `every` s."""
        return rollout(self.robot, self.commands, integrator=integrator, dt=dt, every=round(every / dt))

    def steps(self, dt: float) -> int:
        """Integration steps of one rollout."""
        return round(self.commands.duration / dt)

    @cached_property
    def converged(self) -> Rollout:
        """RK4 with a step at which the pose no longer changes with it."""
        return self.rollout("rk4", 1e-4 if self.quick else 5e-5)

    @cached_property
    def steady(self) -> tuple[float, float]:
        """Second half of the longest stretch at constant speed and yaw rate: from, to (s)."""
        twist = self.plan.twist[: len(self.commands.velocity)]
        breaks = np.flatnonzero(np.abs(np.diff(twist, axis=0)).max(axis=1) > 1e-9) + 1
        edges = np.concatenate([[0], breaks, [len(twist)]])
        k = int(np.argmax(np.diff(edges)))
        first, last = edges[k], edges[k + 1] - 1
        return float(0.5 * (first + last) * KEPT_EVERY), float(last * KEPT_EVERY)
