"""Publishers and subscriptions of the nodes: quality of service, and its overrides by parameters."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.exceptions import InvalidParameterTypeException
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions

from artibot_sim.errors import ArtibotError

QUIET = PublisherEventCallbacks(use_default_callbacks=False)
"""No event handlers for publishers: two each would make every wait of the executor twice as long."""

PUBLISHED = QoSProfile(depth=10)
"""For everything that is published: reliable, which serves reliable subscribers and best-effort ones."""

LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""For what late subscribers need: the last message is sent to them."""


class Polled(CallbackGroup):
    """For subscriptions whose messages are taken by hand: an executor leaves them alone."""

    def can_execute(self, entity: Any) -> bool:
        """Never."""
        return False

    def beginning_execution(self, entity: Any) -> bool:
        """Never."""
        return False

    def ending_execution(self, entity: Any) -> None:
        """Nothing was begun."""


def publisher(node: Node, kind: type, topic: str, qos: QoSProfile = PUBLISHED) -> Any:
    """Make a publisher whose history, depth and reliability parameters ``qos_overrides.<topic>.publisher.*`` override.

    Raises
    ------
    ArtibotError
        When an override is refused.
    """
    return _overridable(
        node.create_publisher, kind, topic, copy(qos),
        event_callbacks=QUIET, qos_overriding_options=QoSOverridingOptions.with_default_policies(),
    )  # fmt: skip


def subscription(
    node: Node, kind: type, topic: str, callback: Callable[..., None], qos: QoSProfile, *, raw: bool = False,
    group: CallbackGroup | None = None, anew: bool = False,
) -> Any:  # fmt: skip
    """Make a subscription; ``qos_overrides.<topic>.subscription.*`` override it. Errors are those of `publisher`.

    `anew` is for one that is made again with another quality of service: what nobody overrides is not declared then,
    for a declared parameter stays what it was at first.
    """
    overrides = QoSOverridingOptions.with_default_policies()
    if anew:
        beginning = f"qos_overrides.{node.resolve_topic_name(topic)}.subscription."
        given = [each for each in overrides.policy_kinds if _is_given(node, f"{beginning}{each.name.lower()}")]
        overrides = QoSOverridingOptions(policy_kinds=given)
    return _overridable(
        node.create_subscription, kind, topic, callback, copy(qos),
        raw=raw, callback_group=group, qos_overriding_options=overrides,
    )  # fmt: skip


def _is_given(node: Node, name: str) -> bool:
    """Whether a parameter that is declared only where it was given has a value; it is declared no more than before."""
    if node.has_parameter(name):
        return True
    given = node.declare_parameter(name, descriptor=ParameterDescriptor(dynamic_typing=True))
    node.undeclare_parameter(name)
    return given.type_ is not Parameter.Type.NOT_SET


def _overridable(make: Callable[..., Any], kind: type, topic: str, *args: Any, **options: Any) -> Any:
    try:
        return make(kind, topic, *args, **options)
    except (RuntimeError, InvalidParameterTypeException) as error:  # rclpy's own words for a value that is none
        raise ArtibotError(
            f"qos_overrides of {topic}: {error}; expected history keep_last or keep_all, an integer depth, reliability "
            "reliable or best_effort"
        ) from error
