"""The rover that recordings are made with, against mechanics, the model, and recordings made elsewhere."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from bag_helpers import foreign
from diagnose.hidden import driving, rover
from diagnose.hidden.cases import recipe, run
from diagnose.hidden.effects import ADDED, LISTED, MOTORS
from diagnose.hidden.machine import SOIL, Machine, Way, machine
from diagnose.hidden.parts import Ground, Hidden

from artibot_sim.experiment import read_bag
from artibot_sim.model import Commands, initial_state, load_robot, rollout

ROBOT = load_robot("agriq")
NOMINAL = {name: getattr(ROBOT.contact, name) for name in SOIL}
KAPPA = 0.75


def plain(**soil: float) -> Machine:
    return machine(ROBOT, {**NOMINAL, **soil}, KAPPA)


def start_of(m: Machine, **values: float) -> np.ndarray:
    row = rover.at_rest(m.rover)
    for name, value in values.items():
        row[getattr(rover, name)] = value
    return row


def coast(m: Machine, row: np.ndarray, seconds: float) -> np.ndarray:
    """Rows of a rover whose front motors stand."""
    return rover.drive(row, 0.0, rover.STEP, 4, np.zeros((round(seconds / rover.STEP) + 1, 2)), m.rover)


def drive(m: Machine, name: str = "eight", seconds: float = 8.0, seed: int = 3, start=(0.3, -0.2, 0.7)):
    t, command = driving.commands(m, name, np.random.default_rng(seed), seconds)
    return run(m, m, KAPPA, name, t, command, rover.at_rest(m.rover, *start))


def without_ground(m: Machine) -> Machine:
    return m.with_rover(soil=Ground(0.0, 0.0, 1.0, 1.0, 0.0))


def momenta(m: Machine, rows: np.ndarray) -> np.ndarray:
    """Momentum along x and y of the map, and angular momentum about its origin, (n, 3)."""
    f, b = m.rover.front, m.rover.back
    c, s, C, S = (g(rows[:, i]) for i in (rover.YAW_F, rover.YAW_B) for g in (np.cos, np.sin))
    x = rows[:, rover.X] + c * f.c_x - s * f.c_y
    y = rows[:, rover.Y] + s * f.c_x + c * f.c_y
    X, Y = rows[:, rover.X] - f.l * c - b.l * C, rows[:, rover.Y] - f.l * s - b.l * S
    h = 1e-3
    v = [np.gradient(each, h, edge_order=2) for each in (x, y, X, Y)]
    spin = f.J_z * rows[:, rover.R] + b.J_z * rows[:, rover.S]
    turn = f.m * (x * v[1] - y * v[0]) + b.m * (X * v[3] - Y * v[2]) + spin
    return np.column_stack([f.m * v[0] + b.m * v[2], f.m * v[1] + b.m * v[3], turn])


@pytest.mark.parametrize("offset", [(0.0, 0.0), (0.06, -0.04)])
def test_nothing_but_the_joint_leaves_momentum_alone(offset):
    m = without_ground(plain())
    front = m.rover.front._replace(l=0.2, c_x=offset[0], c_y=offset[1])
    m = m.with_rover(front=front).hiding(joint_stiffness=25.0, joint_friction=3.0)
    found = momenta(m, coast(m, start_of(m, U=0.5, V=-0.2, R=0.8, S=-0.6, YAW_B=0.4), 2.0))[2:-2]
    np.testing.assert_allclose(found, np.broadcast_to(found[0], found.shape), atol=1e-3)


def test_heun_is_of_second_order_where_nothing_switches():
    m = plain(mu_s=9.0, mu_d=8.9)
    ends = []
    for h in (1e-3, 5e-4, 2.5e-4):
        fine = h * np.arange(round(2.0 / h) + 1)
        wish = np.column_stack([60.0 * (1 - np.cos(fine)), 80.0 * (1 - np.cos(fine))])
        wish = driving.executed(fine, wish, Way(), fine)
        frozen = m.with_rover(share=0.0)  # eq. 30 acts a step later, which is of first order
        ends.append(rover.drive(rover.at_rest(m.rover), 0.0, h, 4, wish, frozen.rover)[-1, :4])
    coarse, fine = np.abs(ends[0] - ends[1]).max(), np.abs(ends[1] - ends[2]).max()
    assert fine < coarse / 3.0


@pytest.mark.parametrize("name", sorted(driving.MANOEUVRES))
def test_agrees_with_the_model(name):
    """Both start the same and stay together until a wheel takes another branch; here none does."""
    d = drive(plain(), name)
    difference = _against_model(d, ROBOT)
    assert difference["path"] < 3e-3 and difference["yaw"] < 4e-3 and difference["articulation"] < 6e-3
    assert difference["torque"] < 0.02


SENSORS = {"encoder_scale", "torque_scale", "pose_lever_arm", "pose_delay", "gyro_bias", "velocity_filter"}
ON_THE_WAY = sorted({*LISTED, *ADDED} - SENSORS)
COMMANDED = ("speed_loop_lag", "command_delay", "deadband", "command_rate_limit")


@pytest.mark.parametrize("name", [name for name in ON_THE_WAY if name not in COMMANDED])
def test_effects_are_read_alike(name):
    """With the same parameters the model's effect changes the motion as the one here does."""
    d = drive(plain(), "stop_and_go", 8.0)
    values = recipe(name).draw(np.random.default_rng(5), 1.0, d.rows[3000:5000:100, :2])
    m = recipe(name).apply(d.machine, values)
    hidden = run(m, d.plain, KAPPA, d.manoeuvre, d.t, d.command, rover.at_rest(m.rover, *d.rows[0, :3]))
    extended = dataclasses.replace(ROBOT, effects={name: values})
    with_it, alone = _against_model(hidden, extended), _against_model(hidden, ROBOT)
    found = [what for what in with_it if with_it[what] < 0.25 * alone[what]]
    assert found, (name, with_it, alone)


def _against_model(d, robot) -> dict[str, float]:
    """Root mean square differences between a drive and the model's, path in m, angles in rad, torques in N m."""
    velocity = np.full((len(d.t), 4), np.nan)
    velocity[:, :2] = d.command
    result = rollout(
        robot, Commands(driving.PERIOD, velocity), dt=2.5e-4, every=40, kappa=d.kappa, duration=float(d.t[-1]),
        state=initial_state(robot, *d.rows[0, :3]), integrator="rk4",
    )  # fmt: skip
    rows = d.rows[::10]
    bend = rows[:, rover.YAW_B] - rows[:, rover.YAW_F]
    torque = rows[:, rover.TORQUE : rover.TORQUE + 4] - result.motor_torque
    return {
        "path": _rms(rows[:, :2] - result.pose[:, :2]),
        "yaw": _rms(rows[:, rover.YAW_F] - result.pose[:, 2]),
        "articulation": _rms(bend - result.articulation_yaw),
        "speed": _rms(rows[:, rover.SPEED : rover.SPEED + 2] - result.motor_velocity[:, :2]),
        "torque": float(np.median(np.abs(torque))),
    }


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def test_neutral_is_nothing():
    d = drive(plain())
    m = d.machine.hiding(**Hidden()._asdict())
    np.testing.assert_array_equal(d.rows, drive(m).rows)


@pytest.mark.parametrize("name", ["slope", "external_force", "friction_patch", "ridges", "tether"])
def test_what_is_fixed_in_the_map_turns_with_it(name):
    """The whole world turned and moved gives the same drive, turned and moved."""
    d = drive(plain(), "circles", 6.0, start=(0.0, 0.0, 0.0))
    values = recipe(name).draw(np.random.default_rng(2), 1.0, d.rows[2000:4000:100, :2])
    angle, shift = 0.9, np.array([2.0, -1.0])
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    moved = dict(values)
    if "heading" in values:
        moved["heading"] += angle
    for pair in (("x", "y"), ("tether_x", "tether_y")):
        if pair[0] in values:
            moved |= dict(zip(pair, turn @ [values[pair[0]], values[pair[1]]] + shift, strict=True))
    if "ridge_x" in values:
        wave = turn @ [values["ridge_x"], values["ridge_y"]]
        moved |= {"ridge_x": wave[0], "ridge_y": wave[1], "ridge_phase": values["ridge_phase"] - float(wave @ shift)}
    here = _from(d, recipe(name).apply(d.machine, values), (0.0, 0.0, 0.0))
    there = _from(d, recipe(name).apply(d.machine, moved), (*shift, angle))
    np.testing.assert_allclose(there[:, :2], here[:, :2] @ turn.T + shift, atol=1e-6)
    assert np.abs(here[:, :2] - d.rows[:, :2]).max() > 1e-3


def _from(d, m: Machine, start) -> np.ndarray:
    return run(m, d.plain, KAPPA, d.manoeuvre, d.t, d.command, rover.at_rest(m.rover, *start)).rows


def test_a_drive_goes_on_from_any_row():
    d = drive(plain().hiding(relaxation=0.3, front_max=0.4), seconds=6.0)
    fine = rover.STEP * np.arange(round(d.t[-1] / rover.STEP) + 1)
    wish = driving.executed(d.t, d.command, Way(), fine)
    rest = rover.drive(d.rows[2500], 2.5, rover.STEP, 4, wish[10000:], d.machine.rover)
    np.testing.assert_allclose(rest, d.rows[2500:], atol=1e-9)


def test_elastic_friction_depends_on_the_way_in_angle_and_a_hose_on_that_in_time():
    """Dahl's torque by its closed form along each way one way round, Maxwell's by its memory of the rate."""
    rows = drive(plain().hiding(bristle=20.0, bristle_angle=0.3, hose=40.0, hose_time=2.0), "slalom", 12.0).rows
    bend = np.diff(rows[:, rover.YAW_B] - rows[:, rover.YAW_F])
    dahl = maxwell = 0.0
    for k, step in enumerate(bend):
        dahl = 20.0 * np.sign(step) + (dahl - 20.0 * np.sign(step)) * np.exp(-abs(step) / 0.3)
        maxwell = maxwell * np.exp(-1e-3 / 2.0) + 40.0 * step
        assert rows[k + 1, rover.BRISTLE] == pytest.approx(dahl, abs=0.02)
        assert rows[k + 1, rover.HOSE] == pytest.approx(maxwell, abs=0.02)
    assert np.abs(rows[:, rover.BRISTLE]).max() > 5.0 and np.abs(rows[:, rover.HOSE]).max() > 5.0


def test_way_of_commands():
    """A ramp comes late by delay and lag, and what is small does not come at all."""
    t = 0.01 * np.arange(1001)
    ramp = np.column_stack([10.0 * t, -10.0 * t])
    fine = 2.5e-4 * np.arange(40001)
    late = driving.executed(t, ramp, Way(delay=0.2, time_constant=0.3), fine)
    np.testing.assert_allclose(late[-1], [10.0 * 9.5, -10.0 * 9.5], rtol=1e-9)
    dead = driving.executed(t, ramp, Way(deadband=45.0), fine)
    assert not dead[fine < 4.48].any() and np.allclose(
        dead[fine > 4.52], np.column_stack([10 * fine, -10 * fine])[fine > 4.52]
    )


FIELD_SOIL = dict(zip(SOIL, (2920.7, 1795.4, 0.677, 0.320, 0.0084), strict=True))


@pytest.mark.parametrize("name", ["run0", "run1", "run2"])
def test_drives_as_a_rover_of_another_program_did(name):
    """On its known soil, told what it was told, from its start: until a wheel takes another branch."""
    recording = read_bag(foreign(f"field_examples/none/{name}"))
    m = machine(ROBOT, FIELD_SOIL, float(recording.metadata["kappa"]))
    command, station = recording.channels["motor_command"], recording.channels["total_station"]
    told = np.column_stack([command[f"{motor}.velocity"] for motor in MOTORS[:2]])
    d = run(m, m, 1.0, name, command.t, told, rover.at_rest(m.rover))
    t = station.t[station.t < 10.0]
    there = np.column_stack([np.interp(t, d.grid, d.rows[:, i]) for i in (rover.X, rover.Y)])
    seen = np.column_stack([station["x"], station["y"]])[: len(t)]
    assert np.hypot(*np.ptp(seen, axis=0)) > 2.0
    assert _rms(there - seen) < 0.012
    motors = recording.channels["motor_torques"]
    rows = motors.t < 10.0
    for i, motor in enumerate(MOTORS):
        torque = np.interp(motors.t[rows], d.grid, d.rows[:, rover.TORQUE + i])
        assert np.median(np.abs(motors[f"{motor}.effort"][rows] - torque)) < 0.03
