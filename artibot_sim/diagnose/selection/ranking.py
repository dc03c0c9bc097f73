"""How every effect of the vocabulary fared, and from which size on those not found are excluded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from artibot_sim.diagnose.candidates.hypotheses import why_unseen
from artibot_sim.diagnose.candidates.patches import RADII, deviations_along
from artibot_sim.diagnose.candidates.screening import Around, Trial
from artibot_sim.diagnose.policy import Thresholds
from artibot_sim.diagnose.records import DECADE, Candidate
from artibot_sim.diagnose.selection.decision import Decision, Named
from artibot_sim.diagnose.selection.evidence import CommandEvidence
from artibot_sim.diagnose.selection.forward import SearchStage, refusal
from artibot_sim.diagnose.verdict import Verdict
from artibot_sim.estimation.checks.common_map import experiments_of, in_common_map, needed
from artibot_sim.estimation.parameters import SPREAD, Extension
from artibot_sim.model.effects import EFFECTS

# ----------------------------------------------------------------------
# From which size on an effect that was not found is excluded: one of that size would have been named.
# ----------------------------------------------------------------------


_MARGIN = 2.0
"""Standard deviations that chance may take from an effect of that size."""
_FAITHFUL = 0.9
"""Share of a size that is found at least."""
_GROUND = 0.9
"""Share of the ground driven on for which a patch is excluded."""
_FARTHEST = 20.0
"""Plain sizes from which on nothing is excluded: a rover not pushed by 700 N is no news."""


def excluded(trials: Sequence[Trial], least: float, thresholds: Thresholds) -> dict[str, float]:
    """Departures from neutral that are excluded, by parameter; of several choices the weakest bound.

    With σ the standard deviation of the effect's coordinate x (the wider of what sensitivities and finite probes say,
    soil free in both), the evidence grows as x²/2σ² less Occam's factor ln(1.5/σ). Excluded is where two deviations
    less than x would still gain what it takes to be named, and be as large as it takes.

    Parameters
    ----------
    trials : sequence of Trial
        The effect's, one for each choice.
    least : float
        Nats that an effect has to gain.
    """
    found: dict[str, float] = {}
    for trial in trials:
        extension = trial.hypothesis.extension
        sd = float(max(np.max(trial.sd), trial.coarsest_sd))
        if not np.isfinite(sd) or extension.search.reference:
            return {}
        reach = _reach(sd, len(extension), least + thresholds.more(trial.id), thresholds)
        if extension.search.least:  # not smooth at neutral: nothing smaller than its probes was looked for
            reach = max(reach, min(float(np.linalg.norm(probe)) for probe in trial.hypothesis.probes))
        if reach > _FARTHEST:
            return {}
        for name, size in extension.search.sizes.items():
            bound = float(np.expm1(reach * size)) if extension.search.logarithmic else reach * size
            found[name] = max(found.get(name, 0.0), bound)
    return found


def excluded_patch(base: Around, effect: str, least: float, thresholds: Thresholds) -> dict[str, float]:
    """From which size on a disc on the ground is excluded: the departure that nine tenths of the ground exclude.

    Parameters
    ----------
    base : Around
        The fit that leaves nothing to be named.
    effect : str
    least : float
        Nats that it has to gain.
    """
    stated = deviations_along(base, effect)
    here = np.sort(stated)[int(np.ceil(_GROUND * len(stated))) - 1] if len(stated) else np.inf
    if not np.isfinite(here):
        return {}
    among = float(np.log(len(stated) * len(RADII)))
    reach, extension = _reach(float(here), 1, least + thresholds.more(effect) + among, thresholds), Extension(effect)
    if reach > _FARTHEST:
        return {}
    return {name: float(np.expm1(reach * size)) for name, size in extension.search.sizes.items()}


def _reach(sd: float, size: int, needed: float, thresholds: Thresholds) -> float:
    """The coordinate that two deviations less than it would still be named by, of so many that are fitted."""
    occam = size * max(0.0, float(np.log(SPREAD / sd)))
    gained = sd * (float(np.sqrt(2.0 * (needed + occam))) + _MARGIN)
    return max(gained, float((thresholds.size + _MARGIN * sd) / _FAITHFUL))


def excluded_below(trial: Trial, least: float, thresholds: Thresholds) -> dict[str, float]:
    """Values below which a limit is excluded, by parameter; empty for what is no limit.

    A limit is determined by what goes beyond it: the gentlest of the values at which it was tried that two deviations
    less would still have shown, all tighter ones showing as well.
    """
    extension, found = trial.hypothesis.extension, dict[str, float]()
    if not extension.search.reference:
        return found
    for own, cost in sorted(trial.tested, key=lambda one: float(one[0][0])):
        if np.sqrt(max(cost, 0.0)) - _MARGIN < np.sqrt(2.0 * (least + thresholds.more(trial.id))):
            break
        found = {name: float(extension.values(own)[name]) for name in extension.search.sizes}
    return found


# ----------------------------------------------------------------------
# How every effect of the vocabulary fared, and from which size on those not found are excluded.
# ----------------------------------------------------------------------


def ranking(decision: Decision, thresholds: Thresholds) -> tuple[Candidate, ...]:
    """All effects, best first: those named as they were found, others as the last search that tried them saw them."""
    named = {n.effect: n for n in decision.named}
    found = []
    for effect in (name for name, declared in EFFECTS.items() if declared.search is not None):
        stages = decision.stages
        if effect in named:
            at = decision.stage_of(effect)
        else:
            tried = [stage for stage in stages if any(trial.id == effect for trial in stage.trials)]
            first = effect in stages[0].evidence and effect not in decision.dropped
            at = stages[0] if first or not tried else tried[-1]
        own = _candidate(effect, at)
        if effect not in at.by_every_window and any(trial.id == effect for trial in at.trials):
            own = replace(own, windows=decision.searched)
        if effect not in named:
            trials = [trial for trial in at.trials if trial.id == effect]
            above = _above(decision, effect, trials, thresholds)
            below = excluded_below(trials[0], decision.least, thresholds) if trials else {}  # limits have no choices
            dropped = "not needed any more beside what was found after it" if effect in decision.dropped else ""
            dropped = "held-out recordings are predicted worse with it" if effect in decision.refuted else dropped
            note = own.note or dropped or _refusal(at, own, decision, thresholds)
            own = replace(own, excluded_above=above, excluded_below=below, note=note)
        found.append(_with_command_evidence(own, decision.other[effect], named) if effect in decision.other else own)
    return tuple(sorted(found, key=lambda c: -c.log10_bayes_factor if np.isfinite(c.log10_bayes_factor) else np.inf))


def _refusal(at: SearchStage, own: Candidate, decision: Decision, thresholds: Thresholds) -> str:
    """Why what gained as much as others are named for is not; empty where it did not."""
    nats = DECADE * own.log10_bayes_factor
    if own.effect not in at.evidence or nats < decision.least:
        return ""
    least = decision.least + thresholds.more(own.effect)
    why = refusal(own.effect, at.evidence[own.effect], nats, least, thresholds)
    if why or decision.verdict is not Verdict.UNEXPLAINED:
        return why
    if decision.unexplained is None and decision.several_soils is None:
        return "most of the error is left with it"
    return "nothing is named in place of what is on no list"


def _above(decision: Decision, effect: str, trials: Sequence[Trial], thresholds: Thresholds) -> dict[str, float]:
    """Departures from neutral that are excluded of an effect that was not found."""
    search, last = EFFECTS[effect].search, decision.stages[-1].base
    if search is None or not search.disc:
        return excluded(trials, decision.least, thresholds)
    if not in_common_map(experiments_of(decision.neutral_problem.stretches)):
        return {}
    return {} if last is None else excluded_patch(last, effect, decision.least, thresholds)


def _candidate(effect: str, at: SearchStage) -> Candidate:
    trials = [trial for trial in at.trials if trial.id == effect]
    rival = next((rival for rival in at.rivals if rival.id == effect), None)
    if rival is not None:
        values = rival.trial.hypothesis.extension.values(rival.effect_coordinates)
        nats = at.nats.get(effect, at.evidence[effect].nats)
        return Candidate(effect, nats / DECADE, values, note=_note(trials), fitted=True)
    if not trials and effect in at.problem.parameters.robot.effects:
        return Candidate(effect, 0.0, {}, note="known: it stands in the robot file")
    if not trials and needed(effect) and not in_common_map(experiments_of(at.problem.stretches)):
        note = f"not looked for: it needs {needed(effect)}, and the segments of these recordings have none"
        return Candidate(effect, 0.0, {}, note=note)
    if not trials:
        why = why_unseen(EFFECTS[effect], at.problem.parameters.robot, at.problem.stretches)
        note = f"not looked for: these recordings cannot show it ({why})" if why else "not tried"
        return Candidate(effect, 0.0, {}, note=note)
    best = min(trials, key=lambda trial: trial.point.cost)
    nats = max(0.5 * (at.screened - best.point.cost), 0.0)  # at neutral it gains nothing, and is no worse than that
    values = best.hypothesis.extension.values(best.effect_coordinates)
    return Candidate(effect, nats / DECADE, values, note=_note(trials))


def _with_command_evidence(own: Candidate, other: CommandEvidence, named: Mapping[str, Named]) -> Candidate:
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
