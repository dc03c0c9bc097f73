"""Which effects are named: greedy turns and ties."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from artibot_sim.diagnose.apart import Apart
from artibot_sim.diagnose.command_view.view import CommandView
from artibot_sim.diagnose.conclusion import concluded
from artibot_sim.diagnose.contest import Rounds
from artibot_sim.diagnose.diagnosis import Found, Left, Verdict
from artibot_sim.diagnose.disc_place import on_best_disc
from artibot_sim.diagnose.evidence import Evidence
from artibot_sim.diagnose.greedy import Turn, refusal, turn
from artibot_sim.diagnose.other import Other
from artibot_sim.diagnose.thresholds import Thresholds
from artibot_sim.diagnose.unexplained.finding import Finding
from artibot_sim.diagnose.valley import at_size, revised
from artibot_sim.diagnose.views import others, together
from artibot_sim.identify.extension import Extension
from artibot_sim.identify.problem import Problem
from artibot_sim.identify.robust import Loss
from artibot_sim.identify.search import Fit
from artibot_sim.model.effects import EFFECTS

if TYPE_CHECKING:
    from artibot_sim.diagnose.options import Options

Tick = Callable[[], None]

_BETTER = 100.0
"""Nats by which a search must better its own baseline, and by more than what it finds is worth, to be made again."""


@dataclass(frozen=True)
class Named:
    """An effect that the data speak for.

    Attributes
    ----------
    effect : str
    nats : float
        Log Bayes factor against the model without it, both views together.
    ties : tuple of str
        Effects that explain as much.
    found : mapping of str to Found
        Its parameters where only the view driven by commands sees it; empty where it was fitted with the soil.
    """

    effect: str
    nats: float
    ties: tuple[str, ...]
    found: Mapping[str, Found] = field(default_factory=dict)


@dataclass(frozen=True)
class Decision:
    """What was decided, and from what.

    Attributes
    ----------
    verdict : Verdict
    named : tuple of Named
        In the order in which they were found.
    least : float
        Nats that an effect had to gain.
    neutral_problem, neutral_fit : Problem, Fit
        The paper's model with its soil identified.
    problem, fit : Problem, Fit
        With all named effects.
    turns : tuple of Turn
    other : mapping of str to Other
        What the view driven by commands says of each effect, of the named ones beside each other.
    left : mapping of str to Left
        What the model with all that was named leaves.
    unexplained : Finding or None
        The force that no effect explains, if one was found.
    apart : Apart or None
        The recordings one by one, where they contradict each other.
    """

    verdict: Verdict
    named: tuple[Named, ...]
    least: float
    neutral_problem: Problem
    neutral_fit: Fit
    problem: Problem
    fit: Fit
    turns: tuple[Turn, ...]
    other: Mapping[str, Other]
    left: Mapping[str, Left] = field(default_factory=dict)
    unexplained: Finding | None = None
    apart: Apart | None = None

    @property
    def ordered(self) -> tuple[Named, ...]:
        """What is named, that with the most evidence first."""
        return tuple(sorted(self.named, key=lambda one: -one.nats))

    @property
    def fitted(self) -> tuple[Named, ...]:
        """What was fitted with the soil, in the order in which it was found; the rest only commands show."""
        return tuple(one for one in self.named if not one.found)

    @property
    def fits(self) -> tuple[tuple[Problem, Fit], ...]:
        """The model with none of `fitted`, with the first of them, the first two, …, and with all."""
        return (*((turn.problem, turn.fit) for turn in self.turns[: len(self.fitted)]), (self.problem, self.fit))

    @property
    def several_soils(self) -> Apart | None:
        """The recordings one by one, where nothing is named because a soil of its own explains each."""
        alone = self.apart if self.verdict is Verdict.UNEXPLAINED else None
        return alone if alone is not None and alone.sufficient else None

    def turn_of(self, effect: str) -> Turn:
        """The search that found a named effect; the first one for what only commands show, which takes none."""
        fitted = [one.effect for one in self.fitted]
        return self.turns[fitted.index(effect) if effect in fitted else 0]


def decide(problem: Problem, fit: Fit, options: Options, tick: Tick, view: CommandView) -> Decision:
    """Add the best effect to the model as long as the data ask for one.

    Parameters
    ----------
    problem, fit : Problem, Fit
        The baseline.
    options : Options
    tick : callable
    view : CommandView
        What the view driven by commands says.
    """
    thresholds = options.thresholds
    rounds = Rounds(scheduler=options.scheduler)
    least = options.least
    named: list[Named] = []
    again = False

    def sought(problem: Problem, fit: Fit, loss: Loss) -> Turn:
        found = turn(problem, fit, loss, [one.effect for one in named], rounds, tick)
        return replace(found, nats=_nats(found, view, named))

    found = sought(problem, fit, fit.loss)
    turns = [found]
    heard = other = others(view)
    neutral = problem, fit = found.problem, found.fit
    while len(named) < thresholds.most:
        best = best_of(found.evidence, found.nats, heard, least, thresholds, tuple(n.effect for n in named))
        if not (named or again) and found.fallen > max(_BETTER, best.nats if best else 0.0):
            # effects were screened around a soil that was none
            again = True
            found = turns[0] = sought(problem, fit, found.loss)
            neutral = problem, fit = found.problem, found.fit
            continue
        if best is None:
            break
        only_commanded = "rotation" not in _views(best.effect)
        named.append(best if only_commanded else replace(best, found={}))
        if best.effect in heard:
            heard = others(view, tuple(n.effect for n in named))
        if only_commanded:
            found = turns[-1] = replace(found, nats=_nats(found, view, named))
            continue
        problem, fit = _with_effect(problem, fit, found, best, options.seed)
        fit = revised(problem, fit, rounds.few, rounds.worth)
        if len(named) < thresholds.most:
            found = sought(problem, fit, found.loss)
            turns.append(found)
            problem, fit = found.problem, found.fit
    tick()
    other = {**other, **_beside_each_other(view, [n.effect for n in named])}
    named = [replace(one, found=other[one.effect].found) if one.found else one for one in named]
    return concluded(Decision(Verdict.NONE, tuple(named), least, *neutral, problem, fit, tuple(turns), other))


def _beside_each_other(view: CommandView, named: Sequence[str]) -> dict[str, Other]:
    """What commands say of each named effect once the others are in the model: alone it stands for them as well."""
    found: dict[str, Other] = {}
    for effect in named:
        told = others(view, tuple(one for one in named if one != effect))
        found |= {effect: told[effect]} if effect in told else {}
    return found


def _views(effect: str) -> tuple[str, ...]:
    search = EFFECTS[effect].search
    return tuple(search.views) if search is not None else ()


def _with_effect(problem: Problem, fit: Fit, found: Turn, best: Named, seed: int) -> tuple[Problem, Fit]:
    """The model with the effect that was named, as it was fitted, or begun at the size that commands tell."""
    for rival in found.rivals:
        if rival.id == best.effect:
            return on_best_disc(rival.problem, rival.fit, seed, Rounds().few)
    extension = Extension(best.effect)
    own = extension.coordinates({name: one.value for name, one in best.found.items()})
    return at_size(problem, fit, extension, own, Rounds().few)


def _nats(found: Turn, view: CommandView, named: Sequence[Named]) -> dict[str, float]:
    """Log Bayes factors of what was fitted, from both views."""
    beside = {n.effect: {name: float(f.value) for name, f in n.found.items()} for n in named if n.found}
    return {rival.id: together(view, rival, found.evidence[rival.id], beside) for rival in found.rivals}


def best_of(
    evidence: Mapping[str, Evidence],
    fitted: Mapping[str, float],
    heard: Mapping[str, Other],
    least: float,
    thresholds: Thresholds,
    without: Collection[str] = (),
) -> Named | None:
    """The effect with the most evidence, if it is enough, and those that tie with it; None if there is none.

    Parameters
    ----------
    evidence : mapping of str to Evidence
        Of what was fitted, by the view that is driven by rotations.
    fitted : mapping of str to float
        Nats of the same from both views.
    heard : mapping of str to Other
        What the view driven by commands says.
    least : float
        Nats that an effect has to gain.
    without : collection of str
        What is named already.
    """
    good: dict[str, float] = {}
    for effect, nats in fitted.items():
        enough = least + thresholds.more(effect)
        if effect not in without and not refusal(effect, evidence[effect], nats, enough, thresholds):
            good[effect] = nats
    for effect, view in heard.items():
        if effect in good or effect in without or fitted.get(effect, least) < least:
            continue  # what rotations contradict is no cause, however well commands like it
        if view.nats >= least:
            good[effect] = view.nats
    if not good:
        return None
    best = max(good, key=lambda effect: good[effect])

    def margin(effect: str) -> float:
        """What commands show has the noise that the best of it leaves; nothing but chance is to be feared there."""
        commanded = best not in fitted and effect not in fitted
        return thresholds.tie if commanded else max(thresholds.tie, thresholds.tie_share * good[best])

    ties = sorted((e for e in good if e != best and good[e] >= good[best] - margin(e)), key=lambda e: -good[e])
    values = heard[best].found if best in heard and best not in fitted else {}
    return Named(best, good[best], tuple(ties), values)
