"""The ground under a robot's wheels as Gazebo takes it, and what of the model other simulators cannot express."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from artibot_sim.model import Robot
from artibot_sim.model.effects import at_work
from artibot_sim.model.robot.derived import params, train
from artibot_sim.model.robot.robot import sides_of

EXPRESSED = ("back_friction", "wheel_radius", "wheel_radius_mismatch", "payload")
"""Effects that are in the numbers of masses, radii and friction which are written."""

SENSORS = ("encoder_scale", "torque_scale", "gyro_bias", "pose_lever_arm", "pose_heading_offset", "pose_delay")
"""Effects of sensors, which are no part of a robot's body."""


class Friction(NamedTuple):
    """Friction of one wheel, along its axle (first) and along its rim (second).

    Attributes
    ----------
    mu, mu2 : largest horizontal over normal force.
    slip, slip2 : velocity of slip over force, (m/s)/N: Gazebo's force-dependent slip.
    """

    mu: float
    mu2: float
    slip: float
    slip2: float


class WheelBody(NamedTuple):
    """What the numbers of a wheel are once effects are in them: its radius (m) and friction."""

    radius: float
    friction: Friction


def wheels_of(robot: Robot) -> dict[str, WheelBody]:
    """Return motor → its wheels' radius and friction.

    Below saturation eq. 15's horizontal force is k times the slip's velocity: a slip of 1/k for each newton. Up to
    there Gazebo's law is the same one; beyond, its force stays at mu times the load.
    """
    found = {}
    modules = train(robot).modules if robot.articulated else (params(robot),)
    sides = [(p.front, motor) for p in modules for motor in (p.right_front, p.left_front)]
    for name, (soil, motor) in zip(sides_of(len(modules)), sides, strict=True):
        found[name] = WheelBody(motor.r_w, Friction(soil.mu_s, soil.mu_s, 1.0 / soil.k_t, 1.0 / soil.k_l))
    return found


def masses(robot: Robot) -> tuple[float, ...]:
    """Return the masses of the modules without wheels, with what effects add to them, kg."""
    modules = train(robot).modules if robot.articulated else (params(robot),)
    return tuple(p.front.m - 4.0 * robot.wheel.m_w for p in modules)


def left_out(robot: Robot) -> Iterator[str]:
    """Yield what of the model a description in another simulator's words leaves out, a sentence each."""
    contact = robot.contact
    yield (
        f"a sliding wheel keeps mu_s ({contact.mu_s:g}) of its load here, in the model mu_d ({contact.mu_d:g}), "
        "and longitudinal and lateral slip share one limit there (eq. 16)"
    )
    yield f"rolling resistance (the load acts u_w = {contact.u_w:g} m ahead of a wheel's centre)"
    yield (
        f"tyres are stiff here; in the model they sink by {_sag(robot) * 1e3:.2g} mm under the rover "
        f"(k_n = {contact.k_n:g} N/m)"
    )
    drives = [drive for drive in robot.drives if drive is not None]
    if any((drive.eta_d, drive.eta_r) != (1.0, 1.0) for drive in drives):
        yield "efficiencies of the gearboxes, which brake differently than they drive, and the rotors' inertia"
    yield "that one motor turns both wheels of a side: give both the same command"
    if robot.articulated:
        kappa = robot.control.kappa
        yield f"the torque sharing of eq. 30 (kappa = {kappa:g}): back wheels get the torque you give them"
    names = [name for name in at_work(robot.effects) if name not in (*EXPRESSED, *SENSORS)]
    if names:
        yield f"the effects {', '.join(names)}"


def _sag(robot: Robot) -> float:
    heaviest = max(masses(robot)) + 4.0 * robot.wheel.m_w
    return heaviest * 9.81 / (4.0 * robot.contact.k_n)
