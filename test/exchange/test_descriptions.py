"""Robots as URDF and SDF: another program finds the same bodies; the ground's law is the model's below saturation."""

from __future__ import annotations

import dataclasses
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

from artibot_sim.cli import main
from artibot_sim.exchange.ground import EXPRESSED, SENSORS, left_out, wheels_of
from artibot_sim.exchange.sdf import sdf
from artibot_sim.exchange.urdf import urdf
from artibot_sim.model import Commands, Robot, load_robot, rollout
from artibot_sim.model.effects import EFFECTS
from artibot_sim.model.robot.robot import module_name
from artibot_sim.model.simulate.rollout import Mode
from artibot_sim.resources import config_names

ROBOTS = config_names("robots")


def origins(robot: Robot) -> list[float]:
    """Where the modules' origins are behind the front one's, m, joints at zero."""
    places = [0.0]
    for hitch, module in zip(robot.hitches, robot.modules[1:], strict=True):
        places.append(places[-1] - hitch.l - module.l)
    return places


def wheel_places(robot: Robot) -> dict[str, tuple[float, float, float]]:
    """Where the model has the wheels' centres in base_link, joints at zero."""
    places = {}
    for i, joint in enumerate(robot.wheel_joints):
        module, origin = robot.modules[i // 4], origins(robot)[i // 4]
        x = origin + (1 if "front_wheel" in joint else -1) * module.i_x / 2
        places[joint] = (x, (1 if "left" in joint else -1) * module.i_y / 2, 0.0)
    return places


@pytest.mark.parametrize("name", ROBOTS)
def test_mujoco_reads_the_urdf_and_finds_the_same_bodies(name: str, tmp_path: Path) -> None:
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed; pip install 'artibot_sim[test]'")
    robot = load_robot(name)
    assert main(["export", name, "--to", "urdf", "-o", str(tmp_path / "r.urdf")]) == 0
    text = (tmp_path / "r.urdf").read_text(encoding="utf-8")
    # MuJoCo merges links that hang on fixed joints, and the base with the world, unless it is told otherwise
    text = text.replace("</robot>", '<mujoco><compiler fusestatic="false"/></mujoco></robot>')
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    base = data.body("base_link").xpos if "base_link" in {model.body(i).name for i in range(model.nbody)} else 0.0
    for joint, place in wheel_places(robot).items():
        np.testing.assert_allclose(data.body(f"{joint}_link").xpos - base, place, atol=1e-6)
        np.testing.assert_allclose(data.joint(joint).xaxis, [0, 1, 0], atol=1e-6)
        inertia = np.sort(model.body(f"{joint}_link").inertia)
        np.testing.assert_allclose(inertia, np.sort([robot.wheel.J_wx, robot.wheel.J_wx, robot.wheel.J_wy]), rtol=1e-6)
    modules = sum(module.m for module in robot.modules)
    total = modules + len(wheel_places(robot)) * robot.wheel.m_w
    assert model.body_mass.sum() == pytest.approx(total + 1e-3 * len(robot.hitches), abs=1e-3)
    place, yaw = np.zeros(2), 0.0
    for i, hitch in enumerate(robot.hitches):  # bent, the modules behind go where the model has them
        data.joint(robot.articulation_joints[2 * i]).qpos[0] = 0.4 - 0.3 * i
        mujoco.mj_kinematics(model, data)
        place = place - hitch.l * np.array([np.cos(yaw), np.sin(yaw)])
        yaw += 0.4 - 0.3 * i
        place = place - robot.modules[i + 1].l * np.array([np.cos(yaw), np.sin(yaw)])
        np.testing.assert_allclose((data.body(f"{module_name(i + 1)}_link").xpos - base)[:2], place, atol=1e-6)


@pytest.mark.parametrize("name", ROBOTS)
def test_no_part_is_fixed_to_another(name: str) -> None:
    """So nothing belongs on /tf_static, and whoever records without robot_state_publisher misses nothing of it."""
    kinds = {joint.get("type") for joint in ET.fromstring(urdf(load_robot(name))).iter("joint")}
    assert kinds <= {"continuous", "revolute"}


@pytest.mark.parametrize("name", ROBOTS)
def test_sdf_has_the_bodies_and_joints_of_the_model(name: str) -> None:
    robot = load_robot(name)
    model = ET.fromstring(sdf(robot)).find("model")
    assert model is not None
    links = {link.get("name"): link for link in model.findall("link")}
    joints = {joint.get("name"): joint for joint in model.findall("joint")}
    for joint, place in wheel_places(robot).items():
        pose = np.array(links[f"{joint}_link"].findtext("pose").split(), float)
        np.testing.assert_allclose(pose[:3], place, atol=1e-6)
        assert joints[joint].findtext("axis/xyz") == "0 1 0"
        assert joints[joint].findtext("child") == f"{joint}_link"
    assert all(joint.findtext("parent") in links and joint.findtext("child") in links for joint in joints.values())
    assert float(model.findtext("pose").split()[2]) == pytest.approx(robot.wheel.r_w)
    total = sum(float(link.findtext("inertial/mass")) for link in links.values())
    assert total == pytest.approx(
        sum(module.m for module in robot.modules)
        + len(wheel_places(robot)) * robot.wheel.m_w
        + 1e-3 * len(robot.hitches),
        abs=1e-3,
    )


def test_the_first_direction_of_friction_is_the_axle() -> None:
    """fdir1 is given in the collision's frame, which is the link's turned by the collision's pose."""
    for form in (sdf(load_robot("husky")), urdf(load_robot("husky"), gazebo=True)):
        root = ET.fromstring(form)
        if root.tag == "sdf":
            collision = next(part for part in root.iter("collision") if part.find("surface") is not None)
            angles = np.array(collision.findtext("pose").split(), float)[3:]
            direction = np.array(collision.findtext("surface/friction/ode/fdir1").split(), float)
        else:
            link = root.findall("link")[1]
            angles = np.array(link.find("collision/origin").get("rpy").split(), float)
            direction = np.array(root.find("gazebo/fdir1").text.split(), float)
        roll, pitch, yaw = angles
        assert pitch == yaw == 0.0
        axle = np.array([[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]]) @ direction
        np.testing.assert_allclose(np.abs(axle), [0, 1, 0], atol=1e-6)


def test_slip_is_what_the_model_slips_for_each_newton() -> None:
    """A rover pulled sideways, its wheels held: slip over force of a wheel is what Gazebo is told."""
    robot = dataclasses.replace(load_robot("husky"), effects={"external_force": {"force": 60.0, "heading": np.pi / 2}})
    robot = robot.replace({"contact.u_w": 0.0})
    velocity = np.full((401, 4), np.nan)
    velocity[:, :2] = 0.0
    result = rollout(robot, Commands(0.01, velocity), modes=Mode.PRESCRIBED)
    sideways = result.v[-1, 1]
    friction = wheels_of(robot)["front_right"].friction
    assert sideways / (60.0 / 4.0) == pytest.approx(friction.slip, rel=0.02)
    assert friction.mu == robot.contact.mu_s
    assert friction.slip2 == pytest.approx(1.0 / robot.contact.k_l)


def test_effects_that_can_be_expressed_are_in_the_numbers_and_others_are_said() -> None:
    assert {*EXPRESSED, *SENSORS} <= set(EFFECTS)
    plain = load_robot("agriq")
    robot = dataclasses.replace(
        plain,
        effects={
            "back_friction": {"scale": 0.5},
            "wheel_radius": {"scale": 0.97},
            "wheel_radius_mismatch": {"relative": 0.02},
            "payload": {"mass": 12.0, "module": "back"},
            "bulldozing": {"coefficient": 400.0},
        },
    )
    root = ET.fromstring(sdf(robot))
    links = {link.get("name"): link for link in root.iter("link")}
    mu = {name: float(link.findtext("collision/surface/friction/ode/mu") or "nan") for name, link in links.items()}
    mu_s = plain.contact.mu_s
    assert mu["back_left_front_wheel_link"] == pytest.approx(0.5 * mu_s)
    assert mu["front_left_front_wheel_link"] == pytest.approx(mu_s)
    radius = {name: float(link.findtext("collision/geometry/cylinder/radius") or "nan") for name, link in links.items()}
    assert radius["front_right_front_wheel_link"] / radius["front_left_front_wheel_link"] == pytest.approx(1.01 / 0.99)
    assert radius["front_right_front_wheel_link"] == pytest.approx(0.97 * 1.01 * plain.wheel.r_w)
    assert float(links["back_link"].findtext("inertial/mass")) == pytest.approx(plain.back.m + 12.0)
    said = "; ".join(left_out(robot))
    assert "bulldozing" in said
    assert not any(name in said for name in EXPRESSED)
    assert "bulldozing" in sdf(robot).split("-->")[0]


@pytest.mark.parametrize("form", ["urdf", "sdf"])
def test_the_command_writes_xml_with_what_is_left_out(form: str, tmp_path: Path) -> None:
    assert main(["export", "agriq", "--to", form, "-o", str(tmp_path / "r")]) == 0
    text = (tmp_path / "r").read_text(encoding="utf-8")
    ET.fromstring(text)
    assert "kappa = 0.8" in text.split("-->")[0]
