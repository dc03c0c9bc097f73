"""Which part of a robot an effect means: its names in a robot of any number of modules.

Effects are written for a pair of modules: the front one, and the back one with the joint ahead of it. In a longer robot
every module behind the front one makes such a pair with it, in which it is called `back`. So nothing in an effect
counts modules: `module_3_right` is `back_right` of the third module's pair, ``joint_2`` is its `joint`, and in all
other pairs an effect that names them is absent.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import lru_cache

_MODULE = re.compile(r"(?:back|module_([3-9]|[1-9]\d+))(?=_|$)")
_JOINT = re.compile(r"joint(?:_([2-9]|[1-9]\d+))?$")


@lru_cache(maxsize=1024)
def of_pair(name: str) -> tuple[str, int]:
    """A part's name in the pair of the module that it is of, and that module's place, counted from 0.

    What is no part of one module behind the front one stays as it is, with 0.
    """
    if found := _MODULE.match(name):
        return f"back{name[found.end() :]}", int(found[1] or 2) - 1
    if found := _JOINT.match(name):
        return "joint", int(found[1] or 1)
    return name, 0


def in_robot(name: str, behind: int) -> str:
    """The reverse: what a part of a pair is called in a robot where the module `behind` is the pair's back one."""
    own, place = of_pair(name)
    if not place or behind == 1:
        return own
    return f"joint_{behind}" if own == "joint" else f"module_{behind + 1}{own.removeprefix('back')}"


def names_of(names: tuple[str, ...], modules: int) -> tuple[str, ...]:
    """Names of a pair's parts, and of the parts alike of a robot of so many modules."""
    behind = [name for name in names if of_pair(name)[1]]
    return names + tuple(in_robot(name, i) for i in range(2, modules) for name in behind)


def for_pair(values: Mapping[str, float | str], behind: int) -> dict[str, float | str] | None:
    """An effect's parameters as the pair of the module `behind` has them; None where it is one of another module."""
    found: dict[str, float | str] = {}
    for key, value in values.items():
        name, place = of_pair(key)
        if place not in (0, behind):
            continue
        if isinstance(value, str):
            value, place = of_pair(value)
            if place not in (0, behind):
                return None
        found[name] = value
    return found
