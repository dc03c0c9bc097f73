"""The command view: effects between commands and motors are found, distinguished, and not seen in clean data."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bag_helpers import foreign

from artibot_sim.diagnose.commands.data import H, command_data
from artibot_sim.diagnose.commands.fit import EFFECTS, NEEDED
from artibot_sim.diagnose.commands.model import CommandResponse, followed, predicted_speeds
from artibot_sim.diagnose.commands.view import CommandView, command_view, view_with
from artibot_sim.diagnose.policy import THRESHOLDS
from artibot_sim.diagnose.selection.evidence import others
from artibot_sim.diagnose.selection.naming import best_of
from artibot_sim.experiment import Experiment, read_bag
from artibot_sim.identify.synthetic import Noise, random_manoeuvre, random_soil, synthetic
from artibot_sim.model import Commands, Robot, load_robot
from artibot_sim.model.simulate.commands import as_executed
from artibot_sim.planning import Arc, Dwell, Manoeuvre, Ramp, Straight

AGRIQ = load_robot("agriq")
HIDDEN = {
    "command_rate_limit": {"rate": 60.0},
    "torque_limit": {"front_max": 0.4},
    "battery_sag": {"stall": 0.6, "no_load_speed": 250.0},
    "speed_loop_lag": {"time_constant": 0.1},
    "command_delay": {"delay": 0.06},
    "deadband": {"threshold": 25.0},
    "encoder_scale": {"scale": 0.99},
    "torque_scale": {"scale": 1.07},
}
LOOP = ("gain", "integral", "windup")
SENSORS = {
    "fine": Noise(),
    "jitter": Noise(jitter=0.001),
    "slow": Noise(command_rate=50.0, motor_rate=33.0),
    "sparse": Noise(command_rate=20.0),
}


def robot_with(**effects: dict) -> Robot:
    return replace(AGRIQ, effects=effects)


def driven(robot: Robot, seed: int = 0, sensors: str = "fine", duration: float = 15.0) -> list[Experiment]:
    """Two recordings on a soil of their own."""
    rng = np.random.default_rng(seed)
    real = random_soil(robot, rng)
    return [
        synthetic(
            real, random_manoeuvre(rng, duration), duration=duration, kappa=kappa, seed=10 * seed + k,
            noise=SENSORS[sensors], name=f"run{k}",
        )
        for k, kappa in enumerate((0.8, 0.65))
    ]  # fmt: skip


@pytest.mark.parametrize("delay", [0.0, 0.137])
@pytest.mark.parametrize("lag", [0.0, 0.21])
@pytest.mark.parametrize("threshold", [0.0, 30.0])
@pytest.mark.parametrize("rate", [np.inf, 50.0])
def test_the_way_is_the_models_own(delay: float, lag: float, threshold: float, rate: float) -> None:
    t = H * np.arange(1200)
    speed = 80.0 * np.sin(t) * np.clip(t, 0, 1)
    robot = robot_with(
        command_delay={"delay": delay}, speed_loop_lag={"time_constant": lag}, deadband={"threshold": threshold},
        command_rate_limit={"rate": rate},
    )  # fmt: skip
    velocity = np.full((len(t), 4), np.nan)
    velocity[:, :2] = speed[:, None]
    expected = as_executed(robot, Commands(H, velocity)).velocity[:, 0]
    found = np.interp(t - delay, t, followed(speed, CommandResponse(rate=rate, threshold=threshold, lag=lag)))
    off = np.abs(found - expected)
    smooth = threshold == 0.0 and rate == np.inf
    assert np.median(off) < (1e-9 if smooth else 0.01)
    assert np.quantile(off, 0.95) < (1e-6 if smooth else 0.05 if threshold == 0.0 else 3.0)  # a step over one interval


@pytest.mark.parametrize("sensors", sorted(SENSORS))
def test_measured_speeds_are_those_of_the_commands_where_nothing_acts(sensors: str) -> None:
    data = command_data(driven(AGRIQ, sensors=sensors))
    assert data is not None
    error = data.speed - predicted_speeds(data, CommandResponse())
    assert np.abs(error).max() < 0.03 * np.abs(data.speed).max()
    assert np.sqrt(np.mean(error**2)) < (0.2 if sensors == "fine" else 4.0)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("sensors", ["fine", "jitter"])
def test_nothing_is_found_where_nothing_acts(seed: int, sensors: str) -> None:
    view = command_view(driven(AGRIQ, seed, sensors), AGRIQ)
    assert view.found == ()
    assert max(one.nats for one in view.evidence.values()) < 8.0
    level = view.levels["front_velocity"]
    assert level.rmse == pytest.approx(level.noise, rel=0.15)


@pytest.mark.parametrize("effects", [{"slope": {"grade": 0.05, "heading": 1.0}}, {"joint_friction": {"torque": 10.0}}])
def test_what_acts_elsewhere_is_nothing_here(effects: dict) -> None:
    assert command_view(driven(robot_with(**effects)), AGRIQ).found == ()


@pytest.mark.parametrize("sensors", ["fine", "slow"])
@pytest.mark.parametrize("name", sorted(HIDDEN))
def test_an_effect_is_found_with_its_size(name: str, sensors: str) -> None:
    view = command_view(driven(robot_with(**{name: HIDDEN[name]}), seed=1, sensors=sensors), AGRIQ)
    assert view.found == (name,)
    ranked = sorted(view.evidence, key=lambda e: -view.evidence[e].nats)
    assert ranked[0] == name
    one = view.evidence[name]
    for parameter, value in HIDDEN[name].items():
        assert one.values[parameter] == pytest.approx(value, rel=0.06)
        assert abs(one.values[parameter] - value) < 4.0 * one.sd[parameter]
    assert max(other.nats for other in view.given(name).values()) < 20.0
    assert view.nats(robot_with(**{name: HIDDEN[name]})) > 0.8 * one.nats


@pytest.mark.parametrize(("name", "parameter"), [("torque_limit", "front_max"), ("battery_sag", "stall")])
def test_a_limit_is_as_plain_for_motors_of_any_size(name: str, parameter: str) -> None:
    """Torques of a motor 500 times as small say as much: Epi.q's pull less than a thousandth of a newton metre."""
    small = 1.0 / 500.0
    runs = driven(robot_with(**{name: HIDDEN[name]}), seed=1)
    shrunk = []
    for run in runs:
        channels = dict(run.channels)
        for key in ("motor_torques", "motor_command"):
            columns = {k: small * v if k.endswith("effort") else v for k, v in channels[key].columns.items()}
            channels[key] = replace(channels[key], columns=columns)
        shrunk.append(replace(run, channels=channels))
    large, little = (command_view(some, AGRIQ).evidence[name] for some in (runs, shrunk))
    assert little.nats == pytest.approx(large.nats, rel=1e-6)
    assert little.values[parameter] == pytest.approx(small * large.values[parameter], rel=1e-6)


def said_of_limits(view: CommandView) -> tuple[str, tuple[str, ...]]:
    """Which of a level limit and a line is named, and what ties with it."""
    both = {name: one for name, one in others(view).items() if name in ("torque_limit", "battery_sag")}
    best = best_of({}, {}, both, NEEDED, THRESHOLDS)
    assert best is not None
    return best.effect, best.ties


@pytest.mark.parametrize("sensors", ["fine", "slow"])
@pytest.mark.parametrize(("gain", "integral"), [(0.06, 4.0), (0.02, 8.0), (0.2, 2.0), (0.06, 0.0)])
def test_a_velocity_loop_is_found_with_its_gains(gain: float, integral: float, sensors: str) -> None:
    """Speeds fall short as the torque asks for, which a limit of torques or a dead band explains a little of."""
    strong = AGRIQ.replace({"drive.front.torque_max": 2.0})
    hidden = {"velocity_loop": {"gain": gain, "integral": integral}}
    view = command_view(driven(replace(strong, effects=hidden), seed=1, sensors=sensors), strong)
    assert view.found == ("velocity_loop",)
    one = view.evidence["velocity_loop"]
    assert one.nats > 5.0 * max(other.nats for name, other in view.evidence.items() if name != "velocity_loop")
    assert one.values == pytest.approx({"gain": gain, "integral": integral}, rel=0.05, abs=0.01)
    assert all(abs(one.values[name] - value) < 4.0 * one.sd[name] for name, value in hidden["velocity_loop"].items())
    assert view.nats(replace(strong, effects=hidden)) > 20.0


@pytest.mark.parametrize(
    ("seed", "loop", "sensors"),
    [
        (61, (0.06, 4.0, 0.2), "fine"),
        (62, (0.03, 6.0, 0.03), "fine"),
        (66, (0.0391, 6.47, 0.022), "fine"),
        (65, (0.1492, 3.03, 0.198), "jitter"),  # the sum of noisy speeds wandered, which left 11 % of the torques
    ],
)
def test_a_velocity_loop_is_found_with_its_windup_limit(
    seed: int, loop: tuple[float, float, float], sensors: str
) -> None:
    """A limit of the integral part is not taken for a limit of the torque, a delay or a lag."""
    strong, hidden = AGRIQ.replace({"drive.front.torque_max": 2.0}), dict(zip(LOOP, loop, strict=True))
    view = command_view(driven(replace(strong, effects={"velocity_loop": hidden}), seed, sensors), strong)
    assert view.found[0] == "velocity_loop"
    one = view.evidence["velocity_loop"]
    assert one.nats > 2.0 * max(other.nats for name, other in view.evidence.items() if name != "velocity_loop")
    assert one.values == pytest.approx(hidden, rel=0.15)
    assert view.nats(replace(strong, effects={"velocity_loop": hidden})) > 20.0


def test_a_velocity_loop_is_found_beside_a_limit() -> None:
    """Motors that are driven through a loop come to their robot's own limit as well, where the loop says nothing."""
    view = command_view(driven(robot_with(velocity_loop={"gain": 0.06, "integral": 4.0}), seed=1), AGRIQ)
    assert set(view.found) == {"torque_limit", "velocity_loop"}
    values = view.given("torque_limit")["velocity_loop"].values
    assert values == pytest.approx({"gain": 0.06, "integral": 4.0}, rel=0.05)


def test_the_voltage_and_the_motor_are_not_told_apart() -> None:
    """Two numbers of a line are seen: what is named is the motor that would have it at full supply."""
    weak = {"stall": 0.75, "no_load_speed": 312.5, "supply": 0.8}
    one, other = (command_view(driven(robot_with(battery_sag=line), seed=1), AGRIQ).evidence["battery_sag"]
                  for line in (weak, HIDDEN["battery_sag"]))  # fmt: skip
    assert one.values == pytest.approx(other.values, rel=1e-6) and set(one.values) == {"stall", "no_load_speed"}


def test_a_level_limit_is_no_line_where_it_is_met_at_many_speeds() -> None:
    view = command_view(driven(robot_with(torque_limit={"front_max": 0.36}), seed=1), AGRIQ)
    assert said_of_limits(view) == ("torque_limit", ())
    assert view.evidence["battery_sag"].nats == 0.0


def test_a_limit_that_is_met_at_one_speed_may_be_a_line() -> None:
    """Motors that come to their limit at one speed alone do not say what they would have left at another."""
    bends = Manoeuvre(
        "bends", (Dwell(0.5), Ramp(speed=0.6), Straight(length=2.0), Arc(radius=2.0, angle=3.0), Straight(length=2.0)),
        a_max=0.3, blend=0.3,
    )  # fmt: skip
    run = synthetic(robot_with(torque_limit={"front_max": 0.3}), bends, duration=25.0, kappa=0.8, seed=1, name="bends")
    view = command_view([run], AGRIQ)
    assert said_of_limits(view) == ("torque_limit", ("battery_sag",))
    assert view.evidence["battery_sag"].sd["no_load_speed"] == np.inf


@pytest.mark.parametrize(("true", "close"), [("command_delay", "speed_loop_lag"), ("speed_loop_lag", "command_delay")])
def test_a_delay_and_a_lag_are_told_apart(true: str, close: str) -> None:
    view = command_view(driven(robot_with(**{true: HIDDEN[true]}), seed=2), AGRIQ)
    assert view.evidence[true].nats > view.evidence[close].nats + 100.0
    assert view.evidence[close].nats > 0.3 * view.evidence[true].nats, "which is close"


@pytest.mark.long
@pytest.mark.parametrize(
    "pair",
    [
        ("command_delay", "speed_loop_lag"),
        ("speed_loop_lag", "torque_limit"),
        ("encoder_scale", "command_delay"),
        ("torque_limit", "torque_scale"),
    ],
)
def test_two_at_once_are_both_found(pair: tuple[str, str]) -> None:
    view = command_view(driven(robot_with(**{name: HIDDEN[name] for name in pair}), seed=3), AGRIQ)
    assert set(view.found) == set(pair)
    for name, other in (pair, pair[::-1]):
        beside = view.given(other)[name]
        for parameter, value in HIDDEN[name].items():
            assert beside.values[parameter] == pytest.approx(value, rel=0.06)
        assert beside.nats > 100.0


@pytest.mark.parametrize(
    ("effects", "excluded"),
    [({"torque_limit": {"front_max": 5.0}}, ""), ({}, "command_delay"), ({}, "encoder_scale"), ({}, "torque_scale")],
)
def test_what_never_acts_gives_no_evidence_and_is_excluded(effects: dict, excluded: str) -> None:
    strong = robot_with(**effects).replace({"drive.front.torque_max": 10.0})
    view = command_view(driven(strong, seed=4), AGRIQ)
    assert view.found == ()
    if excluded:
        ((parameter, size),) = view.evidence[excluded].excluded_above.items()
        assert 0.0 < size < abs(HIDDEN[excluded][parameter] - AGRIQ_NEUTRAL[excluded])


@pytest.mark.parametrize(
    ("effect", "parameter"),
    [("command_delay", "delay"), ("speed_loop_lag", "time_constant"), ("deadband", "threshold")],
)
def test_what_is_excluded_would_have_been_found(effect: str, parameter: str) -> None:
    """Stamps included: a delay within what clocks differ by is none."""
    bound = command_view(driven(AGRIQ, seed=4), AGRIQ).evidence[effect].excluded_above[parameter]
    hidden = command_view(driven(robot_with(**{effect: {parameter: bound}}), seed=4), AGRIQ)
    assert hidden.evidence[effect].nats > NEEDED
    assert hidden.evidence[effect].values[parameter] == pytest.approx(bound, rel=0.2)


def test_a_recording_without_one_torque_leaves_the_others_theirs() -> None:
    one, other = driven(robot_with(torque_scale={"scale": 1.1}), seed=11)
    motors = one.channels["motor_torques"]
    kept = {k: v for k, v in motors.columns.items() if k != "back_left.effort"}
    lacking = replace(one, channels=dict(one.channels) | {"motor_torques": replace(motors, columns=kept)})
    found = command_view([lacking, other], AGRIQ).evidence["torque_scale"]
    assert not found.note and found.nats > NEEDED
    assert found.values["scale"] == pytest.approx(1.1, rel=0.02)


def test_speeds_alone_in_short_parts_are_enough() -> None:
    """One part too short to say anything takes nothing from the others, which have no angles."""
    found = []
    for number, run in enumerate(driven(robot_with(speed_loop_lag={"time_constant": 0.25}), seed=12)):
        motors = run.channels["motor_torques"]
        spoken = {k: np.full_like(v, np.nan) if "position" in k else np.array(v) for k, v in motors.columns.items()}
        if number == 0:
            for key in (k for k in spoken if k.endswith("velocity")):
                spoken[key][motors.t > 0.6] = np.nan
        found.append(replace(run, channels=dict(run.channels) | {"motor_torques": replace(motors, columns=spoken)}))
    assert command_view(found, AGRIQ).found == ("speed_loop_lag",)


def test_a_limit_is_excluded_below_what_would_have_been_found() -> None:
    strong = AGRIQ.replace({"drive.front.torque_max": 10.0})
    view = command_view(driven(strong, seed=4), AGRIQ)
    ((parameter, bound),) = view.evidence["torque_limit"].excluded_below.items()
    reached = max(np.nanmax(np.abs(view_torques(run))) for run in driven(strong, seed=4))
    assert parameter == "front_max" and 0.8 * reached < bound < reached
    lower = robot_with(torque_limit={"front_max": bound}).replace({"drive.front.torque_max": 10.0})
    assert command_view(driven(lower, seed=4), AGRIQ).found == ("torque_limit",)


def view_torques(run: Experiment) -> np.ndarray:
    columns = run.channels["motor_torques"].columns
    return np.concatenate([values for name, values in columns.items() if name.startswith("front") and "effort" in name])


AGRIQ_NEUTRAL = {"command_delay": 0.0, "encoder_scale": 1.0, "torque_scale": 1.0}


def test_without_commands_there_is_nothing_to_say() -> None:
    silent = [replace(r, channels={k: c for k, c in r.channels.items() if k != "motor_command"}) for r in driven(AGRIQ)]
    view = command_view(silent, AGRIQ)
    assert not view.found and not view.levels and not view.series
    assert set(view.evidence) == set(view.given()) == {"velocity_filter"}, "of which angles beside speeds tell"
    assert view.evidence["velocity_filter"].nats == view.nats(AGRIQ) == 0.0


def test_without_torques_and_at_kappa_1_the_others_are_still_found() -> None:
    robot = robot_with(speed_loop_lag={"time_constant": 0.1})
    recordings = []
    for r in driven(robot, seed=5):
        motors, commands = r.channels["motor_torques"], r.channels["motor_command"]
        kept = {k: v for k, v in motors.columns.items() if not k.endswith("effort")}
        told_ = {k: v for k, v in commands.columns.items() if not k.endswith("effort")}
        changed = {"motor_torques": replace(motors, columns=kept), "motor_command": replace(commands, columns=told_)}
        recordings.append(replace(r, channels=dict(r.channels) | changed))
    view = command_view(recordings, AGRIQ)
    assert view.found == ("speed_loop_lag",)
    assert view.evidence["torque_limit"].nats == view.evidence["torque_scale"].nats == 0.0
    assert view.evidence["torque_limit"].note and view.evidence["torque_scale"].note


def test_the_order_of_recordings_does_not_matter() -> None:
    recordings = driven(robot_with(command_delay={"delay": 0.06}), seed=6)
    one, other = command_view(recordings, AGRIQ), command_view(recordings[::-1], AGRIQ)
    for effect in EFFECTS:
        assert one.evidence[effect] == other.evidence[effect]


def test_what_is_known_of_a_robot_is_no_news() -> None:
    late = robot_with(command_delay={"delay": 0.06})
    view = command_view(driven(late, seed=7), late)
    assert view.found == ()


def test_series_show_what_is_explained() -> None:
    recordings = driven(robot_with(speed_loop_lag={"time_constant": 0.1}), seed=8)
    view = command_view(recordings, AGRIQ)
    assert set(view.series) == {"run0", "run1"}
    for series in view.series.values():
        assert series.before.shape == series.after.shape == (len(series.t), 2)
        before, after = (np.sqrt(np.nanmean(e**2)) for e in (series.before, series.after))
        assert after < 1.2 * series.noise < 0.3 * before
    levels, _ = view.for_robot(AGRIQ)
    assert levels["front_velocity"].after == levels["front_velocity"].rmse


def test_other_recordings_are_held_against_what_was_found() -> None:
    """Judged by them is what the fitted ones show; they are not searched, and those that contradict say so."""
    late = robot_with(speed_loop_lag={"time_constant": 0.1})
    view = command_view(driven(late, seed=8), AGRIQ)
    judge = view_with(view, driven(late, seed=12), AGRIQ)
    own = command_view(driven(late, seed=12), AGRIQ)
    assert judge.found == own.found == ("speed_loop_lag",) and judge.followed
    assert judge.nats(late) == pytest.approx(own.nats(late), rel=0.02) and judge.nats(late) > 100.0
    assert view_with(view, driven(AGRIQ, seed=12), AGRIQ).nats(late) < -100.0
    one, other = driven(AGRIQ, seed=10)
    swapped = replace(one, channels=dict(one.channels) | {"motor_command": other.channels["motor_command"]})
    assert not view_with(view, [swapped], AGRIQ).followed
    assert view_with(command_view([], AGRIQ), driven(late, seed=12), AGRIQ).found == own.found


@pytest.mark.parametrize(
    ("what", "found"),
    [
        *(pytest.param(one, (), marks=pytest.mark.long) for one in ("none", "slope", "joint_friction")),
        ("speed_loop_lag", ("speed_loop_lag",)),
    ],
)
def test_recordings_made_elsewhere(what: str, found: tuple[str, ...]) -> None:
    view = command_view([read_bag(foreign(f"field_examples/{what}/run{k}")) for k in range(3)], AGRIQ)
    assert view.found == found
    if found:
        assert view.evidence["speed_loop_lag"].values["time_constant"] == pytest.approx(0.25, abs=0.003)


def test_a_recording_that_begins_in_motion_hides_no_dead_band() -> None:
    """What was commanded before its beginning is not known: a lag that began then is no second effect."""
    robot = robot_with(speed_loop_lag={"time_constant": 0.25})
    later = []
    for r in driven(robot, seed=9):
        part = r.between(3.0, r.duration)
        later.append(replace(part, segments=((3.0, r.duration),)))
    view = command_view(later, AGRIQ)
    assert view.found == ("speed_loop_lag",)
    assert view.evidence["speed_loop_lag"].values["time_constant"] == pytest.approx(0.25, rel=0.02)


def test_motors_that_do_something_else_are_no_evidence() -> None:
    """Commands of another drive: no delay, lag or scale is read into them."""
    one, other = driven(AGRIQ, seed=10)
    swapped = [replace(one, channels=dict(one.channels) | {"motor_command": other.channels["motor_command"]})]
    view = command_view(swapped, AGRIQ)
    assert not view.followed and view.found == ()
    assert all(view.evidence[e].nats == 0.0 and "do not follow" in view.evidence[e].note for e in EFFECTS)
    assert view.nats(robot_with(command_delay={"delay": 0.1})) == 0.0
    assert view.levels["front_velocity"].rmse > 10.0


def test_a_husky_whose_wheels_are_not_commanded_one_by_one() -> None:
    view = command_view([read_bag(foreign("husky_a")).between(0.0, 200.0)], load_robot("husky"))
    assert not view.followed and view.found == ()
