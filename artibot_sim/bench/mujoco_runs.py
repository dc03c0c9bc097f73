"""Rollouts in MuJoCo, with the outputs kept that `rollout` keeps: state and pose at 100 Hz."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from artibot_sim.bench import mujoco_law as law
from artibot_sim.bench.mujoco_models import law_model, native_model
from artibot_sim.model import Commands, Robot, initial_state
from artibot_sim.model.params import params
from artibot_sim.model.robot import WHEELS
from artibot_sim.model.transmission import back_torque_factor

Array = NDArray[np.float64]

STAGES = {"RK4": 4, "Euler": 1, "implicitfast": 1}
"""Evaluations of the forces in a step of each integrator of MuJoCo."""


@dataclass(frozen=True)
class MujocoRun:
    """A rollout: times (n,), poses x, y, yaw of the front module (n, 3), m and rad."""

    t: Array
    pose: Array
    steps: int


def _kept(steps: int, every: int) -> int:
    if steps % every:
        raise ValueError(f"{steps} steps are not a multiple of {every}")
    return steps // every


class LawRun:
    """The paper's contact law on MuJoCo's bodies; call it for a rollout.

    Equivalent to artibot's model: masses and inertias of eq. 9, the joint, contact, transmission, prescribed front
    motors, shared back torque. Different: MuJoCo solves the rigid bodies without eq. 8's simplification (which shows
    only when they roll or pitch), the joint in minimal coordinates, and friction acts on the modules' full rotation.
    """

    def __init__(self, robot: Robot, commands: Commands, dt: float = 1e-3, integrator: str = "RK4") -> None:
        import mujoco

        self._mujoco = mujoco
        self.model = mujoco.MjModel.from_xml_string(law_model(robot, dt, integrator))
        self.data = mujoco.MjData(self.model)
        self.steps = round(commands.duration / dt)
        self._every = round(commands.dt / dt)
        self._start = initial_state(robot)
        self._numbers = law_numbers(robot, commands, dt, STAGES[integrator])
        self._memory = np.zeros(law.MEMORY)
        command = np.ascontiguousarray(np.column_stack([commands.position[:, :2], commands.velocity[:, :2]]))
        self._function, self._held = law.callback(self.data, self._numbers, self._memory, command)

    def __call__(self) -> MujocoRun:
        """One rollout from rest; the callback is installed for its time only."""
        mujoco, model, data = self._mujoco, self.model, self.data
        mujoco.mj_resetData(model, data)
        data.qpos[2] = self._start.q[2]
        self._memory[:] = 0.0
        drives = self._numbers[0]
        self._memory[law.ETA_NEXT : law.ETA_NEXT + 4] = [drives["eta_d_f"]] * 2 + [drives["eta_d_b"]] * 2
        every, rows = self._every, _kept(self.steps, self._every)
        qpos, qvel = np.empty((rows + 1, model.nq)), np.empty((rows + 1, model.nv))
        qpos[0], qvel[0] = data.qpos, data.qvel
        mujoco.set_mjcb_passive(self._function)
        try:
            for row in range(1, rows + 1):
                mujoco.mj_step(model, data, every)
                qpos[row], qvel[row] = data.qpos, data.qvel
        finally:
            mujoco.set_mjcb_passive(None)
        expected = self.steps * int(drives["stages"])
        if self._memory[law.CALLS] != expected:
            raise RuntimeError(f"MuJoCo evaluated the forces {self._memory[law.CALLS]:g} times, not {expected}")
        return MujocoRun(np.arange(rows + 1) * every * model.opt.timestep, qpos[:, [0, 1, 3]], self.steps)


def law_numbers(robot: Robot, commands: Commands, dt: float, stages: int) -> NDArray[Any]:
    """Robot and run as the compiled law takes them."""
    p = params(robot)
    numbers = np.zeros(1, dtype=law.NUMBERS)
    n = numbers[0]
    for source, names in ((p, ("k_n", "u_w")), (p.front, ("k_l", "k_t", "mu_s", "mu_d")), (p.right_front, ("r_w",))):
        for name in names:
            n[name] = getattr(source, name)
    n["A"], n["share"], n["dt"] = p.A_motor, back_torque_factor(robot), dt
    for end, body, motor in (("f", p.front, p.right_front), ("b", p.back, p.right_back)):
        n[f"r_0_{end}"], n[f"x_{end}"], n[f"y_{end}"] = body.r_0, body.half_x, body.half_y
        for name in ("tau", "eta_d", "eta_r", "J_m", "J_w"):
            n[f"{name}_{end}"] = getattr(motor, name)
    n["stages"], n["knot_steps"], n["knots"] = stages, round(commands.dt / dt), len(commands.velocity)
    return numbers


class NativeRun:
    """MuJoCo with its own contacts and friction, as a user would set it up; call it for a rollout.

    Equivalent: masses, geometry, joint, wheel inertias, commanded front speeds, the torque sharing (here at 100 Hz
    from the ground's torque on the front wheels). Different: MuJoCo's regularised Coulomb friction with the one
    coefficient mu_s instead of eqs 15 and 16, forces at the ground instead of the wheel centres, MuJoCo's contact
    softness instead of k_n.
    """

    def __init__(self, robot: Robot, commands: Commands, dt: float = 1e-3, integrator: str = "RK4") -> None:
        import mujoco

        self._mujoco = mujoco
        self.model = mujoco.MjModel.from_xml_string(native_model(robot, dt, integrator))
        self.data = mujoco.MjData(self.model)
        self.steps = round(commands.duration / dt)
        self._every = round(commands.dt / dt)
        self._p, self._share = params(robot), back_torque_factor(robot)
        mean = 0.5 * (commands.velocity[:-1, :2] + commands.velocity[1:, :2])
        self._lead = np.repeat(mean * self._p.right_front.tau, 2, axis=1)  # wheel speeds through each interval
        self._dofs = [int(self.model.joint(wheel).dofadr[0]) for wheel in WHEELS]

    def __call__(self) -> MujocoRun:
        """One rollout from rest."""
        mujoco, model, data = self._mujoco, self.model, self.data
        mujoco.mj_resetData(model, data)
        mujoco.mj_forward(model, data)
        every, rows = self._every, _kept(self.steps, self._every)
        qpos, qvel = np.empty((rows + 1, model.nq)), np.empty((rows + 1, model.nv))
        qpos[0], qvel[0] = data.qpos, data.qvel
        for row in range(1, rows + 1):
            data.ctrl[:4] = self._lead[row - 1]
            data.ctrl[4:] = self._back_torques()
            mujoco.mj_step(model, data, every)
            qpos[row], qvel[row] = data.qpos, data.qvel
        return MujocoRun(np.arange(rows + 1) * every * model.opt.timestep, qpos[:, [0, 1, 3]], self.steps)

    def _back_torques(self) -> list[float]:
        """Torques on the four back wheels (N m): eq. 30 from what the ground does to the front wheels."""
        p, force, speed = self._p, self.data.qfrc_constraint, self.data.qvel
        rolling = 2 * p.u_w * p.front.m * -p.g_z / 4
        total = 0.0
        for a, b in (self._dofs[0:2], self._dofs[2:4]):
            M_r = -(force[a] + force[b]) + rolling * np.tanh(speed[a] / 0.02)
            motor = p.right_front
            total += motor.tau * M_r * (1 / motor.eta_d if M_r * speed[a] >= 0 else motor.eta_r)
        torques = []
        for dof in (self._dofs[4], self._dofs[6]):
            motor, M_m = p.right_back, self._share * total
            eta = motor.eta_d if M_m * speed[dof] >= 0 else 1 / motor.eta_r
            own = eta * M_m / motor.tau - 2 * p.u_w * p.back.m * -p.g_z / 4 * np.tanh(speed[dof] / 0.02)
            torques += [0.5 * own] * 2
        return torques
