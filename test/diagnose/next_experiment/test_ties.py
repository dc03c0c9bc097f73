"""What to measure next: robots that tie are distinguished by the manoeuvre that is chosen, and by no shorter one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from artibot_sim.diagnose.next_experiment.choice import ENOUGH, USUAL, by_commands, duration, hardest, next_experiment
from artibot_sim.diagnose.next_experiment.simulation import LIBRARY, TrialExplanation, nuisance_parameters, trial
from artibot_sim.model import Robot, load_robot

AGRIQ = load_robot("agriq")
NOISE = {c: v for c, v in USUAL.items() if c not in ("yaw", "front_velocity")}
BY_NAME = {entry.name: entry for entry in LIBRARY}
SHORT = [BY_NAME[name] for name in ("forth_and_back", "bends", "stop_and_go")]


def robot_with(**effects: dict) -> Robot:
    return replace(AGRIQ, effects=effects)


PULLED = {
    "slope": robot_with(slope={"grade": 0.05, "heading": 1.0}),
    "external_force": robot_with(external_force={"force": 35.0, "heading": 1.0}),
}
LATE = {
    "command_delay": robot_with(command_delay={"delay": 0.1}),
    "speed_loop_lag": robot_with(speed_loop_lag={"time_constant": 0.1}),
}
JOINT = {
    "joint_friction": robot_with(joint_friction={"torque": 6.0}),
    "joint_damping": robot_with(joint_damping={"coefficient": 20.0}),
}


def test_the_library_can_be_driven() -> None:
    assert len({entry.name for entry in LIBRARY}) == len(LIBRARY) >= 10
    for entry in LIBRARY:
        assert 5.0 < duration(entry, AGRIQ) < 180.0
        driven = trial(AGRIQ, entry, (0.0, 0.0), tuple(NOISE)) if entry in SHORT else True
        assert driven is not None
    assert {entry.yaw for entry in LIBRARY} == {0.0, np.pi / 2}


@pytest.mark.parametrize("entry", SHORT, ids=lambda entry: entry.name)
def test_a_robot_is_not_told_from_itself(entry) -> None:
    assert hardest({"one": PULLED["slope"], "other": PULLED["slope"]}, entry, NOISE) < 1e-3


def test_trains_are_told_apart_as_well() -> None:
    """A start has two numbers more for each joint behind the first."""
    train = load_robot("train3")
    effects: dict[str, dict] = {
        "slope": {"grade": 0.05, "heading": 1.0},
        "external_force": {"force": 35.0, "heading": 1.0},
    }
    robots = {name: replace(train, effects={name: values}) for name, values in effects.items()}
    assert hardest(dict.fromkeys(("one", "other"), robots["slope"]), BY_NAME["jerks"], NOISE) < 1e-3
    found = next_experiment(robots, NOISE, library=[BY_NAME["jerks"]])
    assert found is not None and found.manoeuvre == "jerks" and found.nats > 0.1


def test_another_soil_and_another_size_are_no_difference() -> None:
    """What recordings so far leave open is taken up: hardly anything is left of it."""
    driven = trial(PULLED["slope"], BY_NAME["bends"], (0.0, 0.0), tuple(NOISE))
    near = PULLED["slope"].replace({"contact.k_t": 1.03 * AGRIQ.contact.k_t, "contact.u_w": 0.97 * AGRIQ.contact.u_w})
    near = replace(near, effects={"slope": {"grade": 0.053, "heading": 1.1}})
    frozen = TrialExplanation(driven, near, NOISE)
    left = frozen.nats()
    stiff = frozen._cost(np.zeros(len(nuisance_parameters(near))), *(_still(frozen)))
    assert left < 0.1 * stiff


def _still(explanation: TrialExplanation) -> tuple:
    moves = np.zeros_like(explanation.trial.starts)
    shifts = np.zeros(len(nuisance_parameters(explanation.robot)))
    return moves, explanation._residuals([shifts], moves[None])[0]


def test_on_a_straight_line_a_slope_is_like_a_wind() -> None:
    """In bends the pull on the back module shifts the articulation, which a wind on the front one does not."""
    straight, bends = (hardest(PULLED, BY_NAME[name], NOISE) for name in ("forth_and_back_turned", "bends"))
    assert straight < ENOUGH < bends


def test_friction_and_damping_of_the_joint_are_alike_where_it_does_not_move() -> None:
    assert hardest(JOINT, BY_NAME["forth_and_back"], NOISE) < 1.0
    assert hardest(JOINT, BY_NAME["bends"], NOISE) > ENOUGH


def test_a_delay_and_a_lag_differ_in_the_command_view_alone() -> None:
    entry = BY_NAME["jerks"]
    driven = trial(LATE["command_delay"], entry, (0.0, 0.0), tuple(NOISE))
    assert by_commands(driven, LATE["speed_loop_lag"], NOISE) > ENOUGH
    assert by_commands(driven, LATE["command_delay"], NOISE) < 1e-3
    assert TrialExplanation(driven, LATE["speed_loop_lag"], NOISE).nats() < 1e-3


def test_a_torque_sensors_scale_shows_in_commanded_back_torques() -> None:
    robots = {"torque_scale": robot_with(torque_scale={"scale": 1.1}), "nothing": AGRIQ}
    driven = trial(robots["torque_scale"], BY_NAME["stop_and_go"], (0.0, 0.0), tuple(NOISE))
    assert by_commands(driven, AGRIQ, NOISE) > ENOUGH
    without = {c: v for c, v in NOISE.items() if not c.startswith("torque")}
    assert by_commands(driven, AGRIQ, without) < 1e-3


def test_a_torque_limit_shows_where_it_acts() -> None:
    driven = trial(AGRIQ, BY_NAME["stop_and_go"], (0.0, 0.0), tuple(NOISE))
    assert by_commands(driven, robot_with(torque_limit={"front_max": 0.2}), NOISE) > ENOUGH
    limited = trial(robot_with(torque_limit={"front_max": 0.3}), BY_NAME["stop_and_go"], (0.0, 0.0), tuple(NOISE))
    assert by_commands(limited, LATE["speed_loop_lag"], NOISE) > ENOUGH


def test_a_limit_and_a_line_through_it_differ_at_other_speeds() -> None:
    """Which of both motors drove is told where they are at their limit at several speeds."""
    robots = {
        "torque_limit": robot_with(torque_limit={"front_max": 0.3}),
        "battery_sag": robot_with(battery_sag={"stall": 0.6, "no_load_speed": 280.0}),
    }
    for true, other in (("torque_limit", "battery_sag"), ("battery_sag", "torque_limit")):
        driven = trial(robots[true], BY_NAME["stop_and_go"], (0.0, 0.0), tuple(NOISE))
        assert by_commands(driven, robots[true], NOISE) == 0.0
        assert by_commands(driven, robots[other], NOISE) > ENOUGH


@pytest.mark.parametrize("robots", [PULLED, LATE, JOINT], ids=lambda robots: "-".join(robots))
def test_the_shortest_that_tells_them_apart_is_chosen(robots: dict) -> None:
    found = next_experiment(robots, NOISE, library=SHORT)
    assert found is not None and found.nats > ENOUGH
    assert set(found.separates) == set(robots)
    for entry in SHORT:
        if duration(entry, AGRIQ) < duration(BY_NAME[found.manoeuvre], AGRIQ):
            assert hardest(robots, entry, NOISE) < ENOUGH
    assert all(name in found.what for name in robots)
    assert found == next_experiment(robots, NOISE, library=SHORT), "nothing is drawn"


def test_what_nothing_tells_apart_is_said_so() -> None:
    found = next_experiment({"one": AGRIQ, "other": AGRIQ}, NOISE, library=SHORT[:2])
    assert found is not None and found.nats < 1.0
    assert "hardly enough" in found.what
    assert next_experiment({"slope": PULLED["slope"]}, NOISE) is None


def test_noise_costs() -> None:
    loud = {channel: 4.0 * sigma for channel, sigma in NOISE.items()}
    assert hardest(PULLED, BY_NAME["bends"], loud) < 0.5 * hardest(PULLED, BY_NAME["bends"], NOISE)


def test_a_place_on_the_ground_is_driven_over() -> None:
    patch = {"scale": 0.4, "x": 5.0, "y": 3.0, "radius": 1.2}
    robots = {"friction_patch": robot_with(friction_patch=patch), "stribeck": robot_with(stribeck={"velocity": 0.08})}
    found = next_experiment(robots, NOISE, library=[BY_NAME["bends"]])
    assert found is not None and "x = 3.8 m, y = 3.0 m" in found.what
    off = {"friction_patch": robot_with(friction_patch=patch), "nothing": AGRIQ}
    assert (
        hardest(off, BY_NAME["bends"], NOISE, (3.8, 3.0)) > hardest(off, BY_NAME["bends"], NOISE, (-50.0, 0.0)) + 10.0
    )


def test_a_rigid_robot_has_experiments_too() -> None:
    husky = load_robot("husky")
    robots = {
        "wheel_radius_mismatch": replace(husky, effects={"wheel_radius_mismatch": {"relative": 0.03}}),
        "gyro_bias": replace(husky, effects={"gyro_bias": {"bias": 0.02}}),
    }
    found = next_experiment(robots, {"position": 0.01, "yaw": 0.01, "yaw_rate": 0.01}, library=SHORT)
    assert found is not None and found.nats > ENOUGH
