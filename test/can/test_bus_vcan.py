"""The bus suite on a real SocketCAN: run here where this kernel has vcan0, else in a user-mode kernel."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from can_kernel import on_vcan

SUITES = sorted(Path(__file__).parent.glob("suite_*.py"))


@pytest.mark.vcan
@pytest.mark.parametrize("suite", SUITES, ids=[path.stem for path in SUITES])
def test_on_a_real_vcan(suite: Path) -> None:
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--no-header", str(suite)]
    done = on_vcan(command)
    assert done.returncode == 0, done.stdout + done.stderr
    assert " passed" in done.stdout
    assert " skipped" not in done.stdout
