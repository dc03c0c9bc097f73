"""A robot of many modules in MuJoCo moves as artibot's: MuJoCo derives the chain by itself."""

from __future__ import annotations

import numpy as np
import pytest

from artibot_sim.bench.model import distance
from artibot_sim.bench.trains import STEP, chain, in_mujoco, of_modules, train_model
from artibot_sim.model import load_robot, rollout
from artibot_sim.planning import load_manoeuvre, plan


@pytest.mark.parametrize("name", ["train3", "train5"])
def test_mujoco_derives_the_same_motion(name):
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo comes with the extra 'bench'")
    robot = load_robot(name)
    commands = plan(load_manoeuvre("test2"), robot).commands()
    ours = rollout(robot, commands, dt=STEP, every=round(commands.dt / STEP))
    theirs = in_mujoco(robot, commands)
    assert np.ptp(ours.articulations[:, -1, 0]) > 0.1, "the last joint must bend for this to mean anything"
    assert distance(theirs.pose, ours.pose).max() < 1e-6
    assert np.abs(theirs.pose[:, 2] - ours.pose[:, 2]).max() < 1e-6
    assert mujoco.get_mjcb_passive() is None
    built = mujoco.MjModel.from_xml_string(train_model(robot, STEP))
    total = sum(module.m + 4 * robot.wheel.m_w for module in robot.modules)
    assert built.body_subtreemass[1] == pytest.approx(total)


def test_a_robot_can_have_any_number_of_modules():
    robot = of_modules(7)
    assert robot.wheel_joints[-1] == "module_7_left_back_wheel"
    commands = plan(load_manoeuvre("short"), robot).commands()
    found = chain(robot, commands)
    assert found.q.shape == (len(commands.velocity), 56)
    assert np.isfinite(found.q).all()
