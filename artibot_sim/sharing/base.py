"""What a torque-sharing law is: a small function from what a control cycle knows to the back motors' torques."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from artibot_sim.documents import did_you_mean
from artibot_sim.errors import ArtibotError
from artibot_sim.model import Robot
from artibot_sim.model.equations.transmission import back_torque_factor

Pair = tuple[float, float]
"""Right, left."""


@dataclass(frozen=True)
class Cycle:
    """What a law knows, all motor-side. Nothing in it has to be measured but by the drives themselves.

    Attributes
    ----------
    front_velocity : (float, float)
        Commanded for this cycle, rad/s.
    front_torque : (float, float)
        Measured at the end of the cycle before, N m.
    back_torque : (float, float)
        Commanded in the cycle before, N m.
    kappa : float
        Front share of the traction torque (eq. 29).
    """

    front_velocity: Pair
    front_torque: Pair
    back_torque: Pair
    kappa: float

    @property
    def bend(self) -> float:
        """Difference of the front motors' speeds over their sum, −1 to 1: half the track over the radius of the turn.

        Positive to the left, 0 at standstill; a turn on the spot is as far as it goes.
        """
        right, left = self.front_velocity
        total = abs(right) + abs(left)
        return (right - left) / total if total > 0.0 else 0.0


Share = Callable[..., Pair]
"""(robot, cycle, parameters by name) → torques of the back right and back left motor, N m."""


@dataclass(frozen=True)
class Law:
    """A torque-sharing law.

    Attributes
    ----------
    id : str
    doc : str
        What it does, in one sentence.
    share : callable
        Its parameters after `robot` and `cycle` are the law's, with their defaults.
    values : mapping of str to float
        Those of its parameters that differ from their defaults.
    kappas : tuple of str
        Names of those that are a kappa of eq. 30: motors' limits bound them.
    """

    id: str
    doc: str
    share: Share
    values: Mapping[str, float] = field(default_factory=dict)
    kappas: tuple[str, ...] = ()

    def __str__(self) -> str:
        chosen = ",".join(f"{name}={value:g}" for name, value in self.values.items())
        return f"{self.id}:{chosen}" if chosen else self.id

    @cached_property
    def defaults(self) -> dict[str, float]:
        """The law's parameters by name."""
        names = list(inspect.signature(self.share).parameters.values())[2:]
        return {parameter.name: float(parameter.default) for parameter in names}

    def torques(self, robot: Robot, cycle: Cycle) -> Pair:
        """Torques of the back motors, N m, cut at their torque_max."""
        right, left = self.share(robot, cycle, **self.values)
        most = robot.drive.back.torque_max if robot.drive.back else 0.0
        return min(max(right, -most), most), min(max(left, -most), most)

    def with_values(self, values: Mapping[str, Any]) -> Law:
        """The law with other parameters.

        Raises
        ------
        ArtibotError
            For one that it does not have, or that is no finite number.
        """
        known = self.defaults
        checked = {}
        for name, value in values.items():
            if name not in known:
                has = ", ".join(f"{n}={v:g}" for n, v in known.items()) or "none"
                raise ArtibotError(f"law {self.id}: no parameter '{name}'{did_you_mean(name, known)}; it has {has}")
            try:
                checked[name] = float(value)
            except ValueError:
                checked[name] = float("nan")
            if not abs(checked[name]) < float("inf"):
                raise ArtibotError(f"law {self.id}: {name} is '{value}'; expected a finite number")
        return replace(self, values=checked)


def eq30(robot: Robot, kappa: float, front_torque: Pair) -> float:
    """Torque of each back motor by eq. 30, N m, for the front motors' torques; `kappa` is held in (0, 1]."""
    return back_torque_factor(robot, min(max(kappa, 1e-3), 1.0)) * (front_torque[0] + front_torque[1])
