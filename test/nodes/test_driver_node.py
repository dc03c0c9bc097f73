"""The driver node on a real bus: enabling, commands and silence, services, lifecycle, topics, diagnostics, its end."""

from __future__ import annotations

import itertools
import json
import math
import signal
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed; run `make setup`, or source a ROS 2 Jazzy")

from diagnostic_msgs.msg import DiagnosticArray
from driver_probe import PATIENT, DriverProbe, Drives, Sniffer, drives_on, prompt
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, SetParameters
from rclpy.node import Node
from sim_probe import FRONT, METRES, stamp_ns
from trajectory_msgs.msg import JointTrajectory

from artibot_driver.config import ALL_SPECS, config_from_parameters
from artibot_driver.master import kappa_bounds
from artibot_driver.pdo import Pdo
from artibot_driver.rig import load_rig
from artibot_sim.experiment import bag_info
from artibot_sim.model import MOTORS, load_robot
from artibot_sim.model.equations.transmission import back_torque_factor
from artibot_sim.nodes.common.qos import LATCHED
from artibot_sim.nodes.driver.loop import Settling
from artibot_sim.sharing import LAWS, Cycle, load_law
from ros_helpers import NodeProcess, spin_until

NAN = math.nan
ALL = list(MOTORS)
STANDS = 5.0
"""Slower than this (rad/s, 0.02 m/s over ground) a flywheel that was switched off may still turn."""


@pytest.fixture(scope="module")
def bench(channel: str) -> Iterator[Drives]:
    with drives_on("remote", channel) as found:
        yield found


@pytest.fixture
def drives(bench: Drives) -> Drives:
    """New ones for every test, in one process."""
    bench.renew()
    return bench


@pytest.fixture
def driver(start_node: Any, channel: str, drives: Drives) -> NodeProcess:
    return start_node("driver", "--channel", channel, *PATIENT)


@pytest.fixture
def probe(ros_context: Any, driver: NodeProcess) -> Iterator[DriverProbe]:
    """A probe whose driver has set its drives up."""
    with prompt():
        probe = DriverProbe(ros_context)
        probe.listened()
        probe.until(lambda: probe.part("driver").get("phase") == "READY", "drives that are set up", 60.0)
        yield probe


def test_what_is_published_is_what_the_drives_report(probe: DriverProbe, drives: Drives) -> None:
    assert all(math.isnan(number) for number in (*probe.commanded(), *probe.last("motor_command").effort))
    probe.repeat(lambda: probe.send_request([60.0, 40.0]), 0.2)
    assert not any(each["velocity"] for each in drives.states().values()), "nothing moves before it is enabled"
    probe.enabled()
    probe.clear()
    probe.repeat(lambda: probe.send_request([60.0, 40.0]), 1.0)
    command, torques = probe.last("motor_command"), probe.last("motor_torques")
    at = {stamp_ns(m): m for m in probe.got["motor_torques"]}
    joints = next(m for m in reversed(probe.got["joint_states"]) if stamp_ns(m) in at)  # topics come one by one
    odom = probe.last("odom")
    assert command.name == torques.name == ALL
    assert command.velocity[:2] == pytest.approx([60.0, 40.0], abs=1e-3)
    assert all(map(math.isnan, (*command.velocity[2:], *command.effort[:2])))
    assert all(map(math.isfinite, command.effort[2:]))
    assert torques.velocity[:2] == pytest.approx([60.0, 40.0], rel=0.02)
    assert joints.name == [f"{motor}_{end}_wheel" for motor in ALL for end in ("front", "back")]
    same, drive = at[stamp_ns(joints)], load_robot("agriq").drive
    tau = np.repeat([drive.front.tau, drive.back.tau], 4)
    np.testing.assert_allclose(joints.position, np.repeat(same.position, 2) * tau, rtol=1e-12)
    np.testing.assert_allclose(joints.velocity, np.repeat(same.velocity, 2) * tau, rtol=1e-12)
    assert odom.twist.twist.linear.x == pytest.approx(50.0 * METRES, rel=0.02)
    assert odom.twist.twist.angular.z == pytest.approx(20.0 * METRES / 0.72, rel=0.05)
    for topic in probe.got:
        stamps = np.array([stamp_ns(m) for m in probe.got[topic]])
        assert (np.diff(stamps) > 0).all(), topic
        assert abs(stamps[-1] - time.time_ns()) < 200e6
        assert 60 <= len(stamps) <= 130, (topic, len(stamps))


def test_back_torques_are_eq_30_of_the_front_ones_unless_requested(probe: DriverProbe, drives: Drives) -> None:
    set_kappa(probe, 0.8)
    probe.enabled()
    probe.repeat(lambda: probe.send_request([100.0, 60.0]), 0.3)
    probe.clear()
    probe.repeat(lambda: probe.send_request([100.0, 60.0]), 0.5)
    factor = back_torque_factor(load_robot("agriq"), 0.8)
    permille = load_rig(config_from_parameters({})).scaling["back_left"].torque.step
    wanted = [NAN, NAN, 0.05, -0.03]
    told = list(probe.got["motor_command"])
    probe.repeat(lambda: probe.send_request([100.0, 60.0, NAN, NAN], ALL, wanted), 0.3)
    assert probe.last("motor_command").effort[2:] == pytest.approx([0.05, -0.03], abs=abs(permille))
    sums = {factor * sum(m.effort[:2]) for m in probe.got["motor_torques"]}
    for message in told[5:]:
        assert message.effort[2] == message.effort[3]
        assert min(abs(message.effort[2] - each) for each in sums) <= 1.01 * abs(permille)


OWN_LAW = """
from artibot_sim.sharing import Law


def share(robot, cycle, part=0.5):
    right, left = cycle.front_torque
    return part * right, -part * left


LAW = Law("own", "Each back motor takes a part of the front motor's torque on its side.", share)
"""


def test_every_law_shares_the_torque_while_driving(probe: DriverProbe, tmp_path: Path) -> None:
    """The commanded back torques are what the law makes of torques that were reported, to a step of the drives."""
    robot, own = load_robot("agriq"), tmp_path / "own.py"
    own.write_text(OWN_LAW)
    step = abs(load_rig(config_from_parameters({})).scaling["back_left"].torque.step)
    probe.enabled()
    tried = ["constant:kappa=0.7", "by_curvature:turn=0.65", "relieve:limit=0.02", "vectoring:gain=2"]
    assert {text.split(":")[0] for text in tried} == set(LAWS)
    refused = set_text(probe, "law", str(own))
    assert not refused.successful and "disable first" in refused.reason
    for text in (*tried, f"{own}:part=0.3"):
        if str(own) in text:
            assert probe.call_driver("disable").success
            probe.until(lambda: probe.part("driver")["phase"] == "READY", "disabled drives", 5.0)
        assert set_text(probe, "law", text).successful
        if str(own) in text:
            probe.enabled()
        law, largest = load_law(text), 0.0
        for speed in (60.0, 100.0, 60.0):  # there is torque while speeds change
            probe.clear()
            probe.repeat(lambda v=speed: probe.send_request([v, 0.4 * v]), 0.25)
            reported = [tuple(m.effort[:2]) for m in probe.got["motor_torques"]]
            for before, told in itertools.pairwise(probe.got["motor_command"][3:]):
                speeds, back = tuple(told.velocity[:2]), tuple(before.effort[2:])
                due = [law.torques(robot, Cycle(speeds, front, back, robot.control.kappa)) for front in reported]
                assert np.abs(np.subtract(due, told.effort[2:])).max(axis=1).min() <= 1.01 * step, text
                largest = max(largest, *map(abs, told.effort[2:]))
        assert largest > 5 * step, text


@pytest.mark.parametrize("text", ["constant:kappa=0.3", "by_curvature:turn=0.1", "by_curvature:straight=1.2"])
def test_a_law_cannot_get_around_the_bound_of_kappa(probe: DriverProbe, text: str) -> None:
    refused = set_text(probe, "law", text)
    assert not refused.successful and "expected 0.622 to 1" in refused.reason


def set_kappa(probe: DriverProbe, kappa: float) -> Any:
    return _set(probe, "kappa", ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=kappa))


def set_text(probe: DriverProbe, name: str, text: str) -> Any:
    return _set(probe, name, ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=text))


def _set(probe: DriverProbe, name: str, value: ParameterValue) -> Any:
    request = SetParameters.Request(parameters=[Parameter(name=name, value=value)])
    (result,) = probe.call(SetParameters, "driver/set_parameters", request).results
    return result


def test_kappa_is_bounded_by_the_motors_and_set_while_driving(probe: DriverProbe) -> None:
    low, high = kappa_bounds(load_robot("agriq"))
    assert (low, high) == (0.622, 1.0)
    for kappa in (0.621, 1.001, -1.0, NAN):
        result = set_kappa(probe, kappa)
        assert not result.successful and "kappa" in result.reason
    assert "0.622" in set_kappa(probe, 0.6).reason
    for kappa in (0.622, 1.0, 0.75):
        assert set_kappa(probe, kappa).successful
    probe.until(lambda: probe.part("driver").get("kappa") == "0.75", "kappa in /diagnostics")
    names = list(ALL_SPECS)
    described = probe.call(
        DescribeParameters, "driver/describe_parameters", DescribeParameters.Request(names=names)
    ).descriptors
    assert [each.name for each in described] == names
    for each in described:
        assert each.description == ALL_SPECS[each.name].doc and each.read_only is not ALL_SPECS[each.name].live


@pytest.mark.parametrize("source", ["live", "cmd_vel"])
def test_silence_stops_and_only_an_enable_and_a_fresh_command_move_it_again(
    probe: DriverProbe, driver: NodeProcess, source: str
) -> None:
    send: Callable[[], None] = {
        "live": lambda: probe.send_request([100.0, 80.0]),
        "cmd_vel": lambda: probe.send_twist(0.4, 0.1),
    }[source]
    probe.enabled()
    probe.repeat(send, 1.0)
    assert probe.turning() > 80.0
    probe.clear()
    probe.spin(1.6)
    told = np.array([m.velocity[:2] for m in probe.got["motor_command"]])
    stamps = np.array([stamp_ns(m) for m in probe.got["motor_command"]]) * 1e-9
    given = np.isfinite(told).all(axis=1)
    told, stamps = told[given], stamps[given]
    braking = -np.diff(np.abs(told).max(axis=1)) * METRES
    assert (braking <= 2.0 * 1.02 * np.diff(stamps) + 1e-6).all(), "no faster than stop_deceleration"
    moving = told[(told[:, 0] > 1.0) & (np.abs(told).max(axis=1) < 0.98 * np.abs(told).max())]
    np.testing.assert_allclose(moving[:, 1] / moving[:, 0], told[0, 1] / told[0, 0], rtol=1e-3)
    assert probe.turning() < STANDS
    probe.until(lambda: probe.is_stopped_by("COMMAND_SILENCE"), "the reason in /diagnostics")
    assert "silent" in driver.wait_for("stopped: ") and "silent" in probe.part("driver")["message"]
    probe.repeat(send, 0.5)
    assert probe.turning() < STANDS, "not by a fresh command alone"
    probe.enabled()
    probe.spin(0.3)
    assert probe.turning() < STANDS, "not by an enable alone"
    probe.repeat(send, 0.5)
    assert probe.turning() > 40.0


def test_a_profile_is_followed_refused_from_before_an_enable_and_dies_with_its_planner(
    probe: DriverProbe, driver: NodeProcess, start_node: Any
) -> None:
    shape = [(100.0 * math.sin(math.pi * k / 200) ** 2, 60.0 * math.sin(math.pi * k / 200) ** 2) for k in range(200)]
    probe.send_profile(time.time_ns() + 2_500_000_000, [*shape, (0.0, 0.0)])
    probe.spin(0.2)
    probe.enabled()
    probe.keep_alive(3.5)
    driver.wait_for("published before")
    assert probe.turning() < STANDS, "a profile from before the enable"
    probe.clear()
    probe.send_profile(time.time_ns() + 300_000_000, [*shape, (0.0, 0.0)])
    probe.keep_alive(2.8)
    told = np.array([m.velocity[:2] for m in probe.got["motor_command"]])
    assert np.nanmax(told, axis=0) == pytest.approx([100.0, 60.0], rel=1e-3)
    turned = np.subtract(probe.last("motor_torques").position, probe.got["motor_torques"][0].position)
    assert turned[:2] == pytest.approx([100.0, 60.0], rel=0.02), "the integral of the profile"
    assert probe.part("driver")["phase"] == "ENABLED", "the end of a profile is no silence"
    planner = start_node("planner", "table6_agriq", "--start-delay", 0.3)
    probe.until(lambda: probe.turning() > 20.0, "the planner's profile to be followed")
    planner.send(signal.SIGKILL)
    probe.until(lambda: probe.is_stopped_by("COMMAND_SILENCE"), "the stop after the planner's death", 5.0)
    assert "planned/odom" in driver.output


def test_bad_commands_stop_it_or_move_nothing(probe: DriverProbe, driver: NodeProcess) -> None:
    bad = [
        lambda: probe.send_request([NAN, 50.0]),
        lambda: probe.send_request([1e9, 0.0]),
        lambda: probe.send_request([50.0, 50.0], ["front_right", "rear_left"]),
        lambda: probe.send_request([50.0, 50.0, 0.0, 0.0], ALL, [NAN, NAN, math.inf, 0.0]),
        lambda: probe.send_twist(NAN, 0.0),
        lambda: probe.send_twist(50.0, 0.0),
        lambda: probe.send_profile(time.time_ns(), [(0.0, 0.0), (NAN, 1.0)]),
    ]
    probe.enabled()
    for send in bad:
        probe.repeat(send, 0.1)
    assert probe.turning() < STANDS and probe.part("driver")["phase"] == "ENABLED"
    probe.repeat(lambda: probe.send_twist(0.4, 0.0), 1.0)
    assert probe.turning() > 80.0
    probe.repeat(bad[4], 0.2)
    probe.until(lambda: probe.is_stopped_by("INVALID_COMMAND"), "the reason in /diagnostics")
    assert "nan" in probe.part("driver")["message"]


def test_a_back_effort_beyond_the_motor_s_limit_stops_it(probe: DriverProbe) -> None:
    limit = load_robot("agriq").drive.back.torque_max
    probe.enabled()
    probe.repeat(lambda: probe.send_request([40.0, 40.0, NAN, NAN], ALL, [NAN, NAN, 0.1 * limit, NAN]), 0.5)
    assert probe.part("driver")["phase"] == "ENABLED" and probe.turning() > 30.0
    probe.repeat(lambda: probe.send_request([40.0, 40.0, NAN, NAN], ALL, [NAN, NAN, 1.1 * limit, NAN]), 0.2)
    probe.until(lambda: probe.is_stopped_by("INVALID_COMMAND"), "the reason in /diagnostics")
    assert "back_right effort 0.66 N m, expected at most 0.6" in probe.part("driver")["message"]


def test_messages_without_content_neither_move_nor_end_it(probe: DriverProbe, driver: NodeProcess) -> None:
    topics = {"planned/odom": Odometry, "planned/front_velocity": JointTrajectory}
    publishers = [probe.node.create_publisher(kind, topic, LATCHED) for topic, kind in topics.items()]
    probe.enabled()
    probe.until(lambda: all(each.get_subscription_count() for each in publishers), "the driver's subscriptions")
    for length in (4, 8):
        probe.repeat(lambda: [each.publish(bytes(length)) for each in publishers], 0.2)  # noqa: B023
    assert driver.running and probe.part("driver")["phase"] == "ENABLED" and probe.turning() < STANDS
    assert "planned/front_velocity refused: it cannot be decoded" in driver.output


def test_services_say_what_happened_or_what_is_in_the_way(probe: DriverProbe, drives: Drives) -> None:
    assert probe.call_driver("disable").success
    probe.enabled()
    assert probe.call_driver("enable").message
    probe.repeat(lambda: probe.send_request([100.0, 100.0]), 0.5)
    answer = probe.call_driver("quick_stop")
    assert answer.success and "standstill" in answer.message
    probe.until(lambda: probe.is_stopped_by("QUICK_STOP"), "the quick stop's end")
    probe.enabled()
    drives.fail("back_left", 0x2310)
    probe.until(lambda: probe.part("driver")["phase"] == "LOCKED", "a fault that is noticed")
    assert probe.part("driver")["stop motor"] == "back_left"
    assert "2310h" in probe.part("back_left")["message"] and probe.status("back_left").level == b"\x02"
    answer = probe.call_driver("enable")
    assert not answer.success and "back_left" in answer.message and "2310h" in answer.message
    answer = probe.call_driver("reset_fault")
    assert answer.success, answer.message
    probe.enabled()
    drives.unplug("front_left")
    probe.until(lambda: probe.part("driver")["phase"] == "CONFIGURING", "a drive that is missed")
    probe.until(lambda: probe.status("front_left").level in (b"\x01", b"\x02", b"\x03"), "its status")
    answer = probe.call_driver("enable")
    assert not answer.success and "front_left" in answer.message
    began = time.monotonic()
    drives.plug("front_left")
    probe.until(lambda: probe.part("driver")["phase"] in ("READY", "LOCKED"), "the drive's return")
    assert time.monotonic() - began < 2.5
    probe.call_driver("reset_fault")
    probe.enabled()


def test_the_loop_is_not_held_up_by_services(
    start_node: Any, channel: str, drives: Drives, ros_context: Any, tmp_path: Path
) -> None:
    node = start_node("driver", "--channel", channel, "--enable", "--stats", tmp_path / "stats.json", *PATIENT)
    probe = DriverProbe(ros_context)
    probe.listened()
    probe.until(lambda: probe.part("driver").get("phase") == "ENABLED", "drives that are enabled by themselves")
    with Sniffer("remote", channel) as sniffer:
        for _ in range(3):
            for name in ("enable", "disable", "reset_fault", "quick_stop", "enable"):
                probe.call_driver(name)
            set_kappa(probe, 0.9)
        syncs = np.array([at for at, can_id, _ in sniffer.frames if can_id == 0x80])
    assert len(syncs) > 30
    # of a machine that does other things too: half of all periods must be kept within 5 ms
    assert np.median(np.abs(np.diff(syncs) - 0.01)) < 5e-3
    assert node.stop() == 0
    found = json.loads((tmp_path / "stats.json").read_text())
    assert found["callback_cpu_max_ms"] > 0 and found["callback_wall_p99_ms"] <= found["callback_wall_max_ms"]
    assert found["callback_turns"] > 10
    assert found["steps"] > 30 and found["late_max_ms"] >= found["late_p99_ms"] >= found["late_p50_ms"] > 0.0


UNREAD = """
import fcntl, os, sys
kept, full = os.pipe()
fcntl.fcntl(full, fcntl.F_SETPIPE_SZ, 4096)
os.set_inheritable(kept, True)
os.dup2(full, 2)
os.execv(sys.executable, [sys.executable, "-m", "artibot_sim.cli", *sys.argv[1:]])
"""
"""Runs artibot with log lines that nobody reads, of which few wait to be read."""


def test_log_lines_that_nobody_reads_do_not_hold_the_loop_up(
    start_node: Any, channel: str, drives: Drives, ros_context: Any, tmp_path: Path
) -> None:
    node = start_node.run(
        [sys.executable, "-c", UNREAD, "driver", "--channel", channel, "--enable", *PATIENT], name="unread"
    )
    probe = DriverProbe(ros_context)
    probe.listened()
    probe.until(lambda: probe.part("driver").get("phase") == "ENABLED", "drives that are enabled by themselves")
    for _ in range(60):  # each a line of some hundred characters
        probe.call_driver("enable")
    assert probe.part("driver")["phase"] == "ENABLED"
    probe.repeat(lambda: probe.send_request([60.0, 40.0]), 0.5)
    assert probe.commanded() == pytest.approx((60.0, 40.0), abs=1e-3)
    assert node.stop(timeout=20.0) == 0


def test_diagnostics_name_every_part(probe: DriverProbe) -> None:
    (names,) = {tuple(each.name for each in message.status) for message in probe.diagnostics[-2:]}
    assert names == tuple(f"artibot driver: {part}" for part in ("driver", "bus", *MOTORS))
    for motor in MOTORS:
        found = probe.part(motor)
        assert found["state"] == "switch on disabled" or found["state"] == "ready to switch on"
        assert float(found["since heartbeat (s)"]) < 0.2 and probe.status(motor).level == b"\x00"
        assert motor in probe.status(motor).hardware_id
    assert probe.part("bus")["state"] == "ACTIVE" and 0.05 < float(probe.part("bus")["load"]) < 0.6
    assert float(probe.part("driver")["loop late p99 (ms)"]) > 0.0
    with Sniffer("remote", probe.part("bus")["channel"]) as foreign:
        import can

        before = counted(probe)
        for _ in range(5):
            foreign._bus.send_message(can.Message(arbitration_id=0x181, data=b"\x37", is_extended_id=False))
            foreign._bus.send_message(can.Message(arbitration_id=0x1E2, data=b"\x37", is_extended_id=False))
        probe.until(lambda: counted(probe) >= before + 10, "strange frames that are counted")
    count = len(probe.diagnostics)
    probe.spin(3.0)
    assert 2 <= len(probe.diagnostics) - count <= 8, "1 Hz, and on change"


def test_diagnostics_of_two_rovers_are_told_apart(ros_context: Any, start_node: Any) -> None:
    """Two real nodes of one robot file below two namespaces, both on the one topic that has none."""
    for name in ("rover1", "rover2"):
        start_node("driver", "--unconfigured", "--ros-args", "-r", f"__ns:=/{name}")
    listener = Node("listener", context=ros_context)
    found: dict[str, str] = {}

    def take(message: DiagnosticArray) -> None:
        found.update({each.name: each.hardware_id for each in message.status})

    listener.create_subscription(DiagnosticArray, "/diagnostics", take, 10)
    spin_until(listener, lambda: len(found) == 2, 60.0, "both drivers' diagnostics")
    assert found == {f"{name}/artibot driver: driver": f"{name}/agriq" for name in ("rover1", "rover2")}


def counted(probe: DriverProbe) -> int:
    """All counters of strange frames together."""
    words = ("unknown", "malformed", "foreign")
    return sum(int(v) for k, v in probe.part("driver").items() if any(word in k for word in words) and v.isdigit())


def test_the_lifecycle_opens_enables_disables_and_closes(
    start_node: Any, channel: str, drives: Drives, ros_context: Any
) -> None:
    node = start_node("driver", "--channel", channel, "--unconfigured", *PATIENT)
    probe = DriverProbe(ros_context)
    changes = probe.node.create_client(ChangeState, "driver/change_state")  # one: to be found takes longer than a ramp
    probe.until(changes.service_is_ready, "the lifecycle")

    def change(transition: int) -> bool:
        answer = changes.call_async(ChangeState.Request(transition=Transition(id=transition)))
        probe.until(answer.done, "an answer of the lifecycle")
        return answer.result().success

    def state() -> int:
        return probe.call(GetState, "driver/get_state", GetState.Request()).current_state.id

    assert state() == State.PRIMARY_STATE_UNCONFIGURED
    assert not probe.call_driver("enable").success
    assert change(Transition.TRANSITION_CONFIGURE) and state() == State.PRIMARY_STATE_INACTIVE
    assert not change(Transition.TRANSITION_CONFIGURE) and not change(Transition.TRANSITION_DEACTIVATE)
    assert state() == State.PRIMARY_STATE_INACTIVE, "what a state does not have is refused, and changes nothing"
    probe.until(lambda: probe.part("driver").get("phase") == "READY", "drives that are set up")
    assert change(Transition.TRANSITION_ACTIVATE)
    probe.until(lambda: probe.part("driver")["phase"] == "ENABLED", "drives that are enabled")
    assert state() == State.PRIMARY_STATE_ACTIVE
    assert probe.part("driver")["lifecycle"] == "active"
    probe.repeat(lambda: probe.send_request([100.0, 100.0]), 0.5)
    probe.spin(1.5)
    assert state() == State.PRIMARY_STATE_INACTIVE, "silence has stopped it"
    assert change(Transition.TRANSITION_ACTIVATE)
    probe.repeat(lambda: probe.send_request([400.0, 400.0]), 0.5)
    assert change(Transition.TRANSITION_DEACTIVATE)
    assert not change(Transition.TRANSITION_CLEANUP), "still coming to rest"
    probe.until(lambda: probe.part("driver")["phase"] == "READY", "standstill")
    assert change(Transition.TRANSITION_CLEANUP) and state() == State.PRIMARY_STATE_UNCONFIGURED
    assert change(Transition.TRANSITION_UNCONFIGURED_SHUTDOWN)
    assert node.wait() == 0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_brings_it_to_standstill_before_it_ends(
    probe: DriverProbe, driver: NodeProcess, drives: Drives, channel: str, number: signal.Signals
) -> None:
    codec = load_rig(config_from_parameters({})).codec
    probe.enabled()
    with Sniffer("remote", channel) as sniffer:
        probe.repeat(lambda: probe.send_request([100.0, 80.0]), 0.7)
        driver.send(number)
        asked = time.monotonic()
        assert driver.wait(10.0) == 0
        targets = [
            each.value("target_velocity")
            for _, each in sniffer.decoded(codec, since=asked)
            if isinstance(each, Pdo) and each.map.to_drive and each.node == 1
        ]
    speeds = [abs(each) for each in targets]
    assert speeds[0] > 0 and speeds[-1] == 0
    assert all(b <= a for a, b in zip(speeds, speeds[1:], strict=False)), "a ramp"
    assert len(speeds) > 15
    states = drives.states()
    assert all(abs(each["velocity"]) < STANDS for motor, each in states.items() if motor in FRONT)
    assert all(each["free"] for each in states.values())
    assert "Traceback" not in driver.output


def test_a_drive_that_does_not_fit_is_named_in_the_log(start_node: Any, channel: str, drives: Drives) -> None:
    """Setting up finds it out while the phase stays what it was: the log must not end with "not heard"."""
    driver = start_node("driver", "--channel", channel, *PATIENT, "-p", "counts_per_turn.front:=1000")
    driver.wait_for("object 608Fh:1 (Position encoder resolution, Encoder increments): found 4096, expected 1000")
    driver.stop()
    assert driver.output.count("608Fh") == 1, "said once, not in every period"


def test_two_drives_with_one_id_are_named_in_the_log(start_node: Any, channel: str, drives: Drives) -> None:
    with drives_on("remote", channel):
        driver = start_node("driver", "--channel", channel, *PATIENT)
        driver.wait_for("every answer comes twice: a second node has the id 1", 60.0)
        assert driver.stop() == 0, "it ends in good order, though it never came to drive"


def shares_memory(pid: int) -> bool:
    """Whether a process has the middleware's shared memory in its own."""
    maps = Path(f"/proc/{pid}/maps").read_text()
    return "/dev/shm/fastrtps" in maps or "/dev/shm/fastdds" in maps


@pytest.mark.parametrize(
    ("given", "reach", "shares"),
    [("", "OFF", False), ("DEFAULT", "OFF", True), ("", "LOCALHOST", False), ("DEFAULT", "LOCALHOST", True)],
)
def test_the_driver_keeps_out_of_shared_memory_unless_told_otherwise(
    start_node: Any, channel: str, given: str, reach: str, shares: bool
) -> None:
    """What a killed node leaves in it is read by those that go on, and has corrupted their memory."""
    no_profile = {"FASTDDS_DEFAULT_PROFILES_FILE": "", "FASTRTPS_DEFAULT_PROFILES_FILE": ""}  # that of the tests
    env = {"FASTDDS_BUILTIN_TRANSPORTS": given, "ROS_AUTOMATIC_DISCOVERY_RANGE": reach, **no_profile}
    driver = start_node("driver", "--channel", channel, env=env)
    driver.wait_for("driver on", 60.0)
    assert shares_memory(driver.pid) == shares
    assert driver.stop() == 0


def test_a_driver_out_of_shared_memory_is_found_by_a_node_that_shares_it(
    start_node: Any, channel: str, tmp_path: Path
) -> None:
    no_profile = {"FASTDDS_DEFAULT_PROFILES_FILE": "", "FASTRTPS_DEFAULT_PROFILES_FILE": ""}
    env = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", **no_profile}
    record = start_node("record", "-o", tmp_path / "run", "-t", "/diagnostics", env=env)
    driver = start_node("driver", "--channel", channel, env=env)
    driver.wait_for("driver on", 60.0)
    record.wait_for("recording /diagnostics", 30.0)
    time.sleep(2.5)  # there is one a second
    assert shares_memory(record.pid)
    assert not shares_memory(driver.pid)
    for node in (driver, record):
        assert node.stop(20.0) == 0
    assert bag_info(tmp_path / "run").message_count > 0


def test_what_is_in_the_way_is_said_anew_when_it_has_settled() -> None:
    obstacle = Settling(1.0)
    obstacle.said("not heard")
    assert not obstacle.settles("not heard", 0.0)
    assert not obstacle.settles("being set up", 5.0), "it has only begun"
    assert not obstacle.settles("no heartbeat", 5.5), "the other one has passed"
    assert not obstacle.settles("no heartbeat", 6.4)
    assert obstacle.settles("no heartbeat", 6.5)
    assert not obstacle.settles("no heartbeat", 9.0), "once"
    assert not obstacle.settles("", 9.1)
    assert not obstacle.settles("", 20.0), "nothing in the way is the phase's to say"
    assert not obstacle.settles("no heartbeat", 21.0)
    assert not obstacle.settles("no heartbeat", 23.0), "it was said, and no other since"


@pytest.mark.parametrize(
    ("args", "says"),
    [
        (["--channel", "ws://127.0.0.1:9/"], "artibot can loopback"),
        (["--interface", "socketcan", "--channel", "nocan0"], "nocan0"),
        (["--robot", "husky"], "husky"),
        (["--ros-args", "-p", "max_speeed:=0.3"], "max_speeed: unknown; did you mean max_speed?"),
        (["--ros-args", "-p", "zzz:=0.3"], "velocity_exponent, and qos_overrides of its topics"),
        (["--kappa", "0.5"], "0.622"),
        (["--command-source", "joystick"], "joystick"),
        (["--ros-args", "-p", "command_timeout:=-1.0"], "command_timeout"),
        (["--stats", "/nowhere/at_all/stats.json"], "/nowhere/at_all"),
    ],
)
def test_what_cannot_be_used_ends_it_with_one_line(start_node: Any, args: list[str], says: str) -> None:
    node = start_node("driver", *args)
    assert node.wait() == 2
    lines = [line for line in node.output.splitlines() if not line.startswith("[INFO]")]
    assert len(lines) == 1 and says in lines[0], node.output
