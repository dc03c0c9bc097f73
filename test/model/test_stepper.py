"""The stepper is rollout in slices: the same numbers, whatever the motors are told from slice to slice."""

from __future__ import annotations

import math

import numpy as np
import pytest

from artibot_sim.errors import ArtibotError
from artibot_sim.model import Commands, Mode, Rollout, Status, load_robot, rollout
from artibot_sim.model.simulate.stepper import COASTING, MotorCommand, Stepper

AGRIQ = load_robot("agriq")
SLICE = 0.002
N, KNEE = 500, 300
MODES = (Mode.DRIVEN, Mode.DRIVEN, Mode.TORQUE, Mode.TORQUE)


def speeds(n: int = N) -> np.ndarray:
    """Front speeds at the slices' ends, right and left, rad/s: a bend that begins with a ramp."""
    return np.outer(100.0 * np.minimum(np.arange(n + 1) / KNEE, 1.0), [1.0, 0.8])


def whole(front: np.ndarray, torque: float, integrator: str) -> Rollout:
    velocity, effort = np.full((len(front), 4), np.nan), np.full((len(front), 4), np.nan)
    velocity[:, :2], effort[:, 2:] = front, torque
    commands = Commands(SLICE, velocity, torque=effort)
    return rollout(AGRIQ, commands, modes=MODES, every=2, integrator=integrator)


def turns(
    front: np.ndarray, k: int, torque: float, limit: float = math.inf
) -> tuple[MotorCommand, MotorCommand, MotorCommand, MotorCommand]:
    right, left = (MotorCommand((front[k, side], front[k + 1, side]), limit=limit) for side in (0, 1))
    return right, left, MotorCommand(torque=torque), MotorCommand(torque=torque)


@pytest.mark.parametrize("integrator", ["rk4", "semi_implicit"])
def test_slice_by_slice_is_one_rollout(integrator: str) -> None:
    front = speeds()
    expected = whole(front, 0.05, integrator)
    stepper = Stepper(AGRIQ, integrator=integrator)
    for k in range(N):
        assert stepper.advance(2, turns(front, k, 0.05)) is Status.OK
        np.testing.assert_allclose(stepper.q, expected.q[k + 1], atol=1e-10)
        np.testing.assert_allclose(stepper.v, expected.v[k + 1], atol=1e-9)
        if k + 1 not in (KNEE, N):  # there the rollout's rows already have the acceleration of what comes next
            np.testing.assert_allclose(stepper.torque, expected.motor_torque[k + 1], atol=1e-9)
    assert stepper.t == pytest.approx(N * SLICE)
    assert expected.q[-1, 0] > 0.25


def test_a_slice_may_be_as_long_as_one_likes() -> None:
    front, fine, coarse = speeds(), Stepper(AGRIQ), Stepper(AGRIQ)
    for k in range(0, N, 5):
        for j in range(5):
            first, last = (front[k] + f / 5 * (front[k + 5] - front[k]) for f in (j, j + 1))
            right, left = (MotorCommand((first[side], last[side])) for side in (0, 1))
            fine.advance(2, (right, left, COASTING, COASTING))
        right, left = (MotorCommand((front[k, side], front[k + 5, side])) for side in (0, 1))
        coarse.advance(10, (right, left, COASTING, COASTING))
    np.testing.assert_allclose(fine.q, coarse.q, atol=1e-10)


def test_the_drive_s_limit_holds_motor_by_motor_and_only_while_it_is_given() -> None:
    front, stepper = speeds(), Stepper(AGRIQ)
    free = Stepper(AGRIQ)
    highest = np.zeros(2)
    for k in range(N):
        right, left, *back = turns(front, k, 0.05)
        stepper.advance(2, (right._replace(limit=0.1), left, *back))
        free.advance(2, (right, left, *back))
        highest = np.maximum(highest, [abs(stepper.torque[0]), abs(free.torque[0])])
    assert highest[0] == pytest.approx(0.1)
    assert highest[1] > 0.3
    assert stepper.v[6] < 0.9 * front[-1, 0]
    for _ in range(N):
        stepper.advance(2, turns(front, N - 1, 0.05))
    assert stepper.v[6] == pytest.approx(front[-1, 0], rel=1e-3)


def test_no_drive_makes_a_motor_stronger_than_it_is() -> None:
    weak, stepper = AGRIQ.replace({"drive.front.torque_max": 0.05}), None
    stepper = Stepper(weak)
    for _ in range(100):
        stepper.advance(
            2, (MotorCommand((0.0, 100.0)), MotorCommand((0.0, 100.0)), MotorCommand(torque=1.0, limit=5.0), COASTING)
        )
    assert abs(stepper.torque[:2]).max() <= 0.05
    assert stepper.torque[2] == AGRIQ.drive.back.torque_max


def test_motors_without_current_coast_and_only_lose_energy() -> None:
    front, stepper = speeds(), Stepper(AGRIQ)
    for k in range(N):
        stepper.advance(2, turns(front, k, 0.05))
    energies, speed = [], []
    for _ in range(2000):
        stepper.advance(2, (COASTING,) * 4)
        assert not stepper.torque.any()
        front_speed, back_speed = math.hypot(*stepper.v[:2]), math.hypot(*stepper.v[8:10])
        energies.append(0.5 * (59.0 * front_speed**2 + 28.0 * back_speed**2))
        speed.append(front_speed)
    assert speed[0] > 0.3 and speed[-1] < 0.1 * speed[0]
    assert all(later <= earlier + 1e-9 for earlier, later in zip(energies[100:], energies[101:], strict=False))


def test_modes_change_from_slice_to_slice_and_nothing_jumps() -> None:
    stepper, rng = Stepper(AGRIQ), np.random.default_rng(5)
    for _ in range(300):
        choices = [
            COASTING
            if kind == 0
            else MotorCommand(torque=float(rng.uniform(-0.3, 0.3)))
            if kind == 1
            else MotorCommand((40.0, 40.0))
            for kind in rng.integers(0, 3, 4)
        ]
        before = stepper.q.copy()
        assert stepper.advance(2, tuple(choices)) is Status.OK  # type: ignore[arg-type]
        assert abs(stepper.q - before)[[0, 1, 8, 9]].max() < SLICE * 2.0
        given = [turn.torque for turn in choices]
        for motor, turn in enumerate(choices):
            if turn.speed is None:
                assert stepper.torque[motor] == pytest.approx(given[motor])


def test_a_divergence_is_a_status_and_leaves_the_state() -> None:
    stepper = Stepper(AGRIQ.replace({"drive.front.torque_max": math.inf}))
    stepper.advance(2, (COASTING,) * 4)
    before = stepper.state
    assert (
        stepper.advance(2, (MotorCommand((0.0, 1e9)), MotorCommand((0.0, 1e9)), COASTING, COASTING)) is Status.DIVERGED
    )
    np.testing.assert_array_equal(stepper.state.q, before.q)
    assert stepper.t == before.t


def test_what_it_goes_on_from_is_what_a_rollout_goes_on_from() -> None:
    front, stepper = speeds(), Stepper(AGRIQ)
    for k in range(100):
        stepper.advance(2, turns(front, k, 0.05))
    again = Stepper(AGRIQ, state=stepper.state)
    for k in range(100, 200):
        stepper.advance(2, turns(front, k, 0.05))
        again.advance(2, turns(front, k, 0.05))
    np.testing.assert_array_equal(stepper.q, again.q)


@pytest.mark.parametrize(("dt", "integrator"), [(2e-3, "rk4"), (0.0, "rk4"), (math.nan, "rk4"), (1e-3, "euler")])
def test_what_cannot_be_stepped_is_refused(dt: float, integrator: str) -> None:
    with pytest.raises(ArtibotError, match=r"^(dt|integrator): "):
        Stepper(AGRIQ, dt=dt, integrator=integrator)
