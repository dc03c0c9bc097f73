"""The demo, as ``make demo`` runs it but shorter: it succeeds, leaves results and no process behind."""

from __future__ import annotations

import sys
import uuid
from pathlib import Path

import pytest

from ros_helpers import NodeStarter

MARK = "ARTIBOT_TEST_MARK"


def processes_with(mark: str) -> list[str]:
    """Command lines of all processes whose environment holds `mark`, whatever their session or parent."""
    found = []
    for folder in Path("/proc").iterdir():
        if not folder.name.isdigit():
            continue
        try:
            environment, command = (folder / "environ").read_bytes(), (folder / "cmdline").read_bytes()
        except OSError:  # it ended meanwhile, or is another user's
            continue
        if f"{MARK}={mark}".encode() in environment.split(b"\0"):
            found.append(command.replace(b"\0", b" ").decode(errors="replace"))
    return found


@pytest.mark.install
def test_the_short_demo_leaves_results_and_no_process(start_node: NodeStarter, tmp_path: Path) -> None:
    mark, out = uuid.uuid4().hex, tmp_path / "demo"
    command = [sys.executable, "-m", "artibot_sim.nodes.demo", "--short", "--out", str(out)]
    demo = start_node.run(command, name="demo", env={MARK: mark})
    assert processes_with(mark)  # so that an empty list at the end means something
    assert demo.wait(timeout=300) == 0, demo.output
    assert not processes_with(mark)
    assert list(out.rglob("*.mcap"))
    assert list(out.rglob("*.png"))
