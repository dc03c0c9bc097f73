"""What is large for a robot: plain sizes of effects, forces and discs on the ground, from its weight and lengths.

Effects declare how large a plain one is for Agri.q (`Search.sizes`). For another robot a force is as plain as its
weight is larger, a length as its track, a torque as both, a motor's torque as weight, wheel and gear.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from artibot_sim.estimation.parameters import Extension
from artibot_sim.model import Robot
from artibot_sim.model.effects import EFFECTS
from artibot_sim.model.effects.base import Choice

_MASS = 87.0
"""kg: Agri.q's, wheels included."""
_TRACK = 0.72
"""m: Agri.q's."""
_GEARED = 0.2 * 0.02099076406381192
"""m of way per rad of a front motor: Agri.q's."""


@dataclass(frozen=True)
class RobotScale:
    """A robot's size over Agri.q's.

    Attributes
    ----------
    mass, length : float
    speed : float
        Of a front motor's speed where wheels roll as fast.
    """

    mass: float
    length: float
    speed: float

    @property
    def motor(self) -> float:
        """Of a torque at a front motor."""
        return self.mass / self.speed

    @property
    def torque(self) -> float:
        """Of a torque about a vertical axis."""
        return self.mass * self.length

    def of(self, unit: str, acts: str) -> float:
        """The factor of a quantity with this unit in an effect that acts there; 1 where no size of the robot counts."""
        if acts == "law":  # of somebody's own robot
            return 1.0
        if unit.startswith("N m"):
            return self.motor if acts == "drive" else self.torque
        if unit.startswith("N") or unit == "kg":
            return self.mass
        if unit == "rad/s" and acts == "command":
            return self.speed
        return self.length if unit == "m" else 1.0


def scale_of(robot: Robot) -> RobotScale:
    """A robot's size."""
    mass = sum(module.m + 4.0 * robot.wheel.m_w for module in robot.modules) / _MASS
    return RobotScale(mass, robot.front.i_y / _TRACK, _GEARED / (robot.wheel.r_w * robot.drive.front.tau))


def factors(effect: str, robot: Robot) -> dict[str, float]:
    """By what a robot's plain sizes of an effect differ from Agri.q's, by parameter; those that do not are left out."""
    declared, scale = EFFECTS[effect], scale_of(robot)
    found: dict[str, float] = {}
    for name in declared.search.sizes if declared.search is not None else ():
        quantity = declared.parameters[name].quantity
        factor = 1.0 if isinstance(quantity, Choice) else scale.of(quantity.unit, declared.acts)
        found |= {name: factor} if factor != 1.0 else {}
    return found


def sized(
    effect: str, robot: Robot, fixed: Mapping[str, float | str] | None = None, reference: float = 1.0
) -> Extension:
    """An effect in a fit, 1 being plain for this robot."""
    search = EFFECTS[effect].search
    plain = factors(effect, robot) if search is not None and not search.logarithmic else {}
    return Extension(effect, fixed or {}, reference, plain)
