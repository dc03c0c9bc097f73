"""What must follow a fault on any bus: one abstract suite, run on the loopback bus and on a real vcan, in real time.

Each trial is drawn from ``ARTIBOT_SEED``; ``ARTIBOT_TRIALS`` gives more of each, ``make faults-live`` whole campaigns.
A trial that the machine held up is void, and made again.
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from artibot_driver.cia402 import DriveState
from artibot_driver.config import config_from_parameters
from artibot_driver.faults import campaign
from artibot_driver.faults.catalogue import ON_A_BUS
from artibot_driver.faults.live_loop import LiveLoop, SwitchableBus
from artibot_driver.faults.watchdog import HELD_UP, Stall, Watchdog, attended
from artibot_driver.frames import Frame
from artibot_driver.master import Phase
from artibot_driver.rig import Rig, load_rig

TRIALS, SEED = int(os.environ.get("ARTIBOT_TRIALS", "1")), int(os.environ.get("ARTIBOT_SEED", "1"))

FAULTS = tuple(name for name in ON_A_BUS if name not in ("drive without supply", "drive lets go", "speed out of range"))
"""Those that are like another one are left to campaigns, and to the tests in time of their own."""

if "IN_UML" in os.environ and "ARTIBOT_TRIALS" not in os.environ:  # emulation is slow: what only its kernel can show
    FAULTS = ("drive unplugged", "driver killed", "bus down", "bus-off", "bus flooded", "10 % of frames lost")
    FAULTS += ("unknown nodes",)


class SafetyContract:
    """Inherit, and give fixtures: ``site``, a :class:`SwitchableBus`, and ``words`` that name it to another process."""

    @pytest.fixture
    def rig(self) -> Rig:
        return load_rig(config_from_parameters({}))

    @pytest.fixture
    def watchdog(self) -> Iterator[Watchdog]:
        with attended() as found:
            yield found

    @pytest.mark.parametrize("name", FAULTS)
    def test_what_must_follow_a_fault_does(self, site: SwitchableBus, watchdog: Watchdog, name: str) -> None:
        rig = campaign.live_rig([name])
        for number in range(TRIALS):
            outcome = campaign.live_trial(number, SEED, [name], rig, site, watchdog)
            print(f"seed {SEED}, trial {number}: {outcome}")
            assert outcome.judged, f"{outcome.void} trials were held up, the machine is too busy: {outcome.complaints}"
            assert not outcome.complaints, (f"seed {SEED}, trial {number}", outcome)

    def test_a_driver_that_is_killed_is_missed_by_the_drives(
        self, site: SwitchableBus, words: tuple[str, str], rig: Rig, watchdog: Watchdog
    ) -> None:
        """Another process drives and is SIGKILLed: all four are at standstill or free after 0.3 s and the ramp."""
        for _ in range(TRIALS):
            for _ in range(campaign.LIVE_TRIES):
                took, stall = self.kill_one(site, words, rig, watchdog)
                if stall.seconds <= HELD_UP:
                    break
            else:
                pytest.fail(f"every trial was held up: this machine is too busy: {stall}")
            assert took < 0.3 + 0.5 / rig.config.stop_deceleration + 0.1

    def kill_one(
        self, site: SwitchableBus, words: tuple[str, str], rig: Rig, watchdog: Watchdog
    ) -> tuple[float, Stall]:
        """Have another process drive and kill it; the time until all is at rest, s, and who was held up meanwhile."""
        script = Path(__file__).with_name("driving_process.py")
        with LiveLoop(rig, random.Random(SEED), site) as loop:
            loop.hung = True
            driver = subprocess.Popen([sys.executable, str(script), *words], stdout=subprocess.PIPE, text=True)
            try:
                assert driver.stdout is not None
                assert driver.stdout.readline() == "driving\n"
                watchdog.longest()  # a process that starts is busy
                loop.run(0.1)
                assert {*loop.trace[-1].drives.state} == {DriveState.OPERATION_ENABLED}
                assert loop.trace[-1].drives.asked[0].velocity == pytest.approx(0.5 * loop.turn, rel=1e-3)
                driver.send_signal(signal.SIGKILL)
                begin = time.monotonic()
                self.wait_for_rest(loop)
                took, stall = time.monotonic() - begin, watchdog.longest()
            finally:
                driver.kill()
                driver.communicate()
            assert {*loop.trace[-1].drives.state} <= {DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE}
            loop.hung = False
            assert loop.run_until(Phase.LOCKED, 2.0), loop.last.status
            loop.master.reset_fault()
            assert loop.run_until(Phase.READY, 1.0), loop.last.status
        return took, stall

    def wait_for_rest(self, loop: LiveLoop) -> None:
        """Let time pass until every motor is free, or slow and without torque."""
        until = time.monotonic() + 5.0
        while time.monotonic() < until:
            loop.run(0.01)
            seen = loop.trace[-1].drives
            slow = [abs(velocity) < 0.03 * loop.turn for velocity in seen.velocity[:2]]
            if all(asked.is_free or asked.torque == 0 for asked in seen.asked[2:]) and all(
                asked.is_free or is_slow for asked, is_slow in zip(seen.asked[:2], slow, strict=True)
            ):
                return
        raise AssertionError(f"still turning: {seen}")

    def test_a_flood_of_our_own_identifiers_does_not_move_the_rover(self, site: SwitchableBus, rig: Rig) -> None:
        """Random data under the drives' and the driver's identifiers, at rest: nothing is ever asked of a motor."""
        rng = random.Random(SEED)
        ours = [can_id for can_id in range(0x80, 0x800) if rig.codec.knows(can_id) and can_id & 0x7F in (1, 2, 3, 4)]
        with LiveLoop(rig, rng, site) as loop:
            assert loop.run_until(Phase.READY, 5.0), loop.last.status
            for _ in range(100):
                loop.inject([Frame(rng.choice(ours), rng.randbytes(rng.randrange(9))) for _ in range(20)])
                loop.run(0.01)
                assert not loop.last.status.phase.moves
            assert sum(loop.last.status.counters.values()) > 500
