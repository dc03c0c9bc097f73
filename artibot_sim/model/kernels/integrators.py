"""The right-hand side, and the two ways to step it.

``rk4`` is the classical explicit method. ``semi_implicit`` is symplectic Euler in which the wheel spin, by far the
stiffest part of the model, is solved for implicitly: one right-hand side a step, stable where RK4 is not.

In both, what the paper feeds back from the previous step is held through the step: the efficiencies (eq. 23,
Fig. 7) and the back torques (eq. 30). Flat arrays hold four numbers of each kind, motor by motor: ``drive`` the
commanded angle, speed and acceleration, ``hold`` what stays through the step.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from artibot_sim.model.effects import hooks
from artibot_sim.model.effects.force_law import motion_in, note_angles, note_module
from artibot_sim.model.equations import uneven
from artibot_sim.model.equations.contact import (
    PairSoil,
    WheelPair,
    generalised_forces,
    load_transfer,
    pair_forces,
    soil_under,
    wheel_forces,
    wheel_pairs,
    within_friction,
)
from artibot_sim.model.equations.dynamics import (
    back_to_origin,
    free_acceleration,
    joint_geometry,
    jointed,
    module_loads,
    multipliers,
    on_pitch,
    turned_by_joint,
    write_loads,
)
from artibot_sim.model.equations.kinematics import attitude
from artibot_sim.model.equations.transmission import (
    DRIVEN,
    PRESCRIBED,
    TORQUE,
    follow,
    load_torque,
    motor_equation,
    reflect,
)
from artibot_sim.model.kernels.compilation import inlined
from artibot_sim.model.kernels.layout import (  # fmt: skip
    ACC,
    ALPHA,
    BACK,
    BEHIND,
    BETA,
    ETA,
    F_L,
    F_N,
    F_T,
    FRONT,
    GAMMA,
    LAMBDA,
    M_D,
    M_M,
    M_R,
    MEMORY,
    P_X,
    P_Y,
    SAT,
    THETA_L,
    THETA_R,
    X,
    Y,
)

D, D_DOT, D_DDOT = 0, 4, 8
"""Where `drive` holds angles, speeds and accelerations."""

TORQUE_D, EFFICIENCY, GEAR, INERTIA, INVERSE, WOUND, TRAIL = 0, 4, 8, 12, 16, 20, 24
"""Where `hold` holds torques (NaN for whatever it takes to follow), efficiencies, tau/eta, J_m + J_w tau²/eta and its
inverse; of velocity loops, at the step's start, the integral of the speed's error and the angle behind the command."""

HELD = 28
"""How many numbers `hold` holds."""


@inlined
def motor_of(p, motor):
    """Parameters of a motor by its number."""
    if motor == 0:
        return p.right_front
    if motor == 1:
        return p.left_front
    if motor == 2:
        return p.right_back
    return p.left_back


@inlined
def coordinate_of(motor):
    """Where a motor's angle stands in q."""
    return (THETA_R if motor % 2 == 0 else THETA_L) + (BACK if motor > 1 else 0)


@inlined
def motor_count(p):
    """Four, or two for a rigid robot."""
    return 4 if p.two else 2


@inlined
def hold_efficiencies(p, eta, hold):
    """Fix for a step what eq. 21 makes of the efficiencies, which seldom change.

    Of all four motors: on a plane a rigid robot's missing ones are computed, too, and left out at the end.
    """
    for motor in range(4):
        if hold[EFFICIENCY + motor] != eta[motor]:
            unit = motor_of(p, motor)
            gear, J = reflect(unit.tau, unit.J_m, unit.J_w, 1.0 / eta[motor])
            hold[EFFICIENCY + motor], hold[GEAR + motor] = eta[motor], gear
            hold[INERTIA + motor], hold[INVERSE + motor] = J, 1.0 / J


class MotorCommands(NamedTuple):
    """What moves the motors at an instant: modes (4,), and `drive` and `hold`, flat arrays as this file describes.

    Of a train they have a row a module.
    """

    modes: NDArray[np.int64]
    drive: NDArray[np.float64]
    hold: NDArray[np.float64]


class ModuleParts(NamedTuple):
    """One of two modules: its body, its motors right and left (as in `Params`), and its number, 0 for the front one."""

    body: Any
    right: Any
    left: Any
    number: int


class Footing(NamedTuple):
    """What the wheels of one motor stand on: what they meet, and the soil under them."""

    pair: WheelPair
    soil: PairSoil


class MotorMotion(NamedTuple):
    """A motor at an instant: its number and mode, rotation, acceleration by which it follows, what the step holds.

    And for a velocity loop the error of its speed, rad/s, and the integral of that, rad.
    """

    number: int
    mode: int
    theta: float
    theta_dot: float
    wish: float
    torque: float
    gear: float
    J: float
    inverse_J: float
    error: float
    behind: float


class MotorAction(NamedTuple):
    """What a motor does: torques of the motor, on its wheels' axle and of drag (N m), acceleration, new speed."""

    M_m: float
    M_r: float
    drag: float
    theta_ddot: float
    speed: float


@inlined
def turning(p, fx, commands, motor, theta, theta_dot):
    """A motor at `theta` (rad) and `theta_dot` (rad/s)."""
    modes, drive, hold = commands
    wish, error, behind, mode = 0.0, 0.0, 0.0, modes[motor]
    if mode != TORQUE:
        if fx is not None:
            error = drive[D_DOT + motor] - theta_dot
            behind = hold[WOUND + motor] + ((drive[D + motor] - theta) - hold[TRAIL + motor])
        damping, stiffness = p.velocity_gain, 0.0
        if mode == PRESCRIBED:
            damping, stiffness = 2.0 * p.A_motor, p.A_motor * p.A_motor
        wish = follow(
            damping, stiffness, theta, theta_dot, drive[D + motor], drive[D_DOT + motor], drive[D_DDOT + motor]
        )  # fmt: skip
    return MotorMotion(
        motor, mode, theta, theta_dot, wish, hold[TORQUE_D + motor], hold[GEAR + motor], hold[INERTIA + motor],
        hold[INVERSE + motor], error, behind,
    )  # fmt: skip


@inlined
def motors_at(p, fx, commands, number, q, v):
    """Both motors of a module by its number (`turning`), right and left."""
    b, motor = BACK * number, 2 * number
    return (
        turning(p, fx, commands, motor, q[b + THETA_R], v[b + THETA_R]),
        turning(p, fx, commands, motor + 1, q[b + THETA_L], v[b + THETA_L]),
    )


@inlined
def begin_loops(hold):
    """No motor has been behind its command yet: the next `wind_up` adds nothing."""
    for motor in range(4):
        hold[WOUND + motor], hold[TRAIL + motor] = 0.0, math.nan


@inlined
def wind_up(fx, mode, theta, motor, drive, hold, behind):
    """With effects: what a motor's velocity loop begins a step with, at an angle `theta` (rad).

    The integral of a speed's error is the angle behind the command, less what a windup limit has cut off. So it needs
    no rate of its own: it grows by what the angle has come to since the step before.
    """
    if mode != DRIVEN:
        return
    trail, before = drive[D + motor] - theta, hold[TRAIL + motor]
    grown = trail - before if before == before else 0.0
    behind[motor] = hooks.wound(fx, behind[motor] + grown)
    hold[WOUND + motor], hold[TRAIL + motor] = behind[motor], trail


@inlined
def solved(fx, motor, J, inverse_J, load, torque_max):
    """Torque of a motor and its acceleration under a `load` (N m, motor side), see `transmission.motor_equation`."""
    high = math.inf if motor.mode == PRESCRIBED else torque_max
    low = -high
    if fx is not None:
        low, high = hooks.limits(fx, motor.theta_dot, low, high)
    if motor.mode == TORQUE:
        return motor_equation(J, inverse_J, load, None, motor.torque, low, high)
    held = math.nan
    if fx is not None and motor.mode == DRIVEN:
        held = hooks.loop(fx, motor.error, hooks.wound(fx, motor.behind))
    return motor_equation(J, inverse_J, load, motor.wish, held, low, high)


@inlined
def dragged(fx, unit, motor, theta_dot):
    """With effects: what drags on a motor (its number) before its gear, against its rotation, N m."""
    return hooks.drag(fx, motor, theta_dot) + unit.geared * hooks.gear(fx, theta_dot)


@inlined
def at_shaft(fx, unit, motor, theta_dot):
    """With effects: what laws ask of a motor at its shaft, at a speed `theta_dot` (rad/s), N m."""
    omega = unit.tau * theta_dot
    return hooks.shaft(fx, motor.number, unit.tau * motor.theta, unit.r_w * omega)


@inlined
def dragging(fx, unit, motor, theta_dot):
    """With effects: all that a motor needs before its gear at a speed `theta_dot` (rad/s), N m."""
    return dragged(fx, unit, motor.number, theta_dot) + at_shaft(fx, unit, motor, theta_dot)


@inlined
def motor_acts(p, fx, unit, motor, forces):
    """What a motor does at an instant whose wheels' `forces` are known (eqs 21, 22, 26 to 28)."""
    M_r = load_torque(p, unit, forces, unit.tau * motor.theta_dot)
    drag = dragging(fx, unit, motor, motor.theta_dot) if fx is not None else 0.0
    load = motor.gear * M_r
    if fx is not None:
        load += drag
    M_m, theta_ddot = solved(fx, motor, motor.J, motor.inverse_J, load, unit.torque_max)
    return MotorAction(M_m, M_r, drag, theta_ddot, motor.theta_dot)


@inlined
def forces_now(body, fx, pair, soil, motor, rim, angle, kept_f, kept_b):
    """`contact.wheel_forces` of one rover alone at an instant."""
    return wheel_forces(within_friction, body, fx, pair, soil, motor, rim, angle, kept_f, kept_b, None)


@inlined
def loaded(body, p, fx, units, pairs, soils, motor, turned, lags, wheels, first):
    """With effects: what a module's wheels meet under the loads that they carry as it moves, right and left.

    Parameters
    ----------
    units : tuple of 2 MotorParams
    motor : int
        The right one, by whose number its wheels are known.
    turned : tuple of 4 floats
        Angles of both motors, rad, then their speeds, rad/s.
    lags, wheels, first
        See `kept_by`: what so many wheels remember, and the first of this module.
    """
    if hooks.height(fx) <= 0.0:
        return pairs
    right, left = units
    rims = right.r_w * (right.tau * turned[2]), left.r_w * (left.tau * turned[3])
    angles, i = (right.tau * turned[0], left.tau * turned[1]), first
    kept = (
        kept_by(lags, wheels, i), kept_by(lags, wheels, i + 1), kept_by(lags, wheels, i + 2),
        kept_by(lags, wheels, i + 3),
    )  # fmt: skip
    return load_transfer(forces_now, body, fx, p.pitching, pairs, soils, motor, rims, angles, kept)


@inlined
def step_ahead(body, p, fx, unit, motor, on, kept, dt):
    """A motor's acceleration over a step, the wheels' slip taken implicitly (linearised at the old speed), its torque.

    A prescribed motor's torque follows from the new forces; zero stands in its place here. The wheels stand `on` a
    `Footing`; `kept` is what they remember (`kept_by`), the front one first.
    """
    theta_dot = motor.theta_dot
    if motor.mode == PRESCRIBED:
        return motor.wish, 0.0
    omega = unit.tau * theta_dot
    rim, angle = unit.r_w * omega, unit.tau * motor.theta
    forces = pair_forces(within_friction, body, fx, on.pair, on.soil, motor.number, rim, angle, kept[0], kept[1], None)
    load = motor.gear * load_torque(p, unit, forces, omega)
    inertia = motor.J + dt * motor.gear * unit.r_w * (forces.slope * unit.r_w) * unit.tau
    if fx is not None:
        drag = dragged(fx, unit, motor.number, theta_dot)
        load += drag
        inertia += dt * drag / theta_dot if theta_dot != 0.0 else 0.0
        load += at_shaft(fx, unit, motor, theta_dot)
    M_m, theta_ddot = solved(fx, motor, inertia, 1.0 / inertia, load, unit.torque_max)
    return theta_ddot, M_m


@inlined
def motor_with_wheels(body, p, fx, unit, motor, on, kept, dt, ahead, torques):
    """A motor and its two wheels (eqs 15, 16, 21, 22): at an instant (`dt` None), or over a semi-implicit step.

    For `on` and `kept` see `step_ahead`; over a step `ahead` is what that gives. A prescribed motor at an instant needs
    to know no force unless `torques` are asked for; they are zero then.

    Returns
    -------
    contact.PairForces
        Over a step those at the new speed.
    MotorAction
    """
    speed = motor.theta_dot
    if dt is not None:
        theta_ddot, M_m = ahead
        speed += dt * theta_ddot
    omega = unit.tau * speed
    rim, angle = unit.r_w * omega, unit.tau * motor.theta
    forces = pair_forces(within_friction, body, fx, on.pair, on.soil, motor.number, rim, angle, kept[0], kept[1], dt)
    if dt is None:
        if motor.mode == PRESCRIBED and not torques:
            return forces, MotorAction(0.0, 0.0, 0.0, motor.wish, speed)
        return forces, motor_acts(p, fx, unit, motor, forces)
    M_r = load_torque(p, unit, forces, omega)
    drag = dragging(fx, unit, motor, speed) if fx is not None else 0.0
    if motor.mode == PRESCRIBED:
        M_m = motor.J * theta_ddot + motor.gear * M_r
        if fx is not None:
            M_m += drag
    return forces, MotorAction(M_m, M_r, drag, theta_ddot, speed)


@inlined
def kept_by(lags, wheels, wheel):
    """What a wheel remembers, of the memories of so many `wheels` (see `layout.MEMORY`).

    `lags` is the array of these in a tuple. An empty one, of wheels that remember nothing, is known at compile time.
    """
    if len(lags) == 0:
        return ()
    lag = lags[0]
    return lag[wheel], lag[wheels + wheel], lag[2 * wheels + wheel], lag[3 * wheels + wheel]


@inlined
def write_rates(fx, forces, wheels, wheel, lags, first):
    """With effects: how fast what a motor's two wheels remember changes, from `first` on; the front one is `wheel`.

    They go into the array in `lags`, nowhere where that is empty.
    """
    if len(lags) == 0:
        return
    out = lags[0]
    i = first + wheel
    out[i], out[i + 1] = forces.rate_f, forces.rate_b
    out[wheels + i], out[wheels + i + 1] = forces.wound_f, forces.wound_b
    stiff, _ = hooks.bristle(fx, 0.0)
    if stiff > 0.0:
        out[2 * wheels + i], out[3 * wheels + i] = forces.bent_f
        out[2 * wheels + i + 1], out[3 * wheels + i + 1] = forces.bent_b


@inlined
def write_wheels(pair, forces, motor, w):
    """What the two wheels of a motor meet and do, into the row."""
    i = 2 * motor
    w[P_X + i], w[P_X + i + 1] = pair.p_xf, pair.p_xb
    w[P_Y + i], w[P_Y + i + 1] = pair.p_yf, pair.p_yb
    w[F_N + i], w[F_N + i + 1] = forces.F_nf, forces.F_nb
    w[F_L + i], w[F_L + i + 1], w[F_T + i], w[F_T + i + 1] = forces.F_lf, forces.F_lb, forces.F_tf, forces.F_tb
    w[SAT + i] = 1.0 if forces.held_f != 1.0 else 0.0
    w[SAT + i + 1] = 1.0 if forces.held_b != 1.0 else 0.0


@inlined
def write_motor(fx, acting, motor, hold, w):
    """What a motor does, into the row."""
    w[M_M + motor], w[M_R + motor], w[ETA + motor] = acting.M_m, acting.M_r, hold[EFFICIENCY + motor]
    w[ACC + coordinate_of(motor)] = acting.theta_ddot
    if fx is not None:
        w[M_D + motor] = acting.drag


@inlined
def move_side(body, p, fx, unit, motor, on, lags, dt, hold, w):
    """A `MotorMotion` and its wheels, which stand `on` a footing, into the row; returns `contact.PairForces`."""
    i, ahead = 2 * motor.number, None
    kept = kept_by(lags, 8, i), kept_by(lags, 8, i + 1)
    if dt is not None:
        ahead = step_ahead(body, p, fx, unit, motor, on, kept, dt)
    forces, acting = motor_with_wheels(body, p, fx, unit, motor, on, kept, dt, ahead, True)
    write_wheels(on.pair, forces, motor.number, w)
    write_motor(fx, acting, motor.number, hold, w)
    if fx is not None:
        write_rates(fx, forces, 8, i, lags, MEMORY)
    return forces


@inlined
def module_forces(p, fx, module, q, v, trig, commands, lags, dt, w):
    """Motors, wheels and ground of one module, into the row; the joint left out.

    `module` are `ModuleParts`, `trig` sine and cosine of its roll and of its yaw.

    Returns
    -------
    tuple of 5 floats
        Free accelerations of x, y, z, alpha and gamma.
    """
    (body, right, left, number), (_, c_a, s_g, c_g) = module, trig
    b, motor = BACK * number, 2 * number
    pair_r, pair_l = wheel_pairs(body, p, fx, q, v, b, trig, number)
    soil_r = soil_under(body, p, fx, pair_r, q[b + X], q[b + Y], s_g, c_g, c_a, -1.0)
    soil_l = soil_under(body, p, fx, pair_l, q[b + X], q[b + Y], s_g, c_g, c_a, 1.0)
    met_r, met_l = pair_r, pair_l
    if fx is not None:
        turned = q[b + THETA_R], q[b + THETA_L], v[b + THETA_R], v[b + THETA_L]
        met_r, met_l = loaded(
            body, p, fx, (right, left), (pair_r, pair_l), (soil_r, soil_l), motor, turned, lags, 8, 2 * motor
        )
    turns_r, turns_l = motors_at(p, fx, commands, number, q, v)
    on_right = move_side(body, p, fx, right, turns_r, Footing(met_r, soil_r), lags, dt, commands.hold, w)
    on_left = move_side(body, p, fx, left, turns_l, Footing(met_l, soil_l), lags, dt, commands.hold, w)
    forces = generalised_forces(body, p, fx, trig, on_right, on_left, (pair_r, pair_l), number, w)
    return module_free(p, fx, module, v, trig, on_right, on_left, forces, w)


@inlined
def module_on_uneven(p, fx, ground, module, q, v, trig, commands, lags, dt, w):
    """Motors, wheels and forces of one module on uneven `ground`.

    Returns
    -------
    tuple of 6 floats
        Free accelerations of x, y, z, alpha, gamma and beta.
    """
    (body, right, left, number), (s_a, c_a, s_g, c_g) = module, trig
    b = BACK * number
    at = uneven.attitude_of(p, s_a, c_a, q[b + BETA], s_g, c_g)
    sides = uneven.sides_of(body, p, fx, ground, number, at, q, v, b)
    turns_r, turns_l = motors_at(p, fx, commands, number, q, v)
    on_right = move_side(body, p, fx, right, turns_r, sides[0], lags, dt, commands.hold, w)
    on_left = move_side(body, p, fx, left, turns_l, sides[1], lags, dt, commands.hold, w)
    forces = uneven.generalised_forces(p, fx, at, sides, on_right, on_left, number, w)
    return module_free(p, fx, module, v, trig, on_right, on_left, forces, w)


@inlined
def module_free(p, fx, module, v, trig, on_right, on_left, forces, w):
    """A module's free accelerations under its wheels' generalised `forces` and what effects load it with."""
    (body, _, _, number), (_, c_a, s_g, c_g) = module, trig
    loads = 0.0, 0.0, 0.0, 0.0, 0.0
    if fx is not None:
        b = BACK * number
        forward = c_g * v[b + X] + s_g * v[b + Y]
        loads = module_loads(body, fx, number, forward, on_right, on_left, s_g, c_g, c_a)
        write_loads(loads, number, w)
    return free_acceleration(body, p, fx, s_g, c_g, forces, loads, number)


@inlined
def module_alone(p, fx, ground, module, q, v, trig, commands, lags, dt, w):
    """One module on flat ground (`ground` is empty, at compile time) or on uneven one, the joint left out."""
    if len(ground) == 0:
        return module_forces(p, fx, module, q, v, trig, commands, lags, dt, w)
    return module_on_uneven(p, fx, ground, module, q, v, trig, commands, lags, dt, w)


@inlined
def note_instant(p, fx, q, v, s_f, c_f, s_b, c_b):
    """With effects: what laws may see of a rover at (q, v), whose modules' yaws have these sines and cosines."""
    motion, b = motion_in(fx), BACK
    forward, left = c_f * v[X] + s_f * v[Y], c_f * v[Y] - s_f * v[X]
    note_module(motion, FRONT, q[X], q[Y], q[GAMMA], forward, left, v[GAMMA])
    right_f, left_f = p.right_front.tau * q[THETA_R], p.left_front.tau * q[THETA_L]
    if not p.two:
        note_angles(motion, right_f, left_f, 0.0, 0.0, 0.0, 0.0)
        return
    forward, left = c_b * v[b + X] + s_b * v[b + Y], c_b * v[b + Y] - s_b * v[b + X]
    note_module(motion, BEHIND, q[b + X], q[b + Y], q[b + GAMMA], forward, left, v[b + GAMMA])
    right_b, left_b = p.right_back.tau * q[b + THETA_R], p.left_back.tau * q[b + THETA_L]
    note_angles(motion, right_f, left_f, right_b, left_b, q[b + GAMMA] - q[GAMMA], v[b + GAMMA] - v[GAMMA])


@inlined
def accelerations(q, v, p, fx, ground, commands, lags, dt, w):
    """All of eq. 28 at (q, v): every contribution and the accelerations of all coordinates, into the row.

    At an instant (`dt` None), or as a semi-implicit step of `dt` (s) takes them. `ground` is empty, at compile time,
    where it is flat.
    """
    trig = attitude(q)
    geometry = joint_geometry(q, v, p, fx, trig)
    sa_f, ca_f, sg_f, cg_f, sa_b, ca_b, sg_b, cg_b = trig
    if fx is not None:
        note_instant(p, fx, q, v, sg_f, cg_f, sg_b, cg_b)
    parts = ModuleParts(p.front, p.right_front, p.left_front, FRONT)
    front = module_alone(p, fx, ground, parts, q, v, (sa_f, ca_f, sg_f, cg_f), commands, lags, dt, w)
    if not p.two:
        for i in range(3):
            w[ACC + i] = front[i]
        w[ACC + ALPHA], w[ACC + GAMMA] = front[3], front[4]
        w[ACC + BETA] = on_pitch(front)
        if fx is not None:
            back_to_origin(fx, v, sg_f, cg_f, FRONT, w)
        return
    parts = ModuleParts(p.back, p.right_back, p.left_back, BEHIND)
    back = module_alone(p, fx, ground, parts, q, v, (sa_b, ca_b, sg_b, cg_b), commands, lags, dt, w)
    if fx is not None:
        front, back = turned_by_joint(p, fx, v, geometry, front, back, q[BACK + GAMMA] - q[GAMMA], dt, w)
    multiplier = multipliers(v, p, geometry, front, back)
    w[LAMBDA], w[LAMBDA + 1], w[LAMBDA + 2], w[LAMBDA + 3] = multiplier
    jointed(p.front, geometry[1], front, -1.0, multiplier, FRONT, w)
    jointed(p.back, geometry[2], back, 1.0, multiplier, BEHIND, w)
    if fx is not None:
        back_to_origin(fx, v, sg_f, cg_f, FRONT, w)
        back_to_origin(fx, v, sg_b, cg_b, BEHIND, w)
