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


def torque_factors(robot: Robot, kappa: float | None = None) -> tuple[float, ...]:
    """Torque of a motor of each module over the sum of the front motors' (eq. 30, split equally between the sides).

    Eq. 29 gives the front module the share kappa of the traction. What is left is for the driven modules behind it, in
    equal parts: with one of them that is eq. 30. The front module's own factor, and a passive one's, are zero.
    """
    share = robot.control.kappa if kappa is None else kappa
    behind = [None, *robot.drives[1:]]
    followers = sum(drive is not None for drive in behind)
    return tuple(
        0.0 if drive is None else 0.5 * drive.tau / robot.drive.front.tau * (1.0 / share - 1.0) / followers
        for drive in behind
    )


def back_torque_factor(robot: Robot, kappa: float | None = None) -> float:
    """`torque_factors` of a back motor; zero for a rigid robot."""
    return torque_factors(robot, kappa)[1] if robot.articulated else 0.0


@inlined
def rolling_sign(omega):
    """Smooth sign of the wheel's rotation (rad/s): at standstill rolling resistance has no torque."""
    return tanh(omega * (1.0 / ROLLING_WIDTH))


@inlined
def axle_torque(lever, at_rim, rolling, sign):
    """M_r of eq. 22 (N m): the wheels' F_l (N) at their `lever` (m), and u F_n (N m) against the `sign` of rotation."""
    return lever * at_rim + rolling * sign


@inlined
def load_torque(p, unit, forces, omega):
    """M_r of eq. 22 for the wheels of a motor that turn at `omega` (rad/s), N m; `forces` are `contact.PairForces`."""
    if p.literal_eq22:
        return axle_torque(unit.r_w + p.u_w, forces.at_rim, 0.0, 0.0)
    return axle_torque(unit.r_w, forces.at_rim, forces.u_F_n, tanh_alone(omega * (1.0 / ROLLING_WIDTH)))


@inlined
def driving(M_gear, theta_dot):
    """Eq. 23: whether a motor drives its gear (efficiency eta_d), or is braked by it (1/eta_r).

    `M_gear` is the motor's torque less what drags on its shaft before the gear. With the whole torque a drag that
    outweighs a braking load would have the efficiency flip at each step: driving makes the load large enough to brake,
    and braking too small.
    """
    return M_gear * theta_dot >= 0.0


@inlined
def drives_next(M_gear, theta_dot, rotor, inverse_eta, inverse_eta_d, eta_r, measured):
    """Eq. 23 for the next step: whether a motor drives its gear, see `driving`; a measured torque settles what is open.

    The rotor's inertia acts before the gear as well, and eq. 23 goes by the torque with it. So where a rotor and the
    wheels ask for torques of opposite signs, which they do while an idle motor slows down, both efficiencies may agree
    with the sign of the torque that they give, or neither: of a rotation alone either may be right. Then the torque
    decides that is nearer to the measured one.

    Parameters
    ----------
    M_gear : float
        Torque of the motor less what drags on its shaft, by the efficiency that this step has, N m.
    rotor : float
        J_m times the motor's acceleration, N m.
    inverse_eta, inverse_eta_d, eta_r : float
        1 over the efficiency of this step, and what it is of a motor that drives its gear and of one that brakes it.
    measured : float
        As `M_gear`; NaN where nothing is measured: then what this step has stays as long as it agrees with its torque.
    """
    # torques times the efficiency's inverse in use, which spares a division
    at_wheels, at_rotor, seen = M_gear - rotor, rotor * inverse_eta, measured * inverse_eta
    M_d, M_r = at_rotor + inverse_eta_d * at_wheels, at_rotor + eta_r * at_wheels
    drives, brakes, known = driving(M_d, theta_dot), not driving(M_r, theta_dot), seen == seen
    either, nearer = drives == brakes, abs(seen - M_d) <= abs(seen - M_r)
    # no branches: compilers make vector code of it
    settled = (either & nearer) | ((not either) & drives)
    return (known & settled) | ((not known) & driving(M_gear, theta_dot))


@inlined
def impulses(M_gear, theta_dot, load, J_m, J, dt):
    """What a gear with loss weighs over a step `dt` (s), N m s: what comes to it from the motor, and from the wheels.

    Parameters
    ----------
    M_gear : float
        See `driving`, N m.
    load : float
        tau/eta M_r, N m.
    J_m, J : float
        Inertias of the rotor, and of all that turns by the efficiency in use (`reflect`), kg m².
    """
    return M_gear * dt + J_m * theta_dot, load * dt - (J - J_m) * theta_dot


@inlined
def sticks(M_gear, brought, taken, inverse_eta, inverse_eta_d, eta_r):
    """Whether a gear's own loss holds its motor at rest: neither efficiency agrees with the rotation that it leads to.

    By eq. 23 a motor that drives turns the way its torque does, and one that brakes the other way. After a step under a
    held torque the rotation has the sign of ``brought - inverse/inverse_eta taken`` (see `impulses`) for an `inverse`
    of the efficiency. Where the least loss has it turn forth and the greatest back, both contradict eq. 23: as dry
    friction does, a gear then takes what it needs to stand, which is between them. Inverses may have any common factor.
    """
    forth, back = inverse_eta * brought - eta_r * taken, inverse_eta * brought - inverse_eta_d * taken
    return (M_gear * back <= 0.0) & (M_gear * forth > 0.0)


@inlined
def reflect(tau, J_m, J_w, inverse_eta):
    """Gear ratio tau/eta from wheel torque to motor torque, and inertia J_m + J_w tau²/eta (eq. 21)."""
    gear = tau * inverse_eta
    return gear, J_m + J_w * tau * gear


@inlined
def follow(damping, stiffness, theta, theta_dot, d, d_dot, d_ddot):
    """Acceleration that makes a rotation follow its command (eqs 27, 28), in 1/s and 1/s² of speed and angle behind."""
    return d_ddot + damping * (d_dot - theta_dot) + stiffness * (d - theta)


@inlined
def motor_equation(J, inverse_J, load, wish, held, low, high):
    """Eq. 21 for one motor under a `load` (N m, motor side), solved for what its mode leaves open.

    Parameters
    ----------
    wish : float or None
        Acceleration by which it follows its command, rad/s² (eqs 27, 28, or a velocity loop); None, at compile time,
        for a motor that is known to be under a torque.
    held : float
        Its torque, N m; NaN for whatever the wish takes.
    low, high : float
        Between these its torque stays, N m; infinite for a prescribed motor.

    Returns
    -------
    tuple of 2 floats
        Motor torque M_m (N m) and angular acceleration (rad/s²), motor side.
    """
    if wish is None:
        M_m = min(max(held, low), high)
        return M_m, (M_m - load) * inverse_J
    needed = J * wish + load
    M_m = min(max(held if held == held else needed, low), high)
    return M_m, (wish if M_m == needed else (M_m - load) * inverse_J)
