"""What every node's process does alike: arguments for ROS, signals, rclpy's beginning and end."""

from __future__ import annotations

import signal
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from artibot_sim.nodes.ros_args import split_ros_args

__all__ = ["ros_process", "split_ros_args"]


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
    """
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    asked: list[int] = []
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = {number: signal.signal(number, lambda n, _frame: asked.append(n)) for number in numbers}
    try:
        rclpy.init(args=[name, *ros_args], signal_handler_options=SignalHandlerOptions.NO)
        yield asked
    finally:
        rclpy.try_shutdown()
        for number, handler in before.items():
            signal.signal(number, handler)
