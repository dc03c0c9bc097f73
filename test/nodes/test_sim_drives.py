"""The rover that its drives turn: the real simulator node on a real bus, a master that knows frames, and the truth."""

from __future__ import annotations

import contextlib
import math
import signal
import subprocess
import sys
import time
from collections.abc import Iterator

import numpy as np
import pytest
from bus_contract import wait_for
from frame_master import FrameMaster, SetPoints

from artibot_driver.bus import open_bus
from artibot_driver.cia402 import DriveState, state_of
from artibot_driver.loopback import loopback_bus
from artibot_driver.rig import load_rig
from artibot_sim.model import MOTORS, Commands, Mode, load_robot, rollout
from artibot_sim.nodes.drives.loop import drive_config
from ros_helpers import ROOT

pytest.importorskip("rclpy", reason="rclpy is not installed; run `make setup`, or source a ROS 2 Jazzy")

from sim_probe import METRES, Probe, stamp_ns

AGRIQ = load_robot("agriq")
SHARE = 0.5 * AGRIQ.drive.back.tau / AGRIQ.drive.front.tau * (1 / 0.8 - 1)
"""Eq. 30 at kappa 0.8."""


@contextlib.contextmanager
def mastered(channel: str) -> Iterator[FrameMaster]:
    rig = load_rig(drive_config("agriq", interface="remote", channel=channel))
    with open_bus("remote", channel) as bus:
        yield FrameMaster(bus, rig)


def simulator(start_node, channel: str, *options: object):
    node = start_node("sim", "--with-driver", "--interface", "remote", "--channel", channel, *options)
    node.wait_for("is ready for a driver")
    return node


def listen_up(probe: Probe) -> None:
    """Take all that was published while nobody listened, to the newest."""
    probe.until(lambda: time.time_ns() - stamp_ns(probe.last()) < 100_000_000, "the newest pose")


def bend(t: float, master: FrameMaster) -> SetPoints:
    """Up to 0.5 m/s in a second, the inner side slower; eq. 30 behind, as a driver computes it."""
    speed = min(t, 1.0) * 0.5 / METRES
    back = SHARE * (master.si("front_right", "torque") + master.si("front_left", "torque"))
    return {"front_right": speed, "front_left": 0.9 * speed, "back_right": back, "back_left": back}


def test_the_drives_turn_the_rover_and_tell_what_its_motors_do(start_node, ros_context, channel: str) -> None:
    node = simulator(start_node, channel)
    probe = Probe(ros_context, ["ground_truth/odom", "joint_states"])
    probe.until(lambda: all(probe.got.values()), "the simulator's topics")
    assert probe.last("joint_states").name == ["articulation_yaw", "articulation_roll"]
    for topic in ("/odom", "/motor_torques", "/motor_command", "/diagnostics"):
        assert not probe.node.get_publishers_info_by_topic(topic)
    for topic in ("/planned/front_velocity", "/planned/odom", "/motor_command_request", "/cmd_vel"):
        assert not probe.node.get_subscriptions_info_by_topic(topic), "the driver listens, not the simulator"
    with mastered(channel) as master:
        master.set_up()
        master.lead_to(DriveState.OPERATION_ENABLED)
        begin = {motor: master.si(motor, "position") for motor in MOTORS}
        master.run(4.0, lambda t: bend(t, master))
        turned = {motor: master.si(motor, "position") - begin[motor] for motor in MOTORS}
        speed = {motor: master.si(motor, "velocity") for motor in MOTORS}
        torque = {motor: master.si(motor, "torque") for motor in MOTORS}
        unanswered = master.unanswered
        assert unanswered < 40, "of 400 cycles: the drives answer a SYNC within its period"
        master.run(1.0, lambda t: bend(1.0 - t, master))
        master.run(0.3, lambda _: {})
    listen_up(probe)
    assert speed["front_right"] == pytest.approx(0.5 / METRES, rel=1e-3)
    assert speed["front_left"] == pytest.approx(0.45 / METRES, rel=1e-3)
    # a driver's period behind the master's clock, the time of interpolation, and answers that did not come in time
    behind = 0.05 + unanswered / 100.0
    assert turned["front_right"] == pytest.approx(0.5 / METRES * 3.5, abs=behind * 0.5 / METRES)
    assert torque["front_right"] > torque["front_left"], "the outer side pushes harder in a bend"
    assert torque["back_right"] == torque["back_left"]
    assert torque["back_right"] == pytest.approx(SHARE * (torque["front_right"] + torque["front_left"]), abs=3e-3)
    expected = by_rollout()
    x, y = probe.last().pose.pose.position.x, probe.last().pose.pose.position.y
    assert math.hypot(x - expected[0], y - expected[1]) < 0.02, (x, y, expected)
    assert math.hypot(x, y) > 1.8
    assert "drives: all operation enabled" in node.output


def by_rollout() -> tuple[float, float]:
    """Where the model comes to with the same front velocities: driven motors, eq. 30 behind, no bus between."""
    t = np.arange(0.0, 5.4, 0.01)
    speed = np.interp(t, [0.0, 1.0, 4.0, 5.0], [0.0, 0.5, 0.5, 0.0]) / METRES
    velocity = np.full((len(t), 4), np.nan)
    velocity[:, 0], velocity[:, 1] = speed, 0.9 * speed
    modes = (Mode.DRIVEN, Mode.DRIVEN, Mode.TORQUE, Mode.TORQUE)
    pose = rollout(AGRIQ, Commands(0.01, velocity), modes=modes, kappa=0.8).pose[-1]
    return float(pose[0]), float(pose[1])


def test_a_master_that_falls_silent_stops_the_rover_and_a_reset_switches_the_drives_off_and_on(
    start_node, ros_context, channel: str
) -> None:
    simulator(start_node, channel, "--start", 1, 2, 0)
    probe = Probe(ros_context)
    probe.until(lambda: all(probe.got.values()), "the simulator's topics")
    with mastered(channel) as master:
        master.set_up()
        master.lead_to(DriveState.OPERATION_ENABLED)
        master.run(1.5, lambda t: bend(t, master))
        master.beating = False
        master.run(1.0, lambda t: bend(1.5, master))
        for motor in MOTORS:
            assert state_of(master.access(motor, 0x6041)) is DriveState.FAULT
        assert {code for _, code in master.emergencies} == {0x8130}
        listen_up(probe)
        assert abs(probe.speed()) < 0.02
        assert probe.last().pose.pose.position.x > 1.3

        master.beating = True
        master.set_up()
        master.lead_to(DriveState.OPERATION_ENABLED, reset_faults=True)
        master.run(1.5, lambda t: bend(t, master))
        before = {motor: master.fields[motor]["position_actual_value"] for motor in MOTORS}
        answer = probe.trigger("reset")
        assert answer.success
        assert wait_for(lambda: master.receive(time.monotonic() + 0.1) and set(master.boots) == set(MOTORS))
        master.set_up()
        master.run(0.5, lambda t: bend(1.0, master))  # targets and control words of before: nobody has enabled anew
        after = {motor: master.fields[motor]["position_actual_value"] for motor in MOTORS}
        assert all(master.state(motor) is not DriveState.OPERATION_ENABLED for motor in MOTORS)
        for motor in MOTORS:  # counted on: at 0.5 m/s 20 ms of motion are some 1600 increments
            assert abs(after[motor] - before[motor]) < 5000
    listen_up(probe)
    at = probe.last().pose.pose.position
    assert (at.x, at.y) == pytest.approx((1.0, 2.0), abs=1e-6)


def test_time_with_drives_cannot_be_stopped_and_commands_are_the_driver_s(start_node, ros_context, channel) -> None:
    node = simulator(start_node, channel)
    probe = Probe(ros_context)
    probe.until(lambda: all(probe.got.values()), "the simulator's topics")
    answer = probe.pause(True)
    assert not answer.success
    assert "real time" in answer.message
    assert not probe.trigger("step").success
    count = len(probe.got["ground_truth/odom"])
    probe.spin(0.3)
    assert len(probe.got["ground_truth/odom"]) > count + 10
    assert node.stop() == 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--rate", "2"], "parameter rate: found 2.0, expected 1.0 with with_driver"),
        (["--rate", "0"], "parameter rate: found 0.0, expected 1.0 with with_driver"),
        (["--wait-for-profile"], "parameter wait_for_profile: found True, expected False with with_driver"),
        (["--robot", "husky"], "robot 'husky': is rigid and has two motors; expected a robot with four"),
        (["--dt", "0.005", "--integrator", "semi_implicit"], "dt: 0.005 s is too long with drives"),
        (["--driver-params", "nowhere"], "nowhere"),
        (["--channel", "ws://127.0.0.1:9/"], "bus ws://127.0.0.1:9/: nobody answers there"),
        (["--interface", "socketcan", "--channel", "vcan77"], "bus vcan77: "),
    ],
)
def test_what_does_not_go_with_drives_is_refused(start_node, channel: str, options: list[str], message: str) -> None:
    given = {"--interface": "remote", "--channel": channel} | {options[0]: None}
    rest = [word for key, value in given.items() if value is not None for word in (key, value)]
    if "--channel" in options:
        rest = [] if "--interface" in options else ["--interface", "remote"]
    node = start_node("sim", "--with-driver", *rest, *options)
    assert node.wait() == 2
    assert message in node.output
    assert "Traceback" not in node.output


def test_a_bus_that_was_lost_is_used_again(start_node) -> None:
    with loopback_bus() as channel:
        node = simulator(start_node, channel)
    node.wait_for("is lost")
    port = channel.rpartition(":")[2].strip("/")
    command = [sys.executable, "-m", "artibot_driver.loopback", "--port", port]
    server = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
    try:
        assert server.stdout is not None
        server.stdout.readline()
        node.wait_for("is there again")
        with mastered(channel) as master:
            assert master.access("front_left", 0x6041) & 0x4F == 0x40
        assert node.running
    finally:
        server.send_signal(signal.SIGTERM)
        server.wait()
