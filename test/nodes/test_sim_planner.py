"""Simulator and planner as they are used: two processes, a profile, and the sign of life between them."""

from __future__ import annotations

import signal
from pathlib import Path

import numpy as np
import pytest
from nav_msgs.msg import Odometry
from sim_probe import Probe, stamp_ns

from artibot_sim.model import load_robot, rollout
from artibot_sim.planning import load_manoeuvre, plan

BEND = """
a_max_m_s2: 1.0
segments:
  - straight: {length_m: 0.6, speed_m_s: 0.5}
  - arc: {radius_m: 1.0, angle_deg: 90.0}
  - straight: {length_m: 0.6, speed_m_s: 0.5, end_speed_m_s: 0.0}
"""


@pytest.fixture
def bend(tmp_path: Path) -> Path:
    path = tmp_path / "bend.yaml"
    path.write_text(BEND)
    return path


def test_a_planned_manoeuvre_is_the_models_rollout(start_node, ros_context, bend: Path) -> None:
    """Held clock, full speed, real planner: what comes out is what the library computes."""
    node = start_node("sim", "--rate", 0, "--wait-for-profile", "--duration", 12)
    probe = Probe(ros_context, ["ground_truth/odom", "motor_command"], reliable=True)
    node.wait_for("is ready", 60.0)
    probe.spin(0.5)
    planner = start_node("planner", "--manoeuvre", bend, "--use-sim-time")
    probe.until(lambda: not node.running, "the end", 90.0)
    probe.spin(0.3)
    assert node.wait() == 0, node.output
    robot = load_robot("agriq")
    expected = rollout(robot, plan(load_manoeuvre(str(bend)), robot, dt=0.01).commands())
    moving = [stamp_ns(m) for m in probe.got["motor_command"] if m.velocity[0] > 0]
    start_ns = min(moving) - 10_000_000
    found = {stamp_ns(m): m.pose.pose.position for m in probe.got["ground_truth/odom"]}
    error = [
        np.hypot(found[t].x - x, found[t].y - y)
        for t, (x, y, _) in zip(start_ns + np.round(expected.t * 1e9).astype(int), expected.pose, strict=True)
        if t in found
    ]
    assert len(error) > 0.99 * len(expected.t) and max(error) < 1e-6
    assert np.hypot(*expected.pose[-1, :2]) > 1.5, "it went somewhere"
    planner.stop()


def test_a_planner_that_dies_stops_the_rover_whatever_is_played(start_node, ros_context) -> None:
    """An old recording's planned/odom comes on, as plain `replay` publishes it: it is no sign of the planner's life."""
    node = start_node("sim", "--ros-args", "-p", "command_timeout:=0.5")  # a busy machine stalls for more than 0.1 s
    probe = Probe(ros_context, ["ground_truth/odom", "motor_command"])
    probe.ready()
    planner = start_node("planner", "table6_agriq")
    node.wait_for("profile accepted", 60.0)
    probe.until(lambda: probe.speed() > 0.3, "the rover to move", 30.0)
    probe.clear()
    planner.send(signal.SIGKILL)
    old = Odometry()
    old.header.stamp.sec = 1_600_000_000
    probe.repeat(lambda: probe.planned.publish(old), 3.0)
    assert "no sign of life" in node.output
    assert not any(probe.last("motor_command").velocity[:2]) and abs(probe.speed()) < 0.01
    assert probe.braking().max() <= 2.0 * (1 + 1e-6)


def test_a_simulator_that_still_compiles_misses_no_profile(start_node, ros_context, bend: Path, tmp_path: Path) -> None:
    """Both started at once, nothing cached: the planner sees a listener only when there is one that can follow."""
    node = start_node("sim", "--rate", 3, "--params", "sim_patient", env={"ARTIBOT_CACHE_DIR": str(tmp_path)})
    start_node("planner", "--manoeuvre", bend, "--use-sim-time", "--ros-args", "-p", "clock_timeout:=120.0")
    probe = Probe(ros_context, ["ground_truth/odom", "motor_command"])
    node.wait_for("profile accepted", 120.0)
    probe.ready()
    probe.until(lambda: probe.speed() > 0.3, "the rover to move", 30.0)
    assert "refused" not in node.output
