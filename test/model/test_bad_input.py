"""What a simulation is given is checked before it runs, and one that leaves the finite world says so."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

from artibot_sim.errors import ArtibotError
from artibot_sim.model import Commands, Mode, State, Status, initial_state, load_robot, rollout
from artibot_sim.model.analysis.stability import largest_step
from artibot_sim.model.effects import EFFECTS, LAWS, effects_from_dict
from artibot_sim.model.effects.base import Choice
from artibot_sim.model.robot.derived import params
from artibot_sim.planning import load_manoeuvre, plan


def commands(velocity: float = 50.0, knots: int = 11) -> Commands:
    table = np.full((knots, 4), np.nan)
    table[:, :2] = velocity
    return Commands(0.01, table)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"dt": 0.0}, "dt"),
        ({"dt": -1e-3}, "dt"),
        ({"dt": float("nan")}, "dt"),
        ({"dt": 3e-3}, "dt: 0.003 s does not divide"),
        ({"dt": 2e-3}, "dt: 0.002 s is unstable with 'rk4'"),
        ({"dt": 1e-2, "integrator": "semi_implicit"}, "dt: 0.01 s is unstable with 'semi_implicit'"),
        ({"integrator": "euler"}, "integrator"),
        ({"every": 0}, "every"),
        ({"kappa": 0.0}, "kappa"),
        ({"kappa": 1.5}, "kappa"),
        ({"kappa": float("nan")}, "kappa"),
        ({"duration": -1.0}, "duration"),
        ({"duration": 1e9}, "duration: 1e+09 s at a dt of 0.001 s are 1e+12 steps"),
        ({"dt": 1e-8, "duration": 24.0}, "every: 2.4e+08 rows"),
        ({"integrator": "semi_implicit", "kappa": 1e-9}, "dt: a step of 0.001 s would be cut into 2.7e+08 parts"),
        ({"modes": (Mode.PRESCRIBED,) * 3}, "modes"),
        ({"modes": Mode.PRESCRIBED}, "commands.velocity: no speeds for back_right"),
    ],
)
def test_rollout_refuses(change: dict, says: str) -> None:
    with pytest.raises(ArtibotError) as caught:
        rollout(load_robot("agriq"), commands(), **change)
    assert str(caught.value).startswith(says)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"dt": 0.0}, "commands.dt"),
        ({"velocity": np.zeros((5, 3))}, "commands.velocity"),
        ({"velocity": np.zeros((0, 4))}, "commands.velocity"),
        ({"velocity": np.array([[0.0] * 4, [np.nan, 0, 0, 0]])}, "commands.velocity"),
        ({"velocity": np.array([[0.0] * 4, [np.inf, 0, 0, 0]])}, "commands.velocity"),
        ({"position": np.zeros((3, 4))}, "commands.position"),
        ({"torque": np.full((5, 4), np.inf)}, "commands.torque"),
        ({"t0": float("nan")}, "commands.t0"),
    ],
)
def test_commands_refuse(arguments: dict, says: str) -> None:
    with pytest.raises(ArtibotError, match=f"^{says}"):
        Commands(**({"dt": 0.01, "velocity": np.zeros((5, 4))} | arguments))


def test_states_refuse_nan_and_wrong_shapes() -> None:
    state = initial_state(load_robot("agriq"))
    with pytest.raises(ArtibotError, match=r"^state\.v"):
        State(0.0, state.q, np.full(16, np.nan), state.eta, state.torque)
    with pytest.raises(ArtibotError, match=r"^state\.q"):
        State(0.0, state.q[:15], state.v, state.eta, state.torque)
    with pytest.raises(ArtibotError, match=r"^initial_state: yaw"):
        initial_state(load_robot("agriq"), yaw=float("inf"))


def test_unknown_columns_are_named_with_those_there_are() -> None:
    result = rollout(load_robot("agriq"), commands())
    with pytest.raises(ArtibotError, match="no column 'F_x'; known: x_f"):
        result["F_x"]
    with pytest.raises(ArtibotError, match="energy=True"):
        result["E_motor_front_right"]


def test_the_error_on_an_unstable_step_tells_one_that_is_stable() -> None:
    robot = load_robot("agriq")
    modes = (Mode.PRESCRIBED, Mode.PRESCRIBED, Mode.TORQUE, Mode.TORQUE)
    for integrator in ("rk4", "semi_implicit"):
        longest, _ = largest_step(params(robot), integrator, modes)
        knots = Commands(longest * 0.99, commands().velocity)
        assert rollout(robot, knots, dt=knots.dt, integrator=integrator).status == Status.OK


@pytest.mark.parametrize(
    ("changes", "effects", "part"),
    [
        ({}, {"slip_ratio": {"exponent": 0.5}}, "without effects.slip_ratio"),
        ({}, {"gear_no_load": {"torque": 6.0}, "stribeck": {"velocity": 0.08}}, "without effects.gear_no_load"),
        ({}, {}, "with half of contact.k_l"),
        ({}, {}, "with twice drive.back.J_m"),
        ({"control.A_motor": 5e4}, {}, "with half of control.A_motor"),
    ],
)
def test_the_error_on_an_unstable_step_says_which_part_limits_it(changes: dict, effects: dict, part: str) -> None:
    """And a rover that is so allows the step that the message says."""
    robot = dataclasses.replace(load_robot("agriq").replace(changes), effects=effects)
    with pytest.raises(ArtibotError, match=f"; [0-9.e-]+ s {part}") as refused:
        rollout(robot, commands(), dt=2e-3)
    (step,) = re.findall(f"([0-9.e-]+) s {part}", str(refused.value))
    factor = {"with half of": 0.5, "with twice": 2.0}.get(part.rpartition(" ")[0])
    key = part.rpartition(" ")[2]
    values = {name: value for name, _, value in robot.quantities()}
    other = (
        dataclasses.replace(robot, effects={name: one for name, one in effects.items() if f"effects.{name}" != key})
        if factor is None
        else robot.replace({key: factor * values[key]})
    )
    longest, _ = largest_step(params(other), "rk4", (Mode.PRESCRIBED, Mode.PRESCRIBED, Mode.TORQUE, Mode.TORQUE))
    assert float(step) == pytest.approx(longest, rel=0.01)
    assert longest > largest_step(params(robot), "rk4", (Mode.PRESCRIBED,) * 2 + (Mode.TORQUE,) * 2)[0]


def test_a_rollout_that_diverges_ends_with_a_status_and_finite_rows() -> None:
    robot = load_robot("agriq")
    start = initial_state(robot)
    thrown = State(0.0, start.q, np.where(np.arange(16) == 0, 1e5, 0.0), start.eta, start.torque)
    table = np.full((11, 4), np.nan)
    table[:, :2] = 0.0
    torque = np.full((11, 4), 1e9)
    result = rollout(robot, Commands(0.01, table, torque=torque), state=thrown, modes=Mode.TORQUE)
    assert result.status == Status.DIVERGED
    assert result.final_state is None
    assert "diverged" in result.message and "shorter dt" in result.message
    for array in (result.t, result.q, result.v, result.row):
        assert np.isfinite(array).all()
        assert len(array) == len(result.t) >= 1


def test_a_rover_whose_back_wheels_run_away_is_not_told_to_take_a_shorter_step_first() -> None:
    """With 99 times the front motors' torque behind, whatever the integrator and the step: it is no error of theirs."""
    robot = load_robot("agriq")
    order = plan(load_manoeuvre("table6_agriq"), robot).commands()
    ends = []
    for integrator, dt in (("semi_implicit", 1e-3), ("semi_implicit", 2e-4), ("rk4", 5e-5)):
        result = rollout(robot, order, kappa=0.01, integrator=integrator, dt=dt, every=round(0.01 / dt))
        assert result.status == Status.DIVERGED and "kappa" in result.message
        assert "shorter dt" not in result.message.split("kappa")[0], result.message
        ends.append(result.t[-1])
    assert np.ptp(ends) < 0.02


@pytest.mark.parametrize("integrator", ["rk4", "semi_implicit"])
def test_a_state_that_no_rover_has_is_a_divergence(integrator: str) -> None:
    start = initial_state(load_robot("agriq"))
    absurd = State(0.0, start.q, np.where(np.arange(16) == 6, 1e7, 0.0), start.eta, start.torque)
    result = rollout(load_robot("agriq"), commands(), state=absurd, integrator=integrator)
    assert result.status == Status.DIVERGED
    assert "starts from" in result.message
    assert result.final_state is None
    assert len(result.t) == len(result.q) == 0


def test_nothing_given_is_changed_and_results_are_read_only() -> None:
    robot, order = load_robot("agriq"), commands()
    state = initial_state(robot)
    before = [array.copy() for array in (state.q, state.v, order.velocity)]
    result = rollout(robot, order, state=state)
    for array, kept in zip((state.q, state.v, order.velocity), before, strict=True):
        np.testing.assert_array_equal(array, kept)
    with pytest.raises(ValueError, match="read-only"):
        result.q[0, 0] = 1.0


def push(force: float) -> dict:
    """A steady force (N) on the front module along x."""
    return {"external_force": {"force": force, "heading": 0.0}}


@pytest.mark.parametrize(
    ("effects", "status", "says"),
    [
        ({"com_offset": {"x": 0.0, "y": 0.4}}, Status.TIPPED, "tipped over at"),
        ({"com_offset": {"x": 0.0, "y": -0.4}}, Status.TIPPED, "tipped over at"),
        ({"com_offset": {"x": 0.3, "y": 0.0}}, Status.INVALID, "effects.com_offset.x: 0.3 m is beyond the wheels"),
        ({"com_offset": {"x": 0.2, "y": -0.3}}, Status.OK, "3000 steps"),
        (push(1e5), Status.INVALID, "broke an assumption at 0.000 s: the front module is pushed by more than 20 times"),
        (push(5e3), Status.INVALID, "broke an assumption at 0.92"),
        (push(300.0), Status.OK, "3000 steps"),
    ],
)
def test_a_rover_that_the_model_does_not_hold_for_says_why(effects: dict, status: Status, says: str) -> None:
    robot = dataclasses.replace(load_robot("agriq"), effects=effects)
    result = rollout(robot, commands(knots=301))
    assert result.status is status
    assert result.message.startswith(says)
    assert (result.final_state is None) == (status is not Status.OK)
    assert len(result.t) == len(result.q) == len(result.row) >= 1
    assert np.abs(result.q[:-1, 3:5]).max(initial=0.0) <= 1.0


SIZES = (-1e300, -1e9, -1.0, -1e-3, 0.0, 1e-300, 1e-9, 1e-3, 0.05, 0.5, 1.5, 30.0, 1e3, 1e9, 1e300)
"""Of effects' parameters: none that a file takes may end in anything but finite rows and a status, or a refusal."""


def drawn_effect(rng: np.random.Generator, name: str) -> dict[str, float | str]:
    """Parameters at random, some left out."""
    return {
        key: str(rng.choice(one.quantity.names)) if isinstance(one.quantity, Choice) else float(rng.choice(SIZES))
        for key, one in EFFECTS[name].parameters.items()
        if rng.random() < 0.85
    }


@pytest.mark.parametrize("name", sorted(set(EFFECTS) - set(LAWS)))
def test_whatever_size_an_effect_has_a_run_ends_with_finite_rows_or_is_refused(name: str) -> None:
    rng = np.random.default_rng(sum(map(ord, name)))
    ran = 0
    for _ in range(25):
        robot = load_robot(str(rng.choice(["agriq", "epiq", "husky"])))
        integrator = str(rng.choice(["rk4", "semi_implicit"]))
        try:
            robot = dataclasses.replace(robot, effects=effects_from_dict({name: drawn_effect(rng, name)}))
            result = rollout(robot, commands(30.0, knots=31), integrator=integrator)
        except ArtibotError as error:
            assert "\n" not in str(error)
            continue
        ran += 1
        assert result.message and (result.final_state is None) == (result.status is not Status.OK)
        for array in (result.t, result.q, result.v, result.row):
            assert np.isfinite(array).all()
    assert ran > 0


@pytest.mark.parametrize("integrator", ["rk4", "semi_implicit"])
def test_forces_that_no_number_holds_are_a_divergence(integrator: str) -> None:
    robot = dataclasses.replace(
        load_robot("agriq"), effects={"residual_force": {"front_turn_rate": 1e300, "since": -1e300}}
    )
    result = rollout(robot, commands(), integrator=integrator)
    assert result.status is Status.DIVERGED and "diverged at 0.000 s: a force" in result.message
    assert result.final_state is None and np.isfinite(result.row).all()


@pytest.mark.parametrize("integrator", ["rk4", "semi_implicit"])
def test_a_rover_thrown_up_has_left_the_ground(integrator: str) -> None:
    start = initial_state(load_robot("agriq"))
    v = np.zeros(16)
    v[[2, 10]] = 4.0
    result = rollout(
        load_robot("agriq"), commands(knots=101), state=dataclasses.replace(start, v=v), integrator=integrator
    )
    assert result.status is Status.AIRBORNE
    assert result.message.startswith("left the ground at")
    assert result["F_n_front_left_front"][-1] == 0.0
