"""Real-time quality of the driver, and of recorded frames played beside topics: on vcan0, or the loopback bus."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from artibot_sim.bench.nodes import environment_of, load, missing, pause, replay_missing, started, statistics_of
from artibot_sim.bench.results import Result
from artibot_sim.bench.scenario import Scenario
from artibot_sim.errors import ArtibotError

VCAN: Final = "vcan0"
START: Final = 60.0
"""How long a process may take until it says what is waited for, s."""

WAITING: Final = "waiting for the driver"
"""What the process says that is to keep the driver busy."""

TPDOS: Final = (0x181, 0x182, 0x183, 0x184, 0x281, 0x282, 0x283, 0x284)
"""What four drives answer to a SYNC."""

__all__ = ["driver", "missing", "replay_can", "replay_missing"]


def driver(scenario: Scenario) -> list[Result]:
    """The driver node at 100 Hz with four simulated drives, commanded, and all of its services called all the time.

    It is started last: whatever starts beside it would take a processor from it.
    """
    seconds = 5 if scenario.quick else 30
    with tempfile.TemporaryDirectory(prefix="artibot-bench-") as folder, _bus(folder, scenario) as channel:
        stats = Path(folder) / "driver.json"
        given = ["--channel", channel, "--enable", "--stats", str(stats)]
        with (
            started("drives", ["--bench", "--channel", channel], folder),
            _busy(channel, seconds, folder) as (busy, log),
        ):
            _wait_for(log, WAITING, busy, scenario)
            with started("driver", given, folder) as node:
                said = _wait_for(log, "}", busy, scenario, START + seconds)
                node.send_signal(signal.SIGINT)
                found = statistics_of(node, stats, 30, scenario)
    return _driver_results(found, json.loads(said.splitlines()[-1]), channel)


def _driver_results(found: dict[str, Any], seen: dict[str, Any], channel: str) -> list[Result]:
    note = f"driver at 100 Hz on {_kind(channel)}, {found['wall_s']:.0f} s, {seen['calls']} services called meanwhile"
    late = ("late_p50_ms", "late_max_ms", "overruns", "steps", "cpu_share")
    turns = ("callback_turns", "callback_wall_p99_ms", "callback_cpu_p99_ms", "callback_cpu_max_ms")
    wire = {key: value for key, value in seen.items() if key.startswith("sync")}
    return [
        Result("driver_late_p99", found["late_p99_ms"], "ms", f"set-points and SYNC out after the deadline; {note}",
               {key: found[key] for key in late} | load()),
        Result("driver_sync_jitter_p99", seen["sync_jitter_p99_ms"], "ms", f"intervals of SYNC on the bus; {note}",
               wire | load()),
        Result("driver_callback_longest", found["callback_wall_max_ms"], "ms", f"between two periods; {note}",
               {key: found[key] for key in turns} | load()),
    ]  # fmt: skip


@contextmanager
def _busy(channel: str, seconds: float, folder: str) -> Iterator[tuple[subprocess.Popen[bytes], Path]]:
    """A process that keeps the driver busy, and what it prints."""
    command = [sys.executable, "-m", "artibot_sim.nodes.driver_exercise", channel, str(seconds)]
    log = Path(folder) / "exercise.log"
    with (
        open(log, "wb") as sink,
        subprocess.Popen(command, stdout=sink, stderr=subprocess.STDOUT, env=environment_of(folder)) as process,
    ):
        try:
            yield process, log
        finally:
            process.kill()


def replay_can(scenario: Scenario) -> list[Result]:
    """A computed recording of Table 6 with the frames of four drives beside it, topics and frames played together."""
    with tempfile.TemporaryDirectory(prefix="artibot-bench-") as folder, _bus(folder, scenario) as channel:
        bag, stats = _with_frames(Path(folder), scenario), Path(folder) / "replay.json"
        end = ["--end", "4"] if scenario.quick else []
        with started("replay", [str(bag), *end, "--can", channel, "--stats", str(stats)], folder) as process:
            found = statistics_of(process, stats, 120, scenario)
    by_topic = found["late_p99_ms_by_topic"]
    frames = by_topic.pop("/from_can_bus")
    beside = {"late_p50_ms": found["late_p50_ms"], "late_max_ms": found["late_max_ms"], "not_sent": found["not_sent"]}
    count = found["topics"]["/from_can_bus"]
    note = f"{count} frames on {_kind(channel)} after their recorded instant, beside {len(by_topic)} topics"
    return [
        Result("replay_can_late_p99", frames, "ms", f"{note}; load {os.getloadavg()[0]:.1f}",
               beside | {"topics_late_p99_ms": max(by_topic.values())} | load()),
    ]  # fmt: skip


def _with_frames(folder: Path, scenario: Scenario) -> Path:
    """Table 6 as a recording, with eight frames every 10 ms."""
    from artibot_sim.experiment import BagWriter, write_experiment
    from artibot_sim.experiment.can_frames import CAN_QOS, CAN_TOPIC, CanFrame, encode_frame
    from artibot_sim.experiment.messages import CAN_FRAME
    from artibot_sim.experiment.storage import iter_messages

    plain = folder / "plain"
    write_experiment(plain, scenario.rollout("rk4", 1e-3), scenario.plan, scenario.robot)
    messages = list(iter_messages(plain))
    topic, first, last = f"/{CAN_TOPIC}", messages[0].log_ns, messages[-1].log_ns
    frames = [
        (stamp, topic, encode_frame(CanFrame(stamp, can_id, stamp.to_bytes(8, "little"), 8)))
        for begin in range(first, last, 10_000_000)
        for stamp, can_id in ((begin + 100_000 * k, can_id) for k, can_id in enumerate(TPDOS, 1))
    ]
    merged = sorted([*frames, *((each.log_ns, each.channel.topic, each.data) for each in messages)])
    with BagWriter(folder / "table6", live=False) as bag:
        bag.register(topic, CAN_FRAME, CAN_QOS)
        for channel in {each.channel.topic: each.channel for each in messages}.values():
            bag.register(channel.topic, channel.ros_type)
        for stamp, name, data in merged:
            bag.write(name, data, publish_ns=stamp, log_ns=stamp)
    return folder / "table6"


def _kind(channel: str) -> str:
    return channel if channel == VCAN else "the loopback bus"


@contextmanager
def _bus(folder: str, scenario: Scenario) -> Iterator[str]:
    """The channel of vcan0 where this kernel has it, up; else of a loopback bus."""
    flags = Path("/sys/class/net") / VCAN / "flags"
    if flags.exists() and int(flags.read_text(encoding="ascii"), 0) & 1:
        yield VCAN
        return
    with started("can", ["loopback"], folder) as server:
        said = _wait_for(Path(folder) / "can.log", "ws://", server, scenario)
        yield next(word for word in said.split() if word.startswith("ws://"))


def _wait_for(
    log: Path, text: str, process: subprocess.Popen[bytes], scenario: Scenario, patience: float = START
) -> str:
    """What a process has said once it has said `text`."""
    deadline = time.monotonic() + patience
    while text not in (said := log.read_text(encoding="utf-8", errors="replace")):
        if process.poll() is not None or time.monotonic() > deadline:
            lines = said.splitlines()
            raise ArtibotError(f"bench: {log.stem} did not say '{text}', but: {lines[-1] if lines else 'nothing'}")
        pause(0.1, scenario)
    return said
