"""Peers of the model in Pinocchio, Drake and PyBullet: an articulated rover with the paper's contact law."""

from __future__ import annotations

import tempfile
from abc import ABC, abstractmethod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from artibot_sim.bench import mujoco_peer as law
from artibot_sim.bench.mujoco_peer import MujocoRun, law_numbers
from artibot_sim.model import Commands, Robot, initial_state
from artibot_sim.model.robot.derived import params
from artibot_sim.model.robot.parameters import ModuleParams

# ----------------------------------------------------------------------
# The paper's contact law on the bodies of a library that is called from Python, RK4 around both.
#
# Like any user of such a library's interface one calls its forward dynamics stage by stage. The law is the compiled
# one that MuJoCo calls, so what differs is who solves the bodies, and the calls to it.
# ----------------------------------------------------------------------


Array = NDArray[np.float64]

BODIES = (law.FRONT, law.BACK)


class LawOnBodies(ABC):
    """The paper's contact law on somebody's bodies.

    Equivalent and different as :class:`artibot_sim.bench.mujoco_peer.LawRun` says of MuJoCo. Coordinates are x, y, z,
    gamma, beta, alpha of the front module, yaw and roll of the joint, and four motors of unit inertia that turn alone.
    """

    def __init__(self, robot: Robot, commands: Commands, dt: float = 1e-3, stages: int = 4) -> None:
        self.dt, self.steps, self.every = dt, round(commands.duration / dt), round(commands.dt / dt)
        self.p = params(robot)
        self._height = float(initial_state(robot).q[2])
        self._numbers = law_numbers(robot, commands, dt, stages)
        self._command = np.ascontiguousarray(np.column_stack([commands.position[:, :2], commands.velocity[:, :2]]))
        self._memory = np.zeros(law.MEMORY)
        self._scratch = np.zeros((4, 2)), np.zeros(4)
        shapes = {"xpos": (3, 3), "xmat": (3, 9), "cvel": (3, 6), "com": (3, 3), "qfrc": (12,), "xfrc": (3, 6)}
        self.arrays = {name: np.zeros(shape) for name, shape in shapes.items()}

    @abstractmethod
    def bodies_at(self, q: Array, v: Array) -> list[tuple[Array, Array, Array, Array]]:
        """Origin (m), rotation (3, 3), velocity (m/s) and angular velocity (rad/s) of both modules in `map`."""

    def forces(self, q: Array, v: Array) -> tuple[Array, Array]:
        """What the law does: generalised forces (12,), and forces and moments at the modules' origins (2, 6)."""
        a = self.arrays
        places = self.bodies_at(q, v)
        common = places[0][0]  # MuJoCo gives all velocities at one point
        for body, (origin, rotation, velocity, turn) in zip(BODIES, places, strict=True):
            a["xpos"][body], a["xmat"][body], a["cvel"][body, :3] = origin, rotation.ravel(), turn
            a["cvel"][body, 3:] = velocity + np.cross(turn, common - origin)
        a["com"][law.FRONT], a["qfrc"][:] = common, 0.0
        law.apply(
            self._numbers, self._memory, self._command, *self._scratch, q, v, a["xpos"], a["xmat"], a["cvel"],
            a["com"], a["qfrc"], a["xfrc"],
        )  # fmt: skip
        return a["qfrc"], a["xfrc"][1:]

    def at_rest(self) -> tuple[Array, Array]:
        """Coordinates and rates of a start from rest, with nothing fed back."""
        q, drives = np.zeros(12), self._numbers[0]
        q[2] = self._height
        self._memory[:] = 0.0
        self._memory[law.ETA_NEXT : law.ETA_NEXT + 4] = [drives["eta_d_f"]] * 2 + [drives["eta_d_b"]] * 2
        return q, np.zeros(12)

    def run(self, rows: list[Any]) -> MujocoRun:
        """What came of it; `rows` are poses at the knots."""
        return MujocoRun(np.arange(len(rows), dtype=np.float64) * self.every * self.dt, np.array(rows), self.steps)


class StagedRun(LawOnBodies):
    """A rollout with the paper's contact law and RK4 around another library's forward dynamics; call it to run."""

    @abstractmethod
    def solve(self, q: Array, v: Array, torque: Array, wrench: Array) -> Array:
        """Accelerations (12,) under generalised forces `torque` (12,), and forces and moments (2, 6) at the origins."""

    def _acceleration(self, q: Array, v: Array) -> Array:
        return self.solve(q, v, *self.forces(q, v))

    def __call__(self) -> MujocoRun:
        """One rollout from rest."""
        (q, v), h = self.at_rest(), self.dt
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
            if step % self.every == 0:
                rows.append(q[[0, 1, 3]])
        return self.run(rows)


# ----------------------------------------------------------------------
# The same rover in Drake: its articulated-body algorithm, the paper's contact law beside it (see `LawOnBodies`).
# ----------------------------------------------------------------------


AXES = np.eye(3)


class DrakeRun(StagedRun):
    """The paper's contact law on Drake's bodies, RK4."""

    def __init__(self, robot: Robot, commands: Commands, dt: float = 1e-3) -> None:
        from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant

        super().__init__(robot, commands, dt)
        self.plant = MultibodyPlant(time_step=0.0)
        p = self.p
        self.plant.mutable_gravity_field().set_gravity_vector([p.g_x, p.g_y, p.g_z])
        self._joints = self._model()
        self.plant.Finalize()
        self._context = self.plant.CreateDefaultContext()
        self._q = np.array([joint.position_start() for joint in self._joints])
        self._v = np.array([joint.velocity_start() for joint in self._joints])
        self._bodies = [self.plant.GetBodyByName(name) for name in ("front", "back")]
        self._pushes = []
        for body in self._bodies:
            push = ExternallyAppliedSpatialForce()
            push.body_index, push.p_BoBq_B = body.index(), np.zeros(3)
            self._pushes.append(push)

    def _model(self) -> list[Any]:
        """Six joints to the front module, two more to the back one, and four motors of unit inertia that turn alone."""
        from pydrake.math import RigidTransform
        from pydrake.multibody.tree import PrismaticJoint, RevoluteJoint, SpatialInertia

        plant, p, joints = self.plant, self.p, []

        def add(name: str, kind: Any, axis: int, parent: Any, body: Any, at: Any = None, of: Any = None) -> Any:
            joints.append(plant.AddJoint(kind(name, parent.body_frame(), body.body_frame(), AXES[axis])
                                         if at is None and of is None else kind(name, at, of, AXES[axis])))  # fmt: skip
            return body

        parent = plant.world_body()
        kinds = [(PrismaticJoint, 0), (PrismaticJoint, 1), (PrismaticJoint, 2), (RevoluteJoint, 2), (RevoluteJoint, 1)]
        for i, (kind, axis) in enumerate(kinds):
            parent = add(f"front{i}", kind, axis, parent, plant.AddRigidBody(f"between{i}", SpatialInertia.Zero()))
        front = add("front5", RevoluteJoint, 0, parent, plant.AddRigidBody("front", _inertia(p.front)))
        cross = plant.AddRigidBody("cross", SpatialInertia.Zero())
        back = plant.AddRigidBody("back", _inertia(p.back))
        ends = [
            plant.AddFrame(_fixed(f"joint_{body.name()}", body, RigidTransform([module.O_x, 0.0, module.O_z])))
            for body, module in ((front, p.front), (back, p.back))
        ]
        add("yaw", RevoluteJoint, 2, front, cross, ends[0], cross.body_frame())
        add("roll", RevoluteJoint, 0, cross, back, cross.body_frame(), ends[1])
        unit = SpatialInertia.SolidSphereWithMass(1.0, np.sqrt(2.5))  # 1 kg m² about every axis
        for i in range(4):
            add(f"motor{i}", RevoluteJoint, 1, plant.world_body(), plant.AddRigidBody(f"motor{i}", unit))
        return joints

    def bodies_at(self, q: Array, v: Array) -> list[tuple[Array, Array, Array, Array]]:
        """Origin, rotation, velocity and angular velocity of both modules in `map`."""
        plant, state = self.plant, np.empty(24)
        state[self._q], state[12 + self._v] = q, v
        plant.SetPositionsAndVelocities(self._context, state)
        places = []
        for body in self._bodies:
            pose = plant.EvalBodyPoseInWorld(self._context, body)
            velocity = plant.EvalBodySpatialVelocityInWorld(self._context, body)
            places.append(
                (pose.translation(), pose.rotation().matrix(), velocity.translational(), velocity.rotational())
            )
        return places

    def solve(self, q: Array, v: Array, torque: Array, wrench: Array) -> Array:
        """Accelerations at what `bodies_at` was given last."""
        from pydrake.multibody.math import SpatialForce

        plant, forces = self.plant, np.empty(12)
        forces[self._v] = torque
        for push, acting in zip(self._pushes, wrench, strict=True):
            push.F_Bq_W = SpatialForce(tau=acting[3:], f=acting[:3])
        plant.get_applied_generalized_force_input_port().FixValue(self._context, forces)
        plant.get_applied_spatial_force_input_port().FixValue(self._context, self._pushes)
        found: Array = plant.get_generalized_acceleration_output_port().Eval(self._context)[self._v]
        return found


def _inertia(module: ModuleParams) -> Any:
    from pydrake.multibody.tree import RotationalInertia, SpatialInertia

    turning = RotationalInertia(module.J_x, module.J_y, module.J_z)
    return SpatialInertia.MakeFromCentralInertia(module.m, np.zeros(3), turning)


def _fixed(name: str, body: Any, at: Any) -> Any:
    from pydrake.multibody.tree import FixedOffsetFrame

    return FixedOffsetFrame(name, body.body_frame(), at)


# ----------------------------------------------------------------------
# The same rover in Pinocchio: its forward dynamics (ABA), the paper's contact law beside it (see `LawOnBodies`).
# ----------------------------------------------------------------------


FRONT, PINOCCHIO_BACK = 6, 8
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

    def bodies_at(self, q: Array, v: Array) -> list[tuple[Array, Array, Array, Array]]:
        """Origin, rotation, velocity and angular velocity of both modules in `map`."""
        pin = self._pin
        pin.forwardKinematics(self.model, self.data, q, v)
        places, self._arms = [], []
        for joint, offset in ((FRONT, np.zeros(3)), (PINOCCHIO_BACK, self._to_back)):
            place = self.data.oMi[joint]
            rotation = place.rotation
            speed = pin.getVelocity(self.model, self.data, joint, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
            arm, turn = rotation @ offset, speed.angular
            places.append((place.translation + arm, rotation, speed.linear + np.cross(turn, arm), turn))
            self._arms.append((joint, rotation, arm))
        return places

    def solve(self, q: Array, v: Array, torque: Array, wrench: Array) -> Array:
        """Accelerations at what `bodies_at` was given last."""
        for (joint, rotation, arm), acting in zip(self._arms, wrench, strict=True):
            force, moment = acting[:3], acting[3:]
            self._forces[joint] = self._pin.Force(rotation.T @ force, rotation.T @ (moment + np.cross(arm, force)))
        return np.array(self._pin.aba(self.model, self.data, q, v, torque, self._forces))


# ----------------------------------------------------------------------
# The same rover in PyBullet: its multi-body and its own step, the paper's contact law beside it (see
# `LawOnBodies`).
#
# PyBullet does not hand out accelerations, so there is no RK4 around it: forces go in and it makes a step of
# Euler's symplectic method. The motors turn alone, so they are stepped here, by the same method.
# ----------------------------------------------------------------------


CROSS, PYBULLET_BACK = 0, 1
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
            for link, acting in zip((-1, PYBULLET_BACK), wrench, strict=True):
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
        for link in (-1, CROSS, PYBULLET_BACK):
            bullet.changeDynamics(
                rover, link, linearDamping=0.0, angularDamping=0.0, jointDamping=0.0, maxJointVelocity=1e6,
                activationState=bullet.ACTIVATION_STATE_DISABLE_SLEEPING, physicsClientId=world,
            )  # fmt: skip
        for joint in (CROSS, PYBULLET_BACK):
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

    def bodies_at(self, q: Array, v: Array) -> list[tuple[Array, Array, Array, Array]]:
        """Origin, rotation, velocity and angular velocity of both modules in `map`, as PyBullet has them."""
        bullet, rover, world = self._bullet, self._rover, self._world
        place, turned = bullet.getBasePositionAndOrientation(rover, world)
        linear, angular = bullet.getBaseVelocity(rover, world)
        link = bullet.getLinkState(rover, PYBULLET_BACK, 1, 1, physicsClientId=world)
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
