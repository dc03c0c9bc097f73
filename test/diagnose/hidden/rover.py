"""The articulated rover in the plane, with whatever may be hidden in it: recordings for tests are driven with this.

It shares no code with `artibot_sim.model`, nor equations with `test/model/planar.py`: velocities are those of the front
module in its own frame (quasi-velocities), the joint is eliminated in that frame, and the method is Heun's.

Derivation
----------
With u, v the front origin's velocity in {f}, r and s the yaw rates of both modules, phi = gamma_b − gamma_f and
c = (c_x, c_y) the front module's centre of mass in {f}, seen from {f}:

    front centre   a_f = (u' − r v, v' + r u) + r' (−c_y, c_x) − r² (c_x, c_y)
    back origin    a_b = (u' − r v, v' + r u) + r' (0, −l_f) + r² (l_f, 0) + s' l_b (sin phi, −cos phi)
                         + s² l_b (cos phi, sin phi)

Jourdain's principle for the virtual velocities u, v, r, s gives four rows; u' and v' have the same diagonal mass, so a
2 x 2 system in r', s' is left. Wheels: eqs 15 to 19 of the paper; motors: eqs 21 to 23; torque sharing: eq. 30.
"""

from __future__ import annotations

from math import cos, exp, inf, sin, sqrt, tanh

import numpy as np
from diagnose.hidden.parts import Rover
from numba import njit

STEP = 2.5e-4
"""s; free wheels lose their slip at up to 1900 /s."""
STATE, ROW = 26, 36
"""Numbers of the state, and kept of an instant: these, 4 torques of motors, 4 efficiencies, 2 torques a step before."""
X, Y, YAW_F, YAW_B, ANGLE, U, V, R, S, SPEED = 0, 1, 2, 3, 4, 8, 9, 10, 11, 12
LATERAL, BRISTLE, HOSE, TORQUE, ETA, BEFORE = 16, 24, 25, 26, 30, 34


@njit(cache=True)
def _grip(t, x, y, behind, h):
    """Factors of k_l, k_t and of mu_s, mu_d for a wheel at (x, y)."""
    k = max(0.05, 1.0 - h.softening * t)
    if behind:
        k *= h.back_scale
    inside = (x - h.patch_x) ** 2 + (y - h.patch_y) ** 2 < h.patch_radius**2
    return k, k * h.patch_scale if inside else k


@njit(cache=True)
def _wheel(k, k_l, k_t, mu_s, mu_d, load, slip, p_x, p_y, state, rates, h):
    """Eqs 15, 16: longitudinal and lateral force of wheel k."""
    F_l, F_t = k_l * slip, -k_t * p_y
    if h.relaxation > 0.0:
        rates[LATERAL + k] = (F_t - state[LATERAL + k]) * max(abs(p_x), 0.05) / h.relaxation
        F_t = state[LATERAL + k]
    F_h = sqrt(F_l * F_l + F_t * F_t)
    if F_h > mu_s * load:
        mu = mu_d
        if h.stribeck > 0.0:
            mu += (mu_s - mu_d) * exp(-sqrt(slip * slip + p_y * p_y) / h.stribeck)
        F_l, F_t = F_l * mu * load / F_h, F_t * mu * load / F_h
    return F_l, F_t - h.bulldozing * abs(p_y) * p_y


@njit(cache=True)
def _contact(t, state, rover, rates, out):
    """Sums over each module's wheels in its own frame: out[0:3], out[3:6] = force x, y, moment; out[6:10] = M_r."""
    f, b = rover.front, rover.back
    out[:] = 0.0
    c, n, w, u, v = cos(state[YAW_F]), sin(state[YAW_F]), state[R], state[U], state[V]
    _module(t, state, rover, 0, f, rover.front_gear, (state[X], state[Y], c, n, u, v, w), rates, out)
    phi, v_j = state[YAW_B] - state[YAW_F], v - f.l * w
    C, N = cos(state[YAW_B]), sin(state[YAW_B])
    x, y = state[X] - f.l * c - b.l * C, state[Y] - f.l * n - b.l * N
    w = state[S]
    u, v = cos(phi) * u + sin(phi) * v_j, -sin(phi) * u + cos(phi) * v_j - b.l * w
    _module(t, state, rover, 1, b, rover.back_gear, (x, y, C, N, u, v, w), rates, out)


@njit(cache=True)
def _module(t, state, rover, module, body, gear, motion, rates, out):
    """The four wheels of a module whose origin has this `motion`: x, y, cos and sin of yaw, u, v, yaw rate."""
    h, soil = rover.hidden, rover.soil
    x_o, y_o, c, n, u, v, w = motion
    o, weight = 3 * module, 0.25 * body.m * h.gravity
    for motor in (2 * module, 2 * module + 1):
        side = 2.0 * (motor % 2) - 1.0
        y_w, omega = side * body.half_y, gear.tau * state[SPEED + motor]
        r_w, sense, p_x = rover.r_right if side < 0.0 else rover.r_left, tanh(omega / 0.02), u - w * y_w
        for k in (2 * motor, 2 * motor + 1):
            end = 1.0 - 2.0 * (k % 2)
            x_w = end * body.half_x
            x, y = x_o + c * x_w - n * y_w, y_o + n * x_w + c * y_w
            p_y = v + w * x_w
            r = r_w
            if h.runout != 0.0 and k == int(h.runout_wheel):
                r *= 1.0 + h.runout * sin(gear.tau * state[ANGLE + motor] + h.runout_phase)
            load = weight * (1.0 + end * body.c_x / body.half_x) * (1.0 + side * body.c_y / body.half_y)
            stiff, rough = _grip(t, x, y, module == 1, h)
            F_l, F_t = _wheel(
                k, stiff * soil.k_l, stiff * soil.k_t, rough * soil.mu_s, rough * soil.mu_d, load, r * omega - p_x,
                p_x, p_y, state, rates, h,
            )  # fmt: skip
            if h.ridge != 0.0:
                F_t += h.ridge * sin(h.ridge_x * x + h.ridge_y * y + h.ridge_phase)
            if h.lame != 0.0 and k == int(h.lame_wheel):
                F_l += h.lame * sin(gear.tau * state[ANGLE + motor] + h.lame_phase)
            if h.skid != 0.0 and k == int(h.skid_wheel):
                F_t -= h.skid * p_y
            ahead = soil.u_w * (1.0 + h.rolling_speed * sqrt(p_x * p_x + p_y * p_y))
            out[o] += F_l
            out[o + 1] += F_t
            out[o + 2] += (x_w + ahead) * F_t - y_w * F_l
            out[6 + motor] += r * F_l + ahead * load * sense


@njit(cache=True)
def _joint(angle, rate, h):
    """Torque of the joint against its yaw, N m."""
    torque = h.joint_friction * tanh(rate / 0.01) + h.joint_damping * rate + h.joint_stiffness * angle + h.preload
    if h.hysteresis != 0.0:
        torque += h.hysteresis * abs(angle) * tanh(rate / 0.05)
    if angle > h.joint_stop:
        torque += max(0.0, 4000.0 * (angle - h.joint_stop) + 40.0 * rate)
    elif angle < -h.joint_stop:
        torque += min(0.0, 4000.0 * (angle + h.joint_stop) + 40.0 * rate)
    return torque


@njit(cache=True)
def _elsewhere(t, state, front, back, h, out):
    """Add to the modules' sums what neither wheels nor the joint do, rotated from the map into their frames."""
    air = h.air * sqrt(state[U] ** 2 + state[V] ** 2)
    push_x = h.push_x - h.tether * (state[X] - h.tether_x)
    push_y = h.push_y - h.tether * (state[Y] - h.tether_y)
    for o, yaw, body in ((0, state[YAW_F], front), (3, state[YAW_B], back)):
        fx = cos(yaw) * h.pull_x + sin(yaw) * h.pull_y
        fy = -sin(yaw) * h.pull_x + cos(yaw) * h.pull_y
        out[o] += body.m * fx
        out[o + 1] += body.m * fy
        out[o + 2] += body.m * (body.c_x * fy - body.c_y * fx)
    out[0] += cos(state[YAW_F]) * push_x + sin(state[YAW_F]) * push_y - air * state[U]
    out[1] += -sin(state[YAW_F]) * push_x + cos(state[YAW_F]) * push_y - air * state[V]
    out[2] -= h.yaw_drag * state[R]
    if h.gyre != 0.0:
        out[2] -= h.gyre * state[U] * state[R]
    if h.creep != 0.0:
        out[0] -= h.creep * max(abs(state[U]) - h.creep_from, 0.0) * np.sign(state[U])
    if h.growing != 0.0:
        out[0] -= h.growing * t * tanh(state[U] / 0.05)
    if h.bog != 0.0:
        out[0] -= h.bog / (1.0 + exp(-(state[X] - h.bog_x) / 0.1)) * tanh(state[U] / 0.05)
    w = h.wander
    out[5] += w[0] * sin(w[1] * t + w[2]) + w[3] * sin(w[4] * t + w[5])


@njit(cache=True)
def _bodies(state, rover, out, rates):
    """u', v', r', s' from the sums of forces."""
    f, b, h = rover.front, rover.back, rover.hidden
    u, v, r, s = state[U], state[V], state[R], state[S]
    phi = state[YAW_B] - state[YAW_F]
    c, n = cos(phi), sin(phi)
    joint = _joint(phi, s - r, h) + state[BRISTLE] + state[HOSE]
    if h.bristle != 0.0:  # Dahl's friction: a spring that gives way as it nears its largest torque
        rates[BRISTLE] = h.bristle / h.bristle_angle * (s - r) - abs(s - r) / h.bristle_angle * state[BRISTLE]
    if h.hose != 0.0:  # Maxwell's: a spring and a damper in a row
        rates[HOSE] = h.hose * (s - r) - state[HOSE] / h.hose_time
    X_b, Y_b = c * out[3] - n * out[4], n * out[3] + c * out[4]
    # accelerations that are there without u', v', r', s'
    fx, fy = -r * v - r * r * f.c_x, r * u - r * r * f.c_y
    bx, by = -r * v + r * r * f.l + s * s * b.l * c, r * u + s * s * b.l * n
    Q_u, Q_v = out[0] + X_b - f.m * fx - b.m * bx, out[1] + Y_b - f.m * fy - b.m * by
    Q_r = out[2] + joint - f.l * (Y_b - b.m * by) - f.m * (f.c_x * fy - f.c_y * fx)
    Q_s = out[5] - joint + b.l * (n * (X_b - b.m * bx) - c * (Y_b - b.m * by))
    # the mass matrix: rows u, v against columns r, s, and the corner of r, s
    m = f.m + b.m
    ur, vr, us, vs = -f.m * f.c_y, f.m * f.c_x - b.m * f.l, b.m * b.l * n, -b.m * b.l * c
    rr = f.J_z + f.m * (f.c_x**2 + f.c_y**2) + b.m * f.l**2 - (ur * ur + vr * vr) / m
    ss = b.J_z + b.m * b.l**2 - (us * us + vs * vs) / m
    rs = b.m * f.l * b.l * c - (ur * us + vr * vs) / m
    Q_r -= (ur * Q_u + vr * Q_v) / m
    Q_s -= (us * Q_u + vs * Q_v) / m
    det = rr * ss - rs * rs
    dr, ds = (ss * Q_r - rs * Q_s) / det, (rr * Q_s - rs * Q_r) / det
    rates[U], rates[V] = (Q_u - ur * dr - us * ds) / m, (Q_v - vr * dr - vs * ds) / m
    rates[R], rates[S] = dr, ds


@njit(cache=True)
def _drag(i, t, state, h):
    """Torque against the rotation of motor i before its gear."""
    torque = 0.0
    if i == int(h.drag_motor):
        torque = h.drag * exp(-t / h.drag_fades)
    if h.grease != 0.0 and i == int(h.grease_motor):
        torque += h.grease * exp(-abs(state[ANGLE + i]) / h.grease_turns)
    return torque * tanh(state[SPEED + i] / 0.5)


@njit(cache=True)
def _motors(t, state, rover, eta, held, wish, wish_rate, out, rates, torque):
    """Eq. 21 for each motor: the front ones follow their wish as their torque allows, the back ones have `held`."""
    h = rover.hidden
    for i in range(4):
        gear = rover.back_gear if i > 1 else rover.front_gear
        J = gear.J_m + gear.J_w * gear.tau**2 / eta[i]
        load = gear.tau / eta[i] * out[6 + i]
        load += _drag(i, t, state, h)
        if i > 1:
            torque[i] = held
        else:
            torque[i] = J * (wish_rate[i] + 40.0 * (wish[i] - state[SPEED + i])) + load
            torque[i] = min(max(torque[i], -h.front_max), h.front_max)
            if h.stall < inf:  # two lines of a motor at full voltage, and the current at rest
                lost = h.stall * state[SPEED + i] / h.no_load
                torque[i] = min(max(torque[i], -h.stall - lost, -h.stall), h.stall - lost, h.stall)
        rates[SPEED + i] = (torque[i] - load) / J


@njit(cache=True)
def _rates(t, state, rover, eta, held, wish, wish_rate, out, rates, torque):
    """Derivative of the state, and the motors' torques."""
    _contact(t, state, rover, rates, out)
    _elsewhere(t, state, rover.front, rover.back, rover.hidden, out)
    _bodies(state, rover, out, rates)
    _motors(t, state, rover, eta, held, wish, wish_rate, out, rates, torque)
    c, n = cos(state[YAW_F]), sin(state[YAW_F])
    rates[X], rates[Y] = c * state[U] - n * state[V], n * state[U] + c * state[V]
    rates[YAW_F], rates[YAW_B] = state[R], state[S]
    for i in range(4):
        rates[ANGLE + i] = state[SPEED + i]


@njit(cache=True)
def drive(row, t, h, every, wish, rover, widest=inf):
    """Rows (n, ROW), `every` steps of `h` s apart, of a drive from `row` at time `t` on.

    Parameters
    ----------
    wish : array, shape (steps + 1, 2)
        Speeds that the front motors are to have, rad/s, step by step. Where their torque has no limit they have them.
    widest : float
        The drive ends with the first row in which the joint is bent further (rad); later rows are zero.
    """
    steps = wish.shape[0] - 1
    rows = np.zeros((steps // every + 1, ROW))
    state, eta, before = row[:STATE].copy(), row[ETA : ETA + 4].copy(), row[BEFORE : BEFORE + 2].copy()
    first, second, ahead, torque, unused = np.zeros(STATE), np.zeros(STATE), np.zeros(STATE), np.zeros(4), np.zeros(4)
    out = np.zeros(10)
    free = rover.hidden.front_max < inf or rover.hidden.stall < inf
    for k in range(steps + 1):
        j = min(k, steps - 1)
        slope = (wish[j + 1] - wish[j]) / h
        if not free:
            state[SPEED : SPEED + 2] = wish[k]
        held = rover.share * (before[0] + before[1])
        _rates(t + k * h, state, rover, eta, held, wish[k], slope, out, first, torque)
        if k % every == 0:
            kept = rows[k // every]
            kept[:STATE], kept[TORQUE : TORQUE + 4], kept[ETA : ETA + 4], kept[BEFORE : BEFORE + 2] = (
                state,
                torque,
                eta,
                before,
            )
            if abs(state[YAW_B] - state[YAW_F]) >= widest:
                break
        if k == steps:
            break
        for i in range(STATE):
            ahead[i] = state[i] + h * first[i]
        if not free:
            ahead[SPEED : SPEED + 2] = wish[k + 1]
        _rates(t + (k + 1) * h, ahead, rover, eta, held, wish[k + 1], slope, out, second, unused)
        # eqs 23 and 30 of the next step run on this one's torques; eq. 23 by what goes through the gear
        for i in range(4):
            gear = rover.back_gear if i > 1 else rover.front_gear
            through = torque[i] - _drag(i, t + k * h, state, rover.hidden)
            eta[i] = gear.eta_d if through * state[SPEED + i] >= 0.0 else 1.0 / gear.eta_r
        before[:] = torque[:2]
        for i in range(STATE):
            state[i] += 0.5 * h * (first[i] + second[i])
    return rows


def at_rest(rover: Rover, x: float = 0.0, y: float = 0.0, yaw: float = 0.0) -> np.ndarray:
    """The row (ROW,) of a straight rover that stands at a pose (m, m, rad)."""
    row = np.zeros(ROW)
    row[X], row[Y], row[YAW_F], row[YAW_B] = x, y, yaw, yaw
    row[ETA : ETA + 2], row[ETA + 2 : ETA + 4] = rover.front_gear.eta_d, rover.back_gear.eta_d
    return row
