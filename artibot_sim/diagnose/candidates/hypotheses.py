"""What a diagnosis tries: every effect that a view shows, once for each choice (which motor, which form)."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.sizes import sized
from artibot_sim.estimation.loss import Loss
from artibot_sim.estimation.measurements import Stretch
from artibot_sim.estimation.parameters import Extension, ParameterSet
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.solver import Point, evaluate
from artibot_sim.model import Robot
from artibot_sim.model.effects import EFFECTS
from artibot_sim.model.effects.base import Choice, Effect, Search
from artibot_sim.model.effects.parts import names_of, of_pair
from artibot_sim.model.robot.robot import sides_of

Array = NDArray[np.float64]

_STRAIGHT = 1e-3
"""rad of articulation up to which it has not moved: nothing is known of a stop."""
_LARGEST = 0.995
"""Share of the measured articulation angles that is below what counts as the largest."""


@dataclass(frozen=True)
class Hypothesis:
    """One effect, its choices made.

    Attributes
    ----------
    extension : Extension
    probes : tuple of array, shape (len(extension),)
        Coordinates at which it is tried.
    alternatives : int
        How many alternatives of the same effect it was chosen from.
    """

    extension: Extension
    probes: tuple[Array, ...] = field(default_factory=tuple)
    alternatives: int = 1

    @property
    def id(self) -> str:
        """Of the effect."""
        return self.extension.id


def hypotheses(robot: Robot, stretches: Sequence[Stretch], without: Sequence[str] = ()) -> list[Hypothesis]:
    """Every effect that can show where all motors turn as they were measured; discs on the ground are found elsewhere.

    Parameters
    ----------
    robot : Robot
        Its own effects are known, and not looked for.
    stretches : sequence of Stretch
        The recordings, for limits that follow from what was reached.
    without : sequence of str
        Ids that are left out.
    """
    bend = largest_bend(stretches)
    found: list[Hypothesis] = []
    for effect in EFFECTS.values():
        if effect.id in (*without, *robot.effects) or effect.search is None or effect.search.disc:
            continue
        if not why_unseen(effect, robot, stretches):
            found += _choices(effect, robot, bend)
    return found


def why_unseen(effect: Effect, robot: Robot, stretches: Sequence[Stretch]) -> str:
    """Why recordings whose measured rotations turn the motors cannot show an effect; empty where they can."""
    search = effect.search
    if search is None:
        return "no diagnosis looks for it"
    if search.views == ("encoder",):
        return "it shows between angles and speeds of a motor only, and not both are recorded"
    if "rotation" not in search.views:
        return "it shows between commands and speeds only, and no commands are recorded"
    if not robot.articulated and (search.back or effect.acts == "joint"):
        return "the robot has no back module"
    if effect.law is not None:
        law = effect.law({name: parameter.neutral for name, parameter in effect.parameters.items()})
        if of_pair(str(law["where"]))[1] >= max(len(robot.modules), 2):
            return f"the robot has {len(robot.modules)} modules"
    measured = {series.channel for stretch in stretches for series in stretch.series}
    measured |= {"pose"} if any(stretch.measured.late_heading for stretch in stretches) else set()
    if search.channels and measured.isdisjoint(search.channels):
        return f"nothing measures {' or '.join(search.channels)}"
    if search.reference == "articulation" and not largest_bend(stretches) > _STRAIGHT:
        return "the articulation never bends"
    return ""


def _choices(effect: Effect, robot: Robot, bend: float) -> list[Hypothesis]:
    assert effect.search is not None
    names = [name for name, parameter in effect.parameters.items() if isinstance(parameter.quantity, Choice)]
    options: list[Sequence[float | str]] = [_names(effect, name, robot) for name in names]
    names, options = [*names, *effect.search.forms], [*options, *effect.search.forms.values()]
    combinations = list(itertools.product(*options))
    reference = bend if effect.search.reference == "articulation" else 1.0
    return [
        Hypothesis(
            sized(effect.id, robot, dict(zip(names, chosen, strict=True)), reference),
            tuple(np.array(probe) for probe in effect.search.probes or _corners(effect.search)), len(combinations),
        )
        for chosen in combinations
    ]  # fmt: skip


def _corners(search: Search) -> list[tuple[float, ...]]:
    """Plain sizes with all signs, for several sizes that declare no probes: one alone may fit worse than none."""
    several = len(search.sizes) > 1 and not search.direction
    return list(itertools.product((1.0, -1.0), repeat=len(search.sizes))) if several else []


def _names(effect: Effect, name: str, robot: Robot) -> list[str]:
    """Names that a parameter may be in a robot; how wheels turned that no motor turns is not measured."""
    quantity, modules = effect.parameters[name].quantity, len(robot.modules)
    assert isinstance(quantity, Choice)
    passive = tuple(side for side in sides_of(modules) if side not in robot.motors)
    known = [one for one in names_of(quantity.names, modules) if of_pair(one)[1] < modules]
    return [one for one in known if not one.startswith(passive)]


def largest_bend(stretches: Sequence[Stretch]) -> float:
    """The largest articulation angle that was measured (rad), some outliers apart; NaN where none was."""
    angles = [np.abs(s.value) for stretch in stretches for s in stretch.series if s.channel == "articulation_yaw"]
    return float(np.quantile(np.concatenate(angles), _LARGEST)) if angles else float("nan")


def with_effect(problem: Problem, extension: Extension) -> Problem:
    """A problem with one more effect to be fitted; windows and parameters stay."""
    parameters = problem.parameters
    more = ParameterSet(parameters.robot, parameters.parameters, (*parameters.extensions, extension))
    return problem.with_parameters(more)


def without_effect(problem: Problem, loss: Loss, point: Point, which: int = -1) -> tuple[Problem, Point]:
    """A problem and a point of it, one of its effects left out; the last one unless said otherwise.

    The rover goes on moving as it did: starts are what sensors without that effect see of it.
    """
    old = problem.parameters
    kept = list(old.extensions)
    del kept[which]
    part = problem.with_parameters(ParameterSet(old.robot, old.parameters, tuple(kept)))
    others = np.delete(np.arange(len(old)), old.places[which])
    coordinates = part.parameters.inside(point.coordinates[others])
    starts = part.held(old.robot_at(point.coordinates), part.parameters.robot_at(coordinates), point.starts)
    return part, evaluate(part, loss, [coordinates], starts)[0]
