"""The same rover in Pinocchio: its forward dynamics (ABA), the paper's contact law beside it, RK4 around both.

Pinocchio has no integrator and no contact of this kind: like any user of its Python interface one calls `aba` stage by
stage. The law is the compiled one that MuJoCo calls, so what differs is who solves the bodies, and the calls to it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from artibot_sim.bench import mujoco_law as law
from artibot_sim.bench.mujoco_runs import MujocoRun, law_numbers
from artibot_sim.model import Commands, Robot, initial_state
from artibot_sim.model.params import ModuleParams, params

Array = NDArray[np.float64]

FRONT, BACK = 6, 8
"""Joints that carry the modules, as Pinocchio counts them."""


class PinocchioRun:
    """The paper's contact law on Pinocchio's bodies, RK4; call it for a rollout.

    Equivalent and different as :class:`artibot_sim.bench.mujoco_runs.LawRun` says of MuJoCo.
    """

    def __init__(self, robot: Robot, commands: Commands, dt: float = 1e-3) -> None:
        import pinocchio

        self._pin = pinocchio
        self.dt, self.steps, self._every = dt, round(commands.duration / dt), round(commands.dt / dt)
        p = params(robot)
        self._to_back = np.array([-p.back.O_x, 0.0, -p.back.O_z])
        self.model = self._model(p.front, p.back, (p.g_x, p.g_y, p.g_z))
        self.data = self.model.createData()
        self._start = initial_state(robot)
        self._numbers = law_numbers(robot, commands, dt, 4)
        self._command = np.ascontiguousarray(np.column_stack([commands.position[:, :2], commands.velocity[:, :2]]))
        self._memory = np.zeros(law.MEMORY)
        self._scratch = np.zeros((4, 2)), np.zeros(4)
        shapes = {"xpos": (3, 3), "xmat": (3, 9), "cvel": (3, 6), "com": (3, 3), "qfrc": (12,), "xfrc": (3, 6)}
        self._arrays = {name: np.zeros(shape) for name, shape in shapes.items()}
        self._forces = pinocchio.StdVec_Force()
        self._forces.extend([pinocchio.Force.Zero()] * self.model.njoints)

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

    def _acceleration(self, q: Array, v: Array) -> Array:
        pin, a = self._pin, self._arrays
        pin.forwardKinematics(self.model, self.data, q, v)
        a["qfrc"][:] = 0.0
        arms = []
        for body, joint, offset in ((1, FRONT, None), (2, BACK, self._to_back)):
            place = self.data.oMi[joint]
            rotation = place.rotation
            speed = pin.getVelocity(self.model, self.data, joint, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
            linear, angular = speed.linear, speed.angular
            arm = np.zeros(3) if offset is None else rotation @ offset
            a["xpos"][body] = place.translation + arm
            a["xmat"][body] = rotation.ravel()
            common = self.data.oMi[FRONT].translation  # MuJoCo gives all velocities at one point
            a["cvel"][body, :3], a["cvel"][body, 3:] = angular, linear + np.cross(angular, common - place.translation)
            arms.append((body, joint, rotation, arm))
        load, rims = self._scratch
        a["com"][law.FRONT] = a["xpos"][law.FRONT]
        law.apply(
            self._numbers, self._memory, self._command, load, rims, q, v, a["xpos"], a["xmat"], a["cvel"], a["com"],
            a["qfrc"], a["xfrc"],
        )  # fmt: skip
        for body, joint, rotation, arm in arms:
            force, moment = a["xfrc"][body, :3], a["xfrc"][body, 3:]
            self._forces[joint] = pin.Force(rotation.T @ force, rotation.T @ (moment + np.cross(arm, force)))
        return np.array(pin.aba(self.model, self.data, q, v, a["qfrc"], self._forces))

    def __call__(self) -> MujocoRun:
        """One rollout from rest."""
        q, v, h = np.zeros(12), np.zeros(12), self.dt
        q[2] = self._start.q[2]
        self._memory[:] = 0.0
        n = self._numbers[0]
        self._memory[law.ETA_NEXT : law.ETA_NEXT + 4] = [n["eta_d_f"]] * 2 + [n["eta_d_b"]] * 2
        rows = [q[[0, 1, 3]]]
        for step in range(1, self.steps + 1):
            a1 = self._acceleration(q, v)
            v2 = v + 0.5 * h * a1
            a2 = self._acceleration(q + 0.5 * h * v, v2)
            v3 = v + 0.5 * h * a2
            a3 = self._acceleration(q + 0.5 * h * v2, v3)
            v4 = v + h * a3
            a4 = self._acceleration(q + h * v3, v4)
            q = q + h / 6.0 * (v + 2.0 * v2 + 2.0 * v3 + v4)
            v = v + h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
            if step % self._every == 0:
                rows.append(q[[0, 1, 3]])
        return MujocoRun(np.arange(len(rows), dtype=np.float64) * self._every * h, np.array(rows), self.steps)
