"""What each effect does: nothing at its neutral value, and at severity 1 what its physics says."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from model.effects import LISTED, SEVERITY_1, stepped, with_effects
from model.helpers import energy_gap, from_knot, front_commands, ramp, standstill

from artibot_sim.diagnose.candidates.hypotheses import hypotheses
from artibot_sim.errors import ArtibotError
from artibot_sim.model import MOTORS, WHEELS, Commands, Mode, Robot, initial_state, load_robot, rollout, save_robot
from artibot_sim.model.effects import EFFECTS
from artibot_sim.model.equations.contact import LIGHT

CONTRACT = {*SEVERITY_1}
FRONT, BACK = WHEELS[:4], WHEELS[4:]


def turn(robot, speed=0.4, yaw_rate=0.3, duration=6.0, **options):
    commands = front_commands(robot, lambda t: speed * ramp(t), lambda t: yaw_rate * ramp(t - 1.5), duration)
    return rollout(robot, commands, **({"kappa": 0.8} | options))


@pytest.fixture(scope="module")
def plain(agriq):
    return turn(agriq)


@pytest.fixture(scope="module")
def straight(agriq):
    return turn(agriq, yaw_rate=0.0)


def total(result, name, wheels=WHEELS):
    return sum(result[f"{name}_{wheel}"] for wheel in wheels)


def test_every_effect_is_in_the_tests_table():
    assert {name for name, effect in EFFECTS.items() if effect.acts not in ("command", "sensor")} == CONTRACT


@pytest.mark.parametrize("name", sorted(CONTRACT))
def test_neutral_is_the_papers_model_to_the_bit(agriq, plain, name):
    """Also where the parameters that only say where or which are set."""
    values = SEVERITY_1[name] | {
        key: parameter.neutral for key, parameter in list(EFFECTS[name].parameters.items())[: EFFECTS[name].sizes]
    }
    result = turn(with_effects(agriq, **{name: values}))
    np.testing.assert_array_equal(result.q, plain.q)
    np.testing.assert_array_equal(result.row, plain.row)


@pytest.mark.parametrize(
    "name", sorted(CONTRACT - {"friction_patch", "joint_stop", "torque_limit", "soil_softening", "slip_ratio"})
)
def test_severity_1_is_plain_to_see(agriq, plain, name):
    result = turn(with_effects(agriq, name))
    moved = np.abs(result.pose - plain.pose).max()
    pulled = np.abs(result.motor_torque - plain.motor_torque).max()
    assert moved > 0.01 or pulled > 0.02, f"{name}: {moved:.2g} m or rad, {pulled:.2g} N m"


@pytest.mark.parametrize("name", ["none", *sorted(name for name in CONTRACT if not EFFECTS[name].hooks)])
def test_the_extended_kernel_is_the_papers_where_nothing_acts(agriq, name):
    """An effect that acts too little to be seen has the rest computed by the other kernel, to rounding."""
    tiny = {"joint_damping": {"coefficient": 1e-300}}
    values = {} if name == "none" else {name: SEVERITY_1[name]}
    np.testing.assert_allclose(
        turn(with_effects(agriq, **tiny, **values)).q, turn(with_effects(agriq, **values)).q, rtol=0, atol=1e-9
    )


def test_a_file_with_every_effect_is_read_as_it_was_written(agriq, tmp_path: Path):
    robot = with_effects(agriq, *SEVERITY_1)
    save_robot(robot, tmp_path / "extended.yaml")
    assert load_robot(tmp_path / "extended.yaml") == robot


@pytest.mark.parametrize(
    ("effects", "says"),
    [
        (
            {"motor_drag": {"torque": 0.1, "motor": "middle"}},
            "effects.motor_drag.motor: found 'middle', expected",
        ),
        ({"payload": {"mass": -1.0}}, "effects.payload.mass: -1 kg is out of bounds"),
        ({"joint_stop": {"angle": 0.0}}, "effects.joint_stop.angle: 0 rad is out of bounds"),
        ({"stribeck": {"velocity": float("inf")}}, "effects.stribeck.velocity: inf m/s is out of bounds"),
        ({"bulldozer": {}}, "effects.bulldozer: unknown effect, did you mean 'bulldozing'?"),
    ],
)
def test_a_bad_effect_is_refused(agriq, effects, says):
    with pytest.raises(ArtibotError) as caught:
        dataclasses.replace(agriq, effects=effects)
    assert str(caught.value).startswith(says)


@pytest.mark.parametrize(
    ("name", "integrator"),
    stepped(
        sorted({name for name in CONTRACT if EFFECTS[name].hooks} - {"joint_stiffness"}), ("rk4",), ("semi_implicit",)
    ),
)
def test_accounts_close_with_an_effect(agriq, name, integrator):
    """Energy put in by motors and the external force is stored or taken, the effects' part under its own name."""
    robot = with_effects(agriq, name)
    result = turn(robot, energy=True, dt=5e-4, integrator=integrator)
    put_in = sum(result[f"E_motor_{motor}"][-1] for motor in MOTORS)
    gap = energy_gap(robot, result) + 2 * result["E_push"]  # put in, where energy_gap takes it for taken
    assert np.abs(gap).max() < 2e-3 * put_in


def test_torque_limit_saturates_and_is_caught_up(agriq):
    limit = 0.2
    robot = with_effects(agriq, torque_limit={"front_max": limit})
    result = turn(robot, speed=0.8, yaw_rate=0.4)
    assert result.modes[:2] == (Mode.DRIVEN, Mode.DRIVEN)
    torque = result.motor_torque[:, :2]
    assert np.abs(torque).max() <= limit * (1 + 1e-12)
    assert (np.abs(torque) > 0.999 * limit).any()


LINE = {"stall": 0.5, "no_load_speed": 300.0, "supply": 0.8}
"""Of motors that come to 240 rad/s without a load, 1 m/s."""


@pytest.mark.parametrize("integrator", ["rk4", "semi_implicit"])
def test_the_torque_of_motors_on_a_sagging_battery_lies_on_their_line(agriq, integrator):
    """They are asked for more than they can and come to rest on it, slower than without a load."""
    result = turn(with_effects(agriq, battery_sag=LINE), speed=1.4, yaw_rate=0.2, integrator=integrator)
    assert result.modes[:2] == (Mode.DRIVEN, Mode.DRIVEN)
    speed, torque = result.v[:, 6:8], result.motor_torque[:, :2]
    line = LINE["stall"] * (LINE["supply"] - speed / LINE["no_load_speed"])
    assert (torque < line + (1e-9 if integrator == "rk4" else 0.02)).all()
    np.testing.assert_allclose(torque[-1], line[-1], rtol=0, atol=1e-9 if integrator == "rk4" else 1e-4)
    assert (speed[-1] < LINE["supply"] * LINE["no_load_speed"]).all() and (torque[-1] > 0.05).all()


def test_a_motor_that_brakes_has_its_torque_at_rest(agriq):
    """What a turning motor's voltage lets it lack while it drives it has more than enough of while it brakes."""
    speed = np.repeat([[0.6], [0.6], [-0.6]], [1, 50, 50], axis=0) / agriq.wheel.r_w / agriq.drive.front.tau
    robot = with_effects(agriq, battery_sag={"stall": 0.5, "no_load_speed": 200.0})
    result = rollout(robot, Commands(0.02, np.repeat(speed, 4, axis=1)))
    turning = result.v[:, 6]
    braking, driving = result.motor_torque[turning > 60.0, 0].min(), result.motor_torque[turning > 60.0, 0].max()
    assert braking == pytest.approx(-0.5, abs=1e-12) and 0.0 < driving < 0.5 * (1 - 60.0 / 200.0)


def test_a_battery_that_hardly_sags_leaves_the_papers_model(agriq, plain):
    robot = with_effects(agriq, battery_sag={"stall": 50.0, "no_load_speed": 1e6})
    assert np.abs(turn(robot).pose - plain.pose).max() < 1e-6


@pytest.mark.parametrize("integrator", ["rk4", "semi_implicit"])
def test_a_line_too_steep_for_the_step_is_refused(agriq, integrator):
    robot = with_effects(agriq, battery_sag={"stall": 5.0, "no_load_speed": 5.0})
    with pytest.raises(ArtibotError, match="battery_sag"):
        turn(robot, integrator=integrator, dt=1e-3)


def test_a_torque_limit_that_grows_leaves_the_papers_model(agriq, plain):
    """Whatever limit the robot has: it stands for a motor's, and prescribed motors have none."""
    worst = [np.abs(turn(with_effects(agriq, torque_limit={"front_max": m})).pose - plain.pose).max() for m in (2, 50)]
    assert max(worst) < 1e-6
    most = np.abs(turn(agriq, speed=0.8, yaw_rate=0.9).motor_torque[:, :2]).max()
    assert most > agriq.drive.front.torque_max
    free, held = (
        turn(with_effects(agriq, torque_limit={"front_max": share * most}), speed=0.8, yaw_rate=0.9)
        for share in (1.1, 0.99)
    )
    assert np.abs(free.pose - held.pose).max() < 0.05


@pytest.mark.parametrize("integrator", ["rk4", "semi_implicit"])
def test_drag_on_a_braking_motor_does_not_make_its_gear_chatter(agriq, integrator):
    """Downhill at steady speed: the wheels drive the gears, also where drag asks torque of the motor."""
    downhill = {"slope": {"grade": 0.1, "heading": 0.0}}
    free = turn(with_effects(agriq, **downhill), yaw_rate=0.0, integrator=integrator)
    drive, brake = agriq.drive.front, -free["M_m_front_right"][-1]
    assert brake > 0.0
    # more than the braking load on the motor with 1/eta_r, less than with eta_d, so that the torque's own sign flips
    drag = {"motor_drag": {"torque": brake * (1.0 + 1.0 / (drive.eta_d * drive.eta_r)) / 2.0, "motor": "front_right"}}
    result = turn(with_effects(agriq, **downhill, **drag), yaw_rate=0.0, integrator=integrator, energy=True, every=1)
    steady = result.t > 4.0
    assert (result["M_m_front_right"][steady] > 0.0).all()
    assert len(set(result["eta_front_right"][steady])) == 1
    assert np.ptp(result["M_m_front_right"][steady]) < 1e-3 * brake
    assert np.diff(result["E_gear_front_right"][steady]).min() > 0.0


def test_gear_efficiency_asks_more_of_the_motors(agriq, straight):
    worn = turn(with_effects(agriq, gear_efficiency={"scale": 0.8}), yaw_rate=0.0)
    front = slice(0, 2)
    np.testing.assert_allclose(worn.motor_torque[-1, front], straight.motor_torque[-1, front] / 0.8, rtol=1e-3)


@pytest.mark.parametrize("relative", [0.02, -0.02])
def test_larger_right_wheels_turn_left(agriq, relative):
    result = turn(with_effects(agriq, wheel_radius_mismatch={"relative": relative}), yaw_rate=0.0)
    assert np.sign(result["gamma_f"][-1]) == np.sign(relative)


@pytest.mark.parametrize("speed", [0.4, -0.4])
def test_motion_resistance_is_pulled_against_by_the_wheels(agriq, speed):
    free = turn(agriq, speed=speed, yaw_rate=0.0)
    held = turn(with_effects(agriq, motion_resistance={"force": 30.0}), speed=speed, yaw_rate=0.0)
    more = total(held, "F_l")[-1] - total(free, "F_l")[-1]
    assert more == pytest.approx(np.sign(speed) * 60.0, rel=1e-3)  # both modules are resisted


@pytest.mark.parametrize("speed", [0.4, -0.4])
def test_wheel_resistance_is_a_share_of_what_friction_holds(agriq, speed):
    share = 0.08
    free = turn(agriq, speed=speed, yaw_rate=0.0)
    held = turn(with_effects(agriq, wheel_resistance={"share": share}), speed=speed, yaw_rate=0.0)
    more = total(held, "F_l")[-1] - total(free, "F_l")[-1]
    assert more == pytest.approx(np.sign(speed) * share * agriq.contact.mu_s * total(held, "F_n")[-1], rel=1e-6)


@pytest.mark.parametrize("integrator", ["rk4", "semi_implicit"])
def test_wheel_resistance_points_against_each_wheel_s_motion(husky, integrator):
    """A rover that turns on the spot is held back at each wheel, sideways for the most part; no force is left over."""
    share = 0.1
    robot = with_effects(husky, wheel_resistance={"share": share})
    result = turn(robot, speed=0.0, yaw_rate=0.8, integrator=integrator)
    moment = np.zeros(len(result.t))
    for wheel in FRONT:
        x = 0.5 * husky.front.i_x * (1 if wheel.endswith("_front") else -1)
        y = 0.5 * husky.front.i_y * (1 if "left" in wheel else -1)
        p_x, p_y = result[f"p_x_{wheel}"], result[f"p_y_{wheel}"]
        force = share * husky.contact.mu_s * result[f"F_n_{wheel}"]
        moment -= force * (x * p_y - y * p_x) / np.maximum(np.hypot(p_x, p_y), 1e-9)
    turning = np.abs(result["gamma_f_dot"]) > 0.4
    assert turning.sum() > 100
    np.testing.assert_allclose(result["load_gamma_f"][turning], moment[turning], rtol=1e-6)
    assert np.abs(result["load_x_f"]).max() < 0.02 * np.abs(moment).max()


@pytest.mark.parametrize("name", ["wheel_resistance", "motion_resistance"])
@pytest.mark.parametrize("robot", ["agriq", "husky"])
def test_a_diagnosis_tries_the_grounds_resistance(request, robot, name):
    tried = hypotheses(request.getfixturevalue(robot), [])
    assert [len(one.probes) for one in tried if one.id == name] == [3]


def round_corners(robot, speed, **options):
    """Where a rover goes that drives a left and a right turn at a `speed` (m/s), by the way of its plan (n, 3)."""
    way = np.linspace(0.5, 4.0, 200)
    end = way[-1] / speed + 2.0

    def travelled(t):
        return speed * np.maximum(t - 1.0, 0.0)

    def curvature(t):
        return 0.35 * (ramp(travelled(t) - 0.5, 0.4) - 2.0 * ramp(travelled(t) - 2.0, 0.8))

    commands = front_commands(robot, lambda t: speed * ramp(t), lambda t: speed * curvature(t), end)
    result = rollout(robot, commands, integrator="semi_implicit", kappa=0.8, **options)
    assert not any(result[f"sat_{wheel}"].any() for wheel in WHEELS)
    return np.column_stack([np.interp(way, travelled(result.t), column) for column in result.pose.T])


def test_a_force_that_follows_the_slip_ratio_gives_one_path_at_every_speed(agriq):
    """At 0.05 and at 0.4 m/s; by eq. 15 rolling resistance needs as much slip speed, which costs a slow rover way."""
    holding = agriq.replace({"contact.mu_s": 5.0, "contact.mu_d": 5.0})
    ratio = with_effects(holding, slip_ratio={"exponent": 0.0})
    slow, fast = (round_corners(ratio, speed) for speed in (0.05, 0.4))
    plain_slow, plain_fast = (round_corners(holding, speed) for speed in (0.05, 0.4))
    apart, before = np.abs(slow - fast).max(), np.abs(plain_slow - plain_fast).max()
    assert apart < 0.005
    assert before > 5 * apart


def test_turning_costs_the_same_force_at_every_speed_by_the_slip_ratio(agriq):
    """On a circle of 3 m; by eq. 15 the force is ten times as large at ten times the speed."""

    def lateral(robot, speed):
        end = turn(robot, speed=speed, yaw_rate=speed / 3.0, duration=8.0, integrator="semi_implicit")
        return np.mean([abs(end[f"F_t_{wheel}"][-1]) for wheel in FRONT])

    holding = agriq.replace({"contact.mu_s": 5.0, "contact.mu_d": 5.0})
    ratio = with_effects(holding, slip_ratio={"exponent": 0.0})
    assert lateral(ratio, 0.5) == pytest.approx(lateral(ratio, 0.05), rel=0.1)
    assert lateral(holding, 0.5) > 8 * lateral(holding, 0.05)


def test_ground_stiffens_with_each_wheels_own_load(agriq):
    robot = with_effects(agriq, "com_offset", load_sensitivity={"exponent": 0.7})
    result = turn(robot, yaw_rate=0.2)
    mean = 9.81 * 87.0 / 8
    loads = set()
    for wheel in FRONT:
        held = result[f"sat_{wheel}"] == 0
        moves = np.abs(result[f"p_y_{wheel}"][held]) > 1e-3
        k_t = -result[f"F_t_{wheel}"][held] / np.where(moves, result[f"p_y_{wheel}"][held], np.inf)
        wanted = agriq.contact.k_t * (result[f"F_n_{wheel}"][held] / mean) ** 0.7
        assert moves.sum() > 50
        np.testing.assert_allclose(k_t[moves], wanted[moves], rtol=1e-9)
        loads.add(round(float(result[f"F_n_{wheel}"][-1])))
    assert len(loads) == 4


@pytest.mark.parametrize("ratio", [0.5, 1.6])
def test_friction_across_a_wheel_is_a_share_of_that_along_it(agriq, ratio):
    result = turn(with_effects(agriq, friction_anisotropy={"ratio": ratio}), speed=0.5, yaw_rate=0.9, duration=4.0)
    slid = 0
    for wheel in WHEELS:
        F_l, F_t = result[f"F_l_{wheel}"], result[f"F_t_{wheel}"] / ratio
        force, held = np.hypot(F_l, F_t) / result[f"F_n_{wheel}"], result[f"sat_{wheel}"] == 0
        assert force[held].max(initial=0.0) <= agriq.contact.mu_s * (1 + 1e-9)
        np.testing.assert_allclose(force[~held], agriq.contact.mu_d, rtol=1e-9)
        slid += (~held).sum()
    assert slid > 20


def test_a_push_from_behind_relieves_the_motors(agriq, straight):
    pushed = turn(with_effects(agriq, external_force={"force": 35.0, "heading": 0.0}), yaw_rate=0.0)
    less = total(straight, "F_l")[-1] - total(pushed, "F_l")[-1]
    assert less == pytest.approx(35.0, rel=1e-3)


def test_a_push_moves_free_wheels_by_newtons_law(agriq):
    """All of the rover and its wheels' inertia, before slip and rolling resistance know of it."""
    robot = with_effects(agriq.replace({"contact.u_w": 0.0}), external_force={"force": 35.0, "heading": 1.0})
    result = rollout(robot, standstill(0.01), modes=Mode.TORQUE, dt=1e-6, every=1, duration=1e-6)
    mass = agriq.front.m + 4 * agriq.wheel.m_w
    direction = np.array([result["x_f_ddot"][0], result["y_f_ddot"][0]])
    assert 0 < direction @ [np.cos(1.0), np.sin(1.0)] <= 35.0 / mass


@pytest.mark.parametrize("module", ["front", "back"])
def test_payload_weighs_on_its_own_wheels(agriq, straight, module):
    loaded = turn(with_effects(agriq, payload={"mass": 15.0, "module": module}), yaw_rate=0.0)
    own, other = (FRONT, BACK) if module == "front" else (BACK, FRONT)
    np.testing.assert_allclose(total(loaded, "F_n", own) - total(straight, "F_n", own), 15.0 * 9.81, rtol=1e-6)
    np.testing.assert_allclose(total(loaded, "F_n", other), total(straight, "F_n", other), rtol=1e-9)


def test_com_offset_loads_the_wheels_as_the_contract_says(agriq):
    x, y = 0.06, -0.04
    robot = with_effects(agriq, com_offset={"x": x, "y": y})
    result = rollout(robot, standstill(1.0))
    body = agriq.front
    quarter = (body.m + 4 * agriq.wheel.m_w) * 9.81 / 4
    for wheel in FRONT:
        end = 1 if wheel.endswith("_front") else -1
        side = 1 if "left" in wheel else -1
        load = quarter * (1 + end * 2 * x / body.i_x) * (1 + side * 2 * y / body.i_y)
        np.testing.assert_allclose(result[f"F_n_{wheel}"], load, rtol=1e-9)
    assert np.abs(result.q - result.q[0]).max() < 1e-10


@pytest.mark.parametrize("integrator", ["rk4", "semi_implicit"])
def test_com_offset_turns_what_is_pushed_at_the_origin(agriq, integrator):
    """Free of the ground's forces, a push at the origin turns the module about its centre of mass: J w' = −r × F."""
    soft = {"contact.k_l": 1e-9, "contact.k_t": 1e-9, "contact.u_w": 0.0}
    rigid = dataclasses.replace(agriq.replace(soft), back=None, drive=dataclasses.replace(agriq.drive, back=None))
    robot = with_effects(rigid, com_offset={"x": 0.0, "y": 0.2}, external_force={"force": 10.0, "heading": 0.0})
    result = rollout(robot, standstill(0.2), dt=1e-4, integrator=integrator, modes=Mode.PRESCRIBED)
    wheel, body = agriq.wheel, agriq.front
    J = body.J_z + 4 * wheel.J_wx + wheel.m_w * (body.i_x**2 + body.i_y**2)
    m = body.m + 4 * wheel.m_w
    assert result["gamma_f_ddot"][0] == pytest.approx(0.2 * 10.0 / J, rel=1e-9)
    centre = result["y_f"] + 0.2 * np.cos(result["gamma_f"])
    np.testing.assert_allclose(centre, 0.2, atol=1e-6)
    along = result["x_f"] - 0.2 * np.sin(result["gamma_f"])
    np.testing.assert_allclose(along[-1], 0.5 * 10.0 / m * 0.2**2, rtol=2e-3)


def test_friction_patch_acts_inside_alone(agriq, plain):
    far = turn(with_effects(agriq, friction_patch={"scale": 0.2, "x": 100.0, "y": 0.0, "radius": 5.0}))
    np.testing.assert_allclose(far.q, plain.q, rtol=0, atol=1e-9)
    patch = {"scale": 0.2, "x": 1.0, "y": 0.0, "radius": 0.5}
    result = turn(with_effects(agriq, friction_patch=patch), speed=0.4, yaw_rate=0.0, duration=8.0)
    held = result["F_n_front_left_front"] * agriq.contact.mu_s
    force = np.hypot(result["F_l_front_left_front"], result["F_t_front_left_front"])
    place = result["x_f"] + 0.5 * agriq.front.i_x
    inside = np.abs(place - 1.0) < np.sqrt(0.5**2 - (0.5 * agriq.front.i_y) ** 2) - 1e-6
    assert inside.any()
    assert (force[inside] <= 0.2 * held[inside] * (1 + 1e-9)).all()


def test_softening_soil_slips_more_with_time(agriq):
    soft = turn(with_effects(agriq, soil_softening={"rate": 0.05}), yaw_rate=0.0, duration=15.0)
    firm = turn(agriq, yaw_rate=0.0, duration=15.0)
    behind = firm["x_f"] - soft["x_f"]
    early, late = (np.searchsorted(soft.t, t) for t in (5.0, 14.0))
    assert 0 < behind[early] < 0.5 * behind[late]


def test_softening_goes_on_with_the_states_time(agriq):
    robot = with_effects(agriq, soil_softening={"rate": 0.05})
    commands = front_commands(robot, lambda t: 0.4 * ramp(t), lambda t: 0.2 * ramp(t - 1), 6.0)
    whole = rollout(robot, commands)
    half = rollout(robot, commands, duration=3.0)
    rest = rollout(robot, from_knot(commands, 300), state=half.final_state)
    np.testing.assert_allclose(rest.q[-1], whole.q[-1], rtol=0, atol=1e-11)


@pytest.mark.parametrize(
    ("effects", "integrator"),
    [(SEVERITY_1, "rk4"), (LISTED, "semi_implicit"), pytest.param(SEVERITY_1, "semi_implicit", marks=pytest.mark.long)],
    ids=["all-rk4", "listed-semi_implicit", "all-semi_implicit"],
)
def test_a_cut_rollout_goes_on_with_every_effect(agriq, effects, integrator):
    robot = with_effects(agriq, *effects)
    commands = front_commands(robot, lambda t: 0.4 * ramp(t), lambda t: 0.2 * ramp(t - 1), 4.0)
    whole = rollout(robot, commands, integrator=integrator)
    half = rollout(robot, commands, duration=2.0, integrator=integrator)
    rest = rollout(robot, from_knot(commands, 200), state=half.final_state, integrator=integrator)
    np.testing.assert_allclose(rest.q[-1], whole.q[-1], rtol=0, atol=1e-11)


def test_back_wheels_of_less_friction_slide_first(agriq):
    less = turn(with_effects(agriq, back_friction={"scale": 0.3}), yaw_rate=0.5, speed=0.5)
    for wheel in BACK:
        force = np.hypot(less[f"F_l_{wheel}"], less[f"F_t_{wheel}"])
        assert (force <= 0.3 * agriq.contact.mu_s * less[f"F_n_{wheel}"] * (1 + 1e-9)).all()


def test_stribeck_lies_between_holding_and_sliding(agriq):
    result = turn(with_effects(agriq, stribeck={"velocity": 0.08}), yaw_rate=0.6, speed=0.5)
    slid = 0
    for wheel in WHEELS:
        cut = result[f"sat_{wheel}"] == 1.0
        mu = np.hypot(result[f"F_l_{wheel}"], result[f"F_t_{wheel}"])[cut] / result[f"F_n_{wheel}"][cut]
        assert (mu <= agriq.contact.mu_s + 1e-9).all() and (mu >= agriq.contact.mu_d - 1e-9).all()
        slid += ((mu > agriq.contact.mu_d + 0.01) & (mu < agriq.contact.mu_s - 0.001)).sum()
    assert slid > 10


def test_stribeck_friction_falls_from_the_first_slip_on(agriq):
    """Eq. 15's force, or what the coefficient of that slip holds where this is less: without a drop in between."""
    velocity, c = 0.08, agriq.contact
    result = turn(with_effects(agriq, stribeck={"velocity": velocity, "early": 1.0}), yaw_rate=0.6, speed=0.5)
    slid = early = 0
    for wheel in WHEELS:
        module, drive = wheel.split("_")[0][0], getattr(agriq.drive, wheel.split("_")[0])
        motor = f"theta_{module}{'r' if '_right_' in wheel else 'l'}_dot"
        slip = agriq.wheel.r_w * drive.tau * result[motor] - result[f"p_x_{wheel}"]
        p_y, F_n, cut = (result[f"{name}_{wheel}"] for name in ("p_y", "F_n", "sat"))
        asked = np.hypot(c.k_l * slip, c.k_t * p_y)
        held = (c.mu_d + (c.mu_s - c.mu_d) * np.exp(-np.hypot(slip, p_y) / velocity)) * F_n
        force = np.hypot(result[f"F_l_{wheel}"], result[f"F_t_{wheel}"])
        np.testing.assert_allclose(force, np.minimum(asked, held), rtol=1e-9, atol=1e-9)
        np.testing.assert_array_equal(cut == 1.0, asked > held)
        slid += (cut == 1.0).sum()
        early += ((cut == 1.0) & (asked < c.mu_s * F_n)).sum()  # where the paper's wheel still holds
    assert slid > 10 and early > 10


def test_bulldozing_adds_to_what_eq_16_leaves(agriq):
    result = turn(with_effects(agriq, bulldozing={"coefficient": 900.0}))
    c, checked = agriq.contact, 0
    for wheel in WHEELS:
        hold = result[f"sat_{wheel}"] == 0.0
        p_y = result[f"p_y_{wheel}"][hold]
        np.testing.assert_allclose(
            result[f"F_t_{wheel}"][hold], -c.k_t * p_y - 900.0 * np.abs(p_y) * p_y, rtol=1e-9, atol=1e-9
        )
        checked += (np.abs(p_y) > 0.01).sum()
    assert checked > 100


def test_bulldozing_grows_with_the_load(agriq):
    """A wheel that carries more pushes more, in proportion; without that part all do alike, to the bit."""
    result = turn(with_effects(agriq, "com_offset", bulldozing={"coefficient": 400.0, "load": 3.0}))
    c, checked, loads = agriq.contact, 0, []
    for wheel in WHEELS:
        hold = result[f"sat_{wheel}"] == 0.0
        p_y, F_n = result[f"p_y_{wheel}"][hold], result[f"F_n_{wheel}"][hold]
        expected = -(400.0 + 3.0 * F_n) * np.abs(p_y) * p_y
        np.testing.assert_allclose(result[f"F_t_{wheel}"][hold] + c.k_t * p_y, expected, rtol=1e-9, atol=1e-9)
        checked, loads = checked + (np.abs(p_y) > 0.01).sum(), [*loads, F_n.mean()]
    assert checked > 100 and max(loads) > 1.2 * min(loads)
    alike, stated = (turn(with_effects(agriq, "com_offset", bulldozing={"coefficient": 900.0, **load}))
                     for load in ({}, {"load": 0.0}))  # fmt: skip
    for key in ("x_f", "F_t_front_right_front"):
        np.testing.assert_array_equal(alike[key], stated[key])


def test_relaxed_tyres_reach_the_same_force_later(agriq, plain):
    """Where nothing changes any more the force is eq. 15's; while it does, it lags."""
    robot = with_effects(agriq, tyre_relaxation={"length": 0.3})
    slow = front_commands(robot, lambda t: 0.3 * ramp(t), lambda t: 0.05 * ramp(t - 2), 14.0)
    result = rollout(robot, slow, kappa=0.8)
    for wheel in WHEELS:
        steady = -agriq.contact.k_t * result[f"p_y_{wheel}"]
        size = np.abs(steady).max()
        assert result[f"F_t_{wheel}"][-1] == pytest.approx(steady[-1], abs=0.02 * size)
        assert np.abs(result[f"F_t_{wheel}"] - steady).max() > 0.05 * size


def test_rolling_resistance_grows_with_speed(agriq):
    robot = with_effects(agriq, rolling_resistance_speed={"coefficient": 1.5})
    needed = {}
    for speed in (0.2, 0.6):
        for which in (agriq, robot):
            result = turn(which, speed=speed, yaw_rate=0.0)
            needed[speed, which is robot] = (
                result["M_r_front_left"][-1]
                - agriq.wheel.r_w * total(result, "F_l", ("front_left_front", "front_left_back"))[-1]
            )
    assert needed[0.6, False] == pytest.approx(needed[0.2, False], rel=1e-6)
    for speed in (0.2, 0.6):
        assert needed[speed, True] == pytest.approx((1 + 1.5 * speed) * needed[speed, False], rel=0.02)


def test_a_dragged_motor_needs_the_drag_on_top(agriq, straight):
    dragged = turn(with_effects(agriq, motor_drag={"torque": 0.25, "motor": "front_left"}), yaw_rate=0.0, kappa=1.0)
    free = turn(agriq, yaw_rate=0.0, kappa=1.0)
    more = dragged.motor_torque[-1] - free.motor_torque[-1]
    assert more[1] == pytest.approx(0.25, rel=0.02)
    assert np.abs(more[[0, 2, 3]]).max() < 0.01
    back = turn(with_effects(agriq, motor_drag={"torque": 0.25, "motor": "front_left"}), speed=-0.4, yaw_rate=0.0)
    assert (back["M_drag_front_left"][-100:] < 0).all()


@pytest.mark.parametrize("speed", [0.4, -0.4])
def test_every_gear_takes_its_no_load_torque(agriq, speed):
    """In a straight line, back motors under no torque: front ones pull their gears along, which brake through eta_r."""
    loaded, free = (
        turn(robot, speed=speed, yaw_rate=0.0, kappa=1.0)
        for robot in (with_effects(agriq, gear_no_load={"torque": 0.1}), agriq)
    )
    np.testing.assert_allclose(total(loaded, "M_drag", MOTORS)[-100:], np.sign(speed) * 0.4, rtol=1e-9)
    front, back = agriq.drive.front, agriq.drive.back
    pulled = 0.1 / (back.tau * back.eta_r) * front.tau / front.eta_d
    more = np.sign(speed) * (loaded.motor_torque[-1] - free.motor_torque[-1])
    np.testing.assert_allclose(more[:2], 0.1 + pulled, rtol=1e-3)


def test_a_gear_takes_no_torque_at_rest_and_the_same_at_every_speed(agriq):
    robot = with_effects(agriq, gear_no_load={"torque": 0.1})
    result = turn(robot, speed=0.6, yaw_rate=0.0)
    drag, speed = result["M_drag_front_left"], np.abs(result["theta_fl_dot"])
    assert abs(drag[0]) < 1e-12
    np.testing.assert_allclose(drag[speed > 40.0], 0.1, rtol=1e-6)


@pytest.mark.parametrize("name", ["joint_friction", "joint_damping", "joint_stiffness"])
def test_a_stiff_articulation_bends_less_or_later(agriq, plain, name):
    result = turn(with_effects(agriq, name))
    early = plain.t < 4.0
    bent, free = (np.abs(r.articulation_yaw[early]) for r in (result, plain))
    assert (bent <= free + 1e-6).all() and bent.sum() < 0.99 * free.sum()


def test_torques_in_the_joint_are_what_they_say(agriq):
    sizes = {"joint_friction": 10.0, "joint_damping": 30.0, "joint_stiffness": 25.0}
    result = turn(with_effects(agriq, *sizes))
    angle, rate = result.articulation_yaw, result["gamma_b_dot"] - result["gamma_f_dot"]
    np.testing.assert_allclose(result["M_joint"], 10 * np.tanh(rate / 0.01) + 30 * rate + 25 * angle, atol=1e-9)


@pytest.mark.parametrize("integrator", ["rk4", "semi_implicit"])
def test_the_stop_stops(agriq, integrator):
    result = turn(with_effects(agriq, joint_stop={"angle": 0.2}), yaw_rate=0.4, duration=10.0, integrator=integrator)
    free = turn(agriq, yaw_rate=0.4, duration=10.0, integrator=integrator)
    assert np.abs(free.articulation_yaw).max() > 0.3
    assert np.abs(result.articulation_yaw).max() < 0.23
    pushes = result["M_joint"] * result.articulation_yaw
    assert (pushes >= 0).all() and pushes.max() > 0


def test_friction_in_the_joint_stops_a_swing_and_does_not_turn_it(agriq):
    """A strong friction at a long step: the semi-implicit step brings the joint to rest, it does not shake."""
    robot = with_effects(agriq, joint_friction={"torque": 300.0})
    start = initial_state(robot, articulation_yaw=0.3)
    v = start.v.copy()
    rate, yaw, l_b = 0.5, start.q[13], agriq.back.l
    v[[8, 9, 13]] = l_b * rate * np.sin(yaw), -l_b * rate * np.cos(yaw), rate  # the back module swings about the joint
    result = rollout(
        robot, standstill(1.0), dt=5e-3, integrator="semi_implicit", every=1, state=dataclasses.replace(start, v=v)
    )
    rate = result["gamma_b_dot"] - result["gamma_f_dot"]
    assert np.abs(rate[-20:]).max() < 1e-3
    assert (np.diff(np.sign(rate[np.abs(rate) > 1e-3])) == 0).all()


def test_joint_effects_are_nothing_to_a_rigid_robot(husky: Robot):
    robot = with_effects(husky, "joint_friction", "joint_damping", "joint_stiffness", "joint_stop")
    np.testing.assert_allclose(turn(robot).q, turn(husky).q, rtol=0, atol=1e-9)


def tilted(robot, result, pitching):
    """What loads and forces of a level rover's first module miss of the balance about its centre of mass.

    Moments in roll and in pitch (n,), N m; and what the loads miss of the module's weight, N.
    """
    height, body = robot.effects["com_height"]["height"], robot.front
    F_n = np.array([result[f"F_n_{wheel}"] for wheel in FRONT])
    x = 0.5 * body.i_x * np.array([1 if wheel.endswith("_front") else -1 for wheel in FRONT])
    y = 0.5 * body.i_y * np.array([1 if "left" in wheel else -1 for wheel in FRONT])
    s, c = np.sin(result["gamma_f"]), np.cos(result["gamma_f"])
    along = total(result, "F_l", FRONT) + c * result["load_x_f"] + s * result["load_y_f"]
    across = total(result, "F_t", FRONT) + c * result["load_y_f"] - s * result["load_x_f"]
    roll, pitch = y @ F_n + height * across, x @ F_n + pitching * height * along
    return roll, pitch, F_n.sum(axis=0) - 9.81 * (body.m + 4 * robot.wheel.m_w)


@pytest.mark.parametrize("integrator", ["rk4", "semi_implicit"])
@pytest.mark.parametrize(("name", "pitching"), [("agriq", False), ("husky", True)])
def test_moved_loads_balance_the_moment_of_the_grounds_forces(request, name, pitching, integrator):
    """Also while wheels break away, whose friction drops then."""
    robot = with_effects(request.getfixturevalue(name), "wheel_resistance", com_height={"height": 0.25})
    result = turn(robot, speed=0.8, yaw_rate=0.5, integrator=integrator)
    roll, pitch, weight = tilted(robot, result, pitching)
    slides = np.any([result[f"sat_{wheel}"] for wheel in FRONT], axis=0)
    assert slides.any() and not slides.all() and np.ptp(result[f"F_n_{FRONT[0]}"]) > 5.0
    assert np.abs(weight).max() < 1e-6
    if integrator == "rk4":  # the other one's forces are those at the end of a step, loads of its start
        assert max(np.abs(roll).max(), np.abs(pitch).max()) < 1e-9
    else:
        assert np.median(np.abs(roll)) < 0.02 and np.median(np.abs(pitch)) < 0.02


def test_paths_under_moving_loads_converge_alike_with_both_integrators(husky):
    robot = with_effects(husky, com_height={"height": 0.3})

    def end(integrator, dt):
        result = turn(robot, speed=0.8, yaw_rate=0.8, duration=4.0, integrator=integrator, dt=dt)
        return np.array([result["x_f"][-1], result["y_f"][-1]])

    finest = end("rk4", 1e-4)
    coarse, fine = (np.linalg.norm(end("semi_implicit", dt) - finest) for dt in (1e-3, 2.5e-4))
    assert fine < 0.4 * coarse and fine < 1e-3
    assert np.linalg.norm(end("rk4", 1e-3) - finest) < 1e-3


def test_a_centre_above_the_ground_loads_the_outer_wheels_and_those_behind(husky):
    robot = with_effects(husky, com_height={"height": 0.3})
    left = turn(robot, speed=0.8, yaw_rate=0.4)
    assert total(left, "F_n", FRONT[:2])[-1] > total(left, "F_n", FRONT[2:])[-1] + 1.0  # right wheels in a left turn
    gaining = turn(robot, speed=0.8, yaw_rate=0.0)
    middle = len(gaining.t) // 6  # 1 s into the ramp of 2 s
    behind = total(gaining, "F_n", [wheel for wheel in FRONT if wheel.endswith("_back")])
    weight = total(gaining, "F_n", FRONT)
    mass = weight[middle] / 9.81
    expected = mass * gaining["x_f_ddot"][middle] * 0.3 / robot.front.i_x
    assert behind[middle] - 0.5 * weight[middle] == pytest.approx(expected, rel=1e-3)
    rocker = turn(dataclasses.replace(robot, suspension="rocker"), speed=0.8, yaw_rate=0.0)
    assert np.ptp([rocker[f"F_n_{wheel}"] for wheel in FRONT]) < 1e-6


def test_a_rover_across_a_slope_leans_on_its_lower_wheels(husky):
    """With the centre at h and a track b the load that moves is m g sin(grade) h/b."""
    grade = 0.15
    robot = with_effects(husky, com_height={"height": 0.4}, slope={"grade": grade, "heading": np.pi / 2})
    result = rollout(robot, standstill(3.0))
    lower = total(result, "F_n", FRONT[2:])[-1]  # downhill is to the left
    mass = robot.front.m + 4 * robot.wheel.m_w
    expected = 9.81 * mass * (0.5 * np.cos(grade) + np.sin(grade) * 0.4 / robot.front.i_y)
    assert lower == pytest.approx(expected, rel=1e-4)


def test_loads_move_in_a_mirror_as_they_do_here(agriq):
    robot = with_effects(agriq, "com_height", "load_sensitivity")
    left, right = turn(robot, yaw_rate=0.3), turn(robot, yaw_rate=-0.3)
    for wheel in FRONT:
        other = wheel.replace("right", "LEFT").replace("left", "right").replace("LEFT", "left")
        np.testing.assert_allclose(left[f"F_n_{wheel}"], right[f"F_n_{other}"], rtol=0, atol=1e-7)


def test_no_wheel_pulls_at_the_ground_however_high_the_centre(husky):
    robot = with_effects(husky, com_height={"height": 2.5})
    result = turn(robot, speed=1.5, yaw_rate=0.9)
    loads = np.array([result[f"F_n_{wheel}"] for wheel in FRONT])
    assert 0.0 < loads.min() <= LIGHT and loads.max() > 100.0
    np.testing.assert_allclose(loads.sum(axis=0), loads.sum(axis=0)[0], rtol=1e-9)
