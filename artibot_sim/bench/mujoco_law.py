"""The paper's contact law as a compiled C callback of MuJoCo (``mjcb_passive``), apart from artibot's own kernel.

MuJoCo moves the bodies; this adds, at every evaluation, the wheels' forces (eqs 15 to 20), the motors (21 to 23),
prescribed front motors (26 to 28) and the shared back torque (29, 30). Only what MuJoCo already holds is read, at
the addresses of its arrays, which stay where they are as long as the ``MjData`` lives; the C arguments of the
callback are not looked at, so no layout of a C struct is assumed.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import carray, cfunc, njit, types
from numba.extending import intrinsic
from numpy.typing import NDArray

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
