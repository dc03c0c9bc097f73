"""One job of a campaign: make the case, have it diagnosed, keep the answer beside the truth."""

from __future__ import annotations

import tempfile
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np
from diagnose.hidden.cases import Case, case, write
from diagnose.hidden.jobs import Job
from diagnose.hidden.sensors import Noise

from artibot_sim.checkpoints import Checkpoints
from artibot_sim.diagnose import Options, diagnose
from artibot_sim.diagnose.policy import FALSE_ALARM_RATE
from artibot_sim.diagnose.selection.evidence import Evidence
from artibot_sim.diagnose.selection.forward import SearchStage
from artibot_sim.model import load_robot

Part = TypeVar("Part")

KEPT = (
    "verdict",
    "causes",
    "unexplained",
    "gain",
    "baseline",
    "next_experiment",
    "ranking",
    "warnings",
    "threshold",
    "soils",
    "left",
    "first_search",
)
"""What of an answer goes into the journal."""

Diagnose = Callable[[Case, float], Mapping[str, Any]]
"""From a case, of which it may look at the recordings alone, and a share of false alarms to `Diagnosis.as_dict()`."""


class FirstSearch(Checkpoints):
    """Keeps nothing, but remembers what the first search for an effect found."""

    evidence: Mapping[str, Evidence] = MappingProxyType({})

    def once(self, name: str, make: Callable[[], Part]) -> Part:
        """The part, made."""
        part = super().once(name, make)
        if name == "judged beside nothing" and isinstance(part, SearchStage):
            self.evidence = part.evidence
        return part

    def as_dict(self) -> dict[str, dict[str, float]]:
        """By effect what decides whether it is named."""
        return {
            name: {
                "nats": one.nats, "scatter": one.sampling_sd, "deviations": one.deviations,
                "size": float(np.abs(one.own).max()),
            }
            for name, one in self.evidence.items()
        }  # fmt: skip


def in_memory(found: Case, false_alarms: float = float(FALSE_ALARM_RATE)) -> dict[str, Any]:
    """The diagnosis as a library, in this process, on one core."""
    parts = FirstSearch()
    options = Options(horizon=found.horizon, seed=0, workers=1, false_alarm_rate=false_alarms, parts=parts)
    answer = diagnose(found.recordings, load_robot(found.robot), holdout=found.holdout, options=options)
    soils = {
        name: vars(robot.contact) for name, robot in (("before", answer.baseline_robot), ("after", answer.extended))
    }
    return {**answer.as_dict(), "soils": soils, "first_search": parts.as_dict()}


def command_line(found: Case, false_alarms: float = float(FALSE_ALARM_RATE)) -> dict[str, Any]:
    """`artibot diagnose` on real bags."""
    import json
    import subprocess
    import sys

    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        bags = [str(write(recording, folder)) for recording in found.recordings]
        held = [word for recording in found.holdout for word in ("--holdout", str(write(recording, folder)))]
        out = folder / "diagnosis"
        command = [
            sys.executable,
            "-m",
            "artibot_sim.cli",
            "diagnose",
            *bags,
            *held,
            "--robot",
            found.robot,
            "--horizon",
            str(found.horizon),
            "--false-alarms",
            str(false_alarms),
            "--out",
            str(out),
        ]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            raise RuntimeError(f"artibot diagnose: status {done.returncode}: {done.stderr.strip()[-2000:]}")
        return json.loads((out / "diagnosis.json").read_text())


def silent(found: Case, false_alarms: float = float(FALSE_ALARM_RATE)) -> dict[str, Any]:
    """Says that nothing is wrong, whatever it is shown: what every other way has to beat."""
    return {
        "verdict": "none",
        "causes": [],
        "unexplained": None,
        "gain": {},
        "baseline": {},
        "ranking": [],
        "warnings": [],
    }


def reference(found: Case) -> dict[str, dict[str, float]]:
    """How well the true model predicts what was held out, by channel: its soil and effects are the truth's.

    Of what is on no list there is no model: then `found` is the same case without it, on which a model that knew it
    would err by as much.
    """
    from artibot_sim.identify.validation import hold_out

    truth = found.truth
    robot = load_robot(found.robot).replace({f"contact.{name}": value for name, value in truth.soil.items()})
    robot = replace(robot, effects={name: dict(values) for name, values in truth.effects.items()})
    channels: dict[str, dict[str, float]] = {}
    for recording in found.holdout:
        for name, fit in hold_out(recording, robot, found.horizon, workers=1).summary.channels.items():
            one = channels.setdefault(name, {"after": 0.0, "noise": fit.noise, "count": 0})
            count = one["count"] + fit.count
            one["after"] = ((one["after"] ** 2 * one["count"] + fit.rmse**2 * fit.count) / count) ** 0.5
            one["count"] = count
    return channels


WAYS: dict[str, Diagnose] = {"memory": in_memory, "bags": command_line, "silent": silent}


def do(job: Job, way: str = "memory") -> dict[str, Any]:
    """A line for the journal. A diagnosis that fails is a result, too."""
    noise = Noise().scaled(job.noise)

    def made(effects: Sequence[str]) -> Case:
        size = {"noise": noise, "runs": job.runs, "duration": job.duration}
        return case(effects, job.severity, job.seed, **size, robot=job.robot, torques=job.torques)

    found = made(job.effects)
    result: dict[str, Any] = {"key": job.key, "job": job._asdict(), "truth": asdict(found.truth)}
    began = time.monotonic()
    try:
        answer = WAYS[way](found, job.false_alarms)
    except Exception as error:  # noqa: BLE001 - whatever it is, the campaign goes on
        return result | {"error": f"{type(error).__name__}: {error}", "trace": traceback.format_exc()[-3000:]}
    seconds = time.monotonic() - began
    truth = found.truth
    if (truth.effects or truth.unlisted) and answer["gain"]:
        known = [name for name in job.effects if name not in truth.unlisted]
        result["reference"] = reference(made(known) if truth.unlisted else found)
    return result | {"answer": {name: answer.get(name) for name in KEPT} | {"seconds": round(seconds, 2)}}
