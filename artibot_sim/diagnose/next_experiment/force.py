"""What to measure next where a force acts that is on no list: the manoeuvre that shows best what it follows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.diagnosis import NextExperiment
from artibot_sim.diagnose.next_experiment.freedom import SOIL_SD
from artibot_sim.diagnose.next_experiment.manoeuvres import KAPPA, LIBRARY, Entry
from artibot_sim.diagnose.next_experiment.simulation import WINDOW
from artibot_sim.diagnose.next_experiment.ties import USUAL, advice, cheapest
from artibot_sim.diagnose.unexplained.finding import Finding, acting, regression
from artibot_sim.diagnose.unexplained.forms import WANDERING
from artibot_sim.diagnose.unexplained.response import short
from artibot_sim.diagnose.unexplained.scene import PLACE, Scene
from artibot_sim.diagnose.unexplained.search import Candidate, Equations, InForce, judge
from artibot_sim.diagnose.words import NOTHING, effect_words, joined
from artibot_sim.experiment import Experiment
from artibot_sim.identify.parameters import SOIL
from artibot_sim.identify.problem import Problem
from artibot_sim.identify.requested import parameter_set
from artibot_sim.identify.run import problem_of
from artibot_sim.identify.synthetic import Noise, synthetic
from artibot_sim.model import Robot

Array = NDArray[np.float64]

RIVALS = 3
"""So many other forces at most are to be told from the one that was found."""
WITH_TURNS = tuple(entry for entry in LIBRARY if entry.name not in ("forth_and_back", "forth_and_back_turned", "jerks"))
"""Straight ahead wheels hold, and take up what the regression then counts as seen: such drives promise too much."""
_TOPIC_OF = {"yaw_rate": "imu", "articulation_yaw": "joint_states"}
"""Channels of a diagnosis without which a topic is left out; positions are measured in any case."""


def next_for_force(
    problem: Problem, found: Finding, noise: Mapping[str, float], *, library: Sequence[Entry] = WITH_TURNS
) -> NextExperiment | None:
    """The cheapest manoeuvre that would tell a force from the next best ones.

    None where there are no others, and of what wandered in one recording: nobody knows what it will do in the next.

    Parameters
    ----------
    problem : Problem
        The recordings in which it was found, with the paper's model.
    found : Finding
        The force, and what else might be it.
    noise : mapping of str to float
        Standard deviations of what is measured, by channel (SI); what is not in it is not measured.
    library : sequence of Entry

    Notes
    -----
    The model drives every manoeuvre without the force, on the soil that goes with it. What sensors would say of forces
    there is known from the same regression that found it (`unexplained.regression`); so is what the force would
    do, and how much of that each of the others would explain at its best.
    """
    first, others = found.chosen[0], rivals(found)
    if not others or (first.form.name == WANDERING and not first.form.across):
        return None
    robot = problem.parameters.robot_at(found.soil)
    place = _place(problem, first)

    def nats(entry: Entry, _: float) -> float:
        return expected(robot, recording(robot, entry, place, noise), first, others, problem.workers)

    worth, entry = cheapest(library, robot, nats)
    names = [law(one) for one in (first, *others)]
    return advice(entry, robot, place, f"a {names[0]} from {joined([f'a {name}' for name in names[1:]])}", names, worth)


def law(candidate: Candidate) -> str:
    """What a force is and follows, in a few words."""
    if candidate.form.variable == NOTHING:
        return effect_words(f"constant {candidate.force}")
    return effect_words(f"{candidate.force} that follows {candidate.form.variable}")


def rivals(found: Finding) -> list[Candidate]:
    """The next best forces, each in its best form; what wanders in time is no rival of others, which it may be."""
    first = found.chosen[0]
    laws = {law(first): first}
    for other in found.rivals:
        if first.form.name == WANDERING or other.form.name != WANDERING:
            laws.setdefault(law(other), other)
    return list(laws.values())[1 : 1 + RIVALS]


def recording(robot: Robot, entry: Entry, place: tuple[float, float], noise: Mapping[str, float]) -> Experiment:
    """What the sensors of a robot would record on a manoeuvre, begun at a place in `map` (m)."""
    level = USUAL | {channel: sigma for channel, sigma in noise.items() if sigma > 0.0}
    sensors = Noise(
        torque=level["torque_front"], torque_share=0.0, articulation=level["articulation_yaw"], gyro=level["yaw_rate"],
        station=level["position"], lost=0.0,
    )  # fmt: skip
    found = synthetic(
        robot, entry.manoeuvre, duration=np.inf, kappa=KAPPA, noise=sensors, start=(*place, entry.yaw), name=entry.name
    )
    channels = dict(found.channels)
    for channel, topic in _TOPIC_OF.items():
        if channel not in noise:
            channels.pop(topic, None)
    if not any(channel.startswith("torque") for channel in noise):
        motors = channels["motor_torques"]
        columns = {name: values for name, values in motors.columns.items() if not name.endswith("effort")}
        channels["motor_torques"] = replace(motors, columns=columns)
    return replace(found, channels=channels)


def expected(
    robot: Robot, driven: Experiment, force: Candidate, others: Sequence[Candidate], workers: int | None = None
) -> float:
    """Nats by which a force is expected to explain its own doing on a drive better than any other force does."""
    seen = known(robot, driven, workers)
    if seen is None:
        return 0.0
    equations, of = seen
    pushed = acting(equations, of, force)
    pull = np.einsum("wij,wj->wi", equations.matrix[:, :, : equations.forces], pushed)
    return told(replace(equations, pull=pull), of, force, others)


def known(robot: Robot, driven: Experiment, workers: int | None = None) -> tuple[Equations, Scene] | None:
    """What a drive says of forces, the soil being known from others by `SOIL_SD`; None where too little is measured."""
    trial = short(problem_of([driven], parameter_set(robot, SOIL), WINDOW, workers))
    if not len(trial):
        return None
    equations, of = regression(trial, np.zeros(len(SOIL)))
    return replace(equations, information=np.eye(len(SOIL)) / SOIL_SD**2, slope=np.zeros(len(SOIL))), of


def told(equations: Equations, of: Scene, force: Candidate, others: Sequence[Candidate]) -> float:
    """Nats by which one force explains more than the best of others, each at its best size."""

    def gain(one: Candidate) -> float:
        inside = InForce(equations, of, one.parts)
        return judge(equations, inside.sums(inside.basis(one.form)), one.form, one.force, one.parts).gain

    return gain(force) - max(map(gain, others))


def _place(problem: Problem, force: Candidate) -> tuple[float, float]:
    """Where a manoeuvre begins: amid the recordings if the force is one of the ground there, else at the origin."""
    if force.form.wave is None and force.form.variable != PLACE:
        return 0.0, 0.0
    x, y = np.median(problem.starts[:, :2], axis=0).round(1).tolist()
    return x, y
