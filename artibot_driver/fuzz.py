"""Random frames for the decoder: ``python -m artibot_driver.fuzz 10000000 1`` (frames, seed).

Half of the frames have any identifier, half one of our four nodes' or of all nodes; lengths and bytes are random, some
are extended, remote, CAN FD or error frames. What came out is counted by kind. What raises ends the run.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from artibot_driver.dictionary import load_dictionary
from artibot_driver.pdo import Codec
from artibot_sim.model import MOTORS

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


def run(count: int, seed: int) -> Counter[str]:
    """Decode `count` random frames and count the results by kind.

    Raises
    ------
    RuntimeError
        When the decoder raised, with the frame.
    """
    nodes = {motor: k for k, motor in enumerate(MOTORS, 1)}
    codec = Codec(load_dictionary(), nodes)
    ours = [can_id for can_id in range(1 << 11) if codec.knows(can_id) and can_id & 0x7F in (0, *nodes.values())]
    kinds: Counter[str] = Counter()
    for frame in random_frames(count, seed, ours):
        try:
            decoded = codec.decode_message(frame)
        except Exception as error:
            raise RuntimeError(f"{frame} (seed {seed}): {error!r}") from error
        kinds[type(decoded).__name__] += 1
    return kinds


def main(argv: Sequence[str] | None = None) -> int:
    """Run, and print what the frames were taken for."""
    parser = argparse.ArgumentParser(prog="python -m artibot_driver.fuzz", description=str(__doc__).splitlines()[0])
    parser.add_argument("frames", type=int, nargs="?", default=200_000)
    parser.add_argument("seed", type=int, nargs="?", default=1)
    options = parser.parse_args(argv)
    begin = time.perf_counter()
    kinds = run(options.frames, options.seed)
    took = time.perf_counter() - begin
    print(f"{options.frames} frames, seed {options.seed}, {took:.1f} s: no exception")
    for kind, number in kinds.most_common():
        print(f"  {kind:<10} {number}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
