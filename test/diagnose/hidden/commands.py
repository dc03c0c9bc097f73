"""What is left of the front motors' speeds against their commands, with nothing hidden and with effects: their limits.

``PYTHONPATH=.:test python -m diagnose.hidden.commands [CASES]`` prints it, so many cases of each kind (2).
"""

from __future__ import annotations

import sys
from dataclasses import replace
from math import nan

import numpy as np
from diagnose.hidden.cases import case

from artibot_sim.diagnose.commands.data import command_data
from artibot_sim.diagnose.commands.loop import unexplained
from artibot_sim.diagnose.commands.model import CommandResponse, predicted_speeds
from artibot_sim.diagnose.commands.view import command_view
from artibot_sim.diagnose.policy import LEFT_OF_COMMANDS, LEFT_OF_TORQUES, MINOR_COMMANDS, MIXED
from artibot_sim.experiment import Experiment
from artibot_sim.model import load_robot

KINDS = (
    "none", "torque_limit", "battery_sag", "speed_loop_lag", "command_delay", "deadband", "encoder_scale",
    "command_rate_limit", "command_delay+torque_limit", "command_ceiling",
)  # fmt: skip


def left_of_torques(recordings: list[Experiment]) -> float:
    """Share of the front motors' torques that the best velocity loop leaves of them."""
    data = command_data(recordings)
    if data is None:
        return nan
    return float(np.sqrt(unexplained(data, predicted_speeds(data, CommandResponse()) - data.speed)))


def main(cases: str = "2") -> None:
    """Print every case, and the limits that they are for."""
    robot = load_robot("agriq")
    sizes = f"{'left without':>14} {'left with':>12} {'turning':>16} {'no load':>8} {'torques':>8}"
    print(f"{'hidden':28} {'severity':>8} {sizes} found")
    for kind in KINDS:
        for severity in (1.0, 0.3):
            for seed in range(1, int(cases) + 1):
                effects = () if kind == "none" else kind.split("+")
                recordings = case(effects, severity, seed, runs=2, held_out=0, duration=30.0).recordings
                view, torques = command_view(recordings, robot), left_of_torques(recordings)
                told = {effect: dict(view.evidence[effect].values) for effect in view.found}
                sizes = [view.remainder(replace(robot, effects=one)) for one in ({}, told)]
                before, after = ("–" if one is None else f"{one.worst:.2f}" for one in sizes)
                low, high = view.mixing.interval if view.mixing else (nan, nan)
                turning = f"{low:.3f} … {high:.3f}"
                line = view.evidence["battery_sag"].values.get("no_load_speed", nan)  # the steepest, of a level limit
                row = f"{kind:28} {severity:8g} {before:>14} {after:>12} {turning:>16} {line:8.0f} {torques:8.2f}"
                print(f"{row} {told}", flush=True)
    print(f"limits: {float(LEFT_OF_COMMANDS):g}, and {float(MINOR_COMMANDS):g} of what is left without;", end=" ")
    print(f"turning 1 ± {float(MIXED):g}; {float(LEFT_OF_TORQUES):g} of the torques")


if __name__ == "__main__":
    main(*sys.argv[1:])
