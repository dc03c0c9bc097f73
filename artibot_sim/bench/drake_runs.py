"""The same rover in Drake: its articulated-body algorithm, the paper's contact law beside it (see `law_bodies`)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from artibot_sim.bench.law_bodies import StagedRun
from artibot_sim.model import Commands, Robot
from artibot_sim.model.param_types import ModuleParams

Array = NDArray[np.float64]

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

    def look(self, q: Array, v: Array) -> list[tuple[Array, Array, Array, Array]]:
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
        """Accelerations at what `look` was given last."""
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
