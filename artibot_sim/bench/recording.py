"""How much the recorder's writer takes, and that all of it is there afterwards."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

from artibot_sim.bench.results import Result
from artibot_sim.bench.scenario import Scenario
from artibot_sim.bench.timing import repeat
from artibot_sim.errors import ArtibotError

TOPIC, ROS_TYPE = "/joint_states", "sensor_msgs/msg/JointState"


def writer(scenario: Scenario) -> list[Result]:
    """Messages of /joint_states' size that BagWriter takes per second, as it works while recording; none is lost."""
    from artibot_sim.experiment import BagWriter, bag_info

    count, data = (2_000 if scenario.quick else 20_000), bytes(range(256)) * 2
    with tempfile.TemporaryDirectory(prefix="artibot-bench-") as folder:
        number = iter(range(1_000_000))

        def record() -> None:
            with BagWriter(Path(folder) / f"run{next(number)}", live=True) as bag:
                bag.register(TOPIC, ROS_TYPE)
                for _ in range(count):
                    now = time.time_ns()
                    bag.write(TOPIC, data, publish_ns=now, log_ns=now)

        timing = repeat(record, scenario.runs(5), scenario.tick)
        bags = sorted(Path(folder).iterdir())
        lost = count * len(bags) - sum(bag_info(bag).message_count for bag in bags)
    if lost:
        raise ArtibotError(f"bench: the writer lost {lost} of {count * len(bags)} messages")
    note = f"BagWriter, {len(data)} bytes each, chunks each 0.5 s, until the bag is closed; none of {count} lost"
    detail = timing.per_second(count) | {"lost": 0.0}
    return [Result("recorder_writer", count / timing.best, "messages/s", note, detail)]
