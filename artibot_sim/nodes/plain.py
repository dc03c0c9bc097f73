"""Simulator and planner as processes that need ROS and the compiled model alone: nothing here reads a command line.

Their commands call these functions, and so does ``artibot`` where click is missing, with ROS's arguments alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from artibot_sim.nodes.common.process import LoopNode, built, run_events, run_loop

Overrides = dict[str, Any]
"""Parameters of a node by name; they win over those in the arguments for ROS, which come with their markers."""


def run_sim(overrides: Overrides, ros_args: Sequence[str] = ()) -> int:
    """Run the simulator until it ends; return the exit status: 0, or 1 when the model diverged.

    SIGINT and SIGTERM end it with status 0.

    Raises
    ------
    ArtibotError
        When a parameter or the robot file is refused.
    """

    def make(asked: list[int]) -> LoopNode:
        from artibot_sim.nodes.sim.node import SimNode

        return built(SimNode, overrides, asked)

    return run_loop("sim", ros_args, make)


def run_planner(overrides: Overrides, ros_args: Sequence[str] = ()) -> int:
    """Run the planner until it ends; return the exit status.

    0 after the profile's end, 1 when /clock was lost, 128 and the signal's number when SIGINT or SIGTERM came before
    the end.

    Raises
    ------
    ArtibotError
        When a parameter, robot or manoeuvre is refused, or nobody listens.
    """

    def make(asked: list[int]) -> Any:
        from artibot_sim.nodes.planner.node import PlannerNode

        return built(PlannerNode, overrides, asked)

    return run_events("planner", ros_args, make)
