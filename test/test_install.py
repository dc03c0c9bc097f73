"""What colcon and pip make of the checkout: every executable starts, and the files shipped with it are found."""

from __future__ import annotations

import configparser
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from artibot_sim.cli.words import COMMANDS
from artibot_sim.resources import KINDS, config_names

if TYPE_CHECKING:
    from rclpy.context import Context
from ros_helpers import ROOT, NodeStarter, skip, spin_until

pytestmark = pytest.mark.install

LEFT_OUT = (".git", ".venv", "build", "install", "log", "__pycache__", "*.egg-info", ".*_cache")
"""What belongs to a checkout's owner and not to the package."""


def _left_out(folder: str, names: list[str]) -> set[str]:
    """What is not copied: what tools leave anywhere, and the demo's results, which lie at the top."""
    of_the_demo = {"demo"} if Path(folder) == ROOT else set()
    return of_the_demo & set(names) | shutil.ignore_patterns(*LEFT_OUT)(folder, names)


def call(*command: object, cwd: Path, timeout: float = 300.0) -> str:
    """Run a program that must succeed; return what it printed."""
    words = list(map(str, command))
    done = subprocess.run(words, cwd=cwd, capture_output=True, text=True, timeout=timeout, check=False)
    assert done.returncode == 0, f"{words}\n{done.stdout}\n{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the checkout, so that builds leave no trace in it."""
    folder = tmp_path_factory.mktemp("source") / "artibot"
    shutil.copytree(ROOT, folder, ignore=_left_out)
    return folder


@pytest.fixture(scope="module")
def colcon() -> str:
    """The program colcon, of this environment or the machine's."""
    beside = Path(sys.executable).with_name("colcon")
    found = str(beside) if beside.exists() else shutil.which("colcon")
    return found or skip("colcon is not installed; run `make setup`")


@pytest.fixture(scope="module")
def workspace(source: Path, colcon: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A colcon workspace in which the package has been built."""
    folder = tmp_path_factory.mktemp("workspace")
    call(colcon, "--log-base", "log", "build", "--base-paths", source, cwd=folder)
    return folder


def sourced(workspace: Path, *command: object) -> list[str]:
    """The command line that runs `command` as a user does who has sourced the workspace."""
    script = '. "$0" && exec "$@"'
    return ["bash", "-c", script, str(workspace / "install" / "setup.bash"), *map(str, command)]


def installed(workspace: Path, word: str) -> Path:
    """The file that ``ros2 run artibot_sim WORD`` starts."""
    return workspace / "install" / "artibot_sim" / "lib" / "artibot_sim" / word


def test_colcon_sees_an_ament_package(source: Path, colcon: str, tmp_path: Path) -> None:
    listed = call(colcon, "--log-base", "log", "list", "--base-paths", source, cwd=tmp_path)
    assert listed.split() == ["artibot_sim", str(source), "(ros.ament_python)"]


def test_the_workspace_is_in_the_ament_index(source: Path, workspace: Path) -> None:
    code = "import os; print(os.environ['AMENT_PREFIX_PATH'].split(os.pathsep)[0])"
    prefix = Path(call(*sourced(workspace, sys.executable, "-c", code), cwd=workspace).strip())
    assert prefix == workspace / "install" / "artibot_sim"
    assert (prefix / "share" / "ament_index" / "resource_index" / "packages" / "artibot_sim").is_file()
    assert (prefix / "share" / "artibot_sim" / "package.xml").is_file()
    launch_files = {path.name for path in (source / "launch").glob("*.launch.py")}
    assert launch_files == {path.name for path in (prefix / "share" / "artibot_sim" / "launch").iterdir()}


def test_ros2_run_finds_each_word_and_artibot(workspace: Path) -> None:
    folder = installed(workspace, "")
    assert {path.name for path in folder.iterdir() if os.access(path, os.X_OK)} == {*COMMANDS, "artibot"}


@pytest.mark.parametrize("word", [*COMMANDS, "artibot"])
def test_each_executable_starts(workspace: Path, tmp_path: Path, word: str) -> None:
    assert call(*sourced(workspace, installed(workspace, word), "--help"), cwd=tmp_path).startswith("Usage: ")


def test_the_installed_package_is_the_one_that_runs(workspace: Path, tmp_path: Path) -> None:
    code = (
        "import artibot_sim.resources as r; from artibot_sim.model import load_robot; load_robot('agriq');"
        f"print(r.__file__, r.config_folder(), {{kind: r.config_names(kind) for kind in {list(KINDS)}}}, sep='\\n')"
    )
    printed = call(*sourced(workspace, sys.executable, "-c", code), cwd=tmp_path).splitlines()
    prefix = workspace / "install" / "artibot_sim"
    assert Path(printed[0]).is_relative_to(prefix)
    assert printed[1] == str(prefix / "share" / "artibot_sim" / "config")
    assert printed[2] == str({kind: config_names(kind) for kind in KINDS})


def test_the_installed_simulator_takes_ros_args(workspace: Path, start_node: NodeStarter, ros_context: Context) -> None:
    from rclpy.node import Node
    from rclpy.qos import qos_profile_sensor_data
    from rosgraph_msgs.msg import Clock

    probe, ticks = Node("probe", context=ros_context), []
    probe.create_subscription(Clock, "clock", ticks.append, qos_profile_sensor_data)
    sim = start_node.run(sourced(workspace, installed(workspace, "sim"), "--ros-args", "-p", "rate:=0"), name="sim")
    spin_until(probe, lambda: len(ticks) > 10 or not sim.running, timeout=60, what="hearing the simulator's clock")
    assert sim.running, sim.output
    assert sim.stop() == 0, sim.output


def test_a_wheel_brings_one_program_and_its_files(source: Path, tmp_path: Path) -> None:
    options = ("--quiet", "--no-deps", "--no-build-isolation", "--wheel-dir", ".")
    call(sys.executable, "-m", "pip", "wheel", *options, source, cwd=tmp_path)
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        (entry_points,) = [name for name in archive.namelist() if name.endswith("entry_points.txt")]
        programs = configparser.ConfigParser()
        programs.read_string(archive.read(entry_points).decode())
        assert dict(programs["console_scripts"]) == {"artibot": "artibot_sim.cli:program"}
        shipped = {name.partition("/data/share/artibot_sim/")[2] for name in archive.namelist()}
        modules = {name for name in archive.namelist() if name.startswith("artibot_sim/")}
    share = [*(source / "config").rglob("*"), *(source / "launch").glob("*"), source / "package.xml"]
    assert {str(path.relative_to(source)) for path in share if path.is_file()} <= shipped
    assert modules == {str(path.relative_to(source)) for path in (source / "artibot_sim").rglob("*.py")}
