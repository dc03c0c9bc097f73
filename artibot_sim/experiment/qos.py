"""Quality of service as rosbag2 writes it down (metadata version 9: policies by name)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import yaml

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
