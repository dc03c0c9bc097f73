"""``python -m artibot_sim.bench.growth_tasks KIND SIZE FOLDER``: one measurement in a process of its own.

Prints JSON: for every operation its wall time and processor time (s), and the most memory that the process
had until its end (bytes).
"""

from __future__ import annotations

import json
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

Figures = dict[str, dict[str, float]]

PERIOD = 60.0
"""s of a long recording that are simulated, and written, at a time."""
_TOPICS = ("ground_truth_odom", "joint_states", "motor_torques")


class Watch:
    """Takes the times of operations."""

    def __init__(self) -> None:
        self.figures: Figures = {}

    def __call__(self, name: str, operation: Callable[[], Any]) -> Any:
        """Do it and note how long it took, and the peak of memory so far."""
        wall, cpu = time.perf_counter(), time.process_time()
        result = operation()
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        self.figures[name] = {"seconds": wall, "cpu": cpu, "bytes": peak_memory()}
        return result


def peak_memory(process: int | str = "self") -> float:
    """Most memory that a program had at once, bytes.

    Linux's `ru_maxrss` survives `exec`: a program begun by a large process starts with that one's peak.
    `VmHWM` does not.
    """
    return 1024.0 * float(_status(process)["VmHWM"].split()[0])


@contextmanager
def children_watched() -> Iterator[dict[int, float]]:
    """Number of each child process that there is meanwhile → most memory that it had at once, bytes.

    Each is asked five times a second, for nobody knows of one that is over. The first moment of a child, before it is
    a program of its own, is its parent's memory: what it says last holds.
    """
    found: dict[int, float] = {}
    over = threading.Event()

    def watch() -> None:
        while not over.wait(0.2):
            for process in (int(path.name) for path in Path("/proc").glob("[0-9]*")):
                with suppress(OSError, KeyError):  # over by now
                    if int(_status(process)["PPid"]) == os.getpid():
                        found[process] = peak_memory(process)

    thread = threading.Thread(target=watch, name="children")
    thread.start()
    try:
        yield found
    finally:
        over.set()
        thread.join()


def _status(process: int | str) -> dict[str, str]:
    """What Linux says of a process."""
    lines = Path(f"/proc/{process}/status").read_text(encoding="utf-8", errors="replace").splitlines()
    return dict(line.split(":", 1) for line in lines)


def runs(size: float, folder: Path) -> Figures:
    """A sweep of so many runs of ten seconds in one process, table and summary included."""
    from artibot_sim.sweep import plan_from_dict, sweep
    from artibot_sim.sweep.summary import summarise

    axes = {"contact.k_l": {"from": 1500, "to": 3500}, "contact.mu_s": {"from": 0.45, "to": 0.9}}
    document = {"manoeuvre": "short", "method": "latin", "runs": int(size), "axes": axes, "dt": 2e-3}
    plan = plan_from_dict(document | {"integrator": "semi_implicit"})
    sweep(plan_from_dict(document | {"integrator": "semi_implicit", "runs": 2}), folder / "warm", workers=1)
    watch = Watch()
    done = watch("sweep", lambda: sweep(plan, folder / "sweep", workers=1))
    watch("summary", lambda: summarise(done.folder))
    return watch.figures


def table(size: float, folder: Path) -> Figures:
    """Parts of finished runs made into a table, and its summary."""
    from artibot_sim.sweep.folder import TABLE, Folder, table_bytes
    from artibot_sim.sweep.plan import plan_from_dict
    from artibot_sim.sweep.summary import summarise

    axes = {f"contact.{name}": {"from": 0.31, "to": 0.9} for name in ("mu_s", "u_w")}
    plan = plan_from_dict({"manoeuvre": "short", "method": "latin", "runs": int(size), "axes": axes})
    rng = np.random.default_rng(0)
    watch = Watch()
    with Folder(folder / "sweep", plan) as opened:
        for first, count in list(opened.missing(max(250, int(size) // 1000))):
            drawn = rng.random((count, len(plan.measures))).tolist()
            rows = [dict(zip(plan.measures, row, strict=True)) for row in drawn]
            status = ["ok"] * count
            data = table_bytes(first, plan.columns(first, count), [], plan.measures, rows, status, [""] * count)
            opened.add(first, count, data)
        watch("merge", opened.finish)
    watch("summary", lambda: summarise(folder / "sweep"))
    watch.figures["merge"]["file"] = float((folder / "sweep" / TABLE).stat().st_size)
    return watch.figures


def length(size: float, folder: Path) -> Figures:
    """A recording of so many minutes: written, streamed, read, drawn, simulated again."""
    from artibot_sim.experiment import iter_messages, read_bag
    from artibot_sim.experiment.resimulate import resimulate
    from artibot_sim.model import load_robot
    from artibot_sim.report.recordings import draw

    robot, watch, bag = load_robot("agriq"), Watch(), folder / "long"
    list(pieces(60.0))  # compiles, or loads what was compiled
    watch("write", lambda: write_long(bag, 60.0 * size))
    watch("stream", lambda: sum(1 for _ in iter_messages(bag)))
    experiment = watch("read", lambda: read_bag(bag))
    watch("plot", lambda: draw([experiment], [robot], png=folder / "long.png"))
    watch("resimulate", lambda: resimulate(experiment, robot, horizon=5.0))
    return watch.figures


def identification(size: float, folder: Path) -> Figures:
    """Two parameters identified from a recording of so many minutes."""
    from artibot_sim.experiment import read_bag
    from artibot_sim.identify import identify
    from artibot_sim.model import load_robot

    watch, bag, robot = Watch(), folder / "long", load_robot("agriq")
    write_long(bag, 60.0 * size)
    experiment = read_bag(bag)
    identify([experiment.between(0.0, 30.0)], robot, fit=["k_l"])
    watch("identify", lambda: identify([experiment], robot, fit=["k_l", "k_t"]))
    return watch.figures


def diagnosis(size: float, folder: Path) -> Figures:
    """A diagnosis of so many minutes on a slope, in recordings of half a minute."""
    return _diagnosed(round(2 * size), 1)


def hidden(size: float, folder: Path) -> Figures:
    """A diagnosis of two recordings of half a minute in which so many effects are at work."""
    return _diagnosed(2, int(size))


def _diagnosed(count: int, effects: int) -> Figures:
    from artibot_sim.bench.workflows import recordings
    from artibot_sim.diagnose import diagnose
    from artibot_sim.model import load_robot

    watch, robot = Watch(), load_robot("agriq")
    given = recordings(robot, count + 1, 30.0, effects)  # the last one is held out
    watch("diagnose", lambda: diagnose(given, robot))
    return watch.figures


def pieces(duration: float) -> Iterator[tuple[float, Any]]:
    """A drive of figures of eight, simulated a minute at a time: start (s) and rollout of each piece."""
    from artibot_sim.model import Commands, load_robot, rollout
    from artibot_sim.planning import Manoeuvre, Repeat, load_manoeuvre, plan

    robot, eight = load_robot("agriq"), load_manoeuvre("eight")
    once = plan(eight, robot)
    times = int(np.ceil(duration / once.duration)) + 1
    planned = plan(Manoeuvre("eights", (Repeat(times, eight.segments),), a_max=eight.a_max), robot).commands()
    knots, state = round(PERIOD / planned.dt), None
    for first in range(0, round(duration / planned.dt), knots):
        rows = slice(first, min(first + knots, round(duration / planned.dt)) + 1)
        part = Commands(planned.dt, planned.velocity[rows], position=planned.position[rows], t0=first * planned.dt)
        result = rollout(robot, part, integrator="semi_implicit", dt=2e-3, every=5, state=state)
        state = result.final_state
        yield first * planned.dt, result


def write_long(bag: Path, duration: float) -> None:
    """Write a recording of `duration` s, three topics at 100 Hz, a minute in memory at a time."""
    from artibot_sim.experiment import BagWriter
    from artibot_sim.experiment.messages import encoder
    from artibot_sim.experiment.rollout_bag import START_NS, rollout_columns
    from artibot_sim.experiment.topics import BY_KEY

    with BagWriter(bag, {"robot": "agriq"}, live=False) as writer:
        for key in _TOPICS:
            writer.register(BY_KEY[key].name, BY_KEY[key].ros_type)
        for start, result in pieces(duration):
            columns = rollout_columns(result, result.robot)
            encoders = [(BY_KEY[key].name, encoder(BY_KEY[key], columns[key])) for key in _TOPICS]
            stamps = (START_NS + np.rint(result.t * 1e9)).astype(np.int64).tolist()
            for row, stamp in enumerate(stamps[1 if start else 0 :], 1 if start else 0):
                for topic, encode in encoders:
                    writer.write(topic, encode(row, stamp), stamp, stamp)


def effects(size: float, folder: Path) -> Figures:
    """A rollout with so many of the model's effects at work."""
    import dataclasses

    from artibot_sim.bench.model import ALL_EFFECTS, Scenario
    from artibot_sim.bench.results import repeat

    scenario = Scenario()
    chosen = dict(list(ALL_EFFECTS.items())[: int(size)])
    scenario = dataclasses.replace(scenario, rover=dataclasses.replace(scenario.robot, effects=chosen))
    timing = repeat(lambda: scenario.rollout("rk4", 1e-3), 8)
    return {"rollout": {"seconds": timing.best, "cpu": float(timing.cpu.min()), "bytes": peak_memory()}}


def modules(size: float, folder: Path) -> Figures:
    """A rollout of a robot with so many modules, by the kernels for any number of them."""
    from artibot_sim.bench.model import Scenario
    from artibot_sim.bench.results import repeat
    from artibot_sim.bench.trains import chain, of_modules

    robot, commands = of_modules(int(size)), Scenario().commands
    timing = repeat(lambda: chain(robot, commands), 5)
    return {"rollout": {"seconds": timing.best, "cpu": float(timing.cpu.min()), "bytes": peak_memory()}}


def cores(size: float, folder: Path) -> Figures:
    """A sweep in so many processes, their start included; an identification in so many threads."""
    from artibot_sim.bench.workflows import recordings
    from artibot_sim.identify import identify
    from artibot_sim.model import load_robot
    from artibot_sim.sweep import plan_from_dict, sweep

    axes = {"contact.k_l": {"from": 1500, "to": 3500}, "contact.mu_s": {"from": 0.45, "to": 0.9}}
    plan = plan_from_dict({"manoeuvre": "table6_agriq", "method": "latin", "runs": 512, "axes": axes})
    watch = Watch()
    with children_watched() as children:
        watch("sweep", lambda: sweep(plan, folder / "sweep", workers=int(size)))
    watch.figures["sweep"]["bytes"] += sum(children.values())
    watch.figures["sweep"]["cpu"] += sum(os.times()[2:4])  # of processes that are over
    robot = load_robot("agriq")
    drives = recordings(robot, 2, 30.0, 0)
    identify(drives[:1], robot, fit=["k_l"], workers=int(size))
    watch("identify", lambda: identify(drives, robot, workers=int(size)))
    return watch.figures


KINDS: dict[str, Callable[[float, Path], Figures]] = {
    "runs": runs, "table": table, "length": length, "identification": identification, "diagnosis": diagnosis,
    "hidden": hidden, "effects": effects, "modules": modules, "cores": cores,
}  # fmt: skip


if __name__ == "__main__":
    print(json.dumps(KINDS[sys.argv[1]](float(sys.argv[2]), Path(sys.argv[3]))))
