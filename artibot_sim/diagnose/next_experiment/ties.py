"""What to measure next: the shortest manoeuvre of a library that would tell tied effects apart, found by simulation."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import permutations

import numpy as np

from artibot_sim.diagnose.command_view.data import told
from artibot_sim.diagnose.command_view.fit import Fitter
from artibot_sim.diagnose.command_view.limit import torque_limit
from artibot_sim.diagnose.command_view.model import PARAMETERS, Way, seen, way_of
from artibot_sim.diagnose.command_view.noise import Noise, least_noise
from artibot_sim.diagnose.diagnosis import NextExperiment
from artibot_sim.diagnose.next_experiment.freedom import Explanation
from artibot_sim.diagnose.next_experiment.manoeuvres import KAPPA, LIBRARY, Entry
from artibot_sim.diagnose.next_experiment.simulation import Trial, trial
from artibot_sim.model import Robot
from artibot_sim.planning import plan

ENOUGH = 30.0
"""Nats that the two hardest to tell apart have to differ by: more than a fit leaves that has not quite ended."""
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
    library: Sequence[Entry] = LIBRARY,
) -> NextExperiment | None:
    """The cheapest manoeuvre that would tell effects apart that tie; None where there is nothing to tell apart.

    Parameters
    ----------
    robots : mapping of str to Robot
        By effect: the robot with it, as the recordings so far give it.
    noise : mapping of str to float, optional
        Standard deviations of what is measured, by channel (SI); the usual sensors' by default. What is not in it is
        not measured, except motor speeds, which always are.
    library : sequence of Entry

    Notes
    -----
    Every robot drives every manoeuvre from the same commands; every other one then is to explain what it measured, in
    windows with starts of their own, its soil and its effects' sizes as free as the recordings so far leave them. Of
    all such pairs the one that is hardest to tell apart counts. Where no manoeuvre tells all apart it is the one that
    does best.
    """
    if len(robots) < 2:
        return None
    levels = {c: v for c, v in (dict(noise) if noise else {c: USUAL[c] for c in _MEASURED}).items() if v > 0.0}
    some = next(iter(robots.values()))

    def worth(entry: Entry, least: float) -> float:
        return hardest(robots, entry, levels, _begin(robots, entry), least)

    nats, entry = cheapest(library, some, worth)
    names = list(robots)
    apart = f"{', '.join(names[:-1])} from {names[-1]}" if len(names) == 2 else f"{', '.join(names)} from one another"
    return advice(entry, some, _begin(robots, entry), apart, names, nats)


def cheapest(library: Sequence[Entry], robot: Robot, nats: Callable[[Entry, float], float]) -> tuple[float, Entry]:
    """The shortest manoeuvre that is worth enough, else the one that is worth most, and how much that is.

    Parameters
    ----------
    library : sequence of Entry
    robot : Robot
        That drives it.
    nats : callable
        What a manoeuvre is worth; at less than its second argument it need not be known how much.
    """
    best: tuple[float, Entry] | None = None
    for entry in sorted(library, key=lambda entry: duration(entry, robot)):
        worth = nats(entry, best[0] if best else 0.0)
        if best is None or worth > best[0]:
            best = worth, entry
        if worth >= ENOUGH:
            break
    assert best is not None
    return best


def advice(
    entry: Entry, robot: Robot, place: tuple[float, float], apart: str, names: Sequence[str], nats: float
) -> NextExperiment:
    """What to drive, from where, and what that is expected to tell `apart`, by so many nats."""
    where = f", starting at x = {place[0]:.1f} m, y = {place[1]:.1f} m" if place != (0.0, 0.0) else ""
    sure = "" if nats >= ENOUGH else "; the best of the library, yet hardly enough to be sure"
    said = (
        f"Drive {entry.what} ({duration(entry, robot):.0f} s, kappa {KAPPA:g}){where}: "
        f"expected to tell {apart} by {nats:.0f} nats{sure}."
    )
    return NextExperiment(said, entry.name, tuple(names), float(nats))


def duration(entry: Entry, robot: Robot) -> float:
    """How long a manoeuvre takes, s."""
    return plan(entry.manoeuvre, robot).duration


def hardest(
    robots: Mapping[str, Robot],
    entry: Entry,
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
            told_apart += Explanation(driven, robots[other], noise).nats()
        worst = min(worst, told_apart)
        if worst <= least:
            break
    return float(worst)


def by_commands(driven: Trial, robot: Robot, noise: Mapping[str, float]) -> float:
    """Nats that a robot loses in the command view against the one that drove."""
    data = told([driven.recording])
    if data is None:
        return 0.0
    level = max(noise.get("front_velocity", USUAL["front_velocity"]) / _AVERAGED, least_noise(data))
    sensors = Noise(level, np.zeros(3))
    own = [name for name in robot.effects if name in PARAMETERS]
    fitter = Fitter(data, sensors, way_of(robot.effects), np.ones(len(data), bool))
    best = fitter.best(own)
    lost = sensors.log_likelihood(data, np.zeros(len(data))) - best.value
    if "torque_limit" in robot.effects:
        limit = torque_limit(data, sensors, data.speed - seen(data, best.way))
        lost -= max(limit.nats, 0.0) if limit else 0.0
        torque_noise = noise.get("torque_front", USUAL["torque_front"])
        over = np.abs(data.torque) - float(robot.effects["torque_limit"]["front_max"])
        over = np.maximum(np.nan_to_num(over) / torque_noise, 0.0)
        lost += 0.5 * float(np.minimum(over**2, 25.0).sum())
    return max(lost, 0.0) + _by_back_torques(driven, robot, noise)


def _by_back_torques(driven: Trial, robot: Robot, noise: Mapping[str, float]) -> float:
    """The same of the back motors' torques, which are commanded."""
    data = told([driven.recording], "effort") if "torque_back" in noise else None
    if data is None:
        return 0.0
    sensors = Noise(max(noise["torque_back"] / _AVERAGED, least_noise(data)), np.zeros(3))
    values = robot.effects.get("torque_scale")
    known = Way(scale=float(values["scale"])) if values else Way()
    fitter = Fitter(data, sensors, known, np.ones(len(data), bool))
    best = fitter.best(("encoder_scale",) if values else ())
    return max(sensors.log_likelihood(data, np.zeros(len(data))) - best.value, 0.0)


def _begin(robots: Mapping[str, Robot], entry: Entry) -> tuple[float, float]:
    """Where a manoeuvre begins: before the first place on the ground that an effect is about, else at the origin."""
    for robot in robots.values():
        for values in robot.effects.values():
            if {"x", "y", "radius"} <= set(values):
                x, y = float(values["x"]), float(values["y"])
                return x - _BEFORE * math.cos(entry.yaw), y - _BEFORE * math.sin(entry.yaw)
    return 0.0, 0.0
