"""What can be estimated: parameters of a robot with priors and bounds, and effects, as coordinates of a fit."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from artibot_sim.errors import ArtibotError
from artibot_sim.model import Robot
from artibot_sim.model.effects import EFFECTS, effects_from_dict
from artibot_sim.model.effects.base import Effect, Search
from artibot_sim.model.robot.quantity import Quantity
from artibot_sim.model.robot.robot import unchecked

# ----------------------------------------------------------------------
# An effect as coordinates of a fit: 0 where it is absent, 1 where it is plain.
# ----------------------------------------------------------------------


SPREAD = 1.5
"""Standard deviation of a coordinate's prior: effects are about as large as what is plain, or a few times so."""
_FARTHEST = 12.0
"""Coordinates end here."""
_SMALLEST = 0.05
"""Least factor by which a logarithmic value can fall."""


@dataclass(frozen=True)
class Extension:
    """One effect in a fit.

    Attributes
    ----------
    id : str
        Of the effect.
    fixed : mapping of str to float or str
        Parameters that are not fitted: which motor, where on the ground.
    reference : float
        What the logarithm of a value without a finite neutral one is taken from (`Search.reference`).
    factors : mapping of str to float
        Plain sizes over those that the effect declares, by parameter: a lighter robot has smaller ones.
    own : Search, optional
        How it is looked for, where the effect itself does not say: laws have a size of their own each time.
    """

    id: str
    fixed: Mapping[str, float | str] = field(default_factory=dict)
    reference: float = 1.0
    factors: Mapping[str, float] = field(default_factory=dict)
    own: Search | None = None

    def __len__(self) -> int:
        return len(self.search.sizes) + bool(self.search.direction)

    @property
    def effect(self) -> Effect:
        """Its declaration."""
        return EFFECTS[self.id]

    @cached_property
    def search(self) -> Search:
        """How it is looked for."""
        found = self.own or self.effect.search
        if found is None:
            raise ArtibotError(f"effects.{self.id}: has no coordinates; it declares no `search`")
        sizes = {name: size * self.factors.get(name, 1.0) for name, size in found.sizes.items()}
        return replace(found, sizes=sizes) if self.factors else found

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters that are fitted; of a size with a direction its components along x and y."""
        names = tuple(self.search.sizes)
        return (*(f"{names[0]}_{axis}" for axis in "xy"), *names[1:]) if self.search.direction else names

    @cached_property
    def _origin(self) -> Array:
        """Values at coordinate 0, shape (sizes,)."""
        parameters, around = self.effect.parameters, self.search.around
        neutral = [float(around.get(name, parameters[name].neutral)) for name in self.search.sizes]
        if self.search.logarithmic:
            return np.array([n if math.isfinite(n) and n > 0.0 else self.reference for n in neutral])
        return np.array(neutral)

    @cached_property
    def _scale(self) -> Array:
        return np.array(list(self.search.sizes.values()))

    @cached_property
    def _logarithmic(self) -> NDArray[np.bool_]:
        """Whether the coordinate is a logarithm's, shape (sizes,)."""
        low, _ = self._limits
        positive = [name in self.search.around and end >= 0.0 for name, end in zip(self.search.sizes, low, strict=True)]
        return np.array([self.search.logarithmic or one for one in positive])

    def values(self, coordinates: Array) -> dict[str, Any]:
        """Parameters of the effect at coordinates (len,); neutral where it is absent."""
        c, turned = np.asarray(coordinates, float), dict[str, Any]()
        if self.search.direction:
            turned = {self.search.direction: float(np.arctan2(c[1], c[0])) if c[:2].any() else 0.0}
            c = np.array([np.hypot(c[0], c[1]), *c[2:]])
        values = self._origin + c * self._scale
        log = self._logarithmic
        values[log] = self._origin[log] * np.exp(c[log] * self._scale[log])
        low, high = self._limits
        return dict(zip(self.search.sizes, values.clip(low, high).tolist(), strict=True)) | turned | dict(self.fixed)

    def coordinates(self, values: Mapping[str, Any]) -> Array:
        """Coordinates (len,) at parameters of the effect."""
        known = np.array([float(values[name]) for name in self.search.sizes])
        own, log = (known - self._origin) / self._scale, self._logarithmic
        own[log] = np.log(known[log] / self._origin[log]) / self._scale[log]
        if self.search.direction:
            heading = float(values[self.search.direction])
            own = np.array([own[0] * np.cos(heading), own[0] * np.sin(heading), *own[1:]])
        return np.asarray(own, float)

    @cached_property
    def _limits(self) -> tuple[Array, Array]:
        """Least and largest values, shape (sizes,) each."""
        quantities = [self.effect.parameters[name].quantity for name in self.search.sizes]
        ends = [(q.low, q.high) for q in quantities if isinstance(q, Quantity)]
        return np.array([low for low, _ in ends]), np.array([high for _, high in ends])

    @cached_property
    def bounds(self) -> tuple[Array, Array]:
        """Least and largest coordinates (len,)."""
        limits, log = np.array(self._limits), self._logarithmic
        ends = (limits - self._origin) / self._scale
        ends[:, log] = np.log(np.maximum(limits[:, log] / self._origin[log], _SMALLEST)) / self._scale[log]
        least = max(self.search.least, -_FARTHEST) if self.one_sided else -_FARTHEST
        low, high = np.maximum(ends[0], least), np.minimum(ends[1], _FARTHEST)
        free = np.array([name in self.search.around for name in self.search.sizes])
        low[free], high[free] = -1.0, 1.0
        if self.search.direction:  # components may have either sign
            low, high = (np.array([end, end, *rest]) for end, (_, *rest) in ((-_FARTHEST, low), (_FARTHEST, high)))
        return low, high

    @property
    def one_sided(self) -> bool:
        """Whether the coordinates cannot be negative."""
        parameter = self.effect.parameters[next(iter(self.search.sizes))]
        return (
            not self.search.direction and isinstance(parameter.quantity, Quantity)
            and parameter.quantity.low == parameter.neutral
        )  # fmt: skip

    @property
    def label(self) -> str:
        """The effect's id with what is fixed, for messages."""
        said = [f"{v:.2f}" if isinstance(v, float) else str(v) for v in self.fixed.values()]
        return f"{self.id}({', '.join(said)})" if said else self.id

    @property
    def keys(self) -> tuple[str, ...]:
        """Of the coordinates among all of a fit."""
        return tuple(f"effects.{self.id}.{name}" for name in self.names)

    def nearest(self, coordinates: Array) -> Array:
        """The nearest coordinates (len,) within bounds."""
        low, high = self.bounds
        return np.asarray(np.clip(coordinates, low, high), float)


# ----------------------------------------------------------------------
# What can be identified: parameters of a robot with priors and bounds, as the numbers that a fit works on.
# ----------------------------------------------------------------------


Array = NDArray[np.float64]

SOIL = ("k_l", "k_t", "mu_s", "mu_d", "u_w")
"""What is identified unless `--fit` says otherwise."""

MU_S = "contact.mu_s"
MU_D = "contact.mu_d"
STIFFNESS = ("contact.k_l", "contact.k_t")
"""Slip coefficients of eq. 15."""

PARAMETER_STEP = 4e-3
"""Change of a logarithm for its finite difference: about what data leave open, so that switches that such a change
moves are seen as often as they count."""
_LONGEST = 0.25
"""Longest step of a logarithm, and of an effect's coordinate."""
_LONGEST_EFFECT = 0.7
"""Longest step of an effect's coordinate, in plain sizes."""
_LINEAR = 10.0
"""Prior deviations from a signed value's middle to where its logarithm ends: over three of them it bends by a sixth."""


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
    signed : bool
        Whether the value may have either sign, as a lever arm.
    """

    key: str
    name: str
    unit: str
    prior: Prior
    low: float
    high: float
    signed: bool = False

    @property
    def offset(self) -> float:
        """What is added to a value before its logarithm is taken: 0, or what makes that as good as linear."""
        return _LINEAR * self.prior.sd - self.prior.value if self.signed else 0.0

    @property
    def middle(self) -> float:
        """The prior's middle with the offset: what coordinate 0 stands for."""
        return self.prior.value + self.offset

    @property
    def spread(self) -> float:
        """Standard deviation of the prior in the logarithm."""
        return self.prior.sd / self.middle

    def at(self, logarithm: float) -> float:
        """The value at a logarithm over the middle."""
        return float(self.middle * np.exp(logarithm) - self.offset)


INERTIAS = (".J_x", ".J_y", ".J_z")
"""How keys of a module's moments of inertia end."""


def sum_of_others(robot: Robot, key: str, changes: Mapping[str, float] = MappingProxyType({})) -> float:
    """The sum of a module's other two moments of inertia, kg m², for the one with this key; some may be changed."""
    module = key.rpartition(".")[0]
    others = [module + name for name in INERTIAS if module + name != key]
    stated = {one: value for one, _, value in robot.quantities() if one in others}
    return sum(changes.get(one, stated[one]) for one in others)


@dataclass(frozen=True)
class ParameterSet:
    """The parameters of a fit in their order, the robot that they change, and effects whose coordinates follow them.

    Attributes
    ----------
    robot : Robot
    parameters : tuple of Parameter
    extensions : tuple of Extension
    jump : float, optional
        mu_s over mu_d, where that is held: mu_s then follows mu_d, whatever its own coordinate. With 1 the force of
        eq. 16 is continuous.
    """

    robot: Robot
    parameters: tuple[Parameter, ...]
    extensions: tuple[Extension, ...] = ()
    jump: float | None = None

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

    def steps(self, coordinates: Array) -> Array:
        """Changes of the coordinates (p,) for finite differences, shape (p,): back from an upper bound.

        mu_d steps downwards, for it may stand at mu_s, over which it cannot go.
        """
        steps = np.full(len(self), PARAMETER_STEP)
        logarithms = self.mixing[: len(self.parameters)] @ coordinates + PARAMETER_STEP
        for i, (parameter, moved) in enumerate(zip(self.parameters, logarithms.tolist(), strict=True)):
            if parameter.key == MU_D or parameter.at(moved) > parameter.high:
                steps[i] = -PARAMETER_STEP
        return steps

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
        for key in STIFFNESS:
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
        values = self.at(self.mixing[: len(self.parameters)] @ coordinates)
        i = self.index(MU_S)
        if self.jump is not None and i is not None:
            values[i] = self.jump * self._mu_d(values)
        return values

    def _mu_d(self, values: Array) -> float:
        """mu_d of the robot's own parameters `values`, or as the robot has it."""
        j = self.index(MU_D)
        return float(values[j]) if j is not None else self.robot.contact.mu_d

    def at(self, logarithms: Array) -> Array:
        """Values in SI units of the robot's own parameters at logarithms (own,) over the priors' middles."""
        return np.array([p.at(log) for p, log in zip(self.parameters, logarithms.tolist(), strict=True)])

    def coordinates(self, values: Sequence[float] | Array, extended: Array | None = None) -> Array:
        """Coordinates (p,) at values of the robot's own parameters, and the effects' coordinates `extended` (0)."""
        own = len(self.parameters)
        raised = np.asarray(values, float) + np.array([p.offset for p in self.parameters])
        middles = np.array([p.middle for p in self.parameters])
        mine = np.linalg.solve(self.mixing[:own, :own], np.log(raised / middles))
        rest = np.zeros(len(self) - own) if extended is None else extended
        return np.concatenate([mine, rest])

    @property
    def places(self) -> list[slice]:
        """Where the coordinates of each effect stand among all."""
        ends = np.cumsum([len(self.parameters), *(len(extension) for extension in self.extensions)]).tolist()
        return [slice(a, b) for a, b in zip(ends, ends[1:], strict=False)]

    @property
    def beside_soil(self) -> list[slice]:
        """Where the coordinates of what is no soil stand: of each other parameter of the robot, and of each effect."""
        own = [slice(i, i + 1) for i, p in enumerate(self.parameters) if not p.key.startswith("contact.")]
        return own + self.places

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
            if self.jump is None:
                clipped[j] = min(clipped[j], clipped[i])
            else:
                clipped[j] = np.clip(clipped[j], low[i] / self.jump, high[i] / self.jump)
        if self.jump is not None and i is not None:
            clipped[i] = self.jump * self._mu_d(clipped)
        parts = self.extended(coordinates)
        nearest = [extension.nearest(part) for extension, part in zip(self.extensions, parts, strict=True)]
        unchanged = (clipped == values).all() and all((a == b).all() for a, b in zip(nearest, parts, strict=True))
        if unchanged and (self.jump is None or i is None):
            return coordinates
        return self.coordinates(clipped, np.concatenate([np.empty(0), *nearest]))

    def along_ridge(self, values: Array, extension: Extension, before: Array, after: Array) -> Array:
        """The robot's own `values` where an effect's coordinates change along the ridge that it declares.

        See `Search.ridge`: soil that hides most of the change.
        """
        search, name = extension.search, next(iter(extension.search.sizes))
        first, last = (float(extension.values(own)[name]) + search.ridge_from for own in (before, after))
        moved = values.copy()
        for key, power in search.ridge.items():
            i = self.index(key)
            if i is not None:
                moved[i] *= (last / first) ** power
        return moved

    def at_bound(self, coordinates: Array) -> list[bool]:
        """Which of the robot's own parameters stand at a bound."""
        values = self.values(coordinates)
        return [
            bool(v <= p.low + 1e-4 * (p.low + p.offset) or v >= p.high - 1e-4 * (p.high + p.offset))
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
        """The robot at some coordinates, for a simulation: where only soil changes, the rest is not checked again.

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
        return unchecked(self.robot, effects, replace(self.robot.contact, **soil))

    @property
    def uniform(self) -> bool:
        """Whether the ground is the same everywhere and in all directions."""
        at_work = [*self.robot.effects, *(extension.id for extension in self.extensions)]
        return all(EFFECTS[name].uniform for name in at_work)

    def robot_with(self, values: Array) -> Robot:
        """The robot with values (p,); what no robot can have together gives way.

        mu_d to a smaller mu_s that is fitted, else mu_s to it; a moment of inertia that is fitted to the sum of the
        other two, which no body exceeds.
        """
        own = [parameter.key for parameter in self.parameters]
        changes = dict(zip(own, np.asarray(values, float).tolist(), strict=True))
        mu_s = changes.get(MU_S, self.robot.contact.mu_s)
        mu_d = changes.get(MU_D, self.robot.contact.mu_d)
        if mu_d > mu_s:
            changes |= {MU_D: mu_s} if MU_S in changes else {MU_S: mu_d}
        for key in (key for key in own if key.endswith(INERTIAS)):
            changes[key] = min(changes[key], sum_of_others(self.robot, key, changes))
        return self.robot.replace(changes)

    def index(self, key: str) -> int | None:
        """Place of a key, None if it is not fitted."""
        return self.keys.index(key) if key in self.keys else None
