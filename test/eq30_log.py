"""Eq. 30 checked from a `candump -L` log alone: its own reading of the frames, its own arithmetic."""

from __future__ import annotations

import math
import re
import struct
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from fractions import Fraction
from itertools import pairwise

import yaml

LINE = re.compile(r"\(([\d.]+)\) \S+ ([0-9A-F]{3})#([0-9A-F]*)")
FRONT_IDS, BACK_IDS = (0x181, 0x182), (0x203, 0x204)
"""TPDO1 of the front drives, RPDO1 of the back ones; right, left."""
UNREAD = 3
"""Answers of so many periods may wait in a driver's buffer where it is told more than it can read."""

SYNC, SET_POINTS = 0x80, range(0x201, 0x205)
OPERATION_ENABLED, ENABLE_OPERATION = 0x27, 0x0F
IN_TIME = 0.25
"""Share of the SYNC period: answers that are in the log so long before the set-points have been read by the driver that
sends them. It reads, reckons and sends in less than that; nothing in a log tells when it read."""


@dataclass
class Cycle:
    """What one SYNC period shows.

    Attributes
    ----------
    front : dict
        Answers of the front drives, mostly one each: time, statusword and torque actual value by identifier.
    back : dict
        Time, controlword and target torque of the back drives' set-points by identifier.
    told : float
        When the period's first set-point was sent; NaN where none was.
    """

    at: float
    front: dict[int, list[tuple[float, int, int]]] = field(default_factory=lambda: {each: [] for each in FRONT_IDS})
    back: dict[int, tuple[float, int, int]] = field(default_factory=dict)
    told: float = math.nan

    @property
    def shares(self) -> bool:
        """Whether all drives are enabled; on the way there, and in a stop, nothing is shared."""
        return (
            len(self.back) == len(BACK_IDS)
            and all(word & 0x0F == ENABLE_OPERATION for _, word, _ in self.back.values())
            and all(word & 0x6F == OPERATION_ENABLED for each in self.front.values() for _, word, _ in each)
        )


def cycles(lines: Iterable[str]) -> Iterator[Cycle]:
    """Periods of a log, each from one SYNC to the next: answers to the first, then set-points for the second."""
    current: Cycle | None = None
    for line in lines:
        found = LINE.match(line)
        assert found, line
        at, can_id, data = float(found[1]), int(found[2], 16), bytes.fromhex(found[3])
        if can_id == SYNC:
            if current is not None:
                yield current
            current = Cycle(at)
            continue
        if current is None:
            continue
        if can_id in SET_POINTS and math.isnan(current.told):
            current.told = at
        if can_id in FRONT_IDS:
            statusword, _, torque = struct.unpack("<Hih", data)
            current.front[can_id].append((at, statusword, torque))
        elif can_id in BACK_IDS:
            controlword, _, torque = struct.unpack("<Hih", data)
            current.back[can_id] = at, controlword, torque


def factor(robot_file: str, kappa: str) -> tuple[Fraction, dict[int, int], dict[int, int], int]:
    """Eq. 30's tau_b / (2 tau_f) (1/kappa − 1), polarities by identifier, and the back motors' limit in permille."""
    with open(robot_file, encoding="utf-8") as stream:
        drive = yaml.safe_load(stream)["drive"]
    front, back = drive["front"], drive["back"]

    def value(entry: dict[str, object]) -> Fraction:
        return Fraction(str(entry["value"]))

    share = value(back["tau"]) / value(front["tau"]) * (1 / Fraction(kappa) - 1) / 2
    rated = value(front["rated_torque"]) / value(back["rated_torque"])
    sides = ("right", "left")
    return (
        share * rated,
        {can_id: int(front["polarity"][side]["value"]) for can_id, side in zip(FRONT_IDS, sides, strict=True)},
        {can_id: int(back["polarity"][side]["value"]) for can_id, side in zip(BACK_IDS, sides, strict=True)},
        int(1000 * value(back["torque_max"]) / value(back["rated_torque"])),
    )


@dataclass
class Verdict:
    """What a log shows of the periods in which all drives are enabled.

    Attributes
    ----------
    checked : int
        Periods that have all their frames in time. In each the back torques must be eq. 30, to one count, of the front
        torques that answered its SYNC, and of nothing else.
    late : int
        Those in which an answer is missing, or came so late that the driver may have reckoned with the one before it:
        shortly before the set-points or after them, or, where those themselves were late, shortly before they were due.
        In each the back torques must be eq. 30 of either.
    stale : int
        Those in which they are eq. 30 of older answers, of the last :data:`UNREAD` periods: a driver that cannot read
        all that has come within its period does so, and counts how often.
    wrong : list of str
        Those, of all kinds, in which they are not.
    largest : int
        Largest back torque seen, permille.
    """

    checked: int = 0
    late: int = 0
    stale: int = 0
    wrong: list[str] = field(default_factory=list)
    largest: int = 0


@dataclass(frozen=True)
class Eq30:
    """What a kappa asks of the back torques, in permille of the rated ones (:func:`factor`)."""

    share: Fraction
    front_sign: dict[int, int]
    back_sign: dict[int, int]
    limit: int

    def holds(self, sent: Iterable[int], right: Iterable[int], left: Iterable[int]) -> bool:
        """Whether both back torques are eq. 30, to one count, of one of the front torques on either side."""
        signs = [self.front_sign[each] for each in FRONT_IDS]
        shared = [self.share * (signs[0] * a + signs[1] * b) for a in right for b in left]
        limited = [max(-self.limit, min(self.limit, each)) for each in shared]
        return any(all(abs(torque - each) <= 1 for torque in sent) for each in limited)


def check(lines: Iterable[str], robot_file: str, kappa: str, period: float = 0.01) -> Verdict:
    """Hold every period (s) of a log in which all drives are enabled to eq. 30."""
    rule, verdict = Eq30(*factor(robot_file, kappa)), Verdict()
    older: deque[dict[int, list[int]]] = deque(maxlen=UNREAD)
    before, behind, last = dict.fromkeys(FRONT_IDS, 0), 0.0, math.inf
    for cycle in cycles(lines):
        # a driver that was held up makes up for at most a period, so it may have read so much earlier than it sent
        behind, last = min(max(behind + cycle.at - last - period, 0.0), period), cycle.at
        answers = {can_id: [torque for *_, torque in each] for can_id, each in cycle.front.items()}
        if cycle.shares:
            until = min(cycle.told, cycle.at + period - behind) - IN_TIME * period
            right, left = (used(cycle.front[can_id], until, before[can_id]) for can_id in FRONT_IDS)
            sent = [rule.back_sign[can_id] * torque for can_id, (_, _, torque) in cycle.back.items()]
            verdict.largest = max(verdict.largest, *map(abs, sent))
            verdict.checked += len(right) == len(left) == 1
            verdict.late += not len(right) == len(left) == 1
            if not rule.holds(sent, right, left):
                unread = [
                    [*now, *(t for each in older for t in each[i])]
                    for i, now in zip(FRONT_IDS, (right, left), strict=True)
                ]
                if rule.holds(sent, *unread):
                    verdict.stale += 1
                else:
                    verdict.wrong.append(f"{cycle.at:.6f} back {sent}, front {right}, {left}")
        before |= {can_id: each[-1] for can_id, each in answers.items() if each}
        older.append(answers)
    return verdict


def used(answers: list[tuple[float, int, int]], until: float, before: int) -> tuple[int, ...]:
    """Torques of a front drive that the driver may have reckoned with: one where its last answer was there in time."""
    if answers and answers[-1][0] <= until:
        return (answers[-1][2],)
    return before, *(torque for _, _, torque in answers)


def sync_jitter(lines: Iterable[str], period: float = 0.01) -> tuple[float, float]:
    """How far the intervals between SYNC frames are from the period (s): 99 % of them at most, and the worst, ms."""
    found = [LINE.match(line) for line in lines]
    stamps = [float(each[1]) for each in found if each and int(each[2], 16) == SYNC]
    off = sorted(1e3 * abs(b - a - period) for a, b in pairwise(stamps))
    return (off[math.ceil(0.99 * len(off)) - 1], off[-1]) if off else (math.nan, math.nan)
