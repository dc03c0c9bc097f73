"""Robots of more than two modules in fits: windows are rollouts, starts close every joint, a soil is found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from artibot_sim.estimation.loss import Loss
from artibot_sim.estimation.parameters import SOIL, Extension, ParameterSet
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.search import converge
from artibot_sim.estimation.solver import evaluate
from artibot_sim.estimation.windows import (
    CHANNEL_NAMES,
    START,
    _in_modules,
    arms_of,
    lagging_forces,
    postures,
    start_names,
    states,
)
from artibot_sim.identify import Effort, identify
from artibot_sim.identify.problems import problem_of
from artibot_sim.identify.requested import parameter_set
from artibot_sim.identify.synthetic import Noise, synthetic
from artibot_sim.model import Commands, Mode, Robot, initial_state, load_robot, rollout
from artibot_sim.model.kernels.layout import BACK
from artibot_sim.model.simulate.train_windows import TrainWindows
from artibot_sim.model.simulate.window_inputs import KINDS, Items, MotorTable, SamplingPlan, kind_of
from artibot_sim.model.simulate.windows import WindowBatch
from artibot_sim.planning import Dwell, Manoeuvre, Ramp, Slalom, Stop

WAVES = Manoeuvre(
    "waves", (Dwell(0.3), Ramp(speed=0.6), Slalom(curvature=0.45, wavelength=3.5, periods=1.0), Stop()), a_max=0.5,
    blend=0.3,
)  # fmt: skip
EXACT = Noise(
    counts=1 << 30, velocity=0.0, torque=0.0, torque_share=0.0, articulation=0.0, gyro=0.0, acceleration=0.0,
    station=0.0, lost=0.0, station_rate=50.0,
)  # fmt: skip


def bent_table(robot: Robot, duration: float = 2.0) -> MotorTable:
    """Motors of an accelerating turn that goes to the other side, those behind as fast at the rim as in front."""
    t = np.arange(0.0, duration + 1e-9, 0.01)
    rim = np.column_stack([0.4 + 0.3 * np.sin(2 * t), 0.4 - 0.3 * np.sin(2 * t)]) / robot.wheel.r_w
    drives = [drive for drive in robot.drives if drive is not None]
    speed = np.hstack([rim / drive.tau for drive in drives])
    angle = np.vstack([np.zeros(speed.shape[1]), np.cumsum(0.005 * (speed[1:] + speed[:-1]), axis=0)])
    return MotorTable(0.01, angle, speed, np.full_like(speed, np.nan), (Mode.PRESCRIBED,) * speed.shape[1])


def one_item(q: np.ndarray, v: np.ndarray, knots: int) -> Items:
    zero = np.zeros(1, np.int64)
    return Items(zero, zero, zero, zero, zero + knots, q[None], v[None], np.zeros(1))


def test_samples_are_those_of_a_rollout_for_every_module_and_joint() -> None:
    """Of five modules, a passive one and driven ones behind the second among them, with an effect in every joint."""
    robot = load_robot("train5")
    robot = Robot(**{**vars(robot), "effects": {"joint_damping": {"coefficient": 30.0}}})
    table, t = bent_table(robot), np.arange(0.0, 1.95, 0.05)
    commands = Commands(0.01, table.velocity, position=table.position)
    result = rollout(robot, commands, modes=table.modes, integrator="semi_implicit")
    names = ["x", "yaw", "sliding", *(f"torque_{motor}" for motor in robot.motors), *robot.articulation_joints[::2]]
    names += ["articulation_rate", "articulation_rate_2", "articulation_rate_4"]
    plan = SamplingPlan(np.tile(t, len(names)), np.repeat([kind_of(name) for name in names], len(t)))
    seen = WindowBatch([table], [plan], 1e-3).run([robot], one_item(result.q[0], result.v[0], 200))[0]
    found, rows = dict(zip(names, seen.reshape(len(names), -1), strict=True)), np.round(t / 0.01).astype(int)
    np.testing.assert_allclose(found["x"], result.pose[rows, 0], atol=1e-12)
    np.testing.assert_allclose(found["yaw"], result.pose[rows, 2], atol=1e-12)
    rates = np.diff(result.v[:, 5::8], axis=1)
    for j, name in enumerate(robot.articulation_joints[::2]):
        np.testing.assert_allclose(found[name], result.articulations[rows, j, 0], atol=1e-12)
        rate = f"articulation_rate_{j + 1}".removesuffix("_1")
        if rate in found:
            np.testing.assert_allclose(found[rate], rates[rows, j], atol=1e-12)
    for i, motor in enumerate(robot.motors):
        np.testing.assert_allclose(found[f"torque_{motor}"], result.motor_torque[rows, i], atol=1e-9)
    assert np.abs(result.articulations[:, -1, 0]).max() > 0.01, "the last joint must bend for this to mean anything"


def law(where: str, variable: str, form: str, size: float, **others: float | str) -> dict[str, float | str]:
    return {"where": where, "variable": variable, "form": form, "size": size, **others}


SEVERAL: tuple[dict[str, dict[str, float | str]], ...] = (
    {},
    {"stiction": {"length": 0.02}, "com_height": {"height": 0.3}, "encoder_scale": {"scale": 1.02}},
    {
        "force_law": law(
            "joint_2",
            "articulation_rate",
            "coulomb",
            5.0,
            scale=0.1,
            times="module_3_right_angle",
            times_form="periodic",
            times_scale=0.7,
        ),
        "force_law_2": law("wheels_lateral", "slip", "linear", 20.0),
        "force_law_3": law("front_right_longitudinal", "angle", "periodic", 8.0, scale=3.0),
        "payload": {"mass": 5.0, "module": "module_3"},
    },
)
OTHERS: tuple[dict[str, dict[str, float | str]], ...] = (
    {"joint_friction": {"torque": 10.0}, "motor_drag": {"motor": "module_3_right", "torque": 0.2}},
    {"wheel_resistance": {"share": 0.05}, "torque_limit": {"front_max": 0.05}, "com_offset": {"x": 0.05, "y": 0.03}},
    {"tyre_relaxation": {"length": 0.3}, "velocity_filter": {"time_constant": 0.05}},
    {
        "force_law": law("motors_torque", "articulation_angle", "linear", 0.3),
        "force_law_2": law("module_3_sway", "place", "threshold", 9.0, scale=0.1, direction=0.5),
        "force_law_3": law("back_yaw", "time", "periodic", 4.0, scale=0.3),
        "tyre_relaxation": {"length": 0.3},
    },
)
"""Each has a version of the loops compiled for it, which takes ten seconds."""


@pytest.mark.parametrize(
    "effects",
    [*SEVERAL, *(pytest.param(effects, marks=pytest.mark.long) for effects in OTHERS)],
    ids=lambda effects: "+".join(effects) or "none",
)
def test_windows_side_by_side_are_those_one_by_one(effects: dict[str, dict[str, float | str]]) -> None:
    """Of different robots, starts and lengths, more than fill a block; motors behind prescribed or not, or at rest."""
    robot = load_robot("train5")
    softer = replace(robot, contact=replace(robot.contact, k_l=0.7 * robot.contact.k_l), effects=effects)
    robots, turned = [replace(robot, effects=effects), softer], bent_table(robot)
    free = replace(turned, modes=(Mode.PRESCRIBED,) * 2 + (Mode.TORQUE,) * (len(robot.motors) - 2))
    t = np.arange(0.0, 0.75, 0.03)
    names = ["x", "y", "yaw", "a_x", "yaw_rate", "articulation_yaw_4", "articulation_rate_2"]
    names += [f"torque_{motor}" for motor in robot.motors]
    plan = SamplingPlan(np.tile(t, len(names)), np.repeat([kind_of(name) for name in names], len(t)))
    at = rollout(robot, Commands(0.01, turned.velocity, position=turned.position), modes=turned.modes, duration=1.2)
    count, rows = 11, np.linspace(0, len(at.t) - 1, 11).astype(int)
    items = Items(
        np.arange(count) % 2, np.arange(count) % 3 % 2, np.zeros(count, np.int64), rows, 75 + np.arange(count) % 4,
        at.q[rows], at.v[rows], 0.01 * rows,
    )  # fmt: skip
    none = np.zeros_like(turned.position)
    still = replace(free, position=none, velocity=none, torque=none + 0.02)
    rest = initial_state(robots[0])
    for tables, some in (([turned, free], items), ([still], one_item(rest.q, rest.v, 75))):
        windows = TrainWindows(robots, tables, [plan], some, 1e-3)
        assert not len(windows._alone)
        together, alone = np.full((2, len(some), len(plan.t)), np.nan)
        windows.run_all(0, 1, together.ravel())
        for i in range(len(some)):
            windows.run(i, alone[i])
        np.testing.assert_allclose(together, alone, rtol=0.0, atol=1e-9)
        assert np.isfinite(alone).all()


def test_robots_that_differ_in_a_force_are_prepared_once() -> None:
    """A search for forces tries thousands of them: their numbers are worked out once, and each has its own force."""
    plain = load_robot("train3")
    robots = [replace(plain, effects={"residual_force": {"front_surge": force}}) for force in (0.0, 20.0, -20.0)]
    robots.append(replace(plain, contact=replace(plain.contact, k_l=0.5 * plain.contact.k_l)))
    table, t = bent_table(plain), np.arange(0.0, 0.5, 0.05)
    rest, none = initial_state(plain), np.zeros(4, np.int64)
    items = Items(
        np.arange(4), none, none, none, none + 60, *(np.tile(x, (4, 1)) for x in (rest.q, rest.v)), 0.0 * none
    )
    windows = TrainWindows(robots, [table], [SamplingPlan(t, np.zeros(len(t), np.int64))], items, 1e-3)
    assert len(windows._every) == 2
    out = np.full((4, len(t)), np.nan)
    windows.run_all(0, 1, out.ravel())
    x = out[:, -1]
    assert x[1] > x[0] > x[2] and x[3] != x[0]


def test_motors_that_their_gears_hold_stand_side_by_side_too() -> None:
    """On slopes, held by the front motors, from several motions that soon end: reversals and rest of motors behind.

    With effects of `SEVERAL`, whose version of the loops is compiled anyway.
    """
    robot, rng = load_robot("train3"), np.random.default_rng(5)
    robots = [
        replace(robot, effects={**SEVERAL[1], "slope": {"grade": grade, "heading": heading}})
        for grade, heading in ((0.1, 0.0), (0.3, 2.8), (0.2, 1.0))
    ]
    motors, count = len(robot.motors), 11
    still = np.zeros((100, motors))
    table = MotorTable(0.01, still, still, still * np.nan, (Mode.PRESCRIBED,) * 2 + (Mode.TORQUE,) * (motors - 2))
    t, names = np.arange(0.0, 0.75, 0.03), ["x", "y", "a_x", *(f"torque_{motor}" for motor in robot.motors)]
    plan = SamplingPlan(np.tile(t, len(names)), np.repeat([kind_of(name) for name in names], len(t)))
    q, v = (np.tile(part, (count, 1)) for part in (initial_state(robots[0]).q, np.zeros(24)))
    v[:, [14, 15]] = rng.normal(size=(count, 2))
    none = np.zeros(count, np.int64)
    items = Items(np.arange(count) % 3, none, none, none, 75 + np.arange(count) % 4, q, v, np.zeros(count))
    windows = TrainWindows(robots, [table], [plan], items, 1e-3)
    assert not len(windows._alone)
    together, alone = np.full((2, count, len(plan.t)), np.nan)
    windows.run_all(0, 1, together.ravel())
    for i in range(count):
        windows.run(i, alone[i])
    np.testing.assert_allclose(together, alone, rtol=0.0, atol=1e-9)
    late = alone[:, : 2 * len(t)].reshape(count, 2, len(t))[:, :, t > 0.5]
    assert np.abs(np.diff(late)).max() < 1e-6, "they must stand"


def test_names_of_what_is_sampled_have_numbers_of_their_own() -> None:
    behind = [f"{what}_{j}" for j in (2, 3, 4) for what in ("articulation_yaw", "articulation_rate")]
    behind += [f"torque_module_{i}_{side}" for i in (3, 4, 5) for side in ("right", "left")]
    numbers = [kind_of(name) for name in (*KINDS, *behind)]
    assert len(set(numbers)) == len(numbers)
    assert sorted(numbers)[: len(KINDS)] == list(range(len(KINDS)))


def test_two_modules_as_a_train_see_what_they_see_by_their_own_kernels() -> None:
    """Within a millimetre and a hundredth of the largest torque, and half of that with half the step."""
    robot = load_robot("agriq")
    table, t = bent_table(robot), np.arange(0.1, 1.95, 0.05)
    kinds = [0, 1, 3, *range(10, 14)]
    plan = SamplingPlan(np.tile(t, len(kinds)), np.repeat(kinds, len(t)))
    start = rollout(robot, Commands(0.01, table.velocity[:2]), modes=table.modes, duration=0.0).final_state
    assert start is not None
    items = one_item(start.q, start.v, 200)
    own = WindowBatch([table], [plan], 1e-3).run([robot], items)[0].reshape(7, -1)
    worst = []
    for dt in (1e-3, 5e-4):
        out = np.full(len(plan.t), np.nan)
        TrainWindows([robot], [table], [plan], items, dt).run(0, out)
        chain = out.reshape(7, -1)
        assert np.sqrt(np.mean((chain[3:] - own[3:]) ** 2)) < 0.01 * np.abs(own[3:]).max()
        worst.append(np.abs(chain[:3] - own[:3]).max())
    assert worst[0] < 1e-3
    assert worst[1] == pytest.approx(0.5 * worst[0], rel=0.2)


@pytest.mark.parametrize("name", ["agriq", "train5"])
def test_starts_close_every_joint_and_modules_move_as_these_say(name: str) -> None:
    """The states of random starts: ends of joints meet and stay so, and wheels behind go where the past says."""
    robot, rng = load_robot(name), np.random.default_rng(3)
    names, modules = start_names(robot), len(robot.modules)
    assert names[:8] == START and len(names) == 6 + 2 * (modules - 1)
    guesses = rng.normal(size=(20, len(names))) * 0.3
    zeros = np.zeros((20, 8 * modules))
    q, v = states(postures([robot]), np.zeros(20, np.int64), zeros, zeros, guesses, np.zeros(20, bool))
    for j, (l_f, l_b) in enumerate(arms_of(robot)):
        a, b = 8 * j, 8 * j + BACK
        for c, turn, side in ((0, np.cos, -np.sin(q[:, [a + 5, b + 5]])), (1, np.sin, np.cos(q[:, [a + 5, b + 5]]))):
            gap = q[:, a + c] - l_f * turn(q[:, a + 5]) - q[:, b + c] - l_b * turn(q[:, b + 5])
            rate = v[:, a + c] - l_f * v[:, a + 5] * side[:, 0] - v[:, b + c] - l_b * v[:, b + 5] * side[:, 1]
            assert np.abs(gap).max() < 1e-12 and np.abs(rate).max() < 1e-12
    x, y, yaw, forward, left, rate = guesses[:, :6].T
    c, s = np.cos(yaw), np.sin(yaw)
    motion = np.column_stack([x, y, yaw, c * forward - s * left, s * forward + c * left, rate, guesses[:, 6:]])
    _, aside = _in_modules(motion, arms_of(robot))
    for i in range(modules):
        k = 8 * i
        lateral = np.cos(q[:, k + 5]) * v[:, k + 1] - np.sin(q[:, k + 5]) * v[:, k]
        np.testing.assert_allclose(aside[:, i, 0], lateral, atol=1e-12)
        np.testing.assert_allclose(aside[:, i, 1], v[:, k + 5], atol=1e-12)


def test_trains_that_differ_behind_are_different() -> None:
    """A length of the third module can be fitted, so its robots are not taken for one; its mass has a mass's prior."""
    robot = load_robot("train3")
    longer = robot.replace({"module_3.l": 1.2})
    arms = postures([robot, longer]).arms
    assert arms[:, 1, 1].tolist() == [robot.modules[2].l, 1.2]
    masses = parameter_set(robot, ["front.m", "module_3.m"], None).parameters
    assert masses[0].spread == masses[1].spread


@pytest.fixture(scope="module")
def exact() -> Problem:
    """Windows of two seconds of a recording of train3 without noise."""
    recording = synthetic(load_robot("train3"), WAVES, noise=EXACT)
    return problem_of([recording], parameter_set(load_robot("train3"), SOIL, None), 2.0, 1)


def test_a_train_without_noise_is_predicted_and_one_window_leads_to_the_next(exact: Problem) -> None:
    middle = np.zeros(len(exact.parameters))
    predicted = exact.predictions([exact.parameters.robot], np.zeros((1, len(exact)), np.int64), exact.starts[None])[0]
    value, channel = exact.samples.value, exact.samples.channel
    worst = {c: float(np.sqrt(np.mean((predicted - value)[channel == c] ** 2))) for c in np.unique(channel)}
    position, articulation = CHANNEL_NAMES.index("position"), CHANNEL_NAMES.index("articulation_yaw")
    assert worst[position] < 3e-3 and worst[articulation] < 3e-3
    joints = {s.kind for stretch in exact.stretches for s in stretch.series if s.channel == "articulation_yaw"}
    assert joints == {kind_of("articulation_yaw"), kind_of("articulation_yaw_2")}
    carried = exact.carried(middle, exact.starts)
    assert np.abs(carried - exact.starts)[1:, [0, 1, 2, 6, 8]].max() < 5e-3


def test_a_second_joint_is_a_start_of_its_own(exact: Problem) -> None:
    """Its sensitivity is that of central differences of residuals, and another than the first joint's."""
    middle, step = np.zeros(len(exact.parameters)), 1e-3
    _, found = exact.linearised(middle, exact.starts, [])
    sides = []
    for sign in (1.0, -1.0):
        moved = exact.starts.copy()
        moved[:, 8] += sign * step
        sides.append(exact.flat_residuals([middle], moved)[0])
    central = (sides[0] - sides[1]) / (2 * step)
    rows = exact.samples.channel == CHANNEL_NAMES.index("articulation_yaw")
    close = np.abs(found.starts[8] - central)[rows] < 0.05 * np.abs(central[rows]).max()
    assert close.mean() > 0.95
    assert np.abs(found.starts[8] - found.starts[6])[rows].max() > 0.5 * np.abs(central[rows]).max()


def test_lagging_forces_of_a_steady_turn_are_those_that_starts_ask_for(exact: Problem) -> None:
    """Of every module: nothing has changed on the way, so each wheel's force is its side slip times k_t."""
    robot = Robot(**{**vars(load_robot("train3")), "effects": {"tyre_relaxation": {"length": 0.3}}})
    first, rest = np.zeros(1, np.int64), np.zeros((1, 24))
    q, v = states(postures([robot]), first, rest, rest, exact.starts[1:2], np.zeros(1, bool))
    past = exact._past._replace(lateral=np.zeros_like(exact._past.lateral))
    found = lagging_forces([robot], first, first + 1, q, v, past)[0].reshape(3, 4)
    for i, module in enumerate(robot.modules):
        k = 8 * i
        lateral = np.cos(q[0, k + 5]) * v[0, k + 1] - np.sin(q[0, k + 5]) * v[0, k]
        sweep = 0.5 * module.i_x * v[0, k + 5]
        assert found[i] == pytest.approx(-robot.contact.k_t * np.array([lateral + sweep, lateral - sweep] * 2))


def test_a_trains_soil_is_found() -> None:
    truth = load_robot("train3").replace({"contact.k_t": 2300.0})
    recording = synthetic(truth, WAVES, seed=4, duration=7.0)
    result = identify([recording], load_robot("train3"), fit=["k_t"], effort=Effort(starts=1, finalists=1)).result
    (k_t,) = result.estimates
    assert k_t.value == pytest.approx(2300.0, rel=0.03)
    assert k_t.ci95[0] < 2300.0 < k_t.ci95[1]
    assert result.channels["articulation_yaw"].excess == pytest.approx(1.0, abs=0.2)


@pytest.mark.long
def test_what_acts_in_every_joint_is_found() -> None:
    """Damping in both joints of train3, from a recording without noise and starting at none."""
    real = Robot(**{**vars(load_robot("train3")), "effects": {"joint_damping": {"coefficient": 30.0}}})
    recording = synthetic(real, WAVES, noise=EXACT)
    parameters = ParameterSet(load_robot("train3"), (), (Extension("joint_damping", {}),))
    problem, loss = problem_of([recording], parameters, 2.0, 1), Loss(1.0, np.ones(len(CHANNEL_NAMES)))
    point = evaluate(problem, loss, [np.zeros(1)], problem.starts)[0]
    found = converge(problem, point, loss, 3)
    robot = problem.parameters.robot_at(found.point.coordinates)
    assert robot.effects["joint_damping"]["coefficient"] == pytest.approx(30.0, rel=0.1)
