"""A rover over uneven ground: against plain equations, geometry, energy, symmetry, refinement; and where it ends."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from model.helpers import front_commands, mirrored, mirrored_commands, ramp, standstill, what_wheels_remember
from model.test_fast_equals_plain import KNOT, MODES, commands, cubic, moving_state

from artibot_sim.errors import ArtibotError
from artibot_sim.model import (
    WHEELS,
    Commands,
    Ground,
    Robot,
    State,
    Status,
    initial_state,
    load_robot,
    random_ground,
    rollout,
)
from artibot_sim.model.analysis.stability import parts
from artibot_sim.model.equations.transmission import back_torque_factor
from artibot_sim.model.ground.raster import sample
from artibot_sim.model.kernels.energy import stored_energy
from artibot_sim.model.reference.dynamics import contact
from artibot_sim.model.reference.effects import PlainEffects
from artibot_sim.model.reference.steps import PlainState, rk4_step, semi_implicit_step
from artibot_sim.model.robot.derived import on_ground, params
from artibot_sim.model.simulate.rollout import unlimited_beside_prescribed
from artibot_sim.model.simulate.stepper import COASTING, MotorCommand, Stepper


def raster(height, cell=0.05, half=4.0, **more) -> Ground:
    """Ground around the origin from a function of x and y."""
    at = cell * np.arange(-round(half / cell), round(half / cell) + 1)
    x, y = np.meshgrid(at, at)
    return Ground(height(x, y) + 0.0 * x, cell, at[0], at[0], **more)


def hills(cell=0.05, half=4.0, **more) -> Ground:
    return raster(lambda x, y: 0.06 * np.sin(2.0 * x + 0.5) * np.cos(1.5 * y - 0.3) + 0.05 * x, cell, half, **more)


def driving(robot: Robot, speed=0.5, yaw_rate=0.0, duration=4.0) -> Commands:
    return front_commands(robot, lambda t: speed * ramp(t, 0.5), lambda t: yaw_rate * ramp(t, 0.5), duration)


def plain_run(robot, start, order, modes, ground, integrator, dt) -> np.ndarray:
    """The equations in plain NumPy over `ground`."""
    p = unlimited_beside_prescribed(on_ground(params(robot), ground, robot.wheel.r_w), modes)
    factor, surface = back_torque_factor(robot, 0.7), ground.under_wheels(robot.wheel.r_w)
    state = PlainState(start.q, start.v, start.eta, start.torque, start.memory, start.behind)
    effects = PlainEffects(robot.effects)
    cut = parts(p, dt, factor) if integrator == "semi_implicit" else 1
    step = dt / cut
    for i in range((len(order.velocity) - 1) * KNOT * cut):
        knot, t = i // (KNOT * cut), i * step
        now, held = effects.at(t), order.torque[knot]
        if integrator == "rk4":
            drives = [cubic(order, t + part * step, knot) for part in (0.0, 0.5, 1.0)]
            state = rk4_step(p, state, modes, drives, held, factor, step, now, surface)
        else:
            drive, ahead = cubic(order, t, knot), cubic(order, t + step, knot)
            drive = np.vstack([drive[:2], (ahead[1] - drive[1]) / step, ahead[0]])
            state = semi_implicit_step(p, state, modes, drive, held, factor, step, now, surface)
    return np.concatenate([state.q, state.v, state.eta, state.torque])


def tilted_start(robot: Robot, ground: Ground, rng: np.random.Generator) -> State:
    """Out of equilibrium in every coordinate, where the ground is neither level nor even."""
    moving = moving_state(robot, rng)
    rest = initial_state(
        robot, x=0.4, y=-0.3, yaw=0.7, articulation_yaw=0.3 if robot.articulated else 0.0, ground=ground
    )
    q = rest.q + np.isin(np.arange(16) % 8, (2, 3, 4)) * 1e-3 * rng.normal(size=16)
    return dataclasses.replace(moving, q=q if robot.articulated else np.where(np.arange(16) < 8, q, 0.0))


@pytest.mark.parametrize(
    ("name", "modes", "integrator"),
    [
        ("agriq", "as in the paper", "rk4"),
        ("agriq", "driven", "semi_implicit"),
        ("epiq", "as in the paper", "semi_implicit"),
        ("husky", "driven", "rk4"),
        ("husky", "all prescribed", "semi_implicit"),
    ],
)
def test_compiled_steps_equal_plain_ones(name: str, modes: str, integrator: str) -> None:
    rng, robot = np.random.default_rng(7), load_robot(name)
    if robot.articulated:
        robot = robot.replace({"front.O_z": 0.03, "back.O_z": 0.02, "drive.front.torque_max": 0.5})
    soil = np.exp(0.1 * rng.normal(size=(2, 161, 161)).clip(-2, 2))
    ground, chosen = hills(k=soil[0], mu=soil[1]), MODES[modes]
    start, order = tilted_start(robot, ground, rng), commands(robot, rng, False, 1e-3, 2 * KNOT)
    end = rollout(robot, order, modes=chosen, kappa=0.7, state=start, integrator=integrator, ground=ground).final_state
    want, count = plain_run(robot, start, order, chosen, ground, integrator, 1e-3), 4 if robot.articulated else 2
    got = np.concatenate([end.q, end.v, end.eta[:count], end.torque[:count]])
    want = np.concatenate([want[: 32 + count], want[36 : 36 + count]])
    assert np.max(np.abs(got - want) / np.maximum(np.abs(want), 1.0)) < 1e-11


@pytest.mark.parametrize("name", ["agriq", "husky"])
def test_flat_rasters_are_flat_ground(name: str) -> None:
    robot = load_robot(name)
    order, flat = driving(robot, yaw_rate=0.3), raster(lambda x, y: 0.0 * x)
    on_raster, on_plane = rollout(robot, order, ground=flat), rollout(robot, order)
    np.testing.assert_allclose(on_raster.q, on_plane.q, rtol=0, atol=1e-9)
    np.testing.assert_allclose(on_raster["F_t_front_left_back"], on_plane["F_t_front_left_back"], rtol=0, atol=1e-6)


@pytest.mark.parametrize("name", ["agriq", "husky"])
@pytest.mark.parametrize("yaw", [0.0, 1.1])
def test_on_a_plane_both_modules_stand_parallel_to_it(name: str, yaw: float) -> None:
    robot, slope = load_robot(name), np.array([0.2, -0.1])
    state = initial_state(robot, yaw=yaw, ground=raster(lambda x, y: slope[0] * x + slope[1] * y))
    ahead = slope @ [np.cos(yaw), np.sin(yaw)]
    left = slope @ [-np.sin(yaw), np.cos(yaw)]
    for b in (0, 8) if robot.articulated else (0,):
        alpha, beta = state.q[b + 3 : b + 5]
        assert np.tan(beta) == pytest.approx(-ahead, abs=1e-9)
        if robot.suspended == "rocker":  # axles lie along R_z R_x y, pitch does not reach them
            assert np.tan(alpha) == pytest.approx(left, abs=1e-9)
        else:
            normal = np.array([np.sin(beta) * np.cos(alpha), -np.sin(alpha), np.cos(beta) * np.cos(alpha)])
            np.testing.assert_allclose(normal / normal[2], [-ahead, -left, 1.0], rtol=0, atol=1e-9)


def bump(x0: float, y0: float, height: float, radius=0.15):
    """A hill with a level top."""
    return lambda x, y: height * np.clip(1.6 - np.hypot(x - x0, y - y0) / radius, 0.0, 1.0)


def test_a_bump_under_one_wheel_of_a_rocker_lifts_and_rolls_its_module_by_geometry(agriq) -> None:
    """Half of it reaches the rocker's pivot; the joint leaves the other module's roll free; both share the pitch."""
    x, y, height = agriq.front.i_x / 2, agriq.front.i_y / 2, 0.06
    q = initial_state(agriq, ground=raster(bump(x, y, height), cell=0.02, half=2.0)).q
    level = initial_state(agriq).q
    assert np.sin(q[3]) == pytest.approx(0.5 * height / agriq.front.i_y, abs=1e-9)
    assert q[2] - level[2] == pytest.approx(0.25 * height, abs=1e-9)
    assert np.abs(q[[10, 11]] - level[[10, 11]]).max() < 1e-9
    assert np.sin(q[12]) == pytest.approx(-0.25 * height / agriq.back.l, abs=1e-9)  # l_f is 0


def test_a_bump_under_a_wheel_of_a_rigid_module_is_shared_by_its_springs(husky) -> None:
    """The plane through four points with the least sum of squares: a quarter of the height each for heave and tilts."""
    x, y, height = husky.front.i_x / 2, husky.front.i_y / 2, 0.004
    q = initial_state(husky, ground=raster(bump(x, y, height), cell=0.02, half=2.0)).q
    level = initial_state(husky).q
    assert q[2] - level[2] == pytest.approx(0.25 * height, rel=1e-3)
    assert q[3] == pytest.approx(0.25 * height / y, rel=1e-2)
    assert q[4] == pytest.approx(-0.25 * height / x, rel=1e-2)


@pytest.mark.parametrize("name", ["agriq", "husky"])
def test_normal_forces_are_the_gradient_of_what_the_springs_store(name: str) -> None:
    rng, robot, ground = np.random.default_rng(2), load_robot(name), hills()
    q = tilted_start(robot, ground, rng).q
    p, surface = params(robot), ground.under_wheels(robot.wheel.r_w)
    force = contact(p, q, np.zeros(16), ground=surface).Q.sum(axis=0)
    turning = [6, 7, 14, 15] if robot.articulated else range(6, 16)
    d = 1e-6
    for i in np.delete(np.arange(16), turning):
        ends = q + d * np.eye(16)[i], q - d * np.eye(16)[i]
        stored = stored_energy(robot, np.array(ends), np.zeros((2, 16)), ground)["elastic"]
        lead = p.u_w if i % 8 == 5 else 0.0  # eq. 20's lead is of yaw, and dissipates
        assert force[i] == pytest.approx(-(stored[0] - stored[1]) / (2 * d), abs=1e-4 + 300.0 * lead)


@pytest.mark.parametrize("name", ["agriq", "husky"])
def test_energy_put_in_is_stored_or_lost(name: str) -> None:
    robot, ground = load_robot(name), hills(0.1, 6.0)
    robot = robot.replace({"contact.mu_s": 50.0, "contact.mu_d": 50.0})  # nothing slides: the order of the method
    gaps = []
    for dt in (1e-3, 5e-4):
        run = rollout(robot, driving(robot), dt=dt, ground=ground, energy=True, every=1000)
        assert run.status is Status.OK
        stored = sum(stored_energy(robot, run.q, run.v, ground).values())
        put_in = sum(run[name][-1] for name in run.columns if name.startswith(("E_motor", "E_joint")))
        others = [name for name in run.columns if name.startswith("E_") and not name.startswith(("E_motor", "E_joint"))]
        assert min(run[f"E_normal_{wheel}"][-1] for wheel in WHEELS[: 8 if robot.articulated else 4]) > 0.0
        gaps.append(put_in - (stored[-1] - stored[0]) - sum(run[name][-1] for name in others))
        assert abs(gaps[-1]) < 1e-3 * put_in
    assert abs(gaps[1]) < 0.6 * abs(gaps[0])


def test_a_mirrored_drive_over_mirrored_ground_is_mirrored(agriq) -> None:
    ground, order = hills(), driving(agriq, yaw_rate=0.2, duration=2.0)
    run = rollout(agriq, order, ground=ground)
    flipped = rollout(agriq, mirrored_commands(order), ground=dataclasses.replace(ground, height=ground.height[::-1]))
    np.testing.assert_allclose(flipped.q, mirrored(run.q), rtol=0, atol=1e-9)


def test_a_quarter_turn_of_ground_and_start_turns_the_drive(agriq) -> None:
    ground, order = hills(), driving(agriq, yaw_rate=0.2, duration=2.0)
    start = initial_state(agriq, x=0.3, y=0.2, yaw=0.4, ground=ground)
    turned = dataclasses.replace(ground, height=ground.height.T[:, ::-1].copy())  # h'(x, y) = h(y, -x)
    there = initial_state(agriq, x=-0.2, y=0.3, yaw=0.4 + np.pi / 2, ground=turned)
    run, other = rollout(agriq, order, ground=ground, state=start), rollout(agriq, order, ground=turned, state=there)
    np.testing.assert_allclose(other.q[:, 0], -run.q[:, 1], rtol=0, atol=1e-8)
    np.testing.assert_allclose(other.q[:, 1], run.q[:, 0], rtol=0, atol=1e-8)
    np.testing.assert_allclose(other.q[:, 2:5], run.q[:, 2:5], rtol=0, atol=1e-8)


def test_results_converge_as_step_and_raster_are_refined(agriq) -> None:
    order = driving(agriq, yaw_rate=0.2)

    def end(cell: float, dt: float) -> np.ndarray:
        return rollout(agriq, order, dt=dt, ground=hills(cell), every=10000).q[-1, :6]

    best = end(0.025, 5e-4)
    by_cell = [np.abs(end(cell, 5e-4) - best).max() for cell in (0.2, 0.1, 0.05)]
    assert np.abs(end(0.025, 1e-3) - best).max() < 1e-4
    assert by_cell[0] > by_cell[1] > by_cell[2] and by_cell[2] < 5e-4


def test_both_modules_climb_a_hemisphere_and_come_down(agriq) -> None:
    ball = lambda x, y: np.sqrt(np.maximum(0.09 - (x - 1.2) ** 2 - (y - 0.36) ** 2, 0.0)) - 0.15  # noqa: E731
    ground = raster(lambda x, y: np.maximum(ball(x, y), 0.0), cell=0.02, half=5.0)
    run = rollout(agriq, driving(agriq, 0.4, duration=9.0), ground=ground)
    assert run.status is Status.OK and run.q[-1, 8] > 1.9
    for b in (0, 8):
        roll = run.q[:, b + 3]
        assert 0.06 < roll.max() < 0.15  # half of 0.15 m on 0.72 m
        assert abs(roll[-1]) < 5e-3
    assert run["z_f"].max() - run["z_f"][0] > 0.03


def step_ahead(height: float) -> Ground:
    return raster(lambda x, y: np.where(x > 1.0, height, 0.0), cell=0.02, half=4.0)


@pytest.mark.parametrize("name", ["agriq", "husky"])
def test_a_step_of_half_a_wheels_radius_is_climbed(name: str) -> None:
    robot = load_robot(name)
    height = 0.5 * robot.wheel.r_w
    run = rollout(robot, driving(robot, 0.3, duration=9.0), integrator="semi_implicit", ground=step_ahead(height))
    assert run.status is Status.OK, run.message
    assert run["x_f"][-1] > 1.6
    assert run["z_f"][-1] - run["z_f"][0] == pytest.approx(height, abs=0.01)


def test_a_step_higher_than_the_axle_ends_the_run_with_a_status(agriq) -> None:
    for integrator in ("rk4", "semi_implicit"):
        run = rollout(agriq, driving(agriq), integrator=integrator, ground=step_ahead(1.5 * agriq.wheel.r_w), every=77)
        assert run.status is Status.INVALID and "higher than its axle" in run.message
        assert run.final_state is None
        front = run["x_f"][-1] + agriq.front.i_x / 2 + agriq.wheel.r_w
        assert 0.9 < front < 1.05
        assert run.t[-2] < run.t[-1] < run.t[-2] + 0.077 + 1e-9 and f"{run.t[-1]:.3f} s" in run.message


def test_a_wheel_beyond_the_raster_ends_the_run_with_a_status(agriq) -> None:
    run = rollout(agriq, driving(agriq), ground=raster(lambda x, y: 0.0 * x, half=1.5))
    assert run.status is Status.INVALID and "ends" in run.message
    assert run["x_f"][-1] + agriq.front.i_x / 2 == pytest.approx(1.5, abs=0.01)
    with pytest.raises(ArtibotError, match="no ground at x"):
        initial_state(agriq, x=1.4, ground=raster(lambda x, y: 0.0 * x, half=1.5))


def test_a_rover_falls_off_a_cliff_with_a_status(agriq) -> None:
    cliff = raster(lambda x, y: np.where(x > 1.0, -3.0, 0.0), cell=0.05, half=4.0)
    run = rollout(agriq, driving(agriq), ground=cliff, integrator="semi_implicit")
    assert run.status in (Status.TIPPED, Status.AIRBORNE) or "face steeper" in run.message
    assert run["x_f"][-1] < 1.5


def test_what_wheels_keep_of_their_cells_does_not_show(agriq) -> None:
    """A rover that is asked again at each step, its wheels' cells unknown, goes as one that keeps them: to the bit."""
    ground = random_ground(5, size=6.4, length=0.6)
    turns = (MotorCommand((40.0, 40.0)), MotorCommand((60.0, 60.0)), COASTING, COASTING)
    keeps = Stepper(agriq, ground=ground)
    again = keeps.state
    for _ in range(1000):
        forgets = Stepper(agriq, ground=ground, state=again)
        assert forgets.advance(4, turns) is keeps.advance(4, turns) is Status.OK
        again = forgets.state
    np.testing.assert_array_equal(keeps.q, again.q)
    assert np.hypot(*keeps.q[:2]) > 4 * ground.resolution  # from where it started, at the origin


def test_slippery_ground_lets_a_rover_slide_that_dry_ground_holds(husky) -> None:
    slope, order = 0.3, standstill(1.5)
    heights = slope * raster(lambda x, y: x).height

    def along(mu: float) -> np.ndarray:
        ground = raster(lambda x, y: slope * x, mu=np.full(heights.shape, mu))
        return rollout(husky, order, ground=ground)["x_f"]

    assert abs(along(1.0)[-1]) < 0.15  # creeps, as eq. 15 is viscous
    x, t = along(0.1), 0.01 * np.arange(151)
    angle = np.arctan(slope)
    down = 9.81 * (np.sin(angle) - 0.1 * husky.contact.mu_d * np.cos(angle)) * np.cos(angle)
    assert x[-1] == pytest.approx(-0.5 * down * t[-1] ** 2, rel=0.05)


def test_a_height_of_the_centre_of_mass_moves_loads_as_on_flat_ground(husky) -> None:
    high = dataclasses.replace(husky, effects={"com_height": {"height": 0.25}, "stiction": {"length": 0.01}})
    order, flat = driving(husky, 0.8, 0.8, 5.0), raster(lambda x, y: 0.0 * x, damping=1.0)
    loads = [
        np.array([run[f"F_n_{wheel}"][-1] for wheel in ("front_right_front", "front_left_front")])
        for run in (rollout(high, order), rollout(high, order, ground=flat))
    ]
    moved = loads[0] - loads[0].mean()
    assert np.abs(moved).min() > 2.0
    np.testing.assert_allclose(loads[1] - loads[0], 0.0, atol=0.1 * np.abs(moved).max())


def test_effects_act_on_uneven_ground_as_the_plain_equations_say(agriq) -> None:
    effects = {
        "com_offset": {"x": 0.03, "y": -0.02}, "com_height": {"height": 0.2}, "stiction": {"length": 0.005},
        "wheel_windup": {"way": 0.01},
        "tyre_relaxation": {"length": 0.2}, "slip_ratio": {"exponent": 0.8}, "load_sensitivity": {"exponent": 0.3},
        "friction_patch": {"scale": 0.5, "x": 0.6, "y": 0.0, "radius": 0.5}, "joint_friction": {"torque": 5.0},
        "wheel_resistance": {"share": 0.1}, "bulldozing": {"coefficient": 300.0}, "soil_softening": {"rate": 0.01},
    }  # fmt: skip
    robot, rng, ground = dataclasses.replace(agriq, effects=effects), np.random.default_rng(3), hills()
    start, order = tilted_start(robot, ground, rng), commands(robot, rng, False, 2e-4, 2 * KNOT)
    start = dataclasses.replace(start, **what_wheels_remember(rng))
    end = rollout(robot, order, dt=2e-4, kappa=0.7, state=start, ground=ground).final_state
    want = plain_run(robot, start, order, MODES["as in the paper"], ground, "rk4", 2e-4)
    got = np.concatenate([end.q, end.v, end.eta, end.torque])
    assert np.max(np.abs(got - want) / np.maximum(np.abs(want), 1.0)) < 1e-11


def test_steps_too_long_for_stiff_ground_are_refused(agriq) -> None:
    stiff = raster(lambda x, y: 0.0 * x, k=np.full((161, 161), 3.0))
    with pytest.raises(ArtibotError, match="is unstable with"):
        rollout(agriq, driving(agriq), ground=stiff)
    assert rollout(agriq, driving(agriq), ground=stiff, integrator="semi_implicit").status is Status.OK


def test_trains_on_uneven_ground_are_refused() -> None:
    robot = load_robot("train3")
    with pytest.raises(ArtibotError, match="ground: robot 'train3' has 3 modules"):
        initial_state(robot, ground=hills())
    with pytest.raises(ArtibotError, match="ground: robot 'train3' has 3 modules"):
        rollout(robot, Commands(0.01, np.zeros((11, len(robot.motors)))), ground=hills())


def test_random_ground_is_driven_over(agriq) -> None:
    ground = random_ground(11, size=12.8)
    run = rollout(agriq, driving(agriq, 0.5, 0.2, 10.0), ground=ground)
    assert run.status is Status.OK and run.ground is ground
    under = sample(ground.under_wheels(agriq.wheel.r_w), run["x_f"], run["y_f"])[0]
    assert np.corrcoef(run["z_f"], under)[0, 1] > 0.8
