"""`check`: everything that can be said of recordings before a soil is fitted, in seconds."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from artibot_sim.errors import ArtibotError
from artibot_sim.estimation.checks.comparisons import Finding, StreamComparisons, compare_streams
from artibot_sim.estimation.checks.findings import findings
from artibot_sim.estimation.checks.recordings import doubts, require_usable
from artibot_sim.estimation.streams import Delay
from artibot_sim.experiment import Channel, Experiment
from artibot_sim.model import Robot

NAN_REPORTED = 0.02
"""Share of a measured column that is not a number before it is said."""
_JUMP_BACK = 0.2
"""Share of a topic's samples that lie far from both neighbours while these agree: two sources in one topic."""
_LEAST_STEP = 0.05
"""m or rad of a leap to and fro, below which it may be noise."""


@dataclass(frozen=True)
class Check:
    """What is known of one recording.

    Attributes
    ----------
    name : str
    refused : str
        Why nothing can be learnt from it about this robot; empty where something can.
    findings : tuple of Finding
        What is wrong and has a name, the serious first.
    doubts : tuple of str
        What else is doubtful.
    delays : tuple of (str, str, Delay)
        A stream, the one that it is later than, and by how much.
    """

    name: str
    refused: str
    findings: tuple[Finding, ...]
    doubts: tuple[str, ...]
    delays: tuple[tuple[str, str, Delay], ...]

    @property
    def usable(self) -> bool:
        """Whether it can be fitted as it is."""
        return not self.refused and not any(one.serious for one in self.findings)

    def as_dict(self) -> dict[str, object]:
        """For a file."""
        return {
            "name": self.name, "usable": self.usable, "refused": self.refused,
            "findings": [one.as_dict() for one in self.findings], "doubts": list(self.doubts),
            "delays": [
                {"stream": stream, "after": after, "value": d.value, "ci95": list(d.interval), "unit": "s",
                 "agreement": d.agreement}
                for stream, after, d in self.delays
            ],
        }  # fmt: skip


def check(recordings: Sequence[Experiment], robot: Robot) -> list[Check]:
    """Check recordings for a robot, each by itself and then together."""
    found = [_one(experiment, robot) for experiment in recordings]
    usable = [experiment for experiment, one in zip(recordings, found, strict=True) if not one.refused]
    together = doubts(usable, robot) if len(usable) > 1 else []
    known = {said for one in found for said in one.doubts}
    rest = tuple(said for said in together if said not in known and not _of_one(said, recordings))
    return [*found, Check("all together", "", (), rest, ())] if rest else found


def _of_one(said: str, recordings: Sequence[Experiment]) -> bool:
    return any(said.startswith(f"{experiment.name}: ") for experiment in recordings)


def _one(experiment: Experiment, robot: Robot) -> Check:
    if "motor_torques" not in experiment.channels:
        return Check(experiment.name, _missing(experiment), (), tuple(_numbers(experiment)), ())
    try:
        require_usable([experiment], robot)
        refused = ""
    except ArtibotError as error:
        refused = str(error)
    if refused and not _turns(experiment):
        return Check(experiment.name, refused, (), tuple(_numbers(experiment)), ())
    streams = compare_streams(experiment)
    said = [*_numbers(experiment), *_two_sources(experiment)]
    if not refused:
        said += [text.removeprefix(f"{experiment.name}: ") for text in doubts([experiment], robot)]
    named = tuple(findings(experiment, robot, streams))
    return Check(experiment.name, refused, named, tuple(dict.fromkeys(said)), tuple(_delays(streams)))


def _turns(experiment: Experiment) -> bool:
    """Whether any motor turns: streams that never change agree at every delay."""
    columns = experiment.channels["motor_torques"].columns
    moving = [values[np.isfinite(values)] for name, values in columns.items() if not name.endswith(".effort")]
    return any(len(values) and np.ptp(values) > 0.0 for values in moving)


def _missing(experiment: Experiment) -> str:
    try:
        experiment.require("motor_torques")
    except ArtibotError as error:
        return str(error)
    return ""


def _numbers(experiment: Experiment) -> Iterator[str]:
    """Columns of which a part is not a number, while others of the same topic are."""
    for key in ("motor_torques", "ground_truth_odom", "total_station", "imu", "joint_states"):
        channel = experiment.channels.get(key)
        if channel is None or not len(channel):
            continue
        for name, values in channel.columns.items():
            share = float(np.mean(~np.isfinite(values)))
            if NAN_REPORTED < share < 1.0 and not _in_turns(channel, name):
                yield f"{channel.topic}: {100 * share:.0f} % of {name} is NaN; those samples are left out"


def _in_turns(channel: Channel, name: str) -> bool:
    """Whether a column is absent from the messages that carry other columns only, as JointStates do."""
    lacking = ~np.isfinite(channel[name])
    others = [np.isfinite(values) for other, values in channel.columns.items() if other != name]
    return bool(others) and bool(np.any(others, axis=0)[lacking].all()) and "." in name


def _two_sources(experiment: Experiment) -> Iterator[str]:
    """Topics whose samples jump to and fro between two places: two robots, or two publishers of one topic."""
    for key, names in (("ground_truth_odom", ("x", "y")), ("total_station", ("x", "y")),
                       ("motor_torques", ("front_right.position", "front_left.position"))):  # fmt: skip
        channel = experiment.channels.get(key)
        if channel is None or not set(names) <= set(channel.columns):
            continue
        values = np.column_stack([channel[name] for name in names])
        values = values[np.isfinite(values).all(axis=1)]
        if len(values) < 30:
            continue
        step, across = np.diff(values, axis=0), values[2:] - values[:-2]
        back = (step[1:] * step[:-1]).sum(axis=1) < 0.0
        far = np.minimum(np.linalg.norm(step[1:], axis=1), np.linalg.norm(step[:-1], axis=1))
        wild = back & (far > 5.0 * np.linalg.norm(across, axis=1)) & (far > _LEAST_STEP)
        if np.mean(wild) > _JUMP_BACK:
            yield (
                f"{channel.topic} jumps to and fro by {float(np.median(far[wild])):.2g} in "
                f"{100 * np.mean(wild):.0f} % of its samples: two robots in one recording? "
                "Choose one with --namespace or --topic"
            )


def _delays(of: StreamComparisons) -> Iterator[tuple[str, str, Delay]]:
    pairs = (
        ("heading", "wheels", of.turn), ("position", "wheels", of.forward), ("heading", "gyroscope", of.gyro),
        ("gyroscope", "wheels", of.gyro_wheels), ("wheels", "command", of.response),
    )  # fmt: skip
    for stream, after, delay in pairs:
        if delay is not None:
            yield stream, after, delay
