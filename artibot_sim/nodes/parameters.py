"""Parameters of nodes as tables: name, default, meaning and range in one place, and their declaration with rclpy."""

from __future__ import annotations

import math
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

    def _is_number(self, value: Any, kinds: tuple[type, ...]) -> bool:
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
        return f"{'an integer' if isinstance(self.default, int) else 'a number'}, {low}, at most {self.high:g}"


def declare(node: Any, spec: Spec, default: Value | None = None) -> Value:
    """Declare one parameter with its descriptor on an rclpy node and return its checked value.

    Raises
    ------
    ArtibotError
        When the value given at the start is refused.
    """
    from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
    from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException

    descriptor = ParameterDescriptor(
        description=spec.doc,
        additional_constraints=spec.expected,
        read_only=not spec.live,
        dynamic_typing=type(spec.default) is float,  # so that `rate: 50` is taken; Spec.check has the last word
    )
    low = max(spec.low, spec.above)
    if type(spec.default) is float:
        descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=spec.high, step=0.0)]
    elif type(spec.default) is int:
        descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=int(spec.high), step=1)]
    value = spec.default if default is None else default
    try:
        found = node.declare_parameter(spec.name, list(value) if isinstance(value, tuple) else value, descriptor).value
    except (InvalidParameterValueException, InvalidParameterTypeException) as error:
        reason = " ".join(str(error).split())
        raise ArtibotError(f"parameter {spec.name}: {reason}; expected {spec.expected}") from error
    return spec.check(found)
