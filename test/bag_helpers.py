"""What tests of recordings share: messages, small bags, and the recordings made elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from artibot_sim.experiment import BagWriter, iter_messages, serialize
from artibot_sim.experiment.messages import header, message_class, pose, vector
from artibot_sim.experiment.topics import LATCHED

ROOT = Path(__file__).resolve().parents[1]
FOREIGN = ROOT.parent / "shared" / "data"
"""Recordings made by other programs; not part of the project."""

JOINTS = "sensor_msgs/msg/JointState"
ODOMETRY = "nav_msgs/msg/Odometry"
EPOCH = 1_700_000_000_000_000_000
STEP = 10_000_000
EMPTY: tuple[float, ...] = ()
Message = tuple[str, int, int, bytes]
"""Topic, log time (ns), sequence number and content."""


def messages(path: Path) -> list[Message]:
    """All messages of a bag."""
    return [(m.channel.topic, m.log_ns, m.sequence, m.data) for m in iter_messages(path)]


def foreign(name: str) -> Path:
    """A recording made elsewhere; the test is skipped, saying so, where it is not there."""
    path = FOREIGN / name
    if not path.exists():
        pytest.skip(f"../shared/data/{name} is not there: recordings made elsewhere are no part of the project")
    return path


def foreign_recordings() -> list[str]:
    """Names of all of them (a single one that does not exist where there are none)."""
    found = sorted(str(file.parent.relative_to(FOREIGN)) for file in FOREIGN.rglob("metadata.yaml"))
    return found or ["husky_a"]


def joint_state(
    stamp_ns: int,
    names: Sequence[str],
    position: Sequence[float] = EMPTY,
    velocity: Sequence[float] = EMPTY,
    effort: Sequence[float] = EMPTY,
) -> bytes:
    """A JointState as CDR."""
    arrays = {"position": position, "velocity": velocity, "effort": effort}
    return serialize(
        JOINTS,
        header=header(stamp_ns),
        name=list(names),
        **{key: np.array(values, float) for key, values in arrays.items()},
    )


def odometry(stamp_ns: int, x: float = 0.0, y: float = 0.0, yaw: float = 0.0, speed: float = 0.0) -> bytes:
    """An Odometry as CDR."""
    twist = message_class("geometry_msgs/msg/Twist")
    return serialize(
        ODOMETRY,
        header=header(stamp_ns, "map"),
        child_frame_id="base_link",
        pose=message_class("geometry_msgs/msg/PoseWithCovariance")(
            pose=pose(x, y, 0.0, 0.0, 0.0, yaw), covariance=np.zeros(36)
        ),
        twist=message_class("geometry_msgs/msg/TwistWithCovariance")(
            twist=twist(linear=vector(speed, 0.0, 0.0), angular=vector(0.0, 0.0, 0.0)), covariance=np.zeros(36)
        ),
    )


def write_bag(
    folder: Path,
    messages: Sequence[tuple[str, str, bytes, int]],
    metadata: dict[str, str] | None = None,
    **options: object,
) -> Path:
    """A bag of (topic, type, CDR, log time in ns)."""
    with BagWriter(folder, metadata, **{"live": False, **options}) as bag:
        for topic, ros_type, data, stamp in messages:
            bag.register(topic, ros_type)
            bag.write(topic, data, stamp, stamp)
    return folder


def small_bag(folder: Path, count: int = 400, **options: object) -> Path:
    """A bag with `count` messages of two topics, alternating, 10 ms apart."""
    messages = []
    for i in range(count):
        stamp = EPOCH + i * STEP
        if i % 2:
            messages.append(("/motor_torques", JOINTS, joint_state(stamp, ["front_right"], velocity=[float(i)]), stamp))
        else:
            messages.append(("/ground_truth/odom", ODOMETRY, odometry(stamp, x=0.01 * i), stamp))
    return write_bag(folder, messages, **options)


def mcap_file(folder: Path) -> Path:
    """The one MCAP file of a bag."""
    (file,) = folder.glob("*.mcap")
    return file


def in_namespaces(folder: Path, plain: Path, *spaces: str) -> Path:
    """The recording `plain` as one of rovers below these namespaces, all of which drove alike."""
    with BagWriter(folder, {"robot": "agriq"}, live=False) as bag:
        for channel in {m.channel.topic: m.channel for m in iter_messages(plain)}.values():
            latched = channel.topic.startswith("/planned/") and channel.topic != "/planned/odom"
            for space in spaces:
                bag.register(space + channel.topic, channel.ros_type, LATCHED if latched else None)
        for message in iter_messages(plain):
            for space in spaces:
                bag.write(space + message.channel.topic, message.data, message.publish_ns, message.log_ns)
    return folder
