"""Where the energy goes: power of each named contribution in space and on a plane, and what is stored."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from artibot_sim.model.effects import hooks
from artibot_sim.model.equations import uneven
from artibot_sim.model.equations.contact import normal_force, unloaded_radius
from artibot_sim.model.equations.dynamics import mass_centre
from artibot_sim.model.equations.plane import module_pairs
from artibot_sim.model.equations.transmission import ROLLING_WIDTH, rolling_sign
from artibot_sim.model.ground.raster import Ground, Surface, sample
from artibot_sim.model.kernels.compilation import inlined
from artibot_sim.model.kernels.elementary import sincos, tanh_alone
from artibot_sim.model.kernels.integrators import EFFICIENCY, ModuleParts, coordinate_of, motor_count, motor_of
from artibot_sim.model.kernels.layout import (
    ACC,
    ALPHA,
    BACK,
    BEHIND,
    BETA,
    E_ARTICULATION,
    E_DRAG,
    E_GEAR,
    E_JOINT,
    E_MOTOR,
    E_NORMAL,
    E_OFFSET,
    E_PUSH,
    E_ROLLING,
    E_SLIP_L,
    E_SLIP_T,
    E_TILT,
    ETA,
    F_L,
    F_N,
    F_T,
    FRONT,
    GAMMA,
    LOAD,
    M_D,
    M_J,
    M_M,
    M_R,
    MOTOR_COORDINATES,
    P_X,
    P_Y,
    PUSH,
    Q_J,
    X,
    Y,
    Z,
)
from artibot_sim.model.robot.derived import params
from artibot_sim.model.robot.parameters import ModuleParams, Params
from artibot_sim.model.robot.robot import Robot

# ----------------------------------------------------------------------
# Where the energy goes: power of each named contribution, and what is stored.
#
# Over a rollout, what the motors put in and the joint does is stored or lost: sum(E_motor) + E_joint = stored(end)
# − stored(start) + sum(all other E). `E_joint` is the work that the joint's force does on the modules, zero but for
# the stabilisation of eq. 13.
# ----------------------------------------------------------------------


@inlined
def motor_powers(v, p, fx, w, out):
    """Power put in by the motors, and lost in the gears: (1/eta − 1) of what passes to the wheels."""
    for motor in range(motor_count(p)):
        c = coordinate_of(motor)
        unit = motor_of(p, motor)
        omega = unit.tau * v[c]
        out[E_MOTOR + motor] = w[M_M + motor] * v[c]
        passed = omega * (unit.J_w * unit.tau * w[ACC + c] + w[M_R + motor])
        out[E_GEAR + motor] = (1.0 / w[ETA + motor] - 1.0) * passed
        if fx is not None:
            out[E_DRAG + motor] = w[M_D + motor] * v[c]


@inlined
def wheel_powers(body, p, fx, q, v, module, base, number, w, out):
    """Power dissipated between the wheels of one module and the ground.

    `E_offset`: the forces act u_w ahead of where the slip is taken. `E_tilt`: eq. 18 turns the normal force with
    the module's roll, while the spring is vertical; zero without roll. Loads that move with a centre of mass above the
    ground (`contact.load_transfer`) move no module: the springs' own force does. The module's coordinates begin at
    `module`, its wheels at `base` in the row; `number` is its place, counted from 0.
    """
    s_a, c_a = sincos(q[module + ALPHA])
    s_g, c_g = sincos(q[module + GAMMA])
    v_y = c_g * v[module + Y] - s_g * v[module + X]
    v_z, alpha_dot, gamma_dot = v[module + Z], v[module + ALPHA], v[module + GAMMA]
    for i in range(4):
        j = base + i
        x = body.half_x if i % 2 == 0 else -body.half_x
        y = -body.half_y if i < 2 else body.half_y
        motor = j // 2
        omega = motor_of(p, motor).tau * v[coordinate_of(motor)]
        F_l, F_t, F_n, F_z = w[F_L + j], w[F_T + j], w[F_N + j], w[F_N + j]
        r_0, u_w, rim = body.r_0, p.u_w, motor_of(p, motor).r_w * omega
        if fx is not None:
            rim *= hooks.radius(fx, 4 * number + i, motor_of(p, motor).tau * q[coordinate_of(motor)])
            end, side = 1.0 if i % 2 == 0 else -1.0, -1.0 if i < 2 else 1.0
            r_0 = unloaded_radius(body, p, fx, number, end, side)
            F_z = normal_force(body, p, fx, number, end, side, v_z, alpha_dot, s_a, c_a, q[module + Z])
            u_w *= hooks.lead(fx, w[P_X + j], w[P_Y + j])
        out[E_SLIP_L + j] = F_l * (rim - w[P_X + j])
        out[E_SLIP_T + j] = -F_t * w[P_Y + j]
        out[E_OFFSET + j] = -u_w * gamma_dot * (F_t * c_a - F_z * s_a)
        out[E_ROLLING + j] = u_w * omega * (F_l if p.literal_eq22 else F_n * rolling_sign(omega))
        rate = v_z + alpha_dot * y * c_a
        spring = p.k_n * max(r_0 - q[module + Z] - y * s_a, 0.0)
        out[E_NORMAL + j] = (spring - F_z) * rate
        along_normal = -s_a * (v_y + gamma_dot * x) + c_a * v_z + alpha_dot * y
        out[E_TILT + j] = F_z * (rate - along_normal)


@inlined
def uneven_powers(body, p, fx, ground, q, v, b, number, w, out):
    """Powers of a module's wheels on uneven ground, where the normal force is the gradient of what its spring stores.

    `E_offset` holds what the height does at which forces act, too (effect `com_height`).
    """
    s_a, c_a = sincos(q[b + ALPHA])
    s_g, c_g = sincos(q[b + GAMMA])
    at = uneven.attitude_of(p, s_a, c_a, q[b + BETA], s_g, c_g)
    sides = uneven.sides_of(body, p, fx, ground, number, at, q, v, b)
    for i in range(4):
        j, side = 4 * number + i, sides[0] if i < 2 else sides[1]
        foot = side.front if i % 2 == 0 else side.back
        motor = j // 2
        unit = motor_of(p, motor)
        omega = unit.tau * v[coordinate_of(motor)]
        F_l, F_t, u_w, rim = w[F_L + j], w[F_T + j], p.u_w, unit.r_w * omega
        if fx is not None:
            rim *= hooks.radius(fx, j, unit.tau * q[coordinate_of(motor)])
            u_w *= hooks.lead(fx, w[P_X + j], w[P_Y + j])
        force = uneven.pushed(foot, F_l, F_t)
        offset = u_w * v[b + GAMMA] * at.c_b * force[1]
        if fx is not None:
            m_a, m_g, m_b = uneven.lever_below(p, fx, at, force)
            offset += m_a * v[b + ALPHA] + m_b * v[b + BETA] + m_g * v[b + GAMMA]
        out[E_SLIP_L + j] = F_l * (rim - w[P_X + j])
        out[E_SLIP_T + j] = -F_t * w[P_Y + j]
        out[E_OFFSET + j] = -offset
        out[E_ROLLING + j] = u_w * omega * (F_l if p.literal_eq22 else w[F_N + j] * rolling_sign(omega))
        out[E_NORMAL + j] = (foot.upward - p.k_n * max(foot.sunk, 0.0)) * foot.sinking
        out[E_TILT + j] = 0.0


@inlined
def module_powers(body, p, fx, ground, q, v, b, number, w, out):
    """Power dissipated between the wheels of one of two modules and the ground, which is flat or not."""
    if len(ground) == 0:
        wheel_powers(body, p, fx, q, v, b, 4 * number, number, w, out)
    else:
        uneven_powers(body, p, fx, ground, q, v, b, number, w, out)


@inlined
def load_power(v, module, base, w):
    """Power of the effects' forces on one module, W."""
    o = LOAD + base
    return w[o] * v[module + X] + w[o + 1] * v[module + Y] + w[o + 2] * v[module + GAMMA]


@inlined
def powers(q, v, p, fx, ground, w, out):
    """Power of every contribution (W) at a state whose row is `w`, into `out` (ENERGIES,)."""
    motor_powers(v, p, fx, w, out)
    module_powers(p.front, p, fx, ground, q, v, 0, FRONT, w, out)
    if fx is not None:
        out[E_ARTICULATION] = w[M_J] * (v[BACK + GAMMA] - v[GAMMA])
        out[E_PUSH] = w[PUSH] * v[X] + w[PUSH + 1] * v[Y] + load_power(v, 0, 0, w)
    if p.two:
        module_powers(p.back, p, fx, ground, q, v, BACK, BEHIND, w, out)
        if fx is not None:
            out[E_PUSH] += load_power(v, BACK, 3, w)
        total = 0.0
        for i in range(6):
            total += w[Q_J + i] * v[i] + w[Q_J + 6 + i] * v[BACK + i]
        out[E_JOINT] = total


def stored_energy(
    robot: Robot, q: NDArray[np.float64], v: NDArray[np.float64], ground: Ground | None = None
) -> dict[str, NDArray[np.float64]]:
    """Energies stored in a state.

    Parameters
    ----------
    q, v : array, shape (n, 16)
        States (eqs 10, 11).
    ground : Ground, optional
        Flat ground without.

    Returns
    -------
    dict of arrays, shape (n,), J
        ``kinetic`` of the modules (eqs 5, 8), ``spin`` of motors and wheels, ``gravity`` (eq. 12) and ``elastic``
        of the wheels' normal stiffness.
    """
    p = params(robot)
    units = (p.right_front, p.left_front, p.right_back, p.left_back)[: 4 if p.two else 2]
    kinetic, spin, gravity, elastic = (np.zeros(len(q)) for _ in range(4))
    for unit, c in zip(units, MOTOR_COORDINATES, strict=False):
        spin += 0.5 * (unit.J_m + unit.J_w * unit.tau**2) * v[:, c] ** 2
    for body, b in ((p.front, 0), (p.back, BACK))[: 2 if p.two else 1]:
        inertia = 1.0 / np.array(body.inverse)
        kinetic += 0.5 * (v[:, b : b + 6] ** 2) @ inertia
        gravity -= body.m * (q[:, b : b + 3] @ np.array([p.g_x, p.g_y, p.g_z]))
        if ground is not None:
            elastic += _elastic_on(p, body, q[:, b : b + 6], ground.under_wheels(robot.wheel.r_w))
            continue
        for y in (-body.half_y, body.half_y):
            deflection = np.maximum(body.r_0 - q[:, b + Z] - y * np.sin(q[:, b + ALPHA]), 0.0)
            elastic += 2 * 0.5 * p.k_n * deflection**2
    return {"kinetic": kinetic, "spin": spin, "gravity": gravity, "elastic": elastic}


def _elastic_on(p: Params, body: ModuleParams, q: NDArray[np.float64], ground: Surface) -> NDArray[np.float64]:
    """What the wheels' springs of a module store on uneven ground, J, at its six coordinates q (n, 6)."""
    s_a, c_a, s_g, c_g = (turn(q[:, i]) for i in (ALPHA, GAMMA) for turn in (np.sin, np.cos))
    s_b, c_b = np.sin(p.pitching * q[:, BETA]), np.cos(p.pitching * q[:, BETA])
    elastic, rock = np.zeros(len(q)), 0.5 * (1.0 - p.pitching)
    for y in (-body.half_y, body.half_y):
        heights, above = [], []
        for x in (body.half_x, -body.half_x):
            r_x, r_y = c_b * x + s_b * s_a * y, c_a * y
            heights.append(sample(ground, q[:, X] + c_g * r_x - s_g * r_y, q[:, Y] + s_g * r_x + c_g * r_y)[0])
            above.append(q[:, Z] - s_b * x + c_b * s_a * y)
        tilt = rock * (heights[0] - heights[1])
        for height, z in zip(heights, (above[0] + tilt, above[1] - tilt), strict=True):
            elastic += 0.5 * p.k_n * np.maximum(body.r_0 + height - z, 0.0) ** 2
    return elastic


# ----------------------------------------------------------------------
# Where the energy goes on a plane: `energy.powers` without what only roll and heave bring.
# ----------------------------------------------------------------------


class Account(NamedTuple):
    """What powers are added to: the energies `e` (ENERGIES,), for `weight` seconds."""

    weight: float
    e: NDArray[np.float64]


@inlined
def pair_powers(p, fx, unit, pair, forces, motor, theta, omega, gamma_dot, account):
    """Of the two wheels of a motor, which turn at `omega` (rad/s)."""
    weight, e = account
    i, rim, lead = 2 * motor, unit.r_w * omega, weight * gamma_dot
    r_f = r_b = 1.0
    if fx is not None:
        angle = unit.tau * theta
        r_f, r_b = hooks.radius(fx, 2 * motor, angle), hooks.radius(fx, 2 * motor + 1, angle)
    sign = tanh_alone(omega * (1.0 / ROLLING_WIDTH))
    roll_f, roll_b = forces.u_f * (forces.F_nf * sign), forces.u_b * (forces.F_nb * sign)
    if p.literal_eq22:
        roll_f, roll_b = p.u_w * (r_f * forces.F_lf), p.u_w * (r_b * forces.F_lb)
    e[E_SLIP_L + i] += weight * (forces.F_lf * (r_f * rim - pair.p_xf))
    e[E_SLIP_L + i + 1] += weight * (forces.F_lb * (r_b * rim - pair.p_xb))
    e[E_SLIP_T + i] -= weight * (forces.F_tf * pair.p_yf)
    e[E_SLIP_T + i + 1] -= weight * (forces.F_tb * pair.p_yb)
    e[E_OFFSET + i] -= lead * (forces.u_f * forces.F_tf)
    e[E_OFFSET + i + 1] -= lead * (forces.u_b * forces.F_tb)
    e[E_ROLLING + i] += weight * (omega * roll_f)
    e[E_ROLLING + i + 1] += weight * (omega * roll_b)


@inlined
def motor_power(fx, unit, motor, speed, acting, hold, account):
    """Put in by a motor, lost in its gear, and taken by what drags on it."""
    weight, e = account
    passed = unit.tau * speed * (unit.J_w * unit.tau * acting.theta_ddot + acting.M_r)
    e[E_MOTOR + motor] += weight * (acting.M_m * speed)
    e[E_GEAR + motor] += weight * ((1.0 / hold[EFFICIENCY + motor] - 1.0) * passed)
    if fx is not None:
        e[E_DRAG + motor] += weight * (acting.drag * speed)


@inlined
def module_power(p, fx, module, ground, at, trig, q, v, now, hold, account):
    """Of one module's wheels and motors; q and v are those of its motors and its yaw rate, right and left."""
    body, right, left, number = module
    pair_r, pair_l, _, _ = module_pairs(body, ground, fx, at, trig[0], trig[1])
    motor = 2 * number
    pair_powers(p, fx, right, pair_r, now.forces[motor], motor, q[0], right.tau * v[0], v[2], account)
    pair_powers(p, fx, left, pair_l, now.forces[motor + 1], motor + 1, q[1], left.tau * v[1], v[2], account)
    motor_power(fx, right, motor, v[0], now.acting[motor], hold, account)
    motor_power(fx, left, motor + 1, v[1], now.acting[motor + 1], hold, account)


@inlined
def level_powers(at, p, fx, motions, trig, q, v, now, hold, account):
    """Add the power of every contribution to an `Account`.

    Parameters
    ----------
    motions : tuple of 2 Motion
        At which the forces are.
    q, v : tuple of 10 floats
        Coordinates, and the rates that the forces act at.
    now : plane_step.Instant
    """
    (f, b), (weight, e) = motions, account
    parts = ModuleParts(at.front, p.right_front, p.left_front, FRONT)
    module_power(
        p, fx, parts, at.ground, f, trig[:2], (q[6], q[7]), (v[6], v[7], v[2]), now, hold, account,
    )  # fmt: skip
    if fx is not None:
        push_x, push_y, load_x, load_y, turn = now.loads[0]
        e[E_PUSH] += weight * ((push_x + load_x) * v[0] + (push_y + load_y) * v[1] + turn * v[2])
        e[E_ARTICULATION] += weight * (now.joint[4] * (v[5] - v[2]))
    if p.two:
        parts = ModuleParts(at.back, p.right_back, p.left_back, BEHIND)
        module_power(
            p, fx, parts, at.ground, b, trig[2:], (q[8], q[9]), (v[8], v[9], v[5]), now, hold, account,
        )  # fmt: skip
        l_x, l_y, turn_f, turn_b, _ = now.joint
        if fx is not None:
            r_x, r_y = mass_centre(fx, FRONT, trig[0], trig[1])
            turn_f += r_y * l_x - r_x * l_y
            r_x, r_y = mass_centre(fx, BEHIND, trig[2], trig[3])
            turn_b -= r_y * l_x - r_x * l_y
            _, _, load_x, load_y, turn = now.loads[1]
            e[E_PUSH] += weight * (load_x * v[3] + load_y * v[4] + turn * v[5])
        e[E_JOINT] += weight * (l_x * (v[3] - v[0]) + l_y * (v[4] - v[1]) + (turn_f * v[2] + turn_b * v[5]))
