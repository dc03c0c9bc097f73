"""Recordings of other robots: wheels under other names, wheels from odometry, and a pose from transforms."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment.columns import Channel, Experiment, Floats
from artibot_sim.model import MOTORS, Robot

JOINTS = (*MOTORS, "articulation_yaw", "articulation_roll")
"""Joints that can be named by hand."""
_QUANTITIES = {"position": "rad", "velocity": "rad/s", "effort": "N·m"}
_SIDES = {"right": "right", "r": "right", "left": "left", "l": "left"}
_AXLES = frozenset({"front", "rear", "back", "middle", "mid", "center", "centre", "f", "b", "m"})
_WHEELS = frozenset({"wheel", "wheels", "motor", "drive", "tire", "tyre", "track"})
_OTHERS = frozenset({"steer", "steering", "caster", "castor", "suspension", "rocker", "bogie"})
_WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])")

Joints = Mapping[str, Sequence[str]]
"""Joint as artibot names it → joints of a recording whose mean it is."""


# ----------------------------------------------------------------------
# Joints under other names.
# ----------------------------------------------------------------------


def parse_joints(pairs: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Turn `--joint WANTED=FOUND[,FOUND]` options into the mapping that `read_bag` takes.

    Raises
    ------
    ArtibotError
        If a pair has no `=`, or WANTED is no motor and no joint of an articulation.
    """
    found = {}
    for pair in pairs:
        wanted, _, names = pair.partition("=")
        listed = tuple(name.strip() for name in names.split(",") if name.strip())
        if not listed:
            raise ArtibotError(
                f"--joint '{pair}': expected WANTED=FOUND[,FOUND], "
                "e.g. --joint front_right=front_right_wheel_joint,rear_right_wheel_joint"
            )
        if wanted not in JOINTS:
            raise ArtibotError(f"--joint '{pair}': '{wanted}' is no joint; expected one of {', '.join(JOINTS)}")
        found[wanted] = listed
    return found


def joints_of(channel: Channel) -> list[str]:
    """Names of the joints in a channel."""
    names = (column.rpartition(".") for column in channel.columns)
    return sorted({name for name, _, quantity in names if quantity in _QUANTITIES})


def detected_sides(names: Iterable[str]) -> dict[str, tuple[str, ...]]:
    """The wheels of the right and the left side, by their names (``rear_left_wheel_joint``); empty where unclear.

    A name with two axles (``front_right_back_wheel``) is of an articulated rover and is left alone.
    """
    sides: dict[str, list[str]] = {"right": [], "left": []}
    for name in names:
        words = [word.lower() for word in _WORD.findall(name)]
        side = {_SIDES[word] for word in words if word in _SIDES}
        axles = sum(word in _AXLES for word in words)
        if len(side) == 1 and axles <= 1 and _WHEELS & set(words) and not _OTHERS & set(words):
            sides[side.pop()].append(name)
    if not sides["right"] or len(sides["right"]) != len(sides["left"]):
        return {}
    return {f"front_{side}": tuple(sorted(found)) for side, found in sides.items()}


def with_wheels(channels: Mapping[str, Channel], joints: Joints, remarks: list[str]) -> dict[str, Channel]:
    """Channels whose motors have artibot's names: those of `joints`, else those whose names say what they are.

    Wheels in `/joint_states` serve as motors where nothing else does. Raises where a joint that was named is nowhere.
    """
    found = dict(channels)
    for wanted, names in joints.items():
        homes = [key for key in _HOMES if key in found and set(names) & set(joints_of(found[key]))]
        if not homes:
            present = sorted({name for key in _HOMES if key in found for name in joints_of(found[key])})
            raise ArtibotError(
                f"--joint {wanted}={','.join(names)}: no such joint; the recording has {', '.join(present) or 'none'}"
            )
        for key in homes:
            found[key] = _renamed(found[key], {wanted: names})
    if not _turns(found.get("motor_torques")):
        _detect(found, remarks)
    return found


_HOMES = ("motor_torques", "motor_command", "joint_states")


def _turns(channel: Channel | None) -> bool:
    """Whether a channel tells how both front motors turn."""
    return channel is not None and all(
        any(f"{motor}.{quantity}" in channel for quantity in ("position", "velocity")) for motor in MOTORS[:2]
    )


def _detect(found: dict[str, Channel], remarks: list[str]) -> None:
    for key in ("motor_torques", "joint_states"):
        channel = found.get(key)
        if channel is None:
            continue
        if not _turns(channel):
            sides = detected_sides(joints_of(channel))
            if not sides:
                continue
            channel = _renamed(channel, sides)
            said = "; ".join(f"{wanted} is the mean of {', '.join(names)}" for wanted, names in sides.items())
            remarks.append(f"{channel.topic}: wheels by their names: {said}; say --joint WANTED=FOUND if not")
        if not _turns(channel):
            continue
        found["motor_torques"] = channel
        if "motor_command" in found and not _turns(found["motor_command"]):
            sides = detected_sides(joints_of(found["motor_command"]))
            found["motor_command"] = _renamed(found["motor_command"], sides)
        return


def _renamed(channel: Channel, joints: Joints) -> Channel:
    """A channel with further columns: means of those that are named."""
    columns, units = dict(channel.columns), dict(channel.units)
    for wanted, names in joints.items():
        for quantity, unit in _QUANTITIES.items():
            parts = [channel[f"{name}.{quantity}"] for name in names if f"{name}.{quantity}" in channel]
            if parts:
                columns[f"{wanted}.{quantity}"] = _mean(np.array(parts))
                units[f"{wanted}.{quantity}"] = unit
    return replace(channel, columns=columns, units=units)


def _mean(values: Floats) -> Floats:
    """The mean over rows of what is finite; NaN where nothing is."""
    known = np.isfinite(values)
    total = np.where(known, values, 0.0).sum(axis=0)
    return np.where(known.any(axis=0), total / np.maximum(known.sum(axis=0), 1), np.nan)


def with_odometry_wheels(experiment: Experiment, robot: Robot) -> Experiment:
    """A recording without wheels whose `/odom` has a twist: with wheels that turn as that says, for `robot`'s lengths.

    An odometry is made of wheels, so this undoes what made it if the robot file's numbers are those it was made with.
    """
    odom = experiment.channels.get("odom")
    if _turns(experiment.channels.get("motor_torques")) or robot.articulated or odom is None:
        return experiment
    if not {"vx", "yaw_rate"} <= set(odom.columns) or not np.isfinite(odom["vx"] + odom["yaw_rate"]).any():
        return experiment
    rolled, half = robot.wheel.r_w * robot.drive.front.tau, 0.5 * robot.front.i_y * odom["yaw_rate"]
    right, left = (odom["vx"] + half) / rolled, (odom["vx"] - half) / rolled
    columns = {"front_right.velocity": right, "front_left.velocity": left}
    wheels = replace(odom, columns=columns, units=dict.fromkeys(columns, "rad/s"))
    said = (
        f"{odom.topic}: no wheels are recorded; they are taken from its twist, for a radius of {robot.wheel.r_w:g} m "
        f"and a track of {robot.front.i_y:g} m: where it was made with others, scale and turning are wrong by as much"
    )
    return replace(
        experiment, channels={**experiment.channels, "motor_torques": wheels}, remarks=(*experiment.remarks, said)
    )


# ----------------------------------------------------------------------
# A pose from transforms.
# ----------------------------------------------------------------------


_FIXED = ("map", "world")
"""Frames whose pose does not drift, the first that is there."""
_BODY = ("base_link", "base_footprint")
ARROW = ">"
"""Between parent and child in the columns of transforms: ``map>odom.x``."""


def pose_of_transforms(channel: Channel) -> Channel:
    """Poses of the rover in its map, from a channel of transforms; the most frequent link gives the stamps.

    Others are held until they change, as TF has it.

    Raises
    ------
    ArtibotError
        Where no chain leads from a fixed frame to the rover.
    """
    links = {tuple(column.rpartition(".")[0].split(ARROW)) for column in channel.columns if ARROW in column}
    chain = _chain({(a, b) for a, b in links})
    if not chain:
        listed = ", ".join(sorted(f"{a} to {b}" for a, b in links)) or "no transform"
        raise ArtibotError(
            f"topic {channel.topic}: no chain from {' or '.join(_FIXED)} to {' or '.join(_BODY)}; it has {listed}"
        )
    tables = [channel.series(f"{a}{ARROW}{b}.x")[0] for a, b in chain]
    t = max(tables, key=len)
    t = t[t >= max(times[0] for times in tables)]
    x, y, yaw = np.zeros((3, len(t)))
    for a, b in chain:
        dx, dy, turn = (_held_at(*channel.series(f"{a}{ARROW}{b}.{name}"), t) for name in ("x", "y", "yaw"))
        c, s = np.cos(yaw), np.sin(yaw)
        x, y, yaw = x + c * dx - s * dy, y + s * dx + c * dy, yaw + turn
    rows = np.searchsorted(channel.t, t)
    columns = {"x": x, "y": y, "yaw": np.arctan2(np.sin(yaw), np.cos(yaw))}
    return replace(
        channel, t_ns=channel.t_ns[rows], t=channel.t[rows], received_ns=channel.received_ns[rows], columns=columns,
        units={"x": "m", "y": "m", "yaw": "rad"},
    )  # fmt: skip


def _held_at(times: Floats, values: Floats, t: Floats) -> Floats:
    """The last values (m,) at times t (n,)."""
    return values[np.searchsorted(times, t, side="right") - 1]


def _chain(links: set[tuple[str, str]]) -> list[tuple[str, str]]:
    """Links from a fixed frame to the rover; frames may stand below a namespace (``rover1/base_link``)."""
    parent = {child: (root, child) for root, child in links}
    for body in sorted(parent, key=lambda name: [*_BODY, name.rpartition("/")[2]].index(name.rpartition("/")[2])):
        if body.rpartition("/")[2] not in _BODY:
            continue
        chain: list[tuple[str, str]] = []
        frame = body
        while frame in parent and len(chain) < len(links):
            chain.append(parent[frame])
            frame = parent[frame][0]
        if frame.rpartition("/")[2] in _FIXED:
            return chain[::-1]
    return []
