"""Tasks on a real Dask cluster of processes on loopback: the same results, whatever is killed."""

from __future__ import annotations

import json
import logging
import math
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from artibot_sim import cli
from artibot_sim.cluster import _remote, check_address, identity, map_tasks
from artibot_sim.errors import ArtibotError
from artibot_sim.sweep import SweepPlan, sweep
from artibot_sim.sweep.folder import TABLE
from ros_helpers import ROOT

LOOPBACK = {"0100007F", "0" * 24 + "01000000"}


class Cluster:
    """A scheduler and its workers, each a process that listens on loopback alone."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.processes: list[subprocess.Popen[bytes]] = []
        described = folder / "scheduler.json"
        dashboard = ["--dashboard-address", "127.0.0.1:0"]
        self.scheduler = self.start("dask_scheduler", "--port", "0", "--scheduler-file", str(described), *dashboard)
        deadline = time.monotonic() + 60
        while not described.exists() or not described.read_text().strip():
            assert self.scheduler.poll() is None and time.monotonic() < deadline
            time.sleep(0.05)
        self.address = json.loads(described.read_text())["address"]

    def start(self, program: str, *arguments: str, package: Path = ROOT) -> subprocess.Popen[bytes]:
        path = os.pathsep.join([str(package), *filter(None, sys.path)])
        command = [sys.executable, "-m", f"distributed.cli.{program}", "--host", "127.0.0.1", *arguments]
        with open(self.folder / f"{program}{len(self.processes)}.log", "wb") as log:
            process = subprocess.Popen(
                command, cwd=self.folder, env={**os.environ, "PYTHONPATH": path}, stdout=log, stderr=log
            )
        self.processes.append(process)
        return process

    def worker(self, package: Path = ROOT) -> subprocess.Popen[bytes]:
        more = ["--no-nanny", "--nthreads", "1", "--memory-limit", "0", "--dashboard-address", "127.0.0.1:0"]
        return self.start("dask_worker", self.address, *more, "--local-directory", str(self.folder), package=package)

    def end(self) -> None:
        for process in self.processes:
            process.kill()
        for process in self.processes:
            process.wait()


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    pytest.importorskip("distributed", reason="pip install 'artibot_sim[cluster]'")
    found = Cluster(tmp_path_factory.mktemp("cluster"))
    try:
        workers = [found.worker(), found.worker()]
        wait_for_workers(found, len(workers))
        yield found
    finally:
        found.end()


def wait_for_workers(cluster: Cluster, count: int) -> None:
    from distributed import Client

    with Client(cluster.address, set_as_default=False) as client:
        client.wait_for_workers(count, timeout=60)


def listening(pid: int) -> set[str]:
    """Local addresses, in the kernel's hexadecimal, of the sockets on which a process listens."""
    inodes = set()
    for entry in Path(f"/proc/{pid}/fd").iterdir():
        try:
            inodes.add(os.readlink(entry))
        except OSError:
            continue
    found = set()
    for table in ("tcp", "tcp6"):
        for line in Path(f"/proc/{pid}/net/{table}").read_text().splitlines()[1:]:
            fields = line.split()
            if fields[3] == "0A" and f"socket:[{fields[9]}]" in inodes:
                found.add(fields[1].partition(":")[0])
    return found


def test_what_is_started_here_listens_on_loopback_alone(cluster: Cluster) -> None:
    for process in cluster.processes:
        assert listening(process.pid) and listening(process.pid) <= LOOPBACK


def test_results_are_those_of_this_machine_to_the_bit(
    cluster: Cluster, grid: SweepPlan, swept: Path, tmp_path: Path
) -> None:
    done = sweep(grid, tmp_path / "spread", scheduler=cluster.address, chunk=5)
    assert done.runs.read_bytes() == (swept / TABLE).read_bytes()
    assert dict(map_tasks(math.factorial, range(20), scheduler=cluster.address)) == dict(
        map_tasks(math.factorial, range(20), workers=1)
    )


def test_an_identification_and_a_diagnosis_fit_on_the_cluster(cluster: Cluster) -> None:
    import dataclasses

    import numpy as np

    from artibot_sim.diagnose.candidates.hypotheses import hypotheses
    from artibot_sim.diagnose.candidates.screening import around, screen
    from artibot_sim.diagnose.selection.joint_fits import Rounds, contest
    from artibot_sim.estimation.measurements import stretches
    from artibot_sim.estimation.problem import Problem
    from artibot_sim.estimation.search import Effort, search
    from artibot_sim.estimation.windows import cut
    from artibot_sim.identify.requested import parameter_set
    from artibot_sim.identify.synthetic import random_manoeuvre, synthetic
    from artibot_sim.model import load_robot

    robot, rng = load_robot("agriq"), np.random.default_rng(2)
    drive = synthetic(robot, random_manoeuvre(rng, 10.0), duration=10.0)
    found = stretches(drive, robot)
    problem = Problem(parameter_set(robot, ["k_l"]), found, cut(found, robot, 5.0, 0.3)[:1])
    effort = Effort(starts=2, first=1, finalists=1, last=1)
    here = search(problem, effort)
    there = search(problem, dataclasses.replace(effort, scheduler=cluster.address))
    assert here.point.cost == there.point.cost and here.report == there.report and here.report.restarts == 2
    np.testing.assert_array_equal(here.point.coordinates, there.point.coordinates)
    np.testing.assert_array_equal(here.point.starts, there.point.starts)
    base = around(problem, here.loss, here.point)
    tried = screen(base, [one for one in hypotheses(robot, found) if one.extension.id == "joint_friction"])
    fitted = [
        contest(tried, 1e9, here.loss, Rounds(few=1, many=1, scheduler=address)) for address in (None, cluster.address)
    ]  # against a baseline that any effect beats
    (one,), (other,) = fitted
    assert one.id == other.id == "joint_friction" and one.fit.point.cost == other.fit.point.cost
    np.testing.assert_array_equal(one.fit.point.coordinates, other.fit.point.coordinates)


def test_workers_that_lack_the_task_are_refused_with_the_mend(
    cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "only_here.py").write_text("def twice(x):\n    return 2 * x\n", encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    import only_here  # type: ignore[import-not-found]

    with pytest.raises(ArtibotError, match="cannot import only_here"):
        list(map_tasks(only_here.twice, [1], scheduler=cluster.address))


def test_a_task_that_is_refused_says_why(cluster: Cluster) -> None:
    with pytest.raises(ArtibotError, match="expected an address"):
        list(map_tasks(check_address, ["nowhere"], scheduler=cluster.address))


def test_a_worker_killed_in_the_middle_loses_nothing(
    cluster: Cluster, grid: SweepPlan, swept: Path, tmp_path: Path
) -> None:
    victim = cluster.worker()
    wait_for_workers(cluster, 3)

    def tell(done: int, _before: int) -> None:
        if done >= 8 and victim.poll() is None:
            victim.send_signal(signal.SIGKILL)
            victim.wait()

    done = sweep(grid, tmp_path / "hurt", scheduler=cluster.address, chunk=2, progress=tell)
    assert victim.returncode == -signal.SIGKILL
    assert done.runs.read_bytes() == (swept / TABLE).read_bytes()


def test_workers_of_another_artibot_are_refused(
    cluster: Cluster, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(ROOT / "artibot_sim", tmp_path / "artibot_sim", ignore=shutil.ignore_patterns("__pycache__"))
    version = tmp_path / "artibot_sim" / "version.py"
    version.write_text(version.read_text().replace("__version__ = ", "__version__ = '9.9' + "), encoding="utf-8")
    stranger = cluster.worker(package=tmp_path)
    wait_for_workers(cluster, 3)
    flags = ["--axis", "kappa=0.7,0.8", "--manoeuvre", "short", "--out", str(tmp_path / "out")]
    assert cli.main(["sweep", *flags, "--scheduler", cluster.address]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "has artibot 9.9" in said and f"this is artibot {identity()}" in said
    stranger.kill()
    stranger.wait()


def test_one_that_joins_later_is_refused_too() -> None:
    with pytest.raises(ArtibotError, match="a worker that joined has artibot"):
        _remote(math.factorial, "0.0.1 (abc)", 3)
    assert _remote(math.factorial, identity(), 3) == 6


def test_a_scheduler_that_is_lost_is_said_in_a_line_and_by_nobody_else(
    cluster: Cluster, grid: SweepPlan, swept: Path, tmp_path: Path
) -> None:
    logged: list[logging.LogRecord] = []
    library = logging.getLogger("distributed.client")
    library.addFilter(logged.append)  # type: ignore[arg-type]  # whose None keeps the record away

    def tell(done: int, _before: int) -> None:
        if done >= 8:
            cluster.scheduler.kill()

    with pytest.raises(ArtibotError, match=r"lost after \d+ tasks.*start it and its workers again") as error:
        sweep(grid, tmp_path / "lost", scheduler=cluster.address, chunk=2, progress=tell)
    library.removeFilter(logged.append)  # type: ignore[arg-type]
    assert "\n" not in str(error.value) and not logged
    done = sweep(grid, tmp_path / "lost")  # and here it goes on
    assert 8 <= done.before < 48
    assert done.runs.read_bytes() == (swept / TABLE).read_bytes()


def test_no_scheduler_is_said_in_a_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr("artibot_sim.cluster.CONNECT", 0.5)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))  # nobody listens there
        with pytest.raises(ArtibotError, match="no Dask scheduler answers there"):
            list(map_tasks(math.factorial, [1], scheduler=f"tcp://127.0.0.1:{taken.getsockname()[1]}"))


@pytest.mark.parametrize("address", ["localhost:8786", "tcp://", "tcp://host", "http://host:1", "tcp://host:x"])
def test_what_is_no_address_is_refused(address: str) -> None:
    with pytest.raises(ArtibotError, match=r"expected an address such as tcp://127\.0\.0\.1:8786"):
        check_address(address)


@pytest.mark.parametrize("workers", [1, 2])
def test_here_every_task_is_done_once(workers: int) -> None:
    assert dict(map_tasks(math.factorial, iter(range(30)), workers=workers)) == dict(
        enumerate(map(math.factorial, range(30)))
    )


def test_a_worker_process_that_is_killed_is_said_in_a_line() -> None:
    with pytest.raises(ArtibotError, match="a worker process was killed"):
        list(map_tasks(os._exit, [9], workers=2))


def test_worker_processes_end_with_a_killed_parent(tmp_path: Path) -> None:
    code = (
        "import time\nfrom artibot_sim.cluster import map_tasks\n"
        "if __name__ == '__main__':\n    list(map_tasks(time.sleep, [60, 60], workers=2))\n"
    )
    script = tmp_path / "parent.py"
    script.write_text(code, encoding="utf-8")
    with subprocess.Popen([sys.executable, str(script)], env={**os.environ, "PYTHONPATH": str(ROOT)}) as parent:
        deadline = time.monotonic() + 30
        while len(children(parent.pid)) < 3 and time.monotonic() < deadline:  # two workers and a tracker
            time.sleep(0.02)
        started = children(parent.pid)
        parent.kill()
    assert len(started) >= 3
    deadline = time.monotonic() + 10
    while any(Path(f"/proc/{pid}").exists() for pid in started) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not [pid for pid in started if Path(f"/proc/{pid}").exists()]


def children(pid: int) -> list[int]:
    try:
        return [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    except OSError:
        return []
