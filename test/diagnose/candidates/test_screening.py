"""The screen: what is hidden in a recording gains most, nothing gains where there is nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnose.turns import EVEN, TURNS

from artibot_sim.diagnose.candidates.hypotheses import Hypothesis, hypotheses
from artibot_sim.diagnose.candidates.patches import discs
from artibot_sim.diagnose.candidates.screening import Around, around, converged_baseline, screen
from artibot_sim.diagnose.sizes import sized
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.search import converge
from artibot_sim.estimation.solver import evaluate
from artibot_sim.identify.problems import problem_of
from artibot_sim.identify.requested import parameter_set
from artibot_sim.identify.synthetic import random_manoeuvre, synthetic
from artibot_sim.identify.validation import fitted_starts
from artibot_sim.model import Robot, load_robot
from artibot_sim.planning import Arc, Dwell, Manoeuvre, Ramp, Stop

ROBOT = load_robot("agriq")


def base(effects: dict[str, dict[str, object]], start: tuple[float, float, float] = (0.0, 0.0, 0.4)) -> Around:
    """A recording with something hidden, seen from the right soil."""
    real: Robot = replace(ROBOT, effects=effects)
    recording = synthetic(real, TURNS, kappa=0.8, seed=4, start=start)
    problem: Problem = problem_of([recording], parameter_set(ROBOT), 5.0, 2)
    return around(problem, EVEN, fitted_starts(problem, 2))


def gains(seen: Around, names: tuple[str, ...]) -> dict[str, float]:
    tried = [h for h in hypotheses(ROBOT, seen.problem.stretches) if h.id in names]
    trials = screen(seen, tried)
    return {t.hypothesis.extension.label: 0.5 * (seen.point.cost - t.point.cost) for t in trials}


LEAST = 120.0
"""Nats that tell something from nothing here, where starts are fitted coarsely and noise is taken to be white."""
RIVALS = ("joint_friction", "joint_stiffness", "slope", "motor_drag", "back_friction")


@pytest.mark.parametrize(
    ("effect", "values", "label"),
    [
        ("joint_friction", {"torque": 8.0}, "joint_friction"),
        ("slope", {"grade": 0.04, "heading": 2.0}, "slope"),
        ("motor_drag", {"torque": 0.2, "motor": "back_left"}, "motor_drag(back_left)"),
    ],
)
def test_what_is_hidden_gains_most(effect: str, values: dict[str, object], label: str) -> None:
    found = gains(base({effect: values}), RIVALS)
    assert max(found, key=lambda name: found[name]) == label
    assert found[label] > LEAST


def test_a_faint_patch_is_found_where_a_plain_one_would_fit_worse_than_none() -> None:
    seen = base({"friction_patch": {"scale": 0.87, "x": 3.0, "y": 1.5, "radius": 1.5}})
    best = min(discs(seen), key=lambda trial: trial.point.cost)
    place = best.hypothesis.extension.fixed
    assert 0.5 * (seen.point.cost - best.point.cost) > LEAST
    assert np.hypot(place["x"] - 3.0, place["y"] - 1.5) < 1.5


def test_nothing_gains_little() -> None:
    found = gains(base({}), RIVALS)
    assert max(found.values()) < LEAST


def test_the_direction_of_a_slope_turns_with_the_map() -> None:
    """The same drive with everything turned by 1 rad: the direction goes along, as far as the screen's few tell."""
    found = []
    for heading, yaw in ((2.0, 0.4), (3.0, 1.4)):
        seen = base({"slope": {"grade": 0.04, "heading": heading}}, (0.0, 0.0, yaw))
        (tried,) = screen(seen, [h for h in hypotheses(ROBOT, seen.problem.stretches) if h.id == "slope"])
        assert 0.5 * (seen.point.cost - tried.point.cost) > 10 * LEAST
        found.append(tried.hypothesis.extension.values(tried.effect_coordinates))
    assert found[1]["heading"] - found[0]["heading"] == pytest.approx(1.0, abs=0.5)
    assert found[1]["grade"] == pytest.approx(found[0]["grade"], rel=0.5)  # its size needs more than a screen


def test_a_soil_that_took_an_effect_for_its_own_gives_it_back() -> None:
    """Rolling resistance that grows with speed is first taken for much rolling resistance."""
    speeds = Manoeuvre(
        "speeds",
        (Dwell(0.5), Ramp(speed=0.4), Arc(radius=3.0, angle=0.8), Ramp(speed=0.9), Arc(radius=3.0, angle=-1.5), Stop()),
        a_max=0.5, blend=0.15,
    )  # fmt: skip
    real = replace(ROBOT, effects={"rolling_resistance_speed": {"coefficient": 1.5}})
    problem = problem_of([synthetic(real, speeds, kappa=0.8, seed=5)], parameter_set(ROBOT), 5.0, 2)
    starts = fitted_starts(problem, 2)
    values = problem.parameters.values(starts.coordinates)
    tried = []
    for factor in (1.0, 1.3, 1.6, 1.8, 2.0, 2.2):
        more = values.copy()
        more[problem.parameters.index("contact.u_w")] *= factor
        tried.append(problem.parameters.coordinates(more))
    point = min(evaluate(problem, EVEN, tried, starts.starts), key=lambda p: p.cost)
    assert not np.array_equal(point.coordinates, tried[0])
    found = gains(around(problem, EVEN, point), ("rolling_resistance_speed", "slope", "motor_drag"))
    best = max(found, key=lambda label: found[label])
    assert best == "rolling_resistance_speed" and found[best] > LEAST


def test_probes_gain_what_fits_beside_them_gain_though_the_law_is_not_linear() -> None:
    """Tyres that wind up were taken for soft ground: beside each probe the ground is another one."""
    soil = {"contact.k_l": 480.0, "contact.k_t": 480.0, "contact.mu_s": 0.4, "contact.mu_d": 0.35}
    husky = load_robot("husky_driven").replace(soil)
    real = replace(husky, effects={"wheel_windup": {"way": 0.02}})
    run = synthetic(real, random_manoeuvre(np.random.default_rng(3), 60.0), duration=60.0, kappa=1.0, seed=4)
    problem = problem_of([run], parameter_set(husky), 2.0, 2)
    soft = converge(problem, fitted_starts(problem, 2), EVEN, 12).point
    seen, _ = converged_baseline(problem, EVEN, soft, 2)
    (trial,) = screen(seen, [h for h in hypotheses(husky, problem.stretches) if h.id == "wheel_windup"])
    for probe, cost in trial.tested:
        windup = trial.hypothesis.extension.values(probe)
        held = problem_of([run], parameter_set(replace(husky, effects={"wheel_windup": windup})), 2.0, 2)
        (start,) = evaluate(held, EVEN, [seen.point.coordinates], seen.point.starts)
        best = converge(held, start, EVEN, 12).point
        assert -cost > 0.75 * (seen.point.cost - best.cost) > LEAST, windup


def test_what_nothing_measures_is_not_tried_and_steps_of_the_baseline_are_nobody_s_gain() -> None:
    """Without torques a gear's efficiency changes nothing: what it gains is what its trial's steps do."""
    recording = synthetic(ROBOT, TURNS, kappa=0.8, seed=4)
    motors = recording.channels["motor_torques"]
    silent = {name: column for name, column in motors.columns.items() if not name.endswith("effort")}
    channels = {key: channel for key, channel in recording.channels.items() if key != "imu"}
    channels["motor_torques"] = replace(motors, columns=silent)
    bare = replace(recording, channels=channels)
    problem = problem_of([bare], parameter_set(ROBOT), 5.0, 2)
    names = {hypothesis.id for hypothesis in hypotheses(ROBOT, problem.stretches)}
    assert names.isdisjoint({"gyro_bias", "torque_scale", "gear_efficiency", "gear_no_load", "motor_drag"})
    assert {"bulldozing", "wheel_resistance", "joint_friction"} <= names
    inert = Hypothesis(sized("gear_efficiency", ROBOT), (np.array([-1.0]), np.array([0.6])))

    def gained(seen: Around) -> float:
        (trial,) = screen(seen, [inert])
        return 0.5 * (seen.point.cost - trial.point.cost)

    point = fitted_starts(problem, 2)
    rng = np.random.default_rng(2)
    (off,) = evaluate(problem, EVEN, [point.coordinates], point.starts + 0.3 * problem.start_sd * rng.normal(size=8))
    assert gained(around(problem, EVEN, off)) > 12.0
    base, control = converged_baseline(problem, EVEN, off, 2)
    assert gained(base) < 12.0 and gained(base) <= 0.5 * (base.point.cost - control.cost) + 1e-6
