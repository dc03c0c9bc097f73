"""MuJoCo's bodies under the paper's contact law follow artibot's: the comparison is between equals."""

from __future__ import annotations

import numpy as np
import pytest

from artibot_sim.bench import peers
from artibot_sim.bench.model import Scenario, distance
from artibot_sim.errors import ArtibotError
from artibot_sim.model import load_robot, rollout
from artibot_sim.planning import load_manoeuvre, plan

mujoco = pytest.importorskip("mujoco", reason="MuJoCo comes with the extra 'bench'")

from artibot_sim.bench.mujoco_peer import LawRun, NativeRun, law_model, native_model  # noqa: E402 - after the check  # noqa: E402


def planned(name, manoeuvre):
    robot = load_robot(name)
    return robot, plan(load_manoeuvre(manoeuvre), robot).commands()


@pytest.mark.parametrize(("name", "manoeuvre"), [("agriq", "table6_agriq"), ("agriq", "test2")])
def test_the_same_law_gives_the_same_path(name, manoeuvre):
    robot, commands = planned(name, manoeuvre)
    ours = rollout(robot, commands)
    theirs = LawRun(robot, commands)()
    np.testing.assert_allclose(theirs.t, ours.t, atol=1e-9)
    assert distance(theirs.pose, ours.pose).max() < 1e-7
    assert np.abs(theirs.pose[:, 2] - ours.pose[:, 2]).max() < 1e-7


def test_repeated_runs_are_equal_and_leave_no_callback_behind():
    robot, commands = planned("agriq", "test1")
    run = LawRun(robot, commands, integrator="Euler")
    first, second = run(), run()
    np.testing.assert_array_equal(first.pose, second.pose)
    assert mujoco.get_mjcb_passive() is None


def test_own_contacts_carry_the_rover_level_and_forward():
    robot, commands = planned("agriq", "test1")
    run = NativeRun(robot, commands, integrator="implicitfast")
    result = run()
    assert np.isfinite(result.pose).all()
    assert run.data.body("front").xpos[2] == pytest.approx(robot.wheel.r_w, abs=0.01)
    assert distance(result.pose, np.zeros_like(result.pose)).max() > 1.0


def test_over_hills_both_rovers_stand_alike_but_for_their_wheels_springs():
    """Heights and tilts are those on MuJoCo's heightfield as wheels' springs grow stiff; with their own they differ."""
    results = {one.name: one for one in peers.mujoco_heightfield(Scenario(quick=True))}
    height, tilt = (results[f"mujoco_heightfield_{name}"] for name in ("height", "tilt"))
    assert height.value < 1.0 and tilt.value < 1.5, "mm and mrad, of hills of 20 mm and 35 mrad"
    assert height.detail["own_springs"] > 3.0 * height.value and tilt.detail["own_springs"] > 3.0 * tilt.value


@pytest.mark.parametrize("model", [law_model, native_model])
def test_masses_are_those_of_the_robot(model):
    robot = load_robot("agriq")
    built = mujoco.MjModel.from_xml_string(model(robot, 1e-3, "RK4"))
    modules = built.body("front").mass[0] + built.body("back").mass[0]
    wheels = sum(built.body(i).mass[0] for i in range(built.nbody) if built.body(i).name.endswith(("_front", "_back")))
    assert modules + wheels == pytest.approx(robot.front.m + robot.back.m + 8 * robot.wheel.m_w)


def test_a_rigid_robot_is_refused():
    with pytest.raises(ArtibotError, match="'husky' has no back module"):
        law_model(load_robot("husky"), 1e-3, "RK4")


@pytest.mark.parametrize(("module", "pip", "bench"), [("pinocchio", "pin", "pinocchio"), ("pydrake", "drake", "drake")])
def test_other_bodies_with_the_same_law_drive_the_same_path(module, pip, bench):
    pytest.importorskip(module, reason=f"pip install {pip}")
    (result,) = getattr(peers, bench)(Scenario(quick=True))
    assert result.detail["pose_difference_largest"] < 1e-8


def test_pybullet_with_the_same_law_drives_nearly_the_same_path():
    """Its own step is of first order, so not to rounding."""
    pytest.importorskip("pybullet", reason="pip install pybullet")
    (result,) = peers.pybullet(Scenario(quick=True))
    assert result.detail["pose_difference_largest"] < 1e-3
