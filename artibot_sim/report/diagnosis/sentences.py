"""A diagnosis in sentences: what stands at the head of its page and of the terminal's tables."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from artibot_sim.diagnose.policy import HORIZON
from artibot_sim.diagnose.records import (
    BASELINE,
    DECADE,
    EXTENDED,
    FILES,
    Candidate,
    Cause,
    ChannelBaseline,
    ChannelGain,
    Unexplained,
)
from artibot_sim.diagnose.remains import COMMANDED, beyond_noise
from artibot_sim.diagnose.result import Diagnosis
from artibot_sim.diagnose.verdict import Verdict
from artibot_sim.diagnose.words import (
    NOT_NAMED,
    RECORDING,
    amount,
    cause_words,
    channel_words,
    claim_words,
    degrees,
    differing,
    effect_words,
    force_words,
    is_wrong,
    joined,
    lost,
    odds,
    way_words,
    windows_words,
)
from artibot_sim.identify.result import number
from artibot_sim.model.effects import EFFECTS

_MOST = 0.5
"""Share of its error that the position must lose to stand for all channels."""
_FEW = 3
"""Effects that are listed one by one in a sentence."""


def headline(found: Diagnosis) -> str:
    """The diagnosis in one sentence, or two."""
    if found.verdict in (Verdict.NAMED, Verdict.AMBIGUOUS):
        force = found.unexplained
        first = f"{_causes(found)}{f'; and beside it {_on_no_list(force)}' if force is not None else ''}."
    elif found.verdict is Verdict.UNEXPLAINED:
        first = _unexplained(found)
    else:
        first = "No effect explains these recordings better than the paper's model does once its soil is identified."
    return f"{first[:1].upper()}{first[1:]} {gain_words(found)}".strip()


def _causes(found: Diagnosis) -> str:
    """What is sure first, then what ties, and which of those the extended model has."""
    said = cause_phrases(found)
    if not said:
        return "several effects tie: these recordings cannot tell which"
    return _one_by_one(said) + which_words(found)


def cause_phrases(found: Diagnosis) -> list[str]:
    """Each cause by itself: those that are sure, then what ties."""
    tied = [cause for cause in found.causes if cause.ties]
    return [*(cause_words(cause) for cause in found.causes if not cause.ties), *map(_either, tied)]


def which_words(found: Diagnosis) -> str:
    """That it is not known which of those that tie it is, and which the extended model has; empty where none ties."""
    tied = _names([cause for cause in found.causes if cause.ties])
    if not tied:
        return ""
    which = ": these recordings cannot tell which"
    return which if found.refusal is not None else f"{which}, extended.yaml has {joined(tied)}"


def _one_by_one(said: Sequence[str]) -> str:
    """A list of phrases that have commas of their own: a; b; and c."""
    return "; and ".join(filter(None, ("; ".join(said[:-1]), *said[-1:])))


_ROLLED = {"encoder_scale": "wheel_radius", "wheel_radius": "encoder_scale"}
"""Effects of all wheels' rolling that are the same on the ground: only commands and torques may tell them apart."""


def _circumference(found: Diagnosis) -> str:
    """What tells an encoder scale from a wheel radius, and the mend in either case; empty where they do not tie.

    A wheel of r / scale goes as far as one of r whose recorded rotations are `scale` times the true ones.
    """
    tied = next((cause for cause in found.causes if _ROLLED.get(cause.effect) in cause.ties), None)
    if tied is None:
        return ""
    scale = float(tied.parameters["scale"].value)
    radius = found.robot.wheel.r_w * (scale if tied.effect == "wheel_radius" else 1.0 / scale)
    return (
        "Wheel speeds and poses cannot tell an encoder scale from another wheel radius: mark a loaded wheel and roll "
        f"it one turn. If it goes {2.0 * np.pi * radius:.3f} m, put {radius:.3f} m into wheel.r_w of the robot file; "
        "otherwise mend the counts a turn."
    )


def _names(causes: Sequence[Cause]) -> list[str]:
    return [effect_words(cause.effect) for cause in causes]


def _either(cause: Cause) -> str:
    names = [effect_words(name) for name in (cause.effect, *cause.ties)]
    if len(names) > _FEW:
        names = [*names[:_FEW], f"{len(names) - _FEW} more"]
    return f"either {joined(names, 'or')}"


def _unexplained(found: Diagnosis) -> str:
    what = found.unexplained
    named = "".join(f"{cause_words(cause)}; and " for cause in found.causes)
    if what is None:
        return f"{named}{_still_left(found)}."
    if what.variable == RECORDING:
        return f"{named}{differing(f'each asks for a soil of its own, up to {100 * what.size:.0f} % apart')}."
    return f"{named}{_on_no_list(what)}."


def _on_no_list(what: Unexplained) -> str:
    return f"something that is on no list: a {force_words(what)}"


def _still_left(found: Diagnosis) -> str:
    """Where something shows that no effect and no force explains."""
    where = [channel_words(name) for name in beyond_noise(found.left)]
    what = f"more than noise is left in {joined(where)}" if where else "something is wrong with the model"
    if tuple(beyond_noise(found.left)) == (COMMANDED,):
        return f"{what}: these motors do not do what they are commanded, for no known reason"
    return f"{what}, and no known effect and no force explains it"


_PLACES = {
    "environment": "the site", "contact": "the ground and the wheels", "body": "the load", "joint": "the articulation",
    "drive": "the motors", "command": "the drives' settings", "sensor": "the sensors",
}  # fmt: skip
"""Where an effect acts → where to look for it."""
_IN_ONE_LINE = 2
"""Causes at most whose checks are said in one line."""


def _places(causes: Sequence[Cause]) -> str:
    """Where to look for causes: the robot's file in any case."""
    known = [_PLACES.get(EFFECTS[cause.effect].acts, "the rover") for cause in causes if cause.effect in EFFECTS]
    return joined([*dict.fromkeys(known), "the robot file"])


def _checks(causes: Sequence[Cause]) -> str:
    """What to look at on the rover: what each cause claims of it, and where those act that claim nothing plain.

    Of many causes the first one alone, for each stands above with what it claims.
    """
    first = causes if len(causes) <= _IN_ONE_LINE else causes[:1]
    claims = [claim for cause in first if (claim := claim_words(cause))]
    others = [cause for cause in first if not claim_words(cause)]
    said = [f"whether {'; whether '.join(claims)}"] if claims else []
    if others:
        said.append(f"{_places(others)} for {joined(_names(others))}")
    rest = f", then what the other {len(causes) - 1} causes claim" if len(first) < len(causes) else ""
    return f"Check {'; and '.join(said)}{rest}"


def next_step(found: Diagnosis) -> str:
    """What to do with the answer, in one line."""
    if found.verdict is Verdict.NAMED:
        check = f"{_checks(found.causes)}. Until then {_predict_with(found, EXTENDED)}."
        advice = found.next_experiment.what if found.next_experiment is not None else ""
        return f"{check} {_circumference(found) or advice}".rstrip()
    if found.verdict is Verdict.NONE:
        return f"There is nothing to mend: {_predict_with(found, BASELINE)}, and record what was not driven yet."
    advice = found.next_experiment.what if found.next_experiment is not None else ""
    if found.verdict is Verdict.UNEXPLAINED and tuple(beyond_noise(found.left)) == (COMMANDED,):
        advice = "Compare ramps, filters and limits set in the front drives with what is commanded."
    advice = (
        _circumference(found)
        or advice
        or "Record once more, with motor torques, a gyroscope and the articulation angle where they lack."
    )
    return f"{advice} Until then {_predict_with(found, '')}." if found.predictors else advice


def _predict_with(found: Diagnosis, usual: str) -> str:
    """What to predict with: the `usual` model where no other is clearly better on held-out data."""
    best = next((one for one in found.predictors if one.name == found.best), None)
    rolling = min((one for one in found.predictors if one.kinematic), key=lambda one: one.score, default=None)
    if best is not None and rolling is not None and best.is_clearly_worse_than(rolling):
        return f"predict with {rolling.name}: no dynamic model is as good here"
    mine = next((one for one in found.predictors if one.name == usual), None)
    if not usual or (best is not None and mine is not None and mine.is_clearly_worse_than(best)):
        return "simulate with best.yaml"
    return f"simulate with {FILES[usual]}"


def gain_words(found: Diagnosis) -> str:
    """What it is worth, in the channel that says most; of nothing, how well the paper's model does."""
    channel = headline_channel(found)
    if channel is None:
        return ""
    ahead = f"predictions {found.horizon:g} s ahead"
    where = " of held-out data" if found.holdout else ""
    words = channel_words(channel)
    gain = found.gain.get(channel)
    if found.refusal is not None:
        better = found.refusal.better
        return f"{better[:1].upper()}{better[1:]} predicts held-out data better: extended.yaml is refused."
    if found.extends and gain is not None and gain.after < gain.before:
        with_it = "them" if len(found.causes) > 1 else "either" if found.verdict is Verdict.AMBIGUOUS else "it"
        if found.verdict is Verdict.UNEXPLAINED:
            with_it = "what has a name" if found.causes else "it as a law of the model"
        return (
            f"With {with_it}, {ahead}{where} miss the {words} by {amount(gain.after, gain.unit)} "
            f"instead of {amount(gain.before, gain.unit)}."
        )
    base = found.baseline[channel]
    whose = "its" if found.verdict is Verdict.NONE else "the paper's model's"
    return (
        f"Over all recordings {whose} {ahead} miss the {words} by {amount(base.rmse, base.unit)}; "
        f"the sensor's noise is {amount(base.noise, base.unit)}{_where_it_jumps(base)}."
    )


def _where_it_jumps(base: ChannelBaseline) -> str:
    """That an error above the sensor's noise is none where each sample's own noise is asked; else empty."""
    if not base.over_noise <= 1.0 < base.rmse / max(base.noise, 1e-300):
        return ""
    return ", more where what is measured jumps: in all the error is no more than noise"


def explainable_words(found: Diagnosis) -> str:
    """How well predictions could be at best, beside how well they are; empty where that is not known.

    A channel whose errors are within its noise has nothing else to explain.
    """
    if not found.explainable:
        return ""
    within = [channel_words(name) for name, one in found.explainable.items() if one.model <= one.noise]
    nothing = f"nothing of {joined(within)}: this model errs by less than the sensor's noise" if within else ""
    if len(within) == len(found.explainable):
        return f"{nothing}."
    said = [nothing] if within else []
    for name, one in found.explainable.items():
        if one.model <= one.noise:
            continue
        angle = one.unit == "rad"
        errors = [degrees(value) if angle else amount(value, one.unit) for value in (one.noise, one.model)]
        best = degrees(one.learned) if angle else amount(one.learned, one.unit)
        last = (
            f"the best that any model could do from what was measured, about {best}"
            if one.better
            else "nothing better could be learned"
        )
        said.append(f"{channel_words(name)}: noise {errors[0]} · this model {errors[1]} · {last}")
    minutes = number(next(iter(found.explainable.values())).seconds / 60.0, 2)
    return f"{'; '.join(said)} (over all {minutes} min of recordings, predicted {found.horizon:g} s ahead)."


_PARTS = {
    "explained": "what is named takes away", "sensors": "noise of the sensor", "timing": "jitter of stamps",
    "ground_varies": "ground that varies", "learnable": "learnable, so physics is missing", "unknown": "unknown",
}  # fmt: skip
"""Parts of an `ErrorBudget`, in words."""


def budget_words(found: Diagnosis) -> str:
    """Where the squared error of held-out predictions comes from, of channels that err by clearly more than noise."""
    said = []
    for name, one in found.error_budget.items():
        if not is_wrong(name, found.baseline[name]):
            continue
        parts = [f"{100 * vars(one)[key]:.0f} % {words}" for key, words in _PARTS.items() if vars(one)[key] >= 0.005]
        said.append(f"{channel_words(name)}: {', '.join(parts)}")
    return f"of the squared error of held-out predictions, {'; '.join(said)}." if said else ""


def varies_words(found: Diagnosis) -> str:
    """That a parameter of the ground differs from window to window; empty where none does."""
    one = found.varies
    if one is None:
        return ""
    what = " or ".join([f"{one.effect}.{one.parameter}" if one.effect else one.parameter, *one.ties])
    low, high = (number(value) for value in one.between)
    over = one.each
    return (
        f"from {over} to {over} {what} has another value, by ±{100 * one.spread:.0f} % (two of three between {low} and "
        f"{high}); held-out windows are likelier so by {number(one.holdout_nats, 2)} nats. "
        f"{_LASTS[one.over].format(number(one.length, 2))}"
    )


_LASTS = {
    "window": "No model predicts which value comes next.",
    "time": "Values last: they are alike for some {} s, so what was found a moment ago holds for the next one.",
    "place": "Values belong to places: they are alike within some {} m, so a map of the ground would know them.",
    "recording": "Values are alike within a recording: identify this parameter anew each time.",
}
"""What values that differ are alike in → what follows from it."""


def headline_channel(found: Diagnosis) -> str | None:
    """The channel that says most about a diagnosis: the position where it gains much, else the one that gains most.

    Where nothing gains, what is wrong: the position if it is, or else what errs most beside its noise.
    """
    position = found.gain.get("position") if "position" in found.baseline else None
    if position is not None and is_wrong("position", found.baseline["position"]) and lost(position) > _MOST:
        return "position"
    gains = {name: _gain_over_noise(found, name, gain) for name, gain in found.gain.items() if name in found.baseline}
    if gains and max(gains.values()) > 1.0:
        return max(gains, key=lambda name: gains[name])
    base = found.baseline.get("position")
    if base is not None and (found.verdict is not Verdict.UNEXPLAINED or is_wrong("position", base)):
        return "position"
    return max(found.baseline, key=lambda name: found.baseline[name].over_noise, default=None)


def _gain_over_noise(found: Diagnosis, channel: str, gain: ChannelGain) -> float:
    """By how much a channel's error falls, over its noise."""
    noise = found.baseline[channel].noise
    return float(np.sqrt(max(gain.before**2 - gain.after**2, 0.0)) / noise) if noise > 0 else 0.0


def sureness(found: Diagnosis) -> str:
    """How sure it is: against chance, against the best other effect, and on data that were not fitted."""
    if not found.causes:
        best = max(found.ranking, key=lambda c: c.log10_bayes_factor, default=None)
        if best is None:
            return ""
        takes = f"; a name takes {odds(found.threshold / DECADE)}" if found.threshold > 0.0 else ""
        return f"The best of {len(found.ranking)} known effects is {_rival(best)}{takes}."
    cause = found.causes[0]
    parts = [f"Evidence for {effect_words(cause.effect)} over the model without it: {odds(cause.log10_bayes_factor)}."]
    rival = best_rival(found)
    if rival is not None:
        parts.append(f"The best other effect is {_rival(rival)}.")
    it = "it" if len(found.causes) == 1 else "them"
    parts += _held_out_errors(found, it)
    stated = sum(one.holdout_log10_likelihood for one in found.causes)
    if np.isfinite(stated):
        way = "for" if stated >= 0.0 else "against"
        parts.append(f"Held-out data speak {way} {it}, {odds(abs(stated))}{_surely(found, stated)}.")
    return " ".join(parts)


def _surely(found: Diagnosis, stated: float) -> str:
    """How sure the sign is of what held-out data state; empty where their windows say nothing of it."""
    if found.holdout_likelier is None:
        return ""
    least = min(found.holdout_likelier) if stated >= 0.0 else -max(found.holdout_likelier)
    return f" (surely: at least {odds(least)})" if least > 0.0 else " (not sure)"


def _held_out_errors(found: Diagnosis, it: str) -> list[str]:
    """By how much the error changes in each channel that errs beyond its noise; `it` are the causes.

    Channels are not summed: the one with the least noise would decide, whatever the others gain.
    """
    changes = []
    for name, gain in found.gain.items():
        base = found.baseline.get(name)
        if base is None or gain.before <= base.noise:
            continue
        low, high = gain.ci95
        unsure = " (not sure)" if low <= 0.0 <= high else ""
        changes.append(
            f"{channel_words(name)} {100 * (gain.after / gain.before - 1.0):+.0f} %{unsure}".replace("-", "−")
        )
    return [f"Held-out errors with {it}: {', '.join(changes)}."] if changes else []


def not_named(found: Diagnosis) -> str:
    """Why effects whose evidence is beyond what a name takes have none; empty where there are no such effects.

    The strongest are listed, those with the same reason together.
    """
    if not found.threshold > 0.0:
        return ""
    named = {name for cause in found.causes for name in (cause.effect, *cause.ties)}
    strong = [c for c in found.ranking if c.effect not in named and c.log10_bayes_factor >= found.threshold / DECADE]
    strong = sorted((c for c in strong if np.isfinite(c.log10_bayes_factor)), key=lambda c: -c.log10_bayes_factor)
    if not strong:
        return ""
    reasons: dict[str, list[str]] = {}
    for one in strong[:_FEW]:
        reasons.setdefault(_why_not(found, one), []).append(effect_words(one.effect))
    said = [f"{joined(names)} ({why})" for why, names in reasons.items()]
    said += [f"{len(strong) - _FEW} more (see Why)"] if len(strong) > _FEW else []
    return f"Beyond the evidence that a name takes, and yet not named: {'; '.join(said)}."


def _why_not(found: Diagnosis, candidate: Candidate) -> str:
    """Why a strong effect is not named: its own reason, or the one that its kind of verdict has."""
    if candidate.note:
        return candidate.note
    if any(effect_words(candidate.effect) in line and NOT_NAMED in line for line in found.warnings):
        return "the doubts about the data say why"
    if found.causes:
        many = len(found.causes) > _FEW
        return f"explained better by {'what is named' if many else joined(_names(found.causes))}"
    if not candidate.fitted:
        return "only screened, where it was weaker than those that were fitted"
    return "held-out data, or what it leaves, speak against it"


def best_rival(found: Diagnosis) -> Candidate | None:
    """The best effect that is neither a cause nor tied with one."""
    named = {name for cause in found.causes for name in (cause.effect, *cause.ties)}
    others = [candidate for candidate in found.ranking if candidate.effect not in named]
    return max(others, key=lambda candidate: candidate.log10_bayes_factor, default=None)


def _rival(candidate: Candidate) -> str:
    some = windows_words(candidate)
    return f"{effect_words(candidate.effect)}, {odds(candidate.log10_bayes_factor)}{some and f' in {some}'}"


def threshold_words(found: Diagnosis) -> str:
    """How much evidence a name takes, and what that follows from; empty where it is not known."""
    if not found.threshold > 0.0 or not found.false_alarm_rate > 0.0:
        return ""
    return (
        f"An effect is named from {found.threshold:.0f} nats on, or more where the sensors' own errors look like it: "
        f"prior odds {found.prior_odds:g}, false alarms accepted in {100 * found.false_alarm_rate:.3g} % of recordings "
        "with nothing hidden." + _beyond(found.horizon)
    )


def _beyond(horizon: float) -> str:
    """That evidence of windows of another length is weighed by limits which were not found for it."""
    if horizon == HORIZON:
        return ""
    return f" That was found for predictions {HORIZON:g} s ahead, these are {horizon:g} s ahead."


def branch_words(found: Diagnosis) -> list[str]:
    """Sentences on free runs: which branch each took."""
    said = []
    for comparison in found.comparisons:
        runs = [("the paper's model", comparison.free_before, comparison.left_before)]
        if found.extends:  # else both models are one
            runs.append(("the extended model", comparison.free_after, comparison.left_after))
        ways = [f"{name} {way_words(left)}" for name, run, left in runs if run]
        if ways:
            said.append(f"{comparison.name}: {joined(ways)}.")
    return said
