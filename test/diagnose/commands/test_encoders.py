"""Recorded speeds beside recorded angles: a low-pass is found with its size, and told from a delay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnose.commands.test_view import AGRIQ, SENSORS, driven, robot_with

from artibot_sim.diagnose.commands.fit import NEEDED
from artibot_sim.diagnose.commands.view import command_view
from artibot_sim.diagnose.policy import SMALLEST_DELAY
from artibot_sim.experiment import Experiment


def with_motors(run: Experiment, change) -> Experiment:
    """A recording whose motors' columns are changed: (name, t, values) to values, or None to leave one out."""
    motors = run.channels["motor_torques"]
    columns = {name: change(name, motors.t, np.array(values)) for name, values in motors.columns.items()}
    kept = {name: values for name, values in columns.items() if values is not None}
    return replace(run, channels=dict(run.channels) | {"motor_torques": replace(motors, columns=kept)})


@pytest.mark.parametrize("commanded", [True, False])
@pytest.mark.parametrize("true", [0.1, 0.4])
def test_a_low_pass_is_found_with_its_size(true: float, commanded: bool) -> None:
    runs = driven(robot_with(velocity_filter={"time_constant": true}), seed=1)
    if not commanded:
        runs = [replace(r, channels={k: c for k, c in r.channels.items() if k != "motor_command"}) for r in runs]
    view = command_view(runs, AGRIQ)
    one = view.evidence["velocity_filter"]
    assert one.nats > NEEDED and not one.note
    assert one.values["time_constant"] == pytest.approx(true, rel=0.03, abs=0.001)
    assert view.given("velocity_filter").get("velocity_filter") is None


def test_a_short_low_pass_is_no_more_than_a_delay() -> None:
    """Beside what speeds do in so short a time both look alike, and neither is named."""
    runs = driven(robot_with(velocity_filter={"time_constant": 0.03}), seed=1)
    one = command_view(runs, AGRIQ).evidence["velocity_filter"]
    assert one.nats == 0.0 and "0.030 s later" in one.note


def test_commands_are_not_blamed_for_a_low_pass_on_what_is_recorded() -> None:
    """Beside a lag of the drives both are found with their sizes, whichever of angles and speeds is looked at."""
    robot = robot_with(velocity_filter={"time_constant": 0.2}, speed_loop_lag={"time_constant": 0.1})
    view = command_view(driven(robot, seed=3), AGRIQ)
    assert view.found == ("speed_loop_lag",)
    assert view.evidence["speed_loop_lag"].values["time_constant"] == pytest.approx(0.1, rel=0.03)
    assert view.evidence["velocity_filter"].values["time_constant"] == pytest.approx(0.2, rel=0.03)
    level = view.levels["front_velocity"]
    assert level.after < 1.3 * level.noise < 0.2 * level.rmse


@pytest.mark.parametrize("sensors", sorted(SENSORS))
@pytest.mark.parametrize("seed", range(2))
def test_nothing_is_found_in_clean_speeds(seed: int, sensors: str) -> None:
    """Nor where stamps scatter: smoothing would hide what that does to rates of angles."""
    one = command_view(driven(AGRIQ, seed, sensors), AGRIQ).evidence["velocity_filter"]
    assert one.nats == 0.0 and 0.0 < one.excluded_above["time_constant"] < 0.05


def test_speeds_that_are_late_are_not_smooth() -> None:
    def late(name: str, t: np.ndarray, values: np.ndarray) -> np.ndarray:
        return np.interp(t - 0.1, t, values) if name.endswith("velocity") else values

    one = command_view([with_motors(run, late) for run in driven(AGRIQ, seed=2)], AGRIQ).evidence["velocity_filter"]
    assert one.nats == 0.0


@pytest.mark.parametrize("every", [1, 5])
def test_speeds_computed_from_the_angles_are_no_low_pass(every: int) -> None:
    """A loop of 100 or 20 Hz that divides what an angle gains by its period."""

    def differences(run: Experiment) -> Experiment:
        whole, kept = run.channels["motor_torques"], slice(None, None, every)
        columns = {name: np.array(values[kept]) for name, values in whole.columns.items()}
        motors = replace(
            whole, t=whole.t[kept], t_ns=whole.t_ns[kept], received_ns=whole.received_ns[kept], columns=columns
        )
        for name in [name for name in columns if name.endswith("velocity")]:
            angle = columns[name.replace("velocity", "position")]
            columns[name] = np.concatenate(([0.0], np.diff(angle) / np.diff(motors.t)))
        return replace(run, channels=dict(run.channels) | {"motor_torques": replace(motors, columns=columns)})

    one = command_view([differences(run) for run in driven(AGRIQ, seed=2)], AGRIQ).evidence["velocity_filter"]
    assert one.nats == 0.0


@pytest.mark.parametrize("kept", ["position", "velocity"])
def test_angles_or_speeds_alone_say_nothing(kept: str) -> None:
    def one_kind(name: str, t: np.ndarray, values: np.ndarray) -> np.ndarray | None:
        return values if name.endswith((kept, "effort")) else None

    runs = driven(robot_with(velocity_filter={"time_constant": 0.2}), seed=1)
    assert "velocity_filter" not in command_view([with_motors(run, one_kind) for run in runs], AGRIQ).evidence


def test_speeds_in_other_units_are_no_low_pass() -> None:
    def in_turns(name: str, t: np.ndarray, values: np.ndarray) -> np.ndarray:
        return values / (2.0 * np.pi) if name.endswith("velocity") else values

    one = command_view([with_motors(run, in_turns) for run in driven(AGRIQ, seed=4)], AGRIQ).evidence["velocity_filter"]
    assert one.nats == 0.0 and "not the rates" in one.note


def test_what_the_robot_file_knows_is_not_looked_for() -> None:
    known = robot_with(velocity_filter={"time_constant": 0.2})
    view = command_view(driven(known, seed=1), known)
    assert "velocity_filter" not in view.evidence and view.found == ()


def test_the_least_that_counts_is_what_stamps_leave_open() -> None:
    one = command_view(driven(robot_with(velocity_filter={"time_constant": 0.5 * SMALLEST_DELAY}), seed=1), AGRIQ)
    assert one.evidence["velocity_filter"].nats == 0.0
