"""Of long recordings some windows are searched; what they are too few for is named by the evidence of all."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnose.hidden import case
from diagnose.searches import FEW, remember_stages, try_only

from artibot_sim.diagnose.candidates.hypotheses import Hypothesis, with_effect
from artibot_sim.diagnose.candidates.screening import Trial
from artibot_sim.diagnose.commands.view import command_view
from artibot_sim.diagnose.policy import TRUST, Thresholds
from artibot_sim.diagnose.records import Options
from artibot_sim.diagnose.selection import stepwise
from artibot_sim.diagnose.selection.every_window import EveryWindow, every_window
from artibot_sim.diagnose.selection.joint_fits import Rival, Rounds
from artibot_sim.diagnose.sizes import sized
from artibot_sim.diagnose.timetable import Timetable
from artibot_sim.estimation.search import Effort, converge
from artibot_sim.estimation.solver import evaluate
from artibot_sim.estimation.windows import CHANNEL_NAMES
from artibot_sim.identify.run import best_fit
from artibot_sim.model import load_robot

DRIVE = {"runs": 2, "held_out": 0, "duration": 20.0, "manoeuvres": ("eight", "stop_and_go")}


@pytest.mark.long
def test_what_half_of_the_windows_are_too_few_for_is_named_by_all(monkeypatch: pytest.MonkeyPatch) -> None:
    """An effect is asked for more nats than half of the windows give, and less than all of them do."""
    remember_stages(monkeypatch)
    try_only(monkeypatch, *FEW)
    hidden = case(("joint_damping",), seed=31, **DRIVE)
    robot, options = load_robot("agriq"), Options()
    whole = every_window(hidden.recordings, robot, options)
    assert whole.times == 1.0, "nothing is left out of recordings as short as these"
    every = EveryWindow(whole.problem, range(0, len(whole.problem), 2))
    part, fit = best_fit(every.problem.part(every.rows), Effort(), lambda: None, TRUST)
    view = command_view(hidden.recordings, robot)
    found = stepwise.stage(part, fit, fit.loss, [], Rounds())
    by_part = found.evidence["joint_damping"].nats
    asked = Options(thresholds=replace(Thresholds(), floor=1.4 * by_part, tail=0.0, most=1))
    monkeypatch.setattr(stepwise, "leaves_more_than_noise", lambda left: False)

    few = stepwise.StepwiseSelection(part, fit, asked, Timetable(), view).decide()
    assert not few.named
    all_of_them = stepwise.StepwiseSelection(part, fit, asked, Timetable(), view, every).decide()
    assert [one.effect for one in all_of_them.named] == ["joint_damping"]
    assert 1.4 * by_part < all_of_them.named[0].nats < 3.0 * by_part
    easy = replace(asked, thresholds=replace(asked.thresholds, floor=0.5 * by_part))
    near = replace(easy, thresholds=replace(easy.thresholds, tie=1e6))
    first = stepwise.StepwiseSelection(part, fit, near, Timetable(), view, every).decide().stages[0]
    assert all_of_them.stages[0].by_every_window < first.by_every_window == {rival.id for rival in first.rivals}, (
        "what is near may tie"
    )
    anyway = stepwise.StepwiseSelection(part, fit, easy, Timetable(), view, every).decide()
    assert [(one.effect, one.nats) for one in anyway.named] == [("joint_damping", all_of_them.named[0].nats)]
    assert len(all_of_them.problem) == len(all_of_them.neutral_problem) == len(whole.problem)
    truth = hidden.truth.effects["joint_damping"]["coefficient"]
    extension = all_of_them.problem.parameters.extensions[0]
    own = all_of_them.fit.point.coordinates[all_of_them.problem.parameters.places[0]]
    assert extension.values(own)["coefficient"] == pytest.approx(truth, rel=0.15)


def test_a_fit_is_carried_with_its_noise_and_its_starts() -> None:
    """Noise that was widened stays so, for every window; nothing is fitted worse than where it began."""
    hidden = case((), seed=31, **(DRIVE | {"duration": 10.0}))
    whole = every_window(hidden.recordings, load_robot("agriq"), Options()).problem
    every = EveryWindow(whole, range(0, len(whole), 2))
    part, fit = best_fit(every.problem.part(every.rows), Effort(), lambda: None, TRUST)
    levels = np.linspace(1.1, 1.7, len(CHANNEL_NAMES))
    problem, carried = every.carried(part.rescaled(levels), fit, 2)
    for place, row in enumerate(every.rows):
        expected = part.windows[place].sigma * levels[part.windows[place].channel]
        assert problem.windows[row].sigma == pytest.approx(expected)
    for before, after in zip(whole.windows, problem.windows, strict=True):
        assert (after.sigma > before.sigma).all()
    starts = problem.starts.copy()
    starts[list(every.rows)] = fit.point.starts
    begun = evaluate(problem, fit.loss, [fit.point.coordinates], starts)[0]
    assert carried.point.cost <= begun.cost


def test_no_effect_is_worse_than_none_over_all_windows() -> None:
    """What fits the searched windows by chance may not fit the others; with the effect at neutral it does."""
    hidden = case((), seed=31, **(DRIVE | {"duration": 10.0}))
    robot = load_robot("agriq")
    whole = every_window(hidden.recordings, robot, Options()).problem
    every = EveryWindow(whole, range(0, len(whole), 2))
    part, fit = best_fit(every.problem.part(every.rows), Effort(), lambda: None, TRUST)
    loss = replace(fit.loss, firm=True)
    extension = sized("joint_friction", robot)
    more = with_effect(part, extension)
    far = evaluate(more, loss, [np.append(fit.point.coordinates, 3.0)], part.starts)[0]
    begun = replace(converge(more, far, loss, 1), point=far)
    rival = Rival(Trial(Hypothesis(extension), more, far, np.ones(1)), begun)
    (found,), (_, best) = every.evidence(part, replace(fit, loss=loss), [rival], 0, replace(Rounds(), many=1, few=1))
    assert found.gained >= -1e-6, "but for rounding"
    assert best.point.cost <= every.carried(part, replace(fit, loss=loss), 1)[1].point.cost
