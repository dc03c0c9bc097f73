"""A step that `rollout` accepts is a stable one: the planar rover linearised, against the limit that is enforced.

An unstable wheel spin is bounded by eq. 16 and hardly seen in the pose, so the pose cannot be the judge.
"""

from __future__ import annotations

import sys

import numpy as np
import pytest
from model.effects import with_effects
from model.helpers import front_commands, ramp
from model.planar import linearised

from artibot_sim.errors import ArtibotError
from artibot_sim.model import WHEELS, Commands, Mode, State, Status, initial_state, rollout
from artibot_sim.model.analysis.stability import largest_step, parts, rigid_limit, slip_speedup
from artibot_sim.model.effects.motor_drag import WIDTH
from artibot_sim.model.equations.transmission import back_torque_factor
from artibot_sim.model.robot.derived import params
from artibot_sim.model.simulate.rollout import integration

MODES = (Mode.PRESCRIBED, Mode.PRESCRIBED, Mode.TORQUE, Mode.TORQUE)


def light_back(robot):
    """A light back module with a short gear: wheel spin and slip are both fast, and push each other."""
    changes = {"back.m": 0.5 * robot.back.m, "wheel.m_w": 0.0, "drive.front.eta_d": 0.3}
    return robot.replace(changes | {"drive.back.tau": 2 * robot.drive.back.tau})


def growth(z):
    """|R(z)| of the classical Runge-Kutta method."""
    return np.abs(1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24)


@pytest.mark.parametrize("kind", ["agriq", "epiq", "light_back"])
def test_longest_accepted_rk4_step_is_stable(agriq, epiq, kind):
    robot = {"agriq": agriq, "epiq": epiq, "light_back": light_back(agriq)}[kind]
    drives = [robot.drive.front] * 2 + [robot.drive.back] * 2
    dt, what = largest_step(params(robot), "rk4", MODES)
    driving, braking = (
        linearised(robot, 0.3, eta) for eta in zip(*((d.eta_d, 1 / d.eta_r) for d in drives), strict=True)
    )
    eigenvalues = np.concatenate([driving, braking])
    worst = eigenvalues[np.argmax(growth(eigenvalues * dt))]
    assert growth(worst * dt) <= 1 + 1e-6, (
        f"dt = {dt * 1e3:.3f} ms is accepted ('{what}'), but the mode at {worst:.0f} /s grows by "
        f"{growth(worst * dt):.3f} a step"
    )


@pytest.mark.parametrize("effects", [(), ("bulldozing", "com_offset"), ("slip_ratio", "load_sensitivity")])
@pytest.mark.parametrize("changes", [{}, {"contact.k_l": 9000.0}, {"contact.k_t": 9000.0}, {"front.J_z": 2.4}])
def test_a_rigid_rovers_limit_is_that_of_its_modes(husky, effects, changes):
    """In closed form for prescribed motors, whichever motion is the fastest: along, across or turning."""
    robot = params(with_effects(husky.replace(changes), *effects))
    limit, _ = largest_step(robot, "rk4", (Mode.PRESCRIBED,) * 4)
    assert rigid_limit(robot, 1.0) == pytest.approx(limit, rel=1e-3)


@pytest.mark.parametrize("modes", [(Mode.PRESCRIBED,) * 4, MODES])
def test_slip_is_faster_by_no_more_than_what_is_said(agriq, epiq, modes):
    """Over soils, loads and contact laws at random; and as much where all dampers grow alike."""
    rng = np.random.default_rng(0)
    for plain in (agriq, epiq):
        than, (usual, _) = params(plain), largest_step(params(plain), "rk4", modes)
        for _ in range(6):
            keys = "contact.k_l", "contact.k_t", "front.m", "front.J_z", "back.m", "back.J_z"
            factor = np.exp(0.7 * rng.standard_normal(6))
            factor[3::2] = np.clip(factor[3::2], 0.7, 1.0)  # J_x and J_y hold J_z
            drawn = plain.with_vector(keys, plain.as_vector(keys) * factor)
            p = params(with_effects(drawn, slip_ratio={"exponent": rng.uniform(0.6, 1.0)}))
            assert largest_step(p, "rk4", modes)[0] > 0.999 * usual / slip_speedup(p, than)
        alike = params(plain.with_vector(keys[:2], 3.0 * plain.as_vector(keys[:2])))
        assert slip_speedup(alike, than) == pytest.approx(3.0)
        assert largest_step(alike, "rk4", modes[:1] * 4)[0] == pytest.approx(
            largest_step(than, "rk4", modes[:1] * 4)[0] / 3.0
        )


@pytest.mark.parametrize("kind", ["agriq", "epiq", "light_back"])
def test_longest_accepted_semi_implicit_step_leaves_no_ripple(agriq, epiq, kind):
    robot = {"agriq": agriq, "epiq": epiq, "light_back": light_back(agriq)}[kind]
    dt, _ = largest_step(params(robot), "semi_implicit", MODES)
    dt *= 0.99
    commands = front_commands(robot, lambda t: 0.2 * ramp(t, 1.0), lambda t: 0.0, 600 * dt + 2.0, h=dt)
    result = rollout(robot, commands, dt=dt, integrator="semi_implicit", kappa=0.7, every=1)
    for name in ("theta_br_dot", "M_m_front_left"):
        end = result[name][-200:]
        assert np.ptp(end) < 1e-6 * np.abs(end).max(), f"{name} ripples at dt = {dt * 1e3:.2f} ms"


def test_what_a_step_of_1_ms_gives_is_true_or_refused(agriq):
    """What unstable wheels waste shows in the slip, not in the pose."""
    robot = light_back(agriq)
    commands = front_commands(robot, lambda t: 0.25 * ramp(t, 1.0), lambda t: 0.0, 2.5)

    def slip(dt):
        result = rollout(robot, commands, dt=dt, kappa=0.5, energy=True)
        return sum(result[f"E_slip_l_{wheel}"][-1] for wheel in WHEELS)

    true = slip(2.5e-4)
    try:
        found = slip(1e-3)
    except ArtibotError as error:
        assert "dt" in str(error)
        return
    assert found == pytest.approx(true, rel=0.1), "free wheels rattle: the step is too long for them"


PAPER, DRIVEN, ALL = MODES, (Mode.DRIVEN, Mode.DRIVEN, Mode.TORQUE, Mode.TORQUE), (Mode.PRESCRIBED,) * 4
TORQUES = (Mode.TORQUE,) * 4


@pytest.fixture
def unchecked(monkeypatch):
    """`rollout` takes any step."""
    monkeypatch.setattr(sys.modules["artibot_sim.model.simulate.rollout"], "largest_step", lambda *_: (np.inf, ""))


def growth_of_a_step(robot, dt, modes, speed, bend):
    """Largest eigenvalue of one semi-implicit step, found by trying: rover driving straight on, or standing bent."""
    cruise = speed / (robot.wheel.r_w * robot.drive.front.tau)
    table = np.full((3, 4), cruise)
    commands = Commands(dt, table, position=dt * np.arange(3)[:, None] * table)
    rest = initial_state(robot, articulation_yaw=bend)
    v = np.zeros(16)
    v[[0, 6, 7, 8, 14, 15]] = speed, cruise, cruise, speed, cruise, cruise
    modules = 2 if robot.articulated else 1
    tried = [*range(8 * modules), *range(16, 16 + 8 * modules), *range(32, 32 + 2 * modules)]

    def step(x):
        state = State(0.0, x[:16], x[16:32], rest.eta, x[32:])
        end = rollout(robot, commands, dt=dt, integrator="semi_implicit", modes=modes, state=state, duration=dt)
        return np.concatenate([end.final_state.q, end.final_state.v, end.final_state.torque])[tried]

    x = np.concatenate([rest.q, v, np.zeros(4)])
    columns = [(step(x + 1e-6 * e) - step(x - 1e-6 * e)) / 2e-6 for e in np.eye(36)[tried]]
    return np.abs(np.linalg.eigvals(np.column_stack(columns))).max()


def rover_of(request, agriq, name):
    """A robot as shipped, or one that stresses the semi-implicit step."""
    changed = {"light_back": lambda: light_back(agriq), "damped": lambda: agriq.replace({"contact.c_n": 2000.0})}
    return changed[name]() if name in changed else request.getfixturevalue(name)


@pytest.mark.parametrize("stiffer", [1.0, 30.0])
@pytest.mark.parametrize("modes", [PAPER, DRIVEN, ALL, TORQUES], ids=["paper", "driven", "prescribed", "torques"])
@pytest.mark.parametrize("name", ["agriq", "epiq", "husky", "light_back", "damped"])
def test_no_part_of_a_semi_implicit_step_grows(request, agriq, unchecked, name, modes, stiffer):
    """Parts are short beside the slip, which is explicit, on ground of any stiffness."""
    robot = rover_of(request, agriq, name)
    robot = robot.replace({f"contact.{k}": stiffer * getattr(robot.contact, k) for k in ("k_l", "k_t")})
    dt, what = largest_step(params(robot), "semi_implicit", modes)
    part = dt / parts(params(robot), dt, back_torque_factor(robot))
    for case in ((0.3, 0.0), (0.0, 0.8 if robot.articulated else 0.0)):
        worst = growth_of_a_step(robot, part, modes, *case)
        assert worst < np.exp(0.5 * part) + 1e-6, f"{worst:.4f} a part of {part * 1e3:.2f} ms, limit by {what}"


@pytest.mark.parametrize(
    ("changes", "modes", "limit"),
    [
        ({"contact.k_n": 1e8}, PAPER, "vertical motion on the wheels"),
        ({"contact.k_n": 1e8}, TORQUES, "vertical motion on the wheels"),
        ({"contact.c_n": 3e4}, DRIVEN, "vertical motion on the wheels"),
        ({"control.A_motor": 3e3}, PAPER, "control.A_motor"),
        ({"control.A_motor": 3e3}, ALL, "control.A_motor"),
        ({"control.velocity_gain": 1e4}, DRIVEN, "control.velocity_gain"),
        ({"control.A_joint": 3e3}, TORQUES, "control.A_joint"),
    ],
)
@pytest.mark.parametrize("name", ["agriq", "epiq", "husky"])
def test_semi_implicit_limit_is_where_steps_begin_to_grow(request, unchecked, name, changes, modes, limit):
    """Stiff springs and loops, whose limit is that of a whole part: up to it nothing grows but what grows in any step.

    A third beyond it, something does.
    """
    robot = request.getfixturevalue(name).replace(changes)
    dt, what = largest_step(params(robot), "semi_implicit", modes)
    if limit == "control.A_joint" and not robot.articulated:
        assert what != limit
        return
    assert what == limit
    assert parts(params(robot), 1.33 * dt, back_torque_factor(robot)) == 1
    cases = [(0.3, 0.0), (0.0, 0.8 if robot.articulated else 0.0)]
    for part in (0.1, 0.5, 1.0):
        worst = max(growth_of_a_step(robot, part * dt, modes, *case) for case in cases)
        assert worst < np.exp(0.5 * part * dt) + 1e-6, f"{worst:.4f} a step at {part * dt * 1e3:.2f} ms"
    beyond = max(growth_of_a_step(robot, 1.33 * dt, modes, *case) for case in cases)
    assert beyond > 1.05, f"nothing grows at {1.33 * dt * 1e3:.2f} ms: the limit by {what} is too careful"


@pytest.mark.parametrize("name", ["agriq", "epiq", "husky"])
@pytest.mark.parametrize("modes", [PAPER, DRIVEN, ALL, TORQUES], ids=["paper", "driven", "prescribed", "torques"])
def test_semi_implicit_takes_1_to_5_ms_with_room(request, name, modes):
    dt, _ = largest_step(params(request.getfixturevalue(name)), "semi_implicit", modes)
    assert dt >= 6e-3


@pytest.mark.parametrize("name", ["agriq", "epiq"])
def test_long_steps_give_the_same_steady_turn(request, name):
    """Parts of a step take commands and feedback at their own instants: at 9 and 7 ms the circle is that of 1 ms."""
    robot = request.getfixturevalue(name)
    longest, _ = largest_step(params(robot), "semi_implicit", PAPER)
    times = int(0.95 * longest / 1e-3)

    def turn(dt):
        commands = front_commands(robot, lambda t: 0.25 * ramp(t), lambda t: 0.2 * ramp(t), 9.0, h=times * dt)
        end = rollout(robot, commands, dt=dt, integrator="semi_implicit", kappa=0.8)
        return np.array([*end.twist[-1], end.articulation_yaw[-1], *end.motor_velocity[-1], *end.motor_torque[-1]])

    assert times >= 7
    short, long = turn(1e-3), turn(1e-3 * times)
    np.testing.assert_allclose(long, short, rtol=4e-3, atol=1e-5)


def table_6(robot, name, dt, integrator="semi_implicit", **options):
    """Poses over Table 6 at rows 10 ms apart, at steps of `dt` (s) or a little less."""
    from artibot_sim.planning import load_manoeuvre, plan

    every = int(np.ceil(0.01 / dt - 1e-9))
    commands = plan(load_manoeuvre(f"table6_{name}"), robot, dt=0.01).commands()
    return rollout(robot, commands, dt=0.01 / every, every=every, integrator=integrator, **options).pose[:, :2]


def true_table_6(robot, name, kappa):
    """The same by RK4, at steps at which it has converged: of 240 random rovers all but one to 4 mm, most to 0.1 mm."""
    longest, _ = largest_step(params(robot), "rk4", MODES, back_torque_factor(robot, kappa))
    return table_6(robot, name, min(0.4 * longest, 5e-5), "rk4", kappa=kappa)


@pytest.mark.parametrize("stiffer", [0.1, 1.0, 3.0, 10.0, 30.0, 100.0])
@pytest.mark.parametrize("name", ["agriq", "epiq"])
def test_stiff_ground_is_as_exact_as_soft_one(request, name, stiffer):
    """A whole step of 5 ms on ground 30 times as stiff once ended 15 m off."""
    robot = request.getfixturevalue(name)
    robot = robot.replace({f"contact.{k}": stiffer * getattr(robot.contact, k) for k in ("k_l", "k_t")})
    kappa = robot.control.kappa
    found, true = table_6(robot, name, 5e-3, kappa=kappa), true_table_6(robot, name, kappa)
    assert np.abs(found - true).max() < 5e-3


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("name", ["agriq", "epiq"])
def test_stiff_ground_under_random_rovers(request, name, seed):
    """Masses, spacings, soils and shares at random: within 5 mm, or within what half a percent of friction does.

    Where a wheel is about to break away (eq. 16) the path hangs by anything: Epi.q's more often than Agri.q's. RK4 at
    0.2 ms, or in parts of that which are short enough for it, is within 5 mm there, too.
    """
    plain, rng = request.getfixturevalue(name), np.random.default_rng(seed)

    def factor(most):
        return float(most ** rng.uniform(-1.0, 1.0))

    stiffer = 10.0 ** rng.uniform(-1.0, 2.0)
    changes = {f"contact.{k}": stiffer * factor(1.4) * getattr(plain.contact, k) for k in ("k_l", "k_t")}
    changes |= {f"{m}.m": factor(2.0) * getattr(plain, m).m for m in ("front", "back")}
    changes |= {"front.i_x": factor(1.4) * plain.front.i_x, "front.i_y": factor(1.4) * plain.front.i_y}
    robot = plain.replace(changes)
    kappa = float(rng.uniform(0.5, 1.0))
    share = back_torque_factor(robot, kappa)
    found, true = table_6(robot, name, 5e-3, kappa=kappa), true_table_6(robot, name, kappa)
    error = np.abs(found - true).max()
    if error > 5e-3:
        assert name == "epiq"
        friction = ("contact.mu_s", "contact.mu_d")
        firmer = robot.with_vector(friction, 1.005 * robot.as_vector(friction))
        assert error < np.abs(true_table_6(firmer, name, kappa) - true).max()
    integrator, step = integration(robot, 2e-4, kappa=kappa)
    longest, _ = largest_step(params(robot), "rk4", MODES, share)
    assert integrator == "rk4" and step <= longest and 2e-4 / step == pytest.approx(round(2e-4 / step), rel=1e-12)
    assert step == 2e-4 or 2e-4 / (round(2e-4 / step) - 1) > longest, "no shorter than is needed"
    assert np.abs(table_6(robot, name, step, "rk4", kappa=kappa) - true).max() < 5e-3


@pytest.mark.parametrize("kappa", [0.2, 0.1, 0.05, 0.01])
@pytest.mark.parametrize("name", ["agriq", "epiq"])
def test_torque_sharing_limits_the_step(request, name, kappa):
    """Straight on at a steady speed the back wheels turn steadily at any step that is accepted, whatever they share."""
    robot = request.getfixturevalue(name)
    speed = 0.3
    dt, _ = largest_step(params(robot), "rk4", MODES, back_torque_factor(robot, kappa))
    assert dt < 1e-4 or kappa > 0.01 or name == "epiq"
    dt *= 0.99
    commands = front_commands(robot, lambda t: speed * ramp(t, 1.0), lambda t: 0.0, 100 * dt + 2.0, h=dt)
    result = rollout(robot, commands, dt=dt, kappa=kappa, every=1)
    end = result["theta_br_dot"][-80:]
    assert np.ptp(end) < 1e-3 * np.abs(end).max()
    if kappa < 0.1 and name == "agriq":
        with pytest.raises(ArtibotError, match=r"control\.kappa, torque sharing"):
            rollout(robot, front_commands(robot, lambda t: 0.3, lambda t: 0.0, 1.0), dt=1e-3, kappa=kappa)
    free = front_commands(robot, lambda t: speed * ramp(t, 1.0), lambda t: 0.0, 3.0)
    end = rollout(robot, free, kappa=kappa, integrator="semi_implicit", every=1)["theta_br_dot"][-80:]
    assert np.ptp(end) < 1e-3 * np.abs(end).max()


@pytest.mark.parametrize("integrator", ["rk4", "semi_implicit"])
def test_a_motor_that_drag_has_stopped_stands_or_the_step_is_refused(agriq, integrator):
    robot = with_effects(agriq, motor_drag={"torque": 5.0, "motor": "back_left"})
    commands = front_commands(robot, lambda t: 0.4 * ramp(t), lambda t: 0.0, 3.0)
    try:
        result = rollout(robot, commands, integrator=integrator)
    except ArtibotError as error:
        assert integrator == "rk4" and "motor_drag" in str(error)
        result = rollout(robot, commands, dt=5e-5)
    stands = 0.1 if integrator == "semi_implicit" else WIDTH  # RK4 at its limit swings within the drag's own width
    assert np.abs(result["theta_bl_dot"][-50:]).max() < stands


def test_lateral_forces_that_follow_faster_than_the_step_are_refused(agriq):
    robot = with_effects(agriq, tyre_relaxation={"length": 1e-4})
    fast = front_commands(robot, lambda t: 15.0 * ramp(t), lambda t: 0.0, 2.0)
    with pytest.raises(ArtibotError, match=r"effects\.tyre_relaxation"):
        rollout(robot, fast)
    slow = front_commands(robot, lambda t: 0.2 * ramp(t), lambda t: 0.05, 2.0)
    assert rollout(robot, slow).status == rollout(robot, slow, integrator="semi_implicit").status == Status.OK


@pytest.mark.parametrize("name", ["agriq", "epiq"])
def test_table_6_at_5_ms_is_the_same_path(request, name):
    from artibot_sim.planning import load_manoeuvre, plan

    robot = request.getfixturevalue(name)
    commands = plan(load_manoeuvre(f"table6_{name}"), robot, dt=0.01).commands()
    true, found = (
        rollout(robot, commands, dt=dt, integrator=integrator, every=round(0.01 / dt)).pose[:, :2]
        for dt, integrator in ((2e-4, "rk4"), (5e-3, "semi_implicit"))
    )
    assert np.abs(found - true).max() < 0.02


def test_a_stepper_takes_long_steps_too(epiq):
    from artibot_sim.model.simulate.stepper import MotorCommand, Stepper

    cruise = 0.3 / (epiq.wheel.r_w * epiq.drive.front.tau)
    ends = []
    for dt in (1e-3, 7e-3):
        rover = Stepper(epiq, dt=dt, integrator="semi_implicit")
        for k in range(500):
            speed = min(1, k / 250) * cruise, min(1, (k + 1) / 250) * cruise
            slower = 0.9 * speed[0], 0.9 * speed[1]
            rover.advance(
                round(7e-3 / dt), (MotorCommand(speed), MotorCommand(slower), MotorCommand(speed), MotorCommand(speed))
            )
        ends.append(rover.q[:6].copy())
    np.testing.assert_allclose(ends[1], ends[0], atol=5e-3)
