"""Setting one drive up without waiting for it: frames to send now, answers as they come.

One SDO request is under way at a time, as CiA 301 has it; the next goes out as soon as the answer is read. An object is
read first and written only where it is not right already: a drive's maker may have fixed it. All settings are read
again once the drive has been started, so that a drive that restarted on the way, unnoticed, is found out: it has lost
what was written before.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import groupby
from typing import Final, NamedTuple

from canopen.objectdictionary import ODVariable
from canopen.sdo import SdoAbortedError

from artibot_driver.frames import SDO_REQUEST, Frame, NmtCommand, Sdo, nmt
from artibot_driver.master.values import SetupStage
from artibot_driver.rig import Rig, Setting

# ----------------------------------------------------------------------
# Why a drive is not taken, in words: motor, object, what was found, what was expected, and the mend.
# ----------------------------------------------------------------------


TRANSIENT: Final = (0x05030000, 0x05040000, 0x05040005, 0x08000000, 0x08000020, 0x08000021, 0x08000022)
"""SDO abort codes of a drive that may accept the same a moment later."""

_MENDS: Final = {
    0x6076: "put the motor's rated torque into the robot file (drive.{module}.rated_torque), or into the drive",
    0x608F: "set counts_per_turn.{module} to the encoder's increments, or commission the drive anew",
    0x607E: "set it to {expected} in the drive: the motors' polarity belongs into the robot file",
    0x1019: "set it to {expected} in the drive: the driver's SYNC has no counter",
    0x6091: "set it to {expected} in the drive: gears belong into the robot file (drive.{module}.tau)",
    0x6096: "set it to {expected} in the drive: its unit of velocity is the parameter velocity_exponent",
    0x1018: "give the EDS of this drive (parameter eds)",
    0x60A9: "set velocity_exponent to the drive's, or its unit of velocity to {expected:#x}",
}
_SWAPPED = "are two node ids swapped (node_ids.*)? "


def _key(setting: Setting) -> str:
    return f"{setting.index:04X}h" + (f":{setting.subindex}" if setting.subindex else "")


def _where(rig: Rig, motor: str, setting: Setting) -> str:
    entry = rig.dictionary[setting.index]
    name = entry.name if isinstance(entry, ODVariable) else f"{entry.name}, {entry[setting.subindex].name}"
    return f"motor {motor} (node {rig.codec.nodes[motor]}): object {_key(setting)} ({name})"


def _mismatch(rig: Rig, motor: str, setting: Setting, found: int) -> str:
    base = "#010x" if setting.is_code else "d"
    return f"{_where(rig, motor, setting)}: found {found:{base}}, expected {setting.value:{base}}"


def differs(rig: Rig, motor: str, setting: Setting, found: int) -> str:
    """For an object that is not what it has to be."""
    where = _mismatch(rig, motor, setting, found)
    if setting.written:
        return f"{where}, which was written; the drive has not taken it: see its manual, or change the parameter"
    mend = _MENDS.get(setting.index, "commission the drive anew")
    asked = "" if setting.index == 0x1018 else _SWAPPED
    return f"{where}; {asked}{mend.format(module=motor.partition('_')[0], expected=setting.value)}"


def aborted(rig: Rig, motor: str, access: Access, code: int, wrong: tuple[Setting, int] | None) -> str:
    """For an access that the drive refused.

    Parameters
    ----------
    access : Access
    code : int
        Why, by CiA 301.
    wrong : tuple of Setting and int, optional
        What was to be set right by it, and what was found there.
    """
    setting, write = access
    reason = f"was refused ({code:#010x}: {SdoAbortedError.CODES.get(code, 'no code of CiA 301')})"
    mend = "use the drive's own EDS (parameter eds), or change the parameter"
    if not write:
        return f"{_where(rig, motor, setting)}: reading it {reason}; {mend}"
    if wrong is None:
        return f"{_where(rig, motor, setting)}: writing {setting.value} {reason}; {mend}"
    return f"{_mismatch(rig, motor, *wrong)}; writing {setting.value} to {_key(setting)} {reason}; {mend}"


# ----------------------------------------------------------------------
# Setting one drive up without waiting for it: frames to send now, answers as they come.
# ----------------------------------------------------------------------


SEEK_PERIOD: Final = 100_000_000
"""Between two calls to a drive that does not answer, and two commands to start, ns."""

ANSWER_TIMEOUT: Final = 50_000_000
"""An SDO request without an answer is repeated after this long, ns."""

TRIES: Final = 10
"""Requests without an answer, or refused for the moment, before the drive is sought anew."""

START_TIMEOUT: Final = 1_000_000_000
"""A drive that does not become operational in this time is set up anew, ns."""

_HEAD_BYTES = 4
_SEEKING = Setting(0x1000, 0, 0)  # device type: every node has it
_CIA402 = 402  # its low half names the profile
_ASKING = (SetupStage.SETTING, SetupStage.CHECKING)
_REVISION = (0x1018, 3)


class Access(NamedTuple):
    """One SDO request: a setting that is read, or written."""

    setting: Setting
    write: bool


class DriveSetup:
    """Sets up one drive, again whenever it has been away.

    Attributes
    ----------
    stage : SetupStage
    refusal : str
        Why the drive is refused, as one line with the mend; empty where it is not.
    remark : str
        What does not fit about a drive that is set up all the same; empty where all does.
    """

    def __init__(self, rig: Rig, motor: str, tally: Counter[str]) -> None:
        self._rig, self.motor, self.node = rig, motor, rig.codec.nodes[motor]
        self._tally = tally
        self._parts = parts_of(rig.settings(motor))
        self._checks = tuple(each for part in self._parts for each in last_of(part) if each.written)
        self._total = len(self._checks) + sum(len(last_of(part)) for part in self._parts)
        self._failed: Setting | None = None
        self.refusal = ""
        self.restart()

    def restart(self) -> None:
        """Seek the drive and set it up from the beginning."""
        self.stage = SetupStage.SEEKING
        self.refusal = self.remark = ""
        self._queue: deque[Access] = deque()
        self._part, self._done = -1, 0
        self._found: dict[tuple[int, int], int] = {}
        self._wrong: list[Setting] = []
        self._tries = 0
        self._due = 0
        self._asked = False
        self._started: int | None = None

    def check(self) -> None:
        """Have the settings of a drive that is set up read again."""
        if self.stage is SetupStage.RUNNING:
            self._check()

    def _check(self) -> None:
        self.stage, self._done = SetupStage.CHECKING, self._total - len(self._checks)
        self._queue = deque(Access(each, False) for each in self._checks)
        self._tries, self._asked = 0, False

    @property
    def progress(self) -> float:
        """Share of the settings that are done."""
        return self._done / self._total

    def step(self, now: int) -> Iterator[Frame]:
        """Frames that are due now."""
        if self.stage is SetupStage.SEEKING and now >= self._due:
            self._due = now + SEEK_PERIOD
            yield nmt(NmtCommand.ENTER_PRE_OPERATIONAL, self.node)
            yield self._request(_SEEKING, write=False)
        elif self.stage in _ASKING and (not self._asked or now >= self._due):
            yield from self._ask(now)
        elif self.stage is SetupStage.STARTING and now >= self._due:
            self._started = now if self._started is None else self._started
            self._due = now + SEEK_PERIOD
            if now - self._started > START_TIMEOUT:
                self.restart()
            else:
                yield nmt(NmtCommand.START, self.node)

    def _ask(self, now: int) -> Iterator[Frame]:
        if self._asked:
            self._tally["sdo_repeats"] += 1
            self._tries += 1
            if self._tries >= TRIES:
                self.restart()
                return
        self._asked, self._due = True, now + ANSWER_TIMEOUT
        yield self._request(*self._queue[0])

    def started(self) -> None:
        """Feedback has come: the drive is operational."""
        if self.stage is SetupStage.STARTING:
            self._check()

    def take(self, answer: Sdo) -> None:
        """An answer of the drive; what was not asked for is only counted."""
        if self.stage is SetupStage.SEEKING and (answer.index, answer.subindex) == _SEEKING.key:
            if answer.service == "upload" and int.from_bytes(answer.data[:2], "little") == _CIA402:
                self.stage = SetupStage.SETTING
                self._next_part()
            else:
                self._tally["sdo_unexpected"] += 1
            return
        setting, write = self._queue[0] if self._queue else (_SEEKING, False)
        expected = "download" if write else "upload"
        fits = (answer.index, answer.subindex) == setting.key
        if self.stage not in _ASKING or not self._asked or not fits or answer.service not in (expected, "abort"):
            self._tally["sdo_unexpected"] += 1
        elif answer.service == "abort":
            self._take_abort(setting, write, int.from_bytes(answer.data, "little"))
        elif write:
            self._advance()
        else:
            self._compare(setting, answer)

    def _compare(self, setting: Setting, answer: Sdo) -> None:
        """Take the value that was read: right, to be written, or a reason to refuse the drive."""
        found = int.from_bytes(answer.data[: self._size(setting)], "little", signed=setting.value < 0)
        if self.stage is SetupStage.SETTING and setting.written:
            self._found[setting.key] = found
        if setting.accepts(found):
            self._advance()
        elif setting.key == _REVISION:
            self.remark = differs(self._rig, self.motor, setting, found)
            self._advance()
        elif self.stage is SetupStage.SETTING and setting.written:
            self._wrong.append(setting)
            self._advance()
        elif setting.written and self._is_first(setting):
            self._tally["settings_lost"] += 1
            self.restart()
        else:
            self._refuse(differs(self._rig, self.motor, setting, found))

    def _take_abort(self, setting: Setting, write: bool, code: int) -> None:
        if code in TRANSIENT and self._tries + 1 < TRIES:
            self._due = 0  # as if it had not been answered
        elif self.stage is SetupStage.SETTING and setting.written and not write:
            self._wrong.append(setting)  # it cannot be read: whether it can be written is to be seen
            self._advance()
        elif setting.written and self._is_first(setting):
            self.restart()
        else:
            self._refuse(aborted(self._rig, self.motor, Access(setting, write), code, self._mismatch(setting.index)))

    def _mismatch(self, index: int) -> tuple[Setting, int] | None:
        """What of an object was read and is not as it has to be, and what was found: the first such."""
        part = last_of(self._parts[self._part]) if self._part < len(self._parts) else ()
        read = ((each, self._found[each.key]) for each in part if each.index == index and each.key in self._found)
        return next((pair for pair in read if not pair[0].accepts(pair[1])), None)

    def _is_first(self, setting: Setting) -> bool:
        """Whether it is the first time that an object is not as it should be: the drive may have restarted."""
        before, self._failed = self._failed, setting
        return before != setting

    def _refuse(self, text: str) -> None:
        self.stage, self.refusal, self._failed = SetupStage.REFUSED, text, None

    def _advance(self) -> None:
        """Go on after an answer."""
        done = self._queue.popleft()
        self._done += not done.write
        self._tries, self._asked = 0, False
        if self._queue:
            return
        if self.stage is SetupStage.CHECKING:
            self.stage, self._failed = SetupStage.RUNNING, None
        elif self._wrong:
            self._queue = deque(Access(each, True) for each in self._to_write())
            self._wrong = []
        else:
            self._next_part()

    def _next_part(self) -> None:
        """Read what belongs together, or start the drive where all is as it should be."""
        self._part += 1
        self._found = {}
        if self._part < len(self._parts):
            self._queue = deque(Access(each, False) for each in last_of(self._parts[self._part]))
        else:
            self.stage, self._due, self._started = SetupStage.STARTING, 0, None

    def _to_write(self) -> Iterator[Setting]:
        """The settings of a part of which some are wrong; a mapping that is right stays, for it may be fixed."""
        mapping = any(each.is_mapping for each in self._wrong)
        for each in self._parts[self._part]:
            if mapping or not each.is_mapping:
                yield replace(each, value=each.value | self._found.get(each.key, 0) & each.ignored)

    def _request(self, setting: Setting, write: bool) -> Frame:
        size = self._size(setting)
        command = 0x23 | (_HEAD_BYTES - size) << 2 if write else 0x40
        head = bytes((command, setting.index & 0xFF, setting.index >> 8, setting.subindex))
        value = (setting.value & (1 << 8 * size) - 1 if write else 0).to_bytes(4, "little")
        return Frame(SDO_REQUEST + self.node, head + value)

    def _size(self, setting: Setting) -> int:
        """Bytes of an object; all that are set have at most four."""
        entry = self._rig.dictionary[setting.index]
        variable = entry if isinstance(entry, ODVariable) else entry[setting.subindex]
        return len(variable) // 8


def due(setups: Sequence[DriveSetup], now: int, most: int, turn: int) -> list[Frame]:
    """What several drives are to be sent now: of `most` of them, beginning with another one at each turn."""
    frames: list[Frame] = []
    for k in range(len(setups)):
        said = list(setups[(turn + k) % len(setups)].step(now)) if most else []
        frames += said
        most -= bool(said)
    return frames


def parts_of(settings: tuple[Setting, ...]) -> tuple[tuple[Setting, ...], ...]:
    """Settings that are written together, and each of the others by itself, in their order."""
    groups = groupby(enumerate(settings), key=lambda pair: pair[1].part or str(pair[0]))
    return tuple(tuple(each for _, each in group) for _, group in groups)


def last_of(part: tuple[Setting, ...]) -> tuple[Setting, ...]:
    """What each object of a part has to hold in the end: a PDO is switched off and emptied on the way."""
    return tuple({each.key: each for each in part}.values())
