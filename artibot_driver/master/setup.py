"""Setting one drive up without waiting for it: frames to send now, answers as they come.

One SDO request is under way at a time, as CiA 301 has it; the next goes out as soon as the answer is read. All that was
written is read back once the drive has been started, so that a drive that restarted on the way, unheard, is found out:
it has lost what was written before.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Final

from canopen.objectdictionary import ODVariable

from artibot_driver.frames import SDO_REQUEST, Frame, NmtCommand, Sdo, nmt
from artibot_driver.master.refusals import TRANSIENT, aborted, differs
from artibot_driver.master.values import Stage
from artibot_driver.rig import Rig, Setting

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
_ASKING = (Stage.SETTING, Stage.CHECKING)


class Setup:
    """Sets up one drive, again whenever it has been away.

    Attributes
    ----------
    stage : Stage
    refusal : str
        Why the drive is refused, as one line with the mend; empty where it is not.
    """

    def __init__(self, rig: Rig, motor: str, tally: Counter[str]) -> None:
        self._rig, self.motor, self.node = rig, motor, rig.codec.nodes[motor]
        self._tally = tally
        first, checks = _first(rig.settings(motor)), _checks(rig.settings(motor))
        self._steps, self._settled = (*first, *checks), len(first)
        self._failed: Setting | None = None
        self.refusal = ""
        self.restart()

    def restart(self) -> None:
        """Seek the drive and set it up from the beginning."""
        self.stage = Stage.SEEKING
        self.refusal = ""
        self._next = 0
        self._tries = 0
        self._due = 0
        self._asked = False
        self._started: int | None = None

    def check(self) -> None:
        """Have the settings of a drive that is set up read again."""
        if self.stage is Stage.RUNNING:
            self.stage, self._next = Stage.CHECKING, self._settled
            self._tries, self._asked = 0, False

    @property
    def progress(self) -> float:
        """Share of the settings that are done."""
        return self._next / len(self._steps)

    def step(self, now: int) -> Iterator[Frame]:
        """Frames that are due now."""
        if self.stage is Stage.SEEKING and now >= self._due:
            self._due = now + SEEK_PERIOD
            yield nmt(NmtCommand.ENTER_PRE_OPERATIONAL, self.node)
            yield self._request(_SEEKING, write=False)
        elif self.stage in _ASKING and (not self._asked or now >= self._due):
            yield from self._ask(now)
        elif self.stage is Stage.STARTING and now >= self._due:
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
        setting, write = self._steps[self._next]
        yield self._request(setting, write)

    def started(self) -> None:
        """The drive has been heard to be operational."""
        if self.stage is Stage.STARTING:
            self.stage = Stage.CHECKING

    def take(self, answer: Sdo) -> None:
        """An answer of the drive; what was not asked for is only counted."""
        if self.stage is Stage.SEEKING and (answer.index, answer.subindex) == (_SEEKING.index, _SEEKING.subindex):
            if answer.service == "upload" and int.from_bytes(answer.data[:2], "little") == _CIA402:
                self.stage = Stage.SETTING
            else:
                self._tally["sdo_unexpected"] += 1
            return
        setting, write = self._steps[self._next] if self._next < len(self._steps) else (_SEEKING, False)
        expected = "download" if write else "upload"
        fits = (answer.index, answer.subindex) == (setting.index, setting.subindex)
        if self.stage not in _ASKING or not self._asked or not fits or answer.service not in (expected, "abort"):
            self._tally["sdo_unexpected"] += 1
        elif answer.service == "abort":
            self._take_abort(setting, write, int.from_bytes(answer.data, "little"))
        elif not write and (found := self._found(setting, answer)) is not None:
            self._take_difference(setting, found)
        else:
            self._advance()

    def _found(self, setting: Setting, answer: Sdo) -> int | None:
        """The value that a drive has instead of the one that it should have."""
        size = self._size(setting)
        found = int.from_bytes(answer.data[:size], "little", signed=setting.value < 0)
        return None if found == setting.value else found

    def _take_difference(self, setting: Setting, found: int) -> None:
        if setting.written and self._is_first(setting):
            self._tally["settings_lost"] += 1
            self.restart()
        else:
            self._refuse(differs(self._rig, self.motor, setting, found))

    def _take_abort(self, setting: Setting, write: bool, code: int) -> None:
        if code in TRANSIENT and self._tries + 1 < TRIES:
            self._due = 0  # as if it had not been answered
        elif setting.written and self._is_first(setting):
            self.restart()
        else:
            self._refuse(aborted(self._rig, self.motor, setting, write, code))

    def _is_first(self, setting: Setting) -> bool:
        """Whether it is the first time that an object is not as it should be: the drive may have restarted."""
        before, self._failed = self._failed, setting
        return before != setting

    def _refuse(self, text: str) -> None:
        self.stage, self.refusal, self._failed = Stage.REFUSED, text, None

    def _advance(self) -> None:
        self._next += 1
        self._tries, self._asked = 0, False
        if self._next == self._settled:
            self.stage, self._due, self._started = Stage.STARTING, 0, None
        elif self._next == len(self._steps):
            self.stage, self._failed = Stage.RUNNING, None

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


def due(setups: Sequence[Setup], now: int, most: int, turn: int) -> list[Frame]:
    """What several drives are to be sent now: of `most` of them, beginning with another one at each turn."""
    frames: list[Frame] = []
    for k in range(len(setups)):
        said = list(setups[(turn + k) % len(setups)].step(now)) if most else []
        frames += said
        most -= bool(said)
    return frames


Step = tuple[Setting, bool]
"""A setting, and whether it is written; else it is read."""


def _first(settings: tuple[Setting, ...]) -> tuple[Step, ...]:
    """What is asked before the drive is started: the drive's own objects are read, the others written."""
    return tuple((each, each.written) for each in settings)


def _checks(settings: tuple[Setting, ...]) -> tuple[Step, ...]:
    """What is asked after it: every object that was written, for the value that was written to it last."""
    last = {(each.index, each.subindex): each for each in settings if each.written}
    return tuple((each, False) for each in last.values())
