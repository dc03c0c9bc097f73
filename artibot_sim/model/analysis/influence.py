"""What a wheel's traction does to the front module: the influence coefficients of eq. 24.

The model is linear in the contact forces at any state, so its derivative by one of them is its response to a force
of 1 N there, with all else left out: M a + Phi_x^T lambda = Q, Phi_x a = 0 (eq. 25), with the joint's Jacobian, the
masses of eq. 9 and the generalised forces of eq. 18. Velocities and other forces do not enter.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from artibot_sim.errors import ArtibotError
from artibot_sim.model.equations.kinematics import constraint_jacobian
from artibot_sim.model.kernels.layout import BACK, GAMMA, X, Y
from artibot_sim.model.robot.derived import starred
from artibot_sim.model.robot.robot import WHEELS, Robot
from artibot_sim.model.simulate.state import initial_state

Array = NDArray[np.float64]

SIDES = ("right", "left")


@dataclass(frozen=True, eq=False)
class Influence:
    """Eq. 24 for every wheel: the front module's response to the wheel's longitudinal force.

    Attributes
    ----------
    gamma_r : (n,) array, rad
        Relative yaw gamma_f − gamma_b.
    chi : (n, 8) array, 1/kg
        Lateral acceleration of the front module's origin, along its own y axis, per newton; columns as in WHEELS.
    psi : (n, 8) array, 1/(kg m)
        Yaw acceleration of the front module per newton.
    """

    gamma_r: Array
    chi: Array
    psi: Array


@dataclass(frozen=True, eq=False)
class InfluenceMap:
    """Eq. 24 for a wheel on the right and on the left of the back module, over the robot's aspect ratio.

    Both wheels of a side act alike: where a longitudinal force acts along its own line does not matter.

    Attributes
    ----------
    ratio : (m,) array
        l_f / (l_f + l_b), with l_f + l_b and all else kept.
    gamma_r : (n,) array, rad
    chi, psi : (2, m, n) arrays, 1/kg and 1/(kg m)
        For the right and for the left wheel.
    """

    ratio: Array
    gamma_r: Array
    chi: Array
    psi: Array


def influence(robot: Robot, gamma_r: ArrayLike) -> Influence:
    """Differentiate the model by each wheel's longitudinal force (eq. 24), standing level.

    Parameters
    ----------
    robot : Robot
        Articulated.
    gamma_r : (n,) array or float, rad
        Relative yaw gamma_f − gamma_b.

    Raises
    ------
    ArtibotError
        For a robot without a joint, or an angle that is not finite.
    """
    if not robot.articulated:
        raise ArtibotError(f"influence: robot '{robot.name}' has no back module; eq. 24 is about the joint between two")
    angles = np.atleast_1d(np.asarray(gamma_r, dtype=float))
    flexibility, forces = _flexibility(robot), _wheel_forces(robot)
    chi, psi = np.empty((len(angles), len(WHEELS))), np.empty((len(angles), len(WHEELS)))
    for i, angle in enumerate(angles):
        q = np.array(initial_state(robot, articulation_yaw=-angle).q)  # the front module looks along x
        acceleration = _response(flexibility, constraint_jacobian(robot, q), forces(q))
        chi[i], psi[i] = acceleration[Y], acceleration[GAMMA]
    return Influence(angles, chi, psi)


def influence_map(
    robot: Robot, ratio: ArrayLike, gamma_r: ArrayLike, progress: Callable[[float], None] | None = None
) -> InfluenceMap:
    """Eq. 24 for the back wheels over aspect ratio and relative yaw, as Fig. 6 shows it.

    Parameters
    ----------
    robot : Robot
        Articulated; its l_f + l_b is kept.
    ratio : (m,) array
        l_f / (l_f + l_b), each from 0 to 1.
    gamma_r : (n,) array, rad
    progress : called with the share that is done

    Raises
    ------
    ArtibotError
        As `influence`, or for a ratio outside 0 to 1.
    """
    ratios, angles = np.atleast_1d(np.asarray(ratio, float)), np.atleast_1d(np.asarray(gamma_r, float))
    if not ((ratios >= 0) & (ratios <= 1)).all():
        raise ArtibotError(f"influence_map: ratios {ratios.min():g} to {ratios.max():g}; expected 0 to 1")
    sides = [WHEELS.index(f"back_{side}_front") for side in SIDES]
    chi, psi = np.empty((2, len(ratios), len(angles))), np.empty((2, len(ratios), len(angles)))
    for i, share in enumerate(ratios):
        found = influence(with_ratio(robot, float(share)), angles)
        chi[:, i], psi[:, i] = found.chi[:, sides].T, found.psi[:, sides].T
        if progress:
            progress((i + 1) / len(ratios))
    return InfluenceMap(ratios, angles, chi, psi)


def with_ratio(robot: Robot, ratio: float) -> Robot:
    """The robot with another l_f / (l_f + l_b) and the same l_f + l_b."""
    if robot.back is None:
        raise ArtibotError(f"influence: robot '{robot.name}' has no back module; eq. 24 is about the joint between two")
    length = robot.front.l + robot.back.l
    source = f"assumed: l_f / (l_f + l_b) = {ratio:g}"
    return robot.replace({"front.l": ratio * length, "back.l": (1 - ratio) * length}, source=source)


def _flexibility(robot: Robot) -> Array:
    """Diagonal of the inverse mass matrix (16,); the motors' angles, which no body force moves, have zeros."""
    inverse = np.zeros(16)
    for module, offset in ((robot.front, 0), (robot.back, BACK)):
        assert module is not None
        m, J_x, J_y, J_z = starred(robot, module)
        inverse[offset : offset + 6] = 1 / np.array([m, m, m, J_x, J_y, J_z])
    return inverse


def _wheel_forces(robot: Robot) -> Callable[[Array], Array]:
    """Return what gives, for coordinates q (16,), the generalised forces (16, 8) of 1 N along each wheel (eq. 18)."""
    arms = []
    for name in WHEELS:
        module = robot.front if name.startswith("front") else robot.back
        assert module is not None
        arms.append(0.5 * module.i_y * (1.0 if "right" in name else -1.0))  # −y of the wheel

    def forces(q: Array) -> Array:
        Q = np.zeros((16, len(WHEELS)))
        for column, arm in enumerate(arms):
            offset = 0 if column < 4 else BACK
            yaw = q[offset + GAMMA]
            Q[offset + X, column], Q[offset + Y, column], Q[offset + GAMMA, column] = np.cos(yaw), np.sin(yaw), arm
        return Q

    return forces


def _response(flexibility: Array, Phi_x: Array, Q: Array) -> Array:
    """Accelerations (16, k) to generalised forces (16, k) under the joint (eq. 25 at rest)."""
    free = flexibility[:, None] * Q
    compliance = (Phi_x * flexibility) @ Phi_x.T
    held: Array = free - flexibility[:, None] * (Phi_x.T @ np.linalg.solve(compliance, Phi_x @ free))
    return held
