"""Effective track and radii: right where the answer is known, and a controller with them follows the model."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from artibot_sim.cli import main
from artibot_sim.exchange.controllers import diff_drive_controller, robot_localization
from artibot_sim.exchange.turning import PLACES, differential, spread, steady_turns
from artibot_sim.experiment.measured import dead_reckon
from artibot_sim.model import Commands, Robot, load_robot, rollout
from artibot_sim.model.effects import EFFECTS


def with_effects(robot: Robot, **effects: dict[str, Any]) -> Robot:
    return dataclasses.replace(robot, effects=effects)


def parameters(text: str, section: str = "diff_drive_controller") -> dict[str, Any]:
    found: dict[str, Any] = yaml.safe_load(text)[section]["ros__parameters"]
    return found


def test_wheels_on_one_axle_turn_as_they_stand() -> None:
    """Without a length between the wheels nothing has to slide sideways."""
    robot = load_robot("husky").replace({"front.i_x": 1e-3, "contact.u_w": 0.0})
    found = differential(steady_turns(robot))
    assert found.separation == pytest.approx(robot.front.i_y, rel=2e-3)
    assert found.radius_right == pytest.approx(robot.wheel.r_w, rel=1e-3)


def test_the_longer_the_wheelbase_the_wider_the_track() -> None:
    husky = load_robot("husky")
    tracks = [differential(steady_turns(husky.replace({"front.i_x": i_x}))).separation for i_x in (0.2, 0.5, 0.8)]
    assert tracks[0] < tracks[1] < tracks[2]


def test_unequal_radii_are_found() -> None:
    robot = with_effects(load_robot("husky"), wheel_radius_mismatch={"relative": 0.02})
    found = differential(steady_turns(robot))
    assert found.radius_right / found.radius_left == pytest.approx(1.01 / 0.99, rel=2e-3)


def test_what_encoders_count_is_what_the_radius_is_for() -> None:
    plain = differential(steady_turns(load_robot("husky")))
    scaled = differential(steady_turns(with_effects(load_robot("husky"), encoder_scale={"scale": 1.05})))
    assert scaled.radius_left == pytest.approx(plain.radius_left / 1.05, rel=1e-6)
    assert scaled.separation == pytest.approx(plain.separation, rel=1e-6)


def odometry(numbers: dict[str, Any], right: np.ndarray, left: np.ndarray) -> np.ndarray:
    """Poses (n, 3) as diff_drive_controller integrates wheel angles."""
    track = numbers["wheel_separation"] * numbers["wheel_separation_multiplier"]
    rolled_right = right * numbers["wheel_radius"] * numbers["right_wheel_radius_multiplier"]
    rolled_left = left * numbers["wheel_radius"] * numbers["left_wheel_radius_multiplier"]
    return dead_reckon(0.5 * (rolled_right + rolled_left), (rolled_right - rolled_left) / track)


@pytest.mark.parametrize("name", ["husky", "agriq", "epiq"])
def test_a_controller_with_these_numbers_follows_the_rover(name: str) -> None:
    """On another drive than those that the numbers come from: speeds and curvatures that change all the time."""
    robot = load_robot(name)
    t = np.arange(0, 20, 0.01)
    v = 0.2 * np.sqrt(9.81 * robot.front.i_y) * np.minimum(t / 2, 1.0)
    rate = v / (5.0 * robot.front.i_y) * (0.4 + np.sin(0.5 * t))
    wheels = np.column_stack([v + 0.5 * robot.front.i_y * rate, v - 0.5 * robot.front.i_y * rate]) / robot.wheel.r_w
    velocity = np.full((len(t), 4), np.nan)
    velocity[:, :2] = wheels / robot.drive.front.tau
    result = rollout(robot, Commands(0.01, velocity))
    turned = result.motor_position[:, :2] * robot.drive.front.tau
    numbers = parameters(diff_drive_controller({name: robot}))
    plain = numbers | {key: 1.0 for key in numbers if key.endswith("_multiplier")}
    off = abs(odometry(numbers, *turned.T)[-1, 2] - result.pose[-1, 2])
    off_plain = abs(odometry(plain, *turned.T)[-1, 2] - result.pose[-1, 2])
    assert off < 0.25 * off_plain


def test_intervals_hold_the_value_and_grow_with_those_of_the_file() -> None:
    husky = dataclasses.replace(load_robot("husky"), intervals={})
    widths = []
    for half in (0.1, 0.4):
        k_t = husky.contact.k_t
        robot = dataclasses.replace(husky, intervals={"contact.k_t": (k_t * (1 - half), k_t * (1 + half))})
        found = spread(robot, draws=12)
        interval = found.interval("separation")
        assert interval is not None
        assert interval[0] <= found.value.separation <= interval[1]
        assert interval == spread(robot, draws=12).interval("separation")  # same seed, same bits
        widths.append(interval[1] - interval[0])
    assert widths[1] > 2.0 * widths[0] > 0.0
    assert spread(husky).interval("separation") is None


def test_each_ground_has_a_section_with_its_comment(tmp_path: Path) -> None:
    husky = load_robot("husky")
    text = diff_drive_controller({"gravel": husky, "ice": husky.replace({"contact.mu_s": 0.1, "contact.mu_d": 0.05})})
    gravel, ice = parameters(text), parameters(text, "diff_drive_controller_ice")
    assert gravel["wheel_separation"] == ice["wheel_separation"] == husky.front.i_y
    assert gravel["wheel_separation_multiplier"] != ice["wheel_separation_multiplier"]
    assert gravel["right_wheel_names"] == ["front_right_front_wheel", "front_right_back_wheel"]
    assert "# ice: robot 'husky'" in text


def test_what_belongs_to_a_place_is_left_out_and_said() -> None:
    assert set(PLACES) <= set(EFFECTS)
    flat = load_robot("husky")
    steep = with_effects(flat, slope={"grade": 0.1, "heading": 0.3})
    one, other = diff_drive_controller({"a": flat}), diff_drive_controller({"a": steep})
    assert parameters(one) == parameters(other)
    assert "without slope" in other


def test_the_filter_takes_what_the_robot_measures() -> None:
    husky = load_robot("husky")
    for robot, sideways in ((husky, False), (husky.replace({"front.i_x": 1e-3, "contact.u_w": 0.0}), True)):
        numbers = parameters(robot_localization(robot), "ekf_filter_node")
        vx, vy, yaw_rate = 6, 7, 11  # of x y z, roll pitch yaw, their rates, accelerations
        wanted = {vx, yaw_rate} | ({vy} if sideways else set())
        assert numbers["odom0_config"] == [place in wanted for place in range(15)]
        assert numbers["imu0_config"] == [place == yaw_rate for place in range(15)]
        assert numbers["frequency"] == 50.0


def test_the_command_writes_the_file_and_says_what_is_wrong(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "c.yaml"
    assert main(["export", "husky", "epiq", "--to", "diff_drive_controller", "-o", str(out)]) == 0
    assert set(yaml.safe_load(out.read_text(encoding="utf-8"))) == {
        "diff_drive_controller",
        "diff_drive_controller_epiq",
    }
    for args, said in (
        (["husky", "epiq", "--to", "robot_localization"], "expected one robot, found 2"),
        (["huski", "--to", "robot_localization"], "did you mean 'husky'"),
        (["husky", "--to", "robot_localization", "--rate", "5"], "are for recordings"),
        (["husky", "--to", "robot_localization", "-o", str(tmp_path / "no" / "c.yaml")], "there is no folder"),
    ):
        capsys.readouterr()
        assert main(["export", *args]) == 2
        assert said in capsys.readouterr().err
