"""The suite of faults around the driver node on a real SocketCAN: here where there is vcan0, else in a user-mode one.

``ARTIBOT_TRIALS`` and ``ARTIBOT_SEED`` count as for the loopback bus.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest
from can_kernel import on_vcan

from ros_helpers import ROOT

SUITE = Path(__file__).with_name("node_on_vcan.py")
TRIALS = os.environ.get("ARTIBOT_TRIALS", "1")


@pytest.mark.vcan
def test_faults_around_the_node_on_a_real_vcan(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("rclpy", reason="rclpy is not installed; run `make setup`, or source a ROS 2 Jazzy")
    monkeypatch.setenv("ARTIBOT_TRIALS", TRIALS)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    command = [sys.executable, "-m", "pytest", "-q", "-s", "-p", "no:cacheprovider", "--no-header", str(SUITE)]
    timeout = 300.0 + 60.0 * 6 * int(TRIALS)
    done = on_vcan(command, "1200M", timeout)
    print(done.stdout)
    assert done.returncode == 0, done.stdout + done.stderr
    assert " passed" in done.stdout
    assert " skipped" not in done.stdout
