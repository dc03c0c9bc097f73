"""Which effects are fitted with the soil: what gains in the screen, and what promises to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnose.searches import try_only
from diagnose.turns import EVEN, TURNS

from artibot_sim.diagnose.candidates.hypotheses import Hypothesis, hypotheses, with_effect
from artibot_sim.diagnose.candidates.screening import Trial, around, converged_baseline, screen
from artibot_sim.diagnose.selection import forward
from artibot_sim.diagnose.selection.joint_fits import (
    FitCache,
    Rival,
    Rounds,
    contained,
    contest,
    finished,
    with_soil_of,
)
from artibot_sim.diagnose.sizes import sized
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.search import Fit, converge
from artibot_sim.estimation.solver import evaluate
from artibot_sim.identify.problems import problem_of
from artibot_sim.identify.requested import parameter_set
from artibot_sim.identify.synthetic import synthetic
from artibot_sim.model import load_robot

FAR = np.full(4, 2.0)


@pytest.mark.long
def test_where_all_are_fitted_a_screen_that_was_misled_costs_no_effect() -> None:
    """A probe so far out that the effect looks worse than none, and sensitivities that least_expected nothing."""
    robot, truth = load_robot("agriq"), {"grade": 0.05, "heading": 1.0}
    real = replace(robot, effects={"slope": truth})
    problem = problem_of([synthetic(real, TURNS, kappa=0.8, seed=4)], parameter_set(robot), 5.0, 2)
    point = evaluate(problem, EVEN, [np.zeros(5)], problem.starts)[0]
    base, control = converged_baseline(problem, EVEN, point, Rounds().few)
    (trial,) = screen(base, [one for one in hypotheses(robot, problem.stretches) if one.id == "slope"])
    far = np.append(base.point.coordinates, 4.0 * trial.effect_coordinates)
    misled = replace(trial, point=evaluate(trial.problem, EVEN, [far], base.point.starts)[0], expected_gain=0.0)
    assert misled.point.cost > control.cost
    assert not contest([misled], control.cost, EVEN, Rounds())
    known = FitCache()
    begun = contest([misled], control.cost, EVEN, Rounds().for_all(1), known=known)
    best, (rival,) = finished(base, begun, Rounds(), known=known)
    assert rival.trial.hypothesis.extension.values(rival.effect_coordinates) == pytest.approx(truth, rel=0.05)
    (again,) = contest([misled], control.cost, EVEN, Rounds().for_all(1), known=known)
    assert again.fit is begun[0].fit
    for one in {one.id: one for one in hypotheses(robot, problem.stretches)}.values():
        ends_no_worse(one, problem, best)
    same, (once,) = finished(base, [again], Rounds(), known=known)
    assert once.fit is rival.fit and same is best, "what is known is not fitted again"


def ends_no_worse(hypothesis: Hypothesis, problem: Problem, best: Fit) -> None:
    """A search that ended far out is made again from the baseline's end, where its effect is neutral."""
    more = with_effect(problem, hypothesis.extension)
    far = evaluate(
        more, best.loss, [np.append(best.point.coordinates, FAR[: len(hypothesis.extension)])], best.point.starts
    )[0]
    lost = Rival(
        Trial(hypothesis, more, far, np.ones(len(hypothesis.extension))), replace(best, point=replace(far, cost=np.inf))
    )
    kept = contained(lost, best, Rounds(few=1))
    if hypothesis.extension.search.reference:
        assert kept is lost, "a limit has no neutral coordinates"
    else:
        assert kept.fit.point.cost <= best.point.cost * (1.0 + 1e-12), hypothesis.id  # two models, so two roundings


def test_what_is_known_is_not_made_again() -> None:
    """A fit is known by the very objects that it began from; the others are made, all at once."""
    first, second, third = [1.0], [1.0], [2.0]
    made: list[list[list[float]]] = []

    def make(do, some):  # type: ignore[no-untyped-def]
        made.append(list(some))
        return [do(one) for one in some]

    known = FitCache()
    for items in ([first, second], [third, first], [second]):
        assert known.all(sum, items, lambda one: (sum, one), make) == [sum(one) for one in items]
    assert [[id(one) for one in some] for some in made] == [[id(first), id(second)], [id(third)], []]


def test_an_effect_begins_from_the_best_soil_that_any_found() -> None:
    """An effect stuck in a bad soil is fitted from another's, and stays where it is if that is no better."""
    robot, truth = load_robot("agriq"), {"grade": 0.05, "heading": 1.0}
    real = replace(robot, effects={"slope": truth})
    problem = problem_of([synthetic(real, TURNS, kappa=0.8, seed=4)], parameter_set(robot), 5.0, 2)

    def rival(effect: str, coordinates: list[float]) -> Rival:
        extension = sized(effect, robot)
        more = with_effect(problem, extension)
        point = evaluate(more, EVEN, [np.array(coordinates)], more.starts)[0]
        return Rival(Trial(Hypothesis(extension), more, point, np.ones(1)), Fit(point, EVEN, None, (), True))  # type: ignore[arg-type]

    stuck = rival("slope", [1.5, -1.5, 0.3, 0.3, 0.0, 0.0, 0.0])
    other = rival("joint_friction", [0.0] * 6)
    found = with_soil_of(other, stuck, Rounds())
    assert found.trial.hypothesis.extension.values(found.effect_coordinates) == pytest.approx(truth, rel=0.05)
    assert found.fit.point.cost < stuck.fit.point.cost
    assert (
        with_soil_of(rival("joint_friction", [1.5, -1.5, 0.3, 0.3, 0.0, 0.0]), found, replace(Rounds(), many=1))
        is found
    )
    assert with_soil_of(found, found, Rounds()) is found


def test_soils_on_one_ridge_do_not_differ() -> None:
    """As far away along the flattest direction of a fit they are the same to effects; along the steepest not."""
    robot = load_robot("husky")
    problem = problem_of([synthetic(robot, TURNS, seed=4)], parameter_set(robot), 2.0, 2)
    fit = converge(problem, evaluate(problem, EVEN, [np.zeros(5)], problem.starts)[0], EVEN, 2)
    informations, directions = np.linalg.eigh(fit.reduced.matrix)
    far = np.sqrt(2.0 * 6.0 / informations[0])  # 6 nats along the ridge
    assert informations[-1] > 10.0 * informations[0]

    def differs(direction: np.ndarray) -> bool:
        other = fit.point.coordinates.copy()
        other[list(fit.free)] += far * direction
        return Rounds().differ(problem, fit, replace(fit.point, coordinates=other))

    assert not differs(0.0 * directions[:, 0])
    assert not differs(directions[:, 0])
    assert differs(directions[:, -1])


def test_what_another_soil_explains_is_no_effects_merit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Effects that are tried beside two soils are held against the one that explains more without any of them."""
    try_only(monkeypatch, "gyro_bias")
    monkeypatch.setattr(forward, "converged_baseline", lambda *given: (around(*given[:3]), given[2]))
    robot = load_robot("husky")
    problem = problem_of([synthetic(robot, TURNS, seed=4)], parameter_set(robot), 2.0, 2)
    right = converge(problem, evaluate(problem, EVEN, [np.zeros(5)], problem.starts)[0], EVEN, 2)
    beside = right.point.coordinates + np.array([0.3, 0.3, 0.0, 0.0, 0.0])
    wrong = replace(right, point=evaluate(problem, EVEN, [beside], right.point.starts)[0])
    assert wrong.point.cost > right.point.cost + 100.0
    found = forward.stage(problem, wrong, EVEN, [], Rounds(), soils=[right.point])
    assert found.screened == right.point.cost
    assert found.base is not None
    np.testing.assert_array_equal(found.base.point.coordinates, right.point.coordinates)
