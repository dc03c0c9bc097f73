"""Imports run one way (docs/design), and the light path stays light."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterable

import pytest
from imports import BELOW_ALL, DRIVER, LAYERS, circles, edges, fault, imports_of, modules_below, part_of

from ros_helpers import ROOT

HEAVY = ("scipy", "pandas", "mcap", "rosbags", "matplotlib", "plotly", "rich", "rclpy")


def test_every_import_runs_the_allowed_way() -> None:
    faults = []
    for module, path in modules_below(ROOT):
        source = path.read_text(encoding="utf-8")
        faults += filter(None, map(fault, imports_of(source, module, path.name == "__init__.py")))
    assert not faults, "\n".join(faults)


def test_no_files_import_each_other() -> None:
    graph = edges(ROOT)
    assert len(graph) > 200  # the walk does find them
    assert not circles(graph)


def test_a_circle_of_files_is_seen() -> None:
    graph = {"a": {"b"}, "b": {"c"}, "c": {"b", "d"}, "d": set(), "e": {"e2"}, "e2": {"e"}}
    assert circles(graph) == [["b", "c"], ["e", "e2"]]


def test_every_module_has_its_place() -> None:
    parts = {part_of(module): module for module, _ in modules_below(ROOT)}
    assert {"model", "planning", "experiment", "nodes", "cli", "errors"} <= set(parts)  # the walk does find them
    noise_frames = {module for part, module in parts.items() if part not in ("", DRIVER, *LAYERS, *BELOW_ALL)}
    assert not noise_frames, "name their layer in test/imports.py"


@pytest.mark.parametrize(
    ("module", "line"),
    [
        ("artibot_sim.model.kernels.loop", "from artibot_sim.planning import plan"),
        ("artibot_sim.model.kernels.loop", "from ... import planning"),
        ("artibot_sim.model.kernels.loop", "from ...experiment.reader import read_bag"),
        ("artibot_sim.model.kernels.loop", "def f():\n    import rosbags.rosbag2"),
        ("artibot_sim.planning.plan", "import importlib\nimportlib.import_module('artibot_sim.report')"),
        ("artibot_sim.experiment.reader", "from rclpy.serialization import serialize_message"),
        ("artibot_sim.report.page", "from mcap.reader import make_reader"),
        ("artibot_sim.report.page", "from nav_msgs.msg import Odometry"),
        ("artibot_sim.report.page", "from artibot_sim.bench import run"),
        ("artibot_sim.nodes.sim.command", "import can"),
        ("artibot_sim.nodes.sim.command", "import artibot_sim.cli"),
        ("artibot_sim.errors", "from artibot_sim.model import Robot"),
        ("artibot_sim", "from artibot_sim.model import Robot"),
        ("artibot_sim.identify.fit", "import artibot_driver.bus"),
        ("artibot_driver.bus", "from artibot_sim.experiment import read_bag"),
    ],
)
def test_a_forbidden_import_is_seen(module: str, line: str) -> None:
    assert [fault(found) for found in imports_of(line, module) if fault(found)]


@pytest.mark.parametrize(
    ("module", "line"),
    [
        ("artibot_sim.planning.plan", "from artibot_sim.model import Commands"),
        ("artibot_sim.planning.plan", "from ..model.robot import Robot\nfrom . import legs\nimport yaml"),
        ("artibot_sim.experiment.reader", "import rosbags.rosbag2\nfrom mcap.reader import make_reader"),
        (
            "artibot_sim.nodes.sim.command",
            "import rclpy\nfrom nav_msgs.msg import Path\nimport artibot_driver.drives",
        ),
        ("artibot_sim.bench.comparison", "from artibot_sim.identify import identify"),
        ("artibot_driver.bus", "import can\nfrom artibot_sim.planning import Plan"),
        ("artibot_sim.resources", "from artibot_sim.errors import ArtibotError"),
    ],
)
def test_an_allowed_import_is_let_through(module: str, line: str) -> None:
    found = list(imports_of(line, module))
    assert found
    assert not list(filter(None, map(fault, found)))


def loaded_by(statement: str) -> set[str]:
    """Names of the modules that a fresh interpreter holds after `statement`."""
    code = f"import sys\n{statement}\nprint(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    return set(done.stdout.splitlines()[-1].split())


def among(loaded: set[str], libraries: Iterable[str]) -> set[str]:
    """Those of the modules that belong to the libraries."""
    return {name for name in loaded if name.partition(".")[0] in libraries}


def test_the_model_is_light() -> None:
    loaded = loaded_by("import artibot_sim.model")
    assert "numba" in loaded
    # numba asks scipy for its version, a matter of 10 ms, and later for this one module (see model/compiled.py);
    # the rest of scipy must not come with them
    light = loaded_by("import numba") | {"scipy.linalg.cython_blas"}
    assert not among(loaded - light, {*HEAVY, "click"})


def test_planning_is_light() -> None:
    assert not among(loaded_by("import artibot_sim.planning"), {*HEAVY} - {"scipy"})


def test_a_view_of_a_recording_imports_no_diagnosis() -> None:
    """It is a second of the three in which the page is to be there."""
    loaded = loaded_by("import artibot_sim.view.frames, artibot_sim.nodes.view.command")
    assert "artibot_sim.view.frames" in loaded
    assert "artibot_sim.diagnose" not in loaded


def test_the_command_line_imports_no_command() -> None:
    loaded = loaded_by("from artibot_sim.cli import main\nassert main(['--help']) == 0")
    assert "click" in loaded
    assert not among(loaded, {*HEAVY, "numpy", "numba", "yaml"})
