"""Random frames for decoder and drive: ``python -m artibot_driver.fuzz 10000000 1`` (frames, seed).

Half of the frames have any identifier, half one of our four nodes' or of all nodes; lengths and bytes are random, some
are extended, remote, CAN FD or error frames. Every frame is decoded, and handed to a simulated drive that a master
keeps enabling, for 20 µs of its time each. What came out is counted by kind, and so are the drive's changes of state.
Whatever raises, or changes the state as the table of CiA 402 does not allow, ends the run.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from artibot_driver.cia402 import TRANSITIONS, DriveState, controlword_for
from artibot_driver.config import config_from_parameters
from artibot_driver.frames import Frame, NmtCommand, nmt
from artibot_driver.rig import Rig, load_rig
from artibot_driver.simulated.drive import POWERED, SimulatedDrive
from artibot_driver.simulated.motion import InertialShaft
from artibot_sim.progress import Bar, Report

_BATCH = 100_000


@dataclass(slots=True)
class RandomFrame:
    """A frame as :meth:`Codec.decode_message` takes it."""

    arbitration_id: int
    data: bytearray
    is_extended_id: bool = False
    is_remote_frame: bool = False
    is_error_frame: bool = False
    is_fd: bool = False


def random_frames(count: int, seed: int, ours: Sequence[int]) -> Iterator[RandomFrame]:
    """`count` frames; half of those with 11 bits have an identifier of `ours`."""
    rng = np.random.default_rng(seed)
    while count > 0:
        size = min(count, _BATCH)
        count -= size
        any_id = rng.integers(0, 1 << 11, size)
        ids = np.where(rng.random(size) < 0.5, any_id, rng.choice(np.asarray(ours), size))
        lengths = np.where(rng.random(size) < 0.5, 8, rng.integers(0, 9, size))
        kinds = rng.integers(0, 64, size)  # 0 to 3: extended, remote, error, CAN FD
        content = rng.bytes(size * 8)
        wide = rng.integers(0, 1 << 29, size).tolist()
        for k, (can_id, length, kind) in enumerate(zip(ids.tolist(), lengths.tolist(), kinds.tolist(), strict=True)):
            data = bytearray(content[8 * k : 8 * k + length])
            if kind > 3:
                yield RandomFrame(can_id, data)
            else:
                yield RandomFrame(wide[k], data, kind == 0, kind == 1, kind == 2, kind == 3)


def run(count: int, seed: int, progress: Report = lambda share: None) -> tuple[Counter[str], Counter[str]]:
    """Put `count` random frames through decoder and drive.

    Returns
    -------
    kinds, changes : Counter
        Results of the decoder by kind, and the drive's changes of state by number of the transition (0: power on).

    Raises
    ------
    RuntimeError
        When decoder or drive raised, or the drive changed its state as it may not, with the frame.
    """
    rig = load_rig(config_from_parameters({}))
    mine = set(rig.codec.nodes.values())
    ours = [can_id for can_id in range(1 << 11) if rig.codec.knows(can_id) and can_id & 0x7F in (0, *mine)]
    enabler, drive = _Enabler(rig), DriveUnderTest(rig)
    kinds: Counter[str] = Counter()
    for number, frame in enumerate(random_frames(count, seed, ours)):
        try:
            kinds[type(rig.codec.decode_message(frame)).__name__] += 1
            drive.take(frame)
            if number % 50 == 0:
                enabler.lead(drive)
                progress(number / count)
        except Exception as error:
            raise RuntimeError(f"frame {number}, {frame} (seed {seed}): {error!r}") from error
    return kinds, drive.changes


class DriveUnderTest:
    """A simulated drive with a flywheel, whose every change of state is held against the table."""

    def __init__(self, rig: Rig) -> None:
        self.shaft = InertialShaft()
        self.drive = _Noted(rig, "front_left", self.shaft, lambda frame: None)
        self.now = 0
        self.drive.power_on(0)

    @property
    def changes(self) -> Counter[str]:
        """Changes of state so far."""
        return self.drive.changes

    def take(self, frame: RandomFrame) -> None:
        """Hand a frame over, let time pass, and see that only a powered drive moves its motor."""
        self.now += 20_000
        if not (frame.is_extended_id or frame.is_remote_frame or frame.is_error_frame or frame.is_fd):
            self.drive.receive(frame.arbitration_id, bytes(frame.data), self.now)
        if self.now % 2_000_000 == 0:
            self.drive.step(self.now)
        if not self.shaft.asked.is_free and self.drive.state not in POWERED:
            raise RuntimeError(f"the motor has current in state '{self.drive.state}'")


class _Noted(SimulatedDrive):
    """A simulated drive that notes its changes of state, and raises at one that the table does not have."""

    changes: Counter[str]

    def __setattr__(self, name: str, value: object) -> None:
        if name == "state":
            self._note(value)
        super().__setattr__(name, value)

    def _note(self, state: object) -> None:
        changes: Counter[str] = self.__dict__.setdefault("changes", Counter())
        if state is DriveState.NOT_READY_TO_SWITCH_ON:
            changes["0"] += 1
            return
        numbers = [row.number for row in TRANSITIONS if (row.start, row.end) == (self.state, state)]
        if not numbers:
            raise RuntimeError(f"from '{self.state}' to '{state}' is no transition")
        changes[str(numbers[0])] += 1


class _Enabler:
    """A master that does what it can, with frames, to have the drive enabled and turning, and now and then stops it."""

    def __init__(self, rig: Rig) -> None:
        self._codec, self._node, self._word = rig.codec, rig.codec.nodes["front_left"], 0
        self._mode = bytes.fromhex("2f60600009000000")
        self._rounds = 0

    def lead(self, drive: DriveUnderTest) -> None:
        """One round: start the node, set its mode, send the next controlword."""
        self._word = controlword_for(drive.drive.state, DriveState.OPERATION_ENABLED, self._word, reset_faults=True)
        rpdo = self._codec.pdo("RPDO1", self._node, (self._word, 1_000_000, 0))
        setting = Frame(0x600 + self._node, self._mode)
        for frame in (nmt(NmtCommand.START, self._node), setting, rpdo, self._codec.sync()):
            drive.drive.receive(*frame, drive.now)
        self._rounds += 1
        if self._rounds % 40 == 0:
            drive.drive.receive(*nmt(NmtCommand.ENTER_PRE_OPERATIONAL, self._node), drive.now)


def main(argv: Sequence[str] | None = None) -> int:
    """Run, and print what the frames were taken for and did."""
    parser = argparse.ArgumentParser(prog="python -m artibot_driver.fuzz", description=str(__doc__).splitlines()[0])
    parser.add_argument("frames", type=int, nargs="?", default=200_000)
    parser.add_argument("seed", type=int, nargs="?", default=1)
    options = parser.parse_args(argv)
    begin = time.perf_counter()
    with Bar() as bar:
        kinds, changes = run(options.frames, options.seed, bar.stage("random frames", 1.0))
    took = time.perf_counter() - begin
    rate = f"{took:.1f} s, {options.frames / took:.0f} a second"
    print(f"{options.frames} frames, seed {options.seed}, {rate}: no exception, no change of state but the table's")
    for kind, number in kinds.most_common():
        print(f"  {kind:<10} {number}")
    print("  transitions", ", ".join(f"{name}: {changes[name]}" for name in sorted(changes, key=int)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
