"""What every node's process does alike: arguments for ROS, signals, rclpy's beginning and end."""

from __future__ import annotations

import gc
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Protocol, TypeVar

from artibot_driver.priority import drop_priority, take_priority
from artibot_sim.errors import ArtibotError
from artibot_sim.nodes.ros_args import split_ros_args

__all__ = ["asked_to_end", "built", "destroyed", "ros_process", "split_ros_args", "undisturbed"]

_SWITCH = 5e-4  # s: a thread hands over to the one that waits after so long; Python's own 5 ms are too many


class Destructible(Protocol):
    """An rclpy node."""

    def destroy_node(self) -> None:
        """Give back all that it has."""


Node = TypeVar("Node", bound=Destructible)


@contextmanager
def undisturbed(priority: int = 0) -> Iterator[None]:
    """No garbage collection and short turns of other threads: both delay messages.

    Parameters
    ----------
    priority : int
        Of this thread among the machine's real-time ones meanwhile, where the system grants it; 0: none.
    """
    take_priority(priority)
    before = sys.getswitchinterval()
    sys.setswitchinterval(_SWITCH)
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
        gc.unfreeze()
        sys.setswitchinterval(before)
        if priority:
            drop_priority()


@contextmanager
def asked_to_end() -> Iterator[list[int]]:
    """Take SIGINT and SIGTERM as a wish: yields a list that grows by the number of each, for a loop to look at."""
    asked: list[int] = []
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = {number: signal.signal(number, lambda n, _frame: asked.append(n)) for number in numbers}
    try:
        yield asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def ros_process(name: str, ros_args: Sequence[str]) -> Iterator[list[int]]:
    """Initialise rclpy, and shut it down at the end.

    Parameters
    ----------
    name : str
        What takes the place of the program's name in the arguments.
    ros_args : sequence of str
        Arguments for rclpy, markers included.

    Yields
    ------
    list of int
        Grows by the number of each SIGINT and SIGTERM: the node's loop looks at it and ends in good order, which
        rclpy's own handlers, that shut down the context at once, do not allow.

    Raises
    ------
    ArtibotError
        When ROS refuses an argument, or a name that was given with one.
    """
    import rclpy
    from rclpy.exceptions import NameValidationException
    from rclpy.signals import SignalHandlerOptions

    with asked_to_end() as asked:
        try:
            with _clear_refusals():
                rclpy.init(args=[name, *ros_args], signal_handler_options=SignalHandlerOptions.NO)
            yield asked
        except NameValidationException as error:
            reason = " ".join(str(error).split())
            raise ArtibotError(f"--ros-args: {reason}; expected a name such as /rover1/odom") from error
        finally:
            rclpy.try_shutdown()


def built(kind: Callable[..., Node], *args: object) -> Node:
    """Make a node; one that refuses a parameter half-way is destroyed before the refusal goes on.

    By then it is a participant of the middleware, and nobody else has it to destroy it. Left behind it does what
    :func:`destroyed` says: the process has given its refusal, and now and then ends with SIGABRT ("corrupted …").
    """
    assert isinstance(kind, type)
    node: Node = kind.__new__(kind)
    try:
        node.__init__(*args)  # type: ignore[misc]
    except BaseException:
        with suppress(AttributeError):  # not even begun
            node.destroy_node()
        raise
    return node


@contextmanager
def destroyed(node: Node) -> Iterator[Node]:
    """A node that is there to the end of this, and no longer.

    One that the process leaves behind keeps the threads of its middleware, and they go on in memory that is being given
    back: now and then such a process ends with SIGSEGV or SIGABRT instead of its status.
    """
    try:
        yield node
    finally:
        node.destroy_node()


@contextmanager
def _clear_refusals() -> Iterator[None]:
    """Turn what rclpy raises for arguments that it cannot read into one line."""
    from rclpy.impl.implementation_singleton import rclpy_implementation as implementation

    try:
        yield
    except implementation.UnknownROSArgsError as error:
        raise ArtibotError(
            f"--ros-args: unknown: {error}; expected -p NAME:=VALUE, -r FROM:=TO, --params-file FILE …; "
            "`--` ends them, before options of artibot"
        ) from error
    except (implementation.RCLInvalidROSArgsError, implementation.RCLError) as error:
        reason = str(error).removeprefix("failed to initialize rcl: ").partition(", at /")[0]
        raise ArtibotError(f"--ros-args: {reason}") from error
