"""Planner, driver, CAN, drives, model, CAN, driver: real processes on a real bus, judged by truth and by frames.

The bus is the loopback one; what python-can's own logger writes of it, in candump's format, is held to eq. 30. The same
on a kernel's CAN with candump itself: test/can/test_eq30_vcan.py.
"""

from __future__ import annotations

import math
import re
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from eq30_log import check

from artibot_driver.loopback import loopback_bus
from artibot_sim.model import Mode, Rollout, load_robot, rollout
from artibot_sim.planning import Plan, load_manoeuvre, plan
from ros_helpers import ROOT

pytest.importorskip("rclpy", reason="rclpy is not installed; run `make setup`, or source a ROS 2 Jazzy")

from driver_probe import PATIENT
from sim_probe import Probe, stamp_ns

AGRIQ = load_robot("agriq")


def short_table6(folder: Path) -> Path:
    """Table 6 with both three-quarter circles cut to a sixth."""
    text = (ROOT / "config" / "manoeuvres" / "table6_agriq.yaml").read_text(encoding="utf-8")
    assert text.count("270.0") == 2
    path = folder / "table6.yaml"
    path.write_text(text.replace("270.0", "60.0"), encoding="utf-8")
    return path


def test_what_is_planned_is_driven_through_can_as_by_topics(start_node, ros_context, tmp_path: Path) -> None:
    kappa = "0.65"  # and 0.8 beside it on a kernel's CAN
    manoeuvre = short_table6(tmp_path)
    planned, log = plan(load_manoeuvre(str(manoeuvre)), AGRIQ), tmp_path / "frames.log"
    with loopback_bus() as channel:
        sim = start_node("sim", "--with-driver", "--channel", channel, "--publish-rate", 50)
        sim.wait_for("is ready for a driver", 60)
        logger = start_node.run(
            [sys.executable, "-m", "can.logger", "-i", "remote", "-c", channel, "-f", str(log)], name="logger"
        )
        logger.wait_for("Connected to", 30)
        driver = start_node("driver", "--channel", channel, "--kappa", kappa, "--enable", *PATIENT)
        driver.wait_for("[driver]: enabled", 60)
        probe = Probe(ros_context)
        probe.until(lambda: all(probe.got.values()), "the truth")
        planner = start_node("planner", manoeuvre)
        probe.until(lambda: not planner.running, "the planner's end", 90)
        assert planner.wait() == 0
        probe.spin(1.0)
        probe.until(lambda: time.time_ns() - stamp_ns(probe.last()) < 100_000_000, "the newest pose")
        assert "stopped" not in driver.output, driver.output
        for node in (driver, logger, sim):
            node.stop()
    begun = float(re.search(r"starts at (\d+\.\d+)", planner.output)[1])  # type: ignore[index]
    t = np.array([stamp_ns(message) * 1e-9 - begun for message in probe.got["ground_truth/odom"]])
    pose = [message.pose.pose.position for message in probe.got["ground_truth/odom"]]
    driven = np.array([(each.x, each.y) for each in pose])
    far, lag = deviation(t, driven, by_topics(planned, float(kappa)))
    # where the curvature jumps the yaw rate changes by 1 rad/s within a SYNC period of 10 ms: 0.01 rad for 10 m
    assert far < 0.1, (far, lag)
    assert -0.05 < lag < 0.1, (far, lag)
    assert math.hypot(*(driven[-1] - planned.pose[-1, :2])) > 2 * far  # slip is more than that
    assert t[-1] > planned.duration
    assert np.ptp(driven[t > planned.duration + 0.2], axis=0).max() < 0.01  # and there it stands

    verdict = check(log.read_text(encoding="utf-8").splitlines(), str(ROOT / "config" / "agriq.yaml"), kappa)
    assert not verdict.wrong and not verdict.stale, verdict
    assert verdict.checked + verdict.late > 100 * planned.duration * 0.8, verdict
    assert verdict.checked > 250, verdict
    assert verdict.largest > 100, verdict


def by_topics(planned: Plan, kappa: float) -> Rollout:
    """The same commands as `sim --front-mode driven` follows them: limited front torques, eq. 30 one step old."""
    modes = (Mode.DRIVEN, Mode.DRIVEN, Mode.TORQUE, Mode.TORQUE)
    return rollout(AGRIQ, planned.commands(), kappa=kappa, modes=modes, duration=planned.duration + 2.0)


def deviation(t: np.ndarray, driven: np.ndarray, expected: Rollout) -> tuple[float, float]:
    """Largest distance between both drives at the lag at which it is smallest, and that lag (m, s)."""
    during = (t > 0.2) & (t < expected.t[-1] - 0.3)
    assert during.sum() > 600
    found = []
    for lag in np.arange(-0.06, 0.12, 0.002):
        x, y = (np.interp(t[during] - lag, expected.t, expected.pose[:, axis]) for axis in (0, 1))
        found.append((float(np.hypot(driven[during, 0] - x, driven[during, 1] - y).max()), float(lag)))
    return min(found)
