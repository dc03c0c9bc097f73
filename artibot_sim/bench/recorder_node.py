"""How much the record node takes with everything in it: the middleware, its queue, the writer, the disk."""

from __future__ import annotations

import json
import signal
import struct
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

from artibot_sim.bench.nodes import environment_of, load, started
from artibot_sim.bench.results import Result
from artibot_sim.bench.scenario import Scenario
from artibot_sim.errors import ArtibotError

RATES = (1_000, 2_000, 4_000, 8_000, 12_000, 16_000, 24_000, 32_000)
"""Messages a second of all topics together; a rover's topics make some 1500."""


def recorder_node(scenario: Scenario) -> list[Result]:
    """The real node beside a process that publishes ever more: the highest rate of which nothing was lost."""
    rates, seconds = (RATES[:3], 1.0) if scenario.quick else (RATES, 3.0)
    with tempfile.TemporaryDirectory(prefix="artibot-bench-") as folder:
        bag = Path(folder) / "recorded"
        with started("record", ["-o", str(bag), "-t", "/bench/*"], folder) as recorder:
            stages = _published(seconds, rates, folder)
            recorder.send_signal(signal.SIGINT)
            recorder.wait(60.0)
        found = _recorded(bag)
    scenario.tick()
    lost = {stage: int(each["sent"]) - found[stage] for stage, each in enumerate(stages)}
    whole = [stage for stage in lost if not any(lost[below] for below in range(stage + 1))]
    if not whole:
        raise ArtibotError(f"bench: the recorder lost {lost[0]} of {stages[0]['sent']} messages at {rates[0]} a second")
    reached = stages[whole[-1]]["sent"] / stages[whole[-1]]["seconds"]
    note = (
        f"record node, states of four motors on four topics, {seconds:g} s at each of {len(rates)} rates up to "
        f"{rates[-1]}; the highest up to which nothing was lost"
    )
    by_rate = {f"lost_at_{rates[stage]}": float(count) for stage, count in lost.items()}
    return [Result("recorder_node", reached, "messages/s", note, by_rate | load())]


def _published(seconds: float, rates: tuple[int, ...], folder: str) -> list[dict[str, float]]:
    """What another process published."""
    command = [sys.executable, "-m", "artibot_sim.nodes.record_exercise", str(seconds), *map(str, rates)]
    done = subprocess.run(command, env=environment_of(folder), capture_output=True, text=True, check=False)
    if done.returncode:
        raise ArtibotError(f"bench: publishing failed: {done.stderr.strip().splitlines()[-1:]}")
    stages: list[dict[str, float]] = json.loads(done.stdout.splitlines()[-1])
    return stages


def _recorded(bag: Path) -> Counter[int]:
    """How many different messages of each rate are in a bag."""
    from artibot_sim.experiment.storage import iter_messages

    seen: set[tuple[Any, ...]] = {struct.unpack_from("<iI", message.data, 4) for message in iter_messages(bag)}
    return Counter(stage for stage, _ in seen)
