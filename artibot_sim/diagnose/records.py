"""What a diagnosis is made of: options, causes, candidates, channels, and what pictures are drawn from."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from artibot_sim.checkpoints import Checkpoints
from artibot_sim.diagnose.policy import (
    CLEARLY_WORSE,
    FALSE_ALARM_RATE,
    HORIZON,
    PRIOR_ODDS,
    THRESHOLDS,
    WORTH_LEARNING,
    Thresholds,
)
from artibot_sim.model import Robot

# ----------------------------------------------------------------------
# How a diagnosis is made.
# ----------------------------------------------------------------------


GIVEN, BASELINE, EXTENDED, UNNAMED = "as given", "soil identified", "with what is named", "best fit, no cause claimed"
"""Names of the predictors that are dynamic models, the simplest first."""
FILES = {BASELINE: "baseline.yaml", EXTENDED: "extended.yaml"}
"""Dynamic model → the file in which it is written."""
LAST_THIRD = " (last third)"
"""How the name of a recording's part ends that is held out of it."""

HALF_WIDTH = 0.045
"""s around an instant whose encoder positions give a motor's rotation. Narrower, the encoders' steps make noise of
predicted torques, which back wheels with less friction seem to mend; wider, the peaks of slip are cut."""


@dataclass(frozen=True)
class Options:
    """How a diagnosis is made.

    Attributes
    ----------
    horizon : float
        Length of the predictions that fits, evidence and gains rest on, s.
    seed : int
        The same data and seed give the same diagnosis.
    workers : int, optional
        Threads; as many as cores by default. The result does not depend on it.
    prior_odds : float
        Of some effect being there beforehand.
    false_alarm_rate : float
        Share of the cases with nothing hidden in which something may be named.
    thresholds : Thresholds
    scheduler : str, optional
        Address of a Dask scheduler (:mod:`artibot_sim.cluster`) whose workers fit one effect each; the rest of the
        work stays here, and the result is the same.
    budget : float
        s that all of it is to take, about, from when `parts` was made: as many windows are searched as there is time
        for, what is not over in time is given up, and the warnings say what was not tried. Then the result depends on
        how fast the machine is. A search of a few windows, what commands say, and predictions of all recordings are
        made in any case.
    residual : bool
        Whether what a model without physics learns is kept, where it surely makes predictions better.
    parts : Checkpoints
        What an earlier call with the same arguments had finished, and where finished parts are kept.
    after_search : float
        s of the budget that intervals and predictions take, which follow the search.
    """

    horizon: float = HORIZON
    seed: int = 0
    workers: int | None = None
    prior_odds: float = PRIOR_ODDS
    false_alarm_rate: float = FALSE_ALARM_RATE
    thresholds: Thresholds = THRESHOLDS
    scheduler: str | None = None
    budget: float = np.inf
    residual: bool = False
    parts: Checkpoints = field(default_factory=Checkpoints, compare=False)
    after_search: float = 0.0

    @property
    def left(self) -> float:
        """s that are left of the budget."""
        return self.budget - self.parts.elapsed

    @property
    def for_search(self) -> float:
        """s that are left for the search."""
        return self.left - self.after_search

    @property
    def least(self) -> float:
        """Nats that an effect has to gain to be named."""
        return self.thresholds.least(self.prior_odds, self.false_alarm_rate)


# ----------------------------------------------------------------------
# What a diagnosis is made of: parameters, causes, candidates, channels, and what pictures are drawn from.
# ----------------------------------------------------------------------


Array = NDArray[np.float64]

DECADE = math.log(10.0)
"""Nats of a factor of ten."""


@dataclass(frozen=True)
class EffectEstimate:
    """One parameter of an effect as the data give it.

    Attributes
    ----------
    value : float or str
        SI; a name where the parameter is a choice.
    unit : str
    ci95 : (float, float) or None
        95 % interval; None for a choice.
    """

    value: float | str
    unit: str = ""
    ci95: tuple[float, float] | None = None


@dataclass(frozen=True)
class Cause:
    """An effect that the data speak for.

    Attributes
    ----------
    effect : str
        Its id.
    parameters : mapping of str to EffectEstimate
    log10_bayes_factor : float
        Against the model without it.
    holdout_improvement : float
        Fraction by which the noise-weighted mean squared prediction error, less the noise's own share, falls on
        held-out data.
    ties : tuple of str
        Ids of effects that the data cannot tell from it.
    holdout_log10_likelihood : float
        Decades by which held-out data are more likely with it.
    """

    effect: str
    parameters: Mapping[str, EffectEstimate]
    log10_bayes_factor: float
    holdout_improvement: float
    ties: tuple[str, ...] = ()
    holdout_log10_likelihood: float = float("nan")


@dataclass(frozen=True)
class Candidate:
    """How one effect of the vocabulary fared, whether found or not.

    Attributes
    ----------
    effect : str
    log10_bayes_factor : float
        At its best against the re-identified baseline (of what was tried again beside named effects, against the model
        with these); of both views together. Of what was not fitted what the screen gained, its freedom not counted.
    values : mapping of str to float or str
        Where it was best.
    excluded_above : mapping of str to float
        For an effect that was not found: sizes from which the data exclude it, by parameter; empty where it never acts.
    note : str
        One sentence for a person; empty where nothing is to be said.
    fitted : bool
        Whether it was fitted together with the soil, or only screened.
    excluded_below : mapping of str to float
        What `excluded_above` is, of limits: values below which the data exclude them.
    windows : float
        Share of the recordings' windows that its evidence is of: long recordings are searched in some of them, and
        evidence grows with their number.
    """

    effect: str
    log10_bayes_factor: float
    values: Mapping[str, float | str]
    excluded_above: Mapping[str, float] = field(default_factory=dict)
    note: str = ""
    fitted: bool = False
    excluded_below: Mapping[str, float] = field(default_factory=dict)
    windows: float = 1.0


@dataclass(frozen=True)
class ChannelBaseline:
    """How wrong the paper's model is in one channel, its soil identified anew.

    Attributes
    ----------
    unit : str
    rmse : float
        Of predictions over windows.
    noise : float
        The sensor's.
    free_run_rmse : float
        Of runs of whole recordings; NaN where there are none.
    weighted_rmse : float
        As `rmse`, with each error over its own sample's noise, which is larger where what was measured jumps between
        samples; NaN where it is not known.
    """

    unit: str
    rmse: float
    noise: float
    free_run_rmse: float
    weighted_rmse: float = math.nan

    @property
    def over_noise(self) -> float:
        """The error in units of what is known of each sample; inf where there is no noise."""
        if math.isfinite(self.weighted_rmse):
            return self.weighted_rmse
        return self.rmse / self.noise if self.noise > 0 else math.inf


@dataclass(frozen=True)
class ChannelGain:
    """What the extended model is worth in one channel, on held-out data.

    Attributes
    ----------
    unit : str
    before, after : float
        Root mean square errors of window predictions.
    ci95 : (float, float)
        Of before − after.
    median_before, median_after : float
        Medians over windows of the root mean square error of each, which a few windows do not decide, such as those in
        which a localisation was lost. NaN where they are not known.
    median_ci95 : (float, float)
        Of their difference.
    """

    unit: str
    before: float
    after: float
    ci95: tuple[float, float]
    median_before: float = math.nan
    median_after: float = math.nan
    median_ci95: tuple[float, float] = (math.nan, math.nan)


@dataclass(frozen=True)
class Varies:
    """A parameter that has another value in each window: ground that is not the same everywhere.

    Attributes
    ----------
    effect : str
        Id of the effect whose parameter it is; empty for soil.
    parameter : str
        Its name, as in tables.
    spread : float
        Standard deviation over its value.
    between : (float, float)
        Values one standard deviation below and above, SI.
    holdout_nats : float
        By how much held-out windows are likelier with this spread than with none and noise of any size.
    ci95 : (float, float)
        Of that.
    ties : tuple of str
        Parameters whose spread would explain the windows as well.
    over : str
        Where values are alike: near each other in ``"time"`` or in ``"place"``, or in all of a ``"recording"``;
        ``"window"`` where each window has another one.
    length : float
        s or m over which they are alike; 0 for windows and recordings.
    """

    effect: str
    parameter: str
    spread: float
    between: tuple[float, float]
    holdout_nats: float
    ci95: tuple[float, float]
    ties: tuple[str, ...] = ()
    over: str = "window"
    length: float = 0.0

    @property
    def each(self) -> str:
        """What has a value of its own: a window, a place or a recording; a window, too, where values last a while."""
        return "window" if self.over == "time" else self.over


@dataclass(frozen=True)
class ErrorBudget:
    """Shares of the squared error of held-out predictions by the paper's model, one channel; 1 in sum.

    Attributes
    ----------
    explained : float
        What the extended model takes away.
    sensors : float
        Noise of the measurements, were their stamps right.
    timing : float
        What stamps that jitter add while the robot moves.
    ground_varies : float
        What a parameter that differs from window to window gives: no model predicts it.
    learnable : float
        What a model without physics takes away: physics is missing.
    unknown : float
        The rest.
    """

    explained: float
    sensors: float
    timing: float
    ground_varies: float
    learnable: float
    unknown: float


@dataclass(frozen=True)
class Explainable:
    """How much of one channel's error any model could explain: beside the final model's, that of one without physics.

    The latter is learned from the motors' speeds and what the final model predicts, and predicts recordings that it was
    not learned from. What neither explains does not repeat, or follows something that was not measured.

    Attributes
    ----------
    unit : str
    noise : float
        The sensor's.
    model, learned : float
        Root mean square errors of window predictions: of the final model, and with what was learned added to it.
    ci95 : (float, float)
        Of model − learned.
    seconds : float
        Of recordings from which it was learned, all of them.
    """

    unit: str
    noise: float
    model: float
    learned: float
    ci95: tuple[float, float]
    seconds: float

    @property
    def better(self) -> bool:
        """Whether what was learned makes predictions better, surely and by so much that it is worth a word."""
        return self.ci95[0] > 0.0 and self.learned < WORTH_LEARNING * self.model


@dataclass(frozen=True)
class PredictionError:
    """Errors of one channel at the ends of predictions: root mean square in `unit`, of so many."""

    unit: str
    rmse: float
    count: int


@dataclass(frozen=True)
class Predictor:
    """A model that predicts held-out recordings.

    Attributes
    ----------
    name : str
        Which model it is, in words.
    errors : mapping of str to PredictionError
        By channel: position and heading at the ends of predictions.
    robot : Robot or None
        None for a kinematic model, and where only its errors are known.
    kinematic : bool
        Whether it rolls without forces.
    alike : tuple of str
        Names of those that windows drawn anew may put before or behind it, 95 %.
    """

    name: str
    errors: Mapping[str, PredictionError]
    robot: Robot | None = None
    kinematic: bool = False
    alike: tuple[str, ...] = ()

    @property
    def score(self) -> float:
        """Mean logarithm of the errors: less is better, and a tenth is ten per cent; infinite without any."""
        errors = [max(one.rmse, 1e-12) for one in self.errors.values()]
        return float(np.mean(np.log(errors))) if errors else float("inf")

    def is_clearly_worse_than(self, other: Predictor) -> bool:
        """Whether it errs by clearly and surely more than another; False where the errors of one are not known."""
        known = bool(self.errors) and bool(other.errors)
        return known and self.score > other.score + CLEARLY_WORSE and other.name not in self.alike


@dataclass(frozen=True)
class Refusal:
    """A fitted model that predicts held-out recordings clearly worse than another: its file holds a better one.

    Attributes
    ----------
    file : str
        Of the results.
    model : str
        What is refused, by the name of its predictor,
    better : str
        the predictor that is best of those that it is clearly worse than,
    holds : str
        and the model that is in the file instead; `model` itself where only kinematics are better.
    why : str
        A sentence with the errors.
    """

    file: str
    model: str
    better: str
    holds: str
    why: str


@dataclass(frozen=True)
class SlowResidual:
    """What the final model leaves in one channel, slowly, as forces would; 1 is a sensor's white noise.

    Attributes
    ----------
    typical, worst : float
        Mean squares of averaged residuals over those of white noise: of the window in the middle, and the one that a
        tenth of all windows exceed.
    """

    typical: float
    worst: float


@dataclass(frozen=True)
class ErrorLocation:
    """Where and when something is wrong, in one sentence."""

    channel: str
    what: str


@dataclass(frozen=True)
class Unexplained:
    """A force that is on no list: which one, what it follows, and in which form.

    Attributes
    ----------
    force, variable, form : str
    size : float
        Of the law's coefficient or amplitude, in `unit`.
    unit : str
    where : str
        A sentence for a person.
    typical : float
        Root mean square of the force itself, N or N m; NaN where it is none.
    laws : mapping of str to mapping of str to EffectEstimate
        The force, and others beside it, as terms of the model (`effects.force_law`) with their parameters, where they
        could be fitted to whole windows.
    log10_bayes_factor : float
        Of the model with these against the one without; NaN where there are none.
    spans : mapping of str to (float, float)
        Between which values each law's variable mostly was.
    residuals : mapping of str to tuple of (float, float, float)
        Along each law's variable what recordings ask for beside it: value, force (N or N m), standard deviation.
    """

    force: str
    variable: str
    form: str
    size: float
    unit: str
    where: str
    typical: float = float("nan")
    laws: Mapping[str, Mapping[str, EffectEstimate]] = field(default_factory=dict)
    log10_bayes_factor: float = float("nan")
    spans: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    residuals: Mapping[str, tuple[tuple[float, float, float], ...]] = field(default_factory=dict)


@dataclass(frozen=True)
class NextExperiment:
    """A manoeuvre that would tell effects apart.

    Attributes
    ----------
    what : str
        A sentence for a person.
    manoeuvre : str
        Its name in the library of manoeuvres; empty where it is one that was recorded.
    separates : tuple of str
        Ids of effects; empty where there are none to distinguish.
    nats : float
        Log-likelihood ratio to be expected between the two that are hardest to distinguish; NaN without any.
    """

    what: str
    manoeuvre: str
    separates: tuple[str, ...]
    nats: float


@dataclass(frozen=True)
class ErrorSeries:
    """Errors of one channel of one recording over its predictions: before is the paper's model, after the extended.

    Attributes
    ----------
    t : array, shape (n,)
        s since the recording's start.
    before, after : array, shape (n,)
        Predicted − measured, SI; NaN where a prediction was lost. Of positions along x and y: shape (n, 2); so are
        those of two motors.
    noise : float
        Standard deviation of a sample.
    """

    t: Array
    before: Array
    after: Array
    noise: float


@dataclass(frozen=True)
class Comparison:
    """One recording as it was measured and as both models predict it: what pictures are drawn from.

    Attributes
    ----------
    name : str
    held_out : bool
    path : array, shape (n, 3)
        t, x, y as measured.
    before, after : tuple of array, shape (m, 3)
        t, x, y window by window, by the paper's model (soil identified anew) and by the extended one.
    free_before, free_after : tuple of array, shape (m, 3)
        The same in one run from the recording's start; empty where windows are separate.
    left_before, left_after : float or None
        s, when such a run leaves the measured branch.
    channels : mapping of str to ErrorSeries
    covariates : mapping of str to array, shape (k,)
        On one time grid under ``t``: ``speed`` (m/s), ``yaw_rate`` (rad/s), ``heading`` (rad), ``articulation_yaw``
        (rad), ``x``, ``y`` (m), ``load`` (sum of absolute motor torques, N m; NaN where not measured).
    """

    name: str
    held_out: bool
    path: Array
    before: tuple[Array, ...]
    after: tuple[Array, ...]
    free_before: tuple[Array, ...]
    free_after: tuple[Array, ...]
    left_before: float | None
    left_after: float | None
    channels: Mapping[str, ErrorSeries]
    covariates: Mapping[str, Array]
