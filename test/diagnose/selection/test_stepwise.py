"""What was named wrongly at first is taken back, and never named again."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest
from diagnose.hidden import case
from diagnose.searches import FEW, baseline, remember_stages, try_only

from artibot_sim.diagnose.commands.view import command_view
from artibot_sim.diagnose.conclusion import HeldOut, concluded
from artibot_sim.diagnose.policy import THRESHOLDS, Thresholds
from artibot_sim.diagnose.records import Options
from artibot_sim.diagnose.selection import stepwise
from artibot_sim.diagnose.selection.decision import Decision, Named
from artibot_sim.diagnose.selection.evidence import CommandEvidence, Evidence
from artibot_sim.diagnose.selection.ranking import ranking
from artibot_sim.diagnose.timetable import Timetable
from artibot_sim.diagnose.verdict import Verdict
from artibot_sim.estimation.loss import Loss
from artibot_sim.estimation.parameters import SOIL
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.search import Fit
from artibot_sim.estimation.solver import evaluate
from artibot_sim.estimation.windows import CHANNEL_NAMES
from artibot_sim.experiment import Experiment
from artibot_sim.identify.problems import problem_of
from artibot_sim.identify.requested import parameter_set
from artibot_sim.model import Robot, load_robot

DRIVE = {"runs": 2, "held_out": 0, "duration": 10.0, "manoeuvres": ("eight", "stop_and_go")}


@pytest.mark.long
def test_an_effect_that_the_next_one_makes_up_for_is_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first choice is made to be the best of the others; all that follows is the search's own.

    Little is asked of an effect, so that another one is worth it.
    """
    truth = "joint_damping"
    asked = stepwise.best_of

    def misled(
        evidence: Mapping[str, Evidence], fitted: Mapping[str, float],
        from_commands: Mapping[str, CommandEvidence], least: float, thresholds: Thresholds,
        without: Collection[str] = (), tried: Collection[str] = (),
    ) -> Named | None:  # fmt: skip
        return asked(evidence, fitted, from_commands, least, thresholds, without or (truth,), tried)

    remember_stages(monkeypatch)
    try_only(monkeypatch, *FEW)
    hidden = case((truth,), seed=31, **DRIVE)
    little = replace(THRESHOLDS, floor=12.0, tail=0.0, size=0.0, margin=0.0)
    robot, options = load_robot("agriq"), Options(thresholds=little)
    problem, fit = baseline(hidden.recordings, robot, options)
    view = command_view(hidden.recordings, robot)
    right = stepwise.StepwiseSelection(problem, fit, options, Timetable(), view).decide()
    monkeypatch.setattr(stepwise, "best_of", misled)
    found = stepwise.StepwiseSelection(problem, fit, options, Timetable(), view).decide()
    assert [one.effect for one in found.named] == [one.effect for one in right.named] == [truth]
    assert not right.dropped and len(found.dropped) == 1 and truth not in found.dropped
    nothing_held_out = HeldOut({}, {})
    for one in (found, right):
        assert concluded(one, view, lambda _: nothing_held_out).decision.verdict is Verdict.NAMED
    assert found.ordered[0].nats == pytest.approx(right.ordered[0].nats, rel=0.05), "what it is worth by itself"
    sizes, others = (one.fit.point.coordinates[len(SOIL) :] for one in (found, right))
    assert sizes == pytest.approx(others, rel=0.05)
    assert len(found.fits) == 2, "the paper's model, and the one with what was found"
    notes = {one.effect: one.note for one in ranking(found, THRESHOLDS)}
    assert "not needed any more" in notes[found.dropped[0]] and not notes[truth]


def test_what_commands_asked_for_is_taken_back_beside_what_explains_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Limits of torque gain a little where drives go on a ramp, a line most, and nothing beside the limit of rates.

    No search by rotations: commands alone decide, and the first choice is made to be the best of the others.
    What only commands show is no effect too many either.
    """
    truth, robot = "command_rate_limit", load_robot("agriq")
    asked = stepwise.best_of
    monkeypatch.setattr(stepwise, "best_of", lambda *found: asked(*found[:5], found[5] or (truth,), *found[6:]))
    search_nothing(monkeypatch)
    hidden = case((truth,), seed=3, runs=2, held_out=0, duration=15.0)
    problem, fit = as_in_the_file(hidden.recordings[:1], robot)
    view = command_view(hidden.recordings, robot)
    assert view.evidence["torque_limit"].nats > Options().least
    found = stepwise.StepwiseSelection(problem, fit, Options(), Timetable(), view).decide()
    assert [one.effect for one in found.named] == [truth] and found.dropped == ("battery_sag",)
    assert found.named[0].found["rate"].value == pytest.approx(hidden.truth.effects[truth]["rate"], rel=0.01)
    no_searches = Options(thresholds=replace(THRESHOLDS, most=0))
    none_fitted = stepwise.StepwiseSelection(problem, fit, no_searches, Timetable(), view).decide()
    assert [one.effect for one in none_fitted.named] == [truth]


def name_in_turn(monkeypatch: pytest.MonkeyPatch, worth: Sequence[str]) -> None:
    """Evidence is made up for these, the first one first; they are named as they are, without a fit, and all needed."""

    def made_up(evidence: object, fitted: object, commands: object, least: float, thresholds: Thresholds,
                without: Collection[str] = (), tried: Collection[str] = ()) -> Named | None:  # fmt: skip
        return next((Named(one, 1e3, ()) for one in worth if one not in without), None)

    search_nothing(monkeypatch)
    monkeypatch.setattr(stepwise, "best_of", made_up)
    monkeypatch.setattr(stepwise, "_with_effect", lambda problem, fit, *_: (problem, fit))
    monkeypatch.setattr(stepwise, "superfluous", lambda *_: None)


def test_errors_of_sensors_take_none_of_the_searches(monkeypatch: pytest.MonkeyPatch) -> None:
    """One effect is allowed: searches are over with the first that is none of a sensor, however many these name."""
    worth = ("gyro_bias", "pose_lever_arm", "slope", "encoder_scale", "payload")
    robot = load_robot("agriq")
    hidden = case((), seed=3, runs=1, held_out=0, duration=10.0)
    name_in_turn(monkeypatch, worth)
    monkeypatch.setattr(stepwise, "leaves_more_than_noise", lambda left: False)
    problem, fit = as_in_the_file(hidden.recordings, robot)
    options, view = Options(thresholds=replace(THRESHOLDS, most=1)), command_view(hidden.recordings, robot)
    found = stepwise.StepwiseSelection(problem, fit, options, Timetable(), view).decide()
    assert [one.effect for one in found.named] == ["gyro_bias", "pose_lever_arm", "slope"]


@pytest.mark.parametrize(
    ("left", "nats", "laws"), [(True, 2e3, True), (True, 2e3, False), (True, 500.0, True), (False, 2e3, True)]
)
def test_no_more_effects_are_looked_for_once_laws_explain_what_one_leaves_that_gained_less_than_they_promise(
    monkeypatch: pytest.MonkeyPatch, left: bool, nats: float, laws: bool
) -> None:
    """Laws are asked once. What only commands show is named all the same, for it takes no search."""
    motion, commanded = ("slope", "payload", "joint_damping"), "command_delay"
    robot = load_robot("agriq")
    hidden = case((), seed=3, runs=1, held_out=0, duration=10.0)
    name_in_turn(monkeypatch, (*motion, commanded))
    monkeypatch.setattr(stepwise, "leaves_more_than_noise", lambda _: left)
    monkeypatch.setattr(stepwise, "promise", lambda *_: nats)
    for name in ("_search_soil", "_thorough", "_drop_from_commands"):
        monkeypatch.setattr(stepwise.StepwiseSelection, name, lambda _: None)
    problem, fit = as_in_the_file(hidden.recordings, robot)
    asked: list[list[str]] = []

    def explained(decision: Decision) -> bool:
        asked.append([one.effect for one in decision.named])
        return laws

    options, view = Options(), command_view(hidden.recordings, robot)
    found = stepwise.StepwiseSelection(problem, fit, options, Timetable(), view, None, explained).decide()
    promised = left and nats > 1e3
    assert asked == ([["slope"]] if promised else [])
    named = motion[:1] if promised and laws else motion
    assert [one.effect for one in found.named] == [*named, commanded]


def search_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have searches by rotations try no effect."""
    monkeypatch.setattr(
        stepwise, "stage",
        lambda problem, fit, loss, *_: stepwise.SearchStage((), (), {}, problem, fit, loss, fit.point.cost),
    )  # fmt: skip


def as_in_the_file(recordings: Sequence[Experiment], robot: Robot) -> tuple[Problem, Fit]:
    """The soil of the robot file as a fit of recordings."""
    problem = problem_of(recordings, parameter_set(robot), 5.0, 1)
    loss = Loss(1.0, np.ones(len(CHANNEL_NAMES)))
    point = evaluate(problem, loss, [np.zeros(len(SOIL))], problem.starts)[0]
    return problem, Fit(point, loss, None, (), True)  # type: ignore[arg-type]


@pytest.mark.long
def test_a_search_goes_on_without_what_held_out_recordings_refute(monkeypatch: pytest.MonkeyPatch) -> None:
    try_only(monkeypatch, "slope", "gyro_bias")
    hidden = case(("slope", "gyro_bias"), seed=5, **DRIVE | {"runs": 1})
    robot, options = load_robot("agriq"), Options()
    problem, fit = baseline(hidden.recordings, robot, options)
    naming = stepwise.StepwiseSelection(problem, fit, options, Timetable(), command_view(hidden.recordings, robot))
    both = naming.decide()
    first, last = (one.effect for one in both.fitted)
    assert {first, last} == {"slope", "gyro_bias"}
    found = naming.without(last)
    assert found.refuted == (last,) and not found.dropped
    assert found.fitted[0].effect == first and last not in {one.effect for one in found.named}
    assert len(found.fits) == len(found.fitted) + 1
    for count, (model, _) in enumerate(found.fits):
        named = [one.effect for one in found.fitted[:count]]
        assert [extension.id for extension in model.parameters.extensions] == named
    (note,) = (one.note for one in ranking(found, THRESHOLDS) if one.effect == last)
    assert note == "held-out recordings are predicted worse with it"
