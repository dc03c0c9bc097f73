"""Invariants over random valid robots: nothing here may depend on Agri.q's numbers."""

from __future__ import annotations

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from model.helpers import energy_gap, front_commands, mirrored, mirrored_commands, ramp, standstill

from artibot_sim.model import MOTORS, WHEELS, Status, initial_state, rollout
from artibot_sim.model.equations.kinematics import constraint

SETTINGS = settings(
    max_examples=40,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
DT = 5e-4
SPEEDS = st.one_of(st.floats(0.1, 1.0), st.floats(-1.0, -0.1))
"""m/s. Not 0: turning on the spot the front torques sum to rounding noise, whose sign eq. 23 would then judge."""

FACTORS = {
    "front.m": (0.4, 2.5), "back.m": (0.4, 2.5), "wheel.m_w": (0.0, 3.0),
    "front.i_x": (0.6, 1.6), "front.i_y": (0.7, 1.5), "back.i_x": (0.6, 1.6), "back.i_y": (0.7, 1.5),
    "back.l": (0.6, 1.5), "wheel.r_w": (0.6, 1.6),
    "contact.k_n": (0.5, 2.0), "contact.k_l": (0.3, 1.3), "contact.k_t": (0.3, 1.3),
    "contact.mu_s": (0.5, 2.0), "contact.u_w": (0.0, 2.0),
    "drive.front.tau": (0.3, 3.0), "drive.back.tau": (0.3, 3.0),
    "drive.front.eta_d": (0.5, 1.6), "drive.back.eta_r": (0.5, 2.5),
}  # fmt: skip
VALUES = {"front.l": (0.0, 0.6), "contact.mu_d": (0.05, 0.3), "control.kappa": (0.5, 1.0)}


ROBOTS = st.fixed_dictionaries({key: st.floats(*bounds) for key, bounds in (FACTORS | VALUES).items()})


def build(base, drawn):
    """A robot with drawn values, or drawn factors on the base robot's."""
    known = dict(zip(FACTORS, base.as_vector(list(FACTORS)), strict=True))
    return base.replace({key: known.get(key, 1.0) * value for key, value in drawn.items()})


def drive(robot, speed, turn):
    return front_commands(robot, lambda t: speed * ramp(t, 1.0), lambda t: turn * ramp(t - 0.7, 1.0), 2.5)


@SETTINGS
@given(drawn=ROBOTS, speed=SPEEDS, turn=st.floats(-0.8, 0.8))
def test_any_valid_robot_obeys_the_invariants(agriq, drawn, speed, turn):
    robot = build(agriq, drawn)
    commands = drive(robot, speed, turn)
    result = rollout(robot, commands, dt=DT, integrator="semi_implicit", energy=True)
    assert result.status == Status.OK, result.message
    assert np.isfinite(result.q).all()
    assert np.isfinite(result.row).all()
    assert max(np.abs(constraint(robot, q)).max() for q in result.q[::25]) < 1e-5, "the joint opens"
    within_friction(robot, result)
    energy_is_balanced(robot, commands, result)
    mirror = rollout(robot, mirrored_commands(commands), dt=DT, integrator="semi_implicit")
    assert np.abs(mirrored(mirror.q) - result.q)[:, BODIES].max() < 1e-8, "left and right differ"


BODIES = [i for i in range(16) if i not in (6, 7, 14, 15)]


def energy_is_balanced(robot, commands, result):
    """The balance is off by little, and by half as much at half the step (the integrator is of order 1)."""
    half = rollout(robot, commands, dt=DT / 2, integrator="semi_implicit", energy=True, every=20)
    turned_over = sum(np.abs(result[f"E_motor_{motor}"]).max() for motor in MOTORS)
    gap, smaller = (np.abs(energy_gap(robot, run)).max() for run in (result, half))
    assert gap < 0.03 * turned_over, f"energy is not balanced: {gap:.2g} of {turned_over:.2g} J"
    assert smaller < 0.7 * gap + 1e-4 * turned_over, f"the step does not close it: {gap:.2g}, {smaller:.2g}"


def within_friction(robot, result):
    """Eqs 15, 16: no wheel pulls with more than mu_s F_n, a sliding one with mu_d F_n; none pulls on the ground."""
    for wheel in WHEELS:
        F_h = np.hypot(result[f"F_l_{wheel}"], result[f"F_t_{wheel}"])
        F_n, slides = result[f"F_n_{wheel}"], result[f"sat_{wheel}"] > 0
        assert (F_n >= 0).all()
        assert (F_h <= robot.contact.mu_s * F_n * (1 + 1e-9) + 1e-9).all(), f"{wheel} holds beyond mu_s"
        np.testing.assert_allclose(F_h[slides], robot.contact.mu_d * F_n[slides], rtol=1e-9, err_msg=wheel)


@SETTINGS
@given(drawn=ROBOTS, yaw=st.floats(-3.0, 3.0), bend=st.floats(-1.0, 1.0))
def test_any_valid_robot_stands_still(agriq, drawn, yaw, bend):
    robot = build(agriq, drawn)
    state = initial_state(robot, yaw=yaw, articulation_yaw=bend)
    assert np.abs(constraint(robot, state.q)).max() < 1e-13
    result = rollout(robot, standstill(1.0), dt=DT, integrator="semi_implicit", state=state)
    assert np.abs(result.q - state.q)[:, BODIES].max() < 1e-12, "it moves by itself"
