"""A diagnosis in sentences: what stands at the head of the page and of the terminal's tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from artibot_sim.diagnose.diagnosis import (
    Candidate,
    Cause,
    ChannelBaseline,
    ChannelGain,
    Diagnosis,
    Found,
    Unexplained,
    Verdict,
)
from artibot_sim.diagnose.options import HORIZON
from artibot_sim.diagnose.remains import beyond_noise
from artibot_sim.identify.printing import number, spaced

CHANNEL_WORDS = {
    "position": "position", "yaw": "heading", "yaw_rate": "yaw rate", "articulation_yaw": "articulation angle",
    "front_velocity": "front motors' speed", "torque_front": "front motors' torque",
    "torque_back": "back motors' torque",
}  # fmt: skip
"""Channel of the contract → what people call it."""
RECORDING = "recording"
"""What contact forces follow where each recording has a soil of its own."""
NOTHING = "nothing"
"""What a constant force follows."""
_WRONG = {"position": 3.0, "yaw": 3.0}
"""Errors over noise from which a channel is wrong: poses carry what their prediction's start was off by,"""
_WRONG_ELSEWHERE = 1.5
"""the others forget it."""
_MOST = 0.5
"""Share of its error that the position must lose to stand for all channels."""
_FORCES = ("N m", "N")
"""Units of forces."""
_FEW = 3
"""Effects that are listed one by one in a sentence."""


def effect_words(effect: str) -> str:
    """What people call an effect: its id with spaces."""
    return effect.replace("_", " ")


def channel_words(channel: str) -> str:
    """What people call a channel."""
    return CHANNEL_WORDS.get(channel, channel.replace("_", " "))


def joined(words: Sequence[str], last: str = "and") -> str:
    """A list as it is said: a, b and c."""
    return f" {last} ".join(filter(None, (", ".join(words[:-1]), *words[-1:])))


def amount(value: float, unit: str, digits: int = 2) -> str:
    """A quantity for people: small lengths in mm or cm, no unit where there is none."""
    if unit == "m" and np.isfinite(value) and abs(value) < 1.0:
        said = f"{number(1e3 * value, digits)} mm" if abs(value) < 0.01 else f"{number(1e2 * value, digits)} cm"
    else:
        said = number(value, digits) + (f" {spaced(unit)}" if unit not in ("", "-", "–", "1") else "")
    return said.replace("-", "−", 1) if value < 0 else said


def parameter_words(name: str, found: Found, digits: int = 3) -> str:
    """One parameter with its value; angles also in degrees."""
    if isinstance(found.value, str):
        return f"{effect_words(name)} {effect_words(found.value)}"
    said = f"{effect_words(name)} {amount(found.value, found.unit, digits)}"
    if found.unit == "rad" and np.isfinite(found.value):
        said += f" ({number(float(np.degrees(found.value)), 2 if abs(found.value) < 1.7 else 3)}°)"
    return said


def cause_words(cause: Cause) -> str:
    """An effect with its parameters."""
    said = ", ".join(parameter_words(name, found) for name, found in cause.parameters.items())
    return f"{effect_words(cause.effect)}: {said}" if said else effect_words(cause.effect)


def headline(found: Diagnosis) -> str:
    """The diagnosis in one sentence, or two."""
    if found.verdict is Verdict.NAMED:
        first = f"{'; and '.join(cause_words(cause) for cause in found.causes)}."
    elif found.verdict is Verdict.AMBIGUOUS:
        first = f"{_either(found)}: these recordings cannot tell which."
    elif found.verdict is Verdict.UNEXPLAINED:
        first = _unexplained(found)
    else:
        first = "No effect explains these recordings better than the paper's model does once its soil is identified."
    return f"{first[:1].upper()}{first[1:]} {gain_words(found)}".strip()


def _either(found: Diagnosis) -> str:
    if not found.causes:
        return "several effects tie"
    names = [effect_words(name) for name in (found.causes[0].effect, *found.causes[0].ties)]
    if len(names) > _FEW:
        names = [*names[:_FEW], f"{len(names) - _FEW} more"]
    return f"either {joined(names, 'or')}" if len(names) > 1 else names[0]


def _unexplained(found: Diagnosis) -> str:
    what = found.unexplained
    named = "".join(f"{cause_words(cause)}; and " for cause in found.causes)
    if what is None:
        return f"{named}something that is on no list of effects{_still_left(found)}."
    if what.variable == RECORDING:
        return f"{named}{differing(f'each asks for a soil of its own, up to {100 * what.size:.0f} % apart')}."
    return f"{named}something that is on no list: a {force_words(what)}."


def force_words(what: Unexplained) -> str:
    """A force with its size: what a law's coefficient comes to, for nobody has a feeling for N s²/m²."""
    force, variable = effect_words(what.force), effect_words(what.variable)
    if what.variable == NOTHING:
        return f"constant {force} of {amount(what.size, what.unit)}"
    law = f"that follows {variable} ({what.form})"
    if what.unit in _FORCES and np.isfinite(what.size):
        return f"{force} of {amount(what.size, what.unit)} {law}"
    own = next((unit for unit in _FORCES if what.unit.startswith(unit)), "")
    return f"{force} {law}, {amount(what.typical, own)} on average" if np.isfinite(what.typical) else f"{force} {law}"


def _still_left(found: Diagnosis) -> str:
    """Where something shows that no force explains; empty where it is not known."""
    where = [channel_words(name) for name in beyond_noise(found.left)]
    return f", and for which no force was found: more than noise is left in {joined(where)}" if where else ""


def differing(how: str) -> str:
    """That recordings ask for soils of their own, and how these differ."""
    return f"the ground is not the same in all recordings: {how}"


def gain_words(found: Diagnosis) -> str:
    """What it is worth, in the channel that says most; of nothing, how well the paper's model does."""
    channel = headline_channel(found)
    if channel is None:
        return ""
    ahead = f"predictions {found.horizon:g} s ahead"
    where = " of held-out data" if found.holdout else ""
    words = channel_words(channel)
    gain = found.gain.get(channel)
    if found.causes and gain is not None and gain.after < gain.before:
        with_it = "either" if found.verdict is Verdict.AMBIGUOUS else "it" if len(found.causes) == 1 else "them"
        with_it = "what has a name" if found.verdict is Verdict.UNEXPLAINED else with_it
        return (
            f"With {with_it}, {ahead}{where} miss the {words} by {amount(gain.after, gain.unit)} "
            f"instead of {amount(gain.before, gain.unit)}."
        )
    base = found.baseline[channel]
    whose = "Its" if found.verdict is Verdict.NONE else "The paper's model's"
    return (
        f"{whose} {ahead} miss the {words} by {amount(base.rmse, base.unit)}; the sensor's noise is "
        f"{amount(base.noise, base.unit)}."
    )


def headline_channel(found: Diagnosis) -> str | None:
    """The channel that says most about a diagnosis: the position where it gains much, else the one that gains most.

    Where nothing gains, what is wrong: the position if it is, or else what errs most beside its noise.
    """
    position = found.gain.get("position") if "position" in found.baseline else None
    if position is not None and is_wrong("position", found.baseline["position"]) and lost(position) > _MOST:
        return "position"
    gains = {name: _gain(found, name, gain) for name, gain in found.gain.items() if name in found.baseline}
    if gains and max(gains.values()) > 1.0:
        return max(gains, key=lambda name: gains[name])
    base = found.baseline.get("position")
    if base is not None and (found.verdict is not Verdict.UNEXPLAINED or is_wrong("position", base)):
        return "position"
    return max(found.baseline, key=lambda name: excess(found, name), default=None)


def is_wrong(channel: str, base: ChannelBaseline) -> bool:
    """Whether a channel is off by so much more than its noise that it is worth a word."""
    return base.rmse > _WRONG.get(channel, _WRONG_ELSEWHERE) * base.noise > 0.0


def excess(found: Diagnosis, channel: str) -> float:
    """Error of the paper's model in a channel over the sensor's noise."""
    base = found.baseline[channel]
    return base.rmse / base.noise if base.noise > 0 else float("inf")


def lost(gain: ChannelGain) -> float:
    """Share of its error that a channel loses."""
    return 1.0 - gain.after / gain.before if gain.before > 0 else 0.0


def _gain(found: Diagnosis, channel: str, gain: ChannelGain) -> float:
    """What a channel gains, in units of its noise."""
    noise = found.baseline[channel].noise
    return float(np.sqrt(max(gain.before**2 - gain.after**2, 0.0)) / noise) if noise > 0 else 0.0


def sureness(found: Diagnosis) -> str:
    """How sure it is: against chance, against the best other effect, and on data that were not fitted."""
    if not found.causes:
        best = max(found.ranking, key=lambda c: c.log10_bayes_factor, default=None)
        return "" if best is None else f"The best of {len(found.ranking)} known effects is {_rival(best)}."
    cause = found.causes[0]
    parts = [f"Evidence for {effect_words(cause.effect)} over the model without it: {odds(cause.log10_bayes_factor)}."]
    rival = best_rival(found)
    if rival is not None:
        parts.append(f"The best other effect is {_rival(rival)}.")
    if np.isfinite(cause.holdout_improvement):
        share = 100 * cause.holdout_improvement
        if share <= -0.5:
            parts.append(f"On held-out data it predicts worse: the error beyond noise grows by {-share:.0f} %.")
        else:
            parts.append(f"Of the error beyond noise on held-out data it removes {share:.0f} %.")
    if np.isfinite(told := cause.holdout_log10_likelihood):
        parts.append(f"Held-out data speak {'for' if told >= 0 else 'against'} it, {odds(abs(told))}.")
    return " ".join(parts)


def best_rival(found: Diagnosis) -> Candidate | None:
    """The best effect that is neither a cause nor tied with one."""
    named = {name for cause in found.causes for name in (cause.effect, *cause.ties)}
    others = [candidate for candidate in found.ranking if candidate.effect not in named]
    return max(others, key=lambda candidate: candidate.log10_bayes_factor, default=None)


def _rival(candidate: Candidate) -> str:
    return f"{effect_words(candidate.effect)}, {odds(candidate.log10_bayes_factor)}"


def asked(found: Diagnosis) -> str:
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


def odds(log10: float) -> str:
    """A Bayes factor for people."""
    if not np.isfinite(log10):
        return "unknown"
    if abs(log10) < 2.0:
        return f"{number(10.0**log10, 2)} to 1" if log10 >= 0 else f"1 to {number(10.0**-log10, 2)}"
    return f"10{_power(round(log10))} to 1"


def _power(exponent: int) -> str:
    return str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def branch_words(found: Diagnosis) -> list[str]:
    """Sentences on free runs: which branch each took."""
    said = []
    for look in found.looks:
        runs = [("the paper's model", look.free_before, look.left_before)]
        if found.causes:  # else both models are one
            runs.append(("the extended model", look.free_after, look.left_after))
        ways = [f"{name} {_way(left)}" for name, run, left in runs if run]
        if ways:
            said.append(f"{look.name}: {joined(ways)}.")
    return said


def _way(left: float | None) -> str:
    return "stays on the measured branch" if left is None else f"leaves the measured branch at {left:.1f} s"


def excluded_words(candidate: Candidate, units: Mapping[str, str]) -> str:
    """Which sizes of an effect are excluded; empty where none are."""
    said = []
    for side, sizes in (("from", candidate.excluded_above), ("below", candidate.excluded_below)):
        said += [f"{effect_words(name)} {side} {amount(size, units.get(name, ''))}" for name, size in sizes.items()]
    return ", ".join(said)
