"""One case in full: what was hidden, what the fit alone says of it, and what the diagnosis makes of that.

`PYTHONPATH=.:test python -m diagnose.hidden.one back_friction 0.3 101` (effect, severity, seed; two runs of 30 s, or so
many of so long with two more numbers, `3 45`). Several effects stand with + between them; `none` hides nothing.
"""

from __future__ import annotations

import sys

from diagnose.hidden.cases import case
from diagnose.searches import baseline

from artibot_sim.diagnose.assessment import Assessor
from artibot_sim.diagnose.candidates.patches import disc_place, scanned
from artibot_sim.diagnose.commands.view import command_view
from artibot_sim.diagnose.conclusion import concluded
from artibot_sim.diagnose.extended import found_parameters
from artibot_sim.diagnose.intervals import judged
from artibot_sim.diagnose.records import Options
from artibot_sim.diagnose.selection.decision import Decision
from artibot_sim.diagnose.selection.ranking import ranking
from artibot_sim.diagnose.selection.stepwise import StepwiseSelection
from artibot_sim.diagnose.timetable import Timetable
from artibot_sim.diagnose.validation.stability import drifts
from artibot_sim.estimation.surroundings import surroundings
from artibot_sim.model import load_robot


def main(effect: str, severity: str, seed: str, runs: str = "2", duration: str = "30", robot: str = "agriq") -> None:
    """Diagnose and print."""
    hidden = effect.split("+") if effect != "none" else ()
    found = case(hidden, float(severity), int(seed), runs=int(runs), duration=float(duration), robot=robot)
    rover, options = load_robot(robot), Options()
    problem, fit = baseline(found.recordings, rover, options)
    view = command_view(found.recordings, rover)
    decision = StepwiseSelection(problem, fit, options, Timetable(), view).decide()
    assessor = Assessor(rover, found.recordings, found.holdout, options, Timetable(), view)
    decision = concluded(decision, view, assessor.worth).decision
    acting = {**found.truth.effects, **found.truth.unlisted}
    print("hidden:", {name: dict(values) for name, values in acting.items()})
    print("said:", decision.verdict.value, *(f"{n.effect} by {n.nats:.0f} nats" for n in decision.named))
    if decision.unexplained is not None:
        print("unexplained:", decision.unexplained)
    print("left:", {name: round(one.typical, 2) for name, one in decision.left.items()})
    last = decision.stages[-1]  # what would be named, whatever became of it
    print("drift:", {name: round(nats, 1) for name, nats in drifts(last.problem, last.fit).items()})
    base = decision.stages[0].base
    if base is not None:
        promised = max((seen.disc.gain for seen in scanned(base, "friction_patch")), default=0.0)
        print(f"a patch along the paths promises: {promised:.1f} nats")
    for line in values(decision, options.seed):
        print(line)
    for one in ranking(decision, options.thresholds):
        if (one.effect in hidden or not hidden) and (one.excluded_above or one.excluded_below):
            print(f"{one.effect} excluded from:", dict(one.excluded_above), "below:", dict(one.excluded_below))


def values(decision: Decision, seed: int) -> list[str]:
    """Lines with each effect's values as fitted, and as they are given, with their intervals."""
    parameters = decision.problem.parameters
    from_commands = {effect: other.found for effect, other in decision.other.items()}
    around = surroundings([(decision.problem, decision.fit)])[0]
    what, lines = judged(decision.problem, decision.fit, around, from_commands), []
    for which, (extension, part) in enumerate(zip(parameters.extensions, parameters.places, strict=True)):
        places = disc_place(decision.problem, decision.fit, which, seed)
        given = found_parameters(extension, what.coordinates[part], what.covariance[part, part], places)
        lines.append(f"fit alone: {extension.values(decision.fit.point.coordinates[part])}")
        lines.append(f"given: { {name: (one.value, one.ci95) for name, one in given.items()} }")
    return lines


if __name__ == "__main__":
    main(*sys.argv[1:6])
