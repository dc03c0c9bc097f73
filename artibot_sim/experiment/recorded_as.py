"""A simulation as its robot's sensors record it, and measurements as the model takes them: see `model.sensors`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from artibot_sim.experiment.columns import Experiment, Floats
from artibot_sim.experiment.local_fit import hermite
from artibot_sim.experiment.measured import Motion
from artibot_sim.experiment.motor_inputs import MotorInputs
from artibot_sim.model import MOTORS, Commands, Robot, Rollout
from artibot_sim.model.command_way import as_executed
from artibot_sim.model.param_types import SensorErrors
from artibot_sim.model.sensors import sensor_errors, tracked_point, true_starts


def recorded_motors(result: Rollout, robot: Robot) -> tuple[Floats, Floats, Floats]:
    """Return motor positions, velocities and torques (n, 4) as recorded, rad, rad/s, N·m."""
    errors = sensor_errors(robot)
    turned, pulled = errors.encoder_scale, errors.torque_scale
    return turned * result.motor_position, turned * result.motor_velocity, pulled * result.motor_torque


def recorded_point(result: Rollout, robot: Robot) -> dict[str, Floats]:
    """Return the columns of a total station that sees the tracked point; before the start it stood still."""
    errors = sensor_errors(robot)
    t, coordinates = result.t, [0, 1, 5]
    at = np.clip(t - errors.delay, t[0], t[-1])
    i = np.clip(np.searchsorted(t, at, side="right") - 1, 0, max(len(t) - 2, 0))
    j = np.minimum(i + 1, len(t) - 1)
    pose, rate = result.q[:, coordinates], result.v[:, coordinates]
    late = hermite(t[i], t[j], pose[i], pose[j], rate[i], rate[j], at)[0] if len(t) > 1 else pose
    point = tracked_point(errors, late)
    return {"x": point[:, 0], "y": point[:, 1], "z": np.interp(at, t, result["z_f"])}


def sees_itself(errors: SensorErrors) -> bool:
    """Whether the tracked point is the front module's origin, at once."""
    return errors.arm_x == errors.arm_y == errors.delay == 0.0


def true_motion(errors: SensorErrors, motion: Motion, late: bool) -> Motion:
    """The rover's own motion where sensors with errors measured `motion`, its heading as late as positions or not."""
    if errors._replace(encoder_scale=1.0, torque_scale=1.0) == SensorErrors():
        return motion
    x, y, yaw, vx, vy, rate = np.nan_to_num(np.array(motion[:6], float)).tolist()
    c, s = np.cos(yaw), np.sin(yaw)
    start = np.array([[x, y, yaw, c * vx + s * vy, c * vy - s * vx, rate]])
    x, y, yaw, forward, left, rate = true_starts(np.array([errors]), start, np.array([late]))[0].tolist()
    c, s = np.cos(yaw), np.sin(yaw)
    true = Motion(x, y, yaw, c * forward - s * left, s * forward + c * left, rate, *motion[6:])
    return Motion(*(float("nan") if np.isnan(old) else new for old, new in zip(motion, true, strict=True)))


def true_inputs(inputs: MotorInputs, errors: SensorErrors, recorded: bool) -> MotorInputs:
    """What turns the motors, from encoders and torques with errors: all of it if `recorded`, else the start alone."""
    turned, pulled = errors.encoder_scale, errors.torque_scale
    if turned == pulled == 1.0:
        return inputs
    angle, speed = inputs.measured_position / turned, inputs.measured_velocity / turned
    start = replace(inputs, measured_position=angle, measured_velocity=speed)
    if not recorded:
        return start
    return replace(
        start, position=inputs.position / turned, velocity=inputs.velocity / turned, torque=inputs.torque / pulled
    )


def executed_inputs(inputs: MotorInputs, robot: Robot) -> MotorInputs:
    """Inputs from commands at the end of their way to the front motors: delayed, lagging, without what is too small."""
    given = Commands(inputs.dt, inputs.velocity, position=inputs.position, t0=float(inputs.t[0]))
    followed = as_executed(robot, given)
    if followed is given:
        return inputs
    return replace(inputs, velocity=followed.velocity, position=followed.position)


def recorded_efforts(experiment: Experiment, t: float) -> Floats:
    """Return the recorded torques (4,) nearest to `t`, N·m; NaN where none is recorded."""
    motors = experiment.channels.get("motor_torques")
    efforts = np.full(4, np.nan)
    if motors is not None:
        row = int(np.argmin(np.abs(motors.t - t)))
        for i, motor in enumerate(MOTORS):
            if f"{motor}.effort" in motors:
                efforts[i] = motors[f"{motor}.effort"][row]
    return efforts
