"""A robot for ros2_control: its joints are the motors on artibot's topics, and its controller turns as the model."""

from __future__ import annotations

import math
import time
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
import yaml

from artibot_sim.cli import main
from artibot_sim.exchange.ros2_control import SETTINGS, description
from artibot_sim.model import Commands, Robot, load_robot, rollout
from artibot_sim.resources import config_names
from ros_helpers import NodeStarter, spin_until


def hardware(robot: Robot) -> tuple[ET.Element, ET.Element]:
    """The URDF and the tag in it."""
    root = ET.fromstring(description(robot))
    tag = root.find("ros2_control")
    assert tag is not None and tag.get("type") == "system"
    return root, tag


@pytest.mark.parametrize("name", config_names("robots"))
def test_each_joint_of_the_tag_is_a_joint_that_turns(name: str) -> None:
    """The resource manager refuses others. MuJoCo reads the URDF and has hinges of these names, about the axle."""
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed; pip install 'artibot_sim[test]'")
    robot = load_robot(name)
    root, tag = hardware(robot)
    named = [joint.get("name") for joint in tag.findall("joint")]
    assert named == ["front_right", "front_left"]
    text = description(robot).replace("</robot>", '<mujoco><compiler fusestatic="false"/></mujoco></robot>')
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for joint in named:
        assert model.joint(joint).type[0] == mujoco.mjtJoint.mjJNT_HINGE
        np.testing.assert_allclose(data.joint(joint).xaxis, [0, 1, 0], atol=1e-6)
    assert {link.get("name") for link in root.findall("link")} >= {"base_link", "front_right_motor_link"}


def test_controllers_by_topics_turn_the_simulated_rover(start_node: NodeStarter, ros_context: object) -> None:
    """What the hardware interface sends by the tag, the simulator takes; what the tag reads, the simulator sends."""
    import rclpy.node
    from sensor_msgs.msg import JointState

    _, tag = hardware(load_robot("agriq"))
    process = start_node("sim", "--robot", "agriq")
    probe = rclpy.node.Node("hardware", context=ros_context)
    commands = probe.create_publisher(JointState, SETTINGS["joint_commands_topic"], 10)
    seen: list[JointState] = []
    probe.create_subscription(JointState, SETTINGS["joint_states_topic"], seen.append, 10)
    joints = [joint.get("name") for joint in tag.findall("joint")]
    wanted = [40.0, 60.0]

    def follows() -> bool:
        message = JointState(name=joints, velocity=wanted)
        message.header.stamp = probe.get_clock().now().to_msg()
        commands.publish(message)
        time.sleep(0.02)
        if not seen:
            return False
        found = dict(zip(seen[-1].name, seen[-1].velocity, strict=True))
        return all(abs(found[joint] - speed) < 1.0 for joint, speed in zip(joints, wanted, strict=True))

    spin_until(probe, follows, timeout=60, what="motors that turn as commanded")
    states = {state.get("name") for joint in tag.findall("joint") for state in joint.findall("state_interface")}
    for state in states:
        assert len(getattr(seen[-1], str(state))) == len(seen[-1].name), process.output


def test_its_controller_turns_as_the_model_does(tmp_path: Path) -> None:
    """Wheel speeds by diff_drive_controller's formulas, in rad/s of the motors, make the model turn as was asked."""
    out = tmp_path / "husky.urdf"
    assert main(["export", "husky", "--to", "ros2_control", "-o", str(out)]) == 0
    own = yaml.safe_load(out.with_suffix(".yaml").read_text())["diff_drive_controller"]["ros__parameters"]
    robot = load_robot("husky")
    assert own["left_wheel_names"] == ["front_left"] and own["right_wheel_names"] == ["front_right"]
    speed, rate = 0.4, 0.25
    half = 0.5 * rate * own["wheel_separation"] * own["wheel_separation_multiplier"]
    right, left = (
        (speed + sign * half) / (own["wheel_radius"] * own[f"{side}_wheel_radius_multiplier"])
        for sign, side in ((1, "right"), (-1, "left"))
    )
    t = np.arange(0.0, 12.0, 0.01)
    velocity = np.full((len(t), 4), np.nan)
    velocity[:, :2] = np.clip(t, 0.0, 1.0)[:, None] * [right, left]
    result = rollout(robot, Commands(0.01, velocity))
    yaw = np.unwrap(result.pose[:, 2])
    late = result.t > 6.0
    found = np.polyfit(result.t[late], yaw[late], 1)[0]
    assert math.isclose(found, rate, rel_tol=0.1), found


def test_the_command_writes_both_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "epiq.urdf"
    assert main(["export", "epiq", "--to", "ros2_control", "-o", str(out)]) == 0
    assert out.exists() and out.with_suffix(".yaml").exists()
    assert main(["export", "epiq", "--to", "ros2_control", "-o", str(tmp_path / "x.yaml")]) == 2
    assert "call the URDF .urdf" in capsys.readouterr().err
