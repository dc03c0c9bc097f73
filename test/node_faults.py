"""What the driver node must do when commands end, go wrong, or it is killed: one suite for any bus.

Each kind of fault is tried ``ARTIBOT_TRIALS`` times (once if not given) at random speeds and moments, from the seed
``ARTIBOT_SEED`` (printed). When the reaction begins is read from the frames on the bus. Where the machine held
something up meanwhile the trial is void, and another one is made.
"""

from __future__ import annotations

import contextlib
import os
import random
import secrets
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed; run `make setup`, or source a ROS 2 Jazzy")

from driver_probe import PRIORITY, DriverProbe, Drives, Sniffer, drives_on, prompt
from sim_probe import METRES

from artibot_driver.config import config_from_parameters
from artibot_driver.faults import watchdog
from artibot_driver.faults.watchdog import Stall, Watchdog
from artibot_driver.frames import Emcy
from artibot_driver.pdo import Pdo
from artibot_driver.rig import load_rig
from artibot_driver.simulated.node import HEARTBEAT_LOST
from ros_helpers import NodeProcess, NodeStarter, ros_processes

TRIALS = int(os.environ.get("ARTIBOT_TRIALS", "1"))
SEED = int(os.environ.get("ARTIBOT_SEED", secrets.randbits(31)))

STANDS = 12.0
"""Motor speed at which a flywheel counts as standing, rad/s (0.05 m/s over ground): it lags behind its ramp by as much
and coasts when it is let go."""

DECELERATION = 2.0
PERIOD = 0.01
REACTION = 0.15
"""Longest time until the driver's reaction begins, s."""

BY_DRIVES = 0.3
"""And where only the drives can notice, s."""

TIMEOUT = 0.1
HELD_UP = max(5, TRIALS)
"""So many trials in a row may be void because the machine held up those who command."""

ENABLED_WORD = 0x0F
RIG = load_rig(config_from_parameters({}))
LOOKED_AT = [base + node for base in (0x80, 0x200) for node in RIG.codec.nodes.values()]
"""Emergencies and set-points."""

FRONT_NODES = (RIG.codec.nodes["front_right"], RIG.codec.nodes["front_left"])

BusAddress = tuple[str, str]


@dataclass
class Rover:
    """A driver on a bus with four drives, and who commands it and listens.

    Attributes
    ----------
    held_up : float
        Longest wait that the watchdog has seen in this trial, s.
    said : int
        Characters that the driver had printed when the trial began.
    """

    address: BusAddress
    start_node: NodeStarter
    probe: DriverProbe
    drives: Drives
    sniffer: Sniffer
    driver: NodeProcess
    watchdog: Watchdog
    rng: random.Random
    reactions: list[float] = field(default_factory=list)
    void: int = 0
    held_up: float = 0.0
    said: int = 0

    @property
    def news(self) -> str:
        """What the driver has printed in this trial."""
        return self.driver.output[self.said :]

    def enable(self) -> None:
        """Whatever the last trial has left: disabled drives without a fault, then enabled."""
        probe = self.probe
        probe.forget()
        self.sniffer.frames.clear()
        if probe.part("driver").get("phase") == "ENABLED":
            assert probe.call_driver("disable").success
        probe.until(lambda: probe.part("driver").get("phase") in ("READY", "LOCKED"), "drives that are set up", 60.0)
        if probe.part("driver")["phase"] == "LOCKED":
            answer = probe.call_driver("reset_fault")
            assert answer.success, answer.message
        probe.enabled()
        probe.until(lambda: probe.part("driver")["phase"] == "ENABLED", "news of that", 5.0)

    def drive(self, send: Callable[[], None]) -> None:
        """Enable and command for a random while; anew where commands or drives were held up: that is silence."""
        for _ in range(HELD_UP):
            self.enable()
            end, last, gap = time.monotonic() + self.rng.uniform(0.6, 1.2), time.monotonic(), 0.0
            while last < end:
                send()
                self.probe.spin(0.02)
                gap, last = max(gap, time.monotonic() - last), time.monotonic()
            if gap < TIMEOUT - 0.02 and self.probe.part("driver")["phase"] == "ENABLED":
                self.moves()
                self.begin()
                return
            self.void += 1
            self.probe.spin(2.0)
        pytest.fail(f"this machine is too busy: {HELD_UP} times the commands stopped by themselves")

    def follow_planner(self) -> NodeProcess:
        """Enable and start a planner whose profile is followed for a random while; anew where it was held up."""
        probe = self.probe
        for _ in range(HELD_UP):
            self.enable()
            planner = self.start_node("planner", "table6_agriq", "--start-delay", 0.3)
            deadline = time.monotonic() + 40.0
            probe.until(
                lambda: (
                    probe.turning() > 4 * STANDS
                    or time.monotonic() > deadline  # noqa: B023
                    or probe.part("driver")["phase"] != "ENABLED"
                ),
                "a profile or a stop",
                60.0,
            )
            probe.spin(self.rng.uniform(0.1, 1.0))
            if probe.turning() > 2 * STANDS and probe.part("driver")["phase"] == "ENABLED":
                self.begin()
                return planner
            planner.stop()
            self.void += 1
            probe.spin(1.0)
        pytest.fail(f"this machine is too busy: {HELD_UP} planners were not followed")

    def begin(self) -> None:
        """From now on it counts who has to wait, and what is said."""
        self.watchdog.longest()
        self.held_up, self.said = 0.0, len(self.driver.output)

    def stall(self) -> Stall:
        """The longest wait since this was asked last."""
        found = self.watchdog.longest()
        self.held_up = max(self.held_up, found.seconds)
        return found

    def moves(self) -> None:
        """That the wheels turn as they were told to."""
        told = [(node, round(velocity)) for _, node, velocity, _ in self.commands(time.monotonic() - 0.1)]
        assert self.probe.turning() > 2 * STANDS, f"seed {SEED}: {told}, {self.probe.part('driver')}"

    def commands(self, since: float) -> Iterator[tuple[float, int, float, int]]:
        """Time, node, target velocity (rad/s) and controlword of every RPDO1 since then."""
        for at, each in self.sniffer.decoded(RIG.codec, since):
            if isinstance(each, Pdo) and each.map.to_drive:
                motor = next(motor for motor, node in RIG.codec.nodes.items() if node == each.node)
                velocity = RIG.scaling[motor].velocity.si(each.value("target_velocity"))
                yield at, each.node, velocity, each.value("controlword")

    def reaction(self, since: float, told: dict[int, float]) -> float:
        """Seconds from `since` until a front drive was told to go slower than `told` (rad/s by node), or let go."""
        for at, node, velocity, word in self.commands(since):
            if node in told and (abs(velocity) < 0.995 * abs(told[node]) or word != ENABLED_WORD):
                return at - since
        raise AssertionError("no reaction on the bus")

    def check_stop(self, since: float, reasons: set[str], fresh: Callable[[], None], speed: float) -> None:
        """That all comes to rest in time, says why, and does not move again by fresh commands alone.

        Parameters
        ----------
        reasons : set of str
            Those that may be given.
        fresh : callable
            Sends one good command.
        speed : float
            Of the faster front motor before, rad/s.
        """
        probe = self.probe
        rest = since + REACTION + speed * METRES / DECELERATION + 0.25
        probe.spin(max(0.0, rest - time.monotonic()))
        self.check_rest()
        probe.until(lambda: any(map(probe.is_stopped_by, reasons)), f"{reasons} in /diagnostics", 5.0)
        assert probe.part("driver")["message"].removeprefix("stopped: ") in self.news
        later = time.monotonic()
        probe.repeat(fresh, 0.3)
        assert all(word != ENABLED_WORD for *_, word in self.commands(later)), "enabled without being asked to"
        self.check_rest()
        assert self.driver.running and "Traceback" not in self.driver.output

    def check_rest(self) -> None:
        """All four at standstill or without torque, and the front ones no faster than they may lag behind a ramp.

        Whoever was held up makes the lag longer.
        """
        self.stall()
        coasts = STANDS + self.held_up * DECELERATION / METRES
        for motor, state in self.drives.states().items():
            assert state["free"] or abs(state["velocity"]) < STANDS, (motor, state)
            if motor.startswith("front"):
                assert abs(state["velocity"]) < coasts, (motor, state, coasts)

    def sources(self) -> Iterator[str]:
        """Who commands, those two in turns: as many trials as are wanted, one of each at least."""
        for _ in self.trials(max(TRIALS, 2)):
            yield ("live", "cmd_vel")[len(self.reactions) % 2]

    def trials(self, wanted: int = TRIALS) -> Iterator[int]:
        """Turns, until so many trials are judged as are wanted."""
        for number in range(3 * wanted + HELD_UP):
            if len(self.reactions) == wanted:
                return
            yield number
        pytest.fail(f"this machine is too busy: {self.void} trials were held up, {len(self.reactions)} were not")

    def note(self, seconds: float, limit: float) -> None:
        """Keep how long a reaction took, which must be within the limit, unless the machine held something up."""
        stall = self.stall()
        if stall.seconds > watchdog.HELD_UP:
            print(f"void: {stall.whose} was held up for {1e3 * stall.seconds:.0f} ms", flush=True)
            self.void += 1
            return
        self.reactions.append(seconds)
        print(f"trial {len(self.reactions)}, seed {SEED}: reaction after {1e3 * seconds:.0f} ms", flush=True)
        assert seconds <= limit, f"reaction after {seconds:.3f} s, seed {SEED}"

    def report(self, what: str) -> None:
        """Print the trials' summary."""
        ms = 1e3 * np.array(self.reactions)
        print(
            f"{what}: {len(ms)} trials, seed {SEED}: reaction after {np.median(ms):.0f} ms (median), "
            f"{ms.max():.0f} ms at most; {self.void} void"
        )


def start_driver(start_node: NodeStarter, address: BusAddress) -> NodeProcess:
    """A driver that listens to cmd_vel as impatiently as to live requests."""
    parameters = ["--ros-args", "-p", "cmd_vel_timeout:=0.1"]
    parameters += [] if PRIORITY else ["-p", "realtime_priority:=0"]
    return start_node("driver", "--interface", address[0], "--channel", address[1], *parameters)


@contextlib.contextmanager
def running_rover(address: BusAddress, folder: Path) -> Iterator[Rover]:
    """A rover whose drives are set up: for several tests, for it takes long to start; its files go into `folder`."""
    with contextlib.ExitStack() as stack:
        start_node, context = stack.enter_context(ros_processes("faults", folder))
        driver = start_driver(start_node, address)
        watched = stack.enter_context(Watchdog(watchdog.WATCHING if PRIORITY else 0))
        drives = stack.enter_context(drives_on(*address))
        sniffer = stack.enter_context(Sniffer(*address, LOOKED_AT))
        stack.enter_context(prompt())
        probe = DriverProbe(context, ["motor_torques"])
        probe.until(lambda: probe.got["motor_torques"] != [] or not driver.running, "the driver's topics", 120.0)
        assert driver.running, driver.output
        probe.listened()
        yield Rover(address, start_node, probe, drives, sniffer, driver, watched, random.Random(SEED))


class NodeFaults:
    """The suite: derive, and give a fixture `running` with one rover for all tests."""

    @pytest.fixture
    def rover(self, running: Rover) -> Rover:
        """It, without trials."""
        running.reactions, running.void, running.rng = [], 0, random.Random(SEED)
        return running

    def test_command_silence(self, rover: Rover) -> None:
        for source in rover.sources():
            send, told = good_command(rover, source)
            rover.drive(send)
            send()
            last = time.monotonic()
            rover.probe.spin(0.3)
            rover.note(rover.reaction(last + 0.02, told) + 0.02, REACTION)
            rover.check_stop(last, {"COMMAND_SILENCE"}, send, max(map(abs, told.values())))
        rover.report("commands silent")

    def test_bad_commands(self, rover: Rover) -> None:
        for source in rover.sources():
            send, told = good_command(rover, source)
            rover.drive(send)
            bad = bad_command(rover, source)
            began = time.monotonic()
            rover.probe.repeat(bad, 0.3)
            rover.note(rover.reaction(began, told), REACTION)
            assert "refused: " in rover.news
            rover.check_stop(began, {"INVALID_COMMAND", "COMMAND_SILENCE"}, send, max(map(abs, told.values())))
        rover.report("commands not a number or out of range")

    def test_planner_killed(self, rover: Rover) -> None:
        probe = rover.probe
        for _ in rover.trials():
            planner = rover.follow_planner()
            planner.send(signal.SIGKILL)
            killed = time.monotonic()
            probe.spin(0.3)
            rover.note(braking_after(rover, killed), REACTION)
            rover.check_stop(killed, {"COMMAND_SILENCE"}, lambda: probe.send_twist(0.3, 0.0), 500.0)
        rover.report("planner killed")

    def test_driver_killed(self, rover: Rover) -> None:
        for _ in rover.trials():
            send, told = good_command(rover, "live")
            rover.drive(send)
            rover.driver.send(signal.SIGKILL)
            killed = time.monotonic()
            rover.probe.spin(BY_DRIVES + 0.1)
            noticed = {
                each.node: at - killed
                for at, each in rover.sniffer.decoded(RIG.codec, killed)
                if isinstance(each, Emcy) and each.code == HEARTBEAT_LOST
            }
            assert set(noticed) == set(RIG.codec.nodes.values()), "all four together"
            rover.note(max(noticed.values()), BY_DRIVES)
            rest = killed + BY_DRIVES + max(map(abs, told.values())) * METRES / DECELERATION + 0.25
            rover.probe.spin(max(0.0, rest - time.monotonic()))
            rover.check_rest()
            rover.probe.diagnostics.clear()
            rover.driver = start_driver(rover.start_node, rover.address)
            rover.probe.until(lambda: rover.probe.part("driver") != {}, "the next driver", 60.0)
            rover.probe.repeat(send, 0.3)
            rover.check_rest()
        rover.report("driver killed")


def good_command(rover: Rover, source: str) -> tuple[Callable[[], None], dict[int, float]]:
    """Something to send again and again, and the front motors' speeds (rad/s) by node that it leads to."""
    rng, probe = rover.rng, rover.probe
    fast = rng.choice((-1.0, 1.0)) * rng.uniform(0.25, 0.8)
    if source == "live":
        pair = (fast / METRES, rng.uniform(0.4, 1.0) * fast / METRES)
        return (lambda: probe.send_request(pair)), dict(zip(FRONT_NODES, pair, strict=True))
    fast *= 0.6  # so that it is reached at the acceleration limit
    return (lambda: probe.send_twist(fast, 0.0)), dict.fromkeys(FRONT_NODES, fast / METRES)


def bad_command(rover: Rover, source: str) -> Callable[[], None]:
    """Something that must be refused."""
    number = rover.rng.choice((float("nan"), float("inf"), -float("inf"), 1e6, -1e300))
    if source == "live":
        pair = [number, 30.0] if rover.rng.random() < 0.5 else [30.0, number]
        return lambda: rover.probe.send_request(pair)
    return lambda: rover.probe.send_twist(number, 0.1)


def braking_after(rover: Rover, since: float) -> float:
    """Seconds from `since` until a front drive is slowed down as on a ramp, which no profile does, or let go."""
    last: dict[int, float] = {}
    for at, node, velocity, word in rover.commands(since - 0.05):
        if node not in FRONT_NODES:
            continue
        slower = (abs(last.get(node, 0.0)) - abs(velocity)) * METRES
        if at > since and (word != ENABLED_WORD or slower >= 0.5 * DECELERATION * PERIOD):
            return at - since
        last[node] = velocity
    raise AssertionError("no ramp on the bus")
