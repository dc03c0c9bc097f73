"""An effect and a force on no list: both are found where both act, and the force alone where it acts alone."""

from __future__ import annotations

import time
from types import SimpleNamespace

import numpy as np
import pytest
from diagnose.hidden import Case, case
from diagnose.turns import EVEN

from artibot_sim.diagnose.assessment import Assessor
from artibot_sim.diagnose.candidates.hypotheses import with_effect
from artibot_sim.diagnose.commands.view import command_view
from artibot_sim.diagnose.conclusion import concluded
from artibot_sim.diagnose.records import Options
from artibot_sim.diagnose.remains import leaves_more_than_noise, remains
from artibot_sim.diagnose.selection.decision import Decision, Named
from artibot_sim.diagnose.sizes import sized
from artibot_sim.diagnose.timetable import Timetable
from artibot_sim.diagnose.unlisted.explanations import Explanation, Explanations
from artibot_sim.diagnose.validation.predictions import LAWS
from artibot_sim.diagnose.verdict import Verdict
from artibot_sim.estimation.parameters import SOIL
from artibot_sim.estimation.search import converge
from artibot_sim.estimation.solver import evaluate
from artibot_sim.identify.problems import problem_of
from artibot_sim.identify.requested import parameter_set
from artibot_sim.model import load_robot

SLOPE = {"grade": 0.002, "heading": 0.5}
"""Where the fit of a slope begins that is not there."""


def with_slope(*hidden: str) -> tuple[Case, Decision]:
    """A case, and what a search of the lists may come to that names a slope."""
    found = case(hidden, 1.0, 4, runs=3, held_out=1, duration=8.0)
    robot = load_robot("agriq")
    problem = problem_of(found.recordings, parameter_set(robot, SOIL), 4.0, 1)
    soil = problem.parameters.coordinates([found.truth.soil[name] for name in SOIL])
    neutral = converge(problem, evaluate(problem, EVEN, [soil], problem.starts)[0], EVEN, 8)
    slope = sized("slope", robot)
    larger = with_effect(problem, slope)
    own = slope.coordinates(found.truth.effects.get("slope", SLOPE))
    begin = np.concatenate([neutral.point.coordinates, own])
    fit = converge(larger, evaluate(larger, EVEN, [begin], neutral.point.starts)[0], EVEN, 8)
    left = remains(larger, fit.point)
    assert leaves_more_than_noise(left) == (hidden != ("slope",))
    return found, Decision((Named("slope", 1000.0, ()),), 58.0, ((problem, neutral), (larger, fit)), (), {}, left)


class Weighed(Explanations):
    """Models of so many effects whose costs with so many laws beside are made up; without effects 10 000."""

    def __init__(self, effects: int, alone: float, **costs: float) -> None:
        names = tuple(SimpleNamespace(found={}) for _ in range(effects))
        super().__init__(SimpleNamespace(fitted=names, problem=None, fit=fitted(alone), least=58.0))
        self._models[()] = None, fitted(10_000.0)
        self.costs, self.asked = costs, list[tuple[int, int]]()

    def __call__(self, effects: tuple[int, ...], most: int = 3) -> Explanation:
        self.asked.append((len(effects), most))
        cost = self.costs.get(f"beside_{len(effects)}")
        laws = None if cost is None else SimpleNamespace(spans={"force_law": ()}, fit=fitted(cost))
        return Known(effects, None, fitted(10_000.0), None, laws)

    def _without(self, one: Explanation, place: int) -> Explanation:
        return Known((), None, fitted(10_000.0), None, None)


class Known(Explanation):
    """Laws suffice where there are any."""

    @property
    def suffices(self) -> bool:
        return self.laws is not None


def fitted(cost: float) -> SimpleNamespace:
    return SimpleNamespace(point=SimpleNamespace(cost=cost))


@pytest.mark.parametrize(
    ("alone", "law", "better"),
    [
        (9800.0, 9500.0, True),
        (9800.0, 9790.0, False),  # by 5 nats, which is a tie: the effect is on the list
        (5000.0, 4900.0, False),  # by 50 nats of 2500
        (9500.0, 9800.0, False),
    ],
)
def test_a_law_takes_the_place_of_an_effect_that_leaves_noise_alone_where_it_explains_more(
    alone: float, law: float, better: bool
) -> None:
    of = Weighed(1, alone, beside_0=law)
    best = of.best(1, alone=True)
    assert best is not None and (best.laws is not None) == better
    assert set(of.asked) == {(0, 1)}, "an effect with a law beside it has more terms"


def test_laws_are_tried_in_models_with_no_more_terms_than_asked_for() -> None:
    of = Weighed(3, 9000.0, beside_1=8000.0)
    best = of.best(3)
    assert best is not None and best.terms == 2 and len(best.effects) == 1
    assert of.asked == [(0, 3), (1, 2), (1, 2), (1, 2)]


@pytest.mark.long
def test_a_force_is_found_beside_an_effect_and_both_are_in_the_extended_model() -> None:
    found, searched = with_slope("slope", "joint_preload")
    robot, options = load_robot("agriq"), Options(workers=1, horizon=4.0)
    view = command_view(found.recordings, robot)
    assess = Assessor(robot, found.recordings, found.holdout, options, Timetable(), view)
    decision = concluded(searched, view, assess.worth).decision
    assert decision.verdict is Verdict.NAMED and [one.effect for one in decision.named] == ["slope"]
    assert decision.laws is not None and not leaves_more_than_noise(decision.left)
    assessed = assess(decision)
    slope, law = assessed.extended.effects["slope"], assessed.extended.effects["force_law"]
    assert slope["grade"] == pytest.approx(found.truth.effects["slope"]["grade"], rel=0.1)
    assert (law["where"], law["variable"]) == ("joint", "nothing") and abs(law["size"]) == pytest.approx(12.0, rel=0.1)
    low, high = assessed.effects["force_law"]["size"].ci95
    assert low <= law["size"] <= high
    gain, worth = assessed.worth.gain["articulation_yaw"], assessed.worth.gained
    assert gain.ci95[0] > 0.0 and gain.after < 0.2 * gain.before
    assert list(worth) == ["slope", LAWS] and worth[LAWS].after < 0.2 * worth[LAWS].before


@pytest.mark.long
def test_an_effect_that_is_not_there_is_not_needed_beside_the_force() -> None:
    _, searched = with_slope("joint_preload")
    of = Explanations(searched)
    best = of.best()
    assert of.promised and best is not None and best.effects == () and len(best.laws.spans) == 1
    late = Explanations(searched, latest=time.perf_counter())
    assert late.force() is None and late.best() is None and late.untried == ("forces on no list",)


@pytest.mark.long
def test_beside_the_effect_that_acts_no_law_is_promised() -> None:
    _, searched = with_slope("slope")
    assert not Explanations(searched).promised
