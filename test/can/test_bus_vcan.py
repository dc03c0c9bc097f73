"""Bus, safety and recorder on a real SocketCAN: run here where this kernel has vcan0, else in a user-mode one."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from can_kernel import on_vcan

SUITES = sorted(map(str, Path(__file__).parent.glob("suite_*.py")))


@pytest.mark.vcan
def test_on_a_real_vcan() -> None:
    """All in one process: where the kernel is emulated, it takes long to start one."""
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--no-header", *SUITES]
    done = on_vcan(command, "512M", 1200.0)
    print(done.stdout)
    assert done.returncode == 0, done.stdout + done.stderr
    assert " passed" in done.stdout
    assert " skipped" not in done.stdout
