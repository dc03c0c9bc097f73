"""Which topics of a recording are published again, and under which names: what moves a rover stays out."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment.messages import CAN_FRAME
from artibot_sim.experiment.storage import BagInfo, ChannelInfo
from artibot_sim.experiment.topics import GLOBAL
from artibot_sim.nodes.common.arbiter import SIGN_OF_LIFE

REQUEST = "motor_command_request"
COMMAND = "motor_command"
PROFILE = "planned/front_velocity"
INPUTS = (PROFILE, REQUEST, "cmd_vel")
"""What moves a rover, under any namespace (contract)."""
_MOVING_TYPES = ("trajectory_msgs/msg/JointTrajectory", CAN_FRAME, "ackermann_msgs/")
_SPEED_TYPES = ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped", "std_msgs/msg/Float64")
_OWN = ("/clock", "/rosout", "/parameter_events")
"""Published by the replay itself, or by every node."""


def called(topic: str, name: str) -> bool:
    """Say whether `topic` is `name` in any namespace."""
    return topic.strip("/") == name or topic.endswith(f"/{name}")


def sibling(topic: str, name: str, other: str) -> str:
    """Return what is called `other` in the namespace in which `topic` is called `name`; `other` where it is not."""
    return topic.removesuffix(name) + other if called(topic, name) else other


def moves_a_rover(topic: str, ros_type: str) -> bool:
    """Say whether messages on `topic` may set a rover, ours or another, in motion."""
    if any(called(topic, name) for name in INPUTS) or ros_type.startswith(_MOVING_TYPES):
        return True
    words = topic.rpartition("/")[2].replace("-", "_").split("_")
    return ros_type.startswith(_SPEED_TYPES) and bool({"cmd", "command", "request", "setpoint"} & set(words))


@dataclass(frozen=True)
class ReplaySelection:
    """What to publish.

    Attributes
    ----------
    names : topic as recorded → name to publish it under.
    left_out : inputs of a rover that were recorded and are not published.
    unread : topics that are no CDR messages, with their encodings.
    """

    names: dict[str, str]
    left_out: tuple[str, ...] = ()
    unread: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Wish:
    """What the command line says about topics.

    Attributes
    ----------
    topics, exclude : patterns with `*` and `?`; no topics: all.
    remap : `FROM:=TO` texts.
    drive : whether inputs of a rover may be published.
    request_from : recorded topic to publish as `motor_command_request`, or None.
    """

    topics: Sequence[str] = ()
    exclude: Sequence[str] = ()
    remap: Sequence[str] = ()
    drive: bool = False
    request_from: str | None = None


def without_frames(info: BagInfo, wish: Wish, played: Collection[str]) -> tuple[BagInfo, tuple[str, ...]]:
    """Take the topics with CAN frames out of a recording's: they are played on a bus, or not at all.

    Parameters
    ----------
    info : of the recording.
    wish : what was asked for; a topic that it names stays, to be published if `drive` allows it.
    played : topics that are played on a bus.

    Returns
    -------
    BagInfo, tuple of str
        The rest, and the topics that nobody plays.
    """
    frames = {c.topic for c in info.channels if c.ros_type == CAN_FRAME and not _matches(c.topic, wish.topics)}
    out = frames | set(played)
    rest = tuple(channel for channel in info.channels if channel.topic not in out)
    return replace(info, channels=rest), tuple(sorted(frames - set(played)))


def select(info: BagInfo, wish: Wish, resolve: Callable[[str], str]) -> ReplaySelection:
    """Choose topics.

    Parameters
    ----------
    info : of the recording.
    wish : what was asked for.
    resolve : name to publish under → absolute name on the graph, ROS remapping included.

    Returns
    -------
    ReplaySelection
        Without `drive` nothing that moves a rover, neither by its recorded name or type nor by the name that
        remapping gives it. With `drive` the recorded inputs, save requests unless asked for by name, and of the rest
        only what is asked for by name.

    Raises
    ------
    ArtibotError
        If a pattern matches nothing, an input is asked for without `drive`, or nothing is left.
    """
    channels = {channel.topic: channel for channel in info.channels}
    _check_patterns(info, wish, channels)
    renames = _renames(info, wish.remap, channels)
    names: dict[str, str] = {}
    left_out: list[str] = []
    unread: dict[str, str] = {}
    for topic, channel in sorted(channels.items()):
        asked = _matches(topic, wish.topics)
        if _matches(topic, wish.exclude) or not _considered(topic, channel, asked, wish):
            continue
        if channel.encoding != "cdr":
            unread[topic] = channel.encoding or "none"
            continue
        name = renames.get(topic, topic if topic in GLOBAL else topic.lstrip("/"))
        target = resolve(name)
        if called(target, REQUEST) and not called(topic, REQUEST):
            raise ArtibotError(
                f"{topic} would be published as {target}: ask for it with --drive --request-from {topic}"
            )
        if not wish.drive and (moves_a_rover(topic, channel.ros_type) or moves_a_rover(target, channel.ros_type)):
            if topic in wish.topics or topic.lstrip("/") in wish.topics or topic in renames:
                raise ArtibotError(f"{topic} moves a rover ({target}); it is published only with --drive")
            left_out.append(topic)
            continue
        names[topic] = name
    if wish.request_from is not None:
        _find(info, channels, wish.request_from, "--request-from")
    return ReplaySelection(names, tuple(left_out), unread)


def _considered(topic: str, channel: ChannelInfo, asked: bool, wish: Wish) -> bool:
    """Say whether the options select a topic, safety apart."""
    if topic in _OWN or (not asked and any(part.startswith("_") for part in topic.split("/"))):
        return asked and topic != "/clock"
    if wish.drive and called(topic, SIGN_OF_LIFE):
        return False  # the drive keeps its own going
    if wish.drive and not asked:
        if called(topic, REQUEST):
            return False
        return moves_a_rover(topic, channel.ros_type) or called(topic, "planned/path")
    return asked or not wish.topics


def _matches(topic: str, patterns: Iterable[str]) -> bool:
    return any(fnmatchcase(topic, pattern) or fnmatchcase(topic, f"/{pattern}") for pattern in patterns)


def _check_patterns(info: BagInfo, wish: Wish, channels: dict[str, ChannelInfo]) -> None:
    for pattern in wish.topics:
        if not any(_matches(topic, (pattern,)) for topic in channels):
            raise ArtibotError(f"{info.path}: no topic is called '{pattern}'; it has {', '.join(sorted(channels))}")


def _renames(info: BagInfo, texts: Sequence[str], channels: dict[str, ChannelInfo]) -> dict[str, str]:
    renames = {}
    for text in texts:
        found, sign, wanted = text.partition(":=")
        if not sign or not found or not wanted:
            raise ArtibotError(f"--remap '{text}': expected FROM:=TO, e.g. --remap /odom:=/recorded/odom")
        renames[_find(info, channels, found, f"--remap {text}")] = wanted
    return renames


def _find(info: BagInfo, channels: dict[str, ChannelInfo], name: str, option: str) -> str:
    for topic in (name, f"/{name}"):
        if topic in channels:
            return topic
    raise ArtibotError(f"{option}: {info.path} has no topic '{name}'; it has {', '.join(sorted(channels))}")
