"""Peer of the model in MuJoCo: with the paper's contact law as a compiled callback, and with MuJoCo's own contacts."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import carray, cfunc, njit, types
from numba.extending import intrinsic
from numpy.typing import NDArray

from artibot_sim.errors import ArtibotError
from artibot_sim.model import Commands, Ground, initial_state
from artibot_sim.model.equations.transmission import back_torque_factor
from artibot_sim.model.robot.derived import params
from artibot_sim.model.robot.parameters import ModuleParams, Params
from artibot_sim.model.robot.robot import MOTORS, WHEELS, Module, Robot

# ----------------------------------------------------------------------
# The paper's contact law as a compiled C callback of MuJoCo (``mjcb_passive``), apart from artibot's own kernel.
#
# MuJoCo moves the bodies; this adds, at every evaluation, the wheels' forces (eqs 15 to 20), the motors (21 to 23),
# prescribed front motors (26 to 28) and the shared back torque (29, 30). Only what MuJoCo already holds is read, at
# the addresses of its arrays, which stay where they are as long as the ``MjData`` lives; the C arguments of the
# callback are not looked at, so no layout of a C struct is assumed.
# ----------------------------------------------------------------------


Array = NDArray[np.float64]

ARRAYS = ("qpos", "qvel", "xpos", "xmat", "cvel", "subtree_com", "qfrc_passive", "xfrc_applied")
"""Arrays of ``MjData`` that the law reads, and writes to the last two."""

# Places in `memory`
CALLS, ETA, TORQUE, ETA_NEXT, TORQUE_NEXT, MEMORY = 0, 1, 5, 9, 13, 17

FRONT, BACK, MOTOR = 1, 2, 8
"""Bodies of the modules, and the first motor's degree of freedom."""

NUMBERS = np.dtype(
    [
        (name, np.float64)
        for name in (
            "k_n", "k_l", "k_t", "mu_s", "mu_d", "u_w", "r_w", "A", "share", "dt",
            "r_0_f", "x_f", "y_f", "tau_f", "eta_d_f", "eta_r_f", "J_m_f", "J_w_f",
            "r_0_b", "x_b", "y_b", "tau_b", "eta_d_b", "eta_r_b", "J_m_b", "J_w_b",
        )
    ]
    + [(name, np.int64) for name in ("stages", "knot_steps", "knots")],
    align=True,
)  # fmt: skip
"""The robot and the run, as the callback takes them."""


def _to_pointer(typing_context, address):  # type: ignore[no-untyped-def]  # numba's own form
    def generate(context, builder, signature, args):  # type: ignore[no-untyped-def]
        return builder.inttoptr(args[0], context.get_value_type(signature.return_type))

    return types.voidptr(types.int64), generate


_at: Any = intrinsic(_to_pointer)
"""A number as a C pointer, inside compiled code."""


@njit
def _command(n, command, stage, step, motor):  # type: ignore[no-untyped-def]
    """Angle, speed and acceleration of a front motor now: the cubic between two knots of (angle, speed)."""
    s = step % n.knot_steps * n.dt + (0.0 if stage == 0 else n.dt if stage == 3 else 0.5 * n.dt)
    i = min(step // n.knot_steps, n.knots - 1)
    j = min(i + 1, n.knots - 1)
    if i == j:
        return command[i, motor], 0.0, 0.0
    h = n.knot_steps * n.dt
    rise = (command[j, motor] - command[i, motor]) / h
    a, b = command[i, 2 + motor], command[j, 2 + motor]
    c, d = (3.0 * rise - 2.0 * a - b) / h, (a + b - 2.0 * rise) / (h * h)
    return command[i, motor] + s * (a + s * (c + s * d)), a + s * (2.0 * c + 3.0 * s * d), 2.0 * c + 6.0 * s * d


@njit
def _module(n, body, base, r_0, half_x, half_y, rims, xpos, xmat, cvel, com, xfrc, load):  # type: ignore[no-untyped-def]
    """Contact wrench on one module into `xfrc`; sums of F_l and F_n of each side into `load` (4, 2)."""
    R = xmat[body]
    c_b = math.sqrt(R[0] * R[0] + R[3] * R[3])
    c_g, s_g = R[0] / c_b, R[3] / c_b
    s_a, c_a = R[7] / c_b, R[8] / c_b
    w_x, w_y, w_z = cvel[body, 0], cvel[body, 1], cvel[body, 2]
    r_x, r_y, r_z = xpos[body, 0] - com[0], xpos[body, 1] - com[1], xpos[body, 2] - com[2]
    x_dot = cvel[body, 3] + w_y * r_z - w_z * r_y
    y_dot = cvel[body, 4] + w_z * r_x - w_x * r_z
    z_dot = cvel[body, 5] + w_x * r_y - w_y * r_x
    v_x, v_y = c_g * x_dot + s_g * y_dot, c_g * y_dot - s_g * x_dot
    alpha_dot = (c_g * w_x + s_g * w_y) / c_b
    gamma_dot = w_z - alpha_dot * R[6]  # R[6] is −sin(beta)
    f_x, f_y, f_z, m_a, m_g = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(4):
        x, y = (half_x if i % 2 == 0 else -half_x), (-half_y if i < 2 else half_y)
        p_x = v_x - gamma_dot * y * c_a
        p_y = c_a * (v_y + gamma_dot * x) + s_a * z_dot
        F_n = max(n.k_n * (r_0 - xpos[body, 2] - y * s_a), 0.0)
        F_l, F_t = n.k_l * (rims[base + i // 2] - p_x), -n.k_t * p_y
        F_h = math.sqrt(F_l * F_l + F_t * F_t)
        if F_h > n.mu_s * F_n:
            F_l, F_t = F_l * n.mu_d * F_n / F_h, F_t * n.mu_d * F_n / F_h
        load[base + i // 2, 0] += F_l
        load[base + i // 2, 1] += F_n
        across = F_t * c_a - F_n * s_a
        f_x += F_l
        f_y += across
        f_z += F_t * s_a + F_n * c_a
        m_a += y * F_n
        m_g += (x + n.u_w) * across - y * c_a * F_l
    xfrc[body, 0], xfrc[body, 1], xfrc[body, 2] = c_g * f_x - s_g * f_y, s_g * f_x + c_g * f_y, f_z
    xfrc[body, 3], xfrc[body, 4], xfrc[body, 5] = c_g * m_a, s_g * m_a, m_g


@njit
def _law(n, memory, command, load, rims, qpos, qvel, xpos, xmat, cvel, com, qfrc, xfrc):  # type: ignore[no-untyped-def]
    """All forces of one evaluation. Motors have unit inertia in MuJoCo, so their force is their acceleration."""
    call = int(memory[CALLS])
    stage, step = call % n.stages, call // n.stages
    memory[CALLS] += 1.0
    if stage == 0:  # what the step before fed back (Fig. 7) holds through this one
        for k in range(8):
            memory[ETA + k] = memory[ETA_NEXT + k]
    back_torque = n.share * (memory[TORQUE] + memory[TORQUE + 1])
    for motor in range(4):
        tau = n.tau_f if motor < 2 else n.tau_b
        rims[motor] = n.r_w * tau * qvel[MOTOR + motor]
        load[motor, 0], load[motor, 1] = 0.0, 0.0
    _module(n, FRONT, 0, n.r_0_f, n.x_f, n.y_f, rims, xpos, xmat, cvel, com[FRONT], xfrc, load)
    _module(n, BACK, 2, n.r_0_b, n.x_b, n.y_b, rims, xpos, xmat, cvel, com[FRONT], xfrc, load)
    for motor in range(4):
        front = motor < 2
        tau, J_m, J_w = (n.tau_f, n.J_m_f, n.J_w_f) if front else (n.tau_b, n.J_m_b, n.J_w_b)
        gear = tau / memory[ETA + motor]
        J = J_m + J_w * tau * gear
        speed = qvel[MOTOR + motor]
        omega = tau * speed
        M_r = n.r_w * load[motor, 0] + n.u_w * load[motor, 1] * math.tanh(omega / 0.02)
        if front:
            d, d_dot, d_ddot = _command(n, command, stage, step, motor)
            acceleration = d_ddot - 2.0 * n.A * (speed - d_dot) - n.A * n.A * (qpos[MOTOR + motor] - d)
            M_m = J * acceleration + gear * M_r
        else:
            M_m = back_torque
            acceleration = (M_m - gear * M_r) / J
        qfrc[MOTOR + motor] += acceleration
        if stage == 0:
            drives = M_m * speed >= 0.0
            eta_d, eta_r = (n.eta_d_f, n.eta_r_f) if front else (n.eta_d_b, n.eta_r_b)
            memory[ETA_NEXT + motor] = eta_d if drives else 1.0 / eta_r
            memory[TORQUE_NEXT + motor] = M_m


@njit
def apply(n, memory, command, load, rims, qpos, qvel, xpos, xmat, cvel, com, qfrc, xfrc):  # type: ignore[no-untyped-def]
    """The law for whoever holds MuJoCo's arrays as arrays; `n` is NUMBERS (1,)."""
    _law(n[0], memory, command, load, rims, qpos, qvel, xpos, xmat, cvel, com, qfrc, xfrc)


def callback(data: Any, numbers: NDArray[Any], memory: Array, command: Array) -> tuple[Callable[..., None], list[Any]]:
    """The law as a C function for ``mujoco.set_mjcb_passive``, bound to one ``MjData``.

    Parameters
    ----------
    data : mujoco.MjData
    numbers : array of NUMBERS, shape (1,)
    memory : array, shape (MEMORY,)
        Calls so far, and what is fed back from step to step.
    command : array, shape (knots, 4)
        Angles and then speeds of the two front motors, rad and rad/s.

    Returns
    -------
    function, list
        The C function, and what must live as long as it is used.
    """
    scratch = (np.zeros((4, 2)), np.zeros(4))
    held = [data, numbers, memory, command, *scratch]
    arrays = [getattr(data, name) for name in ARRAYS]
    n_p, memory_p, command_p, load_p, rims_p, *p = (
        a.ctypes.data for a in (numbers, memory, command, *scratch, *arrays)
    )
    qpos_p, qvel_p, xpos_p, xmat_p, cvel_p, com_p, qfrc_p, xfrc_p = p
    knots, bodies, dofs = len(command), len(data.xpos), len(data.qvel)

    @cfunc(types.void(types.voidptr, types.voidptr))
    def passive(_model, _data):  # type: ignore[no-untyped-def]
        _law(
            carray(_at(n_p), (1,), NUMBERS)[0],
            carray(_at(memory_p), (MEMORY,), np.float64), carray(_at(command_p), (knots, 4), np.float64),
            carray(_at(load_p), (4, 2), np.float64), carray(_at(rims_p), (4,), np.float64),
            carray(_at(qpos_p), (dofs,), np.float64), carray(_at(qvel_p), (dofs,), np.float64),
            carray(_at(xpos_p), (bodies, 3), np.float64), carray(_at(xmat_p), (bodies, 9), np.float64),
            carray(_at(cvel_p), (bodies, 6), np.float64), carray(_at(com_p), (bodies, 3), np.float64),
            carray(_at(qfrc_p), (dofs,), np.float64), carray(_at(xfrc_p), (bodies, 6), np.float64),
        )  # fmt: skip

    function = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p)(passive.address or 0)
    return function, [*held, passive]


# ----------------------------------------------------------------------
# Agri.q for MuJoCo, generated from the robot file: one model for the paper's contact law, one with MuJoCo's own.
# ----------------------------------------------------------------------


GRIP = 1e3
"""Armature (kg m²) that lets a velocity actuator lead a front wheel whatever the ground does; a light wheel under a
stiff actuator gives a pose that depends on the step."""

LEAD_RATE = 100.0
"""How fast a front wheel takes up a commanded speed, 1/s."""

_SLIDES = "".join(f'<joint name="f_{axis}" type="slide" axis="{v}"/>' for axis, v in
                  (("x", "1 0 0"), ("y", "0 1 0"), ("z", "0 0 1")))  # fmt: skip
_HINGES = "".join(f'<joint name="f_{angle}" type="hinge" axis="{v}"/>' for angle, v in
                  (("gamma", "0 0 1"), ("beta", "0 1 0"), ("alpha", "1 0 0")))  # fmt: skip


def _inertial(m: float, J: tuple[float, float, float]) -> str:
    return f'<inertial pos="0 0 0" mass="{m!r}" diaginertia="{J[0]!r} {J[1]!r} {J[2]!r}"/>'


def _articulated(p: Params, front: str, back: str, height: tuple[float, float]) -> str:
    """Both modules as one tree; the universal joint is two hinges, about z of the front one and x of the back one."""
    offset = f"{p.front.O_x - p.back.O_x!r} 0 {p.front.O_z - p.back.O_z!r}"
    at = f"{p.back.O_x!r} 0 {p.back.O_z!r}"
    return f"""
    <body name="front" pos="0 0 {height[0]!r}">{_SLIDES}{_HINGES}{front}
      <body name="back" pos="{offset}">
        <joint name="yaw" type="hinge" axis="0 0 1" pos="{at}"/>
        <joint name="roll" type="hinge" axis="1 0 0" pos="{at}"/>
        {back}
      </body>
    </body>"""


def law_model(robot: Robot, dt: float, integrator: str) -> str:
    """MJCF of the modules with the inertias of eq. 9 and four motors that turn on their own, without any contact.

    Without constraints MuJoCo's solver has nothing to do: this is its fastest form. What the wheels and motors do
    is added by :mod:`artibot_sim.bench.mujoco_peer`.
    """
    p = _params(robot)
    bodies = [_inertial(m.m, (m.J_x, m.J_y, m.J_z)) for m in (p.front, p.back)]
    motors = "".join(
        f'<body name="{name}"><joint name="{name}" type="hinge" axis="0 1 0"/>{_inertial(1.0, (1.0, 1.0, 1.0))}</body>'
        for name in MOTORS
    )
    return f"""<mujoco model="{robot.name}, contact law of the paper">
  <option timestep="{dt!r}" integrator="{integrator}" gravity="{p.g_x!r} {p.g_y!r} {p.g_z!r}">
    <flag contact="disable" constraint="disable"/>
  </option>
  <worldbody>{_articulated(p, bodies[0], bodies[1], (0.0, 0.0))}{motors}</worldbody>
</mujoco>"""


@dataclass(frozen=True)
class Heightfield:
    """A part of uneven ground as MuJoCo takes it: heights at nodes (ny, nx), m, between two corners of `map`."""

    heights: Array
    corners: tuple[float, float, float, float]

    @classmethod
    def of(cls, ground: Ground, x: tuple[float, float], y: tuple[float, float]) -> Heightfield:
        """The ground between these coordinates (m), at its own resolution."""
        across, along = (np.arange(low, high + 0.5 * ground.resolution, ground.resolution) for low, high in (x, y))
        heights = np.asarray(ground.heights(*np.meshgrid(across, along)))
        return cls(heights, (float(across[0]), float(across[-1]), float(along[0]), float(along[-1])))

    @property
    def asset(self) -> str:
        """MJCF of the field; its data come later (`data`)."""
        x_0, x_1, y_0, y_1 = self.corners
        size = f"{0.5 * (x_1 - x_0)!r} {0.5 * (y_1 - y_0)!r} {float(np.ptp(self.heights))!r} 0.1"
        rows, columns = self.heights.shape
        return f'<asset><hfield name="ground" nrow="{rows}" ncol="{columns}" size="{size}"/></asset>'

    @property
    def geom(self) -> str:
        """MJCF of the ground."""
        x_0, x_1, y_0, y_1 = self.corners
        at = f"{0.5 * (x_0 + x_1)!r} {0.5 * (y_0 + y_1)!r} {float(self.heights.min())!r}"
        return f'<geom name="ground" type="hfield" hfield="ground" pos="{at}" conaffinity="1"/>'

    @property
    def data(self) -> Array:
        """Heights over their range, row by row."""
        low = self.heights.min()
        return np.asarray((self.heights - low) / np.ptp(self.heights)).ravel()


PLANE = '<geom name="ground" type="plane" size="0 0 1" conaffinity="1"/>'


def native_model(robot: Robot, dt: float, integrator: str, field: Heightfield | None = None) -> str:
    """MJCF as a user of MuJoCo would write it: eight wheels that touch the ground under MuJoCo's own friction.

    The wheels of a motor turn together: the front ones as both are led, the back ones by a joint equality. On a
    heightfield wheels are spheres, as artibot's are on uneven ground.
    """
    p = _params(robot)
    ball = field is not None
    modules = [
        _inertial(m.m, (m.J_x, m.J_y, m.J_z)) + "".join(_wheel(robot, p, body, 4 * k + i, ball) for i in range(4))
        for k, (m, body) in enumerate(_bare(robot, p))
    ]
    actuators = "".join(
        f'<velocity joint="{wheel}" kv="{GRIP * LEAD_RATE!r}"/>' if i < 4 else f'<motor joint="{wheel}"/>'
        for i, wheel in enumerate(WHEELS)
    )
    pairs = "".join(f'<joint joint1="{WHEELS[i]}" joint2="{WHEELS[i + 1]}"/>' for i in (4, 6))
    return f"""<mujoco model="{robot.name}, contacts of MuJoCo">
  <option timestep="{dt!r}" integrator="{integrator}" gravity="{p.g_x!r} {p.g_y!r} {p.g_z!r}"/>
  <default><geom friction="{p.front.mu_s!r} 0.005 0.0001" contype="0" conaffinity="0"/></default>
  {field.asset if field is not None else ""}
  <worldbody>
    {field.geom if field is not None else PLANE}
    {_articulated(p, modules[0], modules[1], (p.right_front.r_w, p.right_back.r_w))}
  </worldbody>
  <equality>{pairs}</equality>
  <actuator>{actuators}</actuator>
</mujoco>"""


def _params(robot: Robot) -> Params:
    if not robot.articulated:
        raise ArtibotError(
            f"bench: robot '{robot.name}' has no back module; expected an articulated one, such as agriq"
        )
    return params(robot)


def _bare(robot: Robot, p: Params) -> list[tuple[Module, ModuleParams]]:
    """Modules without wheels, beside their geometry."""
    assert robot.back is not None
    return [(robot.front, p.front), (robot.back, p.back)]


def _wheel(robot: Robot, p: Params, body: ModuleParams, i: int, ball: bool) -> str:
    x = body.half_x if i % 2 == 0 else -body.half_x
    y = -body.half_y if i % 4 < 2 else body.half_y
    drive = p.right_front if i < 4 else p.right_back
    rotor = GRIP if i < 4 else drive.eta_d * drive.J_m / (2 * drive.tau**2)  # half of eq. 21's, on the wheel's side
    wheel = robot.wheel
    return f"""
      <body name="{WHEELS[i]}" pos="{x!r} {y!r} 0">
        <joint name="{WHEELS[i]}" type="hinge" axis="0 1 0" armature="{rotor!r}"/>
        {_inertial(wheel.m_w, (wheel.J_wx, wheel.J_wy, wheel.J_wx))}
        <geom type="ellipsoid" size="{drive.r_w!r} {drive.r_w if ball else 0.03!r} {drive.r_w!r}" contype="1"/>
      </body>"""


# ----------------------------------------------------------------------
# Rollouts in MuJoCo, with the outputs kept that `rollout` keeps: state and pose at 100 Hz.
# ----------------------------------------------------------------------


SETTLING = 2.0
"""s in which a rover that was let go over uneven ground comes to rest on it."""
STAGES = {"RK4": 4, "Euler": 1, "implicitfast": 1}
"""Evaluations of the forces in a step of each integrator of MuJoCo."""


@dataclass(frozen=True)
class MujocoRun:
    """A rollout: times (n,), poses x, y, yaw of the front module (n, 3), m and rad.

    Where it was kept, `stance` is that module's height, roll and pitch (n, 3), m and rad.
    """

    t: Array
    pose: Array
    steps: int
    stance: Array | None = None


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
        self._memory = np.zeros(MEMORY)
        command = np.ascontiguousarray(np.column_stack([commands.position[:, :2], commands.velocity[:, :2]]))
        self._function, self._held = callback(self.data, self._numbers, self._memory, command)

    def __call__(self) -> MujocoRun:
        """One rollout from rest; the callback is installed for its time only."""
        mujoco, model, data = self._mujoco, self.model, self.data
        mujoco.mj_resetData(model, data)
        data.qpos[2] = self._start.q[2]
        self._memory[:] = 0.0
        drives = self._numbers[0]
        self._memory[ETA_NEXT : ETA_NEXT + 4] = [drives["eta_d_f"]] * 2 + [drives["eta_d_b"]] * 2
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
        if self._memory[CALLS] != expected:
            raise RuntimeError(f"MuJoCo evaluated the forces {self._memory[CALLS]:g} times, not {expected}")
        return MujocoRun(np.arange(rows + 1) * every * model.opt.timestep, qpos[:, [0, 1, 3]], self.steps)


def law_numbers(robot: Robot, commands: Commands, dt: float, stages: int) -> NDArray[Any]:
    """Robot and run as the compiled law takes them."""
    p = params(robot)
    numbers = np.zeros(1, dtype=NUMBERS)
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
    softness instead of k_n. On uneven ground it settles for `SETTLING` first.
    """

    def __init__(
        self, robot: Robot, commands: Commands, dt: float = 1e-3, integrator: str = "RK4",
        field: Heightfield | None = None,
    ) -> None:  # fmt: skip
        import mujoco

        self._mujoco = mujoco
        self.model = mujoco.MjModel.from_xml_string(native_model(robot, dt, integrator, field))
        self._settling = 0
        if field is not None:
            self.model.hfield_data[:] = field.data
            self._settling = round(SETTLING / dt)
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
        if self._settling:
            data.qpos[2] = float(model.hfield_size[0, 2])  # above the highest place
            mujoco.mj_step(model, data, self._settling)
        mujoco.mj_forward(model, data)
        every, rows = self._every, _kept(self.steps, self._every)
        qpos, qvel = np.empty((rows + 1, model.nq)), np.empty((rows + 1, model.nv))
        qpos[0], qvel[0] = data.qpos, data.qvel
        for row in range(1, rows + 1):
            data.ctrl[:4] = self._lead[row - 1]
            data.ctrl[4:] = self._back_torques()
            mujoco.mj_step(model, data, every)
            qpos[row], qvel[row] = data.qpos, data.qvel
        t = np.arange(rows + 1) * every * model.opt.timestep
        stance = qpos[:, [2, 5, 4]] + [self._p.right_front.r_w, 0.0, 0.0]
        return MujocoRun(t, qpos[:, [0, 1, 3]], self.steps, stance)

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
