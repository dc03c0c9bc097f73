"""What `diagnose` returns: a verdict, causes with evidence, what they gain, what to measure next; as data for JSON.

`report.diagnosis` says it in sentences and tables: ``rich.print(report.diagnosis.terminal.printed(found))``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from artibot_sim.diagnose.records import (
    EXTENDED,
    Candidate,
    Cause,
    ChannelBaseline,
    ChannelGain,
    Comparison,
    EffectEstimate,
    ErrorBudget,
    ErrorLocation,
    Explainable,
    NextExperiment,
    Predictor,
    Refusal,
    SlowResidual,
    Unexplained,
    Varies,
)
from artibot_sim.diagnose.verdict import Verdict
from artibot_sim.estimation.checks.stream_values import StreamTable
from artibot_sim.estimation.residual_model import ResidualModel
from artibot_sim.estimation.search import SearchReport
from artibot_sim.model import Robot

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
    where : tuple of ErrorLocation
    causes : tuple of Cause
        Most probable first.
    ranking : tuple of Candidate
        Every effect of the vocabulary, best first.
    unexplained : Unexplained or None
    gain : mapping of str to ChannelGain
    next_experiment : NextExperiment or None
    warnings : tuple of str
        About the data: gaps, saturated sensors, too little excitation; about the answer: what is not named, and why.
    comparisons : tuple of Comparison
    prior_odds, false_alarm_rate : float
        Odds of an effect being there beforehand; share of recordings with nothing hidden in which one may be named.
    threshold : float
        Nats that an effect therefore had to gain.
    seed : int
    seconds : float
    left : mapping of str to SlowResidual
        By channel.
    predictors : tuple of Predictor
        Models that predict the held-out recordings, kinematic ones of a robot without articulation among them.
    refused : tuple of Refusal
        Fitted models that predict worse than simpler ones; `baseline_robot` and `extended` are what stands instead.
    best : str
        The name of the dynamic one that predicts best, whatever is claimed of causes.
    explainable : mapping of str to Explainable
        How much of a channel's error any model could explain; empty where there is too little to learn from, or
        nothing to learn with.
    varies : Varies or None
        A parameter of the ground that differs from window to window, where held-out data surely say so.
    error_budget : mapping of str to ErrorBudget
        Where the squared error of held-out predictions comes from, by channel.
    residual : ResidualModel or None
        What was learned, where it was asked for and surely makes predictions better.
    findings : tuple of str
        What is wrong with the recordings' clocks, signs and units, and what was mended of it beforehand.
    streams : mapping
        Delay, hold, scale and sign of each stream as it was recorded: topic → recording → `stream_values`.
    search : SearchReport or None
        What the search for the soil says of itself.
    holdout_likelier : (float, float) or None
        95 % interval of the decades by which held-out data are likelier with all that is named. Far errors weigh
        little: a pose that was lost in a few windows decides an RMSE, and not this. None where nothing was held out.
    """

    verdict: Verdict
    robot: Robot
    baseline_robot: Robot
    extended: Robot
    bags: tuple[str, ...]
    holdout: tuple[str, ...]
    horizon: float
    baseline: Mapping[str, ChannelBaseline]
    where: tuple[ErrorLocation, ...]
    causes: tuple[Cause, ...]
    ranking: tuple[Candidate, ...]
    unexplained: Unexplained | None
    gain: Mapping[str, ChannelGain]
    next_experiment: NextExperiment | None
    warnings: tuple[str, ...] = ()
    comparisons: tuple[Comparison, ...] = ()
    prior_odds: float = 0.0
    false_alarm_rate: float = 0.0
    threshold: float = 0.0
    seed: int = 0
    seconds: float = 0.0
    left: Mapping[str, SlowResidual] = field(default_factory=dict)
    predictors: tuple[Predictor, ...] = ()
    refused: tuple[Refusal, ...] = ()
    best: str = ""
    explainable: Mapping[str, Explainable] = field(default_factory=dict)
    varies: Varies | None = None
    error_budget: Mapping[str, ErrorBudget] = field(default_factory=dict)
    residual: ResidualModel | None = None
    findings: tuple[str, ...] = ()
    streams: StreamTable = field(default_factory=dict)
    search: SearchReport | None = None
    holdout_likelier: tuple[float, float] | None = None

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
            "causes": [_cause(cause, self.varies) for cause in self.causes],
            "unexplained": _unexplained_entry(self.unexplained) if self.unexplained else None,
            "gain": {name: _numbers(vars(channel)) for name, channel in self.gain.items()},
            "holdout_likelier": _numbers(self.holdout_likelier),
            "next_experiment": _numbers(vars(self.next_experiment)) if self.next_experiment else None,
            "ranking": [_numbers(vars(candidate)) for candidate in self.ranking],
            "findings": list(self.findings),
            "streams": _numbers(self.streams),
            "search": vars(self.search) if self.search else None,
            "warnings": list(self.warnings),
            "prior_odds": self.prior_odds,
            "false_alarm_rate": self.false_alarm_rate,
            "threshold": self.threshold,
            "seed": self.seed,
            "seconds": self.seconds,
            "left": {name: _numbers(vars(left)) for name, left in self.left.items()},
            "predictors": [_predictor(one) for one in self.predictors],
            "refused": [vars(one) for one in self.refused],
            "best": self.best,
            "explainable": {name: _numbers(vars(one)) for name, one in self.explainable.items()},
            "varies": _numbers(vars(self.varies)) if self.varies else None,
            "error_budget": {name: _numbers(vars(one)) for name, one in self.error_budget.items()},
        }

    @property
    def extends(self) -> bool:
        """Whether the extended robot has anything that the paper's model lacks: a named effect, or a law."""
        return bool(self.causes) or bool(self.unexplained is not None and self.unexplained.laws)

    @property
    def refusal(self) -> Refusal | None:
        """Why the extended robot is not the one with what is named, or is worse than kinematics; None where it is."""
        return next((one for one in self.refused if one.model == EXTENDED), None)

    @property
    def best_robot(self) -> Robot | None:
        """The robot that predicts held-out recordings best; None where nothing was held out."""
        return next((one.robot for one in self.predictors if one.name == self.best), None)

    def __str__(self) -> str:
        """Verdict, named effects and recordings in one line."""
        causes = ", ".join(cause.effect for cause in self.causes)
        held = f", held out {', '.join(self.holdout)}" if self.holdout else ""
        answer = f"{self.verdict.value}: {causes}" if causes else self.verdict.value
        return f"{answer} ({self.robot.name}; fitted {', '.join(self.bags)}{held})"


def _predictor(one: Predictor) -> dict[str, Any]:
    errors = {name: _numbers(vars(error)) for name, error in one.errors.items()}
    return {"name": one.name, "kinematic": one.kinematic, "alike": list(one.alike), **errors}


def _cause(cause: Cause, varies: Varies | None) -> dict[str, Any]:
    evidence = {
        "log10_bayes_factor": cause.log10_bayes_factor, "holdout_improvement": cause.holdout_improvement,
        "holdout_log10_likelihood": cause.holdout_log10_likelihood,
    }  # fmt: skip
    mine = varies if varies is not None and varies.effect == cause.effect else None
    spread = {"varies": {"spread": mine.spread, "over": mine.each}} if mine else {}
    return {
        "effect": cause.effect,
        "parameters": {name: _found(found) for name, found in cause.parameters.items()},
        "evidence": _numbers(evidence),
        "ties": list(cause.ties),
        **spread,
    }


def _unexplained_entry(what: Unexplained) -> dict[str, Any]:
    laws = {law: {name: _found(found) for name, found in one.items()} for law, one in what.laws.items()}
    return {**_numbers(vars(what) | {"laws": {}}), "laws": laws}


def _found(found: EffectEstimate) -> dict[str, Any]:
    if isinstance(found.value, str):
        return {"value": found.value}
    return _numbers({"value": found.value, "unit": found.unit, "ci95": found.ci95})


def _numbers(values: Any) -> Any:
    """A value in JSON's terms: lists for tuples and mappings' copies, null for what is not finite."""
    if isinstance(values, Mapping):
        return {key: _numbers(value) for key, value in values.items()}
    if isinstance(values, tuple | list):
        return [_numbers(value) for value in values]
    if isinstance(values, float) and not np.isfinite(values):
        return None
    return values
