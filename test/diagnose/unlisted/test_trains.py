"""Forces on no list of robots of more than two modules: where they act, and that one behind the second is found."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from artibot_sim.diagnose.unlisted.finding import search_forces, unexplained_of
from artibot_sim.diagnose.unlisted.fitting import fitted_laws, law_of
from artibot_sim.diagnose.unlisted.response import components_of, moved_by
from artibot_sim.diagnose.unlisted.variables import _places
from artibot_sim.estimation.loss import Loss
from artibot_sim.estimation.parameters import SOIL
from artibot_sim.estimation.search import converge
from artibot_sim.estimation.solver import evaluate
from artibot_sim.estimation.windows import CHANNEL_NAMES
from artibot_sim.identify.problems import problem_of
from artibot_sim.identify.requested import parameter_set
from artibot_sim.identify.synthetic import synthetic
from artibot_sim.model import initial_state, load_robot
from artibot_sim.planning import Dwell, Manoeuvre, Ramp, Slalom, Stop

TURNS = Manoeuvre(
    "turns",
    (Dwell(0.3), Ramp(speed=0.7), Slalom(curvature=0.5, wavelength=9.0, periods=2.0), Ramp(speed=0.3),
     Slalom(curvature=0.6, wavelength=5.0, periods=1.0), Stop()),
    a_max=0.5, blend=0.3,
)  # fmt: skip


@pytest.mark.parametrize("name", ["husky", "agriq", "train5"])
def test_components_of_a_force_do_its_work(name):
    """A force on any module takes as much power by its components as at its own origin; places are the model's own."""
    robot, rng = load_robot(name), np.random.default_rng(5)
    joints = robot.articulation_joints[::2]
    names = ["x", "y", "yaw", "yaw_rate", "v_x", "v_y", *joints, *(one.replace("_yaw", "_rate", 1) for one in joints)]
    motion = {one: rng.normal(size=(3, 2)) for one in names}
    places = _places(robot, motion)
    assert len(places) == len(robot.modules)
    rates = [motion["v_x"], motion["v_y"], *(place.turn for place in places)]
    for place in places:
        surge, sway, turn = rng.normal(size=(3, 3, 2))
        made = place.force(surge, sway, turn)
        assert len(made) == len(components_of(robot))
        power = sum(force * rate for force, rate in zip(made, rates, strict=False))
        own = surge * place.forward + sway * place.left + turn * place.turn
        np.testing.assert_allclose(power, own, rtol=1e-12, atol=1e-12)
    assert len(rates) == moved_by(robot) or name == "husky"  # a rigid robot's second moment moves nothing
    bends = [motion[one][0, 0] for one in joints]
    stands = initial_state(robot, *(motion[one][0, 0] for one in ("x", "y", "yaw")), bends if joints else 0.0)
    at = stands.q.reshape(-1, 8)
    for i, place in enumerate(places):
        np.testing.assert_allclose(at[i, [0, 1, 5]], [place.x[0, 0], place.y[0, 0], place.yaw[0, 0]], atol=1e-12)


@pytest.mark.long
def test_a_spring_in_the_second_joint_alone_is_found_and_is_a_law():
    """From two recordings with noise: named by its place and variable, and as a term of the model about as large.

    No effect on the list acts in one joint of several.
    """
    robot, size = load_robot("train3"), 150.0
    hidden = {"size": size, "where": "joint_2", "variable": "articulation_angle", "form": "linear"}
    real = replace(robot, effects={"force_law": hidden})
    drives = [replace(synthetic(real, TURNS, seed=seed), name=f"drive{seed}", path=Path(f"{seed}")) for seed in (1, 2)]
    problem = problem_of(drives, parameter_set(robot, SOIL), 3.0, 1)
    soil = np.zeros(len(problem.parameters))
    found = search_forces(problem, soil, windows=100)
    answer = unexplained_of(found)
    assert (answer.force, answer.variable, answer.form) == ("yaw moment in joint 2", "articulation angle", "linear")
    law, _ = law_of(found.chosen[0], len(robot.modules)) or ({}, None)
    assert law["where"] == "joint_2"
    problem = replace(problem, windows=problem.windows[::3])
    loss = Loss(1.0, np.ones(len(CHANNEL_NAMES)))
    fit = converge(problem, evaluate(problem, loss, [soil], problem.starts)[0], loss, 4)
    laws = fitted_laws(problem, fit, found)
    assert laws is not None
    (extension,), (part,) = laws.problem.parameters.extensions, laws.problem.parameters.places
    assert extension.values(laws.fit.point.coordinates[part])["size"] == pytest.approx(size, rel=0.25)
