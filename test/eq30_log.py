"""Eq. 30 checked from a `candump -L` log alone: its own reading of the frames, its own arithmetic."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from fractions import Fraction

import yaml

LINE = re.compile(r"\(([\d.]+)\) \S+ ([0-9A-F]{3})#([0-9A-F]*)")
FRONT_IDS, BACK_IDS = (0x181, 0x182), (0x203, 0x204)
"""TPDO1 of the front drives, RPDO1 of the back ones; right, left."""
OPERATION_ENABLED, ENABLE_OPERATION = 0x27, 0x0F


@dataclass
class Cycle:
    """What one SYNC period shows.

    Attributes
    ----------
    front : dict
        Of the period before: time, statusword and torque actual value by identifier; those that came before this
        period's first set-point.
    back : dict
        Time, controlword and target torque by identifier.
    """

    at: float
    front: dict[int, tuple[float, int, int]] = field(default_factory=dict)
    back: dict[int, tuple[float, int, int]] = field(default_factory=dict)


def cycles(lines: Iterable[str]) -> Iterator[Cycle]:
    """Periods of a log, each from one SYNC to the next: answers to the first, then set-points for the second."""
    current: Cycle | None = None
    for line in lines:
        found = LINE.match(line)
        assert found, line
        at, can_id, data = float(found[1]), int(found[2], 16), bytes.fromhex(found[3])
        if can_id == 0x80:
            if current is not None:
                yield current
            current = Cycle(at)
        elif current is None:
            continue
        elif can_id in FRONT_IDS and not current.back:
            statusword, _, torque = struct.unpack("<Hih", data)
            current.front[can_id] = at, statusword, torque
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
    """What a log shows.

    Attributes
    ----------
    checked : int
        Periods whose back torques are eq. 30, to one count, of the front torques of the period before.
    late : int
        Those in which an answer came after the set-points or so shortly before them that the driver had reckoned with
        the one before: the log has the time at which a frame was sent, not at which the driver's process was given it.
    wrong : list of str
        Those whose back torques are neither.
    largest : int
        Largest back torque seen, permille.
    """

    checked: int = 0
    late: int = 0
    wrong: list[str] = field(default_factory=list)
    largest: int = 0


def check(lines: Iterable[str], robot_file: str, kappa: str) -> Verdict:
    """Hold every period of a log in which all drives are enabled to eq. 30."""
    share, front_sign, back_sign, limit = factor(robot_file, kappa)
    verdict, before = Verdict(), dict.fromkeys(FRONT_IDS, 0)
    for cycle in cycles(lines):
        known, newest = before, before | {can_id: torque for can_id, (_, _, torque) in cycle.front.items()}
        before = newest
        if len(cycle.back) < 2 or any(word & 0x0F != ENABLE_OPERATION for _, word, _ in cycle.back.values()):
            continue
        if any(word & 0x6F != OPERATION_ENABLED for _, word, _ in cycle.front.values()):
            continue  # on the way there, or a stop: nothing is shared
        sent = {can_id: back_sign[can_id] * torque for can_id, (_, _, torque) in cycle.back.items()}
        verdict.largest = max(verdict.largest, *map(abs, sent.values()))

        def follows(fronts: Iterable[int], sent: dict[int, int] = sent) -> bool:
            total = sum(front_sign[can_id] * torque for can_id, torque in zip(FRONT_IDS, fronts, strict=True))
            return all(abs(torque - max(-limit, min(limit, share * total))) <= 1 for torque in sent.values())

        right, left = FRONT_IDS
        if len(cycle.front) == 2 and follows(newest.values()):
            verdict.checked += 1
        elif any(follows((a[right], b[left])) for a in (known, newest) for b in (known, newest)):
            verdict.late += 1
        else:
            verdict.wrong.append(f"{cycle.at:.6f} back {list(sent.values())}, front {list(newest.values())}")
    return verdict
