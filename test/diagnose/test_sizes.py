"""Robots of any size: what is plain follows from weight and lengths, and a light rover's small forces are named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnose.hidden import case
from diagnose.hidden.cases import driven
from diagnose.turns import EVEN

from artibot_sim.diagnose.candidates.hypotheses import hypotheses, with_effect, without_effect
from artibot_sim.diagnose.extended import found_parameters
from artibot_sim.diagnose.sizes import RobotScale, factors, scale_of, sized
from artibot_sim.estimation.solver import evaluate
from artibot_sim.identify.problems import problem_of
from artibot_sim.identify.requested import parameter_set
from artibot_sim.model import load_robot
from artibot_sim.model.effects import EFFECTS

AGRIQ, EPIQ, HUSKY = (load_robot(name) for name in ("agriq", "epiq", "husky"))


def test_plain_sizes_are_declared_for_agriq() -> None:
    assert scale_of(AGRIQ) == RobotScale(1.0, 1.0, 1.0)
    for effect, declared in EFFECTS.items():
        if declared.search is not None:
            assert not factors(effect, AGRIQ), effect
            assert sized(effect, AGRIQ).search.sizes == declared.search.sizes


@pytest.mark.parametrize(
    ("effect", "robot", "low", "high"),
    [
        ("external_force", EPIQ, 1.0, 3.0),  # N, of 4 kg
        ("external_force", HUSKY, 15.0, 30.0),
        ("joint_friction", EPIQ, 0.08, 0.3),  # N m
        ("payload", EPIQ, 0.4, 1.2),  # kg
        ("pose_lever_arm", EPIQ, 0.04, 0.08),  # m, of a track of 0.34
    ],
)
def test_a_plain_size_is_as_large_as_the_robot(effect: str, robot, low: float, high: float) -> None:  # type: ignore[no-untyped-def]
    extension = sized(effect, robot)
    (size, *_) = extension.values(np.array([1.0, 0.0])[: len(extension)]).values()
    assert low < size < high
    again = extension.coordinates(extension.values(np.full(len(extension), 0.4)))
    assert again == pytest.approx(np.full(len(extension), 0.4))


def test_what_has_no_size_is_the_same_for_all() -> None:
    for effect in ("slope", "gyro_bias", "command_delay", "encoder_scale", "stribeck", "gear_efficiency"):
        assert not factors(effect, EPIQ), effect


def test_a_scaled_robot_has_scaled_sizes() -> None:
    """Twice as heavy, everything else as it is."""
    front, back = (replace(module, m=2.0 * module.m + 4.0) for module in (AGRIQ.front, AGRIQ.back))
    heavy = replace(AGRIQ, front=front, back=back)
    assert scale_of(heavy).mass == pytest.approx(2.0)
    assert factors("joint_damping", heavy)["coefficient"] == pytest.approx(2.0)
    assert factors("motor_drag", heavy)["torque"] == pytest.approx(2.0)
    tried = {one.id: one.extension for one in hypotheses(heavy, [])}
    assert tried["payload"].search.sizes["mass"] == pytest.approx(30.0)


def test_hidden_effects_are_as_large_as_the_robot() -> None:
    _, put_in, _ = driven(("external_force",), 1.0, 3, 1, 5.0, robot="epiq")
    assert put_in["external_force"]["force"] == pytest.approx(35.0 * scale_of(EPIQ).mass)


@pytest.mark.parametrize("name", ["agriq", "epiq", "husky_driven", "train3"])
def test_whatever_is_tried_can_be_named(name: str) -> None:
    """With its values and as a robot, also where it has parameters that no search looks for."""
    robot = load_robot(name)
    for one in {one.id: one for one in hypotheses(robot, [])}.values():
        extension, own = one.extension, np.full(len(one.extension), 0.4)
        found = found_parameters(extension, own, 0.01 * np.eye(len(own)))
        assert set(extension.search.sizes) <= set(found), one.id
        values = {parameter: estimate.value for parameter, estimate in found.items()}
        stated = replace(robot, effects={one.id: values}).effects[one.id]
        assert all(stated[parameter] == value for parameter, value in values.items()), one.id
        neutral = {name: p.neutral for name, p in EFFECTS[one.id].parameters.items() if name not in found}
        assert all(stated[parameter] == value for parameter, value in neutral.items()), one.id


@pytest.mark.parametrize(("name", "shorter"), [("epiq", True), ("agriq", False)])
def test_friction_in_a_light_joint_takes_a_shorter_step(name: str, shorter: bool) -> None:
    """With the step of the plain robot Epi.q's joint chatters, and the true friction looks wrong."""
    robot = load_robot(name)
    found = case(("joint_friction",), 1.0, 5, runs=1, duration=10.0, robot=name)
    problem = problem_of(found.recordings, parameter_set(robot), 5.0, 2)
    extension = sized("joint_friction", robot)
    more = with_effect(problem, extension)
    assert (more._batch.dt < problem._batch.dt) is shorter
    point = evaluate(more, EVEN, [np.zeros(6)], more.starts)[0]
    assert without_effect(more, EVEN, point)[0]._batch.dt == problem._batch.dt
    soil = np.array([found.truth.soil[key.split(".")[-1]] for key in problem.parameters.keys])
    own = extension.coordinates(dict(found.truth.effects["joint_friction"]))
    there = [more.parameters.coordinates(soil, own)]

    def cost(dt: float) -> float:
        return evaluate(replace(more, dt=dt), EVEN, there, more.starts)[0].cost

    exact = cost(5e-4)
    assert cost(more._batch.dt) == pytest.approx(exact, rel=0.03)
    assert (cost(problem._batch.dt) > 1.1 * exact) is shorter
