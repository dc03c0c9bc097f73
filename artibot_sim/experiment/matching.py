"""A simulation at the instants of its recording: as tables for a bag, and beside the measured values."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from artibot_sim.experiment.columns import Experiment, Floats
from artibot_sim.experiment.comparison import Compared
from artibot_sim.experiment.measured import Measured
from artibot_sim.experiment.pieces import Pieces
from artibot_sim.experiment.rollout_bag import Table, rollout_columns
from artibot_sim.model import Robot, Rollout
from artibot_sim.model.param_types import SensorErrors
from artibot_sim.model.sensors import sensor_errors, tracked_point

_SIMULATED: dict[str, Callable[[Rollout, SensorErrors], Floats]] = {
    "position": lambda result, errors: tracked_point(errors, result.pose),
    "yaw": lambda result, errors: result.pose[:, 2:],
    "yaw_rate": lambda result, errors: result.twist[:, 2:] + errors.gyro_bias,
    "articulation_yaw": lambda result, errors: result.articulation_yaw[:, None],
    "front_velocity": lambda result, errors: errors.encoder_scale * result.motor_velocity[:, :2],
    "torque_front": lambda result, errors: errors.torque_scale * result.motor_torque[:, :2],
    "torque_back": lambda result, errors: errors.torque_scale * result.motor_torque[:, 2:],
}
"""What a robot's sensors would record of a rollout, at its rows."""


_ROWS = 20_000
"""Rows that are made of a simulation at a time: what they are made from has hundreds of columns."""


def tables_of(experiment: Experiment, robot: Robot, pieces: list[Pieces]) -> dict[str, Table]:
    """Return the simulation's channels at the recorded stamps, as the robot's sensors would record them.

    Where no ground truth or no joint states were recorded, theirs are the motors' stamps (and, for the pose, the
    total station's). A ground truth is the tracked point where it is what tells the recording's positions; beside a
    total station, which then is that, it is the front module's origin.
    """
    channels, errors = experiment.channels, sensor_errors(robot)
    motors = channels.get("motor_torques") or channels["motor_command"]
    truth = channels["ground_truth_odom"].t_ns if "ground_truth_odom" in channels else motors.t_ns
    if "ground_truth_odom" not in channels and "total_station" in channels:
        truth = np.union1d(truth, channels["total_station"].t_ns)
    joints = channels.get("joint_states") or motors
    wanted = {"ground_truth_odom": truth, "motor_torques": motors.t_ns, "joint_states": joints.t_ns}
    if "total_station" in channels:
        wanted["total_station"] = channels["total_station"].t_ns
    tracked = "total_station" if "total_station" in channels else "ground_truth_odom"
    tables: dict[str, Table] = {}
    for key, stamps in wanted.items():
        t = (stamps - experiment.start_ns) / 1e9
        parts = []
        for piece in pieces:
            delay = errors.delay if key == tracked else 0.0
            rows = np.flatnonzero(piece.covers(t) & piece.covers(t - delay))
            if len(rows):
                parts.append((stamps[rows], _columns(key, piece, t[rows], robot, key == tracked)))
        if not parts:
            continue
        tables[key] = np.concatenate([kept for kept, _ in parts]), _joined([columns for _, columns in parts])
    return tables


def _joined(parts: list[dict[str, Floats]]) -> dict[str, Floats]:
    """Columns one after the other, taken out of `parts` one by one: all of them twice would be hundreds of MB."""
    return {name: np.concatenate([part.pop(name) for part in parts]) for name in list(parts[0])}


def _slices(t: Floats) -> list[Floats]:
    """Times (n,) in parts that fit into memory with all that is made of them."""
    return [t[first : first + _ROWS] for first in range(0, len(t), _ROWS)]


def _columns(key: str, piece: Pieces, t: Floats, robot: Robot, tracked: bool) -> dict[str, Floats]:
    """Return the columns of a channel at times (n,) that are simulated; `tracked` if it tells positions."""
    return _joined([_part_of_columns(key, piece, part, robot, tracked) for part in _slices(t)])


def _part_of_columns(key: str, piece: Pieces, t: Floats, robot: Robot, tracked: bool) -> dict[str, Floats]:
    errors = sensor_errors(robot)
    columns = {} if key == "total_station" else rollout_columns(piece.at(t), robot)[key]
    if tracked:
        late = piece.at(t - errors.delay)
        x, y = tracked_point(errors, late.pose).T
        columns |= {"x": x, "y": y, "z": late["z_f"]}
        columns |= {"yaw": late.pose[:, 2]} if key == "ground_truth_odom" else {}
    return columns


def compare(experiment: Experiment, robot: Robot, pieces: list[Pieces]) -> dict[str, list[Compared]]:
    """Return what was measured and simulated, channel by channel, one part per simulated segment."""
    parts: dict[str, list[Compared]] = {}
    errors = sensor_errors(robot)
    for piece in pieces:
        measured = Measured(experiment, piece.t_start, piece.t_end)
        recorded = {"position": measured.position(), "yaw": measured.yaw(), "yaw_rate": measured.yaw_rate()}
        if robot.articulated:
            recorded["articulation_yaw"] = measured.articulation()
        recorded |= measured.motors(robot.articulated)
        for channel, (t, values) in recorded.items():
            late = channel == "position" or (channel == "yaw" and measured.late_heading)
            at = t - errors.delay if late else t
            rows = piece.covers(t) & piece.covers(at)
            if rows.any():
                simulated = [_SIMULATED[channel](piece.at(part), errors) for part in _slices(at[rows])]
                parts.setdefault(channel, []).append(Compared(t[rows], values[rows], np.concatenate(simulated)))
    return parts
