"""The demo, as ``make demo`` runs it but shorter: it succeeds, leaves results, and no process whatever happens."""

from __future__ import annotations

import io
import os
import signal
import sys
import time
import uuid
from collections.abc import Callable
from pathlib import Path

import pytest

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment import bag_info, read_bag
from artibot_sim.nodes.demo.domain import reserved_domain
from artibot_sim.nodes.demo.result import PAPER, lacks, read_result, result_table
from ros_helpers import ROOT, NodeProcess, NodeStarter

MARK = "ARTIBOT_TEST_MARK"
StartDemo = Callable[[Path], NodeProcess]


@pytest.fixture
def mark() -> str:
    """A value of the environment variable `MARK` that is in no other process."""
    return uuid.uuid4().hex


@pytest.fixture
def start_demo(start_node: NodeStarter, mark: str) -> StartDemo:
    """Starts the short demo with results in a folder; all its processes carry the mark."""

    def start(out: Path) -> NodeProcess:
        command = [sys.executable, "-m", "artibot_sim.cli", "demo", "--short", "--out", str(out)]
        before = signal.signal(signal.SIGHUP, signal.SIG_DFL)  # nohup's would be inherited, and the demo heeds it
        try:
            return start_node.run(command, name="demo", env={MARK: mark})
        finally:
            signal.signal(signal.SIGHUP, before)

    return start


def processes_with(mark: str) -> dict[int, str]:
    """Ids and command lines of all processes whose environment holds `mark`, whatever their session or parent."""
    found = {}
    for folder in Path("/proc").iterdir():
        if not folder.name.isdigit():
            continue
        try:
            environment, command = (folder / "environ").read_bytes(), (folder / "cmdline").read_bytes()
        except OSError:  # it ended meanwhile, or is another user's
            continue
        if f"{MARK}={mark}".encode() in environment.split(b"\0"):
            found[int(folder.name)] = command.replace(b"\0", b" ").decode(errors="replace")
    return found


@pytest.mark.install
def test_the_short_demo_leaves_results_and_no_process(start_demo: StartDemo, mark: str, tmp_path: Path) -> None:
    out = tmp_path / "results"
    demo = start_demo(out)
    demo.wait_for("] Driver", timeout=120)
    assert len(processes_with(mark)) >= 3  # so that an empty one at the end means something
    assert demo.wait(timeout=300) == 0, demo.output
    assert not processes_with(mark)
    assert "ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST" in demo.output, "who joins by hand leaves the machine neither"
    assert (out / "drive.png").read_bytes().startswith(b"\x89PNG")
    assert b"<html" in (out / "drive.html").read_bytes()[:1000].lower()
    recorded = read_bag(out / "short")
    assert recorded.metadata["robot"] == "agriq"
    assert set(recorded.channels) >= {"planned_path", "planned_front_velocity", "planned_odom", "motor_torques"}
    assert "/diagnostics" in recorded.topics  # the driver's: it was in the loop
    moving = ("/clock", "/planned/front_velocity")  # a replay has its own clock, and moves no rover
    counts = [c.message_count for c in bag_info(out / "short").channels if c.topic not in moving]
    assert f"{sum(counts)} messages came again on {len(counts)} topics, each the same to the byte" in demo.output
    assert "yaw error e_γ (eq. 31)" in demo.output
    for word in ("sim", "driver", "record", "planner", "replay", "plot"):
        assert f"$ artibot {word} " in demo.output


@pytest.mark.install
@pytest.mark.parametrize(
    ("number", "when"), [(signal.SIGTERM, "Simulator"), (signal.SIGINT, "Planner"), (signal.SIGHUP, "Recorder")]
)
def test_a_signal_ends_everything_and_keeps_nothing(
    start_demo: StartDemo, mark: str, tmp_path: Path, number: signal.Signals, when: str
) -> None:
    out = tmp_path / "results"
    demo = start_demo(out)
    demo.wait_for(f"] {when}", timeout=180)
    demo.send(number)
    assert demo.wait(timeout=30) == 128 + number, demo.output
    assert not processes_with(mark)
    assert not out.exists()
    assert f"ended by {number.name}" in demo.output


@pytest.mark.install
def test_even_killed_it_leaves_no_process(start_demo: StartDemo, mark: str, tmp_path: Path) -> None:
    demo = start_demo(tmp_path / "results")
    demo.wait_for("] Planner", timeout=180)
    demo.send(signal.SIGKILL)
    demo.wait()
    deadline = time.monotonic() + 20
    while processes_with(mark) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not processes_with(mark)


@pytest.mark.install
def test_when_a_node_dies_its_last_words_are_shown(start_demo: StartDemo, mark: str, tmp_path: Path) -> None:
    out = tmp_path / "results"
    demo = start_demo(out)
    demo.wait_for("] Planner", timeout=180)
    (sim,) = [pid for pid, command in processes_with(mark).items() if "artibot_sim.cli sim" in command]
    os.kill(sim, signal.SIGKILL)
    assert demo.wait(timeout=30) == 1, demo.output
    assert not processes_with(mark)
    assert "ended by SIGKILL" in demo.output
    assert "is ready for a driver" in demo.output
    assert list((out / "logs").glob("*.log"))


@pytest.mark.install
def test_a_robot_without_drives_data_is_moved_by_topics(start_node: NodeStarter, mark: str, tmp_path: Path) -> None:
    command = [
        sys.executable,
        "-m",
        "artibot_sim.cli",
        "demo",
        "--short",
        "--robot",
        "epiq",
        "--out",
        str(tmp_path / "e"),
    ]
    demo = start_node.run(command, name="demo", env={MARK: mark})
    assert demo.wait(timeout=300) == 0, demo.output
    assert "[5/5]" in demo.output
    assert "artibot driver" not in demo.output
    assert read_bag(tmp_path / "e" / "short").metadata["robot"] == "epiq"


def test_a_kappa_that_the_motors_do_not_allow_is_refused(start_node: NodeStarter, tmp_path: Path) -> None:
    demo = start_node("demo", "--kappa", 0.6, "--out", tmp_path / "results")
    assert demo.wait() == 2
    assert "kappa: found 0.6, expected 0.622 to 1" in demo.output
    assert not (tmp_path / "results").exists()


def test_results_are_never_overwritten(start_demo: StartDemo, tmp_path: Path) -> None:
    demo = start_demo(tmp_path)
    assert demo.wait() == 2
    assert "never overwritten" in demo.output
    assert not (tmp_path / "logs").exists()


def test_a_domain_is_given_to_one_at_a_time() -> None:
    with reserved_domain() as first, reserved_domain() as second:
        assert first != second
    with reserved_domain(7) as wanted:
        assert wanted == 7


def test_all_domains_in_use_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("artibot_sim.nodes.demo.domain._silent", lambda domain: False)
    with pytest.raises(ArtibotError, match="all in use"), reserved_domain():
        pass


@pytest.mark.parametrize(("name", "duration"), [("table6_agriq", 28.85), ("table6_epiq", 17.42)])
def test_the_figures_stand_beside_table_7(name: str, duration: float) -> None:
    from rich.console import Console

    result, robot = read_result(ROOT / "bags" / name), name.partition("_")[2]
    assert not lacks(result, duration)
    assert lacks(result, duration + 1) == "the drive is not whole"
    console = Console(width=160, record=True, file=io.StringIO())
    console.print(result_table(result, robot, 0.8, duration, 25.85, paper=True))
    text = console.export_text()
    for figure in PAPER[robot][0.8]:
        assert f"{figure:.2f} %" in text
    assert f"{100 * result.measures.e_gamma['true']:.2f} %" in text
    assert str(result.messages) in text
