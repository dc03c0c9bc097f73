"""What can be identified: parameters of a robot with priors and bounds, as the numbers that a fit works on."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from artibot_sim.identify.extension import SPREAD, Extension
from artibot_sim.identify.extension import STEP as EFFECT_STEP
from artibot_sim.model import Robot
from artibot_sim.model.effects import EFFECTS, effects_from_dict

Array = NDArray[np.float64]

SOIL = ("k_l", "k_t", "mu_s", "mu_d", "u_w")
"""What is identified unless `--fit` says otherwise."""

MU_S = "contact.mu_s"
MU_D = "contact.mu_d"

STEP = 4e-3
"""Change of a logarithm for its finite difference: about what data leave open, so that switches that such a change
moves are seen as often as they count."""
_LONGEST = 0.25
"""Longest step of a logarithm, and of an effect's coordinate."""
_LONGEST_EFFECT = 0.7


@dataclass(frozen=True)
class Prior:
    """What is known beforehand: middle and standard deviation, in the parameter's unit."""

    value: float
    sd: float


@dataclass(frozen=True)
class Parameter:
    """One parameter of a fit.

    Attributes
    ----------
    key : str
        As in a robot file (``contact.k_l``).
    name : str
        Short, for tables.
    unit : str
    prior : Prior
    low, high : float
        Bounds of the value.
    """

    key: str
    name: str
    unit: str
    prior: Prior
    low: float
    high: float

    @property
    def spread(self) -> float:
        """Standard deviation of the prior in the logarithm."""
        return self.prior.sd / self.prior.value


@dataclass(frozen=True)
class ParameterSet:
    """The parameters of a fit in their order, the robot that they change, and effects whose coordinates follow them."""

    robot: Robot
    parameters: tuple[Parameter, ...]
    extensions: tuple[Extension, ...] = ()

    def __len__(self) -> int:
        return len(self.parameters) + sum(len(extension) for extension in self.extensions)

    @cached_property
    def keys(self) -> tuple[str, ...]:
        """As in a robot file."""
        own = tuple(parameter.key for parameter in self.parameters)
        return own + tuple(key for extension in self.extensions for key in extension.keys)

    @property
    def names(self) -> tuple[str, ...]:
        """Short ones."""
        own = tuple(parameter.name for parameter in self.parameters)
        return own + tuple(name for extension in self.extensions for name in extension.names)

    @property
    def spread(self) -> Array:
        """Prior standard deviations of the logarithms, and of the effects' coordinates, shape (p,)."""
        own = [parameter.spread for parameter in self.parameters]
        return np.array(own + [SPREAD] * (len(self) - len(own)))

    @cached_property
    def steps(self) -> Array:
        """Changes of the coordinates for finite differences, shape (p,).

        mu_d steps downwards, for it may stand at mu_s, over which it cannot go.
        """
        own = [-STEP if parameter.key == MU_D else STEP for parameter in self.parameters]
        return np.array(own + [EFFECT_STEP] * (len(self) - len(own)))

    @cached_property
    def longest(self) -> Array:
        """Longest steps of a fit, shape (p,)."""
        own = [_LONGEST] * len(self.parameters)
        return np.array(own + [_LONGEST_EFFECT] * (len(self) - len(own)))

    @cached_property
    def mixing(self) -> Array:
        """Logarithms of the values over the priors' middles = mixing · coordinates, shape (p, p).

        A wheel breaks away at a slip of mu_s F_n over k_l and k_t. So mu_s goes along when they change, and its own
        coordinate is that slip: what moves by its gradient leaves the instants of breaking away nearly as they are.
        """
        matrix = np.eye(len(self))
        row = self.index(MU_S)
        for key in ("contact.k_l", "contact.k_t"):
            column = self.index(key)
            if row is not None and column is not None:
                matrix[row, column] = 0.5
        return matrix

    @cached_property
    def prior_information(self) -> Array:
        """Of the coordinates, shape (p, p)."""
        scaled = self.mixing / self.spread[:, None]
        return scaled.T @ scaled

    def values(self, coordinates: Array) -> Array:
        """Values in SI units of the robot's own parameters at coordinates (p,)."""
        own = len(self.parameters)
        middles = np.array([p.prior.value for p in self.parameters])
        values: Array = middles * np.exp(self.mixing[:own] @ coordinates)
        return values

    def coordinates(self, values: Sequence[float] | Array, extended: Array | None = None) -> Array:
        """Coordinates (p,) at values of the robot's own parameters, and the effects' coordinates `extended` (0)."""
        own = len(self.parameters)
        middles = np.array([p.prior.value for p in self.parameters])
        mine = np.linalg.solve(self.mixing[:own, :own], np.log(np.asarray(values, float) / middles))
        rest = np.zeros(len(self) - own) if extended is None else extended
        return np.concatenate([mine, rest])

    @property
    def places(self) -> list[slice]:
        """Where the coordinates of each effect stand among all."""
        ends = np.cumsum([len(self.parameters), *(len(extension) for extension in self.extensions)]).tolist()
        return [slice(a, b) for a, b in zip(ends, ends[1:], strict=False)]

    def extended(self, coordinates: Array) -> list[Array]:
        """The coordinates of each effect."""
        return [coordinates[place] for place in self.places]

    def inside(self, coordinates: Array) -> Array:
        """The nearest coordinates whose values are within bounds, mu_d not above mu_s."""
        low = np.array([parameter.low for parameter in self.parameters])
        high = np.array([parameter.high for parameter in self.parameters])
        values = self.values(coordinates)
        clipped = values.clip(low, high)
        i, j = self.index(MU_S), self.index(MU_D)
        if i is not None and j is not None:
            clipped[j] = min(clipped[j], clipped[i])
        parts = self.extended(coordinates)
        nearest = [extension.nearest(part) for extension, part in zip(self.extensions, parts, strict=True)]
        unchanged = (clipped == values).all() and all((a == b).all() for a, b in zip(nearest, parts, strict=True))
        return coordinates if unchanged else self.coordinates(clipped, np.concatenate([np.empty(0), *nearest]))

    def at_bound(self, coordinates: Array) -> list[bool]:
        """Which of the robot's own parameters stand at a bound."""
        values = self.values(coordinates)
        return [
            bool(v <= p.low * (1 + 1e-4) or v >= p.high * (1 - 1e-4))
            for v, p in zip(values, self.parameters, strict=True)
        ]

    def robot_at(self, coordinates: Array) -> Robot:
        """The robot at coordinates (p,), with the effects as they are there."""
        robot = self.robot_with(self.values(coordinates))
        if not self.extensions:
            return robot
        parts = zip(self.extensions, self.extended(coordinates), strict=True)
        return replace(robot, effects=dict(robot.effects) | {e.id: e.values(part) for e, part in parts})

    def candidate(self, coordinates: Array) -> Robot:
        """The same for a simulation: where only soil changes, the rest of a robot that was checked is not again.

        A fit makes thousands; to check a hundred numbers of each takes as long as to simulate seconds of driving.
        """
        keys = [parameter.key.split(".") for parameter in self.parameters]
        if not all(key[0] == "contact" for key in keys):
            return self.robot_at(coordinates)
        soil = dict(zip([name for _, name in keys], self.values(coordinates).tolist(), strict=True))
        mu_s, mu_d = (soil.get(name, getattr(self.robot.contact, name)) for name in ("mu_s", "mu_d"))
        if mu_d > mu_s:
            return self.robot_at(coordinates)
        parts = zip(self.extensions, self.extended(coordinates), strict=True)
        effects = dict(self.robot.effects) | effects_from_dict({e.id: e.values(part) for e, part in parts})
        robot = copy.copy(self.robot)
        object.__setattr__(robot, "contact", replace(self.robot.contact, **soil))
        object.__setattr__(robot, "effects", MappingProxyType(effects))
        return robot

    @property
    def uniform(self) -> bool:
        """Whether the ground is the same everywhere and in all directions."""
        at_work = [*self.robot.effects, *(extension.id for extension in self.extensions)]
        return all(EFFECTS[name].uniform for name in at_work)

    def robot_with(self, values: Array) -> Robot:
        """The robot with values (p,); mu_d gives way to a smaller mu_s that is fitted, else mu_s to it."""
        own = [parameter.key for parameter in self.parameters]
        changes = dict(zip(own, np.asarray(values, float).tolist(), strict=True))
        mu_s = changes.get(MU_S, self.robot.contact.mu_s)
        mu_d = changes.get(MU_D, self.robot.contact.mu_d)
        if mu_d > mu_s:
            changes |= {MU_D: mu_s} if MU_S in changes else {MU_S: mu_d}
        return self.robot.replace(changes)

    def index(self, key: str) -> int | None:
        """Place of a key, None if it is not fitted."""
        return self.keys.index(key) if key in self.keys else None
