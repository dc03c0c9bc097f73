"""What whole windows answer to forces: the pulses of which forces are made promise what laws in the model do."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from diagnose.turns import EVEN, TURNS

from artibot_sim.diagnose.candidates.hypotheses import with_effect
from artibot_sim.diagnose.candidates.screening import Around, around
from artibot_sim.diagnose.unlisted.finding import whole_regression
from artibot_sim.diagnose.unlisted.fitting import extension_of, law_of
from artibot_sim.diagnose.unlisted.search import families, judged
from artibot_sim.estimation.problem import Sensitivity, clip
from artibot_sim.estimation.solver import reduce
from artibot_sim.identify.problems import problem_of
from artibot_sim.identify.requested import parameter_set
from artibot_sim.identify.synthetic import synthetic
from artibot_sim.identify.validation import fitted_starts
from artibot_sim.model import load_robot

STEP = 0.1
"""Of a law's size, of which the recording was made with the whole: by less than that wheels' switches tell little."""


def by_the_law(base: Around, law: dict[str, Any], size: float) -> tuple[float, float]:
    """Nats that a law gains, and its size: by the law itself in the model, a tenth of it."""
    extension = extension_of("force_law", law, np.array([size]))
    problem, free = with_effect(base.problem, extension), list(base.free)
    (there,) = problem.flat_residuals([np.append(base.point.coordinates, STEP)], base.point.starts)
    own = (there - base.point.residuals.flat)[None] / STEP
    clip(problem.samples, own)
    every = Sensitivity(np.vstack([own, base.sensitivity.parameters]), base.sensitivity.starts)
    reduced = reduce(problem, base.loss, base.point.residuals, every, base.point.starts)
    prior = base.problem.parameters.prior_information
    H, gradient = reduced.matrix.copy(), reduced.gradient.sum(axis=0)
    H[1:, 1:] += prior[np.ix_(free, free)]
    gradient[1:] += (prior @ base.point.coordinates)[free]
    whole, beside = np.linalg.solve(H, -gradient), np.linalg.solve(H[1:, 1:], -gradient[1:])
    return 0.5 * float(-gradient @ whole + gradient[1:] @ beside), float(whole[0] * size)


@pytest.mark.parametrize(
    ("name", "force", "where", "variable", "size"),
    [
        ("agriq", "lateral force of each back wheel", "back_wheels_lateral", "lateral_speed", 100.0),
        ("agriq", "longitudinal force of the front_left wheels", "front_left_longitudinal", "speed", 12.0),
        pytest.param("train3", "yaw moment in joint 2", "joint_2", "articulation_angle", 12.0, marks=pytest.mark.long),
    ],
)
def test_pulses_promise_what_a_law_in_the_model_gains(
    name: str, force: str, where: str, variable: str, size: float
) -> None:
    robot, law = load_robot(name), {"where": where, "variable": variable, "form": "linear"}
    real = replace(robot, effects={"force_law": law | {"size": size}})
    problem = problem_of([synthetic(real, TURNS, seed=4)], parameter_set(robot), 4.0, 1).part([1, 3])
    base = around(problem, EVEN, fitted_starts(problem, 1))
    equations, of = whole_regression(base)
    every = (one for one, _ in judged(equations, of, force, families(of)[force], lambda form: form.name == "linear"))
    found = next(one for one in every if law_of(one, len(robot.modules))[0]["variable"] == variable)
    gain, own = by_the_law(base, law, size)
    assert found.gain == pytest.approx(gain, rel=0.3) and gain > 50.0
    assert found.coefficients == pytest.approx([own], rel=0.3)
