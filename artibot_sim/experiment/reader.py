"""`read_bag`: a recording as an `Experiment`; `bag_info`: what it holds without reading it."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment.columns import Channel, Experiment, find_segments, measured_stamps
from artibot_sim.experiment.messages import POSES, READABLE, TRANSFORMS, Decoder, TopicRows, decoder, serves_as
from artibot_sim.experiment.storage import (
    BagInfo,
    ChannelInfo,
    RawMessage,
    channel_info,
    check_file,
    clear_errors,
    iter_messages,
    open_sqlite,
    sqlite_channels,
    storage_files,
)
from artibot_sim.experiment.topics import TOPICS, find_namespace, find_topic
from artibot_sim.experiment.wheels import Joints, pose_of_transforms, with_wheels
from artibot_sim.progress import Report

METADATA_RECORD = "artibot"
_REPORT_EVERY = 500
"""Messages between two reports of the progress."""
_PIECES = 10
"""Pieces of a recording that is too long to be read whole."""


def read_bag(
    path: Path | str,
    topics: Mapping[str, str] | None = None,
    *,
    namespace: str | None = None,
    joints: Joints | None = None,
    most: int | None = None,
    progress: Report | None = None,
) -> Experiment:
    """Read a recording of the contract's topics.

    Parameters
    ----------
    path : rosbag2 folder, or a bare .mcap (or .db3) file.
    topics : contract topic (or channel key) → topic in the recording that carries it, for recordings
        that use other names.
    namespace : of the rover, below which its topics stand (`/rover1`); where the recording has those of one
        rover only it is found.
    joints : motor, or joint of the articulation → joints in the recording whose mean it is; without, wheels of a
        rigid robot are found by their names (``rear_left_wheel_joint``), in `/joint_states` too.
    most : about how many messages are read at most: of a recording that holds more, pieces from its beginning to its
        end, segments of their own; a remark says so.
    progress : is called now and then with the share of the work that is done; a file without an index is read twice.

    Returns
    -------
    Experiment
        SI units; times are header stamps. Rows are sorted by stamp, rows of equal stamp merged; `remarks`
        says what was repaired.

    Raises
    ------
    ArtibotError
        If the recording is damaged, empty, foreign, has none of the topics, or a renamed topic is not in it.
        The message names the file, what was found and the mend.
    """
    advance, twice = progress or (lambda _: None), False

    def first_half(share: float) -> None:
        nonlocal twice
        twice = True
        advance(0.5 * share)

    info = bag_info(path, progress=first_half)
    found = {channel.topic: channel.ros_type for channel in info.channels if channel.encoding == "cdr"}
    if info.message_count and not found:
        encodings = ", ".join(sorted({channel.encoding or "none" for channel in info.channels}))
        raise ArtibotError(f"{path}: no topic is encoded as cdr (found: {encodings}); expected a ROS 2 recording")
    wanted, remarks = _choose(info, found, topics or {}, namespace)
    pieces = _pieces(info, wanted, most, remarks)
    rows = _read_rows(info, wanted, pieces, (lambda share: advance(0.5 + 0.5 * share)) if twice else advance)
    _refuse_empty(info, topics or {}, rows)
    channels = {key: table.channel(remarks) for key, table in rows.items() if table.stamps}
    if (currents := channels.get("motor_currents")) is not None:
        channels["motor_currents"] = replace(currents, units=dict.fromkeys(currents.columns, "A"))
    try:
        channels = with_wheels(_with_pose(channels, found, remarks, asked=bool(topics)), joints or {}, remarks)
    except ArtibotError as error:
        raise ArtibotError(f"{path}: {error}") from error
    if not channels and not info.message_count:
        raise ArtibotError(
            f"{path}: no message was recorded; start what publishes, in the same ROS_DOMAIN_ID as the recorder, and "
            "record again"
        )
    if not channels:
        present = ", ".join(sorted(found))
        raise ArtibotError(
            f"{path}: no message on any topic that artibot reads; the recording has {present} "
            f"({info.message_count} messages); rename a topic with --topic WANTED=FOUND"
        )
    stamps = measured_stamps(channels)
    start = int(stamps[0])
    segments = find_segments(stamps, start)
    return Experiment(
        name=info.name,
        path=info.path,
        metadata=info.metadata,
        start_ns=start,
        channels={key: _finish(channel, start, segments) for key, channel in channels.items()},
        segments=segments,
        topics=found,
        remarks=tuple(remarks),
    )


def _choose(
    info: BagInfo, found: Mapping[str, str], renames: Mapping[str, str], namespace: str | None
) -> tuple[dict[str, str], list[str]]:
    """Return topic in the recording → channel key, and remarks on topics of a type that artibot cannot read."""
    asked = {find_topic(wanted).key: name for wanted, name in renames.items()}
    try:
        space = find_namespace(found, namespace)
    except ArtibotError as error:
        if namespace is not None or not asked:
            raise ArtibotError(f"{info.path}: {error}") from error
        space = ""  # every topic may have been named
    wanted: dict[str, str] = {}
    remarks = [f"topics are those below {space}/"] if space else []
    for topic in TOPICS:
        name = asked.get(topic.key, topic.name)
        plain = "/" + name.lstrip("/")
        # what was named by hand is meant as it stands; a device that serves all rovers stands below none
        places = (name, plain, space + plain) if topic.key in asked else (space + plain, plain)
        name = next((place for place in places if place in found), plain)
        if name not in found:
            if topic.key in asked:
                present = ", ".join(sorted(found)) or "no topic"
                raise ArtibotError(f"{info.path}: --topic {topic.name}={name}: no topic '{name}'; it has {present}")
            continue
        if serves_as(found[name], topic.ros_type) or (found[name] == TRANSFORMS and topic.key == "ground_truth_odom"):
            wanted[name] = topic.key
            continue
        said = f"{name} is of type {found[name]}; artibot reads {topic.name} as {topic.ros_type}"
        if topic.key in asked:
            raise ArtibotError(f"{info.path}: --topic {topic.name}={name}: {said}")
        remarks.append(f"{said}; left out")
    return _posed(wanted, found, remarks), remarks


def _posed(wanted: dict[str, str], found: Mapping[str, str], remarks: list[str]) -> dict[str, str]:
    """Topic → channel key, with the best there is for a pose: its heading, and transforms where nothing else tells."""
    keys = {key: name for name, key in wanted.items()}
    point = keys.get("total_station")
    if point and found[point] in POSES:
        if "ground_truth_odom" in keys:
            remarks.append(f"{point}: its headings are not used; {keys['ground_truth_odom']} tells them")
        else:
            remarks.append(f"{point} is of type {found[point]}, which has a heading: taken as /ground_truth/odom")
            return {**wanted, point: "ground_truth_odom"}
    if not {"total_station", "ground_truth_odom"} & set(keys) and found.get("/tf") == TRANSFORMS:
        return {**wanted, "/tf": "ground_truth_odom"}
    return wanted


def _refuse_empty(info: BagInfo, renames: Mapping[str, str], rows: Mapping[str, TopicRows]) -> None:
    """Raise where a topic that was named by hand has no message: asking for its name again would lead nowhere."""
    for wanted in renames:
        table = rows.get(find_topic(wanted).key)
        if table is not None and not table.stamps:
            raise ArtibotError(
                f"{info.path}: --topic {find_topic(wanted).name}={table.topic}: there is no message on {table.topic}"
            )


def _with_pose(
    channels: dict[str, Channel], found: Mapping[str, str], remarks: list[str], asked: bool
) -> dict[str, Channel]:
    """Channels with the pose that transforms tell; without it where they tell none and nobody asked for it."""
    channel = channels.get("ground_truth_odom")
    if channel is None or found.get(channel.topic) != TRANSFORMS:
        return channels
    try:
        pose = pose_of_transforms(channel)
    except ArtibotError as error:
        if asked:
            raise
        remarks.append(f"{error}; left out")
        return {key: each for key, each in channels.items() if key != "ground_truth_odom"}
    remarks.append(f"no pose is recorded but that of transforms: {channel.topic} is taken as /ground_truth/odom")
    return {**channels, "ground_truth_odom": pose}


def _pieces(
    info: BagInfo, wanted: Mapping[str, str], most: int | None, remarks: list[str]
) -> list[tuple[int | None, int | None]]:
    """Log times (ns) from and to which a recording is read: all of it, or pieces of it if it has too many messages."""
    share = 1.0 if most is None else most / max(_count(info, wanted), 1)
    if share >= 1.0:
        return [(None, None)]
    whole = info.end_ns - info.start_ns
    length, step = int(share * whole / _PIECES), (1.0 - share / _PIECES) * whole / (_PIECES - 1)
    begins = [info.start_ns + int(number * step) for number in range(_PIECES)]
    remarks.append(
        f"{_PIECES} pieces of {1e-9 * length:.0f} s were read, evenly from all of its {1e-9 * whole / 60.0:.0f} min"
    )
    return [(begin, begin + length) for begin in begins]


def _count(info: BagInfo, wanted: Mapping[str, str]) -> int:
    return sum(channel.message_count for channel in info.channels if channel.topic in wanted)


def _read_rows(
    info: BagInfo, wanted: Mapping[str, str], pieces: Sequence[tuple[int | None, int | None]], progress: Report
) -> dict[str, TopicRows]:
    """Decode the messages of the wanted topics in some pieces into rows, by channel key."""
    rows = {key: TopicRows(name) for name, key in wanted.items()}
    decoders: dict[ChannelInfo, Decoder] = {}
    latest: dict[str, bytes] = {}
    first, last = pieces[0][0], pieces[0][1]
    share = 1.0 if first is None or last is None else len(pieces) * (last - first) / (info.end_ns - info.start_ns)
    total = share * _count(info, wanted)
    messages = (message for begin, end in pieces for message in iter_messages(info.path, set(wanted), begin, end))
    for number, message in enumerate(messages):
        if number % _REPORT_EVERY == 0:
            progress(min(1.0, number / max(total, 1.0)))
        channel = message.channel
        if channel.encoding != "cdr" or channel.ros_type not in READABLE | {TRANSFORMS}:
            continue
        table = rows[wanted[channel.topic]]
        if not table.ordered and latest.get(channel.topic) == message.data:
            continue  # a latched plan that was only published again
        latest[channel.topic] = message.data
        table.add(channel.ros_type, _decode(info, decoders, message), message.log_ns)
    return rows


def _decode(info: BagInfo, decoders: dict[ChannelInfo, Decoder], message: RawMessage) -> Any:
    channel = message.channel
    if channel not in decoders:
        decoders[channel] = decoder(
            channel.ros_type, channel.definition, channel.definition_encoding, channel.type_hash
        )
    try:
        return decoders[channel](message.data)
    except _undecodable() as error:
        raise ArtibotError(
            f"{info.path}: topic {channel.topic}: the message logged at {message.log_ns} ns is not a "
            f"{channel.ros_type}: {error}; the program that recorded it used another definition"
        ) from error


def _undecodable() -> tuple[type[Exception], ...]:
    """What is raised on bytes that are not such a message; asked only then, for the import takes time.

    Older rosbags let the bare errors through.
    """
    from rosbags.serde import SerdeError

    return SerdeError, struct.error, ValueError, LookupError


def _finish(channel: Channel, start_ns: int, segments: tuple[tuple[float, float], ...]) -> Channel:
    """Count a channel's seconds from `start_ns` and unwrap its yaw within each segment.

    Not across segments: the pose after a gap has no relation to the one before.
    """
    t = (channel.t_ns - start_ns) / 1e9
    columns = dict(channel.columns)
    if "yaw" in columns:
        yaw = columns["yaw"].copy()
        part = np.searchsorted([first for first, _ in segments], t, side="right")
        for number in np.unique(part):
            rows = np.flatnonzero((part == number) & np.isfinite(yaw))
            yaw[rows] = np.unwrap(yaw[rows])
        columns["yaw"] = yaw
    return replace(channel, t=t, columns=columns)


def bag_info(path: Path | str, *, progress: Report | None = None) -> BagInfo:
    """Return what a recording holds: files, topics with types, definitions and QoS, times, metadata.

    Parameters
    ----------
    path : rosbag2 folder or bare file.
    progress : is called now and then with how much of a file without an index is counted; nothing where all have one.

    Raises
    ------
    ArtibotError
        If it is damaged, empty or foreign.
    """
    files = storage_files(path)
    parts = []
    for file in files:
        kind = check_file(file)
        with clear_errors(file):
            parts.append(_mcap_info(file, progress) if kind == "mcap" else _sqlite_info(file))
    counts: dict[ChannelInfo, int] = {}
    metadata: dict[str, str] = {}
    for part in parts:
        for channel in part.channels:
            plain = replace(channel, message_count=0)
            counts[plain] = counts.get(plain, 0) + channel.message_count
        metadata |= part.metadata
    spans = [(part.start_ns, part.end_ns) for part in parts if part.message_count] or [(0, 0)]
    return BagInfo(
        path=Path(path),
        files=files,
        channels=tuple(replace(channel, message_count=count) for channel, count in counts.items()),
        metadata=metadata,
        start_ns=min(start for start, _ in spans),
        end_ns=max(end for _, end in spans),
        message_count=sum(part.message_count for part in parts),
    )


def _mcap_info(file: Path, progress: Report | None = None) -> BagInfo:
    from mcap.reader import make_reader

    with open(file, "rb") as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        records = [record for record in reader.iter_metadata() if record.name == METADATA_RECORD]
    metadata = {key: value for record in records for key, value in record.metadata.items()}
    if summary is None or summary.statistics is None:
        return _counted_info(file, metadata, progress or (lambda _: None))
    statistics = summary.statistics
    channels = tuple(
        channel_info(summary.schemas.get(channel.schema_id), channel, statistics.channel_message_counts.get(number, 0))
        for number, channel in summary.channels.items()
    )
    return BagInfo(
        file, (file,), channels, metadata,
        statistics.message_start_time, statistics.message_end_time, statistics.message_count,
    )  # fmt: skip


def _counted_info(file: Path, metadata: dict[str, str], progress: Report) -> BagInfo:
    """Make the index of an MCAP file that was written without one."""
    counts: dict[ChannelInfo, int] = {}
    first, last = 2**63, 0
    size, done = file.stat().st_size, 0
    for number, message in enumerate(iter_messages(file)):
        done += len(message.data)
        if number % _REPORT_EVERY == 0:
            progress(min(1.0, done / size))  # of a compressed file too much, which only a bar minds
        counts[message.channel] = counts.get(message.channel, 0) + 1
        first, last = min(first, message.log_ns), max(last, message.log_ns)
    channels = tuple(replace(channel, message_count=count) for channel, count in counts.items())
    return BagInfo(file, (file,), channels, metadata, first if counts else 0, last, sum(counts.values()))


def _sqlite_info(file: Path) -> BagInfo:
    with closing(open_sqlite(file)) as base:
        channels = tuple(sqlite_channels(base).values())
        first, last, count = base.execute("SELECT min(timestamp), max(timestamp), count(*) FROM messages").fetchone()
    return BagInfo(file, (file,), channels, {}, first or 0, last or 0, count)
