"""The compiled loop computes what the equations in plain NumPy say."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from model.effects import LISTED, SEVERITY_1, stepped, with_effects
from model.helpers import what_wheels_remember

from artibot_sim.errors import ArtibotError
from artibot_sim.model import Commands, Mode, Robot, State, initial_state, load_robot, rollout
from artibot_sim.model.analysis.stability import parts
from artibot_sim.model.effects import EFFECTS, has_laws, has_memory
from artibot_sim.model.equations.transmission import back_torque_factor
from artibot_sim.model.reference.effects import PlainEffects
from artibot_sim.model.reference.steps import PlainState, rk4_step, semi_implicit_step
from artibot_sim.model.robot.derived import params
from artibot_sim.model.simulate.rollout import unlimited_beside_prescribed

DT, STEPS, KNOT = 1e-3, 20, 10
MODES = {
    "as in the paper": (Mode.PRESCRIBED, Mode.PRESCRIBED, Mode.TORQUE, Mode.TORQUE),
    "driven": (Mode.DRIVEN, Mode.DRIVEN, Mode.TORQUE, Mode.TORQUE),
    "all prescribed": (Mode.PRESCRIBED,) * 4,
    "torques": (Mode.TORQUE,) * 4,
}


def moving_state(robot: Robot, rng: np.random.Generator) -> State:
    """A rover in a turn: out of equilibrium in every coordinate, joint closed only roughly."""
    state = initial_state(robot, x=1.0, y=-2.0, yaw=0.7, articulation_yaw=0.3)
    q, v = state.q.copy(), state.v.copy()
    q[[2, 3, 4, 10, 11, 12]] += 1e-3 * rng.normal(size=6)
    v[[0, 1, 8, 9]] = 0.4 * rng.normal(size=4)
    v[[5, 13]] = 0.3 * rng.normal(size=2)
    v[[3, 4, 11, 12]] = 0.05 * rng.normal(size=4)
    v[[6, 7, 14, 15]] = rng.normal(size=4) * 0.5 / robot.wheel.r_w / robot.drive.front.tau
    if not robot.articulated:
        q[8:], v[8:] = 0.0, 0.0
    return State(0.0, q, v, np.array([0.6, 1 / 0.35, 0.6, 0.6]), 0.2 * rng.normal(size=4))


def commands(robot: Robot, rng: np.random.Generator, torque: bool, dt: float = DT, steps: int = STEPS) -> Commands:
    cruise = 0.5 / robot.wheel.r_w / robot.drive.front.tau
    velocity = cruise * (1 + 0.2 * rng.normal(size=(steps // KNOT + 1, 4)))
    given = 0.3 * rng.normal(size=velocity.shape) if torque else None
    return Commands(KNOT * dt, velocity, torque=given)


def cubic(commands: Commands, t: float, knot: int) -> np.ndarray:
    """Angles, speeds and accelerations (3, 4) of the Hermite cubic from `knot`, by its basis functions."""
    h = commands.dt
    x0, x1 = commands.position[knot], commands.position[knot + 1]
    v0, v1 = commands.velocity[knot], commands.velocity[knot + 1]
    s = (t - knot * h) / h
    value = (1 + 2 * s) * (1 - s) ** 2 * x0 + s**2 * (3 - 2 * s) * x1 + h * s * (1 - s) * ((1 - s) * v0 - s * v1)
    speed = 6 * s * (s - 1) / h * (x0 - x1) + (1 - s) * (1 - 3 * s) * v0 + s * (3 * s - 2) * v1
    acceleration = (12 * s - 6) / h**2 * (x0 - x1) + ((6 * s - 4) * v0 + (6 * s - 2) * v1) / h
    return np.array([value, speed, acceleration])


def plain_run(robot: Robot, start: State, order: Commands, modes, kappa: float, integrator: str) -> np.ndarray:
    p, factor = unlimited_beside_prescribed(params(robot), modes), back_torque_factor(robot, kappa)
    state = PlainState(start.q, start.v, start.eta, start.torque, start.memory, start.behind)
    effects = PlainEffects(robot.effects)
    cut = parts(p, order.dt / KNOT, factor) if integrator == "semi_implicit" else 1
    dt = order.dt / (KNOT * cut)
    for step in range((len(order.velocity) - 1) * KNOT * cut):
        knot, t = step // (KNOT * cut), step * dt
        held = order.torque[knot]
        if integrator == "rk4":
            drives = [cubic(order, t + part * dt, knot) for part in (0.0, 0.5, 1.0)]
            state = rk4_step(p, state, modes, drives, held, factor, dt, effects.at(t))
        else:
            drive, ahead = cubic(order, t, knot), cubic(order, t + dt, knot)
            drive = np.vstack([drive[:2], (ahead[1] - drive[1]) / dt, ahead[0]])
            state = semi_implicit_step(p, state, modes, drive, held, factor, dt, effects.at(t))
    return np.concatenate([state.q, state.v, state.eta, state.torque, state.behind])


@pytest.mark.parametrize(("integrator", "dt"), [("rk4", DT), ("semi_implicit", DT), ("semi_implicit", 8e-3)])
@pytest.mark.parametrize("modes", MODES.values(), ids=MODES.keys())
@pytest.mark.parametrize("name", ["agriq", "epiq", "husky"])
def test_compiled_steps_equal_plain_ones(name: str, modes, integrator: str, dt: float) -> None:
    rng = np.random.default_rng(7)
    robot = load_robot(name)
    dt = min(dt, 5e-3) if name == "epiq" else dt  # whose springs swing faster
    if robot.articulated:
        robot = robot.replace({"front.O_z": 0.03, "back.O_z": 0.02, "contact.c_n": 40.0, "drive.front.torque_max": 0.5})
    start = moving_state(robot, rng)
    order = commands(robot, rng, modes[0] == Mode.TORQUE, dt)
    count = 4 if robot.articulated else 2
    fast = rollout(robot, order, dt=dt, modes=modes, kappa=0.7, state=start, integrator=integrator).final_state
    got = np.concatenate([fast.q, fast.v, fast.eta[:count], fast.torque[:count]])
    plain = plain_run(robot, start, order, modes, 0.7, integrator)
    want = np.concatenate([plain[:32], plain[32 : 32 + count], plain[36 : 36 + count]])
    scale = np.abs(want).max() if not robot.articulated else np.maximum(np.abs(want), 1.0)
    assert np.max(np.abs(got - want) / scale) < 1e-12


@pytest.mark.parametrize("integrator", ["rk4", "semi_implicit"])
def test_measured_torques_choose_efficiencies_as_in_plain_steps(integrator: str) -> None:
    """Also where rotors ask for about as much as the wheels, which leaves the efficiency open."""
    robot, modes, settled = load_robot("agriq"), MODES["all prescribed"], 0
    for seed in range(8):
        ends = []
        for torque in (True, False):
            rng = np.random.default_rng(seed)
            start, order = moving_state(robot, rng), commands(robot, rng, torque)
            fast = rollout(robot, order, dt=DT, modes=modes, state=start, integrator=integrator).final_state
            plain = plain_run(robot, start, order, modes, 1.0, integrator)
            np.testing.assert_allclose(fast.torque, plain[36:40], rtol=1e-10)
            np.testing.assert_array_equal(fast.eta, plain[32:36])
            ends.append(fast)
        np.testing.assert_array_equal(ends[0].q, ends[1].q)  # prescribed motors move as they are told
        settled += int((ends[0].eta != ends[1].eta).sum())
    assert settled > 2


@pytest.mark.parametrize("switch", ["readings.literal_eq22", "readings.literal_eq9"])
def test_literal_readings_are_computed_and_differ(switch: str) -> None:
    rng = np.random.default_rng(3)
    robot = load_robot("agriq")
    literal = robot.replace({switch: True})
    start, order = moving_state(robot, rng), commands(robot, rng, torque=False)
    modes = MODES["as in the paper"]
    fast = rollout(literal, order, state=start, kappa=0.7).final_state
    plain = plain_run(literal, start, order, modes, 0.7, "rk4")
    assert np.max(np.abs(np.concatenate([fast.q, fast.v]) - plain[:32])) < 1e-10
    assert not np.allclose(fast.v, rollout(robot, order, state=start, kappa=0.7).final_state.v, rtol=0, atol=1e-6)


def accounted(robot: Robot) -> bool:
    """Whether steps are compared with energies accounted for, which change nothing of them.

    Of robots with laws, and of those whose wheels remember, other tests need the loops with energies: so they are
    compiled once, not with and without.
    """
    return has_laws(robot.effects) or has_memory(robot.effects)


def gap_with(robot: Robot, modes, integrator: str, dt: float, steps: int = STEPS) -> float:
    """Distance of the compiled steps from the plain ones over the larger of 1 and what is compared."""
    rng = np.random.default_rng(11)
    robot = robot.replace({"front.O_z": 0.03, "back.O_z": 0.02, "contact.c_n": 40.0})
    moving, order = moving_state(robot, rng), commands(robot, rng, modes[0] == Mode.TORQUE, dt, steps)
    loops = "velocity_loop" in robot.effects
    behind = np.where(np.array(modes) == Mode.DRIVEN, 0.5 * loops, 0.0)
    start = dataclasses.replace(moving, **what_wheels_remember(rng), behind=behind)
    run = rollout(
        robot, order, dt=dt, modes=modes, kappa=0.7, state=start, integrator=integrator, energy=accounted(robot)
    )
    end = run.final_state
    got = np.concatenate([end.q, end.v, end.eta, end.torque, end.behind])
    want = plain_run(robot, start, order, modes, 0.7, integrator)
    return float(np.max(np.abs(got - want) / np.maximum(np.abs(want), 1.0)))


@pytest.mark.parametrize(("effect", "integrator"), stepped(sorted(SEVERITY_1), ("rk4",), ("semi_implicit",)))
def test_compiled_effects_equal_plain_ones(agriq, effect: str, integrator: str) -> None:
    modes = MODES["driven"] if EFFECTS[effect].drives_front else MODES["as in the paper"]
    assert gap_with(with_effects(agriq, effect), modes, integrator, DT) < 1e-12


@pytest.mark.parametrize(
    ("effects", "name", "mode", "integrator", "dt", "steps"),
    [
        *((SEVERITY_1, "agriq", mode, "rk4", DT, STEPS) for mode in MODES),
        *((LISTED, "agriq", mode, "semi_implicit", DT, STEPS) for mode in MODES),  # a step is one part
        *((LISTED, "agriq", mode, "semi_implicit", 3e-3, STEPS) for mode in MODES),  # three
        *(
            pytest.param(SEVERITY_1, *rest, marks=pytest.mark.long)
            for rest in (
                *(("agriq", mode, "semi_implicit", dt, STEPS) for mode in MODES for dt in (DT, 3e-3)),
                ("epiq", "driven", "semi_implicit", DT, KNOT),  # 72: ten steps are 720 plain ones
            )
        ),
    ],
    ids=lambda value: ("all" if value is SEVERITY_1 else "listed") if value in (SEVERITY_1, LISTED) else str(value),
)
def test_all_compiled_effects_at_once_equal_plain_ones(
    effects, name: str, mode: str, integrator: str, dt: float, steps: int
) -> None:
    """Semi-implicit steps with laws are long tests (`stepped`), and so are those of the small Epi.q.

    For it an articulation that is as hard to turn as Agri.q's is beyond RK4, see the next test.
    """
    small = {
        "com_offset": {"x": 0.02, "y": -0.02}, "battery_sag": {**SEVERITY_1["battery_sag"], "stall": 0.04},
        "velocity_loop": {"gain": 5e-5, "integral": 8.0, "windup": 0.01},
    }  # fmt: skip
    within = {} if name == "agriq" else small  # of the wheels, and of motors that the step follows
    robot = with_effects(load_robot(name), *effects, **within)
    assert gap_with(robot, MODES[mode], integrator, dt, steps) < 1e-12


def test_a_joint_too_stiff_for_the_step_is_refused(epiq) -> None:
    robot, order = with_effects(epiq, "joint_friction"), commands(epiq, np.random.default_rng(1), torque=False)
    with pytest.raises(ArtibotError, match="dt"):
        rollout(robot, order, dt=DT, integrator="rk4")
    assert rollout(robot, order, dt=DT, integrator="semi_implicit").final_state is not None


@pytest.mark.parametrize(
    ("effects", "integrator"),
    [(SEVERITY_1, "rk4"), (LISTED, "semi_implicit"), pytest.param(SEVERITY_1, "semi_implicit", marks=pytest.mark.long)],
    ids=["all-rk4", "listed-semi_implicit", "all-semi_implicit"],
)
def test_effects_on_a_rigid_robot_equal_plain_ones(husky, effects, integrator: str) -> None:
    rng = np.random.default_rng(5)
    robot = with_effects(husky, *(name for name in effects if not name.startswith(("joint", "back", "payload"))))
    start, order = moving_state(robot, rng), commands(robot, rng, torque=False)
    modes = MODES["driven"]
    end = rollout(robot, order, dt=DT, modes=modes, state=start, integrator=integrator).final_state
    plain = plain_run(robot, start, order, modes, 1.0, integrator)
    np.testing.assert_allclose(end.q[:8], plain[:8], rtol=0, atol=1e-12 * np.abs(plain).max())
    np.testing.assert_allclose(end.v[:8], plain[16:24], rtol=0, atol=1e-12 * np.abs(plain).max())
