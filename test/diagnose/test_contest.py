"""Which effects are fitted with the soil: what gains in the screen, and what promises to."""

from __future__ import annotations

from diagnose.hidden import case

from artibot_sim.diagnose.contest import Rounds, contest
from artibot_sim.diagnose.hypotheses import hypotheses
from artibot_sim.diagnose.options import Options
from artibot_sim.diagnose.run import baseline
from artibot_sim.diagnose.screen import at_rest, screen
from artibot_sim.model import load_robot


def test_what_sensitivities_promise_is_fitted_though_other_branches_hide_it() -> None:
    """Each probe throws windows off their branch, where the softened ground explains less than none at all."""
    robot = load_robot("agriq")
    problem, fit = baseline(case(("soil_softening",), 0.3, 212777215).recordings, robot, Options())
    base, control = at_rest(problem, fit.loss, fit.point, Rounds().few)
    softening = [one for one in hypotheses(robot, problem.stretches) if one.id == "soil_softening"]
    (trial,) = screen(base, softening)
    assert trial.point.cost > control.cost and trial.promised > 100.0
    (rival,) = contest([trial], control.cost, fit.loss, Rounds())
    assert 0.5 * (control.cost - rival.fit.point.cost) > 300.0
    assert not contest([trial], control.cost, fit.loss, Rounds(hopes=0))
