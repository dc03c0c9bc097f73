"""The system clock is set while a simulator runs on it: stamps follow forward, and never go back."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
import pytest
from sim_probe import Probe, stamp_ns

SET_CLOCK = """
import sys, time
from pathlib import Path

read, offset = time.time_ns, Path(sys.argv[1])
time.time_ns = lambda: read() + int(offset.read_text())
from artibot_sim.cli import program
sys.argv[1:] = ["sim"]
sys.exit(program())
"""
"""A simulator whose system clock is off by what stands in a file, ns."""


@pytest.mark.parametrize("set_by", [3.0, -3.0])
def test_stamps_follow_forward_and_never_go_back(start_node, ros_context, tmp_path: Path, set_by: float) -> None:
    offset = tmp_path / "offset"
    offset.write_text("0")
    node = start_node.run([sys.executable, "-c", SET_CLOCK, str(offset)], name="sim")
    probe = Probe(ros_context, ["odom"])
    probe.ready()
    probe.clear()
    probe.spin(0.5)
    part = offset.with_suffix(".part")
    part.write_text(f"{round(set_by * 1e9)}")
    part.replace(offset)
    node.wait_for("the system clock was set " + ("forward by 3.0" if set_by > 0 else "back: stamps never go back"))
    probe.spin(0.5)
    stamps = np.array([stamp_ns(message) for message in probe.got["odom"]])
    steps = np.diff(stamps)
    assert (steps > 0).all(), "stamps never go back"
    ahead = (stamps[-1] - time.time_ns()) * 1e-9
    assert ahead == pytest.approx(max(set_by, 0.0), abs=0.5)
    assert np.median(steps) == 10_000_000
    assert ((steps > 2_900_000_000).sum() == 1) == (set_by > 0), "one jump forward, none back"
    assert node.output.count("the system clock was set") == 1
