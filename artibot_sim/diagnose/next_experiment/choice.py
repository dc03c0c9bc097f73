"""What to measure next: the shortest manoeuvre that tells tied effects apart or shows what a force follows."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import permutations

import numpy as np

from artibot_sim.diagnose.commands.data import CommandData, command_data
from artibot_sim.diagnose.commands.fit import Fitter
from artibot_sim.diagnose.commands.limit import LIMIT, SAG, allowed, limited
from artibot_sim.diagnose.commands.model import PARAMETERS, CommandResponse, predicted_speeds, response_of
from artibot_sim.diagnose.commands.noise import SpeedNoise, least_noise
from artibot_sim.diagnose.next_experiment.simulation import (
    KAPPA,
    LIBRARY,
    SOIL_SD,
    WINDOW,
    LibraryManoeuvre,
    TrialExplanation,
    TriedManoeuvre,
    trial,
)
from artibot_sim.diagnose.records import NextExperiment
from artibot_sim.diagnose.unlisted.finding import ForceFinding, acting, regression
from artibot_sim.diagnose.unlisted.forms import WANDERING
from artibot_sim.diagnose.unlisted.response import short
from artibot_sim.diagnose.unlisted.search import Equations, ForceCandidate, InForce, judge
from artibot_sim.diagnose.unlisted.variables import PLACE, Scene
from artibot_sim.diagnose.words import NOTHING, channel_words, effect_words, joined
from artibot_sim.estimation.parameters import SOIL
from artibot_sim.estimation.problem import Problem
from artibot_sim.experiment import Experiment
from artibot_sim.identify.problems import problem_of
from artibot_sim.identify.requested import parameter_set
from artibot_sim.identify.synthetic import Noise, synthetic
from artibot_sim.model import Robot
from artibot_sim.planning import plan

# ----------------------------------------------------------------------
# What to measure next where something acts of which no manoeuvre is known to show more: the same once more.
# ----------------------------------------------------------------------


def repeated(missing: Sequence[str]) -> NextExperiment:
    """One of the recorded drives again, with what was not measured, or else elsewhere.

    Parameters
    ----------
    missing : sequence of str
        Channels that the recordings lack.
    """
    if missing:
        absent = joined([channel_words(channel) for channel in missing])
        said = f"Drive one of these again and record {absent} as well: a force on no list shows what it is there."
    else:
        said = (
            "Drive one of these again, once on the same ground and once on another: what comes back on both belongs to "
            "the rover, what comes back on the same ground alone to that, and what does not come back to that hour."
        )
    return NextExperiment(said, "", (), float("nan"))


def one_by_one(names: Sequence[str]) -> NextExperiment:
    """Nothing to drive yet: the same recordings, of which each has a soil of its own."""
    said = (
        f"Diagnose {joined(names)} one by one: each is then held against a soil of its own. Manoeuvres that are to be "
        "diagnosed together are best driven on one ground, within hours."
    )
    return NextExperiment(said, "", (), float("nan"))


# ----------------------------------------------------------------------
# What to measure next: the shortest manoeuvre of a library that would tell tied effects apart, found by
# simulation.
# ----------------------------------------------------------------------


ENOUGH = 30.0
"""Nats that the two hardest to distinguish have to differ by: more than a fit leaves that has not quite ended."""
USUAL = {
    "position": 0.005, "yaw": 0.01, "yaw_rate": 0.004, "articulation_yaw": 0.003, "torque_front": 0.025,
    "torque_back": 0.025, "front_velocity": 0.25,
}  # fmt: skip
"""Noise of sensors that nothing is known about (SI)."""
_MEASURED = ("position", "yaw_rate", "articulation_yaw", "torque_front", "torque_back")
_AVERAGED = 2.0
"""By which means over 40 ms are better than single speeds."""
_BEFORE = 1.2
"""m before the middle of a place on the ground at which manoeuvres begin."""


def next_experiment(
    robots: Mapping[str, Robot],
    noise: Mapping[str, float] | None = None,
    *,
    library: Sequence[LibraryManoeuvre] = LIBRARY,
) -> NextExperiment | None:
    """The cheapest manoeuvre that would distinguish effects that tie; None where there is nothing to distinguish.

    Parameters
    ----------
    robots : mapping of str to Robot
        By effect: the robot with it, as the recordings so far give it.
    noise : mapping of str to float, optional
        Standard deviations of what is measured, by channel (SI); the usual sensors' by default. What is not in it is
        not measured, except motor speeds, which always are.
    library : sequence of LibraryManoeuvre

    Notes
    -----
    Every robot drives every manoeuvre from the same commands; every other one then is to explain what it measured, in
    windows with starts of their own, its soil and its effects' sizes as free as the recordings so far leave them. Of
    all such pairs the one that is hardest to distinguish counts. Where no manoeuvre distinguishes all it is the
    one that does best.
    """
    if len(robots) < 2:
        return None
    levels = {c: v for c, v in (dict(noise) if noise else {c: USUAL[c] for c in _MEASURED}).items() if v > 0.0}
    some = next(iter(robots.values()))

    def worth(entry: LibraryManoeuvre, least: float) -> float:
        return hardest(robots, entry, levels, _begin(robots, entry), least)

    nats, entry = cheapest(library, some, worth)
    names = list(robots)
    apart = f"{', '.join(names[:-1])} from {names[-1]}" if len(names) == 2 else f"{', '.join(names)} from one another"
    return advice(entry, some, _begin(robots, entry), apart, names, nats)


def cheapest(
    library: Sequence[LibraryManoeuvre], robot: Robot, nats: Callable[[LibraryManoeuvre, float], float]
) -> tuple[float, LibraryManoeuvre]:
    """The shortest manoeuvre that is worth enough, else the one that is worth most, and how much that is.

    Parameters
    ----------
    library : sequence of LibraryManoeuvre
    robot : Robot
        That drives it.
    nats : callable
        What a manoeuvre is worth; at less than its second argument it need not be known how much.
    """
    best: tuple[float, LibraryManoeuvre] | None = None
    for entry in sorted(library, key=lambda entry: duration(entry, robot)):
        worth = nats(entry, best[0] if best else 0.0)
        if best is None or worth > best[0]:
            best = worth, entry
        if worth >= ENOUGH:
            break
    assert best is not None
    return best


def advice(
    entry: LibraryManoeuvre, robot: Robot, place: tuple[float, float], apart: str, names: Sequence[str], nats: float
) -> NextExperiment:
    """What to drive, from where, and what that is expected to tell `apart`, by so many nats."""
    where = f", starting at x = {place[0]:.1f} m, y = {place[1]:.1f} m" if place != (0.0, 0.0) else ""
    sure = "" if nats >= ENOUGH else "; the best of the library, yet hardly enough to be sure"
    sharing = f", kappa {KAPPA:g}" if robot.articulated else ""  # a rigid robot has no back motors to share with
    said = (
        f"Drive {entry.what} ({duration(entry, robot):.0f} s{sharing}){where}: "
        f"expected to tell {apart} by {nats:.0f} nats{sure}."
    )
    return NextExperiment(said, entry.name, tuple(names), float(nats))


def duration(entry: LibraryManoeuvre, robot: Robot) -> float:
    """How long a manoeuvre takes, s."""
    return plan(entry.manoeuvre, robot).duration


def hardest(
    robots: Mapping[str, Robot],
    entry: LibraryManoeuvre,
    noise: Mapping[str, float],
    place: tuple[float, float] = (0.0, 0.0),
    least: float = 0.0,
) -> float:
    """Nats between the two robots that a manoeuvre tells apart worst; as soon as that is under `least` it is enough."""
    trials = {name: trial(robot, entry, place, tuple(noise)) for name, robot in robots.items()}
    worst = np.inf
    for one, other in permutations(robots, 2):
        driven = trials[one]
        if driven is None:
            return 0.0
        told_apart = by_commands(driven, robots[other], noise)
        if told_apart < min(worst, 1e4):
            told_apart += TrialExplanation(driven, robots[other], noise).nats()
        worst = min(worst, told_apart)
        if worst <= least:
            break
    return float(worst)


def by_commands(driven: TriedManoeuvre, robot: Robot, noise: Mapping[str, float]) -> float:
    """Nats that a robot loses in the command view against the one that drove."""
    data = command_data([driven.recording])
    if data is None:
        return 0.0
    lost = _by_front_speeds(data, robot, noise)
    if {LIMIT, SAG} & set(driven.robot.effects):  # whose speeds at the limit nobody predicts, not even with it
        lost -= _by_front_speeds(data, driven.robot, noise)
    return max(lost, 0.0) + _by_back_torques(driven, robot, noise)


def _by_front_speeds(data: CommandData, robot: Robot, noise: Mapping[str, float]) -> float:
    """Nats that a robot loses against speeds that are predicted exactly."""
    level = max(noise.get("front_velocity", USUAL["front_velocity"]) / _AVERAGED, least_noise(data))
    sensors = SpeedNoise(level, np.zeros(3))
    own = [name for name in robot.effects if name in PARAMETERS]
    fitter = Fitter(data, sensors, response_of(robot.effects), np.ones(len(data), bool))
    best = fitter.best(own)
    lost = sensors.log_likelihood(data, np.zeros(len(data))) - best.value
    limit = limited(robot.effects, data, sensors, data.speed - predicted_speeds(data, best.response))
    lost -= limit.nats if limit else 0.0
    over = np.nan_to_num(np.abs(data.torque) - allowed(robot.effects, data), nan=0.0, neginf=0.0)
    over = np.maximum(over / noise.get("torque_front", USUAL["torque_front"]), 0.0)
    return lost + 0.5 * float(np.minimum(over**2, 25.0).sum())


def _by_back_torques(driven: TriedManoeuvre, robot: Robot, noise: Mapping[str, float]) -> float:
    """Nats by which commanded torques of the back motors tell a robot from the one that was driven."""
    data = command_data([driven.recording], "effort") if "torque_back" in noise else None
    if data is None:
        return 0.0
    sensors = SpeedNoise(max(noise["torque_back"] / _AVERAGED, least_noise(data)), np.zeros(3))
    values = robot.effects.get("torque_scale")
    known = CommandResponse(scale=float(values["scale"])) if values else CommandResponse()
    fitter = Fitter(data, sensors, known, np.ones(len(data), bool))
    best = fitter.best(("encoder_scale",) if values else ())
    return max(sensors.log_likelihood(data, np.zeros(len(data))) - best.value, 0.0)


def _begin(robots: Mapping[str, Robot], entry: LibraryManoeuvre) -> tuple[float, float]:
    """Where a manoeuvre begins: before the first place on the ground that an effect is about, else at the origin."""
    for robot in robots.values():
        for values in robot.effects.values():
            if {"x", "y", "radius"} <= set(values):
                x, y = float(values["x"]), float(values["y"])
                return x - _BEFORE * math.cos(entry.yaw), y - _BEFORE * math.sin(entry.yaw)
    return 0.0, 0.0


# ----------------------------------------------------------------------
# What to measure next where a force acts that is on no list: the manoeuvre that shows best what it follows.
# ----------------------------------------------------------------------


RIVALS = 3
"""So many other forces at most are to be told from the one that was found."""
WITH_TURNS = tuple(entry for entry in LIBRARY if entry.name not in ("forth_and_back", "forth_and_back_turned", "jerks"))
"""Straight ahead wheels hold, and take up what the regression then counts as seen: such drives promise too much."""
_TOPIC_OF = {"yaw_rate": "imu", "articulation_yaw": "joint_states"}
"""Channels of a diagnosis without which a topic is left out; positions are measured in any case."""


def next_for_force(
    problem: Problem,
    found: ForceFinding,
    noise: Mapping[str, float],
    *,
    library: Sequence[LibraryManoeuvre] = WITH_TURNS,
) -> NextExperiment | None:
    """The cheapest manoeuvre that would tell a force from the next best ones.

    None where there are no others, and of what wandered in one recording: nobody knows what it will do in the next.

    Parameters
    ----------
    problem : Problem
        The recordings in which it was found, with the paper's model.
    found : ForceFinding
        The force, and what else might be it.
    noise : mapping of str to float
        Standard deviations of what is measured, by channel (SI); what is not in it is not measured.
    library : sequence of LibraryManoeuvre

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

    def nats(entry: LibraryManoeuvre, _: float) -> float:
        return expected(robot, recording(robot, entry, place, noise), first, others, problem.workers)

    worth, entry = cheapest(library, robot, nats)
    names = [law(one) for one in (first, *others)]
    return advice(entry, robot, place, f"a {names[0]} from {joined([f'a {name}' for name in names[1:]])}", names, worth)


def law(candidate: ForceCandidate) -> str:
    """What a force is and follows, in a few words."""
    if candidate.form.variable == NOTHING:
        return effect_words(f"constant {candidate.force}")
    return effect_words(f"{candidate.force} that follows {candidate.form.variable}")


def rivals(found: ForceFinding) -> list[ForceCandidate]:
    """The next best forces, each in its best form; what wanders in time is no rival of others, which it may be."""
    first = found.chosen[0]
    laws = {law(first): first}
    for other in found.rivals:
        if first.form.name == WANDERING or other.form.name != WANDERING:
            laws.setdefault(law(other), other)
    return list(laws.values())[1 : 1 + RIVALS]


def recording(
    robot: Robot, entry: LibraryManoeuvre, place: tuple[float, float], noise: Mapping[str, float]
) -> Experiment:
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
    robot: Robot,
    driven: Experiment,
    force: ForceCandidate,
    others: Sequence[ForceCandidate],
    workers: int | None = None,
) -> float:
    """Nats by which a force is expected to explain its own doing on a drive better than any other force does."""
    found = known_equations(robot, driven, workers)
    if found is None:
        return 0.0
    equations, of = found
    pushed = acting(equations, of, force)
    rhs = np.einsum("wij,wj->wi", equations.matrix[:, :, : equations.forces], pushed)
    return separation(replace(equations, rhs=rhs), of, force, others)


def known_equations(robot: Robot, driven: Experiment, workers: int | None = None) -> tuple[Equations, Scene] | None:
    """What a drive says of forces, the soil being known from others by `SOIL_SD`; None where too little is measured."""
    trial = short(problem_of([driven], parameter_set(robot, SOIL), WINDOW, workers))
    if not len(trial):
        return None
    equations, of = regression(trial, np.zeros(len(SOIL)))
    return replace(equations, information=np.eye(len(SOIL)) / SOIL_SD**2, slope=np.zeros(len(SOIL))), of


def separation(equations: Equations, of: Scene, force: ForceCandidate, others: Sequence[ForceCandidate]) -> float:
    """Nats by which one force explains more than the best of others, each at its best size."""

    def gain(one: ForceCandidate) -> float:
        inside = InForce(equations, of, one.parts)
        return judge(equations, inside.sums(inside.basis(one.form)), one.form, one.force, one.parts).gain

    return gain(force) - max(map(gain, others))


def _place(problem: Problem, force: ForceCandidate) -> tuple[float, float]:
    """Where a manoeuvre begins: amid the recordings if the force is one of the ground there, else at the origin."""
    if force.form.wave is None and force.form.variable != PLACE:
        return 0.0, 0.0
    x, y = np.median(problem.starts[:, :2], axis=0).round(1).tolist()
    return x, y
