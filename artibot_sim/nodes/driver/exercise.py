"""A driver kept busy: ``python -m artibot_sim.nodes.driver.exercise CHANNEL SECONDS``, for benchmarks.

Enables the drives, drives to and fro by live requests, and calls every service of the node meanwhile, over and over:
its own, the lifecycle's, the parameters'. On the bus it listens to SYNC. Prints as JSON what it saw.
"""

from __future__ import annotations

import itertools
import json
import math
import sys
import threading
import time
from collections.abc import Iterator
from typing import Any

import numpy as np

from artibot_driver.bus import open_bus
from artibot_driver.config import ALL_SPECS
from artibot_driver.listener import interface_of
from artibot_driver.priority import take_priority
from artibot_sim.errors import ArtibotError
from artibot_sim.model import MOTORS
from artibot_sim.nodes.common.process import destroyed, ros_process

SYNC_ID = 0x080
REQUESTS = 50.0
"""Live requests a second."""

PATIENCE = 60.0
"""The driver is waited for so long, s."""


class SyncListener:
    """Receives SYNC on a bus, in a thread of its own.

    Attributes
    ----------
    stamps : list of float
        When each came, s: the kernel's stamps on SocketCAN, else when it was read.
    """

    def __init__(self, channel: str) -> None:
        interface = interface_of(channel)
        self._bus, self._own_stamps = open_bus(interface, channel), interface == "socketcan"
        self._bus.raw.set_filters([{"can_id": SYNC_ID, "can_mask": 0x7FF, "extended": False}])
        self.stamps: list[float] = []
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="sync")
        self._thread.start()

    def _run(self) -> None:
        take_priority(40)
        while not self._ended.is_set():
            message = self._bus.receive(0.05)
            if message is not None and message.arbitration_id == SYNC_ID:  # not every interface filters
                self.stamps.append(message.timestamp if self._own_stamps else time.monotonic())

    def end(self) -> None:
        """Receive no more."""
        self._ended.set()
        self._thread.join()
        self._bus.close()


def services(node: Any) -> Iterator[tuple[Any, Any]]:
    """Clients of the driver's services, each with a request, for ever in turns."""
    from lifecycle_msgs.srv import GetAvailableStates, GetState
    from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
    from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
    from std_srvs.srv import Trigger

    def kappa(value: float) -> Any:
        parameter = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=value)
        return SetParameters.Request(parameters=[Parameter(name="kappa", value=parameter)])

    names = list(ALL_SPECS)
    calls = [
        (Trigger, "enable", Trigger.Request()),
        (SetParameters, "set_parameters", kappa(0.7)),
        (GetState, "get_state", GetState.Request()),
        (DescribeParameters, "describe_parameters", DescribeParameters.Request(names=names)),
        (Trigger, "reset_fault", Trigger.Request()),
        (GetParameters, "get_parameters", GetParameters.Request(names=names)),
        (GetAvailableStates, "get_available_states", GetAvailableStates.Request()),
        (Trigger, "quick_stop", Trigger.Request()),
        (Trigger, "enable", Trigger.Request()),
        (Trigger, "disable", Trigger.Request()),
        (ListParameters, "list_parameters", ListParameters.Request()),
        (SetParameters, "set_parameters", kappa(0.9)),
    ]
    clients: dict[str, Any] = {}
    for kind, name, _ in calls:
        clients[name] = clients.get(name) or node.create_client(kind, f"driver/{name}")
    return itertools.cycle([(clients[name], request) for _, name, request in calls])


def exercise(node: Any, channel: str, seconds: float) -> dict[str, Any]:
    """Keep the driver busy for so long; what was seen."""
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.qos import qos_profile_sensor_data
    from sensor_msgs.msg import JointState

    executor = SingleThreadedExecutor()
    executor.add_node(node)
    publisher = node.create_publisher(JointState, "motor_command_request", qos_profile_sensor_data)
    turns, answered, under_way = services(node), 0, None
    client, request = next(turns)
    print("waiting for the driver", flush=True)
    if not client.wait_for_service(PATIENCE):
        raise ArtibotError(f"exercise: no driver within {PATIENCE:g} s")
    listener, begin = SyncListener(channel), time.monotonic()
    try:
        while (now := time.monotonic()) < begin + seconds:
            speed = 60.0 * math.sin(now - begin)
            publisher.publish(JointState(name=list(MOTORS[:2]), velocity=[speed, 0.8 * speed]))
            if under_way is None or under_way.done():
                answered += under_way is not None
                under_way = client.call_async(request)
                client, request = next(turns)
            executor.spin_once(timeout_sec=1.0 / REQUESTS)
    finally:
        listener.end()
    return {"calls": answered, **jitter(np.array(listener.stamps))}


def jitter(stamps: np.ndarray) -> dict[str, float]:
    """How far the intervals between SYNC frames were from the usual one, ms."""
    if len(stamps) < 2:
        return {"syncs": float(len(stamps))}
    gaps = 1e3 * np.diff(stamps)
    off = np.abs(gaps - np.median(gaps))
    return {
        "syncs": float(len(stamps)),
        "sync_period_ms": float(np.median(gaps)),
        "sync_jitter_p99_ms": float(np.percentile(off, 99)),
        "sync_jitter_max_ms": float(off.max()),
    }


def main() -> int:
    """Run, and print what was seen."""
    import rclpy

    with ros_process("exercise", ()), destroyed(rclpy.create_node("exercise")) as node:
        print(json.dumps(exercise(node, sys.argv[1], float(sys.argv[2]))))
    return 0


if __name__ == "__main__":
    sys.exit(main())
