"""The simulation node's parameter table, its files, pacing and URDF."""

from __future__ import annotations

import json
import math
import xml.etree.ElementTree as ET
from pathlib import Path
from types import SimpleNamespace as Record

import numpy as np
import pytest
import yaml

from artibot_sim.errors import ArtibotError
from artibot_sim.exchange.urdf import urdf
from artibot_sim.model import WHEEL_JOINTS, load_robot
from artibot_sim.nodes.common.options import parameter_files
from artibot_sim.nodes.common.pacer import Pacer, Seldom, write_statistics
from artibot_sim.nodes.sim import parameters as parameters
from artibot_sim.nodes.sim.parameters import rules, sensor_model, start, switched
from artibot_sim.resources import config_names, config_path

ROBOTS = config_names("robots")
DEFAULTS = {name: spec.default for name, spec in parameters.SPECS.items()}


def shipped(name: str) -> dict[str, object]:
    return yaml.safe_load(config_path("nodes", name).read_text(encoding="utf-8"))["/**"]["ros__parameters"]


def test_the_shipped_file_is_the_table() -> None:
    assert config_path("nodes", "sim").read_text(encoding="utf-8") == parameters.as_yaml()
    found = {name: tuple(value) if isinstance(value, list) else value for name, value in shipped("sim").items()}
    assert found == {name: value for name, value in DEFAULTS.items() if name != "kappa"}


@pytest.mark.parametrize("name", ["sim", "sim_noisy", "sim_patient"])
def test_shipped_values_are_accepted(name: str) -> None:
    for key, value in shipped(name).items():
        parameters.check(key, value)
    assert parameter_files([name]) == ["--ros-args", "--params-file", str(config_path("nodes", name)), "--"]


def test_every_parameter_says_what_it_is() -> None:
    for spec in parameters.SPECS.values():
        assert len(spec.doc) > 10 and spec.expected
        assert parameters.check(spec.name, spec.default) == spec.default
        number = isinstance(spec.default, (int, float)) and not isinstance(spec.default, bool)
        assert not number or (math.isfinite(max(spec.low, spec.above)) and math.isfinite(spec.high))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("kappa", 0.0),
        ("kappa", 1.1),
        ("kappa", math.nan),
        ("rate", -1.0),
        ("rate", "fast"),
        ("seed", 1.5),
        ("seed", True),
        ("with_driver", 1),
        ("integrator", "euler"),
        ("command_source", "joystick"),
        ("total_station.prism", [1.0]),
        ("total_station.prism", [1.0, 2.0, math.nan]),
        ("stop_deceleration", 0.0),
    ],
)
def test_bad_values_are_refused_by_name(name: str, value: object) -> None:
    with pytest.raises(ArtibotError, match=rf"parameter {name}.*expected"):
        parameters.check(name, value)


def test_a_missing_parameter_file_is_said() -> None:
    with pytest.raises(ArtibotError, match=r"nowhere\.yaml"):
        parameter_files(["nowhere.yaml"])
    with pytest.raises(ArtibotError, match="nothing_like_this"):
        parameter_files(["nothing_like_this"])


def test_settings_reach_their_parts() -> None:
    robot = load_robot("agriq")
    settings = DEFAULTS | {"rate": 0.25, "start.yaw": 1.0, "noise.torque": 0.5, "imu.gyro_noise": 0.1}
    assert rules(settings, robot).command_timeout == pytest.approx(0.4)
    assert rules(DEFAULTS | {"rate": 8.0}, robot).command_timeout == 0.1
    assert rules(DEFAULTS, robot).needs_sign_of_life
    assert not rules(DEFAULTS | {"rate": 0.0}, robot).needs_sign_of_life
    assert start(settings).yaw == 1.0
    assert (sensor_model(settings).torque, sensor_model(settings).gyro) == (0.5, 0.1)
    assert sensor_model(DEFAULTS) == sensor_model(DEFAULTS).__class__(), "ideal sensors by default"
    assert [switched({"x": text}, "x", True) for text in ("auto", "true", "false")] == [True, True, False]


def test_deadlines_are_absolute(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Record(now=1_000)
    monkeypatch.setattr("artibot_sim.nodes.common.pacer.time.monotonic_ns", lambda: clock.now)
    pacer = Pacer(10_000_000, 2.0)
    pacer.start()
    for k in range(1, 200):
        assert pacer.remaining() == pytest.approx((1_000 + k * 5_000_000 - clock.now) * 1e-9)
        clock.now = 1_000 + k * 5_000_000 + 3_000_000  # always late by the same
        assert pacer.done() == 0
    found = pacer.statistics()
    assert found["late_p50_ms"] == found["late_max_ms"] == pytest.approx(3.0)
    assert found["overruns"] == found["slips"] == 0
    clock.now += 400_000_000
    assert pacer.done() > 300_000_000
    assert pacer.remaining() == pytest.approx(0.005)
    assert pacer.statistics()["slips"] == pacer.statistics()["overruns"] == 1


def test_without_pace_there_is_no_waiting(tmp_path: Path) -> None:
    pacer = Pacer(10_000_000, 0.0)
    pacer.start()
    assert pacer.remaining() == 0.0 and pacer.done() == 0
    write_statistics(tmp_path / "s.json", pacer.statistics())
    assert json.loads((tmp_path / "s.json").read_text())["steps"] == 1
    assert [path.name for path in tmp_path.iterdir()] == ["s.json"]
    with pytest.raises(ArtibotError, match=r"stats: .*gone.* cannot be written"):
        write_statistics(tmp_path / "gone" / "s.json", pacer.statistics())


def test_what_may_be_said_once_in_five_seconds_is_said_at_once_and_then_so_often(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock = Record(now=0.0)
    monkeypatch.setattr("artibot_sim.nodes.common.pacer.time.monotonic", lambda: clock.now)
    say, said = Seldom(5.0), []
    for tick in range(1200):
        clock.now = 0.01 * tick
        if say.due():
            said.append(clock.now)
    assert said == pytest.approx([0.0, 5.0, 10.0])


def test_no_node_uses_rclpy_s_throttle() -> None:
    """It looks for the file of its caller at each call, which costs a late simulator a tenth of its time."""
    folder = Path(parameters.__file__).parents[1]
    assert not [path.name for path in folder.rglob("*.py") if "throttle_duration_sec" in path.read_text("utf-8")]


@pytest.mark.parametrize("name", ROBOTS)
def test_the_shipped_urdf_is_the_robot_files(name: str) -> None:
    assert config_path("urdf", name).read_text(encoding="utf-8") == urdf(load_robot(name))


def chain(root: ET.Element, link: str) -> np.ndarray:
    """Position of a link in base_link with all joints at zero."""
    place = np.zeros(3)
    while link != "base_link":
        joint = next(j for j in root.findall("joint") if j.find("child").get("link") == link)
        place += np.array(list(map(float, joint.find("origin").get("xyz").split())))
        link = joint.find("parent").get("link")
    return place


@pytest.mark.parametrize("name", ROBOTS)
def test_urdf_joints_and_geometry(name: str) -> None:
    robot = load_robot(name)
    root = ET.fromstring(urdf(robot))
    joints = {joint.get("name") for joint in root.findall("joint")}
    wheels = robot.wheel_joints
    assert joints == {*wheels, *robot.articulation_joints}
    assert wheels[:8] == WHEEL_JOINTS[: len(wheels)]
    assert robot.articulation_joints[:2] == (("articulation_yaw", "articulation_roll") if robot.back else ())
    links = [link.get("name") for link in root.findall("link")]
    assert len(links) == len(set(links)) == len(joints) + 1, "a tree"
    for i, joint in enumerate(wheels):
        module = robot.modules[i // 4]
        joints_ahead = zip(robot.hitches[: i // 4], robot.modules[1:], strict=False)
        origin = -sum(hitch.l + behind.l for hitch, behind in joints_ahead)
        x = origin + (1 if "front_wheel" in joint else -1) * module.i_x / 2
        y = (1 if "left" in joint else -1) * module.i_y / 2
        np.testing.assert_allclose(chain(root, f"{joint}_link"), [x, y, 0.0], atol=1e-8)
        wheel = next(link for link in root.findall("link") if link.get("name") == f"{joint}_link")
        assert float(wheel.find("visual/geometry/cylinder").get("radius")) == pytest.approx(robot.wheel.r_w)
    masses = sum(float(mass.get("value")) for mass in root.iter("mass"))
    bodies = sum(module.m for module in robot.modules) + len(wheels) * robot.wheel.m_w
    assert masses == pytest.approx(bodies + 1e-3 * len(robot.hitches), abs=1e-3)
