"""`inspect`: what a recording holds, what it is good for, and what to type where something is missing."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment.columns import SEGMENT_GAP, Channel, Experiment, silences
from artibot_sim.experiment.inputs import MOTOR_GAP, is_stretch, unbroken
from artibot_sim.experiment.messages import MANY_ROWS, READABLE
from artibot_sim.experiment.naming import names_of
from artibot_sim.experiment.reader import bag_info, read_bag
from artibot_sim.experiment.storage import BagInfo
from artibot_sim.experiment.topics import BY_KEY, TOPICS, find_namespace, parse_renames
from artibot_sim.experiment.wheels import Joints, parse_joints
from artibot_sim.model import MOTORS, load_robot
from artibot_sim.progress import Report
from artibot_sim.resources import config_names

_FEW = 20
"""Samples from which on a share of held values means anything."""
_STANDSTILL = 3.0
"""s without a change after which a value stands still, and is not held by a recorder that is faster than a sensor."""
_RATES = ("velocity", "effort", "_rate", "vx", "vy")
"""Ends of the names of what is zero at a standstill."""
_POSITIONS = 4
"""Positions without which a prediction says nothing."""
_WHOLE = 0.9
"""Share of a recording that has to be of use, or how much is so is said."""
_POSES = ("nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped")
_STAND_INS: dict[str, tuple[str, ...]] = {
    "ground_truth_odom": _POSES,
    "total_station": ("geometry_msgs/msg/PointStamped",),
    "motor_torques": ("sensor_msgs/msg/JointState",),
    "motor_command": ("sensor_msgs/msg/JointState",),
    "imu": ("sensor_msgs/msg/Imu",),
    "cmd_vel": ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"),
}
"""Channel that a recording may have under another name → the types that can be read as it."""
_BELIEFS = ("/odom", "/odometry/filtered", "/planned/odom")
"""Ends of names of what mostly is a robot's own belief, no measurement of where it was; a lidar's may end so."""


@dataclass(frozen=True)
class TopicView:
    """One topic of a recording.

    Attributes
    ----------
    topic, ros_type : names.
    messages : how many.
    read_as : topic of the contract that it is read as; empty if it is not read.
    rate : Hz, one over the median time between samples; NaN where there are too few.
    distinct : Hz, samples that do not repeat the one before; NaN where it is not known.
    gaps : start and length (s) of silences longer than 0.5 s within segments.
    columns : quantities that hold a finite value.
    """

    topic: str
    ros_type: str
    messages: int
    read_as: str = ""
    rate: float = float("nan")
    distinct: float = float("nan")
    gaps: tuple[tuple[float, float], ...] = ()
    columns: tuple[str, ...] = ()

    @property
    def held(self) -> float:
        """Share of the samples that repeat the one before, 0 where it is not known."""
        share = 1.0 - self.distinct / self.rate
        return max(0.0, share) if np.isfinite(share) else 0.0


@dataclass(frozen=True)
class Use:
    """Something to do with a recording.

    Attributes
    ----------
    name : of the command.
    ready : whether the recording has all it needs.
    lacks : what is missing, or what cannot be found from it; empty if nothing.
    command : what to type, ready or not.
    share : of the recording's time that can be used for it, where gaps take the rest.
    """

    name: str
    ready: bool
    lacks: tuple[str, ...]
    command: str
    share: float = 1.0


@dataclass(frozen=True)
class Inspection:
    """What a recording holds and what it is good for.

    Attributes
    ----------
    path, storage, size : the recording, `mcap` or `sqlite3`, bytes.
    started_ns, duration : first stamp, and s from the first to the last.
    segments : (start, end) in s of the parts between gaps of all topics.
    robot, metadata : the robot that the recording names (may be empty), and all strings of its record.
    topics : every topic, those that are read first.
    uses : what it is good for.
    advice : what to do about names, types and namespaces, one line each.
    remarks : what was repaired or left out while reading.
    """

    path: Path
    storage: str
    size: int
    started_ns: int
    duration: float
    segments: tuple[tuple[float, float], ...]
    robot: str
    metadata: Mapping[str, str]
    topics: tuple[TopicView, ...]
    uses: tuple[Use, ...]
    advice: tuple[str, ...]
    remarks: tuple[str, ...] = field(default=())

    def as_dict(self) -> dict[str, Any]:
        """Return everything as plain data for JSON; what is not known is None."""
        found = asdict(replace(self, metadata=dict(self.metadata)))
        found["path"] = str(self.path)
        for topic in found["topics"]:
            for key in ("rate", "distinct"):
                topic[key] = None if np.isnan(topic[key]) else topic[key]
        return found


def inspect_recording(
    path: Path | str,
    topics: Mapping[str, str] | None = None,
    *,
    namespace: str | None = None,
    joints: Joints | None = None,
    progress: Report | None = None,
) -> Inspection:
    """Say what a recording holds and what it is good for.

    Parameters
    ----------
    path, topics, namespace, joints, progress : as of :func:`artibot_sim.experiment.read_bag`. They go before what a
        file of names says that is kept with the recording.

    Raises
    ------
    ArtibotError
        If it is no recording, or damaged, or a renamed topic is not in it. A recording of topics that artibot does
        not know is no error: what to do about it is in `advice`.
    """
    info = bag_info(path)
    known = names_of(Path(path))
    renames, wheels = dict(topics or {}), dict(joints or {})
    used = {**parse_renames(known["topics"]), **renames}
    named = {**parse_joints(known["joints"]), **wheels}
    space = namespace or known["namespace"]
    experiment: Experiment | None = None
    advice: list[str] = []
    try:
        experiment = read_bag(path, used, namespace=space, joints=named, progress=progress)
    except ArtibotError as error:
        if used or named or space is not None:
            raise
        advice += _unread(info, str(error))
    options = _options(renames, namespace, wheels)
    views = _topics(info, experiment)
    segments = experiment.segments if experiment else ()
    unread = [view for view in views if not view.read_as]
    if experiment is not None or not _several(info):  # which rover is asked first
        advice += _renames(experiment, unread, options, Path(path))
    advice += _robot_advice(info.metadata.get("robot", ""), experiment)
    return Inspection(
        path=info.path,
        storage="sqlite3" if info.files[0].suffix == ".db3" else "mcap",
        size=sum(file.stat().st_size for file in info.files),
        started_ns=experiment.start_ns if experiment else info.start_ns,
        duration=experiment.duration if experiment else (info.end_ns - info.start_ns) / 1e9,
        segments=segments,
        robot=info.metadata.get("robot", ""),
        metadata=info.metadata,
        topics=views,
        uses=tuple(_uses(experiment, info, options)),
        advice=tuple(advice),
        remarks=experiment.remarks if experiment else (),
    )


def _options(renames: Mapping[str, str], namespace: str | None, joints: Joints) -> str:
    """Return the options that read the recording as it was read here, with a blank before each."""
    words = [f" --topic {wanted}={found}" for wanted, found in renames.items()]
    words += [f" --joint {wanted}={','.join(found)}" for wanted, found in joints.items()]
    return "".join(words + ([f" --namespace {namespace}"] if namespace is not None else []))


def _unread(info: BagInfo, error: str) -> Iterator[str]:
    """Say what to type where nothing could be read."""
    if several := _several(info):
        yield f"{several}: artibot inspect {info.path} {several.partition(' with ')[2]}"
        return
    if not any(channel.ros_type in READABLE for channel in info.channels):
        yield error.removeprefix(f"{info.path}: ")


def _several(info: BagInfo) -> str:
    """That a recording has topics of several rovers, and how one is chosen; empty where it has not."""
    try:
        find_namespace([channel.topic for channel in info.channels])
    except ArtibotError as several:
        return str(several)
    return ""


def _topics(info: BagInfo, experiment: Experiment | None) -> tuple[TopicView, ...]:
    """Return every topic, those that are read first, in the order of the contract."""
    counts: dict[str, int] = {}
    types: dict[str, str] = {}
    for channel in info.channels:
        counts[channel.topic] = counts.get(channel.topic, 0) + channel.message_count
        types[channel.topic] = channel.ros_type
    channels = experiment.channels if experiment else {}
    found = []
    for key in [topic.key for topic in TOPICS if topic.key in channels]:
        measured = channels[key]
        view = TopicView(measured.topic, types[measured.topic], counts[measured.topic], BY_KEY[key].name)
        found.append(_measured_view(view, measured, experiment.segments if experiment else ()))
    read = {view.topic for view in found}  # one may be read as two: /joint_states with the wheels in it
    rest = [TopicView(topic, types[topic], count) for topic, count in sorted(counts.items()) if topic not in read]
    return (*found, *rest)


def _measured_view(view: TopicView, channel: Channel, segments: Sequence[tuple[float, float]]) -> TopicView:
    """Add rates, gaps and quantities to a topic."""
    columns = tuple(name for name, values in channel.columns.items() if np.isfinite(values).any() and name != "message")
    if view.ros_type in MANY_ROWS:
        return replace(view, columns=columns)
    rate, distinct = _rates(channel, columns, segments)
    return replace(view, rate=rate, distinct=distinct, gaps=tuple(silences(channel, segments)), columns=columns)


def _rates(channel: Channel, columns: Sequence[str], segments: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Return samples and changes a second (Hz) of the column that changes most often; standstills do not count."""
    found = [(float("nan"), float("nan"))]
    for name in columns:
        t, values = channel.series(name)
        # not across segments: a logger of windows of 2 s is silent between them
        parts = [(t >= first) & (t <= last) for first, last in segments]
        steps = [np.diff(t[part]) for part in parts]
        step = np.concatenate(steps) if steps else np.empty(0)
        if len(step) < _FEW or not np.ptp(values):
            continue
        changes, moving = map(sum, zip(*(_changes(name, t[part], values[part]) for part in parts), strict=True))
        period = float(np.median(step))
        if period > 0 and moving > 0:
            found.append((1.0 / period, changes / moving))
    if len(found) > 1:
        return max(found[1:], key=lambda pair: pair[1])
    step = np.diff(channel.t)
    return (1.0 / float(np.median(step)), float("nan")) if len(step) and np.median(step) > 0 else found[0]


def _changes(name: str, t: np.ndarray, values: np.ndarray) -> tuple[int, float]:
    """Return how often a value changed, and the time (s) of all but its standstills.

    A speed that stays the same for long stands still only if it is zero: otherwise it is held.
    """
    if len(t) < 2:
        return 0, 0.0
    at = np.flatnonzero(np.diff(values) != 0) + 1
    starts = np.concatenate(([0], at))
    runs = np.diff(np.concatenate((t[starts], [t[-1]])))
    still = runs > _STANDSTILL
    if name.endswith(_RATES):
        still &= values[starts] == 0.0
    return len(at), float(runs[~still].sum())


# ----------------------------------------------------------------------
# What it is good for.
# ----------------------------------------------------------------------


def _uses(experiment: Experiment | None, info: BagInfo, options: str) -> Iterator[Use]:
    """Yield what the recording can be used for, in the order of a day's work."""
    path, robot = info.path, info.metadata.get("robot", "")
    rover = robot if robot in config_names("robots") else "ROBOT"
    if experiment is None:
        nothing = ("a topic that artibot reads",)
        for name in ("plot", "resimulate", "check", "identify", "diagnose"):
            yield Use(name, False, nothing, f"artibot inspect {path} --topic WANTED=FOUND")
        return
    drawn = {"motor_torques", "ground_truth_odom", "total_station", "odom", "planned_odom"} & set(experiment.channels)
    yield Use("plot", bool(drawn), () if drawn else ("a pose or motors",), f"artibot plot {path}{options}")
    wheels, where = _motor_faults(experiment), _place_faults(experiment)
    commands = _command_faults(experiment)
    inputs = "commands" if wheels and not commands else "rotations"
    together = None if wheels or where else _Together.of(experiment)
    broken = tuple(together.faults(experiment) if together else ())
    share = together.share(experiment) if together and not broken else 1.0
    gaps = (together.limit(experiment),) if together and share < _WHOLE else ()
    lacks = (*(wheels if inputs == "rotations" else commands), *broken)
    again = f"artibot replay {path} --resimulate {inputs} --robot {rover} --out check{options}"
    yield Use("resimulate", not lacks, lacks or gaps, again, share)
    lacks = (*wheels, *where, *broken)
    yield Use("check", not lacks, lacks or gaps, f"artibot check {path} --robot {rover}{options}", share)
    limits = lacks or (*gaps, *_limits(experiment))
    yield Use("identify", not lacks, limits, f"artibot identify {path} --robot {rover} --out soil.yaml{options}", share)
    if not lacks and commands:
        limits = (*limits, "no front speeds on /motor_command: no delay, lag or dead band can be found")
    yield Use("diagnose", not lacks, limits, f"artibot diagnose {path} --robot {rover} --out found{options}", share)


def _motor_faults(experiment: Experiment) -> list[str]:
    """What keeps the model from being turned by the recorded rotations."""
    motors = experiment.channels.get("motor_torques")
    if motors is None:
        return ["/motor_torques (velocity of front_right and front_left)"]
    absent = [name for name in MOTORS[:2] if not _has(motors, f"{name}.velocity", f"{name}.position")]
    if not absent:
        return []
    there = sorted({name.rpartition(".")[0] for name in motors.columns if "." in name}) or ["nothing"]
    return [f"rotation of {' and '.join(absent)} on {motors.topic}, which has {', '.join(there)}"]


def _has(channel: Channel, *names: str) -> bool:
    return any(name in channel and np.isfinite(channel[name]).any() for name in names)


def _command_faults(experiment: Experiment) -> list[str]:
    command = experiment.channels.get("motor_command")
    if command is not None and all(_has(command, f"{name}.velocity") for name in MOTORS[:2]):
        return []
    return ["front speeds on /motor_command"]


def _place_faults(experiment: Experiment) -> list[str]:
    for key in ("total_station", "ground_truth_odom"):
        channel = experiment.channels.get(key)
        if channel is not None and _has(channel, "x") and _has(channel, "y"):
            return []
    return ["where the rover went: /total_station/point or /ground_truth/odom"]


def _place(experiment: Experiment) -> Channel:
    """Where the rover went, of what is there the first that `identify` takes."""
    return experiment.channels.get("total_station") or experiment.channels["ground_truth_odom"]


def _length(spans: Sequence[tuple[float, float]]) -> float:
    return sum(last - first for first, last in spans)


@dataclass(frozen=True)
class _Together:
    """When motors and positions were measured together.

    Attributes
    ----------
    spans : all times (s) between two gaps of the motors.
    stretches : those long enough for a prediction.
    parts : of these, what lies between two gaps of the positions.
    """

    spans: tuple[tuple[float, float], ...]
    stretches: tuple[tuple[float, float], ...]
    parts: tuple[tuple[float, float], ...]

    @staticmethod
    def of(experiment: Experiment) -> _Together:
        """Look for them as `identify` does, which predicts through no gap of the motors."""
        motors, place = experiment.channels["motor_torques"], _place(experiment)
        spans = [span for first, last in experiment.segments for span in unbroken(motors.between(first, last).t)]
        stretches = [span for span in spans if is_stretch(span)]
        parts: list[tuple[float, float]] = []
        for first, last in stretches:
            t, _ = place.between(first, last).series("x")
            if len(t) < _POSITIONS:
                continue
            gaps = silences(place, [(float(t[0]), float(t[-1]))])
            starts = [float(t[0]), *(start + length for start, length in gaps)]
            parts += zip(starts, [*(start for start, _ in gaps), float(t[-1])], strict=True)
        return _Together(tuple(spans), tuple(stretches), tuple(parts))

    @property
    def seconds(self) -> float:
        """For how long both were measured, s."""
        return _length(self.parts)

    def share(self, experiment: Experiment) -> float:
        """For which share of the recording both were measured."""
        return min(1.0, self.seconds / experiment.duration) if experiment.duration else 1.0

    def faults(self, experiment: Experiment) -> list[str]:
        """What keeps everything from being predicted."""
        motors, place = experiment.channels["motor_torques"].topic, _place(experiment).topic
        if not self.stretches:
            return [
                f"motors without gaps: {motors} {self._motorsilences(experiment)}, and no half a second without one"
            ]
        if not self.parts:
            return [f"{place} and {motors} at the same time (stamps of two clocks?)"]
        return []

    def limit(self, experiment: Experiment) -> str:
        """How much of a recording with gaps can be used, and what is silent."""
        motors, place = experiment.channels["motor_torques"].topic, _place(experiment).topic
        longest = max(last - first for first, last in self.parts)
        several = len(self.spans) > 1
        causes = [f"{motors} {self._motorsilences(experiment)}"] if several else []
        silent = _length(self.stretches) - self.seconds
        if silent > SEGMENT_GAP:
            causes.append(f"{place} is missing for {silent:.1f} s{' between these' if several else ''}")
        said = f": {'; '.join(causes)}" if causes else ""
        return (
            f"gaps: motors and positions together in {self.seconds:.1f} of {experiment.duration:.1f} s, "
            f"{longest:.1f} s at a time at most{said}"
        )

    def _motorsilences(self, experiment: Experiment) -> str:
        return f"has {len(self.spans) - 1} gaps of more than {MOTOR_GAP:g} s in {experiment.duration:.0f} s"


def _limits(experiment: Experiment) -> Iterator[str]:
    """Yield what is not recorded and what therefore stays unknown."""
    motors = experiment.channels["motor_torques"]
    if not any(_has(motors, f"{name}.effort") for name in MOTORS):
        currents = "motor_currents" in experiment.channels
        yield (
            "no torques: identify takes currents as torques of an unknown scale, if they follow any"
            if currents
            else "no torques: forces are known only by how the rover slips"
        )
    truth = experiment.channels.get("ground_truth_odom")
    gyro = "imu" in experiment.channels and _has(experiment.channels["imu"], "yaw_rate")
    heading = "total_station" not in experiment.channels and truth is not None and _has(truth, "yaw")
    if not gyro and not heading:
        yield "no heading and no yaw rate: turning is known only from the path"
    joints = experiment.channels.get("joint_states")
    back = any(_has(motors, f"{name}.velocity", f"{name}.effort") for name in MOTORS[2:])
    if back and (joints is None or not _has(joints, "articulation_yaw.position")):
        yield "no articulation_yaw on /joint_states: the back module is known only by its pull"


# ----------------------------------------------------------------------
# Topics under other names and of other types.
# ----------------------------------------------------------------------


def _renames(experiment: Experiment | None, unread: Sequence[TopicView], options: str, path: Path) -> Iterator[str]:
    """Yield one line for each thing that may be there under another name, with what to type."""
    channels: Mapping[str, Channel] = experiment.channels if experiment else {}
    named = {view.topic: one.key for view in unread for one in TOPICS if view.topic.endswith(one.name)}
    likely: dict[str, str] = {}
    for key, types in _STAND_INS.items():
        if key in channels or (key == "total_station" and "ground_truth_odom" in channels):
            continue
        if key == "ground_truth_odom" and "total_station" in channels:
            continue
        taken = [
            view.topic for view in unread if view.ros_type in types and not view.topic.endswith(_BELIEFS)
            and named.get(view.topic, key) == key and view.topic not in likely
        ]  # fmt: skip
        taken.sort(key=lambda topic: topic not in named)
        is_it = "is it"
        if not taken and key == "ground_truth_odom":
            taken = [view.topic for view in unread if view.ros_type in types and view.topic.endswith(_BELIEFS)]
            is_it = "was measured from outside (lidar, GPS, cameras) and not by the wheels"
        if taken:
            wanted = BY_KEY[key].name
            likely[taken[0]] = f"--topic {wanted}={taken[0]}"
            others = f" (or {', '.join(taken[1:])})" if len(taken) > 1 else ""
            yield f"if {taken[0]}{others} {is_it}: artibot inspect {path}{options} {likely[taken[0]]}"
    if len(likely) > 1:
        yield f"if all are: artibot inspect {path}{options} {' '.join(likely.values())}"
    yield from _joint_names(channels, path)
    strange = [view for view in unread if view.ros_type not in READABLE and view.messages]
    wheels = [view.topic for view in strange if view.ros_type.startswith("std_msgs/msg/Float")]
    if wheels and _lacks_motors(channels):
        yield (
            f"{', '.join(wheels[:2])}: a number each; name what they are in a YAML file: "
            f"artibot import {path} --columns columns.yaml --out {path.name}_named"
        )


def _robot_advice(robot: str, experiment: Experiment | None) -> Iterator[str]:
    """Yield what to give as --robot where the recording does not say, or names a robot that is not shipped."""
    shipped = config_names("robots")
    if robot in shipped or experiment is None:
        return
    which = f"robot '{robot}' has no file here" if robot else "no robot is named"
    known = [experiment.channels[key] for key in ("motor_torques", "motor_command") if key in experiment.channels]
    back = any(_has(channel, f"{name}.velocity", f"{name}.effort") for channel in known for name in MOTORS[2:])
    joint = "joint_states" in experiment.channels and _has(
        experiment.channels["joint_states"], "articulation_yaw.position"
    )
    alike = [name for name in shipped if not (known or joint) or load_robot(name).articulated == (back or joint)]
    if back or joint:
        which += f"; it is articulated ({'it has back motors' if back else 'its joint moves'})"
    elif known:
        which += "; it is of one rigid module (it has no back motors)"
    like = "agriq" if back or joint else "husky"
    make = f"artibot robot new NAME --like {like} --help"
    yield f"{which}: for ROBOT give {', '.join(alike)}, or make a file: {make}"


def _lacks_motors(channels: Mapping[str, Channel]) -> bool:
    motors = channels.get("motor_torques")
    return motors is None or not all(_has(motors, f"{name}.velocity", f"{name}.position") for name in MOTORS[:2])


def _joint_names(channels: Mapping[str, Channel], path: Path) -> Iterator[str]:
    """Yield how to name motors that are called otherwise."""
    if not _lacks_motors(channels):
        return
    for key in ("motor_torques", "joint_states"):
        channel = channels.get(key)
        if channel is None:
            continue
        joints = list(
            dict.fromkeys(n.rpartition(".")[0] for n in channel.columns if n.endswith(("velocity", "position")))
        )
        known = set(MOTORS) | {"articulation_yaw", "articulation_roll"}
        if strange := [joint for joint in joints if joint not in known]:
            yield (
                f"{channel.topic} names {', '.join(strange[:4])}; artibot's motors are {', '.join(MOTORS)}: add "
                "--joint front_right=FOUND[,FOUND] --joint front_left=FOUND[,FOUND] (the mean of a side's wheels), or "
                f"name them in a YAML file: artibot import {path} --columns columns.yaml --out {path.name}_named"
            )
            return
