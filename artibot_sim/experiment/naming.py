"""Recordings whose topics and joints have other names: named by options, or by a file kept with the recording."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment.columns import Experiment
from artibot_sim.experiment.reader import read_bag
from artibot_sim.experiment.topics import parse_renames
from artibot_sim.experiment.wheels import parse_joints, with_odometry_wheels
from artibot_sim.model import Robot
from artibot_sim.progress import Report

NAMES = "names.yaml"
"""File in a recording's folder, or beside it as ``<recording>.names.yaml``."""
_KEYS = ("topics", "joints", "namespace")


def open_recording(
    path: Path,
    robot: Robot | None = None,
    *,
    topics: Sequence[str] = (),
    joints: Sequence[str] = (),
    namespace: str | None = None,
    most: int | None = None,
    progress: Report | None = None,
) -> Experiment:
    """Read a recording of any robot.

    Parameters
    ----------
    path : Path
    robot : Robot, optional
        Whose radius and track turn an odometry's twist into wheels where none are recorded.
    topics, joints : sequence of str
        ``WANTED=FOUND`` and ``WANTED=FOUND[,FOUND]``; they go before what the file of names says.
    namespace : str, optional
    most : int, optional
        Messages to read at most, see `read_bag`.
    progress : callable, optional

    Raises
    ------
    ArtibotError
        As `read_bag`; and for a file of names that is not understood.
    """
    known = names_of(path)
    experiment = read_bag(
        path, {**parse_renames(known["topics"]), **parse_renames(tuple(topics))},
        namespace=namespace or known["namespace"],
        joints={**parse_joints(known["joints"]), **parse_joints(joints)}, most=most, progress=progress,
    )  # fmt: skip
    return experiment if robot is None else with_odometry_wheels(experiment, robot)


def names_of(path: Path) -> dict[str, Any]:
    """What the file of names of a recording says, as options would: lists of texts, and a namespace or None."""
    beside = path.with_name(f"{path.name}.{NAMES}")
    file = next((each for each in (path / NAMES, beside) if each.is_file()), None)
    found: dict[str, Any] = {"topics": [], "joints": [], "namespace": None}
    if file is None:
        return found
    try:
        given = yaml.safe_load(file.read_text())
    except (yaml.YAMLError, UnicodeDecodeError, OSError) as error:
        raise ArtibotError(f"{file}: cannot be read as YAML: {error}") from error
    if not isinstance(given, dict) or not set(given) <= set(_KEYS):
        raise ArtibotError(f"{file}: expected a mapping with {', '.join(_KEYS)}, each of them optional")
    found["namespace"] = given.get("namespace")
    for key in ("topics", "joints"):
        pairs = given.get(key) or {}
        if not isinstance(pairs, dict):
            raise ArtibotError(f"{file}: {key}: expected a mapping WANTED: FOUND")
        for wanted, names in pairs.items():
            listed = names if isinstance(names, list) else [names]
            found[key].append(f"{wanted}={','.join(str(name) for name in listed)}")
    return found
