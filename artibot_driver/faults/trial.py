"""One trial: bring the loop up, drive, let a fault happen, and hold what follows against what must."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Final

from artibot_driver.cia402 import DriveState
from artibot_driver.faults.catalogue import Fault
from artibot_driver.faults.closed_loop import ClosedLoop, PeriodSample
from artibot_driver.faults.outcomes import NotReady, TrialOutcome
from artibot_driver.master import Phase, Setpoints, StopReason, StopRecord
from artibot_sim.model import MOTORS

REJOIN: Final = 2.0
"""After the fault all drives are to be set up again within this time, s."""

STANDSTILL: Final = 0.03
"""A wheel slower than this over ground stands, m/s."""

LAG: Final = 0.1
"""A motor may be so far behind its set-point when the ramp ends, s."""

LEAP: Final = 0.06
"""A drive that begins a ramp of its own begins it at what its motor does, which lags behind, m/s."""


class FaultTrial:
    """One fault in a loop.

    Parameters
    ----------
    loop : ClosedLoop
    fault : Fault
    motor : str
        Which drive is concerned, where one is.
    """

    def __init__(self, loop: ClosedLoop, fault: Fault, motor: str) -> None:
        self.loop, self.fault = loop, fault
        self.outcome = TrialOutcome(fault.name, fault.group or fault.name, motor)
        rng = loop.rng
        self.speed = rng.uniform(0.2, 1.2)  # of the faster front wheel over ground, m/s
        sides = [self.speed * rng.choice((-1, 1)), 0.0]
        sides[1] = sides[0] * rng.uniform(0.3, 1.0)
        rng.shuffle(sides)
        self.velocity = (sides[0] * loop.turn, sides[1] * loop.turn)
        self.duration = rng.uniform(0.4, 1.2)

    def run(self) -> TrialOutcome:
        """Do it all.

        Raises
        ------
        NotReady
            When the loop does not come up.
        """
        loop, fault, motor = self.loop, self.fault, self.outcome.motor
        self.get_moving()
        loop.run(loop.rng.uniform(0.0, 0.1))
        begin, first = loop.now, len(loop.trace)
        fault.inject(loop, motor)
        watched = BEFORE_END + fault.held + self.speed / loop.rig.config.stop_deceleration
        loop.run(watched + self.duration)
        stop = _stop_in(loop.trace[first:])
        left = 0.0 if stop is None else watched - 1e-9 * (loop.now - stop.at_ns)
        if left > 0.0:  # a stop that came late takes its time, too
            loop.run(left)
        self.judge(begin, loop.trace[first:])
        if self.outcome.stopped:
            self.come_back(first)
        else:
            fault.mend(loop, motor)
            self.expect(loop.last.status.phase is Phase.ENABLED, "is not enabled any more, though it did not stop")
        return self.outcome

    def expect(self, is_so: bool, complaint: str) -> None:
        """Note what is not as it must be."""
        if not is_so:
            self.outcome.complaints.append(complaint)

    def get_moving(self) -> None:
        """Up, enabled, and at the commanded speed."""
        loop = self.loop
        if not loop.run_until(Phase.READY, 5.0):
            raise NotReady(f"not ready after 5 s: {_troubles(loop)}")
        loop.master.enable()
        if not loop.run_until(Phase.ENABLED, 2.0):
            raise NotReady(f"not enabled: {loop.last.status.stop}")
        self.command_freshly()
        loop.run(0.3)
        if loop.last.status.phase is not Phase.ENABLED or not self.as_commanded(loop.trace[-1]):
            raise NotReady(f"not driving: {loop.last.status.stop}")

    def command_freshly(self) -> None:
        """Somebody commands, and goes on doing so."""
        velocity = self.velocity
        self.loop.command = lambda now: Setpoints(velocity, now)

    def as_commanded(self, sample: PeriodSample) -> bool:
        """Whether the front drives have the commanded set-points."""
        step = abs(self.loop.rig.scaling[MOTORS[0]].velocity.step)
        asked = [each.velocity for each in sample.drives.asked[:2]]
        return all(a is not None and abs(a - v) <= step for a, v in zip(asked, self.velocity, strict=True))

    def judge(self, begin: int, samples: Sequence[PeriodSample]) -> None:
        """Whether it stopped as it must, or went on as it may."""
        outcome, fault = self.outcome, self.fault
        stop = _stop_in(samples)
        changed = [s for s in samples if not self.as_commanded(s)]
        outcome.stopped = stop is not None or bool(changed)
        if not outcome.stopped:
            self.expect(not fault.stops, "went on, and had to stop")
            return
        if stop is not None:
            outcome.reason = stop.reason
            begin = begin if fault.stops else stop.at_ns
            allowed = fault.reasons or tuple(StopReason)
            self.expect(stop.reason in allowed, f"gave the reason '{stop.reason.name}': {stop.text}")
        self.judge_times(begin, samples)

    def judge_times(self, begin: int, samples: Sequence[PeriodSample]) -> None:
        """When the motors were slowed down, and when they stood or were free."""
        outcome, fault, config = self.outcome, self.fault, self.loop.rig.config
        ramp = self.speed / config.stop_deceleration
        reactions, ends = [], []
        for k in range(len(MOTORS)):
            name = MOTORS[k]
            slowed = _first_after(begin, samples, partial(self._slowed, k))
            ended = _for_good_after(begin, samples, partial(self._ended, k))
            within = max(fault.within, fault.own if name == outcome.motor else 0.0)
            self.expect(k > 1 or slowed <= within + TICK, f"{name} was not slowed down within {within} s: {slowed:.3f}")
            rest = within + ramp + fault.held
            self.expect(ended <= rest + LAG, f"{name} was not at rest in {rest:.2f} s: {ended:.3f}")
            reactions.append(slowed if k < 2 and not (fault.own and name == outcome.motor) else 0.0)
            ends.append(ended)
        outcome.reaction, outcome.standing = max(reactions), max(ends)
        self.expect_calm(begin, samples)

    def _slowed(self, k: int, sample: PeriodSample) -> bool:
        asked = sample.drives.asked[k]
        if k > 1:
            return asked.is_free
        return asked.velocity is None or abs(asked.velocity) < 0.999 * abs(self.velocity[k])

    def _ended(self, k: int, sample: PeriodSample) -> bool:
        asked = sample.drives.asked[k]
        if asked.is_free or asked.torque == 0.0:
            return True
        return k < 2 and abs(sample.drives.velocity[k]) < STANDSTILL * self.loop.turn

    def expect_calm(self, begin: int, samples: Sequence[PeriodSample]) -> None:
        """From the reaction on nothing is asked for that is faster than before."""
        for k in range(2):
            least = math.inf
            for sample in samples:
                if sample.now < begin or (math.isinf(least) and not self._slowed(k, sample)):
                    continue
                asked = abs(sample.drives.asked[k].velocity or 0.0)
                self.expect(asked <= least + LEAP * self.loop.turn, f"{MOTORS[k]} was made to go faster again")
                least = min(least, asked)

    def come_back(self, first: int) -> None:
        """End the fault; nothing may move but after an enable and a fresh command."""
        loop, fault = self.loop, self.fault
        fault.mend(loop, self.outcome.motor)
        self.command_freshly()
        begin, mark = loop.now, len(loop.trace)
        resting = (Phase.READY, Phase.LOCKED)
        while loop.now < begin + 1_000_000_000 * (REJOIN + 1.0):
            loop.run(1e-9 * loop.period)
            if loop.last.status.phase in resting and loop.trace[-1].cycle is not None:
                break
        self.outcome.rejoined = 1e-9 * (loop.now - begin)
        self.expect(loop.last.status.phase in resting, f"is still {loop.last.status.phase.name}")
        self.expect(self.outcome.rejoined <= REJOIN, f"took {self.outcome.rejoined:.2f} s to be back")
        phases = {sample.cycle.status.phase for sample in loop.trace[mark:] if sample.cycle}
        self.expect(Phase.LISTENING in phases or not fault.silent, "did not listen before it spoke again")
        loop.run(0.2)
        if fault.reasons and fault.stops:
            kept, known = loop.last.status.stop, self.outcome.reason
            is_kept = kept is not None and kept.reason in ((known,) if known else fault.reasons)
            self.expect(is_kept, f"the first reason was not kept: {kept}")
        self.reset()
        self.expect_rest(loop.trace[mark:], "before it was enabled")
        self.expect_left_alone(loop.trace[first:])
        self.enable_again()

    def reset(self) -> None:
        """Reset faults where there are some; an enable is refused before that."""
        loop = self.loop
        if loop.last.status.phase is not Phase.LOCKED:
            return
        loop.master.enable()
        loop.run(0.05)
        self.expect(loop.last.status.phase is Phase.LOCKED, "could be enabled with a drive in fault")
        loop.master.reset_fault()
        self.expect(loop.run_until(Phase.READY, 1.0), f"is not ready after a reset: {_troubles(loop)}")
        loop.run(0.1)

    def enable_again(self) -> None:
        """An enable alone moves nothing, and neither do commands from before; a fresh one does."""
        loop, mark = self.loop, len(self.loop.trace)
        old = Setpoints(self.velocity, loop.now)
        loop.command = lambda now: old
        loop.run(0.02)
        self.expect(self.enabled(), f"cannot be enabled again: {loop.last.status.notice}")
        loop.run(0.2)
        self.expect_rest(loop.trace[mark:], "on a command from before the enable")
        self.command_freshly()
        loop.run(0.1)
        self.expect(self.as_commanded(loop.trace[-1]), f"does not move again: {loop.last.status.stop}")
        loop.command = lambda now: replace(old, front_velocity=(0.0, 0.0), stamp_ns=now)

    def enabled(self) -> bool:
        """Whether the drives become enabled in time.

        Who had filled the bus may still have frames under way, for which an enable is refused: it is asked for again.
        """
        loop, end = self.loop, self.loop.now + round(1e9 * REJOIN)
        each = 0.25 * REJOIN if StopReason.BUS_OVERLOADED in self.fault.reasons else REJOIN
        while loop.now < end:
            loop.master.enable()
            if loop.run_until(Phase.ENABLED, each):
                return True
        return False

    def expect_rest(self, samples: Sequence[PeriodSample], when: str) -> None:
        """Nothing is asked of a front motor but to become slower than it is already."""
        for k in range(2):
            most = abs(samples[0].drives.velocity[k])
            for asked in (abs(sample.drives.asked[k].velocity or 0.0) for sample in samples):
                self.expect(asked <= most, f"{MOTORS[k]} moved {when}")
                most = min(most, asked) if asked else most

    def expect_left_alone(self, samples: Sequence[PeriodSample]) -> None:
        """No drive that has left operation enabled comes back to it by itself."""
        on = DriveState.OPERATION_ENABLED
        for k, motor in enumerate(MOTORS):
            again = any(a.drives.state[k] is not on and b.drives.state[k] is on for a, b in pairwise(samples))
            self.expect(not again, f"{motor} was enabled again without being asked to")


BEFORE_END: Final = 0.5
"""What follows a fault is watched for so long at least, beside the ramp, s."""

TICK: Final = 0.002
"""Samples are taken a drive's step after what they show, s."""


def _stop_in(samples: Sequence[PeriodSample]) -> StopRecord | None:
    """Why the driver stopped first, and when."""
    return next((s.cycle.status.stop for s in samples if s.cycle and s.cycle.status.stop), None)


def _first_after(begin: int, samples: Sequence[PeriodSample], holds: Callable[[PeriodSample], bool]) -> float:
    """When it held first, s after `begin`; infinite where it did not."""
    return next((max(0.0, 1e-9 * (s.now - begin)) for s in samples if s.now >= begin and holds(s)), math.inf)


def _for_good_after(begin: int, samples: Sequence[PeriodSample], holds: Callable[[PeriodSample], bool]) -> float:
    """From when on it held to the end, s after `begin`; infinite where it did not."""
    ended = math.inf
    for sample in reversed([each for each in samples if each.now >= begin]):
        if not holds(sample):
            break
        ended = max(0.0, 1e-9 * (sample.now - begin))
    return ended


def _troubles(loop: ClosedLoop) -> str:
    return "; ".join(each.trouble for each in loop.last.status.drives if each.trouble)
