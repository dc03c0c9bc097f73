"""A simulated drive does what CiA 301 and 402 say, and never moves where it may not."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from drive_bench import STEP, Bench
from hypothesis import given, settings
from hypothesis import strategies as st

from artibot_driver.cia402 import TRANSITIONS, DriveState, OperationMode, StatusBit, state_of
from artibot_driver.config import config_from_parameters
from artibot_driver.frames import Frame, Heartbeat, NmtCommand, NmtState, nmt
from artibot_driver.pdo import Pdo
from artibot_driver.rig import load_rig
from artibot_driver.simulated.drive import SimulatedDrive
from artibot_driver.simulated.motion import FREE, ShaftState
from artibot_sim.errors import ArtibotError
from artibot_sim.resources import config_path

RIG = load_rig(config_from_parameters({}))
PROFILE = load_rig(config_from_parameters({"mode.front": "profile_velocity", "mode.back": "profile_torque"}))
SPEED = 1_000_000  # 1000 rpm, 0.44 m/s


def test_power_on_is_a_boot_up_message_and_pre_operational_silence() -> None:
    bench = Bench(rig=RIG)
    bench.advance(0.1)
    assert bench.received == []
    bench.drive.power_on(bench.now)
    assert bench.received == [Heartbeat(2, NmtState.BOOT_UP)]
    bench.advance(0.1)
    bench.send(bench.rig.codec.sync())
    assert bench.received[1:] == []
    assert bench.drive.state is DriveState.SWITCH_ON_DISABLED


def test_heartbeats_come_with_their_period_and_tell_the_state() -> None:
    bench = Bench(rig=RIG)
    bench.set_up()
    bench.received.clear()
    bench.run(1.0)
    beats = [each for each in bench.received if isinstance(each, Heartbeat)]
    assert len(beats) == pytest.approx(25, abs=1)
    assert {beat.state for beat in beats} == {NmtState.OPERATIONAL}


def test_each_sync_brings_every_pdo_once_and_set_points_wait_for_it() -> None:
    bench = Bench(rig=RIG).enabled()
    bench.received.clear()
    bench.send(RIG.codec.pdo("RPDO1", bench.node, (0x0F, SPEED, 0)))
    bench.advance(0.05)
    assert bench.shaft.state().velocity == pytest.approx(0.0, abs=1e-6)
    bench.received.clear()
    bench.send(RIG.codec.sync())
    assert [each.map.name for each in bench.received if isinstance(each, Pdo)] == ["TPDO1", "TPDO2"]
    bench.advance(0.05)
    assert bench.shaft.state().velocity > 20


@pytest.mark.parametrize("rig", [RIG, PROFILE], ids=["cyclic", "profile"])
@pytest.mark.parametrize("motor", ["front_right", "front_left"])
def test_a_velocity_drive_follows_its_target(rig: object, motor: str) -> None:
    bench = Bench(motor, rig=rig).enabled()  # type: ignore[arg-type]
    bench.run(1.5, velocity=SPEED)
    assert bench.feedback("velocity_actual_value") == pytest.approx(SPEED, rel=2e-3)
    assert bench.shaft.state().velocity == pytest.approx(bench.scaling.velocity.si(SPEED), rel=2e-3)
    assert bench.feedback("statusword") & StatusBit.TARGET_REACHED
    # polarity: positive counts turn a right motor backwards, see config/agriq.yaml
    assert math.copysign(1, bench.shaft.state().position) == (-1 if motor == "front_right" else 1)
    turned = bench.scaling.position.si(bench.feedback("position_actual_value"))
    assert turned == pytest.approx(bench.shaft.state().position, abs=2.0)


@pytest.mark.parametrize("rig", [RIG, PROFILE], ids=["cyclic", "profile"])
def test_a_torque_drive_gives_its_target_to_a_permille(rig: object) -> None:
    bench = Bench("back_right", rig=rig).enabled()  # type: ignore[arg-type]
    bench.run(0.2, torque=250)
    assert bench.feedback("torque_actual_value") == 250
    assert bench.shaft.asked.torque == pytest.approx(-0.15)  # 250 ‰ of 0.6 N m, mirrored
    assert bench.shaft.asked.velocity is None


def test_a_profile_follows_its_ramps() -> None:
    bench = Bench(rig=PROFILE).enabled()
    slope = bench.drive.objects.values[0x6083, 0]
    bench.run(0.1, velocity=4 * SPEED)
    demand = bench.drive.objects.values[0x606B, 0]
    assert demand == pytest.approx(0.09 * slope, rel=0.15)  # the SYNC that takes it comes one step before
    torque = Bench("back_left", rig=PROFILE).enabled()
    torque.cycle(torque=1000)
    assert torque.shaft.asked.torque == pytest.approx(0.06, rel=0.01)  # 6 N m/s for 10 ms


def test_limits_cut_off_and_say_so() -> None:
    bench = Bench(rig=RIG).enabled()
    bench.run(0.05, velocity=2**31 - 1)
    assert bench.feedback("statusword") & StatusBit.INTERNAL_LIMIT
    limit = RIG.config.max_speed / (RIG.robot.wheel.r_w * RIG.robot.drive.front.tau)
    assert bench.shaft.asked.velocity == pytest.approx(limit, rel=1e-3)
    assert bench.shaft.asked.torque_limit == pytest.approx(0.6)
    bench.run(0.05, velocity=SPEED)
    assert not bench.feedback("statusword") & StatusBit.INTERNAL_LIMIT
    torque = Bench("back_left", rig=RIG).enabled()
    torque.run(0.05, torque=1500)
    assert torque.feedback("statusword") & StatusBit.INTERNAL_LIMIT
    assert torque.shaft.asked.torque == pytest.approx(0.6)


def slowest_stop(bench: Bench) -> float:
    """How long the stop ramp takes from 1000 rpm, s."""
    return SPEED / bench.drive.objects.values[0x6085, 0]


@pytest.mark.parametrize("rig", [RIG, PROFILE], ids=["cyclic", "profile"])
def test_a_lost_master_stops_the_motor_on_the_ramp_and_needs_a_fault_reset(rig: object) -> None:
    bench = Bench(rig=rig).enabled()  # type: ignore[arg-type]
    bench.run(1.5, velocity=SPEED)
    bench.beat()
    bench.beating = False
    bench.received.clear()
    timeout = bench.rig.config.driver_timeout
    bench.advance(timeout)
    assert bench.drive.state is DriveState.OPERATION_ENABLED
    bench.advance(2 * STEP * 1e-9)
    assert bench.drive.state is DriveState.FAULT_REACTION_ACTIVE
    assert bench.drive.nmt is NmtState.PRE_OPERATIONAL
    assert bench.emergencies() == [0x8130]
    bench.advance(slowest_stop(bench) / 2)
    half = bench.shaft.state().velocity / bench.scaling.velocity.si(SPEED)
    assert 0.3 < half < 0.7
    bench.advance(slowest_stop(bench) / 2 + 0.25)
    assert bench.drive.state is DriveState.FAULT
    assert bench.shaft.asked == FREE
    assert abs(bench.shaft.state().velocity) < 1.0
    # commands alone, heartbeat or not, move nothing; nor does a fault reset while the master is lost
    bench.send(nmt(NmtCommand.START))
    bench.run(0.1, velocity=SPEED)
    bench.controlword = 0x80
    bench.cycle()
    assert bench.drive.state is DriveState.FAULT
    bench.controlword = 0
    bench.cycle()
    bench.beating = True
    bench.beat()
    bench.controlword = 0x0F
    bench.run(0.2, velocity=SPEED)
    assert bench.drive.state is DriveState.FAULT
    bench.controlword = 0
    bench.lead_to(DriveState.OPERATION_ENABLED, reset_faults=True)
    assert bench.emergencies()[-1] == 0
    assert bench.feedback("error_register") == 0


def test_a_drive_that_never_heard_a_master_does_not_miss_one() -> None:
    bench = Bench(rig=RIG)
    bench.drive.power_on(bench.now)
    bench.write(0x1016, 0x7F0096, 1)
    bench.advance(1.0)
    assert bench.drive.state is DriveState.SWITCH_ON_DISABLED


@pytest.mark.parametrize(
    ("action", "state"),
    [(0, DriveState.OPERATION_ENABLED), (2, DriveState.SWITCH_ON_DISABLED), (3, DriveState.QUICK_STOP_ACTIVE)],
)
def test_other_reactions_to_a_lost_master_are_those_of_6007h(action: int, state: DriveState) -> None:
    bench = Bench(rig=RIG).enabled()
    bench.write(0x6007, action)
    bench.run(1.0, velocity=SPEED)
    bench.beating = False
    bench.received.clear()
    bench.advance(0.16)
    assert bench.drive.state is state
    assert bench.emergencies() == [0x8130]
    bench.beat()
    assert bench.emergencies() == [0x8130, 0]


@pytest.mark.parametrize("code", [0, 1, 2, 5, 6])
def test_quick_stop_brakes_as_605ah_says(code: int) -> None:
    bench = Bench(rig=RIG).enabled()
    bench.write(0x605A, code)
    bench.run(1.0, velocity=SPEED)
    bench.controlword = 0x02
    bench.cycle()
    assert bench.drive.state is (DriveState.QUICK_STOP_ACTIVE if code else DriveState.SWITCH_ON_DISABLED)
    bench.run(slowest_stop(bench) + 0.4)
    assert bench.drive.state is (DriveState.QUICK_STOP_ACTIVE if code > 4 else DriveState.SWITCH_ON_DISABLED)
    assert (bench.shaft.asked == FREE) is (code <= 4)
    if code:
        assert abs(bench.shaft.state().velocity) < 1.0
    bench.controlword = 0x0F
    bench.cycle()
    assert (bench.drive.state is DriveState.OPERATION_ENABLED) is (code > 4)


def test_a_motor_that_does_not_come_to_rest_is_let_go() -> None:
    bench = Bench(rig=RIG).enabled()
    bench.run(1.0, velocity=SPEED)
    bench.shaft.friction = -0.02  # driven from outside, beyond what the motor can hold
    bench.shaft.inertia = 1.0
    bench.controlword = 0x02
    bench.run(slowest_stop(bench) + 0.6)
    assert bench.drive.state is DriveState.SWITCH_ON_DISABLED
    assert bench.shaft.asked == FREE


def test_halt_stops_and_lets_go_on() -> None:
    bench = Bench(rig=RIG).enabled()
    bench.run(1.0, velocity=SPEED)
    bench.controlword = 0x10F
    bench.run(1.0, velocity=SPEED)
    assert abs(bench.shaft.state().velocity) < 1.0
    assert bench.drive.state is DriveState.OPERATION_ENABLED
    bench.controlword = 0x0F
    bench.run(1.0, velocity=SPEED)
    assert bench.feedback("velocity_actual_value") == pytest.approx(SPEED, rel=1e-2)


def test_a_fault_of_its_own_is_told_and_outlasts_a_reset_while_its_cause_does() -> None:
    bench = Bench("back_left", rig=RIG).enabled()
    bench.run(0.2, torque=300)
    bench.received.clear()
    bench.drive.fail(0x4310, 0x09, lasting=True)
    assert bench.emergencies() == [0x4310]
    bench.run(0.3, torque=300)
    assert bench.drive.state is DriveState.FAULT
    assert bench.shaft.asked == FREE
    assert (bench.feedback("error_code"), bench.feedback("error_register")) == (0x4310, 0x09)
    for word in (0x80, 0x00, 0x80, 0x00):
        bench.controlword = word
        bench.cycle()
    assert bench.drive.state is DriveState.FAULT
    bench.drive.mend()
    bench.lead_to(DriveState.OPERATION_ENABLED, reset_faults=True)
    assert bench.drive.objects.values[0x1003, 0] == 1
    assert bench.drive.objects.values[0x1003, 1] == 0x4310


@pytest.mark.parametrize("broken", [math.nan, math.inf])
def test_an_encoder_that_fails_is_a_fault_and_the_motor_is_free(broken: float) -> None:
    bench = Bench(rig=RIG).enabled()
    bench.run(0.2, velocity=SPEED)
    bench.shaft._state = ShaftState(broken, broken, 0.0)
    bench.send(RIG.codec.sync())
    bench.advance(0.01)
    assert bench.drive.state is DriveState.FAULT
    assert bench.shaft.asked == FREE
    assert 0x7300 in bench.emergencies()


@pytest.mark.parametrize("command", [NmtCommand.STOP, NmtCommand.ENTER_PRE_OPERATIONAL, NmtCommand.RESET_COMMUNICATION])
def test_leaving_operational_stops_a_moving_drive(command: NmtCommand) -> None:
    bench = Bench(rig=RIG).enabled()
    bench.run(1.0, velocity=SPEED)
    bench.send(nmt(command, bench.node))
    assert bench.drive.state is DriveState.FAULT_REACTION_ACTIVE
    bench.advance(slowest_stop(bench) + 0.4)
    assert bench.drive.state is DriveState.FAULT
    assert abs(bench.shaft.state().velocity) < 1.0


def test_a_reset_of_the_node_frees_the_motor_at_once_and_forgets_all() -> None:
    bench = Bench(rig=RIG).enabled()
    bench.run(1.0, velocity=SPEED)
    bench.send(nmt(NmtCommand.RESET_NODE))
    assert bench.shaft.asked == FREE
    assert isinstance(bench.received[-1], Heartbeat)
    assert bench.received[-1].state is NmtState.BOOT_UP
    assert bench.drive.objects.values[0x6060, 0] == 0
    bench.send(nmt(NmtCommand.START))
    bench.run(0.2, velocity=SPEED)
    assert bench.shaft.asked == FREE


def test_commands_for_others_and_cut_ones_are_not_ours() -> None:
    bench = Bench(rig=RIG).enabled()
    for frame in (
        nmt(NmtCommand.STOP, bench.node + 1),
        Frame(0, b"\x02"),
        Frame(0, b"\x02\x00\x00"),
        Frame(0, b"\x07\x00"),
    ):
        bench.send(frame)
    assert bench.drive.nmt is NmtState.OPERATIONAL


def test_a_cut_set_point_changes_nothing_and_is_told_once() -> None:
    bench = Bench(rig=RIG).enabled()
    bench.run(0.5, velocity=SPEED)
    bench.received.clear()
    for _ in range(50):
        bench.send(Frame(0x200 + bench.node, bytes(7)))
    assert bench.emergencies() == [0x8210]
    bench.send(RIG.codec.sync())
    assert bench.drive.state is DriveState.OPERATION_ENABLED
    assert bench.drive.objects.values[0x60FF, 0] == SPEED


def test_without_a_mode_nothing_moves() -> None:
    bench = Bench(rig=RIG).enabled()
    bench.write(0x6060, 0)
    bench.run(0.2, velocity=SPEED, torque=500)
    assert bench.shaft.asked == FREE


def test_an_eds_without_what_is_simulated_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "other.eds"
    text = config_path("eds", "drive").read_text(encoding="utf-8").replace("[6087]", "[2087]")
    path.write_text(text, encoding="utf-8")
    rig = load_rig(config_from_parameters({"eds": str(path)}))
    with pytest.raises(ArtibotError, match="a simulated drive needs objects 6087h; use the EDS 'drive'"):
        SimulatedDrive(rig, "front_left", Bench(rig=RIG).shaft, print)


ALLOWED = {(row.start, row.end) for row in TRANSITIONS}
FRAMES = st.one_of(
    st.builds(Frame, st.integers(0, 0x7FF), st.binary(max_size=8)),
    st.builds(Frame, st.sampled_from([0x202, 0x602, 0x000, 0x77F, 0x080]), st.binary(max_size=8)),
    st.builds(
        lambda word, velocity, torque: RIG.codec.pdo("RPDO1", 2, (word, velocity, torque)),
        st.sampled_from([0x00, 0x02, 0x06, 0x07, 0x0F, 0x80, 0x10F]),
        st.integers(-(2**31), 2**31 - 1),
        st.integers(-(2**15), 2**15 - 1),
    ),
    st.just(RIG.codec.sync()),
    st.builds(nmt, st.sampled_from(NmtCommand), st.sampled_from([0, 2])),
)


class Watched(SimulatedDrive):
    """A drive whose every change of state is noted."""

    def __setattr__(self, name: str, value: object) -> None:
        if name == "state" and hasattr(self, "state"):
            self.__dict__.setdefault("changes", []).append((self.state, value))
        super().__setattr__(name, value)


@settings(max_examples=60, deadline=None)
@given(frames=st.lists(st.tuples(FRAMES, st.sampled_from([0, 1, 2, 50])), max_size=60), enabled=st.booleans())
def test_no_frames_whatever_make_it_do_what_the_table_does_not_allow(
    frames: list[tuple[Frame, int]], enabled: bool
) -> None:
    bench = Bench(rig=RIG)
    bench.drive = Watched(RIG, "front_left", bench.shaft, bench._receive)
    bench.set_up()
    if enabled:
        bench.enabled()
    for frame, steps in frames:
        bench.send(frame)
        bench.advance(steps * STEP * 1e-9)
        powered = bench.drive.state in (
            DriveState.OPERATION_ENABLED,
            DriveState.QUICK_STOP_ACTIVE,
            DriveState.FAULT_REACTION_ACTIVE,
        )
        assert powered or bench.shaft.asked == FREE
        limit = bench.scaling.velocity.si(bench.drive.objects.values[0x6080, 0] * 1000)
        assert abs(bench.shaft.asked.velocity or 0.0) <= abs(limit) * (1 + 1e-9)
    restarts = (DriveState.NOT_READY_TO_SWITCH_ON,)
    for change in bench.drive.changes:  # type: ignore[attr-defined]
        assert change in ALLOWED or change[1] in restarts, change
    reported = state_of(bench.drive.objects.values[0x6041, 0])
    assert reported is not None or bench.drive.objects.values[0x6041, 0] == 0


def test_supported_modes_are_the_rig_s() -> None:
    bench = Bench(rig=RIG)
    bench.drive.power_on(0)
    for mode in OperationMode:
        bench.write(0x6060, int(mode))
        assert bench.drive.objects.values[0x6060, 0] == int(mode)
