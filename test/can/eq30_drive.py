"""Runs on a kernel with CAN: the driver's master leads `artibot drives` through a plan on vcan0 while candump logs.

Prints what the log shows as JSON. See test_eq30_vcan.py.
"""

# ruff: noqa: E402, I001
from __future__ import annotations

import dataclasses
import json
import math
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parent)]

from eq30_log import check, sync_jitter
from ros_helpers import ROOT, NodeStarter

from artibot_driver.bus import open_bus
from artibot_driver.config import config_from_parameters
from artibot_driver.master import Master, Phase, Setpoints
from artibot_driver.rig import load_rig
from artibot_sim.model import load_robot
from artibot_sim.planning import Plan, load_manoeuvre, plan

PARAMETERS = {"heartbeat.drive_timeout": 0.5, "heartbeat.driver_timeout": 0.5}
"""What is too late, and stops a rover, is tested elsewhere."""


def main(channel: str, manoeuvre: str, kappas: list[str]) -> None:
    """Drive `manoeuvre` once with each kappa, from standstill to standstill."""
    planned = plan(load_manoeuvre(manoeuvre), load_robot("agriq"))
    for kappa in kappas:
        with tempfile.TemporaryDirectory() as folder:
            start, log = NodeStarter(Path(folder), {}), Path(folder) / "candump.log"
            try:
                params = Path(folder) / "driver.yaml"
                params.write_text(json.dumps({"/**": {"ros__parameters": PARAMETERS}}), encoding="ascii")  # YAML, too
                drives = start("drives", "--channel", channel, "--params", params, "--priority", 0, "--every", 1)
                drives.wait_for("all switch on disabled", 120)
                with open(log, "wb") as sink, subprocess.Popen(["candump", "-L", channel], stdout=sink) as dump:
                    told = lead(channel, planned, float(kappa))
                    dump.terminate()
                    drives.stop()
                told["drives"] = drives.output.splitlines()[-1]
            finally:
                start.end()
            lines, robot = log.read_text(encoding="ascii").splitlines(), str(ROOT / "config" / "agriq.yaml")
            verdict = check(lines, robot, kappa)
            shown = dataclasses.asdict(verdict) | {"wrong": verdict.wrong[:10], "wrongs": len(verdict.wrong)}
            jitter = dict(zip(("sync_jitter_p99_ms", "sync_jitter_max_ms"), sync_jitter(lines), strict=True))
            print(json.dumps({"kappa": kappa, **shown, **jitter, **told}), flush=True)


def lead(channel: str, planned: Plan, kappa: float) -> dict[str, object]:
    """The driver without ROS: enable, follow the plan, disable."""
    rig = load_rig(config_from_parameters({"bus.channel": channel, **PARAMETERS}))
    with open_bus("socketcan", channel) as bus:
        master = Master(bus, rig)
        period, due = round(1e9 / rig.config.sync_rate), time.monotonic_ns()
        begin, deadline, late = 0, due + 60_000_000_000, 0
        while time.monotonic_ns() < deadline:
            now = time.monotonic_ns()
            since = 1e-9 * (now - begin) if begin else 0.0
            velocity = [float(np.interp(since, planned.t, planned.velocity[:, side])) for side in (0, 1)]
            given = Setpoints((velocity[0], velocity[1]), now, (math.nan, math.nan), kappa)
            status = master.cycle(now, given if begin else None).status
            if status.phase is Phase.READY and not begin:
                master.enable()
            if status.phase is Phase.ENABLED and not begin:
                begin, deadline = now, now + round(1e9 * (planned.duration + 0.5))
            if begin and status.phase not in (Phase.ENABLED, Phase.ENABLING):
                break
            due += period
            late += time.monotonic_ns() > due + period
            due = max(due, time.monotonic_ns() - period)
            time.sleep(max(0.0, 1e-9 * (due - time.monotonic_ns())))
        master.close(time.monotonic_ns())
    return {"phase": status.phase.name, "stop": str(status.stop), "overruns": late, "counters": dict(status.counters)}


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], sys.argv[3:])
