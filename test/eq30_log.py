"""Eq. 30 checked from a `candump -L` log alone: its own reading of the frames, its own arithmetic."""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from fractions import Fraction
from itertools import pairwise

import yaml

LINE = re.compile(r"\(([\d.]+)\) \S+ ([0-9A-F]{3})#([0-9A-F]*)")
FRONT_IDS, BACK_IDS = (0x181, 0x182), (0x203, 0x204)
"""TPDO1 of the front drives, RPDO1 of the back ones; right, left."""
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
    told : float or None
        When the period's first set-point was sent.
    """

    at: float
    front: dict[int, list[tuple[float, int, int]]] = field(default_factory=lambda: {each: [] for each in FRONT_IDS})
    back: dict[int, tuple[float, int, int]] = field(default_factory=dict)
    told: float | None = None


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
        if can_id in SET_POINTS and current.told is None:
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
    wrong : list of str
        Those, of both kinds, in which they are not.
    largest : int
        Largest back torque seen, permille.
    """

    checked: int = 0
    late: int = 0
    wrong: list[str] = field(default_factory=list)
    largest: int = 0


def check(lines: Iterable[str], robot_file: str, kappa: str, period: float = 0.01) -> Verdict:
    """Hold every period (s) of a log in which all drives are enabled to eq. 30."""
    share, front_sign, back_sign, limit = factor(robot_file, kappa)
    verdict, known = Verdict(), dict.fromkeys(FRONT_IDS, 0)
    behind, last = 0.0, math.inf
    for cycle in cycles(lines):
        # a driver that was held up makes up for at most a period, so it may have read so much earlier than it sent
        behind, last = min(max(behind + cycle.at - last - period, 0.0), period), cycle.at
        before, known = known, known | {can_id: each[-1][2] for can_id, each in cycle.front.items() if each}
        if len(cycle.back) < 2 or any(word & 0x0F != ENABLE_OPERATION for _, word, _ in cycle.back.values()):
            continue
        if any(word & 0x6F != OPERATION_ENABLED for each in cycle.front.values() for _, word, _ in each):
            continue  # on the way there, or a stop: nothing is shared
        sent = {can_id: back_sign[can_id] * torque for can_id, (_, _, torque) in cycle.back.items()}
        verdict.largest = max(verdict.largest, *map(abs, sent.values()))
        assert cycle.told is not None
        until = min(cycle.told, cycle.at + period - behind) - IN_TIME * period
        right, left = (used(cycle.front[can_id], until, before[can_id]) for can_id in FRONT_IDS)
        verdict.checked += len(right) == len(left) == 1
        verdict.late += not len(right) == len(left) == 1
        totals = [front_sign[FRONT_IDS[0]] * a + front_sign[FRONT_IDS[1]] * b for a in right for b in left]
        if not any(
            all(abs(torque - max(-limit, min(limit, share * total))) <= 1 for torque in sent.values())
            for total in totals
        ):
            verdict.wrong.append(f"{cycle.at:.6f} back {list(sent.values())}, front {right}, {left}")
    return verdict


def used(answers: list[tuple[float, int, int]], until: float, before: int) -> tuple[int, ...]:
    """Torques of a front drive that the driver may have reckoned with: one where its last answer was there in time."""
    if answers and answers[-1][0] <= until:
        return (answers[-1][2],)
    return before, *(torque for _, _, torque in answers)


def sync_jitter(lines: Iterable[str], period: float) -> tuple[float, float]:
    """How far the intervals between SYNC frames are from the period (s): 99 % of them at most, and the worst, ms."""
    found = [LINE.match(line) for line in lines]
    stamps = [float(each[1]) for each in found if each and int(each[2], 16) == SYNC]
    off = sorted(1e3 * abs(b - a - period) for a, b in pairwise(stamps))
    return (off[math.ceil(0.99 * len(off)) - 1], off[-1]) if off else (math.nan, math.nan)
