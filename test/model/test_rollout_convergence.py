"""Orders of convergence on smooth parts: what each integrator promises, and what eq. 30's feedback costs."""

from __future__ import annotations

import numpy as np
import pytest
from model.helpers import energy_gap, from_knot, front_commands, observed_order, ramp, smooth_robot

from artibot_sim.model import rollout

KNOT = 0.02
# semi-implicit steps above 1 ms are cut into parts: the order shows in those that are taken whole
STEPS = {"rk4": (10, 16, 20, 32, 40), "semi_implicit": (20, 32, 40, 64, 80)}
"""Steps per knot."""


@pytest.fixture(scope="module")
def smooth(agriq):
    """A robot, commands and a moving state for which nothing switches for a second."""
    robot = smooth_robot(agriq)
    commands = front_commands(
        robot,
        lambda t: (0.5 + 0.1 * np.sin(3 * t)) * ramp(t),
        lambda t: 0.15 * np.sin(2 * t) * ramp(t),
        6.0,
        KNOT,
    )
    state = rollout(robot, commands, kappa=1.0, duration=4.0).final_state
    return robot, from_knot(commands, 200), state


def run(smooth, steps, integrator, kappa):
    robot, commands, state = smooth
    result = rollout(
        robot, commands, dt=KNOT / steps, integrator=integrator, kappa=kappa, state=state, duration=1.0, every=steps,
        energy=True,
    )  # fmt: skip
    assert not any(result[name].any() for name in result.columns if name.startswith("sat_")), "a wheel slid"
    return result


@pytest.fixture(scope="module", params=[1.0, 0.7])
def reference(request, smooth):
    return request.param, run(smooth, 256, "rk4", request.param)


def errors(smooth, integrator, kappa, reference):
    fine = reference.q[-1]
    return [np.abs(run(smooth, n, integrator, kappa).q[-1] - fine).max() for n in STEPS[integrator]]


@pytest.mark.parametrize("integrator", ["rk4", "semi_implicit"])
def test_pose_converges_at_the_integrators_order(smooth, reference, integrator):
    """RK4 is of order 4 while no torque is fed back; eq. 30's torque from the step before makes any method order 1."""
    kappa, fine = reference
    expected = 4.0 if integrator == "rk4" and kappa == 1.0 else 1.0
    order = observed_order(errors(smooth, integrator, kappa, fine), [KNOT / n for n in STEPS[integrator]])
    assert order == pytest.approx(expected, abs=0.3), f"{integrator}, kappa {kappa}: order {order:.2f}"


@pytest.mark.parametrize("integrator", ["rk4", "semi_implicit"])
def test_energy_balance_closes_at_the_integrators_order(smooth, integrator):
    robot, _, _ = smooth
    gaps = []
    for n in STEPS[integrator]:
        result = run(smooth, n, integrator, 1.0)
        gaps.append(abs(energy_gap(robot, result)[-1]))
    order = observed_order(gaps, [KNOT / n for n in STEPS[integrator]])
    expected = 4.0 if integrator == "rk4" else 1.0
    # for RK4 the leading error may vanish, a higher order is no fault
    assert order > 0.85 * expected, f"{integrator}: balance closes at order {order:.2f}: {gaps}"


def test_integrators_meet_in_the_limit(smooth):
    """Two methods of different kinds have the same limit: extrapolated semi-implicit against RK4."""
    coarse, fine = (run(smooth, n, "semi_implicit", 1.0).q[-1] for n in (40, 80))
    limit = run(smooth, 40, "rk4", 1.0).q[-1]
    gap = np.abs(2 * fine - coarse - limit).max()
    assert gap < 0.02 * np.abs(fine - limit).max() + 1e-12, gap
