"""The bus suite on a real SocketCAN: run here where this kernel has vcan0, else in a user-mode kernel."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from can_kernel import has_vcan, in_uml

from ros_helpers import ROOT

SUITES = sorted(Path(__file__).parent.glob("suite_*.py"))


@pytest.mark.vcan
@pytest.mark.parametrize("suite", SUITES, ids=[path.stem for path in SUITES])
def test_on_a_real_vcan(suite: Path) -> None:
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--no-header", str(suite)]
    if has_vcan():
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=600, check=False)
    else:
        done = in_uml("-r", "70", *command, timeout=600)  # the bus keeps real time, whatever else runs
    assert done.returncode == 0, done.stdout + done.stderr
    assert " passed" in done.stdout
    assert " skipped" not in done.stdout
