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
    )
    low = max(spec.low, spec.above)
    if type(spec.default) is float:
        descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=spec.high, step=0.0)]
    elif type(spec.default) is int:
        descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=int(spec.high), step=1)]
    value = spec.default if default is None else default
    _take_integers(node, spec)
    try:
        found = node.declare_parameter(spec.name, list(value) if isinstance(value, tuple) else value, descriptor).value
    except (InvalidParameterValueException, InvalidParameterTypeException) as error:
        given = node._parameter_overrides[spec.name].value  # rclpy's errors have it in their prose alone
        raise ArtibotError(f"parameter {spec.name}: found {given!r}, expected {spec.expected}") from error
    return spec.check(found)


def _take_integers(node: Any, spec: Spec) -> None:
    """Make `rate: 50` of a parameter file the number 50.0 that it stands for."""
    given = node._parameter_overrides.get(spec.name)
    if given is not None and type(spec.default) in (float, tuple):
        node._parameter_overrides[spec.name] = _as_floats(given)


def _as_floats(parameter: Any) -> Any:
    """The parameter with its integers as floats."""
    from rclpy.parameter import Parameter

    if parameter.type_ == Parameter.Type.INTEGER:
        return Parameter(parameter.name, Parameter.Type.DOUBLE, float(parameter.value))
    if parameter.type_ == Parameter.Type.INTEGER_ARRAY:
        return Parameter(parameter.name, Parameter.Type.DOUBLE_ARRAY, list(map(float, parameter.value)))
    return parameter


def keep_types(node: Any) -> None:
    """Have `ros2 param set /sim kappa 1` set the number 1.0: a parameter's type is that of its declaration."""
    from rclpy.parameter import Parameter

    numbers = (Parameter.Type.DOUBLE, Parameter.Type.DOUBLE_ARRAY)

    def before(changes: list[Any]) -> list[Any]:
        known = node._parameters
        return [_as_floats(p) if p.name in known and known[p.name].type_ in numbers else p for p in changes]

    node.add_pre_set_parameters_callback(before)


def warn_of_unknown(node: Any, overrides: bool | None = None) -> None:
    """Warn of parameters that were given but that the node has not declared: ROS ignores them in silence.

    Parameters
    ----------
    node : rclpy node
    overrides : bool, optional
        True for ``qos_overrides`` alone, False for all others, for a node whose topics are known only at its end.
    """
    for name, mend in _unknown(node):
        if overrides is None or overrides == name.startswith("qos_overrides."):
            node.get_logger().warning(f"parameter {name} is unknown and ignored; {mend}")


def refuse_unknown(node: Any) -> None:
    """Raise :class:`ArtibotError` for a parameter that was given but that the node has not declared.

    For a node that moves a real rover: a limit that is written wrongly would not hold.
    """
    for name, mend in _unknown(node):
        raise ArtibotError(f"parameter {name}: unknown; {mend}")


def _unknown(node: Any) -> Iterator[tuple[str, str]]:
    """Parameters that were given and not declared, each with the mend; for when all publishers are made."""
    known = [name for name in node._parameters if name != "use_sim_time"]
    for name in node._parameter_overrides:
        if not node.has_parameter(name):
            near = difflib.get_close_matches(name, known, n=1)
            own = sorted(each for each in known if not each.startswith("qos_overrides."))  # those would hide the rest
            all_of_them = f"{node.get_name()} has {', '.join(own)}, and qos_overrides of its topics"
            yield name, f"did you mean {near[0]}?" if near else all_of_them
