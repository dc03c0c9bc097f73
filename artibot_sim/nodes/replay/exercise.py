"""What subscribers that are there already miss of a replay's start, and how long it takes, for each way to wait.

``python -m artibot_sim.nodes.replay.exercise STARTS WAIT…`` starts four programs that subscribe to both topics of a
recording, two of them reliably, and replays it to them so many times for each WAIT: a number for ``--wait``, or
``default``. Prints a line of JSON for each.
"""

from __future__ import annotations

import json
import select
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from artibot_sim.errors import ArtibotError
from artibot_sim.nodes.common.process import destroyed, ros_process

TOPICS = ("/motor_torques", "/joint_states")
MESSAGES, STEP_NS, BEGIN_NS = 200, 5_000_000, 1_700_000_000_000_000_000
"""Of each topic; between two; the first one's time."""

KINDS = ("reliable", "reliable", "best_effort", "best_effort")
"""Of the subscribers."""

SETTLE = 1.0
"""After a replay's end the last messages may still be on their way, and its participant be known, s."""


def recording(folder: Path) -> Path:
    """A recording of a second."""
    from artibot_sim.experiment import BagWriter, serialize
    from artibot_sim.experiment.messages import header

    kind, empty = "sensor_msgs/msg/JointState", np.array([])
    with BagWriter(folder, live=False) as bag:
        for topic in TOPICS:
            bag.register(topic, kind)
        for number in range(MESSAGES):
            stamp = BEGIN_NS + number * STEP_NS
            data = serialize(
                kind, header=header(stamp), name=["front_right"], position=empty, velocity=empty, effort=empty
            )
            for topic in TOPICS:
                bag.write(topic, data, stamp, stamp)
    return folder


def subscribe(kind: str) -> None:
    """Count what comes; at each line of the standard input say it, with the first one's steady time, and count anew."""
    import rclpy
    from rclpy.qos import QoSProfile, ReliabilityPolicy
    from sensor_msgs.msg import JointState

    reliability = {"reliable": ReliabilityPolicy.RELIABLE, "best_effort": ReliabilityPolicy.BEST_EFFORT}[kind]
    with ros_process("subscriber", ()) as asked, destroyed(rclpy.create_node("subscriber")) as node:
        times: dict[str, list[float]] = {topic: [] for topic in TOPICS}
        qos = QoSProfile(depth=MESSAGES, reliability=reliability)
        for topic in TOPICS:
            node.create_subscription(
                JointState, topic, lambda _, topic=topic: times[topic].append(time.monotonic()), qos, raw=True
            )
        print("listening", flush=True)
        while not asked:
            rclpy.spin_once(node, timeout_sec=0.05)
            if select.select([sys.stdin], [], [], 0.0)[0]:
                if not sys.stdin.readline():
                    return
                first = min((each[0] for each in times.values() if each), default=None)
                print(json.dumps({"got": [len(times[topic]) for topic in TOPICS], "first": first}), flush=True)
                for each in times.values():
                    each.clear()


@contextmanager
def subscribers() -> Iterator[list[subprocess.Popen[str]]]:
    """The programs, once all of them listen."""
    pipe = subprocess.PIPE
    command = [sys.executable, "-m", __spec__.name, "subscribe"]
    begun = [subprocess.Popen([*command, kind], stdin=pipe, stdout=pipe, text=True) for kind in KINDS]
    try:
        for each in begun:
            assert each.stdout is not None
            if each.stdout.readline().strip() != "listening":
                raise ArtibotError("exercise: a subscriber did not start")
        yield begun
    finally:
        for each in begun:
            each.communicate()  # closes its standard input, which ends it


def replay(bag: Path, wait: str) -> float:
    """Replay once; return the steady time of its start."""
    how = [] if wait == "default" else ["--wait", wait]
    begun = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-m", "artibot_sim.cli", "replay", str(bag), "--clock", "0", *how],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    if done.returncode:
        raise ArtibotError(f"exercise: replay ended with status {done.returncode}: {done.stderr.strip()[-300:]}")
    return begun


def exercise(listeners: Sequence[subprocess.Popen[str]], bag: Path, starts: int, wait: str) -> dict[str, Any]:
    """Replay so many times; what was missed, in messages, by kind of subscriber, and what the start took, s."""
    missed: dict[str, list[int]] = {kind: [] for kind in KINDS}
    took = []
    for _ in range(starts):
        begun = replay(bag, wait)
        time.sleep(SETTLE)
        firsts = []
        for kind, each in zip(KINDS, listeners, strict=True):
            assert each.stdin is not None and each.stdout is not None
            each.stdin.write("\n")
            each.stdin.flush()
            said = json.loads(each.stdout.readline())
            missed[kind].append(max(MESSAGES - got for got in said["got"]))
            firsts.append(said["first"])
        took.append(min((first for first in firsts if first is not None), default=np.nan) - begun)
    return {
        "wait": wait,
        "starts": starts,
        "first message after (s)": [round(float(q), 2) for q in np.quantile(took, (0.0, 0.5, 1.0))],
        **{
            f"{kind} that missed some": f"{sum(map(bool, lost))} of {len(lost)}, at most {max(lost)} of {MESSAGES}"
            for kind, lost in missed.items()
        },
        "missed": dict(sorted(Counter(each for lost in missed.values() for each in lost if each).items())),
    }


def main(argv: Sequence[str] | None = None) -> int:
    """Measure, and print what was found."""
    given = sys.argv[1:] if argv is None else argv
    if given[0] == "subscribe":
        subscribe(given[1])
        return 0
    with tempfile.TemporaryDirectory(prefix="artibot-replay-") as folder, subscribers() as listeners:
        bag = recording(Path(folder) / "bag")
        for wait in given[1:]:
            print(json.dumps(exercise(listeners, bag, int(given[0]), wait)), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
