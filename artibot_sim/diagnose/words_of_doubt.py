"""Why something is not named, or may not be all: the first warnings of a diagnosis, in sentences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from artibot_sim.diagnose.diagnosis import ChannelGain
from artibot_sim.diagnose.words import amount, channel_words, effect_words, joined


def doubt(effects: Sequence[str], channels: Sequence[str]) -> str:
    """Why effects that were fitted best are not named: what they leave is another thing."""
    names, where = ([effect_words(name) for name in effects], [channel_words(name) for name in channels])
    return (
        f"{joined(names)} would explain the fitted recordings best, but with that far more than noise is left in "
        f"{joined(where)}, for which no force was found; so that is not named"
    )


def besides(effects: Sequence[str], channels: Sequence[str]) -> str:
    """That something else may act beside what is named."""
    names, where = ([effect_words(name) for name in effects], [channel_words(name) for name in channels])
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
        f"are predicted worse with that: {_errors(gain)}; so that is not named"
    )


def shortfall(effects: Sequence[str], gain: Mapping[str, ChannelGain]) -> str:
    """Why effects that were fitted best are not named: most of the error is still there with them."""
    return (
        f"{joined([effect_words(name) for name in effects])} would explain the recordings best, but with that most "
        f"of the error is left in held-out ones: {_errors(gain)}; so that is not named"
    )


def _errors(gain: Mapping[str, ChannelGain]) -> str:
    errors = []
    for name, one in gain.items():
        before, after = amount(one.before, one.unit, 3), amount(one.after, one.unit, 3)
        errors += [f"{channel_words(name)} {before} to {after}"] if before != after else []
    return f"RMSE of {joined(errors)}" if errors else "by too little to show in three digits of any channel"
