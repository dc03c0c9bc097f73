"""What each command needs: the plain simulator no more than rosdep gives, all else named with its mend."""

from __future__ import annotations

import importlib.metadata
import os
import re
import subprocess
import sys
import venv
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from artibot_sim.cli import PACKAGES
from ros_helpers import ROOT, NodeStarter, skip, spin_until

if TYPE_CHECKING:
    from rclpy.context import Context

PLAIN = ("ros-jazzy-rclpy", "ros-jazzy-rmw-fastrtps-cpp", "ros-jazzy-common-interfaces", "numpy", "scipy", "numba")
"""What a plain simulation may need: ROS 2 (rclpy brings PyYAML), and the compiled model."""

WITH_OPTIONS = (*PLAIN, "click")
"""What reads command lines, too."""

ROSDEP = {
    "python3-can": "python-can",
    "python3-click": "click",
    "python3-matplotlib": "matplotlib",
    "python3-numba": "numba",
    "python3-numpy": "numpy",
    "python3-rich": "rich",
    "python3-scipy": "scipy",
    "python3-yaml": "pyyaml",
    "canopen-pip": "canopen",
    "python3-rosbags-pip": "rosbags",
}
"""rosdep's key → the package on PyPI that it stands for."""


def closure(names: tuple[str, ...]) -> Iterator[importlib.metadata.Distribution]:
    """The distributions that `names` need, themselves included."""
    waiting, known = [*names, *(("ros-rclpy",))], set()
    while waiting:
        name = re.sub(r"[-_.]+", "-", waiting.pop()).lower()
        if name in known:
            continue
        known.add(name)
        try:
            found = importlib.metadata.distribution(name)
        except importlib.metadata.PackageNotFoundError:
            continue
        yield found
        for line in found.requires or ():
            requirement, _, marker = line.partition(";")
            # of the extras only the middleware's, which rclpy[fastrtps] asks for
            if "extra" not in marker or "fastrtps" in marker:
                waiting.append(re.split(r"[\s\[<>=!~(]", requirement.strip())[0])


def environment_of(names: tuple[str, ...], folder: Path) -> Path:
    """Python of a new virtual environment that has nothing but `names` and what they need, linked from this one."""
    try:
        found = list(closure(names))
        importlib.metadata.distribution("ros-jazzy-rclpy")
    except importlib.metadata.PackageNotFoundError:
        skip("ROS 2 is not from PyPI here, and cannot be had without the rest of this environment")
    venv.EnvBuilder(with_pip=False, symlinks=True).create(folder)
    (site,) = folder.glob("lib/python*/site-packages")
    prefix = Path(sys.prefix).resolve()
    here = prefix / site.relative_to(folder)
    for distribution in found:
        for file in distribution.files or ():
            inside = Path(os.path.normpath(here / file)).relative_to(prefix)
            # a package's folder in site-packages, a library beside it, a folder of data: linked as a whole
            depth = len(site.relative_to(folder).parts) + 1 if inside.is_relative_to(site.relative_to(folder)) else 2
            top = Path(*inside.parts[:depth])
            if inside.parts[0] != "bin" and "__pycache__" not in top.parts and not (folder / top).exists():
                (folder / top).parent.mkdir(parents=True, exist_ok=True)
                (folder / top).symlink_to(prefix / top)
    return folder / "bin" / "python"


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return environment_of(PLAIN, tmp_path_factory.mktemp("plain") / "venv")


@pytest.fixture(scope="module")
def bare(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return environment_of(WITH_OPTIONS, tmp_path_factory.mktemp("bare") / "venv")


def run(python: Path, *args: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    command = [str(python), "-m", "artibot_sim.cli", *map(str, args)]
    env = {"PYTHONPATH": str(ROOT), "PATH": "/usr/bin:/bin", "HOME": str(cwd)}
    return subprocess.run(command, cwd=cwd, env=env, capture_output=True, text=True, timeout=300, check=False)


def test_the_environments_are_bare(plain: Path, bare: Path, tmp_path: Path) -> None:
    code = f"import importlib.util as u; print(*[m for m in {sorted(PACKAGES)!r} if u.find_spec(m)])"
    for python, there in ((plain, "numba numpy scipy yaml"), (bare, "click numba numpy scipy yaml")):
        done = subprocess.run(
            [python, "-c", code], capture_output=True, text=True, check=True, timeout=60, cwd=tmp_path
        )
        assert done.stdout.strip() == there


def test_the_plain_simulator_and_planner_run_with_ros_and_the_compiled_model_alone(
    plain: Path, start_node: NodeStarter, ros_context: Context
) -> None:
    from nav_msgs.msg import Odometry
    from rclpy.node import Node

    node, truths = Node("probe", context=ros_context), []
    node.create_subscription(Odometry, "ground_truth/odom", truths.append, 10)
    start = [str(plain), "-m", "artibot_sim.cli"]
    sim = start_node.run([*start, "sim", "--ros-args", "-p", "kappa:=0.8"], name="sim")
    planner = start_node.run([*start, "planner", "--ros-args", "-p", "manoeuvre:=short"], name="planner")
    spin_until(node, lambda: bool(truths) or not sim.running, 120.0, "the simulator")
    assert sim.running, sim.output
    spin_until(node, lambda: truths[-1].pose.pose.position.x > 0.5 or not planner.running, 60.0, "motion")
    assert truths[-1].pose.pose.position.x > 0.5, planner.output
    assert sim.stop() == 0, sim.output


@pytest.mark.parametrize("args", [("sim", "--kappa", "0.8"), ("driver",), ("plot", "bag"), ("--help",), ()])
def test_where_click_is_missing_it_is_named_with_the_command_that_installs_it(
    plain: Path, tmp_path: Path, args: tuple[str, ...]
) -> None:
    done = run(plain, *args, cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr == f"artibot: click: not found; this command needs it: {plain} -m pip install click\n"


@pytest.mark.parametrize(
    ("args", "missing"),
    [
        (("sim", "--with-driver"), "canopen"),
        (("driver",), "can"),
        (("drives",), "canopen"),
        (("recover", "{bag}"), "mcap"),
        (("plot", "{bag}"), "mcap"),
        (("identify", "{bag}", "--robot", "agriq", "--out", "soil.yaml"), "rich"),
    ],
    ids=lambda value: value if isinstance(value, str) else value[0],
)
def test_what_is_missing_is_named_with_the_command_that_installs_it(
    bare: Path, tmp_path: Path, args: tuple[str, ...], missing: str
) -> None:
    bag = ROOT / "bags" / "table6_agriq"
    done = run(bare, *(arg.format(bag=bag) for arg in args), cwd=tmp_path)
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    line = done.stderr.strip().splitlines()[-1]
    package = PACKAGES[missing]
    assert line == f"artibot: {missing}: not found; this command needs it: {bare} -m pip install {package}"


@pytest.mark.parametrize(
    ("there", "args", "missing"),
    [
        (("rich", "mcap", "zstandard", "lz4"), ("plot", "{bag}", "--html", "page.html"), "rosbags"),
        (("rich", "mcap", "zstandard", "lz4", "rosbags"), ("plot", "{bag}", "--html", "page.html"), "plotly"),
        (("rich", "mcap", "zstandard", "lz4", "rosbags"), ("export", "{bag}", "--to", "parquet"), "pyarrow"),
        (("mcap", "zstandard", "lz4"), ("record", "--can", "vcan0"), "can"),
        (("rich", "python-can"), ("driver", "--interface", "remote", "--channel", "ws://127.0.0.1:1/"), "can_remote"),
    ],
    ids=lambda value: value if isinstance(value, str) else value[0],
)
def test_so_is_what_only_some_options_need(
    tmp_path: Path, there: tuple[str, ...], args: tuple[str, ...], missing: str
) -> None:
    """With all else that the command needs."""
    python, bag = environment_of((*WITH_OPTIONS, *there), tmp_path / "venv"), ROOT / "bags" / "table6_agriq"
    done = run(python, *(arg.format(bag=bag) for arg in args), cwd=tmp_path)
    assert done.returncode == 2, done.stderr
    wanted = f"artibot: {missing}: not found; this command needs it: {python} -m pip install {PACKAGES[missing]}"
    assert done.stderr.strip().splitlines()[-1] == wanted


def test_topics_alone_are_recorded_and_replayed_without_what_can_needs(tmp_path: Path) -> None:
    python = environment_of((*WITH_OPTIONS, "mcap", "zstandard", "lz4", "rosbags"), tmp_path / "venv")
    done = run(python, "record", "-o", "bag", "--duration", "0.2", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "bag" / "metadata.yaml").is_file()
    done = run(python, "replay", ROOT / "bags" / "table6_agriq", "--wait", 0, "--end", 0.1, cwd=tmp_path)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("word", ["sim", "planner", "driver", "record", "replay", "recover", "plot", "diagnose"])
def test_every_help_is_there_without_what_its_command_needs(bare: Path, tmp_path: Path, word: str) -> None:
    done = run(bare, word, "--help", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("Usage")


def required() -> set[str]:
    """Packages that setup.py requires."""
    text = (ROOT / "setup.py").read_text()
    listed = re.search(r"install_requires=\[(.*?)\]", text, re.DOTALL)
    assert listed
    return set(re.findall(r'"([a-z-]+)', listed[1]))


def test_rosdep_and_one_documented_command_install_all_that_is_required() -> None:
    depends = {each.text for each in ET.parse(ROOT / "package.xml").getroot().iter("exec_depend")}
    from_rosdep = {ROSDEP[key] for key in depends if key in ROSDEP}
    undeclared = {key for key in depends if key and key.startswith("python3") and key not in ROSDEP}
    assert not undeclared
    command = re.search(r"^python3 -m pip install (.+?)(?:\s+#.*)?$", (ROOT / "README.md").read_text(), re.MULTILINE)
    assert command
    assert from_rosdep | set(command[1].split()) == required()
    assert not from_rosdep & set(command[1].split())
