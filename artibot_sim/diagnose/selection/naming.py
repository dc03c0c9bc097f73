"""Which effect is named: the one with the most evidence from both views, and those that tie with it."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from artibot_sim.diagnose.commands.view import CommandView
from artibot_sim.diagnose.policy import Thresholds
from artibot_sim.diagnose.selection.decision import Named
from artibot_sim.diagnose.selection.evidence import CommandEvidence, Evidence, others, together
from artibot_sim.diagnose.selection.forward import SearchStage, refusal
from artibot_sim.model.effects import EFFECTS


def views_of(effect: str) -> tuple[str, ...]:
    """The views that show an effect: driven by rotations, by commands, or both."""
    search = EFFECTS[effect].search
    return tuple(search.views) if search is not None else ()


def command_evidence(view: CommandView, named: Sequence[str]) -> dict[str, CommandEvidence]:
    """What commands say of each named effect once the others are in the model: alone it stands for them as well."""
    found: dict[str, CommandEvidence] = {}
    for effect in named:
        stated = others(view, tuple(one for one in named if one != effect))
        found |= {effect: stated[effect]} if effect in stated else {}
    return found


def nats_of(
    found: SearchStage, view: CommandView, named: Sequence[Named], of: Collection[str] | None = None
) -> dict[str, float]:
    """Log Bayes factors of what was fitted, all of it or some effects only, from both views."""
    beside = {n.effect: {name: float(f.value) for name, f in n.found.items()} for n in named if n.found}
    rivals = [rival for rival in found.rivals if of is None or rival.id in of]
    return {rival.id: together(view, rival, found.evidence[rival.id], beside) for rival in rivals}


def best_of(
    evidence: Mapping[str, Evidence],
    fitted: Mapping[str, float],
    from_commands: Mapping[str, CommandEvidence],
    least: float,
    thresholds: Thresholds,
    without: Collection[str] = (),
    tried: Collection[str] = (),
) -> Named | None:
    """The effect with the most evidence, if it is enough, and those that tie with it; None if there is none.

    Parameters
    ----------
    evidence : mapping of str to Evidence
        Of what was fitted, by the view that is driven by rotations.
    fitted : mapping of str to float
        Nats of the same from both views.
    from_commands : mapping of str to CommandEvidence
        What the view driven by commands says.
    least : float
        Nats that an effect has to gain.
    without : collection of str
        What is named already.
    tried : collection of str
        What the motion was asked for; commands alone do not name that.
    """
    good: dict[str, float] = {}
    for effect, nats in fitted.items():
        enough = least + thresholds.more(effect)
        if effect not in without and not refusal(effect, evidence[effect], nats, enough, thresholds):
            good[effect] = nats
    for effect, view in from_commands.items():
        if effect in good or effect in (*without, *fitted, *tried):
            continue  # what the motion would show and does not ask for is no cause, however well commands like it
        if view.nats >= least:
            good[effect] = view.nats
    if not good:
        return None
    best = max(good, key=lambda effect: good[effect])

    def margin(effect: str) -> float:
        """What commands show has the noise that the best of it leaves; nothing but chance is to be feared there.

        Where motion was fitted the best one may have its lead by which windows were recorded.
        """
        if best not in fitted and effect not in fitted:
            return thresholds.tie
        both = best in fitted and effect in fitted
        by_chance = evidence[best].sampling_sd_beside(evidence[effect]) if both else 0.0
        return max(thresholds.tie, thresholds.tie_share * good[best], thresholds.margin * by_chance)

    ties = sorted((e for e in good if e != best and good[e] >= good[best] - margin(e)), key=lambda e: -good[e])
    values = from_commands[best].found if best in from_commands and best not in fitted else {}
    return Named(best, good[best], tuple(ties), values)
