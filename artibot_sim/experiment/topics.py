"""The topics of an experiment: names, types, keys in `Experiment.channels`, and the quality of service of each."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import yaml

from artibot_sim.errors import ArtibotError

# ----------------------------------------------------------------------
# Quality of service as rosbag2 writes it down (metadata version 9: policies by name).
# ----------------------------------------------------------------------


_FOREVER = {"sec": 9223372036, "nsec": 854775807}
# rosbag2 before version 9 wrote the numbers of rmw's enumerations
_NUMBERS = {
    "history": ("system_default", "keep_last", "keep_all", "unknown"),
    "reliability": ("system_default", "reliable", "best_effort", "unknown", "best_available"),
    "durability": ("system_default", "transient_local", "volatile", "unknown", "best_available"),
}


@dataclass(frozen=True)
class Qos:
    """The policies of a publisher that matter to a recording; times are without limit.

    Attributes
    ----------
    reliability : `reliable` or `best_effort`.
    durability : `volatile` or `transient_local`.
    history, depth : `keep_last` and how many, or `unknown` and 0, as discovery reports them.
    """

    reliability: str = "reliable"
    durability: str = "volatile"
    history: str = "keep_last"
    depth: int = 10

    def as_dict(self) -> dict[str, Any]:
        """Return the mapping of one entry of `offered_qos_profiles`."""
        return {
            "history": self.history,
            "depth": self.depth,
            "reliability": self.reliability,
            "durability": self.durability,
            "deadline": dict(_FOREVER),
            "lifespan": dict(_FOREVER),
            "liveliness": "automatic",
            "liveliness_lease_duration": dict(_FOREVER),
            "avoid_ros_namespace_conventions": False,
        }


SENSOR = Qos(reliability="best_effort", depth=5)
STATE = Qos()
LATCHED = Qos(durability="transient_local", depth=1)


def dump_profiles(profiles: list[dict[str, Any]]) -> str:
    """Write profiles as the YAML text of MCAP's channel metadata."""
    return yaml.safe_dump(profiles, sort_keys=False, default_flow_style=False).strip() if profiles else ""


def load_profiles(text: str) -> list[dict[str, Any]]:
    """Read the YAML text of `offered_qos_profiles`; unreadable text gives an empty list.

    A recording is not refused for its QoS: it matters to playing, not to the data.
    """
    try:
        found = yaml.safe_load(text) if text else []
    except yaml.YAMLError:
        return []
    return [entry for entry in found if isinstance(entry, dict)] if isinstance(found, list) else []


def parse_qos(text: str) -> Qos:
    """Return the first profile of `offered_qos_profiles` (names or numbers), the default if there is none."""
    profiles = load_profiles(text)
    if not profiles:
        return Qos()
    policy = {}
    for key, names in _NUMBERS.items():
        value = profiles[0].get(key)
        if isinstance(value, int) and 0 <= value < len(names):
            value = names[value]
        policy[key] = str(value).lower()
    depth = profiles[0].get("depth", 10)
    reliability = "best_effort" if policy["reliability"] == "best_effort" else "reliable"
    durability = "transient_local" if policy["durability"] == "transient_local" else "volatile"
    return Qos(reliability, durability, policy["history"], depth if isinstance(depth, int) else 10)


# ----------------------------------------------------------------------
# The topics of an experiment: names, types, keys in `Experiment.channels`, and how each is offered.
# ----------------------------------------------------------------------


@dataclass(frozen=True)
class Topic:
    """One row of the contract's table of topics.

    Attributes
    ----------
    name : absolute topic name.
    key : name in `Experiment.channels`.
    ros_type : ROS type that artibot publishes; others that carry the same quantities are read as well.
    latched : offered transient local, so that a late subscriber still gets it.
    measured : says when the rover was observed; these topics set the recording's start and its segments.
    """

    name: str
    key: str
    ros_type: str
    latched: bool = False
    measured: bool = False


_JOINTS = "sensor_msgs/msg/JointState"
_ODOMETRY = "nav_msgs/msg/Odometry"

TOPICS: tuple[Topic, ...] = (
    Topic("/odom", "odom", _ODOMETRY, measured=True),
    Topic("/odom_model", "odom_model", _ODOMETRY),
    Topic("/ground_truth/odom", "ground_truth_odom", _ODOMETRY, measured=True),
    Topic("/joint_states", "joint_states", _JOINTS, measured=True),
    Topic("/motor_torques", "motor_torques", _JOINTS, measured=True),
    Topic("/motor_command", "motor_command", _JOINTS, measured=True),
    Topic("/motor_currents", "motor_currents", _JOINTS),
    Topic("/imu/data", "imu", "sensor_msgs/msg/Imu", measured=True),
    Topic("/total_station/point", "total_station", "geometry_msgs/msg/PointStamped", measured=True),
    Topic("/planned/odom", "planned_odom", _ODOMETRY, measured=True),
    Topic("/planned/path", "planned_path", "nav_msgs/msg/Path", latched=True),
    Topic("/planned/front_velocity", "planned_front_velocity", "trajectory_msgs/msg/JointTrajectory", latched=True),
    Topic("/motor_command_request", "motor_command_request", _JOINTS),
    Topic("/cmd_vel", "cmd_vel", "geometry_msgs/msg/TwistStamped"),
    Topic("/clock", "clock", "rosgraph_msgs/msg/Clock"),
    Topic("/diagnostics", "diagnostics", "diagnostic_msgs/msg/DiagnosticArray"),
)
GLOBAL = ("/clock", "/diagnostics", "/tf", "/tf_static", "/rosout", "/parameter_events")
"""Names that a namespace does not change."""

BY_NAME = {topic.name: topic for topic in TOPICS}
BY_KEY = {topic.key: topic for topic in TOPICS}


def find_topic(wanted: str) -> Topic:
    """Return the contract's topic called `wanted`.

    Parameters
    ----------
    wanted : topic name with or without the leading slash, or a channel key.

    Raises
    ------
    ArtibotError
        If the contract has no such topic.
    """
    for found in (BY_KEY.get(wanted), BY_NAME.get(wanted), BY_NAME.get("/" + wanted)):
        if found is not None:
            return found
    known = ", ".join(BY_NAME)
    raise ArtibotError(f"topic '{wanted}' is not one that artibot reads; expected one of {known}")


def find_namespace(topics: Collection[str], asked: str | None = None) -> str:
    """Return the namespace under which a recording has the contract's topics: `/rover1`, or empty for none.

    Parameters
    ----------
    topics : names in the recording.
    asked : the one to take; found by itself if None: the only one with `/motor_torques`, or else with two of them.

    Raises
    ------
    ArtibotError
        If nothing stands below the one that was asked for, or several might be meant.
    """
    if asked is not None:
        wanted = f"/{asked.strip('/')}".rstrip("/")
        if not any(topic.startswith(f"{wanted}/") for topic in topics):
            spaces = _rovers(topics)[0] or topics
            present = ", ".join(sorted(filter(None, spaces))) or "no topic"
            raise ArtibotError(f"--namespace {asked}: no topic below {wanted}/; the recording has {present}")
        return wanted
    rovers, several = _rovers(topics)
    rovers = rovers or several
    if "" in rovers or not rovers:
        return ""
    if len(rovers) > 1:
        spaces = ", ".join(sorted(rovers))
        raise ArtibotError(f"topics of several rovers ({spaces}); choose one with --namespace {min(rovers)}")
    return rovers[0]


def _rovers(topics: Collection[str]) -> tuple[list[str], list[str]]:
    """Namespaces with `/motor_torques`, and those with two topics of the contract: /lidar/odom alone is no rover."""
    names = sorted((topic.name for topic in TOPICS if topic.name not in GLOBAL), key=len, reverse=True)
    found: dict[str, set[str]] = {}
    for topic in topics:
        name = next((name for name in names if topic.endswith(name)), None)
        if name:  # the longest: /rover1/ground_truth/odom is no /odom of /rover1/ground_truth
            found.setdefault(topic.removesuffix(name), set()).add(name)
    torques = [space for space, below in found.items() if "/motor_torques" in below]
    return torques, [space for space, below in found.items() if len(below) > 1]


def parse_renames(pairs: list[str] | tuple[str, ...]) -> dict[str, str]:
    """Turn `--topic WANTED=FOUND` options into the mapping that `read_bag` takes.

    Raises
    ------
    ArtibotError
        If a pair has no `=`, or WANTED is not a topic of the contract.
    """
    renames = {}
    for pair in pairs:
        wanted, equals, found = pair.partition("=")
        if not equals or not wanted or not found:
            raise ArtibotError(f"--topic '{pair}': expected WANTED=FOUND, e.g. --topic /ground_truth/odom=/lidar/odom")
        renames[find_topic(wanted).name] = found
    return renames
