"""Computing that makes way: it and its children have the lowest priority there is, and are as usual again when told."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

SCRIPT = Path(__file__).parents[1] / "scripts" / "priority.py"
CHILD = "import os, sys; sys.stdin.readline(); print(os.sched_getscheduler(0), flush=True); sys.stdin.readline()"
PARENT = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {CHILD!r}])"


def test_a_command_and_its_children_make_way_until_they_are_told() -> None:
    mine = os.sched_getscheduler(0)
    command = [sys.executable, str(SCRIPT), "low", sys.executable, "-c", PARENT]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, start_new_session=True, **pipes) as group:  # type: ignore[call-overload]
        group.stdin.write("\n")
        group.stdin.flush()
        assert int(group.stdout.readline()) == os.SCHED_IDLE
        assert os.sched_getscheduler(group.pid) == os.SCHED_IDLE
        subprocess.run([sys.executable, str(SCRIPT), "usual", str(group.pid)], check=True)
        allowed = os.geteuid() == 0  # others stay as they are, unless the machine's limits let them
        if allowed:
            assert os.sched_getscheduler(group.pid) == os.SCHED_OTHER
        group.stdin.write("\n")
        group.stdin.flush()
        assert group.wait(30) == 0
    assert os.sched_getscheduler(0) == mine, "nobody else is touched"
