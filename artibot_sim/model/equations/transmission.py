"""Motors, gearboxes and wheel spin: eqs 21 to 23, 26 to 28 and the torque sharing of eqs 29, 30."""

from __future__ import annotations

import enum

from artibot_sim.model.kernels.compilation import inlined
from artibot_sim.model.kernels.elementary import tanh, tanh_alone
from artibot_sim.model.robot.robot import Robot

ROLLING_WIDTH = 0.02
"""Wheel speed over which rolling resistance changes its sign (tanh), rad/s."""


class Mode(enum.IntEnum):
    """How a motor is moved.

    PRESCRIBED follows its commanded rotation whatever torque that takes (eqs 26 to 28); DRIVEN does so by a
    velocity loop whose torque is limited to ±torque_max; TORQUE turns under a torque: a commanded one, or for
    the back motors that of eq. 30.
    """

    PRESCRIBED = 0
    DRIVEN = 1
    TORQUE = 2


PRESCRIBED, DRIVEN, TORQUE = (int(mode) for mode in Mode)


def back_torque_factor(robot: Robot, kappa: float | None = None) -> float:
    """Torque of each back motor over the sum of the front motors' (eq. 30, split equally between the sides)."""
    if robot.drive.back is None:
        return 0.0
    share = robot.control.kappa if kappa is None else kappa
    return 0.5 * robot.drive.back.tau / robot.drive.front.tau * (1.0 / share - 1.0)


@inlined
def rolling_sign(omega):
    """Smooth sign of the wheel's rotation (rad/s): at standstill rolling resistance has no torque."""
    return tanh(omega * (1.0 / ROLLING_WIDTH))


@inlined
def axle_torque(p, unit, F_l_sum, u_F_n, omega):
    """M_r of eq. 22 from the sums over its wheels of F_l (N) and u F_n (N m): torque on the wheels' axle, N m."""
    if p.literal_eq22:
        return unit.r_w * F_l_sum + p.u_w * F_l_sum
    return unit.r_w * F_l_sum + u_F_n * tanh_alone(omega * (1.0 / ROLLING_WIDTH))


@inlined
def load_torque(p, fx, unit, pair, soil, omega, F_l_sum):
    """M_r of eq. 22 for the wheels of a motor that turn at `omega` (rad/s), N m."""
    if fx is not None:
        u_F_n = soil.u_f * pair.F_nf + soil.u_b * pair.F_nb
    else:
        u_F_n = p.u_w * (pair.F_nf + pair.F_nb)
    return axle_torque(p, unit, F_l_sum, u_F_n, omega)


@inlined
def efficiency(motor, M_gear, theta_dot):
    """Eq. 23: eta_d while the motor drives, 1/eta_r while it brakes.

    `M_gear` is the motor's torque less what drags on its shaft before the gear. With the whole torque a drag that
    outweighs a braking load would have the efficiency flip at each step: driving makes the load large enough to brake,
    and braking too small.
    """
    if M_gear * theta_dot >= 0.0:
        return motor.eta_d
    return 1.0 / motor.eta_r


@inlined
def follow(A, theta, theta_dot, d, d_dot, d_ddot):
    """Acceleration that makes a rotation follow its command, critically damped at rate A (eqs 27, 28)."""
    return d_ddot - 2.0 * A * (theta_dot - d_dot) - A * A * (theta - d)


@inlined
def reflect(motor, eta):
    """Gear ratio tau/eta from wheel torque to motor torque, and inertia J_m + J_w tau²/eta (eq. 21)."""
    gear = motor.tau / eta
    return gear, motor.J_m + motor.J_w * motor.tau * gear


@inlined
def limited(motor, M_m):
    """A torque within ±torque_max."""
    return min(max(M_m, -motor.torque_max), motor.torque_max)


@inlined
def motor_equation(motor, p, mode, J, load, theta, theta_dot, d, d_dot, d_ddot, M_d):
    """Eq. 21 for one motor under a `load` (N m, motor side), solved for what its mode leaves open.

    Returns
    -------
    tuple of 2 floats
        Motor torque M_m (N m) and angular acceleration (rad/s²), motor side.
    """
    if mode == PRESCRIBED:
        theta_ddot = follow(p.A_motor, theta, theta_dot, d, d_dot, d_ddot)
        return J * theta_ddot + load, theta_ddot
    M_m = M_d
    if mode == DRIVEN:
        M_m = J * (d_ddot + p.velocity_gain * (d_dot - theta_dot)) + load
    M_m = limited(motor, M_m)
    return M_m, (M_m - load) / J
