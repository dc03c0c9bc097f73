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

from artibot_driver.loopback import loopback_bus
from artibot_sim.cli.words import COMMANDS
from ros_helpers import ROOT, NodeStarter, spin_until

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


def described(path: Path, monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """What a launch file's description holds, made with the stand-ins above."""
    modules: dict[str, dict[str, Any]] = {
        "launch": {"LaunchDescription": list},
        "launch.actions": {"DeclareLaunchArgument": DeclareLaunchArgument, "Shutdown": Shutdown},
        "launch.conditions": {"IfCondition": IfCondition, "UnlessCondition": UnlessCondition},
        "launch.substitutions": {"LaunchConfiguration": LaunchConfiguration},
        "launch_ros": {},
        "launch_ros.actions": {"Node": Node},
    }
    for name, contents in modules.items():
        module = types.ModuleType(name)
        vars(module).update(contents)
        monkeypatch.setitem(sys.modules, name, module)
    return list(runpy.run_path(str(path))["generate_launch_description"]())


def nodes_of(entities: list[Any], **given: str) -> list[Node]:
    """The nodes, with each launch argument replaced by what is given, its default, or by BAG where it has none."""
    values = {e.name: e.default_value or BAG for e in entities if isinstance(e, DeclareLaunchArgument)} | given

    def resolve(value: Any) -> Any:
        return resolve(values[value.variable_name]) if isinstance(value, LaunchConfiguration) else value

    nodes = [e for e in entities if isinstance(e, Node)]
    for node in nodes:
        node.arguments = [resolve(a) for a in node.arguments]
        node.parameters = [{key: resolve(value) for key, value in group.items()} for group in node.parameters]
    return nodes


def test_the_launch_files_are_there() -> None:
    assert [path.name for path in LAUNCH_FILES] == ["field_test.launch.py", "replay.launch.py", "sim.launch.py"]


@pytest.mark.parametrize("path", LAUNCH_FILES, ids=lambda path: path.name)
def test_arguments_are_declared_described_and_used(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    entities = described(path, monkeypatch)
    declared = {e.name for e in entities if isinstance(e, DeclareLaunchArgument) and e.description}
    used = set()
    for node in (e for e in entities if isinstance(e, Node)):
        values = [*node.arguments, *(value for group in node.parameters for value in group.values())]
        values += [node.condition.predicate_expression] if node.condition else []
        used |= {value.variable_name for value in values if isinstance(value, LaunchConfiguration)}
    assert used == declared


@pytest.mark.parametrize("path", LAUNCH_FILES, ids=lambda path: path.name)
def test_executables_and_their_options_exist(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    nodes = nodes_of(described(path, monkeypatch))
    assert nodes
    for node in nodes:
        assert node.package == "artibot_sim"
        assert node.executable in COMMANDS
        # an option that does not exist is refused before the help is shown
        command = [sys.executable, "-m", "artibot_sim.cli", node.executable, *node.arguments, "--help"]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False)
        assert done.returncode == 0, done.stderr


def test_a_real_rover_is_the_one_of_its_driver_s_parameters_and_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    """What this file has for a default changes neither polarity nor gears of motors that really turn, nor enables."""
    path = next(path for path in LAUNCH_FILES if path.name.startswith("field_test"))
    drivers = [n for n in nodes_of(described(path, monkeypatch), simulated="false") if n.executable == "driver"]
    (real,) = [node for node in drivers if isinstance(node.condition, UnlessCondition)]
    assert real.parameters == [{"enable_on_start": "false"}]
    assert "--robot" not in real.arguments and "--enable" not in real.arguments


@pytest.fixture
def bus_channel() -> Iterator[str]:
    with loopback_bus() as channel:
        yield channel


@pytest.mark.parametrize("path", LAUNCH_FILES, ids=lambda path: path.name)
def test_parameters_exist(
    path: Path, monkeypatch: pytest.MonkeyPatch, start_node: NodeStarter, ros_context: object, bus_channel: str
) -> None:
    import rclpy.node
    from rcl_interfaces.srv import ListParameters

    with monkeypatch.context() as patch:
        entities = described(path, patch)
    nodes = {node.executable: node for node in reversed(nodes_of(entities, channel=bus_channel)) if node.parameters}
    probe = rclpy.node.Node("probe", context=ros_context)
    for node in nodes.values():
        given = {key: value for group in node.parameters for key, value in group.items()}
        settings = [word for key, value in given.items() for word in ("-p", f"{key}:={value}")]
        process = start_node(node.executable, *node.arguments, "--ros-args", *settings)
        client = probe.create_client(ListParameters, f"{node.executable}/list_parameters")
        spin_until(probe, client.service_is_ready, timeout=60, what=f"{node.executable}'s parameter service")
        answer = client.call_async(ListParameters.Request())
        spin_until(probe, answer.done, timeout=30, what=f"{node.executable}'s list of parameters")
        assert set(given) <= set(answer.result().result.names), process.output
        process.stop()
