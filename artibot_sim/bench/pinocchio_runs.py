"""The same rover in Pinocchio: its forward dynamics (ABA), the paper's contact law beside it (see `law_bodies`)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from artibot_sim.bench.law_bodies import StagedRun
from artibot_sim.model import Commands, Robot
from artibot_sim.model.param_types import ModuleParams

Array = NDArray[np.float64]

FRONT, BACK = 6, 8
"""Joints that carry the modules, as Pinocchio counts them."""


class PinocchioRun(StagedRun):
    """The paper's contact law on Pinocchio's bodies, RK4."""

    def __init__(self, robot: Robot, commands: Commands, dt: float = 1e-3) -> None:
        import pinocchio

        super().__init__(robot, commands, dt)
        self._pin, p = pinocchio, self.p
        self._to_back = np.array([-p.back.O_x, 0.0, -p.back.O_z])
        self.model = self._model(p.front, p.back, (p.g_x, p.g_y, p.g_z))
        self.data = self.model.createData()
        self._forces = pinocchio.StdVec_Force()
        self._forces.extend([pinocchio.Force.Zero()] * self.model.njoints)
        self._arms: list[tuple[int, Array, Array]] = []

    def _model(self, front: ModuleParams, back: ModuleParams, gravity: tuple[float, float, float]) -> Any:
        """Six joints to the front module, two more to the back one, and four motors of unit inertia that turn alone."""
        pin = self._pin
        model, here = pin.Model(), pin.SE3.Identity()
        model.gravity.linear = np.array(gravity)
        kinds = [pin.JointModelPX, pin.JointModelPY, pin.JointModelPZ, pin.JointModelRZ, pin.JointModelRY]
        parent = 0
        for i, kind in enumerate([*kinds, pin.JointModelRX]):
            parent = model.addJoint(parent, kind(), here, f"front{i}")
        model.appendBodyToJoint(parent, self._inertia(front, np.zeros(3)), here)
        joint = pin.SE3(np.eye(3), np.array([front.O_x, 0.0, front.O_z]))
        parent = model.addJoint(parent, pin.JointModelRZ(), joint, "yaw")
        parent = model.addJoint(parent, pin.JointModelRX(), here, "roll")
        model.appendBodyToJoint(parent, self._inertia(back, self._to_back), here)
        for i in range(4):
            motor = model.addJoint(0, pin.JointModelRY(), here, f"motor{i}")
            model.appendBodyToJoint(motor, pin.Inertia(1.0, np.zeros(3), np.eye(3)), here)
        return model

    def _inertia(self, module: ModuleParams, centre: Array) -> Any:
        return self._pin.Inertia(module.m, centre, np.diag([module.J_x, module.J_y, module.J_z]))

    def look(self, q: Array, v: Array) -> list[tuple[Array, Array, Array, Array]]:
        """Origin, rotation, velocity and angular velocity of both modules in `map`."""
        pin = self._pin
        pin.forwardKinematics(self.model, self.data, q, v)
        places, self._arms = [], []
        for joint, offset in ((FRONT, np.zeros(3)), (BACK, self._to_back)):
            place = self.data.oMi[joint]
            rotation = place.rotation
            speed = pin.getVelocity(self.model, self.data, joint, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
            arm, turn = rotation @ offset, speed.angular
            places.append((place.translation + arm, rotation, speed.linear + np.cross(turn, arm), turn))
            self._arms.append((joint, rotation, arm))
        return places

    def solve(self, q: Array, v: Array, torque: Array, wrench: Array) -> Array:
        """Accelerations at what `look` was given last."""
        for (joint, rotation, arm), acting in zip(self._arms, wrench, strict=True):
            force, moment = acting[:3], acting[3:]
            self._forces[joint] = self._pin.Force(rotation.T @ force, rotation.T @ (moment + np.cross(arm, force)))
        return np.array(self._pin.aba(self.model, self.data, q, v, torque, self._forces))
