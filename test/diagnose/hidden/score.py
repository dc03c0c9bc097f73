"""One answer against the truth. The answer is a diagnosis' dictionary; the truth is known here alone."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from math import hypot, inf, pi
from typing import Any

from diagnose.hidden.unlisted import ACTS_ON

LONGEST_TIE = 3
NEUTRAL_ONE = ("scale",)
"""Parameters that are neutral at 1; others are so at 0, limits at infinity."""
LIMITS = ("front_max", "angle", "stall", "no_load_speed")
ANGLES = ("heading", "phase")
MOST_OF_IT = 0.8
"""Share of the true model's gain from which a gain is as good."""
LEAST_GAIN = 0.1
"""Of the true model, in the noise's mean square: less is not worth comparing."""


@dataclass(frozen=True)
class Score:
    """What an answer is worth.

    Attributes
    ----------
    truth : tuple of str
        What acts; empty for nothing.
    answer : str
        What is named first; ``none`` or ``unexplained`` where nothing is.
    detected : bool
        Whether it says that something is wrong.
    top1, top3 : float
        1 right, 0 wrong; a tie set of at most three that holds the truth is half right. Of what is listed beside what
        is not both must be said.
    tie : bool
    excess : int
        Named causes that are not there, and a remainder that is not.
    false : bool
        Whether a cause is named that is not there, nor ties with one that is.
    errors : mapping of str to float
        Of parameters of effects that are named and there, relative to their departure from neutral.
    covered : mapping of str to bool
        Whether each one's interval holds the truth.
    gain : float or None
        On held-out data relative to the true model's.
    described : bool or None
        Whether force and variable of what is on no list are right.
    equivalent : bool or None
        Whether they are, or a law in the model predicts what is held out as well as the true one.
    replaced : bool
        Whether something on no list is said where what acts is on it and is not named.
    seconds : float
    """

    truth: tuple[str, ...]
    answer: str
    detected: bool
    top1: float
    top3: float
    tie: bool
    excess: int
    false: bool = False
    errors: Mapping[str, float] = field(default_factory=dict)
    covered: Mapping[str, bool] = field(default_factory=dict)
    gain: float | None = None
    described: bool | None = None
    equivalent: bool | None = None
    replaced: bool = False
    seconds: float = 0.0


def score(answer: Mapping[str, Any], truth: Mapping[str, Any], reference: Mapping[str, Any] | None = None) -> Score:
    """Score one answer.

    Parameters
    ----------
    answer : mapping
        `Diagnosis.as_dict()`.
    truth : mapping
        Fields of `Truth`.
    reference : mapping, optional
        Channel to ``after``, ``noise``, ``count`` of the true model's predictions of the held-out data.
    """
    effects, unlisted = truth["effects"], truth["unlisted"]
    hidden = tuple(sorted([*effects, *unlisted]))
    named = [cause["effect"] for cause in answer["causes"]]
    errors, covered = _parameters(answer, effects)
    top1, top3, tie = _ranks(answer, effects, unlisted)
    remainder = answer["unexplained"]
    gain = relative_gain(answer["gain"], reference) if reference and hidden else None
    described = is_described(remainder, unlisted) if unlisted else None
    as_good = bool((remainder or {}).get("laws")) and gain is not None and gain >= MOST_OF_IT
    if truth.get("varies") and not effects:  # whether it is noise or something that acts: no name is right
        top1 = top3 = float(not named)
    return Score(
        truth=hidden,
        answer=_first(answer),
        detected=answer["verdict"] != "none",
        top1=top1,
        top3=top3,
        tie=tie,
        excess=len(set(named) - set(effects)) + (remainder is not None and not unlisted),
        false=any(not {cause["effect"], *cause["ties"]} & set(effects) for cause in answer["causes"]),
        errors=errors,
        covered=covered,
        gain=gain,
        described=described,
        equivalent=described or as_good if unlisted else None,
        replaced=bool(effects) and not unlisted and remainder is not None and not set(named) & set(effects),
        seconds=float(answer["seconds"]),
    )


def _first(answer: Mapping[str, Any]) -> str:
    """What the answer comes to in one word."""
    if answer["verdict"] in ("none", "unexplained") or not answer["causes"]:
        return str(answer["verdict"])
    return str(answer["causes"][0]["effect"])


def _ranks(
    answer: Mapping[str, Any], effects: Mapping[str, Any], unlisted: Mapping[str, Any]
) -> tuple[float, float, bool]:
    """top1, top3, tie."""
    verdict, causes = answer["verdict"], answer["causes"]
    if unlisted and effects:
        right = set(_effects(causes)) == set(effects) and answer["unexplained"] is not None
        return float(right), float(right), False
    if unlisted:
        right = verdict == "unexplained"
        return float(right), float(right), False
    if not effects:
        return float(verdict == "none"), float(verdict == "none"), False
    ties = list(causes[0]["ties"]) if causes else []
    ranked = list(dict.fromkeys([*_effects(causes[:1]), *ties, *_effects(causes[1:]), *_effects(answer["ranking"])]))
    among = sum(name in ranked[:3] for name in effects) / len(effects)
    top3 = float(among == 1.0)
    if not causes or verdict in ("none", "unexplained"):
        return 0.0, top3, False
    tied = {causes[0]["effect"], *ties}
    if len(tied) > 1:
        return 0.5 * (len(tied) <= LONGEST_TIE and bool(tied & set(effects))), top3, True
    return float(causes[0]["effect"] in effects), top3, False


def _effects(found: Any) -> list[str]:
    return [each["effect"] for each in found]


def _parameters(answer: Mapping[str, Any], effects: Mapping[str, Any]) -> tuple[dict[str, float], dict[str, bool]]:
    """Errors and coverage of all parameters of effects that are named and there."""
    errors: dict[str, float] = {}
    covered: dict[str, bool] = {}
    for cause in answer["causes"]:
        true = effects.get(cause["effect"])
        if true is None:
            continue
        found = _the_same_way_round(cause["parameters"], true)
        for name, value in true.items():
            key = f"{cause['effect']}.{name}"
            if name not in found:
                errors[key] = inf
            elif isinstance(value, str):
                errors[key] = 0.0 if found[name]["value"] == value else inf
            else:
                errors[key] = _error(name, found[name]["value"], value, true)
                interval = found[name].get("ci95")
                if interval:
                    covered[key] = _within(name, value, interval)
    return errors, covered


def _the_same_way_round(found: Mapping[str, Any], true: Mapping[str, Any]) -> dict[str, Any]:
    """A push of −F towards a heading is one of F away from it."""
    size = next((name for name in ("grade", "force") if name in true and "heading" in found and name in found), None)
    if size is None or found[size]["value"] >= 0:
        return dict(found)
    turned = {name: dict(entry) for name, entry in found.items()}
    turned[size]["value"] = -found[size]["value"]
    if found[size].get("ci95"):
        turned[size]["ci95"] = [-found[size]["ci95"][1], -found[size]["ci95"][0]]
    turned["heading"]["value"] = found["heading"]["value"] + pi
    if found["heading"].get("ci95"):
        turned["heading"]["ci95"] = [edge + pi for edge in found["heading"]["ci95"]]
    return turned


def _error(name: str, value: float, true: float, others: Mapping[str, Any]) -> float:
    """Relative to the departure from neutral; of a heading in rad; of a place in a disc's radii or a lever's length."""
    if name in ANGLES:
        return abs(_wrapped(value - true))
    if name in ("x", "y"):
        return abs(value - true) / (others["radius"] if "radius" in others else hypot(others["x"], others["y"]))
    if name in LIMITS or name == "radius":
        return abs(value - true) / true
    return abs(value - true) / abs(true - (1.0 if name in NEUTRAL_ONE else 0.0))


def _wrapped(angle: float) -> float:
    return (angle + pi) % (2 * pi) - pi


def _within(name: str, true: float, interval: list[float]) -> bool:
    low, high = interval
    if name in ANGLES:
        middle = 0.5 * (low + high)
        true = middle + _wrapped(true - middle)
    return bool(low <= true <= high)


def relative_gain(gain: Mapping[str, Any], reference: Mapping[str, Any]) -> float | None:
    """Share of the true model's fall of the noise-weighted mean squared error that the answer's model brings.

    Channels count by their numbers of samples. None where the true model itself gains less than a tenth of the noise.
    """
    found = true = count = 0.0
    for channel, entry in reference.items():
        if channel not in gain:
            continue
        weight, before = entry["count"] / entry["noise"] ** 2, gain[channel]["before"] ** 2
        true += weight * (before - entry["after"] ** 2)
        found += weight * (before - gain[channel]["after"] ** 2)
        count += entry["count"]
    return found / true if true > LEAST_GAIN * count else None


def is_described(unexplained: Mapping[str, Any] | None, unlisted: Mapping[str, Any]) -> bool:
    """Whether the words of what is unexplained hold those that a good answer has."""
    if unexplained is None:
        return False
    said = f"{unexplained['force']} {unexplained['variable']} {unexplained['form']}"
    return any(has_words(said, ACTS_ON[name].values()) for name in unlisted)


def has_words(said: str, words: Iterable[str]) -> bool:
    """Whether each of some words stands in a text as a whole: "time" is not in "times the wheel's angle"."""
    return all(re.search(rf"\b{re.escape(word)}\b", said, re.IGNORECASE) for word in words)
