"""Parameters of nodes as tables: name, default, meaning and range in one place, whether ROS reads them or a file.

Not `generate_parameter_library`: PyPI does not have it, and what it writes needs rclpy, where these tables also stand
behind commands' options and files that are checked without ROS.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Container, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from artibot_sim.errors import ArtibotError

Value = bool | int | float | str | tuple[float, ...]


@dataclass(frozen=True)
class Spec:
    """One parameter.

    Attributes
    ----------
    default : value
        Its type is the parameter's; for a float an integer is taken too (``rate: 50``).
    low, high : float
        Bounds of a number, both allowed; `above` is a bound that is not.
    choices : tuple of str
        What a text may be; empty: anything.
    live : bool
        Whether it can be set while the node runs.
    """

    name: str
    default: Value
    doc: str
    low: float = -math.inf
    high: float = math.inf
    above: float = -math.inf
    choices: tuple[str, ...] = ()
    live: bool = False

    def check(self, value: Any) -> Value:
        """The value in the parameter's type.

        Raises
        ------
        ArtibotError
            With the parameter's name, what was found and what is expected.
        """
        if isinstance(self.default, tuple):
            given = list(value) if isinstance(value, (list, tuple)) or hasattr(value, "typecode") else []
            if len(given) != len(self.default) or not all(self._is_number(part, (int, float)) for part in given):
                raise ArtibotError(f"parameter {self.name}: found {value!r}, expected {self.expected}")
            return tuple(float(part) for part in given)
        kind = type(self.default)
        fits = isinstance(value, kind)
        if kind in (int, float):
            fits = self._is_number(value, (int, float) if kind is float else (int,))
        if not fits or (self.choices and value not in self.choices):
            raise ArtibotError(f"parameter {self.name}: found {value!r}, expected {self.expected}")
        return kind(value)

    def _is_number(self, value: Any, kinds: tuple[type[float], ...]) -> bool:
        return (
            isinstance(value, kinds)
            and not isinstance(value, bool)
            and self.low <= value <= self.high
            and value > self.above
        )

    @property
    def expected(self) -> str:
        """What a value must be, for a message or a descriptor."""
        if self.choices:
            return "one of " + ", ".join(self.choices)
        if isinstance(self.default, (bool, str)):
            return "true or false" if isinstance(self.default, bool) else "a text"
        low = f"more than {self.above:g}" if self.above > -math.inf else f"at least {self.low:g}"
        if isinstance(self.default, tuple):
            return f"{len(self.default)} numbers, each {low}, at most {self.high:g}"
        if isinstance(self.default, int):
            return f"an integer, {low}, at most {self.high:.10g}"
        return f"a number, {low}, at most {self.high:g}"


def as_yaml(specs: Iterable[Spec], header: Sequence[str], left_out: Container[str] = ()) -> str:
    """All parameters at their defaults as a ROS 2 parameter file with a comment each.

    Parameters
    ----------
    header : sequence of str
        Lines of comment at the top.
    left_out : names
        Parameters that stand there as a comment only.
    """
    lines = [*(f"# {line}" for line in header), "/**:", "  ros__parameters:"]
    for spec in specs:
        note = f"{spec.doc} Expected: {spec.expected}." + (" Can be set while running." if spec.live else "")
        lines += [f"    # {line}" for line in textwrap.wrap(note, 110)]
        mark = "# " if spec.name in left_out else ""
        lines.append(f"    {mark}{spec.name}: {_as_yaml(spec.default)}")
    return "\n".join(lines) + "\n"


def _as_yaml(value: Value) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(map(repr, value))}]"
    if isinstance(value, bool):
        return "true" if value else "false"
    return f'"{value}"' if isinstance(value, str) else repr(value)
