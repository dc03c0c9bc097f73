"""What the nodes that have a loop of their own do alike: their command's `main`, running, and their statistics."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol

import click

from artibot_sim.nodes.output import never_held_up
from artibot_sim.nodes.process import Destructible, destroyed, ros_process, split_ros_args


class LoopNode(Destructible, Protocol):
    """An rclpy node whose ``run`` paces itself."""

    settings: dict[str, Any]

    def run(self, executor: Any) -> int:
        """Run to the end; return the exit status."""

    def finish(self) -> None:
        """Leave nothing open, however the run ended."""

    def statistics(self) -> dict[str, Any]:
        """How late the loop was, and more."""

    def get_logger(self) -> Any:
        """Return the node's logger."""


def node_main(command: click.Command, word: str, argv: Sequence[str] | None = None) -> int:
    """Run a node's command line `argv` (by default the process's own), the part for ROS apart; return its status."""
    own, ros_args = split_ros_args(sys.argv[1:] if argv is None else argv)
    return int(command.main(args=own, prog_name=f"artibot {word}", standalone_mode=False, obj=ros_args) or 0)


def run_loop(name: str, ros_args: Sequence[str], make: Callable[[list[int]], LoopNode]) -> int:
    """Make a node and run it until it ends; write its statistics where ``stats`` says, and log them in a line.

    Parameters
    ----------
    name : str
        In place of the program's name.
    make : callable
        Makes the node, given a list that grows by each SIGINT and SIGTERM.

    Returns
    -------
    int
        The exit status.

    Raises
    ------
    ArtibotError
        When a parameter, or what it names, is refused.
    """
    with ros_process(name, ros_args) as asked:
        from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor

        from artibot_sim.nodes.pacer import write_statistics

        with destroyed(make(asked)) as node, never_held_up():
            executor = SingleThreadedExecutor()
            executor.add_node(node)
            try:
                status = node.run(executor)
            except ExternalShutdownException:
                status = 0
            finally:
                node.finish()
                executor.shutdown()
            statistics = node.statistics()
            if node.settings["stats"]:
                write_statistics(Path(node.settings["stats"]), statistics)
            node.get_logger().info(summary(statistics))
            return status


def summary(statistics: dict[str, Any]) -> str:
    """One line for the log."""
    text = (
        "{steps} periods in {wall_s:.1f} s ({achieved_rate:.2f} x real time), {cpu:.1f} % of a core, out "
        "{late_p50_ms:.2f} ms after the deadline (median; p99 {late_p99_ms:.2f}, most {late_max_ms:.1f}), "
        "{overruns} overruns"
    ).format(cpu=100 * statistics["cpu_share"], **statistics)
    if "callback_wall_max_ms" in statistics:
        text += ", callbacks of {callback_wall_max_ms:.2f} ms at most".format(**statistics)
    return text
