"""A state of the model from measurements."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from artibot_sim.experiment.columns import Floats
from artibot_sim.experiment.measured import Motion
from artibot_sim.model import Robot, State, initial_state


def start_state(
    robot: Robot, motion: Motion, position: Floats, velocity: Floats, torque: Floats | None = None, t: float = 0.0
) -> State:
    """Return a rover that moves as measured, on its wheels at static equilibrium.

    Parameters
    ----------
    robot : whose state it is.
    motion : of the front module in `map`; what is NaN counts as 0.
    position, velocity : (4,) motors, rad and rad/s; a speed that is NaN is that of rolling without slip.
    torque : (4,) N·m of the motors just before, which eq. 30 feeds back; NaN or None counts as 0.
    t : s.

    Raises
    ------
    ArtibotError
        If the joint cannot be closed at the measured articulation.
    """
    x, y, yaw, vx, vy, yaw_rate, bend, bend_rate = np.nan_to_num(np.array(motion, float), nan=0.0).tolist()
    state = initial_state(robot, x=x, y=y, yaw=yaw, articulation_yaw=bend if robot.articulated else 0.0, t=t)
    q, v = state.q.copy(), state.v.copy()
    v[[0, 1, 5]] = vx, vy, yaw_rate
    if robot.back is not None:
        yaw_b, rate_b = yaw + bend, yaw_rate + bend_rate
        l_f, l_b = robot.front.l, robot.back.l
        # eq. 13 differentiated: both modules' ends of the joint move alike
        v[8] = vx + l_f * yaw_rate * np.sin(yaw) + l_b * rate_b * np.sin(yaw_b)
        v[9] = vy - l_f * yaw_rate * np.cos(yaw) - l_b * rate_b * np.cos(yaw_b)
        v[13] = rate_b
    motors = (6, 7, 14, 15) if robot.articulated else (6, 7)
    rolling = _rolling(robot, q, v)
    for i, coordinate in enumerate(motors):
        q[coordinate] = position[i] if np.isfinite(position[i]) else 0.0
        v[coordinate] = velocity[i] if np.isfinite(velocity[i]) else rolling[i]
    fed_back = state.torque if torque is None else np.nan_to_num(torque, nan=0.0)
    return replace(state, q=q, v=v, torque=fed_back)


def _rolling(robot: Robot, q: Floats, v: Floats) -> Floats:
    """Return the speeds (4,) of motors whose wheels roll without slip, rad/s."""
    speeds = np.zeros(4)
    for k, (module, drive) in enumerate(((robot.front, robot.drive.front), (robot.back, robot.drive.back))):
        if module is None or drive is None:
            continue
        yaw, rate = q[8 * k + 5], v[8 * k + 5]
        forward = np.cos(yaw) * v[8 * k] + np.sin(yaw) * v[8 * k + 1]
        for side, sign in enumerate((1.0, -1.0)):  # right, left
            speeds[2 * k + side] = (forward + sign * rate * module.i_y / 2) / (robot.wheel.r_w * drive.tau)
    return speeds
