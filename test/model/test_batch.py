"""A batch is many single rollouts and nothing else, whatever the number of workers.

RK4 runs side by side and equals single rollouts to 1e-9; to the bit it does so with itself, however it is cut.
"""

from __future__ import annotations

import dataclasses
import threading

import numpy as np
import pytest
from model.effects import SEVERITY_1, with_effects
from model.helpers import from_knot, front_commands, ramp

from artibot_sim.errors import ArtibotError
from artibot_sim.model import Mode, Status, initial_state, rollout
from artibot_sim.model.effects import EFFECTS, LAWS
from artibot_sim.model.kernels.lane_layout import EXTENDED, extension
from artibot_sim.model.simulate.batch import available_cores, rollout_batch

PARTS = ("t", "q", "v", "row")


@pytest.fixture(scope="module")
def commands(agriq):
    """Into a turn that some soils hold and others do not."""
    return front_commands(agriq, lambda t: 0.8 * ramp(t, 0.5), lambda t: 0.6 * ramp(t - 0.5, 0.5), 1.5)


@pytest.fixture(scope="module")
def robots(agriq):
    soils = np.random.default_rng(3).uniform([1500, 1000, 0.4, 0.2], [3500, 3000, 0.9, 0.39], (9, 4))
    return [agriq.with_vector(["contact.k_l", "contact.k_t", "contact.mu_s", "contact.mu_d"], soil) for soil in soils]


def assert_close(a, b):
    """Everything of two rollouts, to 1e-9: of the size of what is larger than 1 (forces in N, knots far along)."""
    assert (a.status, a.message) == (b.status, b.message)
    for part in PARTS:
        assert_near(getattr(a, part), getattr(b, part))
    for part in ("q", "v", "eta", "torque", "lateral", "behind"):
        assert_near(getattr(a.final_state, part), getattr(b.final_state, part))


def assert_near(found, expected):
    assert found.shape == expected.shape
    scale = np.maximum(1.0, np.abs(expected).max(axis=0, initial=0.0))
    assert (np.abs(found - expected) < 1e-9 * scale).all(), np.abs(found - expected).max()


def assert_same_bits(a, b):
    assert (a.status, a.message) == (b.status, b.message)
    for part in PARTS:
        np.testing.assert_array_equal(getattr(a, part), getattr(b, part), strict=True)
    for part in ("q", "v", "eta", "torque", "behind"):
        np.testing.assert_array_equal(getattr(a.final_state, part), getattr(b.final_state, part), strict=True)


@pytest.mark.parametrize("workers", [1, 2, 5, None])
@pytest.mark.parametrize("integrator", ["rk4", "semi_implicit"])
def test_rows_are_those_of_single_rollouts(robots, commands, workers, integrator):
    batch = rollout_batch(robots, commands, workers=workers, keep="rows", integrator=integrator)
    assert len(batch) == len(robots)
    for robot, result in zip(robots, batch, strict=True):
        assert result.robot is robot
        (assert_close if integrator == "rk4" else assert_same_bits)(
            result, rollout(robot, commands, integrator=integrator)
        )
    assert len({result.q.tobytes() for result in batch}) == len(robots)  # the soils do matter


def test_neither_company_nor_workers_change_a_bit(robots, commands):
    """Nor how much is kept."""
    batch = rollout_batch(robots, commands, workers=1, keep="rows")
    for chosen, workers in (([3], 1), ([8, 3, 0], 2), (range(5), 3)):
        for i, result in zip(
            chosen, rollout_batch([robots[i] for i in chosen], commands, workers=workers), strict=True
        ):
            np.testing.assert_array_equal(result.row[-1], batch[i].row[-1])
            for part in ("q", "v", "eta", "torque", "behind"):
                np.testing.assert_array_equal(getattr(result.final_state, part), getattr(batch[i].final_state, part))


@pytest.mark.parametrize("driven", [False, True])
def test_effects_modes_and_states_are_those_of_single_rollouts(agriq, husky, epiq, commands, driven):
    """Effects together and alone, from the middle of a motion, in lots of different kinds.

    Alone are those that cost little: versions of the lanes for the others are compared with rollouts in `test_lanes`.
    """
    modes = (Mode.DRIVEN, Mode.DRIVEN, Mode.TORQUE, Mode.TORQUE) if driven else None
    names = [name for name in SEVERITY_1 if EFFECTS[name].hooks or EFFECTS[name].adapt]
    side_by_side = [name for name in names if name not in LAWS]
    robots = [agriq, with_effects(agriq, *side_by_side), with_effects(agriq, *names)]
    alone = [with_effects(agriq, name) for name in names]
    robots += [robot for robot in alone if extension(robot.effects) in (None, EXTENDED[0])]
    robots = [robot.replace({"drive.front.torque_max": 2.0}) for robot in robots]
    begun = [rollout(robot, commands, modes=modes, duration=0.7).final_state for robot in robots]
    rest = from_knot(commands, 70)
    starts = [dataclasses.replace(state, t=rest.t0) for state in begun]
    batch = rollout_batch(robots, rest, state=starts, modes=modes, keep="rows", every=7, workers=2)
    for robot, start, result in zip(robots, starts, batch, strict=True):
        assert_close(result, rollout(robot, rest, state=start, modes=modes, every=7))


def test_rigid_robots_and_other_spacings(husky, commands):
    slow = front_commands(husky, lambda t: 0.5 * ramp(t), lambda t: 0.3 * ramp(t), 1.2, h=0.02)
    robots = [husky, with_effects(husky, "slope"), with_effects(husky, "external_force")]
    for robot, result in zip(robots, rollout_batch(robots, slow, dt=2e-3, keep="rows"), strict=True):
        assert_close(result, rollout(robot, slow, dt=2e-3))


def test_final_keeps_both_ends_of_the_same_rollout(robots, commands):
    rows = rollout_batch(robots, commands, keep="rows", workers=2)
    ends = rollout_batch(robots, commands, keep="final", workers=2)
    for full, short in zip(rows, ends, strict=True):
        assert short.q.shape == (2, 16)
        for part in PARTS:
            np.testing.assert_array_equal(getattr(short, part), getattr(full, part)[[0, -1]])
        np.testing.assert_array_equal(short.final_state.q, full.final_state.q)


def test_more_workers_than_rollouts(robots, commands):
    (result,) = rollout_batch(robots[:1], commands, workers=16)
    assert_close(result, rollout(robots[0], commands, every=1500))


def test_no_rollouts_is_an_empty_list(commands):
    assert rollout_batch([], commands) == []


def test_one_robot_with_many_commands_and_states(agriq, commands):
    slow = front_commands(agriq, lambda t: 0.3 * ramp(t), lambda t: 0.0 * t, 0.6)
    starts = [initial_state(agriq, x=1.0), initial_state(agriq, yaw=0.5)]
    batch = rollout_batch(agriq, [commands, slow], state=starts, keep="rows", kappa=0.7, energy=True)
    for given, start, result in zip((commands, slow), starts, batch, strict=True):
        single = rollout(agriq, given, state=start, kappa=0.7, energy=True)
        assert_same_bits(result, single)
        np.testing.assert_array_equal(result.energy, single.energy)


def test_a_divergence_stays_with_its_own_rollout(agriq, robots, commands):
    wild = front_commands(agriq, lambda t: np.where(t > 0.1, 1e7, 0.0), lambda t: 0.0 * t, 1.5)
    batch = rollout_batch(robots[:3], [commands, wild, commands], keep="rows", workers=2)
    assert [result.status for result in batch] == [Status.OK, Status.DIVERGED, Status.OK]
    assert_close(batch[2], rollout(robots[2], commands))
    single = rollout(robots[1], wild)
    assert (batch[1].message, batch[1].final_state) == (single.message, None)
    for part in PARTS:
        assert_near(getattr(batch[1], part), getattr(single, part))


@pytest.mark.parametrize("workers", [1, 2, 4])
def test_a_refusal_names_the_rollout(robots, commands, workers):
    limp = robots[4].replace({"contact.k_l": 2.9e5, "contact.k_t": 2.9e5})
    with pytest.raises(ArtibotError, match=r"^rollout 4: dt: 0.001 s is unstable"):
        rollout_batch([*robots[:4], limp, *robots[5:], limp], commands, workers=workers)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"workers": 0}, "workers: 0; expected at least 1"),
        ({"keep": "all"}, "keep: 'all'; expected one of final, rows"),
        ({"dt": 0.0}, "rollout 0: dt: 0.0 s; expected a finite step"),
        ({"dt": float("nan")}, "rollout 0: dt: nan s; expected a finite step"),
        ({"duration": float("inf")}, "rollout 0: duration: inf s; expected a finite time"),
        ({"kappa": 2.0}, "rollout 0: kappa: 2; expected a share"),
        ({"modes": (Mode.TORQUE,)}, "rollout 0: modes: 1 given"),
        ({"state": [None, None]}, "9 robots, 2 state; expected equal numbers"),
    ],
)
def test_bad_input_is_refused(robots, commands, change, message):
    with pytest.raises(ArtibotError, match=message.replace("(", r"\(")):
        rollout_batch(robots, commands, **change)


def test_a_stranger_among_the_robots_is_named(robots, commands):
    with pytest.raises(ArtibotError, match=r"robots\[1\]: str; expected a Robot"):
        rollout_batch([robots[0], "agriq"], commands)


def test_progress_counts_every_rollout(robots, commands):
    seen, threads = [], set()
    rollout_batch(robots, commands, workers=2, progress=lambda n: (seen.append(n), threads.add(threading.get_ident())))
    assert seen == list(range(1, len(robots) + 1))


def test_an_exception_of_the_callers_ends_the_batch(robots, commands):
    def progress(done: int) -> None:
        raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        rollout_batch(robots, commands, workers=2, progress=progress)


def test_there_is_a_core():
    assert available_cores() >= 1
