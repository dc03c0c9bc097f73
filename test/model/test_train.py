"""Robots of any number of modules: against a derivation of its own, the plain equations, and the two-module kernels."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from model.effects import SEVERITY_1, stepped
from model.helpers import front_commands, ramp
from model.planar_chain import chain_rollout

from artibot_sim.errors import ArtibotError
from artibot_sim.model import Commands, Mode, State, initial_state, load_robot, rollout
from artibot_sim.model.effects import has_laws
from artibot_sim.model.equations.transmission import torque_factors
from artibot_sim.model.kernels.layout import Grid
from artibot_sim.model.kernels.train_layout import places
from artibot_sim.model.reference.effects import PlainEffects
from artibot_sim.model.reference.train import solve_train, train_constraint
from artibot_sim.model.robot.derived import train
from artibot_sim.model.robot.robot import MOTORS, Hitch, sides_of, wheels_of
from artibot_sim.model.simulate import trains
from artibot_sim.model.simulate.rollout import DEFAULT_MODES, default_modes

DT = 5e-4
TRAINS = ("train3", "train5")


@pytest.fixture(scope="module", params=TRAINS)
def robot(request):
    return load_robot(request.param)


def bend(robot, duration=14.0):
    """Straight, then a turn in which wheels slide, then the other way round."""
    return front_commands(robot, lambda t: 0.8 * ramp(t), lambda t: 0.35 * ramp(t - 3) - 0.7 * ramp(t - 8), duration)


@pytest.fixture(scope="module")
def run(robot):
    return rollout(robot, bend(robot), dt=DT, every=20, energy=True)


def test_table_6_agrees_with_the_chain_in_minimal_coordinates(robot, table6):
    result = rollout(robot, table6, dt=DT, kappa=0.8, every=20)
    modules = len(robot.modules)
    switches = sum(np.abs(np.diff(result[f"sat_{wheel}"])).sum() for wheel in wheels_of(modules))
    assert switches > 10, "no wheel slid: the comparison would be too easy"
    chain = chain_rollout(robot, table6, DT, kappa=0.8, every=20)
    assert np.abs(result.pose[:, :2] - chain.position).max() < 1e-5, "another path than the chain's"
    yaws = result.q.reshape(len(result.t), modules, 8)[:, :, 5]
    assert np.abs(yaws - chain.yaws).max() < 1e-5, "other yaws than the chain's"
    assert np.ptp(yaws[:, -1] - yaws[:, 0]) > 0.3, "the train must bend for this to mean anything"
    torques = np.column_stack([result[f"M_m_{side}"] for side in sides_of(modules)])
    np.testing.assert_allclose(torques[:-1], chain.M_m[:-1], atol=1e-5, err_msg="motor torques")


def moving(robot, rng):
    """A state out of equilibrium in every coordinate, the joints closed only roughly."""
    modules = len(robot.modules)
    start = initial_state(robot, 1.0, -2.0, 0.7, 0.3 * rng.normal(size=modules - 1))
    q, v = start.q.reshape(modules, 8).copy(), np.zeros((modules, 8))
    q[:, 2:5] += 1e-3 * rng.normal(size=(modules, 3))
    v[:, :2], v[:, 5] = 0.4 * rng.normal(size=(modules, 2)), 0.3 * rng.normal(size=modules)
    v[:, 3:5] = 0.05 * rng.normal(size=(modules, 2))
    v[:, 6:] = (
        rng.normal(size=(modules, 2)) * 2.5 / np.array([1 if d is None else d.tau for d in robot.drives])[:, None]
    )
    eta = np.where(rng.random(2 * modules) < 0.5, start.eta, 1.2)
    return State(0.0, q.ravel(), v.ravel(), eta, 0.2 * rng.normal(size=2 * modules))


@pytest.mark.parametrize(
    "effects",
    [
        {},
        {"com_offset": {"x": 0.06, "y": -0.04}, "payload": {"mass": 9.0, "module": "back"}, "slope": {"grade": 0.05}},
        {"joint_friction": {"torque": 10.0}, "joint_stiffness": {"stiffness": 25.0}, "gear_efficiency": {"scale": 0.7}},
        {"tyre_relaxation": {"length": 0.3}, "wheel_runout": {"relative": 0.03}, "back_friction": {"scale": 0.6}},
        {"motor_drag": {"torque": 0.2, "motor": "back_left"}, "external_force": {"force": 35.0}},
        {"gear_no_load": {"torque": 0.1}, "slope": {"grade": 0.1, "heading": 0.3}},
        {"motion_resistance": {"force": 30.0}, "payload": {"mass": 9.0, "module": "module_3"}},
        {"wheel_runout": {"relative": 0.03, "wheel": "module_3_left_back"}, "joint_damping": {"coefficient": 30.0}},
        {
            "force_law": {"size": 20.0, "where": "module_3_yaw", "variable": "module_3_right_angle", "form": "linear"},
            "force_law_2": {"size": 5.0, "where": "joint_2", "variable": "articulation_rate", "form": "linear"},
            "force_law_3": {
                "size": 90.0,
                "where": "module_3_wheels_lateral",
                "variable": "articulation_angle",
                "form": "linear",
            },
        },
    ],
)
def test_right_hand_side_is_that_of_the_plain_equations(robot, effects):
    robot = dataclasses.replace(robot, effects=effects)
    rng = np.random.default_rng(7)
    p, motors = train(robot), len(robot.motors)
    for modes in (default_modes(robot), (Mode.DRIVEN,) * motors, (Mode.TORQUE,) * motors):
        state = moving(robot, rng)
        velocity = 50.0 * rng.normal(size=(2, motors))
        given = 0.3 * rng.normal(size=(2, motors))
        commands = Commands(0.01, velocity, position=rng.normal(size=(2, motors)), torque=given)
        # laws with energies, for which their loop is compiled anyway
        result = rollout(
            robot, commands, dt=1e-4, modes=modes, state=state, duration=0.0, every=1, energy=has_laws(effects)
        )
        sides, drive = trains.by_side(robot, modes), np.zeros((3, 2 * len(robot.modules)))
        torque = np.zeros(2 * len(robot.modules))
        h, places_ = 0.01, trains.sides(robot)
        (x0, x1), (v0, v1) = commands.position, commands.velocity
        drive[:, places_] = x0, v0, 6 * (x1 - x0) / h**2 - (4 * v0 + 2 * v1) / h
        torque[places_] = given[0]
        limited = trains.unlimited_beside_prescribed(p, sides)
        plain = solve_train(
            limited, state.q, state.v, sides, drive, state.eta, torque, PlainEffects(robot.effects), state.memory
        )
        found = np.array(
            [result[f"{name}_ddot"][0] for name in places(len(robot.modules)).columns if is_position(name)]
        )
        scale = np.abs(plain.acceleration).max()
        np.testing.assert_allclose(found, plain.acceleration, rtol=1e-10, atol=1e-12 * scale)
        M_m = [result[f"M_m_{side}"][0] for side in sides_of(len(robot.modules))]
        np.testing.assert_allclose(M_m, plain.torque, rtol=1e-10, atol=1e-9)
        multipliers = [result[f"lambda_{k + 1}"][0] for k in range(len(plain.multiplier))]
        np.testing.assert_allclose(multipliers, plain.multiplier, rtol=1e-9, atol=1e-9 * np.abs(multipliers).max())


def test_a_moment_in_a_joint_is_two_opposite_ones_on_its_modules():
    """Of the second joint: on the module ahead of it and on the one behind, by laws of different places."""
    robot = load_robot("train3")
    moment = {"size": 30.0, "variable": "time", "form": "linear"}
    inside = {"force_law": moment | {"where": "joint_2"}}
    outside = {
        "force_law": moment | {"where": "back_yaw"}, "force_law_2": moment | {"where": "module_3_yaw", "size": -30.0},
    }  # fmt: skip
    one, other, none = (rollout(dataclasses.replace(robot, effects=e), bend(robot, 3.0), dt=DT, every=20)
                        for e in (inside, outside, {}))  # fmt: skip
    np.testing.assert_allclose(one.q, other.q, atol=1e-9)
    assert np.abs(one.q - none.q).max() > 1e-2


def test_a_part_that_a_robot_does_not_have_is_refused(agriq):
    with pytest.raises(ArtibotError, match=r"effects.payload.module: 'module_3': the robot has 2 modules"):
        dataclasses.replace(agriq, effects={"payload": {"mass": 5.0, "module": "module_3"}})
    with pytest.raises(ArtibotError, match=r"effects.force_law.variable: 'back_left_angle' means nothing to the"):
        law = {"size": 1.0, "where": "module_3_yaw", "variable": "back_left_angle", "form": "linear"}
        dataclasses.replace(load_robot("train3"), effects={"force_law": law})


def is_position(name):
    stem = name.split("_")[0]
    return stem in ("x", "y", "z", "alpha", "beta", "gamma", "theta") and name.count("_") == 1


EVERY_EFFECT = [{name: values} for name, values in SEVERITY_1.items()]


@pytest.mark.parametrize(("effects", "integrator"), stepped([{}, *EVERY_EFFECT], ("rk4",), ("semi_implicit",)))
def test_two_modules_are_a_case_of_it(agriq, effects, integrator):
    """The two-module kernels and the chain of one joint give the same rows and energies to rounding."""
    robot = dataclasses.replace(agriq, effects=effects)
    commands = bend(robot, 6.0)
    one = rollout(robot, commands, integrator=integrator, energy=True)
    p, modes = trains.unlimited_beside_prescribed(train(robot), one.modes), one.modes
    inputs, grid = trains.inputs_of(robot, commands, modes, torque_factors(robot)), Grid(1e-3, 6000, 10, 10)
    found, kept, final = trains.run(robot, p, inputs, initial_state(robot), grid, integrator, True)
    assert final is not None
    assert kept == len(one.t)
    np.testing.assert_allclose(found.q, one.q, atol=1e-9)
    columns, energies = places(2)
    for name, (table, i) in (columns | energies).items():
        if table in ("row", "energy"):
            values = found.w[:, i] if table == "row" else found.e[:, i]
            np.testing.assert_allclose(values, one[name], rtol=1e-6, atol=1e-5, err_msg=name)


def stored(robot, q, v):
    """Energy in a state, J, written out apart from the model."""
    p, total = train(robot), np.zeros(len(q))
    for i, module in enumerate(p.modules):
        own, rate = q[:, 8 * i : 8 * i + 8], v[:, 8 * i : 8 * i + 8]
        body, unit = module.front, module.right_front
        total += 0.5 * rate[:, :6] ** 2 @ np.array([body.m, body.m, body.m, body.J_x, body.J_y, body.J_z])
        total += 0.5 * (unit.J_m + unit.J_w * unit.tau**2) * (rate[:, 6:] ** 2).sum(axis=1)
        total += body.m * 9.81 * own[:, 2]
        for y in (-body.half_y, body.half_y):
            total += module.k_n * np.maximum(body.r_0 - own[:, 2] - y * np.sin(own[:, 3]), 0.0) ** 2
    return total


@pytest.mark.parametrize("integrator", ["rk4", "semi_implicit"])
def test_energy_is_accounted_for(robot, integrator):
    result = rollout(robot, bend(robot), dt=DT, integrator=integrator, every=20, energy=True)
    held = stored(robot, result.q, result.v)
    gap = held[0] - held
    for name in result.columns:
        if name.startswith("E_"):
            gap += result[name] * (1.0 if name.startswith(("E_motor", "E_joint")) else -1.0)
    put_in = sum(result[f"E_motor_{motor}"][-1] for motor in robot.motors)
    assert put_in > 500.0
    assert np.abs(gap).max() < 1e-3 * put_in, "energy appears or vanishes"


def test_joints_stay_closed(robot, run):
    p = train(robot)
    gaps = [np.abs(train_constraint(p, q, v)[0]).max() for q, v in zip(run.q[::50], run.v[::50], strict=True)]
    assert max(gaps) < 1e-6


@pytest.mark.parametrize("integrator", ["rk4", "semi_implicit"])
def test_mirrored_commands_give_the_mirrored_run(robot, integrator):
    commands = bend(robot)
    swapped = Commands(commands.dt, commands.velocity[:, [1, 0, 3, 2]])
    one, other = (rollout(robot, c, dt=DT, integrator=integrator, every=20) for c in (commands, swapped))
    shape = (len(one.t), -1, 8)
    signs = np.array([1, -1, 1, -1, 1, -1, 1, 1])
    twin = (other.q.reshape(shape) * signs)[:, :, [0, 1, 2, 3, 4, 5, 7, 6]]
    assert np.abs(twin - one.q.reshape(shape)).max() < 1e-9, "left and right differ"


def test_a_third_module_that_weighs_and_holds_nothing_does_not_matter(agriq):
    """Massless and frictionless behind the rover, it swings as it may; the rover drives as without it."""
    robot = load_robot("train3")
    commands = bend(robot, 10.0)
    p = trains.unlimited_beside_prescribed(train(robot), trains.by_side(robot, DEFAULT_MODES))
    light = 1e-9
    body = p.modules[2].front
    body = body._replace(
        m=light * body.m, J_x=light * body.J_x, J_y=light * body.J_y, J_z=light * body.J_z, k_l=0.0, k_t=0.0,
        inverse=tuple(value / light for value in body.inverse),
    )  # fmt: skip
    module = p.modules[2]._replace(front=body, k_n=light * p.modules[2].k_n, u_w=0.0)
    joint = p.joints[1]._replace(back=body)
    p = p._replace(modules=(*p.modules[:2], module), joints=(p.joints[0], joint))
    modes = trains.by_side(robot, DEFAULT_MODES)
    inputs = trains.inputs_of(robot, commands, modes, torque_factors(robot))
    found, _, final = trains.run(robot, p, inputs, initial_state(robot), Grid(1e-3, 10000, 10, 10), "rk4", False)
    two = rollout(agriq, commands)
    assert final is not None
    assert np.abs(found.q[:, :16] - two.q).max() < 1e-6
    assert np.ptp(found.q[:, 21]) > 0.5, "the third module must be dragged along"


def test_traction_is_shared_by_the_driven_modules_behind():
    """Eq. 29: the front module carries kappa of the traction, the driven ones behind it equal parts of the rest."""
    robot = load_robot("train5")
    factors, kappa = torque_factors(robot, 0.7), 0.7
    at_wheels = [2 * f / drive.tau for f, drive in zip(factors, robot.drives, strict=True) if drive is not None]
    front = 1.0 / robot.drive.front.tau
    assert factors[0] == factors[3] == 0.0
    assert at_wheels[1] == pytest.approx(at_wheels[2]) == pytest.approx(at_wheels[3])
    assert front / (front + sum(at_wheels)) == pytest.approx(kappa)


def test_a_cut_run_goes_on_as_if_it_were_whole(robot):
    commands = bend(robot, 4.0)
    whole = rollout(robot, commands, dt=DT, every=200)
    first = rollout(robot, commands, dt=DT, every=200, duration=2.0)
    rest = Commands(commands.dt, commands.velocity[200:], position=commands.position[200:], t0=2.0)
    second = rollout(robot, rest, dt=DT, every=200, state=first.final_state)
    np.testing.assert_array_equal(second.q[-1], whole.q[-1])


def test_names_of_a_two_module_robot_stay(agriq):
    assert agriq.motors == MOTORS
    columns = places(3).columns
    own = rollout(agriq, bend(agriq, 0.01)).columns
    assert set(own) < set(columns), "a train has all columns of the two-module rover"
    third = set(columns) - set(own)
    assert all("_3" in name or name in ("lambda_5", "lambda_6", "lambda_7", "lambda_8", "M_joint_2") for name in third)


def test_joints_close_where_hitches_are_high():
    robot = load_robot("train3")
    (third,) = robot.trailing
    robot = dataclasses.replace(robot, trailing=(dataclasses.replace(third, hitch=Hitch(0.45, 0.05), O_z=0.0),))
    state = initial_state(robot, 0.3, 0.1, 0.4, [0.2, -0.3])
    phi, _, _ = train_constraint(train(robot), state.q, state.v)
    assert np.abs(phi).max() < 1e-9
    assert np.abs(state.q.reshape(3, 8)[:, 4]).max() > 1e-3, "modules pitch for the hitch to meet"


def test_what_is_not_a_train_is_refused_with_what_to_do(agriq):
    robot = load_robot("train5")
    with pytest.raises(ArtibotError, match="modes: 4 given; expected one, or 8: front_right"):
        rollout(robot, bend(robot, 0.1), modes=DEFAULT_MODES, dt=DT)
    with pytest.raises(ArtibotError, match="commands: 10 columns; robot 'train5' has 8 motors"):
        rollout(robot, Commands(0.01, np.zeros((3, 10))), dt=DT)
    with pytest.raises(ArtibotError, match="state: 16 coordinates; robot 'train5' has 40"):
        rollout(robot, bend(robot, 0.1), state=initial_state(agriq), dt=DT)
    with pytest.raises(ArtibotError, match="2 articulation yaws; robot 'train5' has 4 joints"):
        initial_state(robot, articulation_yaw=[0.1, 0.2])
