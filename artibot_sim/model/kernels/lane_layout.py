"""Where a block of rovers side by side (`kernels.lanes`) holds what, effects' parameters included."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np
from numba.core import cgutils, types
from numba.extending import intrinsic
from numpy.typing import NDArray

from artibot_sim.model.effects import EFFECTS, RECORD_DTYPE, at_work
from artibot_sim.model.effects.base import Effect, Values
from artibot_sim.model.effects.force_law import FORCES
from artibot_sim.model.effects.hooks import PLACES
from artibot_sim.model.equations.plane import Body, CommonTerms
from artibot_sim.model.kernels.compilation import inlined
from artibot_sim.model.kernels.layout import MEMORY

# ----------------------------------------------------------------------
# Effects' parameters of one lane (`lanes`), under the names by which hooks ask for them.
# ----------------------------------------------------------------------


EFFECT_VALUES = RECORD_DTYPE.itemsize // np.dtype(np.float64).itemsize
"""How many numbers a record of effects holds; the first is the time."""


def flat(record: Any) -> NDArray[np.float64]:
    """Records of effects as rows of numbers, shape (n, EFFECT_VALUES)."""
    values: NDArray[np.float64] = np.ascontiguousarray(record).view(np.float64).reshape(-1, EFFECT_VALUES)
    return values


VERSIONS: tuple[frozenset[str], ...] = tuple(
    frozenset({"", *kinds.split()})
    for kinds in (
        "motor", "resistance", "speed", "resistance speed", "slip", "resistance slip", "resistance seldom motor",
        "resistance transfer", "resistance windup", "resistance speed seldom slip motor",
        "resistance speed seldom slip motor windup bristles",
        "resistance speed seldom slip motor windup bristles transfer",
    )
)  # fmt: skip
"""Which kinds of places (`effects.hooks.Place`) are asked by each version of the extended model.

A version is compiled when a rover first needs it. A diagnosis tries one effect after the other, so each kind that takes
much has a version to itself and costs the others nothing. What motors ask costs windows 2 %: less than the 5 s that a
version takes to compile are worth, so what acts on bodies alone has none of its own.
"""

EXTENDED: tuple[tuple[float, ...], ...] = tuple((1.0,) * (k + 1) for k in range(len(VERSIONS)))
"""Stand for the versions as `fx` of lanes: the compiler knows their lengths."""


def _asking(*kinds: str) -> tuple[bool, ...]:
    """Which of EXTENDED, by their lengths, ask places of any of these kinds; the compiler knows what it finds there."""
    return (False, *(not asked.isdisjoint(kinds) for asked in VERSIONS))


LIMITED = _asking("motor")
"""Motors may have gears that take a torque of their own, limits, and velocity loops."""

LAGGING = _asking("slip", "transfer", "windup", "bristles")
"""Normal forces may move, or lateral forces lag."""

TRANSFERRING = _asking("transfer")
"""Normal forces may move as the rover does."""

WOUND, BRISTLED = _asking("windup", "bristles"), _asking("bristles")
"""Wheels may wind up, and have bristles: they remember more."""


def _kinds(effect: Effect) -> set[str]:
    """Of the places where an effect acts."""
    return {PLACES[hook].kind for hook in effect.hooks}


def extension(effects: Mapping[str, Values]) -> tuple[float, ...] | None:
    """What of the model a robot's effects need: None, or the first of EXTENDED that asks all of them."""
    kinds: set[str] = set().union(*(_kinds(effect) for effect, _ in at_work(effects).values()))
    return next(EXTENDED[k] for k, asked in enumerate(VERSIONS) if kinds <= asked) if kinds else None


def _numbers(name: str) -> Any:
    """Named tuple of an effect's parameters, which is found again by its name."""
    kind = namedtuple(name, EFFECTS[name].parameters, module=__name__)  # type: ignore[misc]  # mypy wants a list
    kind.__qualname__ = f"Numbers.{name}"
    return kind


_NAMES: tuple[str, ...] = RECORD_DTYPE.names or ()
Effects: Any = namedtuple("Effects", _NAMES)  # type: ignore[misc]  # as above
Numbers = SimpleNamespace(**{name: _numbers(name) for name in _NAMES[1:]})
"""Of all versions of a loop the same: the pieces that read them are then compiled once."""


# ----------------------------------------------------------------------
# Where a block of rovers holds what: see `lanes`.
# ----------------------------------------------------------------------


LANES = 8
"""Rovers in a block."""

SIZE = 10
"""Coordinates that move on a plane: x, y, gamma of the front module, of the back one, and the motors' angles."""

MOTORS = 6 * LANES
"""Where the motors begin among them."""

_SIZES = {
    # state; stage, first accelerations and sums of them of RK4; the same of what wheels remember (see `layout.MEMORY`)
    "Q": SIZE, "V": SIZE, "ACC": SIZE, "Q_S": SIZE, "V_S": SIZE, "FIRST": SIZE, "SUM": SIZE,
    "LAG": MEMORY, "LAG_S": MEMORY, "LAG_RATE": MEMORY, "SUM_LAG": MEMORY,
    # yaws of both modules when their sines and cosines were last taken, and these
    "FACING": 2, "SINE": 2, "COSINE": 2,
    # commands: angles and speeds at both ends of a cubic, its last coefficients; the inverse of its length, 0 after
    # the last one
    "P_0": 4, "V_0": 4, "P_1": 4, "V_1": 4, "C_2": 4, "C_3": 4, "GOING": 4,
    # commanded torque (NaN: eq. 30), eq. 30's factor of the front motors' sum; held through a step: torque (NaN:
    # whatever it takes to follow the command), gear ratio over efficiency, inertia and its inverse
    "GIVEN": 4, "SHARE": 1, "HELD": 4, "GEARED": 4, "INERTIA": 4, "INV_J": 4,
    # motors: speed of their wheels' rims, the sign of rolling resistance, of both wheels F_l at the rims and u F_n,
    # drag, between what torques stay, torque now and a step before, inverse efficiency; the wheels' load on a motor,
    # whether its gear holds it at rest, and its inverse efficiency then; factors of speed and angle behind the
    # command; the lever of F_l, and whether rolling resistance is beside it
    "RIM": 4, "SIGN": 4, "AT_RIM": 4, "U_F_N": 4, "DRAG": 4, "LOW": 4, "HIGH": 4, "TORQUE": 4, "PREVIOUS": 4, "GEAR": 4,
    "LOAD": 4, "STANDS": 4, "BETWEEN": 4,
    "MODE": 4, "TAU": 4, "R_W": 4, "J_M": 4, "J_W": 4, "DRIVING": 4, "BRAKING": 4, "TORQUE_MAX": 4,
    "DAMPING": 4, "STIFFNESS": 4, "LEVER": 4, "ROLLS": 4,
    # velocity loops: error of the speed, angle behind the command at the stage and at the step's start, its integral
    "ERROR": 4, "TRAIL_S": 4, "TRAIL": 4, "BEHIND": 4,
    "BODY_F": len(Body._fields), "BODY_B": len(Body._fields), "GROUND": len(CommonTerms._fields),
    # whether a coordinate is sound, and in how many rows it was
    "SOUND": SIZE, "KEPT": SIZE,
    # parameters of effects; row of the robot's laws, and `force_law.LawForces` at the stage
    "EFFECTS": EFFECT_VALUES, "LAWS": 1, "LAW_FORCES": FORCES,
}  # fmt: skip


def beginnings(sizes: Mapping[str, int]) -> Any:
    """Where each of some quantities of these sizes begins, for LANES rovers, as they stand one after the other."""
    ends = LANES * np.cumsum(list(sizes.values()))
    begin = [0, *ends[:-1].tolist()]
    return namedtuple("At", list(sizes))(*begin)


AT = beginnings(_SIZES)
"""Where each quantity begins in a block."""

BLOCK = LANES * sum(_SIZES.values())
"""Size of a block."""

LIMIT_V, LIMIT_Q = 1e6, 1e12
"""Beyond, a rover has diverged, as in `loop`."""


def aligned(size: int) -> NDArray[np.float64]:
    """So many zeros that begin where a line of the cache does: else each access to eight numbers is to two lines."""
    line = 64
    room = np.zeros(size + line // 8)
    first = -room.ctypes.data % line // 8
    return room[first : first + size]


_NUMBERS = {
    name: types.NamedUniTuple(types.float64, len(EFFECTS[name].parameters), getattr(Numbers, name))
    for name in _NAMES[1:]
}
_EFFECTS = types.NamedTuple((types.float64, *_NUMBERS.values()), Effects)


def _lane_effects(typing_context: Any, fx: Any, S: Any, at: Any, t: Any) -> Any:
    """What `effects.record` would be for the lane whose effects begin at `at`, as named tuples that hooks read.

    The compiler leaves out all that they do not read, and all that comes of effects which are neutral here because they
    act in places of other kinds than the version of `fx` asks. Compiled code cannot go through names, so it is put
    together where it is compiled.
    """
    asked = VERSIONS[len(fx) - 1]

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        _, block, first, now = arguments
        begin = context.make_array(S)(context, builder, block).data

        def number(place: int) -> Any:
            index = builder.add(first, context.get_constant(types.intp, place * LANES))
            return builder.load(builder.gep(begin, [index]))

        values, place = [now], 1
        for name, kind in _NUMBERS.items():
            parameters = EFFECTS[name].parameters.values()
            if _kinds(EFFECTS[name]) <= asked:
                numbers = [number(place + k) for k in range(len(parameters))]
            else:
                neutral = (parameter.number(parameter.neutral) for parameter in parameters)
                numbers = [context.get_constant(types.float64, value) for value in neutral]
            values.append(context.make_tuple(builder, kind, numbers))
            place += len(parameters)
        return context.make_tuple(builder, _EFFECTS, values)

    return _EFFECTS(fx, S, types.intp, types.float64), generate


lane_effects: Any = intrinsic(_lane_effects)

LawEffects: Any = namedtuple("LawEffects", [*_NAMES, "laws", "motion"])  # type: ignore[misc]  # as above
ForceEffects: Any = namedtuple("ForceEffects", [*_NAMES, "law_forces"])  # type: ignore[misc]  # as above


def _with_laws(typing_context: Any, effects: Any, laws: Any, motion: Any) -> Any:
    """Effects of a lane together with its three laws, and the motion that these follow."""
    return _together(LawEffects, effects, laws, motion)


def _with_forces(typing_context: Any, effects: Any, forces: Any) -> Any:
    """Effects of a lane together with what its laws do (`force_law.LawForces`)."""
    return _together(ForceEffects, effects, forces)


def _together(kind: Any, effects: Any, *more: Any) -> Any:
    both = types.NamedTuple((*effects.types, *more), kind)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        values = cgutils.unpack_tuple(builder, arguments[0])
        return context.make_tuple(builder, both, [*values, *arguments[1:]])

    return both(effects, *more), generate


with_laws: Any = intrinsic(_with_laws)
with_forces: Any = intrinsic(_with_forces)


@inlined
def effects_at(S, fx, e, t):
    """With effects: those of a lane at `t` (s) since its start."""
    if fx is not None:
        at = AT.EFFECTS + e
        return lane_effects(fx, S, at, S[at] + t)
    return None


@inlined
def four(S, at):
    """Four numbers of a lane."""
    return S[at], S[at + LANES], S[at + 2 * LANES], S[at + 3 * LANES]


@inlined
def put4(S, at, a, b, c, d):
    """Write four numbers of a lane."""
    S[at], S[at + LANES], S[at + 2 * LANES], S[at + 3 * LANES] = a, b, c, d
