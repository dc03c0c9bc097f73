"""Bristles between wheel and ground: rovers that stand, paths that do not depend on speed, where energy goes."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from model.effects import with_effects
from model.helpers import front_commands, ramp, standstill
from model.test_fast_equals_plain import MODES, plain_run

from artibot_sim.errors import ArtibotError
from artibot_sim.model import WHEELS, Mode, Status, initial_state, load_robot, rollout
from artibot_sim.model.effects.stiction import TIME
from artibot_sim.model.equations.contact import bending
from artibot_sim.model.kernels.compilation import kernel
from artibot_sim.model.reference.contact import contact
from artibot_sim.model.reference.effects import PlainEffects
from artibot_sim.model.robot.derived import params
from artibot_sim.model.simulate.batch import rollout_batch

FRICTION = 0.63
"""mu_s of Agri.q."""


def on_slope(robot, grade, heading, **effects):
    return with_effects(robot, slope={"grade": grade, "heading": heading}, **effects)


def parked(robot, duration=60.0, state=None, **options):
    """Held by all of its motors."""
    return rollout(robot, standstill(duration, motors=4), modes=Mode.PRESCRIBED, state=state, **options)


@pytest.mark.parametrize("integrator", ["rk4", "semi_implicit"])
@pytest.mark.parametrize("share", [0.3, 0.97])
@pytest.mark.parametrize("heading", [0.0, 1.1, math.pi / 2])
def test_a_rover_stands_on_any_slope_below_its_friction_angle(agriq, heading, share, integrator):
    robot = on_slope(agriq, math.atan(share * FRICTION), heading, stiction={"length": 0.005})
    result = parked(robot, integrator=integrator)
    assert result.status == Status.OK
    assert np.abs(result.pose - result.pose[0]).max() < 1e-4
    late = result.t > 30.0
    assert np.abs(np.diff(result.pose[late], axis=0)).max() < 1e-12
    creeping = parked(on_slope(agriq, math.atan(share * FRICTION), heading), 5.0, integrator=integrator)
    assert np.abs(creeping.pose - creeping.pose[0]).max() > 0.01


def braked_in_front(robot, duration=60.0, state=None, **options):
    """As rovers are driven: front motors hold, back ones are under eq. 30."""
    return rollout(robot, standstill(duration), state=state, **options)


@pytest.mark.parametrize(("integrator", "dt"), [("rk4", 1e-3), ("rk4", 2e-4), ("semi_implicit", 2.5e-3)])
@pytest.mark.parametrize("share", [0.3, 0.97])
@pytest.mark.parametrize("heading", [0.0, 1.1, math.pi / 2, 2.4, math.pi])
def test_a_rover_stands_where_front_motors_alone_hold(agriq, heading, share, integrator, dt):
    """What eq. 30 has the back motors do and what their wheels need differ: the loss in their gears holds the rest."""
    robot = on_slope(agriq, math.atan(share * FRICTION), heading, stiction={"length": 0.005})
    result = braked_in_front(robot, 60.0 if dt > 5e-4 else 10.0, integrator=integrator, dt=dt)
    assert result.status == Status.OK
    assert np.abs(result.pose - result.pose[0]).max() < 1e-5
    assert np.abs(np.diff(result.pose[result.t > 5.0], axis=0)).max() < 1e-12
    assert np.abs(np.diff(result.motor_torque[result.t > 5.0], axis=0)).max() < 1e-6


@pytest.mark.parametrize(("name", "kappa", "most"), [("epiq", 0.8, 0.7), ("epiq", 0.7, 0.844), ("agriq", 0.95, 0.848)])
def test_how_steep_a_slope_eq_30_and_the_gears_hold(name, kappa, most):
    """Back wheels hold (1/kappa − 1)/(eta_d eta_r) of what front ones do at most: on steeper ones these slide.

    The start, which has each wheel hold by its load, is not yet that of these torques: a tenth is left for the swing.
    """
    robot = load_robot(name).replace({"control.kappa": kappa})
    gear, (front, back) = robot.drive.front, (body.m + 4 * robot.wheel.m_w for body in robot.modules)
    held, mu = min((1.0 / kappa - 1.0) / (gear.eta_d * gear.eta_r), back / front), robot.contact.mu_s
    assert front * (1.0 + held) / (front + back) == pytest.approx(most, abs=5e-4)
    standing, sliding = (
        braked_in_front(on_slope(robot, math.atan(share * most * mu), math.pi, stiction={"length": 0.005}), 20.0)
        for share in (0.9, 1.02)
    )
    assert np.abs(standing.pose - standing.pose[0]).max() < 2e-4
    assert np.abs(np.diff(standing.pose[standing.t > 5.0], axis=0)).max() < 1e-9
    assert np.abs(sliding.pose - sliding.pose[0]).max() > 1.0


def test_a_train_stands_where_front_motors_alone_hold():
    """Its last module has no motors: the others hold it."""
    result = braked_in_front(on_slope(load_robot("train3"), 0.3, 0.0, stiction={"length": 0.005}))
    assert np.abs(result.q[:, :2] - result.q[0, :2]).max() < 1e-4
    assert np.abs(np.diff(result.q[result.t > 5.0, :2], axis=0)).max() < 1e-9


@pytest.mark.parametrize("integrator", ["rk4", "semi_implicit"])
@pytest.mark.parametrize(("grade", "heading"), [(0.3, 0.0), (0.3, math.pi), (0.2, 1.0)])
def test_a_rover_that_has_driven_comes_to_stand(agriq, grade, heading, integrator):
    """Motors that are held turn by what rounding leaves: their efficiency does not flip with the sign of that."""
    robot = on_slope(agriq, grade, heading, stiction={"length": 0.005})
    commands = front_commands(
        robot, lambda t: 0.3 * (ramp(t) - ramp(t - 4.0)), lambda t: 0.12 * (ramp(t) - ramp(t - 4.0)), 40.0
    )
    result = rollout(robot, commands, integrator=integrator)
    late = result.t > 8.0
    assert np.abs(result.pose[late] - result.pose[-1]).max() < 1e-6
    assert np.abs(np.diff(result.motor_torque[late], axis=0)).max() < 1e-3


def coming_to_rest(robot, rng):
    """Bristles that hold too little yet, and back wheels that turn a little."""
    start = initial_state(robot)
    v = start.v.copy()
    v[[14, 15]] = rng.normal(size=2)
    return dataclasses.replace(start, v=v, bristles=0.9 * start.bristles)


@pytest.mark.parametrize("integrator", ["rk4", "semi_implicit"])
def test_motors_that_their_gears_hold_stand_in_plain_steps_and_side_by_side_too(agriq, integrator):
    rng, duration = np.random.default_rng(2), 0.1
    slopes = [(0.1, 0.0), (0.3, 2.8), (0.5, 1.0), (0.4, -2.0), (0.2, math.pi)]
    robots = [on_slope(agriq, *slope, stiction={"length": 0.005}) for slope in slopes]
    starts, between = [coming_to_rest(robot, rng) for robot in robots], 0
    alone = [
        braked_in_front(robot, duration, state, integrator=integrator, dt=1e-3)
        for robot, state in zip(robots, starts, strict=True)
    ]
    together = rollout_batch(robots, standstill(duration), state=starts, integrator=integrator, dt=1e-3)
    for robot, start, one, other in zip(robots, starts, alone, together, strict=True):
        modes, kappa = MODES["as in the paper"], robot.control.kappa
        plain = plain_run(robot, start, standstill(duration), modes, kappa, integrator)
        end, last = one.final_state, other.final_state
        for found in (np.concatenate([end.q, end.v, end.eta]), np.concatenate([last.q, last.v, last.eta])):
            np.testing.assert_allclose(found, plain[:36], rtol=1e-7, atol=1e-9)
        between += int(((end.eta[2:] > 0.601) & (end.eta[2:] < 1.0 / 0.351)).sum())
    assert between > 5


@pytest.mark.parametrize("name", ["husky", "train3"])
def test_robots_of_any_number_of_modules_stand(name):
    robot = load_robot(name)
    robot = on_slope(robot, 0.15, 1.4, stiction={"length": 0.005})
    motors = len(robot.motors)
    result = rollout(robot, standstill(20.0, motors=motors), modes=(Mode.PRESCRIBED,) * motors)
    assert np.abs(result.q - result.q[0]).max() < 1e-4


@pytest.mark.parametrize("seed", [*range(18), 64, 105, 126])  # the last three once slid, their k_l 7 to 26 times k_t
def test_random_rovers_stand_on_random_slopes(seed):
    """Whatever they weigh and hold by, bent as they may be: what acts u_w ahead of the wheels does not turn them."""
    rng = np.random.default_rng(seed)
    plain = load_robot(("agriq", "epiq", "husky")[seed % 3])

    def factor(most):
        return float(most ** rng.uniform(-1.0, 1.0))

    mu = float(rng.uniform(0.2, 1.2))
    changes = {f"contact.{k}": factor(5.0) * getattr(plain.contact, k) for k in ("k_l", "k_t")}
    changes |= {"front.m": factor(2.0) * plain.front.m, "front.i_x": factor(1.4) * plain.front.i_x}
    changes |= {"contact.mu_s": mu, "contact.mu_d": mu * float(rng.uniform(0.5, 1.0))}
    grade = min(0.8, math.atan(float(rng.uniform(0.05, 0.99)) * mu))
    effects = {"stiction": {"length": 10.0 ** rng.uniform(-3.0, -1.0)}, "payload": {"mass": 0.2 * plain.front.m}}
    if seed % 2:
        effects["com_offset"] = {"x": 0.1 * plain.front.i_x, "y": -0.1 * plain.front.i_y}
    robot = on_slope(plain.replace(changes), grade, float(rng.uniform(-3.0, 3.0)), **effects)
    bend = float(rng.uniform(-0.8, 0.8)) if plain.articulated else 0.0
    start = initial_state(robot, yaw=float(rng.uniform(-3.0, 3.0)), articulation_yaw=bend)
    result = parked(robot, state=start, integrator="semi_implicit", every=100)
    assert result.status == Status.OK
    assert np.abs(result.pose - result.pose[0]).max() < 1e-4


def test_beyond_its_friction_angle_it_slides(agriq):
    result = parked(on_slope(agriq, math.atan(1.05 * FRICTION), math.pi / 2, stiction={"length": 0.005}), 2.0)
    assert result["y_f"][-1] > 1.0
    assert all(result[f"sat_{wheel}"][-1] == 1.0 for wheel in WHEELS)


@pytest.mark.parametrize("firmer", [1.0, 10.0])
def test_a_load_that_comes_at_once_is_held_after_a_swing(husky, firmer):
    """Bristles that are not bent yet: the rover gives by what they bend and let go meanwhile, and stands."""
    holding = husky.replace({"contact.k_t": firmer * husky.contact.k_t})
    robot = on_slope(holding, 0.2, math.pi / 2, stiction={"length": 0.005})
    unbent = dataclasses.replace(initial_state(robot), bristles=np.zeros(16))
    result = parked(robot, 5.0, unbent, integrator="semi_implicit", dt=1e-4)
    share, m = math.tan(0.2) / husky.contact.mu_s, husky.front.m + 4 * husky.wheel.m_w
    bend = m * 9.81 * math.sin(0.2) / 4 * TIME / holding.contact.k_t
    moved = (result["y_f"] - result["y_f"][0]) / bend
    let_go = -math.log(1.0 - share) / share  # of a load that grows without a swing; one that swings goes further
    if firmer * husky.contact.k_t * 4 / m * TIME >= 4.0:  # critically damped
        assert moved[-1] == pytest.approx(let_go, rel=0.005)
    else:
        most = moved.max() * bend
        limit = bend / share  # how far bristles are bent that hold all they can
        further = (most - limit * (-math.expm1(-most / limit) - share)) / bend
        assert let_go < further <= moved[-1] < moved.max()
    assert np.abs(moved[result.t > 1.0] - moved[-1]).max() < 1e-4


@kernel
def bends(stiff, k_l, k_t, slip_l, slip_t, narrow, friction, z_l, z_t):
    """How fast bristles bend now where rolling does not renew them."""
    return bending(stiff, 0.0, k_l, k_t, slip_l, slip_t, narrow, friction, z_l, z_t, None)


def test_any_small_slip_is_resisted():
    """However much stiffer bristles are one way than the other: or a rover that stands well below its limit slides.

    With one rate of release for both ways, slip along the stiff one lets go of more across it than it builds up.
    """
    rng = np.random.default_rng(6)
    for _ in range(2000):
        k, narrow = 10.0 ** rng.uniform(1.0, 4.0, 2), 10.0 ** rng.uniform(-0.5, 0.5)
        stiff, friction, slip = (
            1.0 / TIME,
            10.0 ** rng.uniform(0.0, 3.0),
            rng.normal(size=2) * 10.0 ** rng.uniform(-9, -3),
        )
        angle, used = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(0.0, 1.0)
        F = used * friction * np.array([math.cos(angle), math.sin(angle) / narrow])
        z = F / (stiff * k)
        rate = np.array(bends(stiff, *k, *slip, narrow, friction, *z))
        resisted, elastic = slip @ (stiff * k * rate), slip @ (stiff * k * slip)
        assert (1.0 - used) * elastic * (1.0 - 1e-9) <= resisted <= elastic * (1.0 + 1e-9)
        outward = (F * [1.0, narrow**2]) @ (stiff * k * rate) / friction  # the faster, the less is left of the limit
        assert outward <= (1.0 - used) * np.linalg.norm(stiff * k * slip) * max(1.0, narrow) * (1.0 + 1e-9) + 1e-12


def test_what_is_bent_does_not_wind_up_while_it_slides(agriq):
    """After metres of sliding bristles hold no more than friction does."""
    robot = on_slope(agriq, 0.7, 0.6, stiction={"length": 0.005})
    end = parked(robot, 2.0).final_state
    along, across = end.bristles.reshape(2, 8)
    force = np.hypot(along * agriq.contact.k_l, across * agriq.contact.k_t) / TIME
    loads = contact(params(robot), end.q, end.v, PlainEffects(robot.effects)).F_n
    assert np.hypot(*end.v[:2]) > 2.0
    assert (force <= FRICTION * loads * (1 + 1e-9)).all() and (force > 0.9 * FRICTION * loads).all()


def eight(robot, speed, size=1.5, **options):
    """Where a rover goes on an eight of two circles of `size` (m) at a `speed` (m/s), by the way of its plan (n, 3)."""
    around = 2.0 * math.pi * size
    way = np.linspace(0.2, 2.0 * around, 400)
    begin = 0.2 / speed if speed < 0.2 else 2.0 * speed  # so that it is fast enough where the way begins to bend

    def travelled(t):
        s = np.clip(t / begin, 0.0, 1.0)
        return speed * (begin * (s**3 - 0.5 * s**4) + np.maximum(t - begin, 0.0))

    def bent(t):
        to = travelled(t)
        return (ramp(to - 0.6, 0.8) - 2.0 * ramp(to - around + 0.4, 0.8)) / size

    end = float(way[-1] / speed + begin)
    commands = front_commands(robot, lambda t: speed * ramp(t, begin), lambda t: speed * ramp(t, begin) * bent(t), end)
    result = rollout(robot, commands, kappa=0.8, every=20, **options)
    assert result.status == Status.OK
    return np.column_stack([np.interp(way, travelled(result.t), column) for column in result.pose.T])


@pytest.mark.parametrize("alike", [True, False])
def test_an_eight_has_one_shape_at_every_speed(agriq, alike):
    """From 0.05 to 1 m/s, on ground as firm at 0.5 m/s as the paper's: what differs is inertia's, and grows as v².

    Also where it is as firm across wheels as along them, whose bristles turn no force of inertia aside.
    By eq. 15 alone turns cost force by speed, and a slow rover drives another eight.
    """
    holding = agriq.replace({"contact.mu_s": 5.0, "contact.mu_d": 5.0})
    if alike:
        holding = holding.replace({"contact.k_t": agriq.contact.k_l})
    length = 0.1
    softer = 1.0 / (1.0 + length / (TIME * 0.5))
    soil = {f"contact.{k}": softer * getattr(holding.contact, k) for k in ("k_l", "k_t")}
    bristled = with_effects(holding.replace(soil), stiction={"length": length})
    apart, before = (
        [np.abs(eight(robot, speed) - eight(robot, 0.05)).max() for speed in (0.2, 0.5, 1.0)]
        for robot in (bristled, holding)
    )
    assert apart[0] < 0.01
    assert apart[2] < 0.1 or not alike
    assert 2.5 < apart[2] / apart[1] < 4.5 and apart[0] < (0.25 if alike else 0.26) * apart[1]
    assert before[0] > 4 * apart[0] and before[2] < 2 * before[0]


@pytest.mark.parametrize("speed", [0.05, 0.2, 0.8])
def test_a_wheel_that_rolls_steadily_meets_stiffer_ground(agriq, speed):
    """The steady state of bristles that slip bends and rolling renews: for little slip k (1 + length/(T v)).

    That is the paper's k as the length goes to zero.
    """
    holding = agriq.replace({"contact.mu_s": 5.0, "contact.mu_d": 5.0})
    for length in (1e-4, 0.005, 0.05):
        robot = with_effects(holding, stiction={"length": length})
        commands = front_commands(robot, lambda t: speed * ramp(t), lambda t: 0.3 * speed * ramp(t - 1.0), 10.0)
        end = rollout(robot, commands, kappa=0.8, integrator="semi_implicit", dt=1e-3)
        for wheel in WHEELS[:4]:
            side = "r" if "_right_" in wheel else "l"
            rim = agriq.wheel.r_w * agriq.drive.front.tau * end[f"theta_f{side}_dot"][-1]
            p_y, F_t, slip = end[f"p_y_{wheel}"][-1], end[f"F_t_{wheel}"][-1], rim - end[f"p_x_{wheel}"][-1]
            k = np.array([agriq.contact.k_l, agriq.contact.k_t])
            pull = np.array([end[f"F_l_{wheel}"][-1], F_t]) - k * [slip, -p_y]  # of the bristles
            gives = np.linalg.norm(pull) / (5.0 * end[f"F_n_{wheel}"][-1]) * (pull @ (k * [slip, -p_y]))
            release = rim / length + gives / (TIME * pull @ (k * pull)) * k[1]
            assert end[f"sat_{wheel}"][-1] == 0.0
            assert F_t == pytest.approx(-k[1] * (1.0 + 1.0 / (TIME * release)) * p_y, rel=5e-3, abs=1e-3)
            if length < 1e-3 and speed > 0.1:
                assert F_t == pytest.approx(-agriq.contact.k_t * p_y, rel=0.15)


def test_energy_only_ever_leaves(agriq):
    """Whatever a wheel does: what its force takes out of the motion is stored in bristles, as 1/2 k/T z², or lost."""
    robot = with_effects(agriq, stiction={"length": 0.005})
    p, fx, rng = params(robot), PlainEffects(robot.effects), np.random.default_rng(4)
    k = np.array([agriq.contact.k_l, agriq.contact.k_t]) / TIME
    slid = 0
    for _ in range(300):
        q, v = initial_state(robot).q, rng.normal(size=16) * 10.0 ** rng.uniform(-4, -0.5)
        v[[2, 3, 4, 10, 11, 12]] = 0.0
        v[[6, 7, 14, 15]] *= 100.0
        bristles = rng.normal(size=(2, 8)) * 1e-4
        met = contact(p, q, v, fx, np.concatenate((np.zeros(16), bristles.ravel())))
        rims = np.repeat([0.2 * d.tau for d in (agriq.drive.front, agriq.drive.back) for _ in (0, 1)], 2)
        slip = rims * np.repeat(v[[6, 7, 14, 15]], 2) - met.p_x
        taken = met.F_l * slip - met.F_t * met.p_y
        stored = (k[:, None] * bristles * met.rate[:, 2:].T).sum(axis=0)
        assert (taken - stored >= -1e-9 * np.abs(taken).max()).all()
        slid += (met.held < 1).sum()
    assert 200 < slid < 2100


def test_a_push_and_back_leaves_less_than_it_brought(agriq):
    """A rover that is struck swings on its bristles and comes to rest: its energy never grows by itself."""
    robot = with_effects(agriq, stiction={"length": 0.005})
    start = initial_state(robot)
    v = start.v.copy()
    v[[1, 9]] = 0.02
    result = parked(robot, 3.0, dataclasses.replace(start, v=v), every=1)
    kinetic = (result.v[:, [0, 1, 8, 9]] ** 2).sum(axis=1)
    assert kinetic[-1] < 1e-16
    swings = kinetic[1:-1][(kinetic[1:-1] > kinetic[:-2]) & (kinetic[1:-1] >= kinetic[2:]) & (kinetic[1:-1] > 1e-20)]
    assert (np.diff(swings) < 0).all() and kinetic.argmax() == 0


def test_a_cut_rollout_goes_on_with_bent_bristles(agriq):
    robot = on_slope(agriq, 0.2, 0.5, stiction={"length": 0.005})
    whole = parked(robot, 0.2, dataclasses.replace(initial_state(robot), bristles=np.zeros(16)))
    half = parked(robot, 0.1, dataclasses.replace(initial_state(robot), bristles=np.zeros(16)))
    rest = parked(robot, 0.1, half.final_state)
    assert np.abs(half.final_state.bristles).max() > 1e-6
    np.testing.assert_array_equal(rest.q[-1], whole.q[-1])


@pytest.mark.parametrize("length", [1e-6, 1e-4, 1e-3, 0.1])
@pytest.mark.parametrize("robot", ["agriq", "epiq", "husky"])
def test_a_step_that_is_accepted_is_stable(request, robot, length):
    holding = request.getfixturevalue(robot).replace({"contact.mu_s": 5.0, "contact.mu_d": 5.0})
    robot = with_effects(holding, stiction={"length": length})
    commands = front_commands(robot, lambda t: 0.3 * ramp(t), lambda t: 0.2 * ramp(t - 2), 6.0)
    for integrator, dt in (("rk4", 1e-3), ("rk4", 5e-3), ("semi_implicit", 1e-3), ("semi_implicit", 5e-3)):
        try:
            result = rollout(robot, commands, integrator=integrator, dt=dt, every=1)
        except ArtibotError as error:
            assert integrator == "rk4" and (length < 1e-3 or dt > 2e-3), str(error)
            continue
        last = result["F_t_front_left_front"][-50:]
        assert result.status == Status.OK
        assert np.abs(np.diff(last)).max() < 1e-2 * max(np.abs(last).max(), 1e-3)
