"""A rover with its drives and sensors, as numbers: what an effect changes, and what is driven."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import inf
from typing import Any

import numpy as np
from diagnose.hidden.parts import Body, Gear, Ground, Hidden, Rover

from artibot_sim.diagnose.sizes import scale_of
from artibot_sim.model import Robot

SOIL = ("k_l", "k_t", "mu_s", "mu_d", "u_w")


@dataclass(frozen=True)
class Way:
    """What happens to commands on their way to the front motors: s, rad/s, s, rad/s², rad/s."""

    delay: float = 0.0
    deadband: float = 0.0
    time_constant: float = 0.0
    ramp: float = inf
    fastest: float = inf


@dataclass(frozen=True)
class Sensing:
    """What sensors do to the truth, noise apart."""

    encoder_scale: float = 1.0
    torque_scale: float = 1.0
    lever_x: float = 0.0
    lever_y: float = 0.0
    pose_delay: float = 0.0
    gyro_bias: float = 0.0
    smoothed: float = 0.0  # s, time constant of the low-pass on recorded motor speeds


@dataclass(frozen=True)
class Machine:
    """A rover on its soil, with the way commands take and what its sensors say.

    Attributes
    ----------
    track : float
        Distance between right and left wheels as whoever plans knows it, m; `radius` (m) and `tau` likewise.
    length : float
        Lengths over Agri.q's.
    """

    rover: Rover
    track: float
    radius: float
    tau: float
    length: float
    way: Way = field(default_factory=Way)
    sensing: Sensing = field(default_factory=Sensing)

    def hiding(self, **values: Any) -> Machine:
        """The same with these fields of `Hidden`."""
        return self.with_rover(hidden=self.rover.hidden._replace(**values))

    def with_rover(self, **values: Any) -> Machine:
        """The same with these fields of `Rover`."""
        return replace(self, rover=self.rover._replace(**values))


def machine(robot: Robot, soil: dict[str, float], kappa: float) -> Machine:
    """A machine with a robot file's numbers on another soil, in which nothing is hidden."""
    wheel, front, back = robot.wheel, robot.drive.front, robot.drive.back
    share = 0.5 * back.tau / front.tau * (1.0 / kappa - 1.0)
    gears = [Gear(d.tau, d.eta_d, d.eta_r, d.J_m, wheel.wheels_per_motor * wheel.J_wy) for d in (front, back)]
    bodies = [_body(part, wheel) for part in (robot.front, robot.back)]
    ground = Ground(*(float(soil[name]) for name in SOIL))
    rover = Rover(*bodies, ground, *gears, wheel.r_w, wheel.r_w, share, Hidden())
    return Machine(rover, robot.front.i_y, wheel.r_w, front.tau, scale_of(robot).length)


def _body(part: Any, wheel: Any) -> Body:
    """m*, J_z* of eq. 9: four wheels at half the spacings."""
    m = part.m + 4.0 * wheel.m_w
    J_z = part.J_z + 4.0 * wheel.J_wx + wheel.m_w * (part.i_x**2 + part.i_y**2)
    return Body(m, J_z, 0.5 * part.i_x, 0.5 * part.i_y, part.l)


def random_soil(robot: Robot, rng: np.random.Generator, spread: float = 0.12) -> dict[str, float]:
    """Soil drawn about the robot file's, each parameter log-normally; mu_d stays below mu_s."""
    drawn = {name: getattr(robot.contact, name) * float(np.exp(spread * rng.standard_normal())) for name in SOIL}
    drawn["mu_d"] = min(drawn["mu_d"], 0.9 * drawn["mu_s"])
    return drawn
