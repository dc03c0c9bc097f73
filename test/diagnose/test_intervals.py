"""Values of a diagnosis and how sure they are: noise of encoders bends no value, views that differ are less sure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from artibot_sim.diagnose.candidates.hypotheses import with_effect, without_effect
from artibot_sim.diagnose.intervals import Uncertain, combined, judged
from artibot_sim.diagnose.records import EffectEstimate
from artibot_sim.diagnose.selection.decision import Decision
from artibot_sim.estimation.encoder_noise import NoiseShare, noise_share
from artibot_sim.estimation.loss import Loss
from artibot_sim.estimation.parameters import Extension, ParameterSet
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.search import Fit, converge, free_parameters
from artibot_sim.estimation.solver import evaluate, reduce
from artibot_sim.estimation.surroundings import along, surroundings
from artibot_sim.estimation.uncertainty import Node, reweighted
from artibot_sim.estimation.windows import CHANNEL_NAMES
from artibot_sim.identify.problems import problem_of
from artibot_sim.identify.requested import parameter_set
from artibot_sim.identify.synthetic import synthetic
from artibot_sim.model import load_robot
from artibot_sim.planning import Arc, Dwell, Manoeuvre, Ramp, Stop

ROBOT = load_robot("agriq")
TURN = Manoeuvre("turn", (Dwell(0.5), Ramp(speed=0.5), Arc(radius=2.0, angle=2.0), Stop()), a_max=0.5, blend=0.3)
BACK = CHANNEL_NAMES.index("torque_back")
SCALE = Extension("torque_scale")


@pytest.fixture(scope="module")
def fitted() -> tuple[Problem, Fit]:
    """Recordings with nothing hidden, and the fit of a back friction to them."""
    runs = [synthetic(ROBOT, TURN, kappa=0.8, seed=seed) for seed in (6, 7)]
    problem = problem_of(runs, parameter_set(ROBOT), 2.5, 2)
    beside = with_effect(problem, Extension("back_friction"))
    loss = Loss(1.0, np.ones(len(CHANNEL_NAMES)))
    point = evaluate(beside, loss, [np.zeros(6)], beside.starts)[0]
    return beside, converge(beside, point, loss, 3)


def test_noise_goes_with_the_square_of_what_grips(fitted: tuple[Problem, Fit]) -> None:
    problem, fit = fitted
    slopes = noise_share(problem, fit).slopes[:, BACK]
    names = problem.parameters.keys
    grip = slopes[names.index("contact.k_l")]
    assert 1.4 < grip < 3.0
    # coordinate 1 is a factor exp(0.5)
    assert 0.5 < slopes[names.index("effects.back_friction.scale")] < 1.5
    assert abs(slopes[names.index("contact.u_w")]) < 0.5 * grip


def test_what_only_a_sensor_says_answers_no_noise(fitted: tuple[Problem, Fit]) -> None:
    problem, fit = fitted
    beside = with_effect(without_effect(problem, fit.loss, fit.point)[0], Extension("encoder_scale"))
    point = evaluate(beside, fit.loss, [np.append(fit.point.coordinates[:5], -0.3)], fit.point.starts)[0]
    slopes = noise_share(beside, replace(fit, point=point)).slopes
    assert slopes[:5].any() and not slopes[-1].any()


def test_what_the_noise_has_bent_is_straightened(fitted: tuple[Problem, Fit]) -> None:
    problem, fit = fitted
    bent = fit.point.coordinates[-1]
    found = judged(problem, fit, surroundings([(problem, fit)])[0])
    own, sd = found.coordinates[-1], np.sqrt(found.covariance[-1, -1])
    assert bent < -0.1  # wheels that are all alike seem to grip less at the back
    assert abs(own) < 0.4 * abs(bent)
    assert abs(own) < 3.0 * sd


def test_the_walk_goes_along_each_effect(fitted: tuple[Problem, Fit]) -> None:
    problem, fit = fitted
    both = with_effect(problem, SCALE)
    point = evaluate(both, fit.loss, [np.append(fit.point.coordinates, 0.1)], fit.point.starts)[0]
    free = free_parameters(both)
    residuals, sensitivity = both.linearised(point.coordinates, point.starts, free)
    stands = Fit(point, fit.loss, reduce(both, fit.loss, residuals, sensitivity, point.starts), free, False)
    for place in (5, 6):
        nodes = [node for line in along(both, stands, slice(place, place + 1)) for node in line()]
        nodes.sort(key=lambda node: float(node.point.coordinates[place]))
        sizes = np.array([node.point.coordinates[place] for node in nodes]) - point.coordinates[place]
        assert (sizes < -0.01).any() and (sizes > 0.01).any() and np.abs(sizes).min() > 0.01
        beside_it = {float(node.point.coordinates[11 - place]) for node in nodes}
        assert len(beside_it) == len(nodes), "the other effect follows"
        rise = [node.point.cost - point.cost for node in nodes[:: len(nodes) - 1]]
        assert all(
            r > 10.0 or abs(s) > 0.2 * abs(point.coordinates[place])
            for r, s in zip(rise, sizes[:: len(nodes) - 1], strict=True)
        )
        assert all(len(node.reduced.matrix) == len(free) for node in nodes)


def test_draws_stay_within_bounds_where_the_loss_is_flat(fitted: tuple[Problem, Fit]) -> None:
    problem, fit = fitted
    count = len(problem)
    silent = NoiseShare(fit.point.coordinates, np.zeros((count, len(CHANNEL_NAMES))), np.zeros((6, len(CHANNEL_NAMES))))
    flat = replace(fit.reduced, gradient=1e3 * (1.0 + fit.reduced.gradient))
    (drawn,) = reweighted(problem, [Node(fit.point, flat)], fit.free, silent, [np.ones(count)])
    assert np.allclose(drawn, problem.parameters.inside(drawn))
    problem.parameters.robot_at(drawn)


def test_a_model_that_a_decision_falls_back_to_has_no_other_ends(fitted: tuple[Problem, Fit]) -> None:
    problem, fit = fitted
    plain, point = without_effect(problem, fit.loss, fit.point)
    neutral = replace(fit, point=point)
    whole = Decision((), 58.0, ((plain, neutral), (problem, fit)), (), {}, beside=((problem, fit),))
    assert whole.others == (fit,)
    assert replace(whole, fits=whole.fits[:1]).others == ()


def scales(sd: float, along: float) -> tuple[ParameterSet, Uncertain]:
    """A torque scale of 0.9, known to `sd` coordinates, with forces that make up for it."""
    plain = parameter_set(ROBOT)
    parameters = ParameterSet(ROBOT, plain.parameters, (SCALE,))
    direction = np.array([along] * 5 + [1.0])
    mean = np.concatenate([np.zeros(5), SCALE.coordinates({"scale": 0.9})])
    return parameters, Uncertain(mean, sd**2 * np.outer(direction, direction) + 1e-8 * np.eye(6))


def from_commands(scale: float, half: float) -> dict[str, dict[str, EffectEstimate]]:
    return {"torque_scale": {"scale": EffectEstimate(scale, "1", (scale - half, scale + half))}}


def test_what_commands_say_takes_the_soil_with_it() -> None:
    parameters, what = scales(sd=0.2, along=-0.15)
    found = combined(parameters, what, from_commands(0.92, 0.002))
    assert SCALE.values(found.coordinates[-1:])["scale"] == pytest.approx(0.92, abs=0.002)
    ratio = parameters.values(found.coordinates) / parameters.values(what.coordinates)
    assert ratio == pytest.approx(np.full(5, 0.9 / 0.92), rel=0.004)
    assert found.covariance[-1, -1] < 0.05 * what.covariance[-1, -1]


def test_views_that_contradict_each_other_are_less_sure() -> None:
    parameters, what = scales(sd=0.01, along=-0.15)
    agree, differ = (combined(parameters, what, from_commands(scale, 0.003)) for scale in (0.9, 0.95))
    assert differ.covariance[-1, -1] > 4.0 * agree.covariance[-1, -1]
    low, high = (SCALE.coordinates({"scale": scale})[0] for scale in (0.9, 0.95))
    sd = np.sqrt(differ.covariance[-1, -1])
    assert differ.coordinates[-1] - 2.0 * sd < low < high < differ.coordinates[-1] + 2.0 * sd


def test_what_no_other_view_knows_stays() -> None:
    parameters, what = scales(sd=0.1, along=0.0)
    assert np.allclose(combined(parameters, what, {}).coordinates, what.coordinates)
