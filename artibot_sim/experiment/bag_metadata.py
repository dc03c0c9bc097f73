"""rosbag2's metadata.yaml, version 9 (Jazzy)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml


@dataclass
class TopicEntry:
    """One topic as a writer keeps it.

    Attributes
    ----------
    name, ros_type : of the topic.
    qos : offered profiles, as `Qos.as_dict` makes them.
    type_hash : RIHS01.
    number : MCAP channel id.
    count : messages safe in the file.
    sequence : number of the last message taken.
    serialization : message encoding.
    """

    name: str
    ros_type: str
    qos: list[dict[str, Any]]
    type_hash: str
    number: int = 0
    count: int = 0
    sequence: int = 0
    serialization: str = "cdr"


class _Plain(yaml.SafeDumper):
    """Writes every mapping out: anchors and aliases are legal but no pleasure to read."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def write_bag_metadata(
    folder: Path, files: list[str], topics: list[TopicEntry], start_ns: int, duration_ns: int
) -> None:
    """Write `folder/metadata.yaml`, whole or not at all.

    Parameters
    ----------
    folder : the recording.
    files : names of its storage files, in order; the counts are given to the first.
    topics : in order of registration.
    start_ns, duration_ns : of all messages, log time.

    Raises
    ------
    OSError
        If it cannot be written; the one that was there is then untouched.
    """
    count = sum(topic.count for topic in topics)
    span = {
        "starting_time": {"nanoseconds_since_epoch": start_ns},
        "duration": {"nanoseconds": duration_ns},
        "message_count": count,
    }
    content = {
        "version": 9,
        "storage_identifier": "mcap",
        **{key: span[key] for key in ("duration", "starting_time", "message_count")},
        "topics_with_message_count": [_topic(topic) for topic in topics],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": files,
        "files": [{"path": name, **span} for name in files[:1]],
        "custom_data": None,
        "ros_distro": "jazzy",
    }
    text = yaml.dump({"rosbag2_bagfile_information": content}, Dumper=_Plain, sort_keys=False, default_flow_style=False)
    target = folder / "metadata.yaml"
    partial = folder / ".metadata.yaml.partial"
    try:
        partial.write_text(text)
        partial.replace(target)
    except OSError:
        partial.unlink(missing_ok=True)
        raise


def _topic(topic: TopicEntry) -> dict[str, Any]:
    return {
        "topic_metadata": {
            "name": topic.name,
            "type": topic.ros_type,
            "serialization_format": topic.serialization,
            "offered_qos_profiles": topic.qos,
            "type_description_hash": topic.type_hash,
        },
        "message_count": topic.count,
    }
