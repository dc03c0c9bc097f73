"""The same rover in PyBullet: its multi-body and its own step, the paper's contact law beside it (see `law_bodies`).

PyBullet does not hand out accelerations, so there is no RK4 around it: forces go in and it makes a step of Euler's
symplectic method. The motors turn alone, so they are stepped here, by the same method.
"""

from __future__ import annotations

import tempfile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from artibot_sim.bench.law_bodies import LawOnBodies
from artibot_sim.bench.mujoco_runs import MujocoRun
from artibot_sim.model import Commands, Robot

Array = NDArray[np.float64]

CROSS, BACK = 0, 1
"""Links behind the front module, which is the base: the joint's cross, and the back module."""

LIGHT = 1e-6
"""Mass (kg) and inertia (kg m²) of the cross: PyBullet takes none that is nothing."""


class PybulletRun(LawOnBodies):
    """The paper's contact law on PyBullet's bodies; call it for a rollout."""

    def __init__(self, robot: Robot, commands: Commands, dt: float = 1e-3) -> None:
        super().__init__(robot, commands, dt, stages=1)

    def __call__(self) -> MujocoRun:
        """One rollout from rest, in a world of its own."""
        import pybullet

        world = pybullet.connect(pybullet.DIRECT)
        try:
            return self._roll(pybullet, world)
        finally:
            pybullet.disconnect(world)

    def _roll(self, bullet: Any, world: int) -> MujocoRun:
        (q, v), p, yaw = self.at_rest(), self.p, 0.0
        bullet.setGravity(p.g_x, p.g_y, p.g_z, physicsClientId=world)
        bullet.setPhysicsEngineParameter(fixedTimeStep=self.dt, numSubSteps=1, physicsClientId=world)
        self._bullet, self._world, self._rover = bullet, world, self._made(bullet, world, float(q[2]))
        rows = [q[[0, 1, 3]]]
        for step in range(1, self.steps + 1):
            torque, wrench = self.forces(q, v)
            for link, acting in zip((-1, BACK), wrench, strict=True):
                at = self.arrays["xpos"][1 if link < 0 else 2]
                bullet.applyExternalForce(self._rover, link, acting[:3], at, bullet.WORLD_FRAME, world)
                bullet.applyExternalTorque(self._rover, link, acting[3:], bullet.WORLD_FRAME, world)
            bullet.stepSimulation(world)
            v[8:] += self.dt * torque[8:]
            q[8:] += self.dt * v[8:]
            if step % self.every == 0:
                place, turned = bullet.getBasePositionAndOrientation(self._rover, world)
                seen = bullet.getEulerFromQuaternion(turned)[2]
                yaw += (seen - yaw + np.pi) % (2 * np.pi) - np.pi
                rows.append(np.array([place[0], place[1], yaw]))
        return self.run(rows)

    def _made(self, bullet: Any, world: int, height: float) -> int:
        """Both modules with the joint between them, and nothing that damps."""
        with tempfile.NamedTemporaryFile("w", suffix=".urdf") as file:
            file.write(self._urdf())
            file.flush()
            rover: int = bullet.loadURDF(
                file.name, [0.0, 0.0, height], flags=bullet.URDF_USE_INERTIA_FROM_FILE, physicsClientId=world
            )
        for link in (-1, CROSS, BACK):
            bullet.changeDynamics(
                rover, link, linearDamping=0.0, angularDamping=0.0, jointDamping=0.0, maxJointVelocity=1e6,
                activationState=bullet.ACTIVATION_STATE_DISABLE_SLEEPING, physicsClientId=world,
            )  # fmt: skip
        for joint in (CROSS, BACK):
            bullet.setJointMotorControl2(rover, joint, bullet.VELOCITY_CONTROL, force=0.0, physicsClientId=world)
        return rover

    def _urdf(self) -> str:
        """A joint about z of the front module and one about x of the back one, a cross that weighs nothing between."""
        f, b = self.p.front, self.p.back
        back = _link("back", b.m, (b.J_x, b.J_y, b.J_z), (-b.O_x, -b.O_z))
        return (
            '<robot name="rover">'
            + _link("front", f.m, (f.J_x, f.J_y, f.J_z))
            + _link("cross", LIGHT, (LIGHT, LIGHT, LIGHT))
            + back
            + _joint("yaw", "front", "cross", (f.O_x, f.O_z), "0 0 1")
            + _joint("roll", "cross", "back", (0.0, 0.0), "1 0 0")
            + "</robot>"
        )

    def look(self, q: Array, v: Array) -> list[tuple[Array, Array, Array, Array]]:
        """Origin, rotation, velocity and angular velocity of both modules in `map`, as PyBullet has them."""
        bullet, rover, world = self._bullet, self._rover, self._world
        place, turned = bullet.getBasePositionAndOrientation(rover, world)
        linear, angular = bullet.getBaseVelocity(rover, world)
        link = bullet.getLinkState(rover, BACK, 1, 1, physicsClientId=world)
        return [
            (np.array(where), np.reshape(bullet.getMatrixFromQuaternion(how), (3, 3)), np.array(speed), np.array(turn))
            for where, how, speed, turn in ((place, turned, linear, angular), (link[0], link[1], link[6], link[7]))
        ]


def _link(name: str, m: float, J: tuple[float, float, float], at: tuple[float, float] = (0.0, 0.0)) -> str:
    """A body whose centre of mass is at x and z (m) of its frame."""
    turning = f'<inertia ixx="{J[0]!r}" iyy="{J[1]!r}" izz="{J[2]!r}" ixy="0" ixz="0" iyz="0"/>'
    place = f'<origin xyz="{at[0]!r} 0 {at[1]!r}"/>'
    return f'<link name="{name}"><inertial>{place}<mass value="{m!r}"/>{turning}</inertial></link>'


def _joint(name: str, parent: str, child: str, at: tuple[float, float], axis: str) -> str:
    """A hinge at x and z (m) of its parent's frame."""
    return (
        f'<joint name="{name}" type="continuous"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{at[0]!r} 0 {at[1]!r}"/><axis xyz="{axis}"/></joint>'
    )
