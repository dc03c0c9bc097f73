"""Motors of a robot file are the effects of the same numbers, which stand; and velocity loops with an integral."""

from __future__ import annotations

import numpy as np
import pytest
from model.effects import with_effects
from model.helpers import energy_gap, from_knot, front_commands, observed_order, ramp, smooth_robot

from artibot_sim.errors import ArtibotError
from artibot_sim.model import Commands, Mode, load_robot, rollout, save_robot
from artibot_sim.model.analysis.stability import largest_step
from artibot_sim.model.effects import EFFECTS
from artibot_sim.model.equations.transmission import drives_next
from artibot_sim.model.kernels.compilation import kernel
from artibot_sim.model.robot.derived import params
from artibot_sim.model.robot.file import robot_from_dict, robot_to_dict
from artibot_sim.model.robot.robot import MOTOR_EFFECTS, Motor
from artibot_sim.model.simulate.sensors import sensor_errors

OWN = {
    "motor.stall_torque": 0.9, "motor.no_load_speed": 320.0, "motor.supply": 0.9, "motor.no_load_torque": 0.05,
    "motor.velocity_filter": 0.03, "motor.loop_gain": 0.05, "motor.loop_integral": 6.0, "motor.loop_windup": 0.4,
}  # fmt: skip
SAME = {
    "battery_sag": {"stall": 0.9, "no_load_speed": 320.0, "supply": 0.9}, "gear_no_load": {"torque": 0.05},
    "velocity_filter": {"time_constant": 0.03}, "velocity_loop": {"gain": 0.05, "integral": 6.0, "windup": 0.4},
}  # fmt: skip


def turn(robot, speed=0.6, yaw_rate=0.3, duration=4.0, **options):
    commands = front_commands(robot, lambda t: speed * ramp(t), lambda t: yaw_rate * ramp(t - 1.5), duration)
    return rollout(robot, commands, **options)


def test_a_robot_that_says_nothing_of_its_motors_has_no_effect_of_theirs(agriq):
    assert agriq.motor == Motor() and not agriq.effects and "motor" not in robot_to_dict(agriq)


@pytest.mark.parametrize("name", ["agriq", "husky", "train3"])
def test_a_robots_own_motors_are_the_effects_of_the_same_numbers_to_the_bit(name):
    robot = load_robot(name)
    own, same = robot.replace(OWN), with_effects(robot, **SAME)
    assert own.effects == same.effects and own != same
    driven = turn(own)
    assert driven.modes[0] is Mode.DRIVEN
    np.testing.assert_array_equal(driven.row, turn(same).row)
    assert sensor_errors(own) == sensor_errors(same)


def test_an_effect_by_name_goes_before_the_robots_own_number_and_leaves_the_others(agriq):
    low = with_effects(agriq.replace(OWN), battery_sag={"supply": 0.6})
    assert low.effects["battery_sag"] == SAME["battery_sag"] | {"supply": 0.6}
    assert low.effects["gear_no_load"] == SAME["gear_no_load"] and set(low.effects_beside) == {"battery_sag"}
    assert not with_effects(agriq.replace(OWN), gear_no_load={"torque": 0.0}).effects["gear_no_load"]["torque"]
    stronger = low.replace({"motor.stall_torque": 1.2})  # what stands follows, what was said stays
    assert stronger.effects["battery_sag"] == {"stall": 1.2, "no_load_speed": 320.0, "supply": 0.6}


def test_motors_and_what_effects_change_of_them_survive_a_round_trip(agriq, tmp_path):
    robot = agriq.replace(OWN, source="datasheet: a motor").replace({"effects.battery_sag.supply": 0.7})
    save_robot(robot, tmp_path / "copy.yaml")
    document = robot_to_dict(robot)
    assert set(document["effects"]) == {"battery_sag"} and set(document["effects"]["battery_sag"]) == {"supply"}
    assert load_robot(tmp_path / "copy.yaml") == robot == robot_from_dict(document)
    assert robot.sources["motor.no_load_speed"] == "datasheet: a motor"


def test_every_number_of_a_motor_is_one_of_an_effect_and_neutral_with_it():
    for key, (effect, parameter) in MOTOR_EFFECTS.items():
        assert getattr(Motor(), key.removeprefix("motor.")) == EFFECTS[effect].parameters[parameter].neutral


@pytest.mark.parametrize(
    ("entries", "says"),
    [
        ({"no_load_speed": {"value": 300.0, "unit": "rad/s", "source": "stated"}}, "motor.stall_torque"),
        ({"stall_torque": {"value": 0.0, "unit": "N m", "source": "stated"}}, "motor.stall_torque"),
        ({"stall_torque": {"value": 1.0, "unit": "N", "source": "stated"}}, "motor.stall_torque.unit"),
        ({"no_load_torque": 0.1}, "motor.no_load_torque"),
        ({"stal_torque": {"value": 1.0, "unit": "N m", "source": "stated"}}, "did you mean 'stall_torque'"),
    ],
)
def test_what_cannot_be_a_motor_is_refused_with_the_keys_path(agriq, entries, says):
    with pytest.raises(ArtibotError, match=says):
        robot_from_dict(robot_to_dict(agriq) | {"motor": entries})


def test_a_line_too_steep_for_the_step_names_the_motor(agriq):
    steep = agriq.replace({"motor.stall_torque": 5.0, "motor.no_load_speed": 5.0})
    with pytest.raises(ArtibotError, match=r"torque-speed line.*with (half of motor.stall|twice motor.no_load)"):
        turn(steep, integrator="rk4", dt=1e-3)


# ----------------------------------------------------------------------
# Velocity loops. In a straight line with back motors under no torque a front motor's load hardly knows its speed.
# ----------------------------------------------------------------------

GAIN, INTEGRAL = 0.06, 8.0


def looped(robot, integral=INTEGRAL, windup=float("inf"), gain=GAIN):
    return with_effects(robot, velocity_loop={"gain": gain, "integral": integral, "windup": windup})


def straight(robot, **options):
    commands = front_commands(robot, lambda t: 0.5 * ramp(t, 1.0), lambda t: 0.0 * t, 6.0)
    return rollout(robot, commands, kappa=1.0, **options)


@pytest.fixture(scope="module")
def prescribed(agriq):
    return straight(agriq)


def lag(result, prescribed):
    """How much slower the front motors are than planned at the end, rad/s."""
    return (prescribed.v - result.v)[-1, 6:8]


@pytest.mark.parametrize(("integral", "windup"), [(0.0, float("inf")), (INTEGRAL, 0.05)])
def test_a_loop_without_enough_integral_lags_by_what_is_left_of_the_load_over_its_gain(
    agriq, prescribed, integral, windup
):
    result = straight(looped(agriq, integral, windup))
    load = prescribed.motor_torque[-1, :2]
    left = load - (windup if integral else 0.0)
    np.testing.assert_allclose(lag(result, prescribed), left / GAIN, rtol=1e-6)
    assert (left > 0.05).all()


def test_an_integral_holds_the_speed_under_a_constant_load(agriq, prescribed):
    result = straight(looped(agriq))
    assert np.abs(lag(result, prescribed)).max() < 1e-6
    assert result.final_state is not None
    held = GAIN * INTEGRAL * result.final_state.behind[:2]
    np.testing.assert_allclose(held, prescribed.motor_torque[-1, :2], rtol=1e-6)  # all of the load


def test_a_loop_that_grows_stiff_leaves_the_papers_prescribed_motion(agriq, prescribed):
    runs = [straight(looped(agriq, gain=g), dt=5e-4, every=20) for g in (0.06, 0.24)]
    apart = [np.abs(run.v - prescribed.v)[:, 6].max() for run in runs]
    assert apart[1] < apart[0] / 3.0


def stalled(robot):
    """Motors too weak to come to 1.2 m/s in 2 s, then asked for a third of it."""
    speed = np.full((400, 4), np.nan)
    speed[:, :2] = (np.where(np.arange(400) < 200, 1.2, 0.4) / robot.wheel.r_w / robot.drive.front.tau)[:, None]
    return rollout(with_effects(robot, torque_limit={"front_max": 0.3}), Commands(0.01, speed), kappa=1.0)


def test_a_windup_limit_bounds_what_is_left_of_a_stall(agriq, prescribed):
    """The error that holds load and integral part in balance is all that can be left; without a limit the stall is."""
    windup, asked = 0.2, 0.4 / agriq.wheel.r_w / agriq.drive.front.tau
    bounded, free = (stalled(looped(agriq, windup=w)) for w in (windup, float("inf")))
    at_most = (windup + prescribed.motor_torque[-1, 0]) / GAIN
    late = bounded.t > 3.5
    over, without = (np.abs(run.v[late, 6] - asked).max() for run in (bounded, free))
    assert over < at_most * (1 + 1e-6) and without > 10.0 * at_most
    assert np.abs(GAIN * INTEGRAL * bounded.final_state.behind).max() <= windup * (1 + 1e-9)


def swerving(robot, **options):
    commands = front_commands(robot, lambda t: 0.5 * ramp(t, 1.0), lambda t: 0.3 * np.sin(1.5 * t) * ramp(t), 3.0)
    return rollout(robot, commands, **options)


@pytest.mark.parametrize("integrator", ["rk4", "semi_implicit"])
def test_energy_is_accounted_for_with_a_velocity_loop(agriq, integrator):
    result = swerving(looped(agriq, windup=0.2), energy=True, integrator=integrator)
    put_in = result["E_motor_front_right"] + result["E_motor_front_left"]
    assert np.abs(energy_gap(agriq, result)).max() < 2e-3 * put_in[-1]


def test_steps_converge_with_an_integral(agriq):
    """From under way on, where nothing switches: at rest the sign of rolling resistance does."""
    robot = looped(smooth_robot(agriq))
    commands = front_commands(
        robot, lambda t: (0.5 + 0.1 * np.sin(3 * t)) * ramp(t), lambda t: 0.15 * np.sin(2 * t) * ramp(t), 5.0, 0.02
    )
    state = rollout(robot, commands, kappa=1.0, duration=4.0).final_state
    steps = np.array([2e-3, 1e-3, 5e-4])
    ends = [
        rollout(robot, from_knot(commands, 200), dt=dt, kappa=1.0, state=state, integrator="rk4").final_state
        for dt in (*steps, 1.25e-4)
    ]
    assert observed_order([np.abs(end.q - ends[-1].q).max() for end in ends[:-1]], steps) > 3.5


def test_a_rollout_that_goes_on_has_its_integral_to_the_bit(agriq):
    robot = looped(agriq, windup=0.1)
    commands = front_commands(robot, lambda t: 0.5 * ramp(t, 1.0), lambda t: 0.3 * ramp(t), 2.0)
    whole = rollout(robot, commands)
    half = rollout(robot, commands, duration=1.0)
    rest = rollout(robot, from_knot(commands, 100), state=half.final_state)
    assert np.abs(half.final_state.behind[:2]).min() > 0.0
    for part in ("q", "v", "behind"):
        np.testing.assert_array_equal(getattr(rest.final_state, part), getattr(whole.final_state, part))


@pytest.mark.parametrize("integrator", ["rk4", "semi_implicit"])
@pytest.mark.parametrize(("gain", "integral"), [(2.0, 0.0), (0.5, 5e4)])
def test_a_loop_too_stiff_for_the_step_is_refused(agriq, integrator, gain, integral):
    modes = (Mode.DRIVEN,) * 2 + (Mode.TORQUE,) * 2
    stiff, soft = (largest_step(params(looped(agriq, integral, gain=g)), integrator, modes)[0] for g in (gain, 1e-3))
    assert stiff < soft
    with pytest.raises(ArtibotError, match=r"without effects.velocity_loop"):
        straight(looped(agriq, integral, gain=gain), integrator=integrator, dt=2e-3)


def test_steps_up_to_the_longest_allowed_do_not_grow(agriq):
    """Of a loop that sets the limit, wheels that slide included: with hardly any friction nothing else brakes them."""
    slippery = agriq.replace({"contact.mu_s": 0.02, "contact.mu_d": 0.02})
    robot = looped(slippery, integral=2000.0, gain=0.5)
    modes = (Mode.DRIVEN,) * 2 + (Mode.TORQUE,) * 2
    longest, _ = largest_step(params(robot), "rk4", modes)
    h = 1e-2 / np.ceil(1e-2 / longest)
    run, fine = (straight(robot, dt=dt, integrator="rk4").final_state for dt in (h, h / 4))
    assert np.abs(run.v - fine.v)[6:8].max() < 0.5


@kernel
def drives_then(M_gear, theta_dot, rotor, inverse_eta, inverse_eta_d, eta_r, measured):
    return drives_next(M_gear, theta_dot, rotor, inverse_eta, inverse_eta_d, eta_r, measured)


def test_a_measured_torque_settles_the_efficiency_whichever_a_motor_had():
    """Of random rotors, gears, loads and rotations: whichever efficiency agrees with the torque that it gives is found.

    From either efficiency, with noise of less than half of what lies between the torques of both. Without a measured
    torque a motor keeps the one that it has as long as that agrees: eq. 23 as the paper has it.
    """
    rng, open_cases = np.random.default_rng(1), 0
    for _ in range(2000):
        eta_d, eta_r = rng.uniform(0.3, 1.0, 2)
        rotor, wheels, speed = rng.normal(size=3)
        torques = {True: rotor + wheels / eta_d, False: rotor + wheels * eta_r}
        inverse = {True: 1.0 / eta_d, False: eta_r}
        agree = [drives for drives in torques if (torques[drives] * speed >= 0.0) == drives]
        open_cases += len(agree) == 2
        noise = 0.49 * rng.uniform(-1.0, 1.0) * abs(torques[True] - torques[False])
        for had in torques:
            given = (torques[had], speed, rotor, inverse[had], 1.0 / eta_d, eta_r)
            for true in agree:
                assert drives_then(*given, torques[true] + noise) == true
            assert drives_then(*given, np.nan) == (torques[had] * speed >= 0.0)
    assert open_cases > 50
