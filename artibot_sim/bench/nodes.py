"""Real-time quality of the nodes, the driver and the recorder, from the statistics that they write themselves."""

from __future__ import annotations

import importlib.util
import json
import os
import signal
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Final

from artibot_sim.bench.model import Scenario
from artibot_sim.bench.results import Result
from artibot_sim.errors import ArtibotError
from artibot_sim.resources import local_environment

# ----------------------------------------------------------------------
# Real-time quality of the nodes, from the statistics that they write themselves.
# ----------------------------------------------------------------------


NO_ROS = "rclpy is not installed; source a ROS 2 Jazzy, or pip install 'artibot_sim[ros]'"
PLANNER_READY = 3.0
"""How long the planner gets to start before the simulator, whose statistics it would disturb, s."""


def missing() -> str | None:
    """Why the nodes cannot run here, or None."""
    return None if importlib.util.find_spec("rclpy") else NO_ROS


def replay_missing() -> str | None:
    """Why replay cannot be measured here, or None."""
    if missing():
        return missing()
    if importlib.util.find_spec("artibot_sim.nodes.replay.command") is None:
        return "this version has no replay"
    shown = subprocess.run([*word_of("replay"), "--help"], capture_output=True, text=True, check=False)
    return None if "--stats" in shown.stdout else "replay has no --stats to measure itself with"


def sim(scenario: Scenario) -> list[Result]:
    """The sim node in real time, physics at 1 kHz and topics at 100 Hz, driven along Table 6 by the planner."""
    seconds = 4 if scenario.quick else 20
    with tempfile.TemporaryDirectory(prefix="artibot-bench-") as folder:
        stats = Path(folder) / "sim.json"
        with started("planner", ["table6_agriq", "--keep"], folder):
            pause(PLANNER_READY, scenario)
            with started("sim", ["--duration", str(seconds), "--stats", str(stats)], folder) as process:
                found = statistics_of(process, stats, seconds + 60, scenario)
    note = f"sim node in real time, RK4 at 1 kHz, topics at 100 Hz, driving Table 6 for {found['wall_s']:.0f} s"
    late = ("late_p50_ms", "late_max_ms", "overruns", "steps")
    return [
        Result("sim_node_cpu_share", found["cpu_share"], "cores", note),
        Result("sim_node_late_p99", found["late_p99_ms"], "ms", f"{note}; load {os.getloadavg()[0]:.1f}",
               {key: found[key] for key in late} | load()),
    ]  # fmt: skip


def replay(scenario: Scenario) -> list[Result]:
    """Replay of a computed recording of Table 6 with its recorded timing."""
    from artibot_sim.experiment import write_experiment

    with tempfile.TemporaryDirectory(prefix="artibot-bench-") as folder:
        bag, stats = Path(folder) / "table6", Path(folder) / "replay.json"
        write_experiment(bag, scenario.rollout("rk4", 1e-3), scenario.plan, scenario.robot)
        end = ["--end", "4"] if scenario.quick else []
        with started("replay", [str(bag), *end, "--stats", str(stats)], folder) as process:
            found = statistics_of(process, stats, 120, scenario)
    if "late_p99_ms" not in found:
        raise ArtibotError(f"bench: replay --stats wrote {sorted(found)}; expected late_p99_ms")
    numbers = {key: value for key, value in found.items() if isinstance(value, int | float) and key != "late_p99_ms"}
    note = f"published after the recorded instant, Table 6 at its own pace; load {os.getloadavg()[0]:.1f}"
    return [Result("replay_late_p99", found["late_p99_ms"], "ms", note, numbers | load())]


def load() -> dict[str, float]:
    """How busy the machine was: lateness tells about the node only where a core was free."""
    return {"load_average": os.getloadavg()[0]}


def word_of(word: str) -> list[str]:
    return [sys.executable, "-m", "artibot_sim.cli", word]


def environment_of(log: str) -> dict[str, str]:
    """On this machine only, and in a domain of its own, unless the caller chose one."""
    own = {**local_environment(), "ROS_LOG_DIR": log}
    path = os.pathsep.join(filter(None, sys.path))
    return {"ROS_DOMAIN_ID": str(1 + os.getpid() % 100), **os.environ, **own, "PYTHONPATH": path}


@contextmanager
def started(word: str, arguments: list[str], folder: str) -> Iterator[subprocess.Popen[bytes]]:
    """A process that is asked to end, and then made to, when the block is left."""
    with (
        open(Path(folder) / f"{word}.log", "wb") as log,
        subprocess.Popen([*word_of(word), *arguments], stdout=log, stderr=log, env=environment_of(folder)) as process,
    ):
        try:
            yield process
        finally:
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
                try:
                    process.wait(5.0)
                except subprocess.TimeoutExpired:
                    process.kill()


def statistics_of(process: subprocess.Popen[bytes], stats: Path, timeout: float, scenario: Scenario) -> dict[str, Any]:
    """What a node wrote when it came to its own end."""
    deadline = time.monotonic() + timeout
    while process.poll() is None and time.monotonic() < deadline:
        pause(0.2, scenario)
    if process.returncode != 0 or not stats.exists():
        lines = stats.with_suffix(".log").read_text(encoding="utf-8", errors="replace").splitlines()
        said = lines[-1] if lines else "nothing"
        raise ArtibotError(f"bench: {stats.stem} ended with status {process.returncode} and said: {said}")
    found: dict[str, Any] = json.loads(stats.read_text(encoding="utf-8"))
    return found


def pause(seconds: float, scenario: Scenario) -> None:
    end = time.monotonic() + seconds
    while (left := end - time.monotonic()) > 0:
        time.sleep(min(left, 0.1))
        scenario.tick()


# ----------------------------------------------------------------------
# What a rover that drives costs, with all of its processes.
# ----------------------------------------------------------------------


CHAIN_STARTS = {"sim": " is ready ", "driver": "[driver]: enabled", "record": "recording /motor_command"}
"""What the processes say that are waited for, in the order of their starts."""


def chain(scenario: Scenario) -> list[Result]:
    """Planner, driver, bus, drives, simulator and recorder in real time along Table 6: processor time of each."""
    seconds = 4.0 if scenario.quick else 20.0
    with (
        tempfile.TemporaryDirectory(prefix="artibot-bench-") as folder,
        ExitStack() as running,
        _bus_and_server(folder, scenario) as (channel, server),
    ):
        given = {
            "sim": ["--with-driver", "--channel", channel],
            "driver": ["--channel", channel, "--enable"],
            "record": ["--robot", "agriq", "--out", str(Path(folder) / "recorded")],
        }
        pids = {} if server is None else {"bus": server.pid}
        for word, said in CHAIN_STARTS.items():
            process = running.enter_context(started(word, given[word], folder))
            _wait_for(Path(folder) / f"{word}.log", said, process, scenario)
            pids[word] = process.pid
        planner = running.enter_context(started("planner", ["table6_agriq", "--keep", "--start-delay", "2"], folder))
        pids["planner"] = planner.pid
        pause(2.0 * PLANNER_READY, scenario)
        before, began = {name: processor_time(pid) for name, pid in pids.items()}, time.monotonic()
        pause(seconds, scenario)
        after, took = {name: processor_time(pid) for name, pid in pids.items()}, time.monotonic() - began
    shares = {name: (after[name] - before[name]) / took for name in pids}
    note = f"{', '.join(shares)} on {_kind(channel)}, driving Table 6 in real time for {took:.0f} s"
    return [Result("chain_cpu_share", sum(shares.values()), "cores", note, shares | load())]


def odometry(scenario: Scenario) -> list[Result]:
    """The odometry node behind a simulator that publishes at 50 Hz, driven along Table 6."""
    seconds = 4.0 if scenario.quick else 20.0
    with tempfile.TemporaryDirectory(prefix="artibot-bench-") as folder, ExitStack() as running:
        given = {"sim": ["--ros-args", "-p", "publish_rate:=50.0"], "odometry": ["--robot", "agriq"]}
        for word, said in (("sim", " is ready "), ("odometry", "odometry from ")):
            process = running.enter_context(started(word, given[word], folder))
            _wait_for(Path(folder) / f"{word}.log", said, process, scenario)
        running.enter_context(started("planner", ["table6_agriq", "--keep", "--start-delay", "2"], folder))
        pause(2.0 * PLANNER_READY, scenario)
        before, began = processor_time(process.pid), time.monotonic()
        pause(seconds, scenario)
        share = (processor_time(process.pid) - before) / (time.monotonic() - began)
    note = f"odometry node, rotations and articulation at 50 Hz, driving Table 6 for {seconds:.0f} s"
    return [Result("odometry_node_cpu_share", share, "cores", note, load())]


def no_viewer() -> str | None:
    """Why the view cannot be measured here, or None."""
    return None if importlib.util.find_spec("viser") else "viser is not installed; pip install 'artibot_sim[view]'"


def view(scenario: Scenario) -> list[Result]:
    """From the command to the address of the page, of a recording of Table 6."""
    from artibot_sim.experiment import write_experiment

    took = []
    with tempfile.TemporaryDirectory(prefix="artibot-bench-") as folder:
        bag = Path(folder) / "table6"
        write_experiment(bag, scenario.rollout("rk4", 1e-3), scenario.plan, scenario.robot)
        for _ in range(1 if scenario.quick else 3):
            began = time.monotonic()
            with started("view", [str(bag), "--no-browser", "--port", "0"], folder) as process:
                _wait_for(Path(folder) / "view.log", "http://127.0.0.1", process, scenario)
                took.append(time.monotonic() - began)
    note = f"artibot view, from the command to the address of its page, a recording of {scenario.plan.duration:.0f} s"
    live = _live_view(scenario) if missing() is None else ()  # a recording is shown without ROS
    return [Result("view_start", min(took), "s", note, {"slowest": max(took)} | load()), *live]


def _live_view(scenario: Scenario) -> Iterator[Result]:
    """A live view of a rover that drives, and one who takes all that a page would be sent."""
    seconds = 4.0 if scenario.quick else 20.0
    with tempfile.TemporaryDirectory(prefix="artibot-bench-") as folder, ExitStack() as running:
        sim = running.enter_context(started("sim", [], folder))
        _wait_for(Path(folder) / "sim.log", " is ready ", sim, scenario)
        viewer = running.enter_context(started("view", ["--live", "--no-browser", "--port", "0"], folder))
        log = Path(folder) / "view.log"
        _wait_for(log, "http://127.0.0.1", viewer, scenario)
        running.enter_context(started("planner", ["table6_agriq", "--keep", "--start-delay", "2"], folder))
        pause(2.0 * PLANNER_READY, scenario)
        port = int(log.read_text(encoding="utf-8").partition("http://127.0.0.1:")[2].split()[0].strip("/"))
        page = running.enter_context(_Page(port))
        pause(1.0, scenario)
        before, pictures, began = processor_time(viewer.pid), page.pictures, time.monotonic()
        pause(seconds, scenario)
        after, took = processor_time(viewer.pid), time.monotonic() - began
        rate = (page.pictures - pictures) / took
    note = (
        f"artibot view --live beside a simulator that drives Table 6 for {took:.0f} s; a reader of all that a page gets"
    )
    yield Result("view_live_cpu_share", (after - before) / took, "cores", note, {"pictures_per_s": rate} | load())


class _Page:
    """Takes what the viewer sends to a page, and counts the messages with a picture: with the lines of forces.

    A message of viser's has two sizes (8 bytes each, little-endian), the second that of the zstd frame that follows.
    """

    def __init__(self, port: int) -> None:
        from importlib.metadata import version

        from websockets.sync.client import connect
        from websockets.typing import Subprotocol

        self._socket = connect(
            f"ws://127.0.0.1:{port}", subprotocols=[Subprotocol(f"viser-v{version('viser')}")], max_size=None
        )
        self.pictures = 0
        self._thread = threading.Thread(target=self._read, name="page", daemon=True)

    def __enter__(self) -> _Page:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()
        self._thread.join()

    def _read(self) -> None:
        import zstandard

        unpacker = zstandard.ZstdDecompressor()
        for message in self._socket:
            if isinstance(message, bytes):
                (size,) = struct.unpack_from("<Q", message, 8)
                self.pictures += b"/forces" in unpacker.decompress(message[16 : 16 + size])


def processor_time(pid: int) -> float:
    """What a process has used so far, s."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


# ----------------------------------------------------------------------
# How much the record node takes with everything in it: the middleware, its queue, the writer, the disk.
# ----------------------------------------------------------------------


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
    command = [sys.executable, "-m", "artibot_sim.nodes.record.exercise", str(seconds), *map(str, rates)]
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


# ----------------------------------------------------------------------
# Real-time quality of the driver, and of recorded frames played beside topics: on vcan0, or the loopback bus.
# ----------------------------------------------------------------------


VCAN: Final = "vcan0"
START: Final = 60.0
"""How long a process may take until it says what is waited for, s."""

WAITING: Final = "waiting for the driver"
"""What the process says that is to keep the driver busy."""

TPDOS: Final = (0x181, 0x182, 0x183, 0x184, 0x281, 0x282, 0x283, 0x284)
"""What four drives answer to a SYNC."""

__all__ = ["chain", "driver", "missing", "replay_can", "replay_missing"]


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
    command = [sys.executable, "-m", "artibot_sim.nodes.driver.exercise", channel, str(seconds)]
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
    with _bus_and_server(folder, scenario) as (channel, _):
        yield channel


@contextmanager
def _bus_and_server(folder: str, scenario: Scenario) -> Iterator[tuple[str, subprocess.Popen[bytes] | None]]:
    """A CAN channel to drive on, and the process that serves it where it is a loopback bus."""
    flags = Path("/sys/class/net") / VCAN / "flags"
    if flags.exists() and int(flags.read_text(encoding="ascii"), 0) & 1:
        yield VCAN, None
        return
    with started("can", ["loopback"], folder) as server:
        said = _wait_for(Path(folder) / "can.log", "ws://", server, scenario)
        yield next(word for word in said.split() if word.startswith("ws://")), server


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
