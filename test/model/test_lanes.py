"""Rovers side by side do what each does alone: windows in lanes against `rollout`, to 1e-9."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from model.effects import SEVERITY_1, with_effects
from model.test_laws import laws
from model.test_rollout_random_robots import FACTORS, VALUES, build

from artibot_sim.estimation.windows import postures, states
from artibot_sim.model import Commands, Mode, Robot, State, rollout
from artibot_sim.model.effects import EFFECTS, LAWS, has_laws
from artibot_sim.model.kernels.lane_layout import EXTENDED, extension
from artibot_sim.model.kernels.layout import BACK, GAMMA, MOTOR_COORDINATES
from artibot_sim.model.simulate import windows as windows_module
from artibot_sim.model.simulate.window_inputs import KINDS, Items, MotorTable, SamplingPlan
from artibot_sim.model.simulate.windows import Fleet, WindowBatch, level

PRESCRIBED = (Mode.PRESCRIBED,) * 4
SHARED = (Mode.PRESCRIBED, Mode.PRESCRIBED, Mode.TORQUE, Mode.TORQUE)
SHOWN = list(range(KINDS.index("sliding")))
"""Kinds that are compared with rollouts; lanes do not know about single wheels, and the rest are these once more."""
MODEL_EFFECTS = [name for name in SEVERITY_1 if EFFECTS[name].hooks or EFFECTS[name].adapt]


def table(robot: Robot, modes: tuple[Mode, ...] = PRESCRIBED, duration: float = 12.0) -> MotorTable:
    """Motors of a rover that weaves, goes backwards now and then, and slips."""
    t = np.arange(0.0, duration + 1e-9, 0.01)
    v, w = 0.35 + 0.4 * np.sin(0.9 * t + 0.3), 0.5 * np.sin(0.7 * t) + 0.1
    speed = np.zeros((len(t), 4))
    for k, (body, drive) in enumerate(((robot.front, robot.drive.front), (robot.back, robot.drive.back))):
        if body is not None:
            turn, ratio = 0.5 * body.i_y * w, robot.wheel.r_w * drive.tau
            speed[:, 2 * k], speed[:, 2 * k + 1] = (v + turn) / ratio, (v - turn) / ratio
    angle = np.vstack([np.zeros(4), np.cumsum(0.005 * (speed[1:] + speed[:-1]), axis=0)])
    return MotorTable(0.01, angle, speed, np.full_like(speed, np.nan), modes)


def items_of(robots: list[Robot], motors: MotorTable, seed: int, each: int = 1, longest: int = 150) -> Items:
    """Windows at random places, of random length and start, `each` for every robot."""
    rng = np.random.default_rng(seed)
    n = each * len(robots)
    robot, zero = np.repeat(np.arange(len(robots)), each), np.zeros(n, np.int64)
    knots = rng.integers(20, longest, n)
    first = rng.integers(0, len(motors.position) - longest, n)
    q, v = np.zeros((n, 16)), np.zeros((n, 16))
    q[:, MOTOR_COORDINATES], v[:, MOTOR_COORDINATES] = motors.position[first], motors.velocity[first]
    low, high = np.array([[-3, 3], [-3, 3], [-4, 4], [-0.6, 0.8], [-0.1, 0.1], [-0.4, 0.4], [-0.6, 0.6], [-0.3, 0.3]]).T
    starts = rng.uniform(low, high, (n, 8))[:, : 8 if robots[0].articulated else 6]
    q, v = states(postures(robots), robot, q, v, starts, np.zeros(n, bool))
    return Items(robot, zero, zero, first, knots, q, v, rng.uniform(0.0, 30.0, n))


def chosen(items: Items, rows: np.ndarray) -> Items:
    known = {field.name: getattr(items, field.name) for field in dataclasses.fields(Items)}
    return Items(**{name: values[rows] for name, values in known.items() if values is not None})


def at_knots(knots: int) -> SamplingPlan:
    t = 0.01 * np.arange(knots + 1)
    return SamplingPlan(np.tile(t, len(SHOWN)), np.repeat(SHOWN, len(t)))


def by_rollout(robot: Robot, motors: MotorTable, items: Items, i: int, dt: float) -> np.ndarray:
    """What an item shows at its knots, (kinds, knots + 1), by a rollout of its own."""
    part = slice(items.first[i], items.first[i] + items.knots[i] + 1)
    commands = Commands(0.01, motors.velocity[part], position=motors.position[part], t0=float(items.t[i]))
    drives = [robot.drive.front] * 2 + [robot.drive.back or robot.drive.front] * 2
    start = State(float(items.t[i]), items.q[i], items.v[i], np.array([d.eta_d for d in drives]), np.zeros(4))
    run = rollout(robot, commands, modes=motors.modes, dt=dt, every=round(0.01 / dt), state=start)
    c, s = np.cos(run.pose[:, 2]), np.sin(run.pose[:, 2])
    a_x, a_y = run["x_f_ddot"], run["y_f_ddot"]
    rate = run["gamma_b_dot"] - run["gamma_f_dot"] if robot.articulated else 0.0 * a_x
    return np.vstack(
        [run.pose.T, run.articulation_yaw, run.twist[:, [2, 0, 1]].T, c * a_x + s * a_y, c * a_y - s * a_x, rate]
        + list(run.motor_torque.T)
    )


def assert_like_rollouts(robots: list[Robot], motors: MotorTable, items: Items, dt: float) -> None:
    """All items run in lanes but those with laws whose loads move, and all show what rollouts do."""
    lengths, plan = np.unique(items.knots, return_inverse=True)
    items = dataclasses.replace(items, plan=plan)
    batch = WindowBatch([motors], [at_knots(int(knots)) for knots in lengths], dt, workers=2)
    free = motors.modes != PRESCRIBED
    alone = np.array([has_laws(robot.effects) and "com_height" in robot.effects for robot in robots])
    np.testing.assert_array_equal(level(Fleet.of(robots, [motors], free), items), ~alone[items.robot])
    for i, found in enumerate(batch.run(robots, items)):
        expected = by_rollout(robots[items.robot[i]], motors, items, i, dt)
        wrong = np.abs(found.reshape(expected.shape) - expected)
        assert np.isfinite(found).all()
        name = KINDS[SHOWN[int(wrong.max(axis=1).argmax())]]
        # torques are large: by their size, all else as it is
        scale = np.where(np.arange(len(SHOWN)) >= 10, np.maximum(1.0, np.abs(expected).max(axis=1)), 1.0)
        assert (wrong.max(axis=1) < 1e-9 * scale).all(), f"item {i}: {name} is off by {wrong.max():.2g}"


def random_robots(base: Robot, count: int, seed: int) -> list[Robot]:
    rng = np.random.default_rng(seed)
    bounds = FACTORS | VALUES
    return [build(base, {key: rng.uniform(*bounds[key]) for key in bounds}) for _ in range(count)]


def test_random_robots(agriq) -> None:
    robots = random_robots(agriq, 12, 0)
    motors = table(agriq)
    assert_like_rollouts(robots, motors, items_of(robots, motors, 1, each=2), 1e-3)


def test_rovers_that_spin(agriq) -> None:
    """So fast that sines and cosines of yaw are taken anew between two knots."""
    motors = table(agriq)
    items = items_of([agriq], motors, 12, each=6, longest=40)
    items.v[:, [GAMMA, BACK + GAMMA]] = np.linspace(-9.0, 9.0, 6)[:, None]
    assert_like_rollouts([agriq], motors, items, 1e-3)


def test_rigid_robots(husky) -> None:
    """They have lanes of their own: without a back module, with effects of all kinds or with none."""
    robots = [husky.replace({"contact.mu_s": mu, "contact.mu_d": 0.8 * mu}) for mu in (0.3, 0.5, 0.8)]
    everything = "stiction", "slip_ratio", "wheel_runout", "com_offset", "com_height", "motor_drag"
    robots.append(with_effects(husky, *everything))
    assert extension(robots[-1].effects) == EXTENDED[-1]
    motors = table(husky)
    assert_like_rollouts(robots, motors, items_of(robots, motors, 2, each=3), 2.5e-3)


def test_a_rigid_robot_is_not_disturbed_by_articulated_ones(agriq, husky) -> None:
    """Blocks are used again, and nothing is left in them of a back module that a rigid robot does not have."""
    motors = table(husky)
    plan = SamplingPlan(np.tile([0.05, 0.2], len(SHOWN)), np.repeat(SHOWN, 2))
    batch = WindowBatch([motors], [plan], 1e-3, workers=1)
    items = items_of([husky], motors, 13, each=3)
    (alone, together) = batch.run([husky], items), []
    for _ in range(2):
        batch.run([agriq], items_of([agriq], motors, 14, each=3))
        together.append(batch.run([husky], items))
    for found in together:
        np.testing.assert_array_equal(found, alone)


@pytest.mark.parametrize("readings", ["literal_eq22", "literal_eq9"])
def test_other_readings(epiq, readings) -> None:
    robots = [epiq.replace({f"readings.{readings}": True})]
    motors = table(epiq)
    assert_like_rollouts(robots, motors, items_of(robots, motors, 3, each=5), 2e-3)


@pytest.mark.parametrize("effect", MODEL_EFFECTS)
def test_every_effect(agriq, effect) -> None:
    robots = [with_effects(agriq, effect), agriq]
    motors = table(agriq)
    assert_like_rollouts(robots, motors, items_of(robots, motors, 4, each=3), 2.5e-3)


def small_laws() -> list[dict[str, object]]:
    """Those of `laws`, so small that the square of an angle in rad lets no rover diverge."""
    return [law | {"size": 1e-3 * law["size"]} for law in laws()]


def test_laws_at_every_place_of_every_variable_in_every_form(agriq) -> None:
    robots = [with_effects(agriq, force_law_2=law) for law in small_laws()]
    motors = table(agriq)
    assert_like_rollouts(robots, motors, items_of(robots, motors, 15), 2.5e-3)


def test_laws_beside_each_other_and_beside_effects(agriq) -> None:
    every = small_laws()
    robots = [
        with_effects(agriq, *beside, **dict(zip(LAWS, every[k::17], strict=False)))
        for k, beside in enumerate(((), ("com_offset", "motor_drag"), ("com_height",)))
    ]
    for modes in (PRESCRIBED, SHARED):
        motors = table(agriq, modes)
        assert_like_rollouts(robots, motors, items_of(robots, motors, 16, each=3), 1e-3)


def test_laws_of_rigid_robots(husky) -> None:
    """They have one module, whose two motors lanes for them alone know."""
    behind = "back", "joint", "artic"
    here = [law for law in small_laws() if not any(str(value).startswith(behind) for value in law.values())]
    robots = [with_effects(husky, force_law=law) for law in here]
    motors = table(husky)
    assert_like_rollouts(robots, motors, items_of(robots, motors, 17), 2.5e-3)


def test_all_effects_at_once(agriq) -> None:
    side_by_side = [name for name in MODEL_EFFECTS if name not in LAWS]
    some = (
        ["slope", "com_offset"], ["wheel_resistance", "slip_ratio"], ["wheel_resistance", "stribeck"],
        ["stribeck", "slip_ratio", "wheel_runout"],
    )  # fmt: skip
    robots = [with_effects(agriq, *side_by_side), *(with_effects(agriq, *names) for names in some), agriq]
    used = {extension(with_effects(agriq, *names).effects) for names in (side_by_side, *some, *zip(side_by_side))}
    assert used >= set(EXTENDED), "here and in `test_every_effect`"
    motors = table(agriq)
    assert_like_rollouts(robots, motors, items_of(robots, motors, 5, each=4), 1e-3)


def test_back_motors_under_a_shared_torque(agriq) -> None:
    """Also those of robots with effects, and beside driven front motors, which have a limit."""
    robots = [agriq.replace({"contact.mu_s": 0.5, "contact.mu_d": 0.35}), with_effects(agriq, "motor_drag", "stribeck")]
    for modes in (SHARED, (Mode.DRIVEN, Mode.DRIVEN, Mode.TORQUE, Mode.TORQUE)):
        motors = table(agriq, modes)
        assert_like_rollouts(robots, motors, items_of(robots, motors, 6, each=3, longest=60), 1e-3)


@pytest.fixture(scope="module")
def crowd(agriq):
    """Robots with and without effects, their motors, items, a plan and what they show."""
    robots = [*random_robots(agriq, 3, 7), with_effects(agriq, "joint_friction"), with_effects(agriq, "payload")]
    motors = table(agriq)
    items = items_of(robots, motors, 8, each=7)
    plan = SamplingPlan(np.tile([0.013, 0.1], len(SHOWN)), np.repeat(SHOWN, 2))
    return robots, motors, items, plan, WindowBatch([motors], [plan], 1e-3, workers=1).run(robots, items)


@pytest.mark.parametrize("workers", [1, 2, 5])
def test_neither_company_nor_order_nor_workers_matter(crowd, workers) -> None:
    robots, motors, items, plan, expected = crowd
    for seed, count in ((0, len(items)), (1, 11), (2, 1)):
        rows = np.random.default_rng(seed).permutation(len(items))[:count]
        found = WindowBatch([motors], [plan], 1e-3, workers).run(robots, chosen(items, rows))
        for row, samples in zip(rows, found, strict=True):
            np.testing.assert_array_equal(samples, expected[row])


def test_one_that_diverges_disturbs_nobody(crowd) -> None:
    """Its samples end with its rows, here when motors are told to run away."""
    robots, motors, items, _, _ = crowd
    items = chosen(items, np.arange(0, len(items), 3))
    items.first[:], items.table[:] = 100, np.arange(len(items)) % 2
    items.q[:, MOTOR_COORDINATES], items.v[:, MOTOR_COORDINATES] = motors.position[100], motors.velocity[100]
    speed = motors.velocity.copy()
    speed[108:] = 1e7
    wild = dataclasses.replace(motors, velocity=speed)
    plan = SamplingPlan(np.arange(0.0, 0.2, 0.01), np.zeros(20, np.int64))
    before = WindowBatch([motors, motors], [plan], 1e-3).run(robots, items)
    after = WindowBatch([motors, wild], [plan], 1e-3).run(robots, items)
    for lost, calm, found in zip(items.table, before, after, strict=True):
        assert np.isfinite(calm).all()
        known = int(np.isfinite(found).sum())
        assert known == (8 if lost else 20)
        np.testing.assert_array_equal(found[:known], calm[:known])


def test_what_leaves_the_plane_runs_alone(agriq, monkeypatch) -> None:
    """A joint off the plane of the wheels lifts the modules; so does a start that is not level."""
    robots = [agriq, agriq.replace({"front.O_z": 0.05, "back.O_z": 0.05})]
    motors = table(agriq)
    items = items_of(robots, motors, 9, each=3)
    items.q[1, 2] += 1e-4
    items.v[2, 3] = 1e-3
    fleet = Fleet.of(robots, [motors], False)
    np.testing.assert_array_equal(level(fleet, items), [True, False, False, False, False, False])
    plan = SamplingPlan(np.repeat([0.05, 0.1], 3), np.tile([0, 2, 11], 2))
    found = WindowBatch([motors], [plan], 1e-3).run(robots, items)
    monkeypatch.setattr(windows_module, "level", lambda fleet, items: np.zeros(len(items), bool))
    alone = WindowBatch([motors], [plan], 1e-3).run(robots, items)
    for i in range(1, 6):
        np.testing.assert_array_equal(found[i], alone[i])
    np.testing.assert_allclose(found[0], alone[0], rtol=0, atol=1e-9)


def test_sensor_errors_act_in_lanes_as_alone(agriq, monkeypatch) -> None:
    """Scales of what turned the motors, and what sensors make of the motion, also before its first row."""
    errors = {
        "encoder_scale": {"scale": 1.03}, "torque_scale": {"scale": 0.9}, "pose_lever_arm": {"x": 0.2, "y": -0.1},
        "pose_delay": {"delay": 0.08}, "pose_heading_offset": {"angle": 0.05}, "gyro_bias": {"bias": 0.02},
        "velocity_filter": {"time_constant": 0.04},
    }  # fmt: skip
    robots = [dataclasses.replace(agriq, effects=errors), agriq]
    motors = dataclasses.replace(table(agriq), from_speeds=(True,) * 4)
    items = items_of(robots, motors, 11, each=3)
    kinds = [*SHOWN, *range(KINDS.index("grip") + 1, len(KINDS))]
    plan = SamplingPlan(np.tile([0.03, 0.111, 0.15], len(kinds)), np.repeat(kinds, 3))
    found = WindowBatch([motors], [plan], 2.5e-3).run(robots, items)
    monkeypatch.setattr(windows_module, "level", lambda fleet, items: np.zeros(len(items), bool))
    alone = WindowBatch([motors], [plan], 2.5e-3).run(robots, items)
    np.testing.assert_allclose(found, alone, rtol=0, atol=1e-9)
    assert np.isfinite(found).all()


def test_slopes_and_loads_stay_on_the_plane(agriq) -> None:
    motors = table(agriq)
    for effects in (["slope"], ["slope", "payload"], ["slope", "com_offset", "payload"]):
        robots = [with_effects(agriq, *effects)]
        assert level(Fleet.of(robots, [motors], False), items_of(robots, motors, 10)).all(), effects
