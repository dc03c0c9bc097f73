"""What was decided: which effects are named, on what evidence, and the models on the way."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from artibot_sim.diagnose.records import EffectEstimate, SlowResidual
from artibot_sim.diagnose.selection.evidence import CommandEvidence
from artibot_sim.diagnose.selection.forward import SearchStage
from artibot_sim.diagnose.selection.per_recording import ByRecording
from artibot_sim.diagnose.unlisted.finding import ForceFinding
from artibot_sim.diagnose.unlisted.fitting import FittedLaws
from artibot_sim.diagnose.verdict import Verdict
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.search import Fit


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
    found : mapping of str to EffectEstimate
        Its parameters where only the view driven by commands sees it; empty where it was fitted with the soil.
    stage : int
        Number of the search that found it; the first one for what only commands show, which takes none.
    """

    effect: str
    nats: float
    ties: tuple[str, ...]
    found: Mapping[str, EffectEstimate] = field(default_factory=dict)
    stage: int = 0


class FittedEffects:
    """Models that grow by one effect after the other.

    Attributes
    ----------
    fits : tuple of (Problem, Fit)
        With none of the `fitted` effects, with the first of them, the first two, …, and with all.
    named : tuple of Named
        In the order in which they were found.
    """

    fits: tuple[tuple[Problem, Fit], ...]
    named: tuple[Named, ...]

    @property
    def problem(self) -> Problem:
        """With all effects, without laws."""
        return self.fits[-1][0]

    @property
    def fit(self) -> Fit:
        """With all effects, without laws."""
        return self.fits[-1][1]

    @property
    def fitted(self) -> tuple[Named, ...]:
        """What is named and was fitted to the motion; the rest only commands show."""
        return tuple(one for one in self.named if not one.found)


@dataclass(frozen=True)
class Decision(FittedEffects):
    """What was decided, and from what.

    Attributes
    ----------
    named : tuple of Named
        In the order in which they were found.
    least : float
        Nats that an effect had to gain.
    fits : tuple of (Problem, Fit)
        The paper's model with its soil identified, then with the first of the `fitted` effects, the first two, …, and
        with all of them; without laws.
    stages : tuple of SearchStage
    other : mapping of str to CommandEvidence
        What the view driven by commands says of each effect, of the named ones beside each other.
    left : mapping of str to SlowResidual
        What the model with all that was named leaves.
    unexplained : ForceFinding or None
        The force that no effect explains, if one was found.
    by_recording : ByRecording or None
        The recordings one by one, where they contradict each other.
    dropped : tuple of str
        Effects that were found and are not needed beside those found after them.
    refuted : tuple of str
        Effects that held-out recordings speak against beside those found before them.
    untried : tuple of str
        What there was no time for.
    verdict : Verdict
        What the tables of `verdict` make of it; of a search by itself it is none.
    searched : float
        Share of the windows that the stages searched.
    laws : FittedLaws or None
        The force that no effect explains as a term of the model, beside the named effects.
    beside : tuple of (Problem, Fit)
        Other ends of the search for the model with all that it found, beside another soil, about as good.
    """

    named: tuple[Named, ...]
    least: float
    fits: tuple[tuple[Problem, Fit], ...]
    stages: tuple[SearchStage, ...]
    other: Mapping[str, CommandEvidence]
    left: Mapping[str, SlowResidual] = field(default_factory=dict)
    unexplained: ForceFinding | None = None
    by_recording: ByRecording | None = None
    dropped: tuple[str, ...] = ()
    refuted: tuple[str, ...] = ()
    untried: tuple[str, ...] = ()
    verdict: Verdict = Verdict.NONE
    searched: float = 1.0
    laws: FittedLaws | None = None
    beside: tuple[tuple[Problem, Fit], ...] = ()

    @property
    def neutral_problem(self) -> Problem:
        """The paper's model."""
        return self.fits[0][0]

    @property
    def neutral_fit(self) -> Fit:
        """The paper's model."""
        return self.fits[0][1]

    @property
    def whole(self) -> tuple[Problem, Fit]:
        """The model with all that was found: named effects and laws."""
        return (self.problem, self.fit) if self.laws is None else (self.laws.problem, self.laws.fit)

    @property
    def others(self) -> tuple[Fit, ...]:
        """Other ends of the search for the `whole` model; of what it fell back to there are none."""
        keys = self.whole[0].parameters.keys
        return tuple(fit for problem, fit in self.beside if problem.parameters.keys == keys)

    @property
    def ordered(self) -> tuple[Named, ...]:
        """What is named, that with the most evidence first."""
        return tuple(sorted(self.named, key=lambda one: -one.nats))

    def without_last(self) -> Decision:
        """The decision before the last of the `fitted` effects was found; there has to be one."""
        gone = self.fitted[-1]
        named = tuple(one for one in self.named if one is not gone)
        return replace(self, named=named, fits=self.fits[:-1], laws=None, refuted=(*self.refuted, gone.effect))

    @property
    def several_soils(self) -> ByRecording | None:
        """The recordings one by one, where nothing is named because a soil of its own explains each."""
        alone = self.by_recording if self.verdict is Verdict.UNEXPLAINED else None
        return alone if alone is not None and alone.sufficient else None

    def stage_of(self, effect: str) -> SearchStage:
        """The search that found a named effect."""
        return self.stages[next(one.stage for one in self.named if one.effect == effect)]
