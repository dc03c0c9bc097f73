"""A writer killed at any instant loses at most a second, and `artibot recover` makes its file readable.

The recording node itself is killed in `test/nodes/test_record.py`.
"""

from __future__ import annotations

import mmap
import multiprocessing
import os
import random
import struct
import time
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path

import killed_writer
from bag_helpers import joint_state, mcap_file
from click.testing import CliRunner
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader

from artibot_sim.cli.recover import command
from artibot_sim.experiment import iter_messages

INSTANTS = 27
TOGETHER = 9
LONGEST = 2.6
MOST_LOST_NS = 1_000_000_000

# All writers come of one process that has imported the library; each then is a process of its own, forked from it.
FORKS = multiprocessing.get_context("forkserver")
FORKS.set_forkserver_preload(["artibot_sim.experiment"])


def start(place: Path) -> tuple[BaseProcess, Connection]:
    place.mkdir()
    (place / "page").write_bytes(bytes(16))
    data = joint_state(1, ["a", "b", "c", "d"], [1.0] * 4, [2.0] * 4, [3.0] * 4)
    hears, tells = FORKS.Pipe(duplex=False)
    process = FORKS.Process(target=killed_writer.write, args=(str(place / "run"), str(place / "page"), data, tells))
    process.start()
    tells.close()
    return process, hears


def handed_over(place: Path) -> tuple[int, int]:
    with open(place / "page", "r+b") as stream, mmap.mmap(stream.fileno(), 16) as shared:
        count, last = struct.unpack("<QQ", shared[:])
    return count, last


def check(place: Path, what: str) -> int:
    """Recover and read; return how many ns of messages were lost."""
    count, last = handed_over(place)
    result = CliRunner().invoke(command, [str(place / "run")])
    assert result.exit_code == 0, f"{what}: {result.output}"
    saved = list(iter_messages(place / "run_recovered"))
    assert [m.sequence for m in saved] == [i // 6 + 1 for i in range(len(saved))], what  # the first ones, in order
    assert len(saved) <= count + 1, what  # one may have been written but not yet counted
    with open(mcap_file(place / "run_recovered"), "rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert sum(1 for _ in reader.iter_messages()) == len(saved), what
    with Reader(place / "run_recovered") as bag:
        assert sum(1 for _ in bag.messages()) == len(saved), what
    first = last - count * 10_000_000 // 6 if count else 0
    return max(0, last - (saved[-1].log_ns if saved else first))


def test_a_writer_killed_at_random_instants(tmp_path: Path) -> None:
    seed = int(os.environ.get("ARTIBOT_KILL_SEED", time.time_ns() % 1_000_000))
    print(f"seed {seed}; ARTIBOT_KILL_SEED={seed} repeats these instants")
    rng = random.Random(seed)
    instants = [rng.uniform(0.0, LONGEST) for _ in range(INSTANTS)]
    worst = 0
    for begin in range(0, INSTANTS, TOGETHER):
        batch = {k: start(tmp_path / f"{k}") for k in range(begin, min(begin + TOGETHER, INSTANTS))}
        try:
            for _, hears in batch.values():
                assert hears.recv() == "ready", f"seed {seed}"
            ready = time.monotonic()
            for k in sorted(batch, key=lambda k: instants[k]):
                time.sleep(max(0.0, ready + instants[k] - time.monotonic()))
                batch[k][0].kill()
        finally:
            for process, hears in batch.values():
                process.kill()
                process.join()
                hears.close()
        for k in batch:
            what = f"seed {seed}, killed {instants[k]:.3f} s after the start"
            lost = check(tmp_path / f"{k}", what)
            assert lost <= MOST_LOST_NS, f"{what}: {lost / 1e9:.3f} s lost"
            worst = max(worst, lost)
    print(f"{INSTANTS} kills, at most {worst / 1e9:.3f} s lost")
