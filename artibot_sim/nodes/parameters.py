"""Declaration of a table's parameters with rclpy."""

from __future__ import annotations

import difflib
from collections.abc import Iterator
from typing import Any

from artibot_sim.errors import ArtibotError
from artibot_sim.parameters import Spec, Value


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
        given = node._parameter_overrides[spec.name].value  # rclpy's errors have it in their prose alone
        raise ArtibotError(f"parameter {spec.name}: found {given!r}, expected {spec.expected}") from error
    return spec.check(found)


def warn_of_unknown(node: Any) -> None:
    """Warn of parameters that were given but that the node has not declared: ROS ignores them in silence."""
    for name, mend in _unknown(node):
        node.get_logger().warning(f"parameter {name} is unknown and ignored; {mend}")


def refuse_unknown(node: Any) -> None:
    """Raise :class:`ArtibotError` for a parameter that was given but that the node has not declared.

    For a node that moves a real rover: a limit that is written wrongly would not hold.
    """
    for name, mend in _unknown(node):
        raise ArtibotError(f"parameter {name}: unknown; {mend}")


def _unknown(node: Any) -> Iterator[tuple[str, str]]:
    """Parameters that were given and not declared, each with the mend."""
    known = [name for name in node._parameters if name != "use_sim_time"]
    for name in node._parameter_overrides:
        if not node.has_parameter(name) and not name.startswith("qos_overrides."):
            near = difflib.get_close_matches(name, known, n=1)
            yield name, f"did you mean {near[0]}?" if near else f"{node.get_name()} has {', '.join(sorted(known))}"
