"""How far the search for the first effect ends from its best by the luck of its random draws.

`PYTHONPATH=.:test python -m diagnose.hidden.scatter --examples DIR --seeds 4` searches the recordings of each folder in
DIR, and a generated case with a load on the front module, by several seeds. All ends are compared under one loss, that
of the first seed, so that only what the search missed is seen; the evidence as stated has the noise of its own fit.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np
from diagnose.searches import baseline

from artibot_sim.bench.steadiness import EXAMPLES, HIDDEN, Case, generated, recorded
from artibot_sim.diagnose.holdout import split
from artibot_sim.diagnose.records import Options
from artibot_sim.diagnose.selection.forward import SearchStage, stage
from artibot_sim.diagnose.selection.joint_fits import Rounds
from artibot_sim.estimation.alignment import on_one_clock
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.search import Fit
from artibot_sim.estimation.solver import evaluate
from artibot_sim.model import Robot, load_robot


class Searched(NamedTuple):
    """The first search by one seed, and the processor time of soil and effects, s."""

    seed: int
    stage: SearchStage
    soil: float
    effects: float


def searched(case: Case, robot: Robot, seed: int) -> Searched:
    """Soil, and the effects beside it."""
    timed = on_one_clock(case.recordings, robot, seed)
    fitted, _ = split([one.experiment for one in timed], [], robot)
    begun = time.process_time()
    problem, fit = baseline(fitted, robot, Options(seed=seed, workers=1))
    soil = time.process_time()
    found = stage(problem, fit, fit.loss, (), Rounds())
    return Searched(seed, found, soil - begun, time.process_time() - soil)


def missed(first: SearchStage, found: SearchStage, effect: str) -> float:
    """Nats of a fit with an effect (none: "") under the first search's noise, a constant apart; NaN if not fitted."""
    fits: dict[str, tuple[Problem, Fit]] = {"": (found.problem, found.fit)}
    fits |= {rival.id: (rival.problem, rival.fit) for rival in found.rivals}
    if effect not in fits:
        return float("nan")
    own, fit = fits[effect]
    problem = first.problem.with_parameters(own.parameters)
    return 0.5 * evaluate(problem, first.fit.loss, [fit.point.coordinates], fit.point.starts)[0].cost


def lines(case: Case, found: Sequence[Searched]) -> Iterator[str]:
    """A line for each model, and one for the time."""
    first = found[0].stage
    yield case.name
    for effect in ("", *(rival.id for rival in first.rivals[:2])):
        ends = np.array([missed(first, one.stage, effect) for one in found])
        behind = ends - np.nanmin(ends)
        stated = [one.stage.evidence[effect].nats if effect in one.stage.evidence else np.nan for one in found]
        said = f"; evidence {' '.join(f'{nats:.0f}' for nats in stated)}" if effect else ""
        each = " ".join(f"{nats:.0f}" for nats in behind)
        yield f"  {effect or 'soil alone':20s} {np.nanmax(behind):6.0f} nats apart: {each}{said}"
    cost = [(one.soil, one.effects) for one in found]
    yield "  processor time: soil {:.0f} s, effects {:.0f} s each".format(*np.mean(cost, axis=0))


def main(argv: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--examples", type=Path, default=os.environ.get(EXAMPLES))
    parser.add_argument("--only", default="none,joint_friction,slope,payload")
    parser.add_argument("--seeds", type=int, default=4)
    options = parser.parse_args(argv)
    robot, wanted = load_robot("agriq"), options.only.split(",")
    place = next(i for i, hidden in enumerate(HIDDEN) if "payload" in hidden)
    cases = [case for case in recorded(options.examples) if case.name in wanted] if options.examples else []
    if "payload" in wanted:
        cases += islice(generated(place + 1, 45.0, robot), place, None)
    for case in cases:
        for line in lines(case, [searched(case, robot, seed) for seed in range(options.seeds)]):
            print(line, flush=True)


if __name__ == "__main__":
    main()
