"""Robots of any number of modules: what a module more costs, what the two-module kernels gain, the same in MuJoCo."""

from __future__ import annotations

import dataclasses
import math
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from artibot_sim.bench import mujoco_peer as law
from artibot_sim.bench.model import Scenario, distance
from artibot_sim.bench.results import Result, repeat
from artibot_sim.model import Commands, initial_state, load_robot, rollout
from artibot_sim.model.equations.transmission import torque_factors
from artibot_sim.model.kernels.layout import Grid
from artibot_sim.model.robot.derived import train
from artibot_sim.model.robot.parameters import Train
from artibot_sim.model.robot.robot import Robot, module_name
from artibot_sim.model.simulate import trains
from artibot_sim.model.simulate.rollout import default_modes

Array = NDArray[np.float64]

STEP = 5e-4
"""s, at which RK4 is stable with the free wheels of passive modules."""


def of_modules(count: int) -> Robot:
    """Agri.q with so many modules: those from the third on are train3's, without motors."""
    if count < 3:
        return load_robot("agriq")
    robot = load_robot("train3")
    drive = dataclasses.replace(robot.drive, trailing=robot.drive.trailing * (count - 2))
    return dataclasses.replace(
        robot, name=f"train{count}", trailing=robot.trailing * (count - 2), drive=drive, sources={}
    )


def chain(robot: Robot, commands: Commands, dt: float = STEP) -> trains.Tables:
    """A rollout by the kernels for any number of modules, two included; RK4, rows at the commands' knots."""
    steps, every = round(commands.duration / dt), round(commands.dt / dt)
    modes = trains.by_side(robot, default_modes(robot))
    p = trains.unlimited_beside_prescribed(train(robot), modes)
    inputs = trains.inputs_of(robot, commands, modes, torque_factors(robot))
    tables, _, _ = trains.run(robot, p, inputs, initial_state(robot), Grid(dt, steps, every, every), "rk4", False)
    return tables


def modules(scenario: Scenario) -> list[Result]:
    """Steps per second with 3, 5 and 10 modules, and what the kernels of two modules gain over the general ones."""
    results = []
    for count in (3, 5, 10):
        robot = of_modules(count)
        timing = repeat(partial(chain, robot, scenario.commands), scenario.runs(10), scenario.tick)
        steps = scenario.steps(STEP)
        note = f"one rollout of {count} modules, {scenario.commands.duration:.4g} s, rk4 at {STEP * 1e3:g} ms"
        results.append(
            Result(f"rollout_{count}_modules", steps / timing.best, "steps/s", note, timing.per_second(steps))
        )
    two = repeat(lambda: chain(scenario.robot, scenario.commands, 1e-3), scenario.runs(10), scenario.tick)
    own = repeat(lambda: scenario.rollout("rk4", 1e-3), scenario.runs(10), scenario.tick)
    note = "time of a rollout of two modules by the kernels for any number, over that of their own"
    return [*results, Result("two_modules_own_kernels", two.best / own.best, "x", note)]


# ----------------------------------------------------------------------
# The same robot in MuJoCo: a chain of bodies under the paper's contact law, which Python calls here.
# ----------------------------------------------------------------------

ETA, TORQUE, ETA_NEXT, TORQUE_NEXT = range(4)
"""Rows of what is fed back from step to step, a column a side."""


class Now(NamedTuple):
    """What MuJoCo hands its callbacks, by its own names; `com` is the centre of mass that velocities are about."""

    qpos: Array
    qvel: Array
    xpos: Array
    xmat: Array
    cvel: Array
    com: Array
    qfrc: Array
    xfrc: Array


@njit
def _train_law(n, own, call, fed, command, load, rims, first, now):  # type: ignore[no-untyped-def]
    """Wheel forces and motors of a train, which MuJoCo asks for at every stage of a step.

    `own` is (modules, 9): r_0, half spacings, gear, and share of eq. 30.
    """
    qpos, qvel, xpos, xmat, cvel, com, qfrc, xfrc = now
    stage, step = call % n.stages, call // n.stages
    sides = 2 * len(own)
    if stage == 0:
        for k in range(sides):
            fed[ETA, k], fed[TORQUE, k] = fed[ETA_NEXT, k], fed[TORQUE_NEXT, k]
    for k in range(sides):
        rims[k] = n.r_w * own[k // 2, 3] * qvel[first + k]
        load[k, 0], load[k, 1] = 0.0, 0.0
    for i in range(len(own)):
        law._module(n, i + 1, 2 * i, own[i, 0], own[i, 1], own[i, 2], rims, xpos, xmat, cvel, com, xfrc, load)
    for k in range(sides):
        _, _, _, tau, eta_d, eta_r, J_m, J_w, share = own[k // 2]
        gear = tau / fed[ETA, k]
        J = J_m + J_w * tau * gear
        speed = qvel[first + k]
        M_r = n.r_w * load[k, 0] + n.u_w * load[k, 1] * math.tanh(tau * speed / 0.02)
        if k < 2:
            d, d_dot, d_ddot = law._command(n, command, stage, step, k)
            acceleration = d_ddot - 2.0 * n.A * (speed - d_dot) - n.A * n.A * (qpos[first + k] - d)
            M_m = J * acceleration + gear * M_r
        else:
            M_m = share * (fed[TORQUE, 0] + fed[TORQUE, 1])
            acceleration = (M_m - gear * M_r) / J
        qfrc[first + k] += acceleration
        if stage == 0:
            fed[ETA_NEXT, k] = eta_d if M_m * speed >= 0.0 else 1.0 / eta_r
            fed[TORQUE_NEXT, k] = M_m


def train_model(robot: Robot, dt: float) -> str:
    """MJCF of the modules as a chain of bodies with two hinges a joint, and of all sides, which turn on their own."""
    p = train(robot)
    body = ""
    for i in range(len(p.modules) - 1, -1, -1):
        m, name = p.modules[i].front, module_name(i)
        inside = law._inertial(m.m, (m.J_x, m.J_y, m.J_z)) + body
        if i == 0:
            body = f'<body name="{name}">{law._SLIDES}{law._HINGES}{inside}</body>'
            continue
        ahead, behind = p.joints[i - 1].front, p.joints[i - 1].back
        at = f"{behind.O_x!r} 0 {behind.O_z!r}"
        hinges = "".join(
            f'<joint name="{axis}_{i}" type="hinge" axis="{direction}" pos="{at}"/>'
            for axis, direction in (("yaw", "0 0 1"), ("roll", "1 0 0"))
        )
        offset = f"{ahead.O_x - behind.O_x!r} 0 {ahead.O_z - behind.O_z!r}"
        body = f'<body name="{name}" pos="{offset}">{hinges}{inside}</body>'
    unit = law._inertial(1.0, (1.0, 1.0, 1.0))
    sides = "".join(
        f'<body name="side_{k}"><joint name="side_{k}" type="hinge" axis="0 1 0"/>{unit}</body>'
        for k in range(2 * len(p.modules))
    )
    g = p.modules[0]
    return f"""<mujoco model="{robot.name}, contact law of the paper">
  <option timestep="{dt!r}" integrator="RK4" gravity="{g.g_x!r} {g.g_y!r} {g.g_z!r}">
    <flag contact="disable" constraint="disable"/>
  </option>
  <worldbody>{body}{sides}</worldbody>
</mujoco>"""


def _numbers(p: Train, commands: Commands, dt: float) -> tuple[Any, Array]:
    """Robot and run as the law takes them, but for each module's own (modules, 8)."""
    n = np.zeros(1, dtype=law.NUMBERS)[0]
    module = p.modules[0]
    for name in ("k_l", "k_t", "mu_s", "mu_d"):
        n[name] = getattr(module.front, name)
    n["k_n"], n["u_w"], n["r_w"], n["A"], n["dt"] = module.k_n, module.u_w, module.right_front.r_w, module.A_motor, dt
    n["stages"], n["knot_steps"], n["knots"] = 4, round(commands.dt / dt), len(commands.velocity)
    own = [(m.front.r_0, m.front.half_x, m.front.half_y, *(m.right_front[:1]), *m.right_front[2:6]) for m in p.modules]
    return n, np.array(own)


def in_mujoco(robot: Robot, commands: Commands) -> law.MujocoRun:
    """A rollout from rest in MuJoCo, RK4, front motors prescribed and those behind under their share (eqs 29, 30)."""
    import mujoco

    p = train(robot)
    model = mujoco.MjModel.from_xml_string(train_model(robot, STEP))
    data = mujoco.MjData(model)
    start = initial_state(robot)
    data.qpos[2] = start.q[2]
    n, own = _numbers(p, commands, STEP)
    own = np.column_stack([own, torque_factors(robot)])
    sides, first = 2 * len(p.modules), 6 + 2 * (len(p.modules) - 1)
    fed, load, rims = np.zeros((4, sides)), np.zeros((sides, 2)), np.zeros(sides)
    fed[ETA_NEXT] = start.eta
    command = np.ascontiguousarray(np.column_stack([commands.position[:, :2], commands.velocity[:, :2]]))
    calls = 0

    def passive(_: Any, now: Any) -> None:
        nonlocal calls
        given = Now(
            now.qpos, now.qvel, now.xpos, now.xmat, now.cvel, now.subtree_com[1], now.qfrc_passive, now.xfrc_applied
        )
        _train_law(n, own, calls, fed, command, load, rims, first, given)
        calls += 1

    steps, every = round(commands.duration / STEP), round(commands.dt / STEP)
    poses = [data.qpos[[0, 1, 3]].copy()]
    mujoco.set_mjcb_passive(passive)
    try:
        for _ in range(steps // every):
            mujoco.mj_step(model, data, every)
            poses.append(data.qpos[[0, 1, 3]].copy())
    finally:
        mujoco.set_mjcb_passive(None)
    return law.MujocoRun(commands.dt * np.arange(len(poses), dtype=np.float64), np.array(poses), steps)


def against_mujoco(scenario: Scenario) -> list[Result]:
    """How far five modules in MuJoCo end from artibot's, with the same law, integrator and step."""
    robot = load_robot("train5")
    ours = rollout(robot, scenario.commands, dt=STEP, every=round(scenario.commands.dt / STEP))
    scenario.tick()
    apart = distance(in_mujoco(robot, scenario.commands).pose, ours.pose)
    note = f"five modules in MuJoCo, {scenario.commands.duration:.4g} s; at the end {apart[-1]:.2g} m from artibot's"
    return [Result("mujoco_train5_difference", float(apart.max()), "m", note)]
