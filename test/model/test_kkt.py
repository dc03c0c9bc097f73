"""The augmented system (25), (28), assembled here from independent parts, holds at what the compiled kernel returns.

Inertias are eq. 9 written out, Phi_x and its rate come from sympy, the generalised contact forces from complex steps.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from model.helpers import GRAVITY, front_commands, ramp
from model.planar import _hermite
from model.symbolic import geometry_of, joint
from model.test_contact_forces import expected

from artibot_sim.model import MOTORS, WHEELS, Mode, rollout
from artibot_sim.model.reference.dynamics import solve
from artibot_sim.model.robot.derived import params

MOTOR_COORDINATES = [6, 7, 14, 15]
MODES = (Mode.PRESCRIBED, Mode.PRESCRIBED, Mode.TORQUE, Mode.TORQUE)


def mass_matrix(robot, eta):
    """Diagonal of M (16,): eq. 9 for the modules, eq. 21 for the motors."""
    wheel, diagonal = robot.wheel, np.zeros(16)
    for k, body, drive in ((0, robot.front, robot.drive.front), (8, robot.back, robot.drive.back)):
        diagonal[k : k + 3] = body.m + 4 * wheel.m_w
        diagonal[k + 3] = body.J_x + 4 * wheel.J_wx + wheel.m_w * body.i_y**2
        diagonal[k + 4] = body.J_y + 4 * wheel.J_wy + wheel.m_w * body.i_x**2
        diagonal[k + 5] = body.J_z + 4 * wheel.J_wx + wheel.m_w * (body.i_x**2 + body.i_y**2)
        diagonal[k + 6 : k + 8] = drive.J_m + 2 * wheel.J_wy * drive.tau**2 / eta[k // 4 : k // 4 + 2]
    return diagonal


def applied(robot, q, v, eta, M_m, gravity):
    """Terms of n (list of (16,)): weight, every wheel's Q, motors and the loads on them."""
    forces, per_wheel = expected(robot, q, v)
    weight, motors = np.zeros(16), np.zeros(16)
    for k, body, drive in ((0, robot.front, robot.drive.front), (8, robot.back, robot.drive.back)):
        weight[k : k + 3] = (body.m + 4 * robot.wheel.m_w) * np.asarray(gravity)
        for side in (0, 1):
            i, c = k // 4 + side, k + 6 + side
            pair = [forces[f"{MOTORS[i]}_{end}"] for end in ("front", "back")]
            omega = drive.tau * v[c]
            M_r = robot.wheel.r_w * sum(F[0] for F in pair)
            M_r += robot.contact.u_w * sum(F[2] for F in pair) * np.tanh(omega / 0.02)
            motors[c] = M_m[i] - drive.tau / eta[i] * M_r
    return [weight, motors, *per_wheel.values()]


def residual(robot, result, row, gravity):
    """Largest residual of (25) over the sum of its terms' sizes, per row, at one row of a rollout."""
    q, v = result.q[row], result.v[row]
    eta = np.array([result[f"eta_{motor}"][row] for motor in MOTORS])
    M_m = result.motor_torque[row]
    acc = np.array([result[f"{name}_ddot"][row] for name in names()])
    multiplier = np.array([result[f"lambda_{i}"][row] for i in range(1, 5)])
    Phi, Phi_x, bias = (f(q, v, geometry_of(robot)) for f in joint())
    A = robot.control.A_joint
    motion = [mass_matrix(robot, eta) * acc, Phi_x.T @ multiplier]
    motion += [-term for term in applied(robot, q, v, eta, M_m, gravity)]
    closed = [Phi_x @ acc, bias.ravel(), 2 * A * (Phi_x @ v), A**2 * Phi.ravel()]
    # Phi is a difference of places in the map: what it is made of is as large as they are
    places = A**2 * np.append(np.abs(q[0:3]) + np.abs(q[8:11]), 1.0)
    worst = []
    for terms, parts in ((motion, 0.0), (closed, places)):
        terms = np.array(terms, dtype=float)
        size = np.abs(terms).sum(axis=0) + parts + 1e-3 * max(np.abs(terms).max(), 1.0)
        worst.append(np.abs(terms.sum(axis=0) / size).max())
    return worst


def names():
    pose = ("x", "y", "z", "alpha", "beta", "gamma")
    return [*(f"{s}_f" for s in pose), "theta_fr", "theta_fl", *(f"{s}_b" for s in pose), "theta_br", "theta_bl"]


def sliding_turn(robot):
    return front_commands(robot, lambda t: 0.8 * ramp(t), lambda t: 0.4 * ramp(t - 2) - 0.8 * ramp(t - 5), 8.0)


@pytest.fixture(scope="module", params=["agriq", "bumpy"])
def case(request, agriq):
    """Agri.q, and one whose joint is high and off the axle, on a slope: then roll, pitch and loads move too."""
    if request.param == "agriq":
        return agriq, (0.0, 0.0, -GRAVITY)
    robot = agriq.replace({"front.l": 0.25, "front.O_z": 0.15, "back.O_z": 0.12})
    grade, heading = 0.06, 1.1
    robot = dataclasses.replace(robot, effects={"slope": {"grade": grade, "heading": heading}})
    along = GRAVITY * np.sin(grade)
    return robot, (along * np.cos(heading), along * np.sin(heading), -GRAVITY * np.cos(grade))


@pytest.fixture(scope="module")
def run(case):
    robot, _ = case
    result = rollout(robot, sliding_turn(robot), kappa=0.7)
    slid = sum(result[f"sat_{wheel}"].any() for wheel in WHEELS)
    assert slid >= 2, "both branches of eq. 16 must occur"
    return result


def test_augmented_system_holds_at_the_kernels_solution(case, run):
    robot, gravity = case
    for row in range(0, len(run.t), 7):
        motion, closed = residual(robot, run, row, gravity)
        assert motion < 1e-10, f"t = {run.t[row]:.2f} s: eq. 3 is off by {motion:.1e} of its terms"
        assert closed < 1e-10, f"t = {run.t[row]:.2f} s: the joint's accelerations are off by {closed:.1e}"


def test_high_joint_tilts_the_modules(case, run):
    """So that the check above sees more than the plane."""
    if case[0].front.O_z:
        assert np.ptp(run["alpha_f"]) > 1e-4
        assert np.ptp(run["F_n_front_left_front"]) > 1.0


def test_plain_solution_of_eq_28_is_the_kernels(case, run):
    robot, _ = case
    commands = sliding_turn(robot)
    p = params(robot)
    for row in range(0, len(run.t) - 1, 7):  # rows are knots: their cubic begins there
        knots = zip(
            commands.position[row], commands.position[row + 1], commands.velocity[row], commands.velocity[row + 1],
            strict=True,
        )  # fmt: skip
        drive = np.array([_hermite(*knot, commands.dt, 0.0) for knot in knots]).T
        eta = np.array([run[f"eta_{motor}"][row] for motor in MOTORS])
        plain = solve(p, run.q[row], run.v[row], MODES, drive, eta, run.motor_torque[row])
        assert plain.residual < 1e-10
        acc = np.array([run[f"{name}_ddot"][row] for name in names()])
        close(acc, plain.acceleration, f"accelerations at {run.t[row]:.2f} s")
        multiplier = np.array([run[f"lambda_{i}"][row] for i in range(1, 5)])
        close(multiplier, plain.multiplier, f"multipliers at {run.t[row]:.2f} s")
        close(run.motor_torque[row], plain.torque, f"torques at {run.t[row]:.2f} s")


def close(actual, expected_values, what):
    gap = np.abs(np.asarray(actual) - expected_values).max()
    assert gap < 1e-10 * (1.0 + np.abs(expected_values).max()), f"{what}: off by {gap:.1e}"
