"""One rover on a plane: which rovers stay level, the right-hand side, the row of contributions."""

from __future__ import annotations

from typing import NamedTuple

from artibot_sim.model.effects import hooks
from artibot_sim.model.effects.force_law import motion_in, note_angles, note_module
from artibot_sim.model.equations.contact import PairForces, normal_force
from artibot_sim.model.equations.dynamics import mass_centre, write_loads
from artibot_sim.model.equations.plane import Body, CommonTerms, Motion, module_pairs, planar_accelerations
from artibot_sim.model.kernels.compilation import inlined
from artibot_sim.model.kernels.elementary import sincos, turn_by
from artibot_sim.model.kernels.integrators import (
    Footing,
    MotorAction,
    kept_by,
    loaded,
    motor_with_wheels,
    step_ahead,
    turning,
    write_motor,
    write_rates,
    write_wheels,
)
from artibot_sim.model.kernels.layout import (
    ACC,
    ALPHA,
    BACK,
    BEHIND,
    BETA,
    FRONT,
    LAMBDA,
    M_J,
    MEMORY,
    MOTOR,
    Q_C,
    Q_J,
    Z,
)

Three = tuple[float, float, float]
Five = tuple[float, float, float, float, float]

# ----------------------------------------------------------------------
# Which rovers stand level, and what of a module matters on a plane (`planar`).
# ----------------------------------------------------------------------


_STILL = 1e-12
"""m, rad and per second, within which a rover stands level and still: what rounding leaves."""

_BALANCED = 1e-9
"""Vertical and roll accelerations (m/s², rad/s²) that move nobody from there."""


@inlined
def static_loads(body, p, fx, module, z):
    """Normal forces (N) of a level module's wheels: right in front and behind, left in front and behind."""
    return (
        normal_force(body, p, fx, module, 1.0, -1.0, 0.0, 0.0, 0.0, 1.0, z),
        normal_force(body, p, fx, module, -1.0, -1.0, 0.0, 0.0, 0.0, 1.0, z),
        normal_force(body, p, fx, module, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0, z),
        normal_force(body, p, fx, module, -1.0, 1.0, 0.0, 0.0, 0.0, 1.0, z),
    )


@inlined
def module_level(body, p, fx, module, q, v):
    """Whether a module at q and v (8,) stands level, and its wheels carry it so."""
    for c in (Z, ALPHA, BETA):
        if abs(v[c]) > _STILL or (c != Z and abs(q[c]) > _STILL):
            return False
    right_f, right_b, left_f, left_b = static_loads(body, p, fx, module, q[Z])
    left = 0.0
    if fx is not None:
        _, left = hooks.centre(fx, module)
    rising = p.g_z + body.inverse[2] * ((right_f + right_b) + (left_f + left_b))
    rolling = body.inverse[3] * (body.half_y * ((left_f + left_b) - (right_f + right_b)) + body.m * p.g_z * left)
    return abs(rising) < _BALANCED and abs(rolling) < _BALANCED


@inlined
def level(p, fx, q, v):
    """Whether a rover at q and v (16,) moves on a plane only."""
    if not module_level(p.front, p, fx, FRONT, q[:BACK], v[:BACK]):
        return False
    if not p.two:
        return True
    return coplanar(p, q[Z], q[BACK + Z]) and module_level(p.back, p, fx, BEHIND, q[BACK:], v[BACK:])


@inlined
def coplanar(p, ahead, behind):
    """Whether the joint of `p` lies in the plane of its modules' origins, which are at heights `ahead` and `behind`."""
    return p.front.O_z == 0.0 and p.back.O_z == 0.0 and abs(ahead - behind) < _STILL


@inlined
def standing(body, p, fx, module, z):
    """A level module's numbers (`planar.Body`), its origin at height `z` (m)."""
    F_rf, F_rb, F_lf, F_lb = static_loads(body, p, fx, module, z)
    return Body(
        body.inverse[0], body.inverse[5], body.half_x, body.half_y, body.O_x, body.k_l, body.k_t, body.mu_s, body.mu_d,
        F_rf, F_rb, F_lf, F_lb,
    )  # fmt: skip


# ----------------------------------------------------------------------
# What a rover on a plane writes down of an instant: the row of `layout.COLUMNS`, as in space.
# ----------------------------------------------------------------------


@inlined
def unload(values, two, out):
    """Coordinates, rates or accelerations that move on a plane (10) into `out` (16,)."""
    out[0], out[1], out[5], out[6], out[7] = values[0], values[1], values[2], values[6], values[7]
    if two:
        out[8], out[9], out[13], out[14], out[15] = values[3], values[4], values[5], values[8], values[9]


class Instant(NamedTuple):
    """What brings a level rover's accelerations about (`level_accelerations`).

    Attributes
    ----------
    forces : tuple of 4 contact.PairForces
    acting : tuple of 4 integrators.MotorAction
        Both in the order of MOTORS.
    contacts, joint, loads : tuple
        See `plane.planar_accelerations`.
    """

    forces: tuple[PairForces, PairForces, PairForces, PairForces]
    acting: tuple[MotorAction, MotorAction, MotorAction, MotorAction]
    contacts: tuple[Three, Three]
    joint: Five
    loads: tuple[Five, Five]


@inlined
def module_row(body, ground, fx, at, s_g, c_g, module, now, hold, w):
    """Motors, wheels, contact forces and the joint's force of one module, into the row."""
    pair_r, pair_l, _, _ = module_pairs(body, ground, fx, at, s_g, c_g)
    motor, side = 2 * module, 1.0 if module > 0 else -1.0
    write_wheels(pair_r, now.forces[motor], motor, w)
    write_wheels(pair_l, now.forces[motor + 1], motor + 1, w)
    write_motor(fx, now.acting[motor], motor, hold, w)
    write_motor(fx, now.acting[motor + 1], motor + 1, hold, w)
    c, j = Q_C + 6 * module, Q_J + 6 * module
    w[c], w[c + 1], w[c + 5] = now.contacts[module]
    on_right, on_left = body.F_rf + body.F_rb, body.F_lf + body.F_lb
    w[c + Z], w[c + 3] = on_right + on_left, body.half_y * (on_left - on_right)
    w[j], w[j + 1], w[j + 5] = side * now.joint[0], side * now.joint[1], now.joint[2 + module]
    if fx is not None:
        write_loads(now.loads[module], module, w)
        r_x, r_y = mass_centre(fx, module, s_g, c_g)
        w[j + 5] -= side * (r_y * now.joint[0] - r_x * now.joint[1])


@inlined
def write_row(at, two, fx, motions, trig, a, now, hold, w):
    """All of an instant but gravity, which never changes, into `w` (ROW,).

    Parameters
    ----------
    motions : tuple of 2 Motion
    trig : tuple of 4 floats
        Sine and cosine of yaw, front and back.
    a : tuple of 10 floats
        Accelerations.
    now : Instant
    """
    module_row(at.front, at.ground, fx, motions[0], trig[0], trig[1], FRONT, now, hold, w)
    if two:
        w[LAMBDA], w[LAMBDA + 1] = now.joint[0], now.joint[1]
        module_row(at.back, at.ground, fx, motions[1], trig[2], trig[3], BEHIND, now, hold, w)
        if fx is not None:
            w[M_J] = now.joint[4]
    unload(a, two, w[ACC : ACC + 16])


# ----------------------------------------------------------------------
# One rover on a plane, alone: the right-hand side, as `integrators` has it in space.
#
# Coordinates that move and their rates are tuples of ten numbers, which stay in registers: x, y, gamma of the front
# module, of the back one, and the motors' angles. Nothing is stored on the way; `write_row` writes down what is
# kept.
# ----------------------------------------------------------------------


class Standing(NamedTuple):
    """A rover's modules and what they stand on (see `planar`)."""

    front: Body
    back: Body
    ground: CommonTerms


@inlined
def stand(p, fx, q):
    """A level rover at q (16,)."""
    ground = CommonTerms(p.u_w, p.g_x, p.g_y, p.A_joint, 1.0 if p.two else 0.0, p.load, p.pitching)
    return Standing(
        standing(p.front, p, fx, FRONT, q[Z]), standing(p.back, p, fx, BEHIND, q[BACK + Z]), ground
    )  # fmt: skip


@inlined
def motions(q, v):
    """Both modules' motions from tuples of coordinates and rates."""
    return Motion(q[0], q[1], q[2], v[0], v[1], v[2]), Motion(q[3], q[4], q[5], v[3], v[4], v[5])


@inlined
def heading(q):
    """Sine and cosine of yaw, of the front module and the back one."""
    s_f, c_f = sincos(q[2])
    s_b, c_b = sincos(q[5])
    return s_f, c_f, s_b, c_b


@inlined
def turned(trig, begun, q):
    """Sines and cosines of both yaws at `q`, from those at `begun`: within a step a module turns by little."""
    s_f, c_f = turn_by(q[2] - begun[2], trig[0], trig[1])
    s_b, c_b = turn_by(q[5] - begun[5], trig[2], trig[3])
    return s_f, c_f, s_b, c_b


@inlined
def near(begun, q):
    """Whether no module has turned by more than `turn_by` knows."""
    return abs(q[2] - begun[2]) < 0.02 and abs(q[5] - begun[5]) < 0.02


@inlined
def side_ahead(body, p, fx, unit, motor, theta, theta_dot, on, commands, lags, dt):
    """A motor (`integrators.Turning`), and over a semi-implicit step what `integrators.step_ahead` gives."""
    at, i = turning(p, fx, commands, motor, theta, theta_dot), 2 * motor
    if dt is None:
        return at, None
    return at, step_ahead(body, p, fx, unit, at, on, (kept_by(lags, 8, i), kept_by(lags, 8, i + 1)), dt)


@inlined
def side_moves(body, p, fx, unit, motor, on, lags, dt, torques):
    """A motor and its wheels: `integrators.motor_with_wheels`; `motor` is what `side_ahead` gives."""
    at, ahead = motor
    i = 2 * at.number
    kept = kept_by(lags, 8, i), kept_by(lags, 8, i + 1)
    forces, acting = motor_with_wheels(body, p, fx, unit, at, on, kept, dt, ahead, torques)
    if fx is not None:
        write_rates(fx, forces, 8, i, lags, MEMORY)
    return forces, acting


@inlined
def note_level(motion, two, turned, f, b, trig):
    """Note what laws may see of a level rover.

    Parameters
    ----------
    motion : record
        See `force_law.note_module`.
    two : bool
        Whether there is a module behind.
    turned : tuple of 4 floats
        Angles of the motors' wheels, rad.
    f, b : Motion
    trig : tuple of 4 floats
        Sine and cosine of the front module's yaw, then of the back one's.
    """
    s_f, c_f, s_b, c_b = trig
    forward, left = c_f * f.x_dot + s_f * f.y_dot, c_f * f.y_dot - s_f * f.x_dot
    note_module(motion, FRONT, f.x, f.y, f.gamma, forward, left, f.gamma_dot)
    if not two:
        note_angles(motion, turned[0], turned[1], 0.0, 0.0, 0.0, 0.0)
        return
    forward, left = c_b * b.x_dot + s_b * b.y_dot, c_b * b.y_dot - s_b * b.x_dot
    note_module(motion, BEHIND, b.x, b.y, b.gamma, forward, left, b.gamma_dot)
    bend, bend_rate = b.gamma - f.gamma, b.gamma_dot - f.gamma_dot
    note_angles(motion, turned[0], turned[1], turned[2], turned[3], bend, bend_rate)


@inlined
def level_accelerations(at, p, fx, q, v, trig, commands, lags, dt, torques):
    """Accelerations of the ten coordinates, and what brings them about: an `Instant`.

    At an instant (`dt` None), with the torques of prescribed motors only where `torques` are wanted; or as a
    semi-implicit step of `dt` (s) takes them. `lags` holds an array (48,) of what wheels remember, then its rates; or
    nothing.
    """
    f, b = motions(q, v)
    if fx is not None:
        turned_f = p.right_front.tau * q[6], p.left_front.tau * q[7]
        turned_b = p.right_back.tau * q[8], p.left_back.tau * q[9]
        note_level(motion_in(fx), p.two, turned_f + turned_b, f, b, trig)
    r_f, l_f, soil_rf, soil_lf = module_pairs(at.front, at.ground, fx, f, trig[0], trig[1])
    r_b, l_b, soil_rb, soil_lb = module_pairs(at.back, at.ground, fx, b, trig[2], trig[3])
    one, two, three, four = p.right_front, p.left_front, p.right_back, p.left_back
    if fx is not None:
        turned, soils = (q[6], q[7], v[6], v[7]), (soil_rf, soil_lf)
        r_f, l_f = loaded(at.front, p, fx, (one, two), (r_f, l_f), soils, MOTOR[0], turned, lags, 8, 2 * MOTOR[0])
        turned, soils = (q[8], q[9], v[8], v[9]), (soil_rb, soil_lb)
        r_b, l_b = loaded(at.back, p, fx, (three, four), (r_b, l_b), soils, MOTOR[2], turned, lags, 8, 2 * MOTOR[2])
    on_0, on_1, on_2, on_3 = Footing(r_f, soil_rf), Footing(l_f, soil_lf), Footing(r_b, soil_rb), Footing(l_b, soil_lb)
    # all motors one step ahead first: they know nothing of each other, and the processor takes them side by side
    T_0 = side_ahead(at.front, p, fx, one, MOTOR[0], q[6], v[6], on_0, commands, lags, dt)
    T_1 = side_ahead(at.front, p, fx, two, MOTOR[1], q[7], v[7], on_1, commands, lags, dt)
    T_2 = side_ahead(at.back, p, fx, three, MOTOR[2], q[8], v[8], on_2, commands, lags, dt)
    T_3 = side_ahead(at.back, p, fx, four, MOTOR[3], q[9], v[9], on_3, commands, lags, dt)
    F_0, M_0 = side_moves(at.front, p, fx, one, T_0, on_0, lags, dt, torques)
    F_1, M_1 = side_moves(at.front, p, fx, two, T_1, on_1, lags, dt, torques)
    F_2, M_2 = side_moves(at.back, p, fx, three, T_2, on_2, lags, dt, torques)
    F_3, M_3 = side_moves(at.back, p, fx, four, T_3, on_3, lags, dt, torques)
    forces = F_0, F_1, F_2, F_3
    on_f, on_b, contacts, joint, loads = planar_accelerations(at.front, at.back, at.ground, fx, f, b, trig, forces, dt)
    a_2, a_3 = (M_2.theta_ddot, M_3.theta_ddot) if p.two else (0.0, 0.0)
    a = (
        on_f[0], on_f[1], on_f[2], on_b[0], on_b[1], on_b[2], M_0.theta_ddot, M_1.theta_ddot, a_2, a_3,
    )  # fmt: skip
    return a, Instant(forces, (M_0, M_1, M_2, M_3), contacts, joint, loads)
