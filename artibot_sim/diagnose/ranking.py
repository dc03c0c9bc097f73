"""How every effect of the vocabulary fared, and from which size on those not found are excluded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from artibot_sim.diagnose.decision import Decision, Named
from artibot_sim.diagnose.diagnosis import Candidate, Verdict
from artibot_sim.diagnose.evidence import DECADE
from artibot_sim.diagnose.exclusion import excluded, excluded_below, excluded_patch
from artibot_sim.diagnose.greedy import Turn, refusal
from artibot_sim.diagnose.other import Other
from artibot_sim.diagnose.screen import Trial
from artibot_sim.diagnose.thresholds import Thresholds
from artibot_sim.model.effects import EFFECTS


def ranking(decision: Decision, thresholds: Thresholds) -> tuple[Candidate, ...]:
    """All effects, best first: those named as they were found, others as the last turn that tried them saw them."""
    named = {n.effect: n for n in decision.named}
    found = []
    for effect in (name for name, declared in EFFECTS.items() if declared.search is not None):
        turns = decision.turns
        if effect in named:
            at = decision.turn_of(effect)
        else:
            tried = [turn for turn in turns if any(trial.id == effect for trial in turn.trials)]
            first = effect in turns[0].evidence and effect not in decision.dropped
            at = turns[0] if first or not tried else tried[-1]
        own = _candidate(effect, at)
        if effect not in named:
            trials = [trial for trial in at.trials if trial.id == effect]
            above = _above(decision, effect, trials, thresholds)
            below = excluded_below(trials[0], decision.least, thresholds) if trials else {}  # limits have no choices
            dropped = "not needed any more beside what was found after it" if effect in decision.dropped else ""
            note = own.note or dropped or _refusal(at, own, decision, thresholds)
            own = replace(own, excluded_above=above, excluded_below=below, note=note)
        found.append(_with_other(own, decision.other[effect], named) if effect in decision.other else own)
    return tuple(sorted(found, key=lambda c: -c.log10_bayes_factor if np.isfinite(c.log10_bayes_factor) else np.inf))


def _refusal(at: Turn, own: Candidate, decision: Decision, thresholds: Thresholds) -> str:
    """Why what gained as much as others are named for is not; empty where it did not."""
    nats = DECADE * own.log10_bayes_factor
    if own.effect not in at.evidence or nats < decision.least:
        return ""
    least = decision.least + thresholds.more(own.effect)
    why = refusal(own.effect, at.evidence[own.effect], nats, least, thresholds)
    return why or ("nothing is named in place of what is on no list" if decision.verdict is Verdict.UNEXPLAINED else "")


def _above(decision: Decision, effect: str, trials: Sequence[Trial], thresholds: Thresholds) -> dict[str, float]:
    """Departures from neutral that are excluded of an effect that was not found."""
    search, last = EFFECTS[effect].search, decision.turns[-1].base
    if search is None or not search.disc:
        return excluded(trials, decision.least, thresholds)
    return {} if last is None else excluded_patch(last, effect, decision.least, thresholds)


def _candidate(effect: str, at: Turn) -> Candidate:
    trials = [trial for trial in at.trials if trial.id == effect]
    rival = next((rival for rival in at.rivals if rival.id == effect), None)
    if rival is not None:
        values = rival.trial.hypothesis.extension.values(rival.own)
        nats = at.nats.get(effect, at.evidence[effect].nats)
        return Candidate(effect, nats / DECADE, values, note=_note(trials), fitted=True)
    if not trials and effect in at.problem.parameters.robot.effects:
        return Candidate(effect, 0.0, {}, note="known: it stands in the robot file")
    if not trials:
        return Candidate(effect, 0.0, {}, note="not looked for: these recordings cannot show it")
    best = min(trials, key=lambda trial: trial.point.cost)
    nats = 0.5 * (at.screened - best.point.cost)
    return Candidate(effect, nats / DECADE, best.hypothesis.extension.values(best.own), note=_note(trials))


def _with_other(own: Candidate, other: Other, named: Mapping[str, Named]) -> Candidate:
    """A candidate with what the view driven by commands says added; a fitted one's evidence is of both views."""
    nats = named[own.effect].nats / DECADE if own.effect in named else own.log10_bayes_factor
    if not (own.fitted or own.effect in named):
        nats += other.nats / DECADE
    if own.values:
        return replace(own, log10_bayes_factor=nats)
    values = {name: found.value for name, found in other.found.items()}
    own = replace(own, log10_bayes_factor=nats, values=values, note=other.note, fitted=True)
    if own.effect in named:
        return own
    return replace(own, excluded_above=other.excluded_above, excluded_below=other.excluded_below)


def _note(trials: list[Trial]) -> str:
    if trials and all(not np.isfinite(trial.sd).all() for trial in trials):
        search = trials[0].hypothesis.extension.search
        if search.reference or search.disc:  # no sensitivities are known
            return ""
        return "it never acts in these recordings"
    return ""
