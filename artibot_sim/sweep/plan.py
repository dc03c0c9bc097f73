"""A sweep as a value: what is varied about what, and the parameters of each run."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from artibot_sim.documents import did_you_mean, load_document
from artibot_sim.errors import ArtibotError
from artibot_sim.model import Robot, load_robot
from artibot_sim.model.robot.file import robot_from_dict, robot_to_dict
from artibot_sim.model.simulate.rollout import INTEGRATORS
from artibot_sim.planning import manoeuvre_from_dict, plan
from artibot_sim.sweep.axes import MANOEUVRE, Axis, Base, Document, Value, axis_from_node, check_value
from artibot_sim.sweep.measures import arcs, names

METHODS = ("grid", "latin")
KNOTS = 0.01
"""Spacing of the planned motor commands, s."""
_WORDS = ("robot", "manoeuvre", "method", "runs", "seed", "dt", "integrator", "sample", "energy", "set", "axes")
_MOST = 1_000_000_000


@dataclass(frozen=True, eq=False)
class SweepPlan:
    """All runs of a sweep; building one checks every key and bound.

    Attributes
    ----------
    base : Base
        Robot and manoeuvres that it departs from.
    axes : tuple of Axis
    fixed : mapping of str to value
        Keys set to the same value in every run.
    method : {"grid", "latin"}
        All combinations of the axes' points, the last axis fastest; or a Latin hypercube.
    runs : int or None
        Size of the hypercube.
    seed : int
        Of the hypercube.
    dt : float, s
    integrator : {"rk4", "semi_implicit"}
    sample : float
        Distance of the rows that measures are taken from, s.
    energy : bool
        Whether energies are accounted for.
    """

    base: Base
    axes: tuple[Axis, ...]
    fixed: Mapping[str, Value] = field(default_factory=dict)
    method: str = "grid"
    runs: int | None = None
    seed: int = 0
    dt: float = 1e-3
    integrator: str = "rk4"
    sample: float = 0.05
    energy: bool = True

    def __post_init__(self) -> None:
        _check_shape(self)
        for axis in self.axes:
            for value in axis.ends:
                check_value(axis.key, value, self.base)
        for key, value in self.fixed.items():
            check_value(key, value, self.base)

    @cached_property
    def count(self) -> int:
        """Number of runs."""
        return int(self.runs or 0) if self.method == "latin" else math.prod(len(axis.points()) for axis in self.axes)

    @property
    def every(self) -> int:
        """Steps between two rows."""
        return round(self.sample / self.dt)

    @cached_property
    def _shares(self) -> NDArray[np.float64]:
        """Points of the hypercube, (count, axes): one in each of `count` slices of every axis."""
        from scipy.stats import qmc  # slow to import, and a grid does without

        return np.asarray(qmc.LatinHypercube(len(self.axes), seed=np.random.default_rng(self.seed)).random(self.count))

    def columns(self, first: int, count: int) -> dict[str, list[Value]]:
        """Values of the axes, by key, for the runs from number `first` on."""
        if self.method == "latin":
            shares = self._shares[first : first + count]
            return {axis.key: axis.at(shares[:, i]) for i, axis in enumerate(self.axes)}
        points = {axis.key: axis.points() for axis in self.axes}
        shape = [len(values) for values in points.values()]
        places = np.unravel_index(np.arange(first, first + count), shape)
        rows = zip(points.items(), places, strict=True)
        return {key: [values[i] for i in place.tolist()] for (key, values), place in rows}

    @cached_property
    def digest(self) -> str:
        """A hash of all that decides on the results, the hypercube's points themselves included."""
        sha = hashlib.sha256(json.dumps(self.as_task(), sort_keys=True).encode())
        sha.update(json.dumps([axis.as_dict() for axis in self.axes]).encode())
        if self.method == "latin":
            sha.update(np.ascontiguousarray(self._shares).tobytes())
        return sha.hexdigest()[:32]

    @cached_property
    def measures(self) -> tuple[str, ...]:
        """Names of the measures that the runs have."""
        robot = self.base.robot
        planned = [plan(manoeuvre_from_dict(node, name), robot) for name, node in self.base.manoeuvres.items()]
        return tuple(names(max(len(arcs(one)) for one in planned), robot.articulated, self.energy))

    def as_task(self) -> dict[str, Any]:
        """What a worker needs beside the runs' own values: plain data, from which :func:`base_of` makes the base."""
        return {
            "robot": robot_to_dict(self.base.robot), "manoeuvres": dict(self.base.manoeuvres),
            "axes": [axis.key for axis in self.axes], "text": [axis.key for axis in self.axes if axis.is_text],
            "fixed": dict(self.fixed), "dt": self.dt, "integrator": self.integrator, "every": self.every,
            "energy": self.energy, "measures": list(self.measures),
        }  # fmt: skip

    def as_dict(self) -> dict[str, Any]:
        """For people: as a plan file has it, names instead of what files hold."""
        size = {"runs": self.runs, "seed": self.seed} if self.method == "latin" else {}
        return {
            "robot": self.base.robot.name, "manoeuvre": list(self.base.manoeuvres), "method": self.method, **size,
            "dt": self.dt, "integrator": self.integrator, "sample": self.sample, "energy": self.energy,
            "set": dict(self.fixed), "axes": {axis.key: axis.as_dict() for axis in self.axes},
        }  # fmt: skip


def base_of(task: Mapping[str, Any]) -> Base:
    """The base of a plan's `as_task`."""
    return Base(robot_from_dict(task["robot"]), task["manoeuvres"])


def plan_from_dict(document: Any) -> SweepPlan:
    """A plan from what a plan file holds.

    Raises
    ------
    ArtibotError
        Beginning with the key's path.
    """
    if not isinstance(document, Mapping):
        raise ArtibotError(f"found {type(document).__name__}, expected a mapping with the key 'axes'")
    for word in document:
        if word not in _WORDS:
            raise ArtibotError(f"{word}: unknown key{did_you_mean(word, _WORDS)}; expected one of {', '.join(_WORDS)}")
    nodes = document.get("axes") or {}
    fixed = document.get("set") or {}
    for name, node in (("axes", nodes), ("set", fixed)):
        if not isinstance(node, Mapping):
            raise ArtibotError(f"{name}: found {node!r}, expected a mapping of keys to values")
    axes = tuple(axis_from_node(str(key), node) for key, node in nodes.items())
    numbers = {
        word: _typed(document[word], kind, word)
        for word, kind in (("runs", int), ("seed", int), ("dt", float), ("sample", float), ("energy", bool))
        if word in document
    }
    texts: dict[str, Any] = {word: str(document[word]) for word in ("method", "integrator") if word in document}
    settings = {str(key): axis_from_node(str(key), node).values for key, node in fixed.items()}
    for key, values in settings.items():
        if len(values) != 1:
            raise ArtibotError(f"set.{key}: expected one value; several belong under 'axes'")
    base = _base(document, axes, {key: values[0] for key, values in settings.items()})
    return SweepPlan(base, axes, {key: values[0] for key, values in settings.items()}, **texts, **numbers)


def load_plan(path: str, extra: Mapping[str, Any] | None = None) -> SweepPlan:
    """Read a plan file; `extra` goes over its keys, `axes` and `set` entry by entry."""
    return load_document("sweeps", path, "sweep", lambda document, _: plan_from_dict(merged(document, extra or {})))


def merged(document: Any, extra: Mapping[str, Any]) -> Any:
    """A plan's document with other keys over it."""
    if not isinstance(document, Mapping):
        return document
    out = {**document, **extra}
    for name in ("axes", "set"):
        if isinstance(document.get(name), Mapping) and name in extra:
            out[name] = {**document[name], **extra[name]}
    return out


def base_of_document(document: Mapping[str, Any]) -> Base:
    """Robot and manoeuvres of a plan that may lack everything else."""
    return _base(document, (), {})


def _base(document: Mapping[str, Any], axes: Sequence[Axis], fixed: Mapping[str, Value]) -> Base:
    """Robot and manoeuvres: those on an axis, or the one that is set, or the one of the file."""
    robot: Robot = load_robot(str(document.get("robot", "agriq")))
    driven: list[Any] = [document.get("manoeuvre", "table6_agriq")]
    if isinstance(driven[0], list):
        raise ArtibotError("manoeuvre: found a list, expected one; several belong under axes.manoeuvre")
    if MANOEUVRE in fixed:
        driven = [fixed[MANOEUVRE]]
    for axis in axes:
        if axis.key == MANOEUVRE:
            driven = list(axis.values)
    return Base(robot, dict(_manoeuvre(node) for node in driven))


def _manoeuvre(node: Any) -> tuple[str, Document]:
    """Name and content of a manoeuvre: a shipped one's name, a file's path, or the segments themselves."""
    if isinstance(node, Mapping):
        try:
            manoeuvre_from_dict(node, MANOEUVRE)
        except ArtibotError as error:
            raise ArtibotError(f"{MANOEUVRE}.{error}") from error
        return "segments", dict(node)

    def checked(document: Any, name: str) -> Document:
        manoeuvre_from_dict(document, name)
        return dict(document)

    return str(node), load_document("manoeuvres", str(node), "manoeuvre", checked)


def _typed(value: Any, kind: type, word: str) -> Any:
    if kind is float and isinstance(value, int | float) and not isinstance(value, bool) and value > 0:
        return float(value)
    if kind is not float and type(value) is kind:
        return value
    wanted = {int: "a whole number", float: "a number above 0", bool: "true or false"}[kind]
    raise ArtibotError(f"{word}: found {value!r}, expected {wanted}")


def _check_shape(plan: SweepPlan) -> None:
    """Method, sizes and steps."""
    if plan.method not in METHODS:
        raise ArtibotError(f"method: found '{plan.method}'{did_you_mean(plan.method, METHODS)}; expected grid or latin")
    if plan.integrator not in INTEGRATORS:
        raise ArtibotError(f"integrator: '{plan.integrator}'; expected one of {', '.join(INTEGRATORS)}")
    if not plan.axes:
        raise ArtibotError("axes: none; add at least one, such as --axis contact.mu_s=0.4:0.9:6")
    twice = {axis.key for axis in plan.axes} & set(plan.fixed)
    if twice:
        raise ArtibotError(f"{min(twice)}: stands under 'axes' and under 'set'; leave one out")
    if plan.method == "latin" and (plan.runs is None or not 1 <= plan.runs <= _MOST):
        raise ArtibotError(f"runs: found {plan.runs}, expected how many runs the hypercube has (--latin 1000)")
    if plan.method == "latin" and plan.runs != 1 and all(len(set(axis.ends)) == 1 for axis in plan.axes):
        only = ", ".join(f"{axis.key} = {axis.ends[0]}" for axis in plan.axes)
        raise ArtibotError(
            f"axes: all {plan.runs} runs would be the same, no axis has two values ({only}); give one a range, such as "
            "--axis contact.mu_s=0.4:0.9, or leave --latin out"
        )
    if plan.method == "grid" and plan.runs is not None:
        raise ArtibotError("runs: a grid has as many as its points give; leave it out, or say method: latin")
    if plan.method == "grid" and plan.count > _MOST:
        raise ArtibotError(f"axes: {plan.count} combinations, expected at most {_MOST}; take fewer points or --latin")
    for name, long, short in (("dt", KNOTS, plan.dt), ("sample", plan.sample, plan.dt)):
        ratio = long / short
        if round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-6:
            raise ArtibotError(f"{name}: {plan.dt:g} s does not divide {long:g} s; take a dt of 0.001 s, say")
