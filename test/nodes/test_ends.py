"""A node that has ended leaves no thread and no handle of the middleware while the process takes itself down."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from bag_helpers import small_bag

from artibot_driver.loopback import loopback_bus
from ros_helpers import NodeStarter

LISTED = """
import gc
import sys
import threading
from pathlib import Path
from artibot_sim.cli import program

status = program()
gc.unfreeze()  # what a loop froze is not listed
held = {f"{type(one).__module__}.{type(one).__name__}" for one in gc.get_objects()}
print("held:", *(name for name in held if name.startswith("rclpy.")))
print("python:", *(one.name for one in threading.enumerate()))
print("left:", *{path.read_text().strip() for path in Path("/proc/self/task").glob("*/comm")})
sys.exit(status)
"""
"""Does what `artibot` does, and says which objects of rclpy and which threads are left."""
COUNTED = """
import os
from artibot_sim.nodes.common.process import ros_process

with ros_process("counted", ()):
    meanwhile = len(os.listdir("/proc/self/task"))
print(meanwhile - len(os.listdir("/proc/self/task")))
"""
"""Initialises rclpy, ends it, and says how many of its threads ended with it."""

ASKED_EARLY = """
import importlib.machinery
import os
import signal
import sys
from artibot_sim.cli import program

create = importlib.machinery.ExtensionFileLoader.create_module

def asked(loader, spec):
    if spec.name.endswith("_rclpy_pybind11"):
        os.kill(os.getpid(), signal.SIGINT)
    return create(loader, spec)

importlib.machinery.ExtensionFileLoader.create_module = asked
sys.exit(program())
"""
"""Does what `artibot` does, and gets a signal while rclpy's extension is being imported."""

HANDLES = {
    "Node", "LifecycleNode", "SingleThreadedExecutor", "Context", "Publisher", "Subscription", "Service", "Client",
    "Timer", "GuardCondition",
}  # fmt: skip
"""Classes of rclpy whose objects hold parts of the middleware."""

PROCESS_S = {"dds.shm.wdog", "dds.log"}
"""Those that belong to the library, which ends them itself, and to no node."""

REFUSED = {
    "driver": ("--kappa", "0.3"),
    "sim": ("--ros-args", "-p", "kappa:=7.0"),
    "planner": ("--ros-args", "-p", "manoeuvre:=nowhere"),
}
"""What a node refuses when it already is a participant of the middleware."""

STARTED = {"sim": "is ready", "driver": "driver on", "record": "recording to"}
"""What a node says once it runs, where it has to be told to end."""


@pytest.mark.parametrize("word", ["sim", "driver", "planner", "record", "replay"])
def test_no_thread_of_the_middleware_is_left(start_node: NodeStarter, tmp_path: Path, word: str) -> None:
    with loopback_bus() as channel:
        given = {
            "sim": [],
            "driver": ["--channel", channel],
            "planner": ["--subscriber-timeout", "0.1"],
            "record": ["-o", str(tmp_path / "run")],
            "replay": [str(small_bag(tmp_path / "made", 2))],
        }
        node = start_node.run([sys.executable, "-c", LISTED, word, *given[word]], name=word)
        if word in STARTED:
            node.wait_for(STARTED[word])
            node.stop()
        node.wait()
    assert not threads_of_the_middleware(node.output)
    assert said(node.output, "python") == {"MainThread"}
    assert not {name for name in said(node.output, "held") if name.split(".")[-1] in HANDLES}


def test_nor_a_thread_of_its_own_after_a_profile_was_followed(start_node: NodeStarter) -> None:
    """A driver reads profiles beside its loop; it ends by a signal while it follows one."""
    with loopback_bus() as channel:
        start_node("drives", "--bench", "--channel", channel)
        command = [sys.executable, "-c", LISTED, "driver", "--channel", channel, "--enable"]
        node = start_node.run(command, name="driver")
        node.wait_for("[driver]: enabled", 60.0)
        start_node("planner", "short")
        node.wait_for("profile accepted", 60.0)
        assert node.stop(20.0) == 0
    assert said(node.output, "python") == {"MainThread"}
    assert not threads_of_the_middleware(node.output)
    assert not {name for name in said(node.output, "held") if name.split(".")[-1] in HANDLES}


def test_the_thread_in_which_rclpy_waits_for_signals_ends_with_it(start_node: NodeStarter) -> None:
    """It has one even where it is to handle none, and would leave it to exit handlers."""
    process = start_node.run([sys.executable, "-c", COUNTED])
    assert process.wait() == 0
    assert process.output.split() == ["1"]


@pytest.mark.parametrize("word", ["sim", "record"])
def test_a_signal_during_the_import_of_rclpy_is_a_wish_to_end(
    start_node: NodeStarter, tmp_path: Path, word: str
) -> None:
    """Raised in the midst of it, KeyboardInterrupt may come out as an ImportError, with a page of traceback."""
    given = ("-o", str(tmp_path / "run")) if word == "record" else ()
    node = start_node.run([sys.executable, "-c", ASKED_EARLY, word, *given], name=word)
    assert node.wait() == 0, node.output
    assert "Traceback" not in node.output


@pytest.mark.parametrize("word", REFUSED)
def test_a_node_that_refuses_a_parameter_leaves_none_either(start_node: NodeStarter, word: str) -> None:
    node = start_node.run([sys.executable, "-c", LISTED, word, *REFUSED[word]], name=word)
    assert node.wait() == 2
    assert not threads_of_the_middleware(node.output)


def test_ends_among_neighbours_that_come_and_go_are_counted_by_their_status() -> None:
    """The command with which the page's figures are found."""
    words = [sys.executable, "-m", "artibot_sim.nodes.driver.ends", "2", "--at-once", "1"]
    done = subprocess.run(
        [*words, "--situation", "parameter refused"], capture_output=True, text=True, timeout=900, check=False
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == {"situation": "parameter refused", "ends": {"status 2": 2}, "crashes": []}


def threads_of_the_middleware(output: str) -> set[str]:
    """Those of a node among the threads that are left."""
    left = said(output, "left")
    assert left
    return {name for name in left if name.startswith("dds.")} - PROCESS_S


def said(output: str, what: str) -> set[str]:
    """Words of a line."""
    (line,) = [line for line in output.splitlines() if line.startswith(f"{what}:")]
    return set(line.partition(":")[2].split())
