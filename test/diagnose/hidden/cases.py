"""Cases: recordings of a rover in which something is hidden, and the truth about them, apart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from diagnose.hidden import driving, logged, rover, sensors
from diagnose.hidden.acting import nats_of
from diagnose.hidden.effects import ADDED, LISTED, Recipe
from diagnose.hidden.ground import OTHER_GROUND, RECIPE, RECORDING
from diagnose.hidden.machine import Machine, machine, random_soil
from diagnose.hidden.sensors import Noise, Table
from diagnose.hidden.unlisted import LAWS, ON_COMMANDS, UNLISTED

from artibot_sim.diagnose.policy import HORIZON
from artibot_sim.diagnose.sizes import factors, scale_of
from artibot_sim.errors import ArtibotError
from artibot_sim.estimation.parameters import SOIL
from artibot_sim.experiment import Channel, Experiment
from artibot_sim.experiment.columns import find_segments, measured_stamps
from artibot_sim.experiment.rollout_bag import write_channels
from artibot_sim.experiment.topics import BY_KEY
from artibot_sim.identify.synthetic import Noise as SensorNoise
from artibot_sim.identify.synthetic import random_manoeuvre, synthetic
from artibot_sim.identify.synthetic import random_soil as synthetic_soil
from artibot_sim.model import Robot, load_robot

START_NS = 1_000_000_000
EVERY = 4
"""Steps between two rows of a drive that are kept: 1 ms."""
LEAST_NATS = 10.0
"""An effect that changes what the sensors say by less never acts: the truth is then that it is not there."""
KNOWN = {**LISTED, **ADDED}
"""Of all that a diagnosis can name."""
RECIPES = {**KNOWN, **UNLISTED, **LAWS, **ON_COMMANDS, OTHER_GROUND: RECIPE}
"""Of all that can be hidden."""
WIDEST = 1.3
"""rad of articulation beyond which a drive is thrown away: a real rover would be damaged."""


@dataclass(frozen=True)
class Drive:
    """One drive before sensors see it.

    Attributes
    ----------
    machine, plain : Machine
        As it was driven, and the same with nothing hidden.
    grid, rows : arrays, shape (n,) and (n, ROW)
        1 ms apart.
    t, command : arrays, shape (m,) and (m, 2)
        What the front motors were told, rad/s.
    """

    machine: Machine
    plain: Machine
    kappa: float
    manoeuvre: str
    grid: np.ndarray
    rows: np.ndarray
    t: np.ndarray
    command: np.ndarray


@dataclass(frozen=True)
class Truth:
    """What a scorer knows and a diagnosis must not.

    Attributes
    ----------
    effects : mapping of id to parameters
        Listed ones that act.
    unlisted : mapping of name to parameters
        Others that act, another soil in one of the recordings among them.
    idle : mapping of id to parameters
        What was put in and never acts in these recordings.
    nats : mapping of id to float
        By how much each changes what the sensors say: half the squared change over noise, in windows of 5 s that
        begin in the true state, soil known. Of a rigid robot of predictions of 2 s from measured poses.
    soil : mapping of str to float
    severity : float
    seed : int
    manoeuvres : tuple of str
    varies : bool
        Whether the soil is another one every few seconds, about that mean.
    """

    effects: Mapping[str, Mapping[str, Any]]
    unlisted: Mapping[str, Mapping[str, Any]]
    idle: Mapping[str, Mapping[str, Any]]
    nats: Mapping[str, float]
    soil: Mapping[str, float]
    severity: float
    seed: int
    manoeuvres: tuple[str, ...]
    varies: bool = False


@dataclass(frozen=True)
class Case:
    """Recordings to diagnose, others to hold out, and the truth."""

    recordings: tuple[Experiment, ...]
    holdout: tuple[Experiment, ...]
    truth: Truth
    robot: str = "agriq"
    horizon: float = HORIZON


def case(
    effects: Sequence[str] = (),
    severity: float = 1.0,
    seed: int = 0,
    *,
    noise: Noise | None = None,
    runs: int = 3,
    held_out: int = 1,
    duration: float = 45.0,
    manoeuvres: Sequence[str] = (),
    soil: Mapping[str, float] | None = None,
    robot: str = "agriq",
    torques: bool = False,
) -> Case:
    """Recordings of a rover with these effects (none, one, two; listed or not) on a random soil.

    Each run is another manoeuvre from another start with another kappa; the same arguments give the same case.

    Parameters
    ----------
    noise : Noise, optional
    runs, held_out : int
        Recordings to diagnose, and of another manoeuvre to hold out.
    duration : float, s
        Of each.
    manoeuvres : names of `driving.MANOEUVRES`, optional
        For the runs and then the held-out ones; drawn where there are too few.
    soil : mapping, optional
        Instead of a random one.
    robot : str
        A rigid one is recorded as :mod:`diagnose.hidden.logged` has it: noise, manoeuvres and soil are drawn there.
        One of more than two modules is driven by the model itself, for the rover here has two.
    torques : bool
        A rigid robot is driven so as well, and seen by Agri.q's sensors, those of torques among them.
    """
    if load_robot(robot).trailing or torques:
        return _by_model(effects, severity, seed, runs, held_out, duration, robot, noise or Noise())
    if not load_robot(robot).articulated:
        return _logged(effects, severity, seed, runs, held_out, duration, robot)
    drives, put_in, soil = driven(effects, severity, seed, runs + held_out, duration, manoeuvres, soil, robot)
    noise = (noise or Noise()).of(load_robot(robot))
    rng = np.random.default_rng([seed, 2])
    names = [f"run{i}" for i in range(len(drives))]
    found = [experiment(d, noise, rng, name, robot) for d, name in zip(drives, names, strict=True)]
    nats = {}
    for name in put_in:
        others = {other: values for other, values in put_in.items() if other != name}
        nats[name] = sum(nats_of(d, _with(d.plain, others, i), noise) for i, d in enumerate(drives[:runs]))
    acts = {name: values for name, values in put_in.items() if nats[name] >= LEAST_NATS}
    truth = Truth(
        effects={name: values for name, values in acts.items() if name in KNOWN},
        unlisted={name: values for name, values in acts.items() if name not in KNOWN},
        idle={name: values for name, values in put_in.items() if name not in acts},
        nats=nats, soil=soil, severity=severity, seed=seed, manoeuvres=tuple(d.manoeuvre for d in drives),
    )  # fmt: skip
    return Case(tuple(found[:runs]), tuple(found[runs:]), truth, robot)


def _logged(
    effects: Sequence[str], severity: float, seed: int, runs: int, held_out: int, duration: float, robot: str
) -> Case:
    """A rigid robot's recordings; beside ground that varies all that is put in counts as acting."""
    names = [f"run{i}" for i in range(runs + held_out)]
    found, put_in, soil = logged.recordings(effects, severity, seed, names, duration, robot)
    varies = logged.VARYING in effects
    nats = {} if varies else {name: logged.nats_of(name, put_in, found[:runs], soil, robot) for name in put_in}
    idle = {name: values for name, values in put_in.items() if nats.get(name, LEAST_NATS) < LEAST_NATS}
    acts = {name: values for name, values in put_in.items() if name not in idle}
    truth = Truth(acts, {}, idle, nats, soil, severity, seed, ("random speeds",) * len(names), varies)
    return Case(tuple(found[:runs]), tuple(found[runs:]), truth, robot, logged.HORIZON)


def _by_model(
    effects: Sequence[str], severity: float, seed: int, runs: int, held_out: int, duration: float, robot: str,
    noise: Noise,
) -> Case:  # fmt: skip
    """Recordings of a robot that the model itself drives, with nothing hidden."""
    if effects:
        raise ArtibotError(
            f"{robot}: nothing can be hidden in a robot of more than two modules, nor beside a rigid one's torques; "
            f"found {effects}"
        )
    rng = np.random.default_rng([seed, 0])
    real = synthetic_soil(load_robot(robot), rng)
    seen = _as_seen(noise, real)
    found = [
        synthetic(
            real, random_manoeuvre(rng, duration), duration=duration, kappa=float(rng.uniform(0.62, 1.0)),
            seed=int(rng.integers(2**31)), start=(*rng.uniform(-1.5, 1.5, 2), rng.uniform(-np.pi, np.pi)),
            name=f"run{i}", noise=seen,
        )
        for i in range(runs + held_out)
    ]  # fmt: skip
    soil = {name: float(getattr(real.contact, name)) for name in SOIL}
    truth = Truth({}, {}, {}, {}, soil, severity, seed, ("random",) * len(found))
    return Case(tuple(found[:runs]), tuple(found[runs:]), truth, robot)


def _as_seen(noise: Noise, robot: Robot) -> SensorNoise:
    """Noise for the model's own recordings: encoders count as many a metre of way, whatever the gear."""
    own = noise.of(robot)
    same = {name: getattr(own, name) for name in vars(own) if name in SensorNoise.__dataclass_fields__}
    counts = max(1, round(own.counts / scale_of(robot).speed))
    return SensorNoise(**{**same, "counts": counts, "station": float(np.hypot(own.station, own.drift))})


def recipe(name: str) -> Recipe:
    """Of an effect that is listed or not, or of another soil."""
    return RECIPES[name]


def driven(
    effects: Sequence[str],
    severity: float,
    seed: int,
    runs: int,
    duration: float,
    manoeuvres: Sequence[str] = (),
    soil: Mapping[str, float] | None = None,
    robot: str = "agriq",
) -> tuple[list[Drive], dict[str, dict[str, Any]], dict[str, float]]:
    """Drives, the effects' parameters and the soil of a case; soil and commands do not depend on the effects."""
    rng, told = np.random.default_rng([seed, 0]), np.random.default_rng([seed, 1])
    numbers = load_robot(robot)
    soil = dict(soil) if soil else random_soil(numbers, told)
    names = [*manoeuvres, *told.permutation([name for name in driving.MANOEUVRES if name not in manoeuvres])][:runs]
    plain = [_drawn(numbers, soil, str(name), told, duration) for name in names]
    track = np.vstack([d.rows[::100, :2] for d in plain])
    put_in = {name: scaled(name, recipe(name).draw(rng, severity, track), numbers) for name in effects}
    drives = [again(d, _with(d.machine, put_in, i)) if put_in else d for i, d in enumerate(plain)]
    return drives, put_in, soil


def scaled(name: str, values: Mapping[str, Any], numbers: Robot) -> dict[str, Any]:
    """An effect's parameters, drawn for Agri.q, as plain for another robot."""
    scale = scale_of(numbers)
    if name in KNOWN:
        by = {
            **factors(name, numbers),
            **dict.fromkeys(("front_max", "stall"), scale.motor),
            "no_load_speed": scale.speed,
            "rate": scale.speed if name in ADDED else 1.0,
            "radius": scale.length,
        }
    else:
        by = {key: getattr(scale, size) for key, size in UNLISTED_BY.items()}
    found = {key: value * by[key] if key in by else value for key, value in values.items()}
    if "wander" in values:  # two waves: N m, rad/s, rad
        found["wander"] = tuple(v * (scale.torque if i % 3 == 0 else 1.0) for i, v in enumerate(values["wander"]))
    return found


UNLISTED_BY: dict[str, Any] = {
    "yaw_drag": "torque", "preload": "torque", "ridge": "mass", "lame": "mass", "tether": "mass", "air": "mass",
    "drag": "motor", "fastest": "speed", "gyre": "torque", "creep": "mass", "hysteresis": "torque", "grease": "motor",
    "skid": "mass", "growing": "mass", "bog": "mass",
}  # fmt: skip
"""Field of what is on no list → the robot's size that it grows with."""


def _drawn(numbers: Any, soil: Mapping[str, float], name: str, rng: np.random.Generator, duration: float) -> Drive:
    """A drive with nothing hidden; drawn again where the articulation bends too far."""
    while True:
        kappa = float(np.round(rng.uniform(0.62, 1.0), 3))
        m = machine(numbers, dict(soil), kappa)
        t, command = driving.commands(m, name, rng, duration)
        start = rover.at_rest(m.rover, *rng.uniform(-1.5, 1.5, 2), rng.uniform(-np.pi, np.pi))
        drive = run(m, m, kappa, name, t, command, start, WIDEST)
        if np.abs(drive.rows[:, rover.YAW_B] - drive.rows[:, rover.YAW_F]).max() < WIDEST:
            return drive


def run(
    m: Machine,
    plain: Machine,
    kappa: float,
    name: str,
    t: np.ndarray,
    command: np.ndarray,
    start: np.ndarray,
    widest: float = np.inf,
) -> Drive:
    """Drive a machine from a row on, until its joint is bent as far as `widest`, rad."""
    fine = rover.STEP * np.arange(round(t[-1] / rover.STEP) + 1)
    rows = rover.drive(start, 0.0, rover.STEP, EVERY, driving.executed(t, command, m.way, fine), m.rover, widest)
    return Drive(m, plain, kappa, name, fine[::EVERY], rows, t, command)


def again(drive: Drive, m: Machine) -> Drive:
    """The same commands from the same start with another machine."""
    start = rover.at_rest(m.rover, *drive.rows[0, : rover.YAW_F + 1])
    return run(m, drive.plain, drive.kappa, drive.manoeuvre, drive.t, drive.command, start)


def _with(plain: Machine, put_in: Mapping[str, Mapping[str, Any]], number: int) -> Machine:
    """The machine of a recording with what is put in; only one of them is on another soil."""
    for name, values in put_in.items():
        if name != OTHER_GROUND or number == RECORDING:
            plain = recipe(name).apply(plain, dict(values))
    return plain


def tables(drive: Drive, noise: Noise, rng: np.random.Generator) -> dict[str, Table]:
    """What is recorded of a drive, by channel key."""
    return sensors.observe(drive.grid, drive.rows, drive.t, drive.command, drive.machine.sensing, noise, rng)


def experiment(drive: Drive, noise: Noise, rng: np.random.Generator, name: str, robot: str = "agriq") -> Experiment:
    """A drive as a recording in memory, as `read_bag` gives it."""
    stamped = {key: (_ns(t), columns) for key, (t, columns) in tables(drive, noise, rng).items()}
    start_ns = min(int(stamps[0]) for stamps, _ in stamped.values())
    channels = {
        key: Channel(BY_KEY[key].name, stamps, (stamps - start_ns) / 1e9, stamps, columns)
        for key, (stamps, columns) in stamped.items()
    }
    topics = {BY_KEY[key].name: BY_KEY[key].ros_type for key in channels}
    segments = find_segments(measured_stamps(channels), start_ns)
    metadata = {"contract": "1", "robot": robot, "kappa": repr(drive.kappa)}
    return Experiment(name, Path(name), metadata, start_ns, channels, segments, topics)


def _ns(t: np.ndarray) -> np.ndarray:
    return START_NS + np.round(t * 1e9).astype(np.int64)


def write(recording: Experiment, folder: Path) -> Path:
    """A recording in memory as a bag, folder and file named after it."""
    found = {key: (channel.t_ns, dict(channel.columns)) for key, channel in recording.channels.items()}
    metadata = {key: value for key, value in recording.metadata.items() if key != "contract"}
    return write_channels(folder / recording.name, found, metadata)
