"""Commands, cuts, mirrors and sums that several of the model's tests use."""

from __future__ import annotations

import numpy as np

from artibot_sim.model import Commands, State

GRAVITY = 9.81
MIRROR_COORDINATES = [0, 1, 2, 3, 4, 5, 7, 6, 8, 9, 10, 11, 12, 13, 15, 14]
MIRROR_SIGNS = np.array([1, -1, 1, -1, 1, -1, 1, 1] * 2)
MIRROR_MOTORS = [1, 0, 3, 2]


def front_commands(robot, speed, yaw_rate, duration, h=0.01):
    """Front motor speeds for a forward speed (m/s) and yaw rate (rad/s) given as functions of time, no slip assumed."""
    t = h * np.arange(round(duration / h) + 1)
    v, w = speed(t) + 0.0 * t, yaw_rate(t) + 0.0 * t
    per_speed = 1.0 / (robot.wheel.r_w * robot.drive.front.tau)
    velocity = np.full((len(t), 4), np.nan)
    velocity[:, 0] = per_speed * (v + 0.5 * robot.front.i_y * w)
    velocity[:, 1] = per_speed * (v - 0.5 * robot.front.i_y * w)
    return Commands(h, velocity)


def ramp(t, duration=2.0):
    """From 0 to 1 with no jump in the first derivative."""
    s = np.clip(t / duration, 0.0, 1.0)
    return s * s * (3 - 2 * s)


def standstill(duration, h=0.01, motors=2):
    """Commands that hold the first `motors` motors where they are."""
    velocity = np.full((round(duration / h) + 1, 4), np.nan)
    velocity[:, :motors] = 0.0
    return Commands(h, velocity)


def from_knot(commands, n):
    """The same commands from their knot `n` on."""
    return Commands(
        commands.dt,
        commands.velocity[n:],
        position=commands.position[n:],
        torque=commands.torque[n:],
        t0=commands.t0 + n * commands.dt,
    )


def mirrored_commands(commands):
    """Right and left exchanged."""
    swap = MIRROR_MOTORS
    return Commands(
        commands.dt,
        commands.velocity[:, swap],
        position=commands.position[:, swap],
        torque=commands.torque[:, swap],
        t0=commands.t0,
    )


def mirrored(q):
    """Coordinates or rates (…, 16) as a mirror in the x-z plane shows them."""
    return (np.asarray(q) * MIRROR_SIGNS)[..., MIRROR_COORDINATES]


def mirrored_state(state):
    swap = MIRROR_MOTORS
    return State(state.t, mirrored(state.q), mirrored(state.v), state.eta[swap], state.torque[swap])


def what_wheels_remember(rng):
    """Lateral forces, bristles and windup of a `State` of two modules, drawn at random."""
    lateral, bristles = 20.0 * rng.normal(size=8), 1e-4 * rng.normal(size=16)
    return {"lateral": lateral, "bristles": bristles, "windup": rng.uniform(-1.0, 1.0, 8)}


def relative_poses(q, module=0):
    """x, y, yaw of a module as seen from where the front module was in the first row, shape (n, 3)."""
    x0, y0, yaw = q[0, 0], q[0, 1], q[0, 5]
    c, s = np.cos(yaw), np.sin(yaw)
    dx, dy = q[:, 8 * module] - x0, q[:, 8 * module + 1] - y0
    return np.column_stack([c * dx + s * dy, c * dy - s * dx, q[:, 8 * module + 5] - yaw])


def observed_order(errors, steps):
    """Slope of log(error) over log(step)."""
    return np.polyfit(np.log(steps), np.log(errors), 1)[0]


def smooth_robot(robot, wheel_inertia_factor=20.0):
    """A robot on which the model is smooth: nothing slides, gears lose nothing, wheel spin is not stiff."""
    changes = {"contact.mu_s": 50.0, "contact.mu_d": 50.0}
    for module in ("front", "back"):
        changes |= {f"drive.{module}.eta_d": 1.0, f"drive.{module}.eta_r": 1.0}
        changes[f"drive.{module}.J_m"] = wheel_inertia_factor * getattr(robot.drive, module).J_m
    return robot.replace(changes)


def stored_energy(robot, q, v):
    """Energy in a state (n,), J, from eqs 5, 8, 9, 12 and the tyres' springs, written out apart from the model."""
    total = np.zeros(len(q))
    wheel = robot.wheel
    for k, body, drive in ((0, robot.front, robot.drive.front), (8, robot.back, robot.drive.back)):
        if body is None:
            continue
        m = body.m + 4 * wheel.m_w
        J_x = body.J_x + 4 * wheel.J_wx + wheel.m_w * body.i_y**2
        J_y = body.J_y + 4 * wheel.J_wy + wheel.m_w * body.i_x**2
        J_z = body.J_z + 4 * wheel.J_wx + wheel.m_w * (body.i_x**2 + body.i_y**2)
        total += 0.5 * (v[:, k : k + 6] ** 2 @ np.array([m, m, m, J_x, J_y, J_z]))
        spin = drive.J_m + 2 * wheel.J_wy * drive.tau**2
        total += 0.5 * spin * (v[:, k + 6] ** 2 + v[:, k + 7] ** 2)
        total += m * GRAVITY * q[:, k + 2]
        sag = m * GRAVITY / (4 * robot.contact.k_n)
        for y in (-0.5 * body.i_y, 0.5 * body.i_y):
            lift = q[:, k + 2] + y * np.sin(q[:, k + 3]) - wheel.r_w
            total += robot.contact.k_n * (sag - lift) ** 2
    return total


def energy_gap(robot, result):
    """Energy put in by the motors, less what is stored and what the contributions account for (n,), J."""
    stored = stored_energy(robot, result.q, result.v)
    gap = stored[0] - stored
    for name in result.columns:
        if name.startswith("E_"):
            # the motors put in, and what the joint's stabilisation does on the modules counts as put in
            gap += result[name] * (1.0 if name.startswith(("E_motor", "E_joint")) else -1.0)
    return gap
