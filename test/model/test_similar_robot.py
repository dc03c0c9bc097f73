"""A robot from a data sheet: what was given stands in it, the rest scales as a body does, and it can be simulated."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st
from model.helpers import front_commands, ramp, standstill

from artibot_sim.cli.robot import command
from artibot_sim.errors import ArtibotError
from artibot_sim.identify.requested import parameter_set
from artibot_sim.model import Robot, load_robot, rollout, save_robot
from artibot_sim.model.robot.similar import DataSheet, similar
from artibot_sim.resources import config_names

WARTHOG = DataSheet(mass=260.0, radius=0.30, track=1.136, wheelbase=0.915)


def weight(robot: Robot) -> float:
    modules = [m for m in (robot.front, robot.back) if m is not None]
    return sum(m.m + 4.0 * robot.wheel.m_w for m in modules)


@settings(max_examples=60, deadline=None)
@given(
    name=st.sampled_from(["agriq", "epiq", "husky", "warthog", "optiodom_diff"]),
    mass=st.floats(2.0, 800.0), radius=st.floats(0.03, 0.6), track=st.floats(0.1, 2.0), wheelbase=st.floats(0.1, 2.0),
)  # fmt: skip
def test_any_data_sheet_makes_a_valid_robot_that_says_what_was_given(name, mass, radius, track, wheelbase) -> None:
    robot = similar(load_robot(name), "other", DataSheet(mass, radius, track, wheelbase))
    assert weight(robot) == pytest.approx(mass)
    assert (robot.wheel.r_w, robot.front.i_y, robot.front.i_x) == pytest.approx((radius, track, wheelbase))
    for key, (low, high) in robot.intervals.items():
        value = robot.as_vector([key])[0]
        assert low < value < high, key


def test_a_robot_twice_as_large_is_scaled_as_a_body() -> None:
    small = load_robot("husky")
    sheet = DataSheet(8 * weight(small), 2 * small.wheel.r_w, 2 * small.front.i_y, 2 * small.front.i_x)
    large = similar(small, "large", sheet)
    for name in ("J_x", "J_y", "J_z"):
        assert getattr(large.front, name) == pytest.approx(32 * getattr(small.front, name))
    assert large.wheel.J_wy == pytest.approx(32 * small.wheel.J_wy)
    assert large.contact.k_l == pytest.approx(8 * small.contact.k_l)
    assert large.contact.mu_s == small.contact.mu_s


def test_intervals_of_a_robot_file_are_priors_and_identified_ones_are_not() -> None:
    robot = similar(load_robot("husky"), "warthog", WARTHOG)
    (soil,) = parameter_set(robot, ("k_l",)).parameters
    low, high = robot.intervals["contact.k_l"]
    assert np.exp(1.96 * soil.spread) == pytest.approx(np.sqrt(high / low), rel=0.01)
    known = robot.replace({"contact.k_l": robot.contact.k_l}, source="identified: from run0")
    (again,) = parameter_set(known, ("k_l",)).parameters
    assert again.prior.sd == pytest.approx(0.4 * robot.contact.k_l)


def test_the_command_writes_a_file_that_drives(tmp_path: Path) -> None:
    out = tmp_path / "warthog.yaml"
    options = ["--like", "husky", "--mass", "260", "--radius", "0.30", "--track", "1.136", "--wheelbase", "0.915"]
    done = CliRunner().invoke(command, ["new", "warthog", *options, "--out", str(out)], catch_exceptions=False)
    assert done.exit_code == 0 and "contact.k_l" in done.output
    robot = load_robot(out)
    assert robot.name == "warthog" and "datasheet: wheelbase" in robot.sources["front.i_x"]
    run = rollout(robot, front_commands(robot, ramp, lambda t: 0.0, 3.0))
    assert np.isfinite(run.q).all() and run.q[-1, 0] == pytest.approx(2.0, abs=0.1)
    with pytest.raises(ArtibotError, match="exists already"):
        CliRunner().invoke(command, ["new", "warthog", *options, "--out", str(out)], catch_exceptions=False)


def test_what_cannot_be_is_refused() -> None:
    husky = load_robot("husky")
    with pytest.raises(ArtibotError, match="mass: -3"):
        DataSheet(mass=-3.0)
    with pytest.raises(ArtibotError, match="--wheel-mass"):
        similar(husky, "x", DataSheet(mass=50.0, wheel_mass=20.0))


@pytest.mark.parametrize("name", ["warthog", "husky_driven", "optiodom_diff"])
def test_robots_of_real_recordings_are_shipped_and_stand_still_when_still(name: str, tmp_path: Path) -> None:
    assert name in config_names("robots")
    robot = load_robot(name)
    save_robot(robot, tmp_path / "again.yaml")
    assert load_robot(tmp_path / "again.yaml") == robot
    still = rollout(robot, standstill(1.0))
    assert abs(still.q[-1, :2]).max() < 1e-6


def test_a_motor_of_a_data_sheet_stands_in_the_file_and_in_a_larger_robot_it_is_stronger(tmp_path) -> None:
    path = tmp_path / "other.yaml"
    motor = ["--stall-torque", "1.2", "--no-load-speed", "400", "--no-load-torque", "0.04"]
    result = CliRunner().invoke(command, ["new", "other", "--like", "agriq", *motor, "-o", str(path)])
    assert result.exit_code == 0, result.output
    robot = load_robot(path)
    assert (robot.motor.stall_torque, robot.motor.no_load_speed, robot.motor.no_load_torque) == (1.2, 400.0, 0.04)
    assert robot.sources["motor.no_load_speed"] == "datasheet: no load speed 400 rad/s"
    larger = similar(robot, "larger", DataSheet(mass=2 * weight(robot)))
    assert larger.motor.stall_torque == pytest.approx(2.4) and larger.motor.no_load_speed == 400.0
    assert larger.motor.velocity_filter == 0.0 and "motor.supply" not in larger.sources
