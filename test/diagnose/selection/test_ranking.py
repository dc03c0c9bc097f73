"""What becomes of several named effects, in whatever order and by whichever view they were found."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from artibot_sim.diagnose.candidates.hypotheses import Hypothesis, why_unseen, with_effect
from artibot_sim.diagnose.candidates.screening import Trial
from artibot_sim.diagnose.commands.view import command_view
from artibot_sim.diagnose.conclusion import without_ties_among_named
from artibot_sim.diagnose.policy import THRESHOLDS
from artibot_sim.diagnose.records import DECADE, EffectEstimate
from artibot_sim.diagnose.selection.decision import Decision, Named
from artibot_sim.diagnose.selection.evidence import Evidence, others
from artibot_sim.diagnose.selection.forward import SearchStage
from artibot_sim.diagnose.selection.joint_fits import Rival
from artibot_sim.diagnose.selection.ranking import ranking
from artibot_sim.diagnose.unlisted.finding import ForceFinding
from artibot_sim.diagnose.verdict import Verdict
from artibot_sim.estimation.loss import Loss
from artibot_sim.estimation.parameters import Extension
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.search import Fit
from artibot_sim.estimation.solver import evaluate
from artibot_sim.estimation.windows import CHANNEL_NAMES
from artibot_sim.experiment import Experiment
from artibot_sim.identify.problems import problem_of
from artibot_sim.identify.requested import parameter_set
from artibot_sim.identify.synthetic import random_manoeuvre, synthetic
from artibot_sim.model import load_robot
from artibot_sim.model.effects import EFFECTS

ROBOT = load_robot("agriq")
FITTED = ("joint_friction", "joint_damping")
"""Effects of the view driven by rotations, in the order in which they are found here."""
COMMANDED = {
    "speed_loop_lag": {"time_constant": EffectEstimate(0.2, "s")},
    "command_delay": {"delay": EffectEstimate(0.1, "s")},
}
NATS = {"joint_friction": 500.0, "joint_damping": 90.0, "speed_loop_lag": 700.0, "command_delay": 300.0}


def fit_of(problem: Problem) -> Fit:
    loss = Loss(1.0, np.ones(len(CHANNEL_NAMES)))
    size = sum(map(len, problem.parameters.extensions))
    point = evaluate(problem, loss, [np.concatenate([np.zeros(5), np.ones(size)])], problem.starts)[0]
    return Fit(point, loss, None, (), True)  # type: ignore[arg-type]


def turn_for(problem: Problem, effect: str) -> tuple[SearchStage, Problem]:
    """A search that found an effect, plain in size, beside those in the problem."""
    fit, extension = fit_of(problem), Extension(effect)
    more = with_effect(problem, extension)
    there = fit_of(more)
    rival = Rival(Trial(Hypothesis(extension), more, there.point, np.ones(1)), there)
    told = Evidence(NATS[effect], 0.0, np.ones(1), np.full((1, 1), 1e-4))
    return SearchStage((rival.trial,), (rival,), {effect: told}, problem, fit, fit.loss, fit.point.cost), more


@pytest.fixture(scope="module")
def run() -> Experiment:
    return synthetic(ROBOT, random_manoeuvre(np.random.default_rng(2), 8.0), duration=8.0, kappa=0.8, seed=3)


def decision_of(run: Experiment, order: tuple[str, ...]) -> Decision:
    """As a search would leave it that found these, one after the other."""
    problem = neutral = problem_of([run], parameter_set(ROBOT), 5.0, 1)
    stages = []
    for effect in (name for name in order if name in FITTED):
        found, problem = turn_for(problem, effect)
        stages.append(found)
    fit = fit_of(problem)
    stages.append(SearchStage((), (), {}, problem, fit, fit.loss, fit.point.cost))
    fitted = [name for name in order if name in FITTED]
    at = {name: number for number, name in enumerate(fitted)}
    named = tuple(Named(name, NATS[name], (), COMMANDED.get(name, {}), at.get(name, 0)) for name in order)
    first = fit_of(neutral)
    view = others(command_view([run], ROBOT))
    between = [(one.problem, fit_of(one.problem)) for one in stages[1:-1]]
    return Decision(named, 40.0, ((neutral, first), *between, (problem, fit)), tuple(stages), view)


ORDERS = [
    order
    for count in (1, 2, 3)
    for order in itertools.permutations(NATS, count)
    if [name for name in order if name in FITTED] == list(FITTED)[: sum(name in FITTED for name in order)]
]


@pytest.mark.parametrize("order", ORDERS, ids="-".join)
def test_what_is_named_is_ranked_by_its_own_evidence(run: Experiment, order: tuple[str, ...]) -> None:
    decision = decision_of(run, order)
    ranked = {one.effect: one for one in ranking(decision, THRESHOLDS)}
    for effect in order:
        assert ranked[effect].fitted
        assert ranked[effect].log10_bayes_factor == pytest.approx(NATS[effect] / DECADE)
        assert not ranked[effect].excluded_above and "not looked for" not in ranked[effect].note
    assert [one.effect for one in decision.ordered] == sorted(order, key=lambda name: -NATS[name])


def test_what_has_evidence_and_is_not_named_says_why(run: Experiment) -> None:
    decision = decision_of(run, FITTED[:1])
    nothing = replace(decision, verdict=Verdict.UNEXPLAINED, named=())
    (one,) = (one for one in ranking(nothing, THRESHOLDS) if one.effect == FITTED[0])
    assert one.note == "most of the error is left with it"
    force = ForceFinding((), (), 1.0, (), np.zeros(5), np.zeros(5), ())
    (one,) = (one for one in ranking(replace(nothing, unexplained=force), THRESHOLDS) if one.effect == FITTED[0])
    assert "on no list" in one.note
    small = replace(decision.stages[0].evidence[FITTED[0]], own=np.full(1, 0.05))
    stages = (replace(decision.stages[0], evidence={FITTED[0]: small}), *decision.stages[1:])
    (one,) = (one for one in ranking(replace(nothing, stages=stages), THRESHOLDS) if one.effect == FITTED[0])
    assert "plain size" in one.note


def test_only_what_recordings_cannot_show_is_said_to_be_so(run: Experiment) -> None:
    """No stage here has tried any other effect: that alone says nothing about the recordings."""
    decision = decision_of(run, FITTED[:1])
    notes = {one.effect: one.note for one in ranking(decision, THRESHOLDS)}
    stretches = decision.neutral_problem.stretches
    untried = [name for name in notes if name not in decision.other and not EFFECTS[name].search.disc]
    untried.remove(FITTED[0])
    assert {"slope", "back_friction", "gyro_bias"} <= set(untried)
    for name in untried:
        assert ("cannot show" in notes[name]) == bool(why_unseen(EFFECTS[name], ROBOT, stretches)), notes[name]
    assert notes["slope"] == "not tried"
    assert "no back module" in why_unseen(EFFECTS["joint_friction"], load_robot("husky"), stretches)
    assert "never bends" in why_unseen(EFFECTS["joint_stop"], ROBOT, [])


def test_what_is_found_beside_another_is_no_rival_of_it(run: Experiment) -> None:
    decision = decision_of(run, FITTED)
    tied = tuple(replace(one, ties=tuple(name for name in FITTED if name != one.effect)) for one in decision.named)
    assert not any(one.ties for one in without_ties_among_named(replace(decision, named=tied)).named)
    open_ = replace(decision, named=(decision.named[0], replace(decision.named[1], ties=("payload",))))
    assert without_ties_among_named(open_).named == open_.named
    assert not without_ties_among_named(open_).ordered[0].ties, "the one with the most evidence has no rival"


def test_who_believes_less_asks_for_more() -> None:
    least = THRESHOLDS.least
    assert least(1.0, 0.01) == pytest.approx(THRESHOLDS.floor + THRESHOLDS.tail * np.log(100.0))
    assert least(0.1, 0.01) == pytest.approx(least(1.0, 0.001))
    assert least(1e6, 0.01) == THRESHOLDS.floor
