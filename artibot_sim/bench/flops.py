"""``python -m artibot_sim.bench.flops``, with NUMBA_DISABLE_JIT=1: floating-point operations of one RK4 step.

The model's own loop runs uncompiled on numbers that count what is done with them, so the count follows the code.
"""

from __future__ import annotations

import math
import struct
import sys
from collections import Counter
from types import SimpleNamespace
from typing import Any

import numpy as np

from artibot_sim.model.kernels import elementary

COUNTED: Counter[str] = Counter()
_NAMES = {"add": "+", "sub": "−", "mul": "×", "truediv": "÷"}


class CountingFloat(float):
    """A float that counts its operations."""

    __slots__ = ()


def _counting(name: str, kind: str) -> Any:
    plain = getattr(float, name)

    def operate(self: CountingFloat, other: Any) -> Any:
        result = plain(self, other)
        if result is NotImplemented:
            return result
        COUNTED[kind] += 1
        return CountingFloat(result)

    return operate


for _word, _kind in _NAMES.items():
    for _form in (f"__{_word}__", f"__r{_word}__"):
        setattr(CountingFloat, _form, _counting(_form, _kind))


def _free(name: str) -> Any:
    """Signs cost nothing."""
    plain = getattr(float, name)
    return lambda self: CountingFloat(plain(self))


for _form in ("__neg__", "__abs__", "__pos__"):
    setattr(CountingFloat, _form, _free(_form))


def _function(name: str) -> Any:
    plain = getattr(math, name)

    def call(*values: Any) -> CountingFloat:
        COUNTED[name] += 1
        return CountingFloat(plain(*values))

    return call


def _numbers(array: Any) -> Any:
    """An array of counting numbers."""
    out = np.empty(np.shape(array), dtype=object)
    flat = np.asarray(array, float).ravel().tolist()
    out.ravel()[:] = [CountingFloat(value) for value in flat]
    return out


def _bits_of(number: float) -> int:
    """The bits of a float64, which compiled code takes by an instruction of its own."""
    return int(struct.unpack("<q", struct.pack("<d", number))[0])


def _number_of(bits: int) -> CountingFloat:
    """The float64 that has the last 64 of these bits."""
    return CountingFloat(struct.unpack("<d", struct.pack("<Q", bits % 2**64))[0])


def _patch() -> None:
    """Square roots and the like of the model give counting numbers again."""
    own = SimpleNamespace(**{name: getattr(math, name) for name in dir(math) if not name.startswith("__")})
    for name in ("sqrt", "hypot", "tanh", "sin", "cos", "exp", "atan2"):
        setattr(own, name, _function(name))
    elementary.bits_of, elementary.number_of = _bits_of, _number_of
    for name, module in list(sys.modules.items()):
        if name.startswith("artibot_sim.model") and getattr(module, "math", None) is math:
            module.math = own  # type: ignore[attr-defined]


def operations(steps: int) -> int:
    """Operations of so many RK4 steps in a turn of Table 6's trajectory."""
    from artibot_sim.model import Mode, load_robot
    from artibot_sim.model.equations.transmission import back_torque_factor
    from artibot_sim.model.kernels import loop, plane_loop
    from artibot_sim.model.kernels.layout import Grid, KernelInputs, RowTables, RunState
    from artibot_sim.model.robot.derived import params
    from artibot_sim.model.simulate.state import initial_state
    from artibot_sim.planning import load_manoeuvre, plan

    robot = load_robot("agriq")
    planned = plan(load_manoeuvre("table6_agriq"), robot).commands()
    start, knot = initial_state(robot), 1500  # 15 s: in a turn at cruise speed
    commands = [_numbers(np.nan_to_num(part[knot : knot + 3])) for part in (planned.position, planned.velocity)]
    v = start.v.copy()
    v[[6, 7]] = planned.velocity[knot, :2]
    rows = RowTables(np.empty((2, 16)), np.empty((2, 16)), np.empty((2, loop.ROW)))
    work = loop.Workspace(*map(_numbers, loop.workspace()))
    torque = np.full((3, 4), np.nan)
    modes = np.array([Mode.PRESCRIBED] * 2 + [Mode.TORQUE] * 2, dtype=np.int64)
    q, v, eta, fed = (_numbers(part) for part in (start.q, v, start.eta, start.torque))
    q[[6, 7]] = commands[0][0, :2]
    _patch()
    COUNTED.clear()
    integrate: Any = plane_loop.level_rk4
    position, velocity = commands
    inputs = KernelInputs(modes, position, velocity, _numbers(torque), back_torque_factor(robot, 0.8))
    grid = Grid(1e-3, steps, steps, 10)
    status, _ = integrate(RunState(q, v, eta, fed, np.zeros(4)), params(robot), inputs, grid, work, rows, None)
    assert status == loop.OK, "Agri.q stands level"
    return COUNTED.total()


if __name__ == "__main__":
    print(operations(6) - operations(5))
