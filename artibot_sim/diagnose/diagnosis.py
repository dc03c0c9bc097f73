"""What a diagnosis finds: a verdict, causes with evidence, what they gain, and what to measure next."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from artibot_sim.diagnose.parts import (
    Candidate,
    Cause,
    ChannelBaseline,
    ChannelGain,
    Found,
    Left,
    Look,
    NextExperiment,
    Place,
    Series,
    Unexplained,
    Verdict,
)
from artibot_sim.model import Robot

__all__ = [
    "SCHEMA",
    "Candidate",
    "Cause",
    "ChannelBaseline",
    "ChannelGain",
    "Diagnosis",
    "Found",
    "Left",
    "Look",
    "NextExperiment",
    "Place",
    "Series",
    "Unexplained",
    "Verdict",
]  # fmt: skip

SCHEMA = "artibot/diagnosis/1"


@dataclass(frozen=True)
class Diagnosis:
    """What is wrong, where, why, how sure, what it gains, and what to measure next.

    Attributes
    ----------
    verdict : Verdict
    robot : Robot
        The one that was given.
    baseline_robot : Robot
        With its soil identified anew.
    extended : Robot
        With the causes' effects as well.
    bags, holdout : tuple of str
        Recordings fitted and held out.
    horizon : float, s
    baseline : mapping of str to ChannelBaseline
    where : tuple of Place
    causes : tuple of Cause
        Most probable first.
    ranking : tuple of Candidate
        Every effect of the vocabulary, best first.
    unexplained : Unexplained or None
    gain : mapping of str to ChannelGain
    next_experiment : NextExperiment or None
    warnings : tuple of str
        About the data: gaps, clocks, saturated sensors, too little excitation.
    looks : tuple of Look
    prior_odds, false_alarm_rate : float
        Odds of an effect being there beforehand; share of recordings with nothing hidden in which one may be named.
    threshold : float
        Nats that an effect therefore had to gain.
    seed : int
    seconds : float
    left : mapping of str to Left
        By channel.
    """

    verdict: Verdict
    robot: Robot
    baseline_robot: Robot
    extended: Robot
    bags: tuple[str, ...]
    holdout: tuple[str, ...]
    horizon: float
    baseline: Mapping[str, ChannelBaseline]
    where: tuple[Place, ...]
    causes: tuple[Cause, ...]
    ranking: tuple[Candidate, ...]
    unexplained: Unexplained | None
    gain: Mapping[str, ChannelGain]
    next_experiment: NextExperiment | None
    warnings: tuple[str, ...] = ()
    looks: tuple[Look, ...] = ()
    prior_odds: float = 0.0
    false_alarm_rate: float = 0.0
    threshold: float = 0.0
    seed: int = 0
    seconds: float = 0.0
    left: Mapping[str, Left] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """All but robots and pictures' data, as plain data for JSON; what is not a number is null there."""
        return {
            "schema": SCHEMA,
            "verdict": self.verdict.value,
            "robot": self.robot.name,
            "bags": list(self.bags),
            "holdout": list(self.holdout),
            "horizon": self.horizon,
            "baseline": {name: _numbers(vars(channel)) for name, channel in self.baseline.items()},
            "where": [vars(place) for place in self.where],
            "causes": [_cause(cause) for cause in self.causes],
            "unexplained": _numbers(vars(self.unexplained)) if self.unexplained else None,
            "gain": {name: _numbers(vars(channel)) for name, channel in self.gain.items()},
            "next_experiment": _numbers(vars(self.next_experiment)) if self.next_experiment else None,
            "ranking": [_numbers(vars(candidate)) for candidate in self.ranking],
            "warnings": list(self.warnings),
            "prior_odds": self.prior_odds,
            "false_alarm_rate": self.false_alarm_rate,
            "threshold": self.threshold,
            "seed": self.seed,
            "seconds": self.seconds,
            "left": {name: _numbers(vars(left)) for name, left in self.left.items()},
        }

    def __rich__(self) -> Any:
        from artibot_sim.diagnose.printing import printed

        return printed(self)

    def __str__(self) -> str:
        from artibot_sim.diagnose.printing import as_text

        return as_text(self)


def _cause(cause: Cause) -> dict[str, Any]:
    evidence = {
        "log10_bayes_factor": cause.log10_bayes_factor, "holdout_improvement": cause.holdout_improvement,
        "holdout_log10_likelihood": cause.holdout_log10_likelihood,
    }  # fmt: skip
    return {
        "effect": cause.effect,
        "parameters": {name: _found(found) for name, found in cause.parameters.items()},
        "evidence": _numbers(evidence),
        "ties": list(cause.ties),
    }


def _found(found: Found) -> dict[str, Any]:
    if isinstance(found.value, str):
        return {"value": found.value}
    return _numbers({"value": found.value, "unit": found.unit, "ci95": found.ci95})


def _numbers(values: Any) -> Any:
    """The same in JSON's terms: lists for tuples and mappings' copies, null for what is not finite."""
    if isinstance(values, Mapping):
        return {key: _numbers(value) for key, value in values.items()}
    if isinstance(values, tuple | list):
        return [_numbers(value) for value in values]
    if isinstance(values, float) and not np.isfinite(values):
        return None
    return values
