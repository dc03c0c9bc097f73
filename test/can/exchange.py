"""Runs beside ``candump`` and ``cansend`` on a kernel with CAN; prints what was seen as JSON. See test_vcan.py."""

from __future__ import annotations

import json
import subprocess
import sys
import time

import can


def main(channel: str, count: int) -> None:
    """Send `count` frames from python-can to candump, one from cansend to python-can, and print both."""
    with can.Bus(channel, interface="socketcan") as bus:
        dump = subprocess.Popen(["candump", "-L", "-n", str(count), channel], stdout=subprocess.PIPE, text=True)
        _wait_until_listening(channel)
        for k in range(count):
            bus.send(can.Message(arbitration_id=0x180 + k, data=bytes([k] * (k % 9)), is_extended_id=False))
        dumped, _ = dump.communicate(timeout=20)

        subprocess.run(["cansend", channel, "1F334455#1122334455667788"], check=True)
        message = bus.recv(timeout=20)
    received = None if message is None else [message.arbitration_id, message.is_extended_id, message.data.hex()]
    print(json.dumps({"dumped": [line.split()[2] for line in dumped.splitlines()], "received": received}))


def _wait_until_listening(channel: str) -> None:
    """Wait until a second socket receives on `channel`: python-can's is the first."""
    deadline = time.monotonic() + 10
    while time.monotonic() < deadline:
        with open("/proc/net/can/rcvlist_all", encoding="ascii") as listing:
            if sum(line.split()[:1] == [channel] for line in listing) >= 2:
                return
        time.sleep(0.01)
    raise TimeoutError(f"candump did not begin to listen on {channel}")


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
