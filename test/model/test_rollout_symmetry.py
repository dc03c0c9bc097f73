"""What must not matter: left or right, where, which way, when, and how often a run is cut."""

from __future__ import annotations

import numpy as np
import pytest
from model.helpers import (
    from_knot,
    front_commands,
    mirrored,
    mirrored_commands,
    mirrored_state,
    ramp,
    relative_poses,
)

from artibot_sim.model import WHEELS, Commands, initial_state, rollout

INTEGRATORS = ["rk4", "semi_implicit"]


@pytest.fixture(scope="module")
def turn(agriq):
    """Straight, then a turn in which wheels slide (eq. 16 switches), then the other way round."""
    return front_commands(agriq, lambda t: 0.8 * ramp(t), lambda t: 0.35 * ramp(t - 3) - 0.7 * ramp(t - 8), 14.0)


@pytest.fixture(scope="module", params=INTEGRATORS)
def run(request, agriq, turn):
    result = rollout(agriq, turn, integrator=request.param, kappa=0.8)
    assert any(result[f"sat_{wheel}"].any() for wheel in WHEELS), "the run must cross a switch of eq. 16"
    return request.param, result


def test_mirrored_commands_give_the_mirrored_run(agriq, turn, run):
    integrator, result = run
    other = rollout(agriq, mirrored_commands(turn), integrator=integrator, kappa=0.8)
    assert np.abs(mirrored(other.q) - result.q).max() < 1e-10, "left and right differ"
    for motor, twin in (("front_right", "front_left"), ("back_right", "back_left")):
        np.testing.assert_allclose(other[f"M_m_{motor}"], result[f"M_m_{twin}"], atol=1e-9)


def test_mirrored_state_gives_the_mirrored_run(agriq, turn, run):
    integrator, _ = run
    state = initial_state(agriq, x=0.3, y=-0.4, yaw=0.5, articulation_yaw=0.35)
    one = rollout(agriq, turn, integrator=integrator, state=state, duration=6.0)
    other = rollout(agriq, mirrored_commands(turn), integrator=integrator, state=mirrored_state(state), duration=6.0)
    assert np.abs(mirrored(other.q) - one.q).max() < 1e-10, "left and right differ from a bent start"


@pytest.mark.parametrize("pose", [(3.0, -7.0, 0.0), (0.0, 0.0, 2.3), (-20.0, 11.0, -1.1)])
def test_start_pose_does_not_matter(agriq, turn, run, pose):
    integrator, result = run
    other = rollout(agriq, turn, integrator=integrator, kappa=0.8, state=initial_state(agriq, *pose))
    for module in (0, 1):
        gap = np.abs(relative_poses(other.q, module) - relative_poses(result.q, module)).max()
        assert gap < 1e-9, f"module {module} takes another path from {pose}: {gap} m or rad"


def test_start_time_does_not_matter(agriq, turn, run):
    integrator, result = run
    later = Commands(turn.dt, turn.velocity, position=turn.position, torque=turn.torque, t0=1234.5)
    other = rollout(agriq, later, integrator=integrator, kappa=0.8)
    np.testing.assert_array_equal(other.q, result.q)
    np.testing.assert_allclose(other.t - 1234.5, result.t, atol=1e-9)


def test_same_input_same_bits(agriq, turn, run):
    integrator, result = run
    before = turn.velocity.copy()
    again = rollout(agriq, turn, integrator=integrator, kappa=0.8)
    for name in ("t", "q", "v", "row"):
        np.testing.assert_array_equal(getattr(again, name), getattr(result, name))
    np.testing.assert_array_equal(turn.velocity, before)


def test_chunks_are_one_run_bit_for_bit(agriq, turn, run):
    """Cut at knots, with efficiencies and fed-back torques handed on in the state."""
    integrator, result = run
    state, rows = None, []
    for first, last in ((0, 137), (137, 512), (512, 513), (513, len(turn.velocity) - 1)):
        part = rollout(
            agriq, from_knot(turn, first), integrator=integrator, kappa=0.8, state=state,
            duration=(last - first) * turn.dt,
        )  # fmt: skip
        rows.append(part.q[1 if rows else 0 :])
        state = part.final_state
    np.testing.assert_array_equal(np.vstack(rows), result.q)
    np.testing.assert_array_equal(state.v, result.final_state.v)
    np.testing.assert_array_equal(state.eta, result.final_state.eta)
    np.testing.assert_array_equal(state.torque, result.final_state.torque)
    assert state.t == pytest.approx(result.final_state.t, abs=1e-9)


def test_output_rate_does_not_change_the_motion(agriq, turn, run):
    integrator, result = run
    sparse = rollout(agriq, turn, integrator=integrator, kappa=0.8, every=70)
    np.testing.assert_array_equal(sparse.q[:-1], result.q[: 7 * (len(sparse.q) - 1) : 7])
    np.testing.assert_array_equal(sparse.q[-1], result.q[-1])


def test_energy_accounts_do_not_change_the_motion(agriq, turn, run):
    integrator, result = run
    counted = rollout(agriq, turn, integrator=integrator, kappa=0.8, energy=True)
    # to rounding: the two are compiled apart, and a compiler may fuse a product and a sum in one of them only
    np.testing.assert_allclose(counted.q, result.q, rtol=1e-12, atol=1e-12)
