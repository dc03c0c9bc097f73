"""A driver in a process of its own: ``driving_process.py INTERFACE CHANNEL`` enables the drives and drives on."""

from __future__ import annotations

import sys
import time

from artibot_driver.bus import open_bus
from artibot_driver.config import config_from_parameters
from artibot_driver.master import Master, Phase, Setpoints
from artibot_driver.rig import load_rig, motor_per_metre


def main(interface: str, channel: str) -> None:
    """Say "driving" once the drives follow, and go on until somebody ends it."""
    rig = load_rig(config_from_parameters({}))
    master, period = Master(open_bus(interface, channel), rig), 1000 * rig.config.sync_period_us
    velocity = (0.5 * motor_per_metre(rig.robot, "front_right"),) * 2
    due, followed = time.monotonic_ns(), 0
    while True:
        now = time.monotonic_ns()
        status = master.cycle(now, Setpoints(velocity, now)).status
        if status.phase in (Phase.READY, Phase.LOCKED):
            (master.enable if status.phase is Phase.READY else master.reset_fault)()
        followed = followed + 1 if status.following else 0
        if followed == 30:
            print("driving", flush=True)
        due = max(due + period, now)
        time.sleep(max(0.0, 1e-9 * (due - time.monotonic_ns())))


if __name__ == "__main__":
    main(*sys.argv[1:3])
