"""The launch files name executables, parameters and options that exist.

``launch`` comes only with a full ROS 2, so the files run here against stand-ins that accept what Jazzy's classes do.
"""

from __future__ import annotations

import runpy
import subprocess
import sys
import types
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
import yaml
from bag_helpers import small_bag

from artibot_driver.loopback import loopback_bus
from artibot_sim.cli import main
from artibot_sim.cli.words import COMMANDS
from ros_helpers import ROOT, NodeProcess, NodeStarter, spin_until

LAUNCH_FILES = sorted((ROOT / "launch").glob("*.launch.py"))
BAG = "recording"


@dataclass(frozen=True)
class LaunchConfiguration:
    variable_name: str


@dataclass(frozen=True)
class DeclareLaunchArgument:
    name: str
    default_value: str | LaunchConfiguration | None = None
    description: str = ""


@dataclass(frozen=True)
class Command:
    command: list[Any]


@dataclass(frozen=True)
class PathJoinSubstitution:
    substitutions: list[Any]


@dataclass(frozen=True)
class FindPackageShare:
    package: str


@dataclass(frozen=True)
class ParameterValue:
    value: Any
    value_type: type


@dataclass(frozen=True)
class IfCondition:
    predicate_expression: Any


@dataclass(frozen=True)
class UnlessCondition:
    predicate_expression: Any


@dataclass(frozen=True)
class Shutdown:
    reason: str = ""


@dataclass
class Node:
    package: str
    executable: str
    name: str | None = None
    namespace: str | None = None
    output: str = "log"
    parameters: list[dict[str, Any]] = field(default_factory=list)
    remappings: list[tuple[str, str]] = field(default_factory=list)
    arguments: list[Any] = field(default_factory=list)
    on_exit: Any = None
    condition: Any = None
    """An object of launch; after `nodes_of` whether it holds."""


def described(path: Path, monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """What a launch file's description holds, made with the stand-ins above."""
    modules: dict[str, dict[str, Any]] = {
        "launch": {"LaunchDescription": list},
        "launch.actions": {"DeclareLaunchArgument": DeclareLaunchArgument, "Shutdown": Shutdown},
        "launch.conditions": {"IfCondition": IfCondition, "UnlessCondition": UnlessCondition},
        "launch.substitutions": {each.__name__: each for each in (Command, LaunchConfiguration, PathJoinSubstitution)},
        "launch_ros": {},
        "launch_ros.actions": {"Node": Node},
        "launch_ros.parameter_descriptions": {"ParameterValue": ParameterValue},
        "launch_ros.substitutions": {"FindPackageShare": FindPackageShare},
        "ament_index_python": {},
        "ament_index_python.packages": {"get_packages_with_prefixes": lambda: {"rviz2": "/opt/ros/jazzy"}},
    }
    for name, contents in modules.items():
        module = types.ModuleType(name)
        vars(module).update(contents)
        monkeypatch.setitem(sys.modules, name, module)
    return list(runpy.run_path(str(path))["generate_launch_description"]())


def nodes_of(entities: list[Any], **given: str) -> list[Node]:
    """The nodes, with each launch argument replaced by what is given, its default, or by BAG where it has none."""
    declared = [e for e in entities if isinstance(e, DeclareLaunchArgument)]
    values = {e.name: BAG if e.default_value is None else e.default_value for e in declared} | given

    def resolve(value: Any) -> Any:
        if isinstance(value, Command):
            return Command([resolve(part) for part in value.command])
        if isinstance(value, ParameterValue):
            return resolve(value.value)
        if isinstance(value, PathJoinSubstitution):
            return str(Path(*map(resolve, value.substitutions)))
        if isinstance(value, FindPackageShare):
            assert value.package == "artibot_sim"
            return str(ROOT)  # what is installed into share/ is laid out as here
        return resolve(values[value.variable_name]) if isinstance(value, LaunchConfiguration) else value

    def parameter(value: Any) -> Any:
        """As launch_ros has it: text of a substitution is read as YAML, unless it is empty or a type is stated."""
        text = resolve(value)
        return (yaml.safe_load(text) if text else "") if isinstance(value, LaunchConfiguration) else text

    def holds(condition: Any) -> bool:
        """As launch has it, which takes these four words and no other."""
        if condition is None:
            return True
        word = resolve(condition.predicate_expression).strip().lower()
        assert word in ("true", "1", "false", "0"), word
        return (word in ("true", "1")) is isinstance(condition, IfCondition)

    nodes = [e for e in entities if isinstance(e, Node)]
    for node in nodes:
        node.arguments = [resolve(a) for a in node.arguments]
        node.parameters = [{key: parameter(value) for key, value in group.items()} for group in node.parameters]
        node.namespace = resolve(node.namespace)
        node.condition = holds(node.condition)
    return nodes


def launched(node: Node, folder: Path) -> list[str]:
    """Arguments with which launch_ros starts a node: its own, its namespace made absolute, its parameters in files."""
    words = [*node.arguments, "--ros-args", "-r", f"__ns:=/{str(node.namespace).strip('/')}"]
    for number, group in enumerate(node.parameters):
        file = folder / f"launch_params_{node.executable}_{number}"
        file.write_text(yaml.dump({"/**": {"ros__parameters": group}}))
        words += ["--params-file", str(file)]
    return words


def test_the_launch_files_are_there() -> None:
    assert [path.name for path in LAUNCH_FILES] == [
        "field_test.launch.py", "replay.launch.py", "ros2_control.launch.py", "sim.launch.py", "view.launch.py",
    ]  # fmt: skip


@pytest.mark.parametrize("path", LAUNCH_FILES, ids=lambda path: path.name)
def test_arguments_are_declared_described_and_used(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    entities = described(path, monkeypatch)
    declared = {e.name for e in entities if isinstance(e, DeclareLaunchArgument) and e.description}
    used = set()
    for node in (e for e in entities if isinstance(e, Node)):
        values = [*node.arguments, *(value for group in node.parameters for value in group.values()), node.namespace]
        values += [node.condition.predicate_expression] if node.condition else []
        inner = [value.value for value in values if isinstance(value, ParameterValue)]
        values += inner + [part for value in inner if isinstance(value, Command) for part in value.command]
        used |= {value.variable_name for value in values if isinstance(value, LaunchConfiguration)}
        assert node.namespace == LaunchConfiguration("namespace")
    assert used == declared


@pytest.mark.parametrize("path", LAUNCH_FILES, ids=lambda path: path.name)
def test_executables_and_their_options_exist(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    nodes = nodes_of(described(path, monkeypatch))
    assert nodes
    for node in nodes:
        if node.package in ("rviz2", "robot_state_publisher", "controller_manager"):
            continue
        assert node.package == "artibot_sim"
        assert node.executable in COMMANDS
        # an option that does not exist is refused before the help is shown
        command = [sys.executable, "-m", "artibot_sim.cli", node.executable, *node.arguments, "--help"]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False)
        assert done.returncode == 0, done.stderr


def test_what_looks_like_a_number_stays_text(monkeypatch: pytest.MonkeyPatch) -> None:
    """Names and files are anybody's: launch would make a number of one, and a node refuse the parameter's type."""
    field = next(path for path in LAUNCH_FILES if path.name.startswith("field_test"))
    for node in nodes_of(described(field, monkeypatch), robot="2024", manoeuvre="1e3", simulated="true"):
        given = {key: value for group in node.parameters for key, value in group.items()}
        assert given.get("robot", "2024") == "2024" and given.get("manoeuvre", "1e3") == "1e3"


def test_a_real_rover_is_the_one_of_its_driver_s_parameters_and_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    """What this file has for a default changes neither polarity nor gears of motors that really turn, nor enables."""
    path = next(path for path in LAUNCH_FILES if path.name.startswith("field_test"))
    drivers = [n for n in nodes_of(described(path, monkeypatch), simulated="false") if n.executable == "driver"]
    (real,) = [node for node in drivers if node.condition]
    assert real.parameters == [{"enable_on_start": False}]
    assert "--robot" not in real.arguments and "--enable" not in real.arguments


@pytest.fixture
def bus_channel() -> Iterator[str]:
    with loopback_bus() as channel:
        yield channel


@pytest.mark.parametrize("path", LAUNCH_FILES, ids=lambda path: path.name)
def test_parameters_exist(
    path: Path, monkeypatch: pytest.MonkeyPatch, start_node: NodeStarter, ros_context: object, bus_channel: str,
    tmp_path: Path,
) -> None:  # fmt: skip
    import rclpy.node
    from rcl_interfaces.srv import ListParameters

    with monkeypatch.context() as patch:
        entities = described(path, patch)
    ours = [node for node in nodes_of(entities, channel=bus_channel) if node.package == "artibot_sim"]
    nodes = {node.executable: node for node in reversed(ours) if node.parameters}
    probe = rclpy.node.Node("probe", context=ros_context)
    for node in nodes.values():
        given = {key: value for group in node.parameters for key, value in group.items()}
        process = start_node(node.executable, *launched(node, tmp_path))
        client = probe.create_client(ListParameters, f"{node.executable}/list_parameters")
        spin_until(probe, client.service_is_ready, timeout=60, what=f"{node.executable}'s parameter service")
        answer = client.call_async(ListParameters.Request())
        spin_until(probe, answer.done, timeout=30, what=f"{node.executable}'s list of parameters")
        assert set(given) <= set(answer.result().result.names), process.output
        process.stop()


def launch(path: Path, start_node: NodeStarter, folder: Path, **given: str) -> dict[str, NodeProcess]:
    """Start all that a launch file starts with these arguments; by executable."""
    with pytest.MonkeyPatch.context() as patch:
        nodes = [node for node in nodes_of(described(path, patch), **given) if node.condition]
    assert len({node.executable for node in nodes}) == len(nodes)
    return {node.executable: start_node(node.executable, *launched(node, folder)) for node in nodes}


def recorded(bag: Path) -> dict[str, int]:
    """Topic → how many messages a recording has of it."""
    found = yaml.safe_load((bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    return {each["topic_metadata"]["name"]: each["message_count"] for each in found["topics_with_message_count"]}


@pytest.mark.parametrize("simulated", ["true", "false"])
def test_a_field_test_runs_as_a_whole(
    start_node: NodeStarter, ros_context: object, bus_channel: str, tmp_path: Path, simulated: str
) -> None:
    """Rover, driver, planner and recorder find each other, and the planner's end is that of the launch.

    Where the rover is a real one, drives are on the bus already, and nothing moves before somebody enables them.
    """
    import rclpy.node
    from std_srvs.srv import Trigger

    bag = tmp_path / "run"
    if simulated == "false":
        start_node("drives", "--channel", bus_channel).wait_for("drives")
    path = next(path for path in LAUNCH_FILES if path.name.startswith("field_test"))
    given = {"simulated": simulated, "channel": bus_channel, "manoeuvre": "short", "namespace": "rover1"}
    nodes = launch(path, start_node, tmp_path, out=str(bag), **given)
    assert set(nodes) == {"record", "driver", "planner"} | ({"sim"} if simulated == "true" else set())
    if simulated == "false":
        nodes["driver"].wait_for("may be enabled", 60.0)
        probe = rclpy.node.Node("probe", context=ros_context)
        client = probe.create_client(Trigger, "/rover1/driver/enable")
        spin_until(probe, client.service_is_ready, timeout=60, what="the driver's service")
        assert "starts at" not in nodes["planner"].output
        answer = client.call_async(Trigger.Request())
        spin_until(probe, answer.done, timeout=30, what="being enabled")
        assert answer.result().success, answer.result().message
    assert nodes["planner"].wait(150.0) == 0, nodes["planner"].output
    for node in nodes.values():  # as on_exit's Shutdown does
        assert node.stop(20.0) == 0, node.output
    counts = recorded(bag)
    assert counts["/rover1/planned/front_velocity"] == 1
    assert all(counts[f"/rover1/{topic}"] > 100 for topic in ("odom", "motor_torques", "planned/odom"))
    assert counts["/rover1/from_can_bus"] > 1000 and counts["/diagnostics"] > 5
    assert ("/rover1/ground_truth/odom" in counts) == (simulated == "true")


def test_a_replay_runs_as_a_whole(start_node: NodeStarter, tmp_path: Path) -> None:
    bag = small_bag(tmp_path / "made", 2)
    path = next(path for path in LAUNCH_FILES if path.name.startswith("replay"))
    nodes = launch(path, start_node, tmp_path, bag=str(bag), rate="2.0", namespace="rover1")
    assert nodes["replay"].wait() == 0
    assert "done: " in nodes["replay"].output


def test_the_view_gives_robot_state_publisher_the_urdf_and_rviz_its_file(monkeypatch: pytest.MonkeyPatch) -> None:
    """The command that launch would run is run here: what it prints is the parameter's text."""
    path = next(path for path in LAUNCH_FILES if path.name.startswith("view"))
    with monkeypatch.context() as patch:
        state, rviz = nodes_of(described(path, patch), robot="epiq", frame_prefix="rover1/", use_sim_time="true")
    assert (state.package, rviz.package) == ("robot_state_publisher", "rviz2")
    (given,) = state.parameters
    assert given["frame_prefix"] == "rover1/" and given["use_sim_time"] == rviz.parameters[0]["use_sim_time"] is True
    words = "".join(given["robot_description"].command).split()
    assert words[:3] == ["ros2", "run", "artibot_sim"] and words[3] in COMMANDS
    command = [sys.executable, "-m", "artibot_sim.cli", *words[3:]]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120, check=True)
    assert done.stderr == "", "launch's Command fails where anything is said there"
    assert done.stdout == (ROOT / "config" / "urdf" / "epiq.urdf").read_text()
    option, file = rviz.arguments
    assert option == "-d"
    layout = yaml.safe_load(Path(file).read_text())
    displays = layout["Visualization Manager"]["Displays"]
    topics = {d[key]["Value"] for d in displays for key in ("Topic", "Description Topic") if key in d}
    assert topics == {"robot_description", "planned/path", "odom", "ground_truth/odom"}


def test_controllers_have_the_exported_files_and_no_description_of_another(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Simulator and driver publish a description without ros2_control's tag, which a manager must not take."""
    urdf, controllers = tmp_path / "agriq_ros2_control.urdf", tmp_path / "agriq_ros2_control.yaml"
    assert main(["export", "agriq", "--to", "ros2_control", "-o", str(urdf)]) == 0
    path = next(path for path in LAUNCH_FILES if path.name.startswith("ros2_control"))
    with monkeypatch.context() as patch:
        state, manager, spawner = nodes_of(described(path, patch), urdf=str(urdf), controllers=str(controllers))
    words = "".join(state.parameters[0]["robot_description"].command).split()
    assert subprocess.run(words, capture_output=True, text=True, check=True).stdout == urdf.read_text()
    for node in (state, manager):
        assert ("robot_description", "robot_description_control") in node.remappings
    assert manager.arguments[-1] == spawner.arguments[-1] == str(controllers)
    manifest = yaml.safe_load(controllers.read_text())
    assert spawner.arguments[0] in manifest["controller_manager"]["ros__parameters"]
    assert spawner.arguments[0] in manifest


def test_without_rviz_the_view_is_robot_state_publisher_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    path = next(path for path in LAUNCH_FILES if path.name.startswith("view"))
    described(path, monkeypatch)
    monkeypatch.setattr(sys.modules["ament_index_python.packages"], "get_packages_with_prefixes", dict)
    entities = list(runpy.run_path(str(path))["generate_launch_description"]())
    assert [node.package for node in entities if isinstance(node, Node)] == ["robot_state_publisher"]


def test_launch_arguments_that_are_left_empty_are_not_given(
    monkeypatch: pytest.MonkeyPatch, start_node: NodeStarter, ros_context: object, tmp_path: Path
) -> None:
    """A parameter file's values hold unless an argument says otherwise, and topics are in the namespace."""
    import rclpy.node
    from rcl_interfaces.srv import GetParameters

    path = next(path for path in LAUNCH_FILES if path.name.startswith("sim"))
    file = tmp_path / "mine.yaml"
    file.write_text("/**:\n  ros__parameters: {robot: epiq, rate: 2.0, kappa: 0.7}\n")
    with monkeypatch.context() as patch:
        (sim,) = nodes_of(described(path, patch), params=str(file), kappa="0.9", namespace="rover1")
    process = start_node(sim.executable, *launched(sim, tmp_path))
    probe = rclpy.node.Node("probe", context=ros_context)
    client = probe.create_client(GetParameters, "/rover1/sim/get_parameters")
    spin_until(probe, client.service_is_ready, timeout=60, what="the simulator's parameter service")
    answer = client.call_async(GetParameters.Request(names=["robot", "rate", "kappa"]))
    spin_until(probe, answer.done, timeout=30, what="its parameters")
    robot, rate, kappa = answer.result().values
    assert (robot.string_value, rate.double_value, kappa.double_value) == ("epiq", 2.0, 0.9), process.output
