"""Whether a resistance at the wheels holds on held-out windows beside ground that varies, where it is there and not.

``PYTHONPATH=.:test python -m diagnose.hidden.varying [CASES]`` prints intervals of nats, so many cases a kind (4).
"""

from __future__ import annotations

import sys

import numpy as np
from diagnose.hidden.cases import Case, case
from diagnose.hidden.logged import VARYING

from artibot_sim.diagnose.records import HALF_WIDTH
from artibot_sim.diagnose.validation.predictions import predicted
from artibot_sim.diagnose.validation.varying_ground import Model, beside_varying_ground
from artibot_sim.estimation.loss import Loss
from artibot_sim.estimation.parameters import SOIL, Prior
from artibot_sim.estimation.search import Fit, converge, thinned
from artibot_sim.estimation.solver import evaluate
from artibot_sim.estimation.windows import CHANNEL_NAMES
from artibot_sim.identify.problems import problem_of
from artibot_sim.identify.requested import parameter_set
from artibot_sim.model import load_robot

RESISTANCE = "wheel_resistance"
KINDS = ((), (VARYING,), (RESISTANCE,), (RESISTANCE, VARYING))


def model(of: Case, *more: str) -> Model:
    """Soil and `more`, fitted from the mean soil, with its predictions of what is held out."""
    robot = load_robot(of.robot).replace({f"contact.{name}": value for name, value in of.truth.soil.items()})
    parameters = parameter_set(robot, (*SOIL, *more), {name: Prior(0.15, 0.2) for name in more})
    problem = problem_of(of.recordings, parameters, of.horizon, 1, HALF_WIDTH, 0)
    loss = Loss(1.0, np.ones(len(CHANNEL_NAMES)))
    start = evaluate(problem, loss, [np.zeros(len(parameters.parameters))], problem.starts)[0]
    fit = converge(problem, start, loss, 4)
    fit = Fit(**{**vars(fit), "loss": thinned(problem, fit)})
    final = parameters.robot_at(fit.point.coordinates)
    return problem, fit, [predicted(one, final, of.horizon, 1) for one in of.holdout]


def held(effects: tuple[str, ...], seed: int, duration: float = 60.0) -> tuple[float, float]:
    """Interval of the nats of a case with `effects`."""
    of = case(effects, seed=seed, runs=2, duration=duration, robot="husky_driven")
    return beside_varying_ground(model(of), model(of, f"effects.{RESISTANCE}.share"), 0)


def main(cases: str = "4") -> None:
    """Print every case."""
    for effects in KINDS:
        for seed in range(1, int(cases) + 1):
            low, high = held(effects, seed)
            print(f"{' + '.join(effects) or 'nothing':36} seed {seed}: {low:8.1f} … {high:.1f} nats", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
