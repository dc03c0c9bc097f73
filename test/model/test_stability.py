"""A step that `rollout` accepts is a stable one: the planar rover linearised, against the limit that is enforced.

An unstable wheel spin is bounded by eq. 16 and hardly seen in the pose, so the pose cannot be the judge.
"""

from __future__ import annotations

import numpy as np
import pytest
from model.helpers import front_commands, ramp
from model.planar import linearised

from artibot_sim.errors import ArtibotError
from artibot_sim.model import WHEELS, Mode, rollout
from artibot_sim.model.params import params
from artibot_sim.model.stability import largest_step

MODES = (Mode.PRESCRIBED, Mode.PRESCRIBED, Mode.TORQUE, Mode.TORQUE)


def light_back(robot):
    """A light back module with a short gear: wheel spin and slip are both fast, and push each other."""
    changes = {"back.m": 0.5 * robot.back.m, "wheel.m_w": 0.0, "drive.front.eta_d": 0.3}
    return robot.replace(changes | {"drive.back.tau": 2 * robot.drive.back.tau})


def growth(z):
    """|R(z)| of the classical Runge-Kutta method."""
    return np.abs(1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24)


@pytest.mark.parametrize("kind", ["agriq", "epiq", "light_back"])
def test_longest_accepted_rk4_step_is_stable(agriq, epiq, kind):
    robot = {"agriq": agriq, "epiq": epiq, "light_back": light_back(agriq)}[kind]
    drives = [robot.drive.front] * 2 + [robot.drive.back] * 2
    dt, what = largest_step(params(robot), "rk4", MODES)
    driving, braking = (
        linearised(robot, 0.3, eta) for eta in zip(*((d.eta_d, 1 / d.eta_r) for d in drives), strict=True)
    )
    eigenvalues = np.concatenate([driving, braking])
    worst = eigenvalues[np.argmax(growth(eigenvalues * dt))]
    assert growth(worst * dt) <= 1 + 1e-6, (
        f"dt = {dt * 1e3:.3f} ms is accepted ('{what}'), but the mode at {worst:.0f} /s grows by "
        f"{growth(worst * dt):.3f} a step"
    )


@pytest.mark.parametrize("kind", ["agriq", "epiq", "light_back"])
def test_longest_accepted_semi_implicit_step_leaves_no_ripple(agriq, epiq, kind):
    robot = {"agriq": agriq, "epiq": epiq, "light_back": light_back(agriq)}[kind]
    dt, _ = largest_step(params(robot), "semi_implicit", MODES)
    dt *= 0.99
    commands = front_commands(robot, lambda t: 0.2 * ramp(t, 1.0), lambda t: 0.0, 600 * dt + 2.0, h=dt)
    result = rollout(robot, commands, dt=dt, integrator="semi_implicit", kappa=0.7, every=1)
    for name in ("theta_br_dot", "M_m_front_left"):
        end = result[name][-200:]
        assert np.ptp(end) < 1e-6 * np.abs(end).max(), f"{name} ripples at dt = {dt * 1e3:.2f} ms"


def test_what_a_step_of_1_ms_gives_is_true_or_refused(agriq):
    """What unstable wheels waste shows in the slip, not in the pose."""
    robot = light_back(agriq)
    commands = front_commands(robot, lambda t: 0.25 * ramp(t, 1.0), lambda t: 0.0, 2.5)

    def slip(dt):
        result = rollout(robot, commands, dt=dt, kappa=0.5, energy=True)
        return sum(result[f"E_slip_l_{wheel}"][-1] for wheel in WHEELS)

    true = slip(2.5e-4)
    try:
        found = slip(1e-3)
    except ArtibotError as error:
        assert "dt" in str(error)
        return
    assert found == pytest.approx(true, rel=0.1), "free wheels rattle: the step is too long for them"
