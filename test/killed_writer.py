"""A process that writes a recording until it is killed, for `experiment/test_kill.py`."""

from __future__ import annotations

import mmap
import struct
import time
from multiprocessing.connection import Connection

from artibot_sim.experiment import BagWriter


def write(folder: str, page: str, data: bytes, tells: Connection) -> None:
    """Write six topics at 100 Hz for two seconds, close the bag, and wait to be killed.

    What was handed to the writer stands in a shared page, the file `page`, which outlives this process: number of
    messages, log time of the last (ns). `tells` is told when it begins.
    """
    with open(page, "r+b") as stream:
        shared = mmap.mmap(stream.fileno(), 16)
    topics = [f"/topic{i}" for i in range(6)]
    with BagWriter(folder, {"robot": "agriq"}, sync_period=1.0) as bag:
        for topic in topics:
            bag.register(topic, "sensor_msgs/msg/JointState")
        tells.send("ready")
        count, begin = 0, time.monotonic()
        for tick in range(200):
            for topic in topics:
                now = time.time_ns()
                bag.write(topic, data, now, now)
                count += 1
                shared[:] = struct.pack("<QQ", count, now)
            time.sleep(max(0.0, begin + (tick + 1) * 0.01 - time.monotonic()))
    time.sleep(60)
