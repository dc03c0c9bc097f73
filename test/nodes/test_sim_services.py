"""The simulation node's time: reset, pause, step, parameters while running, full speed and repeatability."""

from __future__ import annotations

import math
import signal
import struct
import time

import numpy as np
import pytest
from nav_msgs.msg import Odometry
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.parameter import Parameter
from sim_probe import MEASURED, METRES, Probe, stamp_ns

TOPICS = (*MEASURED, "/clock")

PATIENT = ("-p", "command_timeout:=0.5")
"""For tests that are not about the timeout's length: a busy machine holds up a test for longer than 0.1 s."""


def bump(seconds: float, top: float = 80.0) -> list[tuple[float, float]]:
    n = round(seconds * 100)
    shape = [top * math.sin(math.pi * i / n) ** 2 for i in range(n)] + [0.0]
    return [(s, 0.7 * s) for s in shape]


def set_parameter(probe: Probe, name: str, value: object):
    request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
    return probe.call(SetParameters, "sim/set_parameters", request).results[0]


def later(probe: Probe, topic: str, than_ns: int) -> list:
    """What came with a later stamp."""
    return [message for message in probe.got[topic] if stamp_ns(message) > than_ns]


def test_a_hundred_resets(start_node, ros_context) -> None:
    start_node("sim", "--start", 0.5, -0.5, 0.3, "--ros-args", "-p", "publish_clock:='true'", *PATIENT)
    probe = Probe(ros_context, TOPICS)
    probe.ready()
    seen: dict[str, list[int]] = {topic: [] for topic in TOPICS}

    def moves() -> bool:
        probe.repeat(lambda: probe.send_request([100.0, 60.0]), 0.12)
        return abs(probe.speed()) > 0.01

    for k in range(100):
        assert any(moves() for _ in range(20))
        if k % 3 == 0:  # a profile that a reset must drop, too
            probe.send_profile(probe.now_ns() + 20_000_000, bump(2.0))
        for topic in TOPICS:
            seen[topic] += [stamp_ns(message) for message in probe.got[topic]]
        before = probe.now_ns()
        probe.send_request([100.0, 60.0])
        assert probe.trigger("reset").success
        probe.until(lambda: probe.last().pose.pose.position.x == pytest.approx(0.5, abs=1e-9), f"reset {k}", 5.0)
        reset = probe.now_ns()  # what was published before may still come
        probe.clear()
        probe.keep_alive(0.05)
        probe.until(lambda: all(len(later(probe, t, reset)) >= 3 for t in TOPICS), "topics after a reset", 5.0)  # noqa: B023
        after = {topic: later(probe, topic, reset) for topic in TOPICS}
        for topic in TOPICS:
            assert before < stamp_ns(after[topic][0]) <= reset + 30_000_000, "every topic resumes at once"
        for message in after["ground_truth/odom"]:
            place, twist = message.pose.pose.position, message.twist.twist
            assert (place.x, place.y) == pytest.approx((0.5, -0.5), abs=1e-9), f"reset {k}"
            assert abs(twist.linear.x) + abs(twist.angular.z) < 1e-9
        assert probe.last("odom").pose.pose.position.x == pytest.approx(0.5, abs=1e-9)
        assert list(probe.last("motor_command").velocity[:2]) == [0.0, 0.0]
    for topic, stamps in seen.items():
        assert (np.diff(stamps) > 0).all(), f"time goes on: {topic}"
    assert min(seen["/clock"]) >= 10_000_000


def test_pause_and_step(start_node, ros_context) -> None:
    start_node("sim", "--ros-args", "-p", "publish_clock:='true'", "-p", "reliable:='true'")
    probe = Probe(ros_context, TOPICS, reliable=True)
    probe.ready()
    assert not probe.trigger("step").success, "not paused"
    assert probe.pause(True).success
    probe.spin(0.2)
    stood = probe.now_ns()
    probe.spin(0.3)
    assert probe.now_ns() == stood == max(map(stamp_ns, probe.got["/clock"]))
    for k in range(1, 6):
        assert probe.trigger("step").success
        probe.until(lambda k=k: probe.now_ns() >= stood + k * 10_000_000, "the step", 5.0)
        probe.spin(0.05)
        assert probe.now_ns() == stood + k * 10_000_000, "one period, no more"
    assert probe.trigger("reset").success
    assert probe.pause(False).success
    probe.until(lambda: probe.now_ns() > stood + 200_000_000, "time going on")
    for topic in MEASURED:
        assert set(np.diff([stamp_ns(m) for m in probe.got[topic]])) == {10_000_000}, f"nothing is lost: {topic}"


def test_a_pause_does_not_count_as_silence_of_the_planner(start_node, ros_context) -> None:
    start_node("sim", "--ros-args", "-p", "publish_clock:='true'", *PATIENT)
    probe = Probe(ros_context, MEASURED)
    probe.ready()
    start = probe.now_ns() + 300_000_000
    profile = bump(4.0)
    probe.send_profile(start, profile)
    probe.keep_alive(1.0)
    probe.pause(True)
    probe.spin(1.0)  # silent for twice the timeout
    for _ in range(3):
        probe.trigger("step")
    probe.spin(0.2)
    last = probe.last("motor_command")
    place = (stamp_ns(last) - start) // 10_000_000
    assert profile[place][0] - 1e-9 <= last.velocity[0] <= profile[place + 1][0] + 1e-9
    assert last.velocity[0] > 5.0, "still on the profile"


def test_without_clock_stamps_jump_ahead_over_a_pause(start_node, ros_context) -> None:
    start_node("sim")
    probe = Probe(ros_context)
    probe.ready()
    probe.pause(True)
    probe.spin(0.5)
    stood = probe.now_ns()
    probe.pause(False)
    probe.until(lambda: probe.now_ns() > stood, "time going on")
    stamps = np.array([stamp_ns(m) for m in probe.got["ground_truth/odom"]])
    assert np.diff(stamps).max() > 400_000_000 and np.diff(stamps).min() >= 10_000_000


@pytest.mark.parametrize("clock", [True, False])
def test_a_machine_that_stands_still_makes_time_slip_not_race(start_node, ros_context, clock: bool) -> None:
    node = start_node("sim", "--ros-args", "-p", f"publish_clock:='{str(clock).lower()}'")
    probe = Probe(ros_context)
    probe.ready()
    probe.until(lambda: len(probe.got["ground_truth/odom"]) > 20, "time going on", 10.0)
    slips = node.output.count("the schedule slips")  # the machine may have been late already
    node.send(signal.SIGSTOP)
    time.sleep(1.0)
    node.send(signal.SIGCONT)
    probe.until(lambda: node.output.count("the schedule slips") > slips, "the slip", 10.0)
    stood = probe.now_ns()
    probe.until(lambda: probe.now_ns() > stood + 300_000_000, "time going on", 10.0)
    gaps = np.diff([stamp_ns(m) for m in probe.got["ground_truth/odom"]])
    assert gaps.min() >= 10_000_000
    if clock:
        assert gaps.max() < 500_000_000, "simulated time only comes later"
    else:
        assert gaps.max() > 700_000_000, "stamps are system time again"


def test_parameters_while_running(start_node, ros_context) -> None:
    start_node("sim", "--kappa", 1.0, "--ros-args", *PATIENT)
    probe = Probe(ros_context, MEASURED)
    probe.ready()

    def back_share() -> float:
        probe.repeat(lambda: probe.send_request([60.0, 60.0]), 1.0)
        return float(np.mean([sum(m.effort[2:]) for m in probe.got["motor_torques"][-20:]]))

    assert back_share() == pytest.approx(0.0, abs=1e-9)
    assert set_parameter(probe, "kappa", 0.6).successful
    assert back_share() > 0.01
    refusal = set_parameter(probe, "kappa", 1.5)
    assert not refusal.successful and "kappa" in refusal.reason
    assert not set_parameter(probe, "kappa", 0.0).successful
    assert not set_parameter(probe, "dt", 0.002).successful, "read-only"
    assert not set_parameter(probe, "command_source", "joystick").successful
    found = probe.call(GetParameters, "sim/get_parameters", GetParameters.Request(names=["kappa"])).values[0]
    assert found.double_value == 0.6
    assert set_parameter(probe, "command_source", "cmd_vel").successful
    probe.repeat(lambda: probe.send_request([60.0, 60.0]), 1.0)
    assert abs(probe.speed()) < 1e-3, "live requests no longer rule"


def bits(message: Odometry) -> bytes:
    pose, twist = message.pose.pose, message.twist.twist
    place, turn = pose.position, pose.orientation
    return struct.pack("<10d", place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w, twist.linear.x,
                       twist.linear.y, twist.angular.z)  # fmt: skip


def full_speed_run(start_node, ros_context) -> dict[str, dict[int, bytes]]:
    """A run at rate 0 with noise: stamp → bits of what was published."""
    node = start_node("sim", "--rate", 0, "--wait-for-profile", "--duration", 6, "--params", "sim_noisy")
    probe = Probe(ros_context, [*MEASURED, "/clock"], reliable=True)
    probe.until(lambda: probe.got["/clock"] and probe.profile.get_subscription_count() > 0, "the held clock", 60.0)
    probe.until(lambda: all(probe.node.count_publishers(t) for t in MEASURED), "publishers")
    probe.spin(0.5)  # time stands, so this changes nothing
    assert {stamp_ns(m) for m in probe.got["/clock"]} == {10_000_000}, "held after the first step"
    probe.send_profile(stamp_ns(probe.last("/clock")) + 1_000_000_000, bump(4.0))
    probe.until(lambda: not node.running, "the end", 60.0)
    assert node.wait() == 0
    counts: list[int] = []
    while counts[-2:-1] != counts[-1:] or not counts:  # what was received and is not taken yet
        counts.append(sum(map(len, probe.got.values())))
        probe.spin(0.5)
    probe.node.destroy_node()
    found = {"odom": {}, "truth": {}, "torques": {}}
    for name, topic in (("odom", "odom"), ("truth", "ground_truth/odom")):
        found[name] = {stamp_ns(m): bits(m) for m in probe.got[topic]}
    found["torques"] = {
        stamp_ns(m): struct.pack("<12d", *m.position, *m.velocity, *m.effort) for m in probe.got["motor_torques"]
    }
    return found


def test_full_speed_is_the_same_to_the_bit(start_node, ros_context) -> None:
    one, two = (full_speed_run(start_node, ros_context) for _ in range(2))
    for name in one:
        assert len(one[name]) > 590, "reliable topics lose nothing after the hold"
        shared = one[name].keys() & two[name].keys()
        assert len(shared) > 590 and max(shared) == 6_000_000_000
        assert all(one[name][stamp] == two[name][stamp] for stamp in shared), name
    last = struct.unpack("<10d", one["truth"][6_000_000_000])
    assert last[0] > 160.0 * METRES * 0.5, "the profile was followed to its end without a sign of life"


def test_full_speed_runs_on_without_commands(start_node, ros_context) -> None:
    node = start_node("sim", "--rate", 0, "--duration", 30)
    probe = Probe(ros_context, ["/clock"])
    probe.until(lambda: not node.running, "the end", 60.0)
    assert node.wait() == 0
    stamps = [stamp_ns(m) for m in probe.got["/clock"]]
    assert stamps and min(stamps) >= 10_000_000 and (np.diff(stamps) > 0).all()
    assert "3000 periods" in node.output
