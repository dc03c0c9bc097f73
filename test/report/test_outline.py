"""The drawn rover has the sizes of its robot file and stands where the recording says."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from artibot_sim.experiment import Experiment
from artibot_sim.model import Robot, load_robot
from artibot_sim.report.figures import experiment_figure
from artibot_sim.report.panels import Outline
from artibot_sim.report.paths import outline, size

ANGLES = st.floats(-3.2, 3.2)
PLACES = st.floats(-20.0, 20.0)


def centres(rover: Outline) -> np.ndarray:
    """Centres of the wheels (n, 2), front module first, in the order right front, right back, left front, left back."""
    return np.array([wheel[:-1].mean(axis=0) for wheel in rover.wheels])


@pytest.mark.parametrize("name", ["agriq", "epiq", "husky"])
@given(x=PLACES, y=PLACES, yaw=ANGLES, bend=ANGLES)
def test_wheels_stand_where_the_robot_file_says(name: str, x: float, y: float, yaw: float, bend: float) -> None:
    robot = load_robot(name)
    rover = outline(robot, x, y, yaw, bend)
    modules = [module for module in (robot.front, robot.back) if module is not None]
    found = centres(rover).reshape(len(modules), 4, 2)
    for module, wheels, heading in zip(modules, found, (yaw, yaw + bend), strict=False):
        forward = np.array([np.cos(heading), np.sin(heading)])
        assert np.allclose(wheels[0] - wheels[1], module.i_x * forward, atol=1e-9)
        assert np.allclose(wheels[2] - wheels[0], module.i_y * np.array([-forward[1], forward[0]]), atol=1e-9)
    assert np.allclose(found[0].mean(axis=0), [x, y], atol=1e-9)
    for wheel in rover.wheels:
        assert np.isclose(max(np.hypot(*np.diff(wheel, axis=0).T)), 2 * robot.wheel.r_w)


@pytest.mark.parametrize("name", ["agriq", "epiq"])
@given(yaw=ANGLES, bend=ANGLES)
def test_the_modules_meet_at_the_joint(name: str, yaw: float, bend: float) -> None:
    robot = load_robot(name)
    assert robot.back is not None
    front, back = centres(outline(robot, 1.0, 2.0, yaw, bend)).reshape(2, 4, 2).mean(axis=1)
    joint = front - robot.front.l * np.array([np.cos(yaw), np.sin(yaw)])
    assert np.allclose(back + robot.back.l * np.array([np.cos(yaw + bend), np.sin(yaw + bend)]), joint)


def test_without_an_articulation_angle_the_back_module_is_left_out(agriq: Robot) -> None:
    assert len(outline(agriq, 0, 0, 0, None).wheels) == 4


@pytest.mark.parametrize("name", ["agriq", "epiq", "husky"])
def test_size_is_from_the_foremost_to_the_last_wheel(name: str) -> None:
    robot = load_robot(name)
    corners = np.concatenate(outline(robot, 0, 0, 0, 0.0).wheels)
    assert np.isclose(size(robot), np.ptp(corners[:, 0]))


def test_rovers_are_drawn_on_the_true_path(run: Experiment, agriq: Robot) -> None:
    panel = experiment_figure([run], [agriq])["path"]
    truth, joints = run.channels["ground_truth_odom"], run.channels["joint_states"]
    assert 2 <= len(panel.outlines) <= 6
    assert panel.outlines[0].t == truth.t[0]
    assert panel.outlines[-1].t == truth.t[-1]
    for rover in panel.outlines:
        pose = [float(np.interp(rover.t, truth.t, truth[name])) for name in ("x", "y", "yaw")]
        bend = float(np.interp(rover.t, joints.t, joints["articulation_yaw.position"]))
        assert np.allclose(centres(rover), centres(outline(agriq, pose[0], pose[1], pose[2], bend)))


def test_arrows_point_along_the_motion(run: Experiment, agriq: Robot) -> None:
    (arrows,) = experiment_figure([run], [agriq])["path"].arrows
    truth = run.channels["ground_truth_odom"]
    assert len(arrows.x) >= 5
    for x, y, heading in zip(arrows.x, arrows.y, arrows.heading, strict=True):
        row = int(np.argmin(np.hypot(truth["x"] - x, truth["y"] - y)))
        course = truth["yaw"][row] + np.arctan2(truth["vy"][row], truth["vx"][row])
        assert abs(np.angle(np.exp(1j * (heading - course)))) < 0.05
