"""A simulation as a contract bag, without ROS; the same input gives the same bytes."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment.columns import Floats, Stamps
from artibot_sim.experiment.inputs import recorded_motors, recorded_point, tracks_origin
from artibot_sim.experiment.measured import dead_reckon
from artibot_sim.experiment.messages import encoder, path_message, trajectory_message
from artibot_sim.experiment.topics import BY_KEY, LATCHED, STATE
from artibot_sim.experiment.writer import BagWriter, whole_folder
from artibot_sim.model.simulate.sensors import low_passed, sensor_errors
from artibot_sim.progress import Report

if TYPE_CHECKING:
    from artibot_sim.model import Commands, Robot
    from artibot_sim.model.simulate.rollout import Rollout
    from artibot_sim.planning import Plan

MOTORS = ("front_right", "front_left", "back_right", "back_left")
START_NS = 1_000_000_000
"""Stamp of t = 0 by default: not 0, which in a header means "no stamp"."""
_PLANNED_PERIOD = 0.04
"""s between rows of what was planned."""
_REPORT_EVERY = 1000
"""Messages between two words on the progress."""
Table = tuple[Stamps, Mapping[str, Floats]]


class _Outgoing(NamedTuple):
    """A message on its way into a bag: sorts by time, then topic."""

    log_ns: int
    order: int
    key: str
    data: bytes


def _when(message: _Outgoing) -> tuple[int, int]:
    return message[:2]


def _outgoing(order: int, key: str, table: Table) -> Iterator[_Outgoing]:
    """Encode a channel's messages one after the other, in the order of their stamps; what is wrong is said at once."""
    (stamps, columns), topic = table, BY_KEY[key]
    for name, values in columns.items():
        if len(values) != len(stamps):
            raise ArtibotError(f"{topic.name}: column '{name}' has {len(values)} rows, its stamps {len(stamps)}")
    encode = encoder(topic, columns)
    rows = np.argsort(stamps, kind="stable")
    pairs = zip(rows.tolist(), stamps[rows].tolist(), strict=True)
    return (_Outgoing(stamp, order, key, encode(row, stamp)) for row, stamp in pairs)


def write_channels(
    folder: Path | str,
    tables: Mapping[str, Table],
    metadata: Mapping[str, str] | None = None,
    *,
    latched: Mapping[str, list[tuple[int, bytes]]] | None = None,
    progress: Report | None = None,
) -> Path:
    """Write columns as a contract bag; `read_bag` gives them back.

    Parameters
    ----------
    folder : made anew; whole, or not there at all.
    tables : channel key → stamps (n,) int64 in ns and columns, name → (n,) in SI units, named as `read_bag`
        names them.
    metadata : strings for the `artibot` record.
    latched : channel key → (stamp in ns, CDR bytes) of messages made elsewhere.
    progress : is called now and then with the share that is done.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    ArtibotError
        If the folder exists, a key is not the contract's, or a column's length is not that of its stamps.
    """
    folder = Path(folder)
    advance = progress or (lambda _: None)
    streams = [
        iter(sorted((_Outgoing(stamp, -1, key, data) for stamp, data in messages), key=_when))
        for key, messages in (latched or {}).items()
    ]
    streams += [_outgoing(order, key, table) for order, (key, table) in enumerate(tables.items())]
    total = sum(len(stamps) for stamps, _ in tables.values()) + sum(map(len, (latched or {}).values()))
    name = folder.resolve().name
    with (
        whole_folder(folder) as partial,
        BagWriter(partial, metadata, live=False, name=name) as bag,
    ):
        for key in (*(latched or {}), *tables):
            bag.register(BY_KEY[key].name, BY_KEY[key].ros_type, LATCHED if BY_KEY[key].latched else STATE)
        for number, message in enumerate(heapq.merge(*streams, key=_when)):  # hours of messages need not fit in memory
            if number % _REPORT_EVERY == 0:
                advance(number / total)
            bag.write(BY_KEY[message.key].name, message.data, message.log_ns, message.log_ns)
    return folder


def write_experiment(
    folder: Path | str,
    result: Rollout,
    plan: Plan | None,
    robot: Robot,
    *,
    commands: Commands | None = None,
    metadata: Mapping[str, str] | None = None,
    start_ns: int = START_NS,
    keys: tuple[str, ...] | None = None,
) -> Path:
    """Write a rollout as a contract bag.

    The motors are as the robot's encoders and torque sensors record them. `/ground_truth/odom` is where the front
    module really is; where effects let its position or yaw rate be seen otherwise, `/total_station/point` or
    `/imu/data` shows them so.

    Parameters
    ----------
    folder : made anew; whole, or not there at all.
    result : the rollout; its rows are the messages (100 Hz with steps of 1 ms and `every=10`).
    plan : what was to be driven, for `/planned/*`; None if nothing was planned.
    robot : whose rollout it is.
    commands : what the motors were told, for `/motor_command`; the plan's if None.
    metadata : strings for the `artibot` record; `robot`, `kappa` and, where it is uneven, `ground` are filled in.
    start_ns : stamp of t = 0.
    keys : channel keys to write (`ground_truth_odom`, …); all if None.

    Raises
    ------
    ArtibotError
        If the folder exists, or a key is unknown.
    """
    stamps = start_ns + np.rint(np.asarray(result.t) * 1e9).astype(np.int64)
    tables: dict[str, Table] = {
        "ground_truth_odom": (stamps, _ground_truth(result)),
        "odom": (stamps, _odometry(result, robot)),
        "joint_states": (stamps, _joint_states(result, robot)),
        "motor_torques": (stamps, _motor_torques(result, robot)),
        "motor_command": (stamps, _motor_command(result, robot, commands or (plan.commands() if plan else None))),
    }
    errors = sensor_errors(robot)
    if not tracks_origin(errors):
        tables["total_station"] = stamps, recorded_point(result, robot)
    if errors.gyro_bias:
        tables["imu"] = stamps, {"yaw_rate": result.twist[:, 2] + errors.gyro_bias}
    latched = {}
    if plan is not None:
        tables["planned_odom"] = _planned_odom(plan, start_ns)
        latched = _planned_profiles(plan, start_ns)
    unknown = set(keys or ()) - set(tables) - {"planned_path", "planned_front_velocity", "planned_odom"}
    if unknown:
        raise ArtibotError(f"write_experiment: no channel {', '.join(sorted(unknown))}; there are {', '.join(tables)}")
    about = {"robot": robot.name, "kappa": repr(float(robot.control.kappa))}
    about |= {"ground": result.ground.name} if result.ground is not None else {}
    return write_channels(
        folder,
        {key: table for key, table in tables.items() if keys is None or key in keys},
        about | dict(metadata or {}),
        latched={key: messages for key, messages in latched.items() if keys is None or key in keys},
    )


def rollout_columns(result: Rollout, robot: Robot) -> dict[str, dict[str, Floats]]:
    """Return what a rollout's rows say as columns (n,) of `ground_truth_odom`, `joint_states`, `motor_torques`."""
    return {
        "ground_truth_odom": _ground_truth(result),
        "joint_states": _joint_states(result, robot),
        "motor_torques": _motor_torques(result, robot),
    }


def _motors(robot: Robot) -> tuple[str, ...]:
    """The motors there are: those of the front module alone without a back one."""
    return robot.motors if robot.articulated else robot.motors[:2]


def _ground_truth(result: Rollout) -> dict[str, Floats]:
    from artibot_sim.model.simulate.motion import velocities

    pose, (velocity, rates) = result.pose, velocities(result.q, result.v)
    return {
        "x": pose[:, 0], "y": pose[:, 1], "z": result["z_f"],
        "roll": result["alpha_f"], "pitch": result["beta_f"], "yaw": pose[:, 2],
        "vx": velocity[:, 0], "vy": velocity[:, 1], "vz": velocity[:, 2],
        "roll_rate": rates[:, 0], "pitch_rate": rates[:, 1], "yaw_rate": rates[:, 2],
    }  # fmt: skip


def _odometry(result: Rollout, robot: Robot) -> dict[str, Floats]:
    """Return what the rover believes: the front wheels' rotations rolled off without slip, from its start pose."""
    from artibot_sim.planning.plan import FrontKinematics

    kinematics = FrontKinematics.of(robot)
    position, velocity, _ = recorded_motors(result, robot)
    travelled, turned = kinematics.forward(position[:, :2])
    speed, yaw_rate = kinematics.forward(velocity[:, :2])
    x, y, yaw = result.pose[0].tolist()
    pose = dead_reckon(travelled, turned, (x, y, yaw))
    return {"x": pose[:, 0], "y": pose[:, 1], "yaw": pose[:, 2], "vx": speed, "yaw_rate": yaw_rate}


def _joint_states(result: Rollout, robot: Robot) -> dict[str, Floats]:
    from artibot_sim.model.simulate.motion import joint_motion

    columns, errors = {}, sensor_errors(robot)
    speed = low_passed(result.t, result.wheel_velocity, errors.velocity_filter)
    for i, wheel in enumerate(robot.wheel_joints):
        columns[f"{wheel}.position"] = errors.encoder_scale * result.wheel_position[:, i]
        columns[f"{wheel}.velocity"] = errors.encoder_scale * speed[:, i]
    angle, rate = joint_motion(result.q, result.v)
    for i, joint in enumerate(robot.articulation_joints):
        columns[f"{joint}.position"], columns[f"{joint}.velocity"] = angle[:, i], rate[:, i]
    return columns


def _motor_torques(result: Rollout, robot: Robot) -> dict[str, Floats]:
    columns = {}
    position, velocity, torque = recorded_motors(result, robot)
    for i, motor in enumerate(_motors(robot)):
        columns[f"{motor}.position"] = position[:, i]
        columns[f"{motor}.velocity"] = velocity[:, i]
        columns[f"{motor}.effort"] = torque[:, i]
    return columns


def _motor_command(result: Rollout, robot: Robot, commands: Commands | None) -> dict[str, Floats]:
    """Return commanded velocities, and the efforts of motors that are commanded by torque."""
    columns = {}
    given = np.full((1, 4), np.nan) if commands is None else np.asarray(commands.velocity)
    for i, motor in enumerate(_motors(robot)):
        if commands is not None and i < given.shape[1] and np.isfinite(given[:, i]).all():
            knots = commands.t0 + commands.dt * np.arange(len(given))
            columns[f"{motor}.velocity"] = np.interp(result.t, knots, given[:, i])
        elif i >= 2:
            columns[f"{motor}.effort"] = result.motor_torque[:, i]
    return columns


def _planned_odom(plan: Plan, start_ns: int) -> Table:
    every = max(1, int(_PLANNED_PERIOD / plan.dt + 1e-9))
    t, pose, twist = plan.t[::every], plan.pose[::every], plan.twist[::every]
    columns = {"x": pose[:, 0], "y": pose[:, 1], "yaw": pose[:, 2], "vx": twist[:, 0], "yaw_rate": twist[:, 1]}
    return start_ns + np.rint(t * 1e9).astype(np.int64), columns


def _planned_profiles(plan: Plan, start_ns: int) -> dict[str, list[tuple[int, bytes]]]:
    """Return the path and the front velocity profile, published at the start."""
    after = np.rint(plan.t * 1e9).astype(np.int64)
    every = max(1, int(_PLANNED_PERIOD / plan.dt + 1e-9))
    path = path_message(start_ns, (start_ns + after[::every]).tolist(), plan.pose[::every])
    profile = trajectory_message(start_ns, list(MOTORS[:2]), after.tolist(), plan.position, plan.velocity)
    return {"planned_path": [(start_ns, path)], "planned_front_velocity": [(start_ns, profile)]}
