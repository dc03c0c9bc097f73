"""Words for effects, parameters, channels, amounts and odds: what sentences on a diagnosis are made of."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from artibot_sim.diagnose.records import Candidate, Cause, ChannelBaseline, ChannelGain, EffectEstimate, Unexplained
from artibot_sim.identify.result import number, spaced
from artibot_sim.model.effects import EFFECTS
from artibot_sim.model.effects.force_law import formula, unit_of, variable_words

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
"""Errors over noise from which a channel is wrong: poses carry what their prediction's start was off by."""
_WRONG_ELSEWHERE = 1.5
"""Error over noise from which other channels are wrong: these forget their prediction's start."""
_FORCES = ("N m", "N")
"""Units of forces."""
NOT_NAMED = "so that is not named"
"""How a warning ends that says why an effect has no name."""


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


def parameter_words(name: str, found: EffectEstimate, digits: int = 3) -> str:
    """One parameter with its value; angles also in degrees."""
    if isinstance(found.value, str):
        return f"{effect_words(name)} {effect_words(found.value)}"
    said = f"{effect_words(name)} {amount(found.value, found.unit, digits)}"
    if found.unit == "rad" and np.isfinite(found.value):
        degrees = number(float(np.degrees(found.value)), 2 if abs(found.value) < 1.7 else 3)
        said += f" ({degrees.replace('-', '−')}°)"
    return said


def cause_words(cause: Cause) -> str:
    """An effect with its parameters."""
    said = ", ".join(parameter_words(name, found) for name, found in cause.parameters.items())
    return f"{effect_words(cause.effect)}: {said}" if said else effect_words(cause.effect)


_NUMBER = re.compile(r"\{(\w+)(-1)?(?:\|([^|}]*)\|([^|}]*))?\}")
"""A parameter in an effect's claim: its name, what it counts from, words for either sign."""


def claim_words(cause: Cause) -> str:
    """What a cause says of the rover, to be checked on it; empty where there is no claim, or numbers lack."""

    def said(match: re.Match[str]) -> str:
        name, from_one, positive, negative = match.groups()
        found = cause.parameters[name]
        if isinstance(found.value, str):
            return effect_words(found.value)
        value = found.value - 1.0 if from_one else found.value
        size = abs(value) if positive else value
        share = found.unit in ("", "-", "–")
        words = f"{number(100.0 * size, 2)} %" if share else parameter_words("", replace(found, value=size), 2).strip()
        return f"{words} {positive if value >= 0.0 else negative}" if positive else words

    claim = EFFECTS[cause.effect].claim if cause.effect in EFFECTS else ""
    known = all(name in cause.parameters for name, *_ in _NUMBER.findall(claim))
    return _NUMBER.sub(said, claim) if known else ""


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


def law_words(parameters: Mapping[str, EffectEstimate]) -> str:
    """A law as a formula with numbers and the intervals of those that were fitted: what the model has as a term."""
    values = {name: found.value for name, found in parameters.items()}
    followed = {"scale": "variable", "times_scale": "times"}
    intervals = []
    for name, found in parameters.items():
        if found.ci95 is None or not all(np.isfinite(found.ci95)):
            continue
        unit = unit_of(str(values["where"])) if name == "size" else found.unit
        if name in followed:
            unit = variable_words(str(values[followed[name]]))[1]
        low, high = found.ci95
        intervals.append(f"{effect_words(name)} {low:.3g} to {high:.3g} {spaced(unit)}".rstrip())
    return f"{formula(values)} ({', '.join(intervals)})" if intervals else formula(values)


def differing(how: str) -> str:
    """That recordings ask for soils of their own, and how these differ."""
    return f"the ground is not the same in all recordings: {how}"


def degrees(value: float) -> str:
    return f"{number(float(np.degrees(value)), 2)}°"


def is_wrong(channel: str, base: ChannelBaseline) -> bool:
    """Whether a channel is off by so much more than its noise that it is worth a word."""
    return base.noise > 0.0 and base.over_noise > _WRONG.get(channel, _WRONG_ELSEWHERE)


def lost(gain: ChannelGain) -> float:
    """Share of its error that a channel loses."""
    return lost_share(gain.before, gain.after)


def lost_share(before: float, after: float) -> float:
    """Share of an error that is lost."""
    return 1.0 - after / before if before > 0 else 0.0


def windows_words(candidate: Candidate) -> str:
    """Of how many of the windows a candidate's evidence is; empty where it is of all."""
    return "" if candidate.windows >= 1.0 else f"{100 * candidate.windows:.0f} % of the windows"


def odds(log10: float) -> str:
    """A Bayes factor for people."""
    if not np.isfinite(log10):
        return "unknown"
    if abs(log10) < 2.0:
        return f"{number(10.0**log10, 2)} to 1" if log10 >= 0 else f"1 to {number(10.0**-log10, 2)}"
    return f"10{_power(round(log10))} to 1"


def _power(exponent: int) -> str:
    return str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def way_words(left: float | None) -> str:
    return "stays on the measured branch" if left is None else f"leaves the measured branch at {left:.1f} s"


def excluded_words(candidate: Candidate, units: Mapping[str, str]) -> str:
    """Which sizes of an effect are excluded; empty where none are."""
    said = []
    for side, sizes in (("from", candidate.excluded_above), ("below", candidate.excluded_below)):
        said += [f"{effect_words(name)} {side} {amount(size, units.get(name, ''))}" for name, size in sizes.items()]
    return ", ".join(said)


# ----------------------------------------------------------------------
# Why something is not named, or may not be all: the first warnings of a diagnosis, in sentences.
# ----------------------------------------------------------------------


def doubt(effects: Sequence[str], channels: Sequence[str]) -> str:
    """Why effects that were fitted best are not named: what they leave is another thing."""
    names, where = ([effect_words(name) for name in effects], [channel_words(name) for name in channels])
    return (
        f"{joined(names)} would explain the fitted recordings best, but with that far more than noise is left in "
        f"{joined(where)}, for which no force was found; {NOT_NAMED}"
    )


def besides(effects: Sequence[str], channels: Sequence[str], forces: bool) -> str:
    """That something else may act beside what is named; `forces` says whether it would show as a force."""
    names, where = ([effect_words(name) for name in effects], [channel_words(name) for name in channels])
    if not forces:
        return (
            f"with {joined(names)} more than noise is still left in {joined(where)}: ground that varies, or something "
            "else as well; wheel speeds and poses do not tell these apart, recorded torques would"
        )
    return (
        f"with {joined(names)} more than noise is still left in {joined(where)}, and no force was found for it: "
        "something else may act as well"
    )


def partly(names: Sequence[str], unexplained: Sequence[str]) -> list[str]:
    """That the paper's model explains some recordings by themselves; empty where it is none or all of them."""
    explained = [name for name in names if name not in unexplained]
    if not (explained and unexplained):
        return []
    itself, them = ("itself" if len(explained) == 1 else "themselves"), ("that" if len(unexplained) == 1 else "these")
    said = f"the paper's model explains {joined(explained)} by {itself}, but not {joined(unexplained)}"
    return [f"{said}: diagnose {them} apart"]


def refutation(effects: Sequence[str], gain: Mapping[str, ChannelGain]) -> str:
    """Why effects that were fitted best are not named: with them, held-out data are predicted worse."""
    return (
        f"{joined([effect_words(name) for name in effects])} would explain the fitted recordings, but held-out ones "
        f"are predicted worse with that: {_errors(gain)}; {NOT_NAMED}"
    )


def refuted_beside(effect: str, others: Sequence[str], grown: float) -> str:
    """Why an effect is not named that was found beside others: the held-out error beyond noise has `grown` by it."""
    size = f": the error beyond noise grows by {100 * grown:.0f} %" if np.isfinite(grown) else ""
    return (
        f"{effect_words(effect)} would explain the fitted recordings beside "
        f"{joined([effect_words(name) for name in others])}, but held-out ones are predicted worse with it{size}; "
        f"{NOT_NAMED}"
    )


def shortfall(effects: Sequence[str], gain: Mapping[str, ChannelGain]) -> str:
    """Why effects that were fitted best are not named: most of the error is still there with them."""
    return (
        f"{joined([effect_words(name) for name in effects])} would explain the recordings best, but with that most "
        f"of the error is left in held-out ones: {_errors(gain)}; {NOT_NAMED}"
    )


def _errors(gain: Mapping[str, ChannelGain]) -> str:
    errors = []
    for name, one in gain.items():
        before, after = amount(one.before, one.unit, 3), amount(one.after, one.unit, 3)
        errors += [f"{channel_words(name)} {before} to {after}"] if before != after else []
    return f"RMSE of {joined(errors)}" if errors else "by too little to show in three digits of any channel"
