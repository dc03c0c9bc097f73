"""A simulation at the instants of its recording: as tables for a bag, and beside the measured values."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from artibot_sim.experiment.columns import Experiment, Floats, Stamps
from artibot_sim.experiment.comparison import Compared
from artibot_sim.experiment.measured import Measured
from artibot_sim.experiment.pieces import Pieces
from artibot_sim.experiment.rollout_bag import Table, rollout_columns
from artibot_sim.model import Robot, Rollout

_SIMULATED: dict[str, Callable[[Rollout], Floats]] = {
    "position": lambda result: result.pose[:, :2],
    "yaw": lambda result: result.pose[:, 2:],
    "yaw_rate": lambda result: result.twist[:, 2:],
    "articulation_yaw": lambda result: result.articulation_yaw[:, None],
    "front_velocity": lambda result: result.motor_velocity[:, :2],
    "torque_front": lambda result: result.motor_torque[:, :2],
    "torque_back": lambda result: result.motor_torque[:, 2:],
}


def tables_of(experiment: Experiment, robot: Robot, pieces: list[Pieces]) -> dict[str, Table]:
    """Return the simulation's channels at the recorded stamps.

    Where no ground truth or no joint states were recorded, theirs are the motors' stamps (and, for the pose, the
    total station's).
    """
    channels = experiment.channels
    motors = channels.get("motor_torques") or channels["motor_command"]
    truth = channels["ground_truth_odom"].t_ns if "ground_truth_odom" in channels else motors.t_ns
    if "ground_truth_odom" not in channels and "total_station" in channels:
        truth = np.union1d(truth, channels["total_station"].t_ns)
    joints = channels.get("joint_states") or motors
    wanted = {"ground_truth_odom": truth, "motor_torques": motors.t_ns, "joint_states": joints.t_ns}
    tables: dict[str, Table] = {}
    for key, stamps in wanted.items():
        t = (stamps - experiment.start_ns) / 1e9
        found = [(part[0], part[1]) for part in (_inside(stamps, t, piece) for piece in pieces) if len(part[0])]
        if not found:
            continue
        columns = [rollout_columns(result, robot)[key] for _, result in found]
        kept = np.concatenate([stamps for stamps, _ in found])
        tables[key] = (kept, {name: np.concatenate([c[name] for c in columns]) for name in columns[0]})
    return tables


def _inside(stamps: Stamps, t: Floats, pieces: Pieces) -> tuple[Stamps, Rollout]:
    rows = np.flatnonzero(pieces.covers(t))
    return stamps[rows], pieces.at(t[rows])


def compare(experiment: Experiment, robot: Robot, pieces: list[Pieces]) -> dict[str, list[Compared]]:
    """Return what was measured and simulated, channel by channel, one part per simulated segment."""
    parts: dict[str, list[Compared]] = {}
    for piece in pieces:
        measured = Measured(experiment, piece.t_start, piece.t_end)
        recorded = {"position": measured.position(), "yaw": measured.yaw(), "yaw_rate": measured.yaw_rate()}
        if robot.articulated:
            recorded["articulation_yaw"] = measured.articulation()
        recorded |= measured.motors(robot.articulated)
        for channel, (t, values) in recorded.items():
            rows = piece.covers(t)
            if rows.any():
                result = piece.at(t[rows])
                parts.setdefault(channel, []).append(Compared(t[rows], values[rows], _SIMULATED[channel](result)))
    return parts
