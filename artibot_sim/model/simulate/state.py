"""The state of a rover, and where it starts."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from artibot_sim.errors import ArtibotError
from artibot_sim.model.kernels.layout import BACK, BETA, GAMMA, X, Y, Z
from artibot_sim.model.reference.dynamics import constraint_terms
from artibot_sim.model.robot.derived import params
from artibot_sim.model.robot.parameters import Params
from artibot_sim.model.robot.robot import Robot

Array = NDArray[np.float64]


@dataclass(frozen=True)
class State:
    """Everything a rollout needs to go on.

    Attributes
    ----------
    t : float
        Time, s.
    q, v : array, shape (16,)
        Generalised coordinates (eqs 10, 11) and their rates: x y z alpha beta gamma theta_r theta_l of the front
        module, then of the back one; m, rad, motor-side rad.
    eta : array, shape (4,)
        Efficiencies for the next step (eq. 23).
    torque : array, shape (4,)
        Motor torques of the last step (N m), which eq. 30 feeds back.
    lateral : array, shape (8,)
        Lateral forces (N) of tyres that need some way to build them up, in the order of WHEELS; only the effect
        `tyre_relaxation` knows them.
    """

    t: float
    q: Array
    v: Array
    eta: Array
    torque: Array
    lateral: Array = field(default_factory=lambda: np.zeros(8))

    def __post_init__(self) -> None:
        for name, size in (("q", 16), ("v", 16), ("eta", 4), ("torque", 4), ("lateral", 8)):
            array = np.array(getattr(self, name), dtype=float)
            if array.shape != (size,) or not np.isfinite(array).all():
                raise ArtibotError(f"state.{name}: found {array!r}, expected {size} finite numbers")
            array.setflags(write=False)
            object.__setattr__(self, name, array)


def initial_state(
    robot: Robot, x: float = 0.0, y: float = 0.0, yaw: float = 0.0, articulation_yaw: float = 0.0, t: float = 0.0
) -> State:
    """A rover at rest on its wheels.

    Vertical motion is an undamped spring (section 4.3), so each module starts where its wheels carry it, and
    pitched, if need be, so that the joint's two ends meet.

    Parameters
    ----------
    x, y, yaw : float
        Pose of the front module in `map`, m and rad.
    articulation_yaw : float
        gamma_b − gamma_f, rad.
    t : float
        Time, s.

    Raises
    ------
    ArtibotError
        When a number is not finite, or the joint cannot be closed at this articulation.
    """
    for name, value in (("x", x), ("y", y), ("yaw", yaw), ("articulation_yaw", articulation_yaw)):
        if not math.isfinite(value):
            raise ArtibotError(f"initial_state: {name} is {value}; expected a finite number")
    p = params(robot)
    q = np.zeros(16)
    q[[X, Y, GAMMA]] = x, y, yaw
    q[Z] = p.front.r_0 + p.front.m * p.g_z / (4 * p.k_n)
    if p.two:
        q[BACK + Z] = p.back.r_0 + p.back.m * p.g_z / (4 * p.k_n)
        q[BACK + GAMMA] = yaw + articulation_yaw
        _close_joint(p, q)
    eta = np.array([robot.drive.front.eta_d] * 2 + [(robot.drive.back or robot.drive.front).eta_d] * 2)
    return State(t, q, np.zeros(16), eta, np.zeros(4))


def _close_joint(p: Params, q: Array) -> None:
    """Solve eq. 13 for the back module's x and y and both pitches, in place, by Newton's method."""
    x_f, x_b = p.front.O_x, p.back.O_x
    q[BACK + X] = q[X] + x_f * math.cos(q[GAMMA]) - x_b * math.cos(q[BACK + GAMMA])
    q[BACK + Y] = q[Y] + x_f * math.sin(q[GAMMA]) - x_b * math.sin(q[BACK + GAMMA])
    if q[Z] + p.front.O_z == q[BACK + Z] + p.back.O_z:
        return  # level, as on flat ground: this closes it
    free = [BACK + X, BACK + Y, BETA, BACK + BETA]
    for _ in range(20):
        gap, jacobian, _ = constraint_terms(p, q, np.zeros(16))
        if np.abs(gap).max() < 1e-15:
            return
        q[free] -= np.linalg.lstsq(jacobian[:, free], gap, rcond=None)[0]
    if np.abs(gap).max() > 1e-9:
        raise ArtibotError(
            f"initial_state: the joint does not close at an articulation of {q[BACK + GAMMA] - q[GAMMA]:g} rad; "
            "check front.O_z, back.O_z and l, or start straighter"
        )
