"""Windows are rollouts: what `WindowBatch` samples is what `rollout` gives at the same instants."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from model.effects import SEVERITY_1

from artibot_sim.errors import ArtibotError
from artibot_sim.model import Commands, Mode, Robot, State, load_robot, rollout
from artibot_sim.model.effects.residual_force import FORCES
from artibot_sim.model.robot.robot import unchecked
from artibot_sim.model.simulate.window_inputs import KINDS, Items, MotorTable, SamplingPlan, by_numbers
from artibot_sim.model.simulate.windows import WindowBatch, window_step

ALL = (Mode.PRESCRIBED,) * 4


def _table(duration: float = 3.0) -> MotorTable:
    t = np.arange(0.0, duration + 1e-9, 0.01)
    speed = np.column_stack([60 + 40 * np.sin(t), 60 - 40 * np.sin(t), 35 + 24 * np.sin(t), 35 - 24 * np.sin(t)])
    angle = np.vstack([np.zeros(4), np.cumsum(0.005 * (speed[1:] + speed[:-1]), axis=0)])
    return MotorTable(0.01, angle, speed, np.full_like(speed, np.nan), ALL)


def _items(states: list, first: int, knots: int) -> Items:
    n = len(states)
    zero = np.zeros(n, np.int64)
    return Items(
        np.arange(n), zero, zero, zero + first, zero + knots, np.array([s.q for s in states]),
        np.array([s.v for s in states]), np.zeros(n),
    )  # fmt: skip


@pytest.mark.parametrize("effect", ["", "back_friction", "bulldozing", "stribeck", "load_sensitivity", "stiction"])
def test_samples_are_those_of_a_rollout(effect: str) -> None:
    """At rows of a rollout every kind has the rollout's own value, also in the middle of a table.

    With effects of every cost, which are compiled apart, beside a rover that has none.
    """
    table = _table()
    plain = load_robot("agriq")
    robots = [
        Robot(**{**vars(plain), "effects": {effect: SEVERITY_1[effect]} if effect else {}}),
        plain.replace({"contact.mu_d": 0.25}),
    ]
    commands = Commands(0.01, table.velocity, position=table.position)
    begun = [rollout(r, commands, modes=ALL, dt=2.5e-3, duration=1.0).final_state for r in robots]
    rest = Commands(0.01, table.velocity[100:301], position=table.position[100:301])
    t = np.arange(0.0, 1.96, 0.05)
    kinds = [k for k in range(len(KINDS)) if KINDS[k] not in ("grip", "a_x", "a_y", "v_x", "v_y")]
    plan = SamplingPlan(np.tile(t, len(kinds)), np.repeat(kinds, len(t)))
    seen = WindowBatch([table], [plan], 2.5e-3, workers=2).run(robots, _items(begun, 100, 200))
    for robot, start, found in zip(robots, begun, seen, strict=True):
        # windows begin with the drives' efficiencies, a rollout that goes on with those of the step before
        fresh = type(start)(0.0, start.q, start.v, np.full(4, 0.6), np.zeros(4))
        result = rollout(robot, rest, modes=ALL, dt=2.5e-3, every=4, state=fresh)
        rows = np.round(t / 0.01).astype(int)
        table_ = dict(zip(kinds, found.reshape(len(kinds), -1), strict=True))
        np.testing.assert_allclose(table_[0], result.pose[rows, 0], atol=1e-12)
        np.testing.assert_allclose(table_[2], result.pose[rows, 2], atol=1e-12)
        np.testing.assert_allclose(table_[3], result.articulation_yaw[rows], atol=1e-12)
        np.testing.assert_allclose(table_[4], result.twist[rows, 2], atol=1e-9)
        for i in range(4):
            np.testing.assert_allclose(table_[10 + i], result.motor_torque[rows, i], atol=1e-9)
        bits = (result.row[rows, 40:48] * 2.0 ** np.arange(8)).sum(axis=1)
        np.testing.assert_array_equal(table_[KINDS.index("sliding")], bits)


def test_workers_do_not_change_results() -> None:
    robots = [load_robot("agriq").replace({"contact.k_t": k}) for k in (1500.0, 1800.0, 2100.0)]
    table = _table()
    start = rollout(robots[0], Commands(0.01, table.velocity[:2]), modes=ALL, duration=0.0).final_state
    plan = SamplingPlan(np.array([0.5, 1.0]), np.array([0, 10]))
    runs = [WindowBatch([table], [plan], 5e-3, workers=n).run(robots, _items([start] * 3, 0, 150)) for n in (1, 3)]
    np.testing.assert_array_equal(runs[0], runs[1])
    assert len({tuple(r) for r in runs[0]}) == 3


def test_robots_that_share_their_parts_are_as_if_each_were_alone() -> None:
    """Of three, two differ in a force only, which the paper's numbers do not know; one has another mass as well."""
    plain, table = load_robot("agriq"), _table()
    push = {f"{name}{of}": 0.0 for name in FORCES for of in ("", "_rate")} | {"since": 0.0}
    given = [
        {"residual_force": {**push, "front_sway": 20.0}},
        {"residual_force": {**push, "front_sway": -20.0}},
        {"residual_force": {**push, "front_sway": 20.0}, "payload": {"mass": 15.0, "module": "front"}},
    ]
    robots = [unchecked(plain, effects) for effects in given]
    different, like = by_numbers(robots)
    assert different == [robots[0], robots[2]] and like.tolist() == [0, 0, 1]
    start = rollout(plain, Commands(0.01, table.velocity[:2]), modes=ALL, duration=0.0).final_state
    plan = SamplingPlan(np.array([0.5, 1.0]), np.array([1, 10]))
    batch = WindowBatch([table], [plan], 2.5e-3, workers=1)
    together = batch.run(robots, _items([start] * 3, 0, 150))
    for effects, found in zip(given, together, strict=True):
        (alone,) = batch.run([replace(plain, effects=effects)], _items([start], 0, 150))
        np.testing.assert_array_equal(found, alone)
    assert len({tuple(found) for found in together}) == 3


def test_step_is_stable_and_divides_the_knots() -> None:
    table = _table(0.1)
    dt = window_step(load_robot("agriq"), [table])
    assert 2e-3 <= dt <= 5e-3
    stiff = load_robot("agriq").replace({"contact.k_l": 20000.0, "contact.k_t": 20000.0})
    assert window_step(stiff, [table]) < dt
    with pytest.raises(ArtibotError, match="does not divide"):
        WindowBatch([table], [], 3e-3)


@pytest.mark.parametrize("back", [Mode.PRESCRIBED, Mode.TORQUE])
def test_articulated_robots_that_are_stiffer_ask_for_shorter_steps(back: Mode) -> None:
    """Beyond what is stable wheels chatter within their friction: forces are wrong and nothing diverges."""
    plain, stiff = load_robot("agriq"), load_robot("agriq").replace({"contact.k_l": 9000.0, "contact.k_t": 6000.0})
    found = _table()
    torque = np.where(np.arange(4) < 2, np.nan, 0.02) * np.ones((len(found.velocity), 1))
    table = MotorTable(0.01, found.position, found.velocity, torque, (ALL[0], ALL[0], back, back))
    begun = rollout(plain, Commands(0.01, table.velocity, position=table.position), duration=1.0).final_state
    plan, items = SamplingPlan(np.array([0.5, 2.0, 0.5, 2.0]), np.array([2, 2, 10, 10])), _items([begun], 100, 200)
    batch = WindowBatch([table], [plan], window_step(plain, [table]), 1, plain)
    assert batch.suits([plain])
    assert not batch.suits([plain, stiff])
    short = batch
    while not short.suits([stiff]):
        short = short.halved
    assert short.dt == batch.dt / 4
    exact = replace(batch, dt=batch.dt / 50).run([stiff], items)[0]
    off, far = (np.abs(b.run([stiff], items)[0] - exact).max() for b in (short, batch))
    assert off < 0.1 * far


def _rigid(modes: tuple[Mode, ...] = ALL) -> tuple[Robot, MotorTable, WindowBatch, Items]:
    """A Husky on soft ground that turns for two seconds, from a state in motion."""
    husky, found = load_robot("husky").replace({"contact.k_l": 1000.0, "contact.k_t": 700.0}), _table()
    table = MotorTable(0.01, found.position / 10, found.velocity / 10, found.torque, modes)
    kinds = [KINDS.index(name) for name in ("x", "y", "yaw", "yaw_rate", "torque_front_right", "torque_front_left")]
    plan = SamplingPlan(np.tile([0.5, 2.0], len(kinds)), np.repeat(kinds, 2))
    begun = rollout(husky, Commands(0.01, table.velocity, position=table.position), duration=1.0).final_state
    return husky, table, WindowBatch([table], [plan], window_step(husky, [table]), 1), _items([begun], 100, 200)


def test_a_rigid_robot_has_no_back_motors_that_could_be_free() -> None:
    """Where nobody says how back motors turn a rigid robot is simulated as where all are said to."""
    husky, _, usual, items = _rigid()
    absent = (Mode.PRESCRIBED, Mode.PRESCRIBED, Mode.TORQUE, Mode.TORQUE)
    np.testing.assert_array_equal(_rigid(absent)[2].run([husky], items), usual.run([husky], items))


def test_a_rigid_robot_takes_a_step_from_knot_to_knot() -> None:
    """Half a millimetre and half a milliradian from steps of a tenth after two seconds of sliding turns."""
    husky, table, batch, items = _rigid()
    assert batch.dt == 0.01 == table.dt
    (coarse,), (fine,) = batch.run([husky], items), replace(batch, dt=1e-3).run([husky], items)
    assert np.abs(fine[:6]).max() > 0.3
    np.testing.assert_allclose(coarse[:6], fine[:6], atol=5e-4)


def test_stiffer_robots_ask_for_shorter_steps() -> None:
    """All that run together have the step that the stiffest one takes; bristles are stiff on any ground."""
    husky, table, batch, items = _rigid()
    harder, stiff = (
        husky.replace({f"contact.{key}": factor * getattr(husky.contact, key) for key in ("k_l", "k_t")})
        for factor in (1.5, 5.0)
    )
    held = replace(husky, effects={"stiction": SEVERITY_1["stiction"]})
    assert window_step(harder, [table]) == 1e-2  # which is stable there, and not exact
    assert window_step(stiff, [table]) == 5e-3
    assert batch.suits([husky])
    for robots in ([harder], [stiff], [husky, stiff], [held]):
        assert not batch.suits(robots)
    np.testing.assert_array_equal(batch.halved.run([stiff], items), replace(batch, dt=5e-3).run([stiff], items))


@pytest.mark.parametrize("one_by_one", [False, True])
def test_measured_torques_say_which_efficiency_an_idle_motor_has(one_by_one: bool) -> None:
    """Eq. 23 has two where a motor that pulls next to nothing slows down.

    Back motors brake for half a second, then pull a few thousandths of that, while the rover slows down all the time.
    Turned as they turned, the model has their torques where they are measured, and goes on braking without.
    """
    robot, t = load_robot("epiq"), np.arange(0.0, 3.005, 0.01)
    fast = 0.4 / robot.wheel.r_w / robot.drive.front.tau
    speed = (fast * np.interp(t, [0.0, 0.5, 1.0, 3.0], [0.0, 1.0, 1.0, 0.1]))[:, None] * [1.0, 1.0, np.nan, np.nan]
    pull = np.interp(t, [1.0, 1.01, 1.5, 1.51], [0.0, -3e-5, -3e-5, 1e-6])[:, None] * [0.0, 0.0, 1.0, 1.0]
    made = rollout(robot, Commands(0.01, speed, torque=pull), dt=2.5e-4, every=40)
    at = np.arange(1.2, 2.5, 0.02)
    names = ["torque_back_right", "torque_back_left", *(["grip"] if one_by_one else [])]
    plan = SamplingPlan(np.tile(at - 1.0, len(names)), np.repeat([KINDS.index(name) for name in names], len(at)))
    start, off = State(0.0, made.q[100], made.v[100], np.full(4, 0.8), np.zeros(4)), []
    for measured in (made.motor_torque, np.full_like(pull, np.nan)):
        table = MotorTable(0.01, made.motor_position.copy(), made.motor_velocity.copy(), measured.copy(), ALL)
        found = WindowBatch([table], [plan], 2.5e-4, 1).run([robot], _items([start], 100, 200))[0]
        wanted = np.column_stack([np.interp(at, t, made.motor_torque[:, i]) for i in (2, 3)]).T
        settled = np.abs(at - 1.5) > 0.1  # there the torque changes by 3e-5 between two knots
        off.append(np.abs(found[: 2 * len(at)].reshape(2, -1) - wanted)[:, settled])
    assert off[0].max() < 1e-8
    assert np.median(off[1]) > 1e-5
