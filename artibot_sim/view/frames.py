"""What a view shows at each instant, free of any viewer: rovers with their wheels' forces, and paths."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment import Experiment
from artibot_sim.experiment.measured import Measured
from artibot_sim.experiment.resimulate import Pieces, resimulate
from artibot_sim.model import MOTORS, Commands, Mode, Robot, Rollout, initial_state, rollout
from artibot_sim.model.kernels.layout import ALPHA, BACK, BETA, F_L, F_T, GAMMA, MOTOR_COORDINATES, SAT, Z
from artibot_sim.model.simulate.rollout import default_modes, side_gears
from artibot_sim.progress import Report
from artibot_sim.report.paths import find_track

if TYPE_CHECKING:
    from artibot_sim.diagnose.result import Diagnosis

Floats = NDArray[np.float64]

MEASURED, PAPER, EXTENDED = "measured", "paper's model", "extended model"
RATE = 25.0
"""Instants a second."""
MOST = 6000
"""Instants at most; longer recordings have fewer a second."""
HORIZON = 5.0
"""s after which a simulation is started anew from what was measured."""
_INSTANT = 1e-3
"""s that are simulated to have the forces at their beginning."""


@dataclass(frozen=True, eq=False)
class Poses:
    """A rover at n instants; NaN where it is not known.

    Attributes
    ----------
    modules : (n, modules, 3) array
        x, y (m) and yaw (rad) of each module's origin in `map`.
    wheels : (n, wheels) array
        Angles, rad.
    forces : (n, wheels, 2) array
        Longitudinal and lateral force of the ground on each wheel, N, in its module's frame.
    sliding : (n, wheels) array of bool
    """

    modules: Floats
    wheels: Floats
    forces: Floats
    sliding: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Film:
    """All that a view shows.

    Attributes
    ----------
    title : str
    robot : Robot
    t : (n,) array
        s since the recording's start.
    rovers : mapping of str to Poses
        By who says so; `MEASURED` first.
    paths : mapping of str to (m, 2) array
        ``planned``, ``odometric``, ``true``: x, y in m; rows of NaN join nothing.
    pushes : mapping of str to (x, y)
        Forces in `map` that a diagnosis found, N.
    notes : sequence of str
        What is said beside the picture.
    """

    title: str
    robot: Robot
    t: Floats
    rovers: Mapping[str, Poses]
    paths: Mapping[str, Floats]
    pushes: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    notes: Sequence[str] = ()


def measured_film(experiment: Experiment, robot: Robot) -> Film:
    """What a recording shows before anything is simulated: the measured rover, without forces, and the paths.

    Raises
    ------
    ArtibotError
        Where the recording has no pose.
    """
    first, last = experiment.segments[0][0], experiment.segments[-1][1]
    t = np.linspace(first, last, int(np.clip((last - first) * RATE, 2, MOST)))
    return Film(experiment.name, robot, t, {MEASURED: _measured(experiment, robot, t)}, _paths(experiment))


def film_of(
    experiment: Experiment, robot: Robot, diagnosis: Diagnosis | None = None, progress: Report | None = None
) -> Film:
    """What a recording shows.

    The measured rover stands where the reference (or, without one, its odometry) says, and has the forces that the
    model computes from the measured rotations. With a diagnosis both of its models drive beside it.

    Raises
    ------
    ArtibotError
        Where the recording has no pose.
    """
    advance, bare = progress or (lambda _: None), measured_film(experiment, robot)
    models = {PAPER: robot} if diagnosis is None else {PAPER: diagnosis.baseline_robot, EXTENDED: diagnosis.extended}
    if diagnosis is not None and not diagnosis.causes:
        models.pop(EXTENDED)
    notes, simulated = [], {}
    for number, (name, model) in enumerate(models.items()):

        def part(share: float, begun: int = number) -> None:
            advance((begun + share) / len(models))

        try:
            run = resimulate(experiment, model, horizon=HORIZON, forces=True, progress=part)
            simulated[name] = _simulated(run.pieces, model, bare.t)
        except ArtibotError as error:
            notes.append(f"without forces: {error}")
    shown = _with_forces(bare.rovers[MEASURED], simulated.get(PAPER))
    rovers = {MEASURED: shown} | (simulated if diagnosis is not None else {})
    if diagnosis is not None:
        notes.append(f"{', '.join(simulated)}: started anew from what was measured every {HORIZON:g} s")
    pushes = {} if diagnosis is None else _pushes(diagnosis)
    return replace(bare, rovers=rovers, pushes=pushes, notes=notes)


def _with_forces(measured: Poses, model: Poses | None) -> Poses:
    """The rover as measured, with what the model says of its wheels."""
    if model is None:
        return measured
    wheels = np.where(np.isfinite(measured.wheels), measured.wheels, model.wheels)
    return replace(measured, wheels=wheels, forces=model.forces, sliding=model.sliding)


def _measured(experiment: Experiment, robot: Robot, t: Floats) -> Poses:
    """The rover as measured, without forces."""
    pose = np.full((len(t), 3), np.nan)
    bends = np.full((len(t), len(robot.hitches)), np.nan)
    for begin, end in experiment.segments:
        rows = (t >= begin) & (t <= end)
        if not rows.any():
            continue
        motion = Measured(experiment, begin, end).along(t[rows])
        pose[rows], bends[rows, :1] = motion[:, :3], motion[:, 6:7] if robot.articulated else 0.0
    odometry = find_track(experiment, "odometric")
    if not np.isfinite(pose[:, :2]).any() and odometry is not None and odometry.yaw is not None:
        pose = np.column_stack([np.interp(t, odometry.t, one) for one in (odometry.x, odometry.y, odometry.yaw)])
    if not np.isfinite(pose).any():
        raise ArtibotError(f"{experiment.path}: no pose is recorded, so there is nothing to place a rover by")
    wheels, count = _turned(experiment, robot, t), 4 * len(robot.modules)
    bends = np.where(np.isfinite(bends), bends, 0.0)
    return Poses(chain(robot, pose, bends), wheels, np.zeros((len(t), count, 2)), np.zeros((len(t), count), bool))


def chain(robot: Robot, pose: Floats, bends: Floats) -> Floats:
    """Poses (n, modules, 3) of all modules by that of the front one (n, 3) and the joints' yaws (n, joints)."""
    found, yaw, place = [pose], pose[:, 2], pose[:, :2]
    for i, (hitch, module) in enumerate(zip(robot.hitches, robot.modules[1:], strict=True)):
        place = place - hitch.l * np.column_stack([np.cos(yaw), np.sin(yaw)])
        yaw = yaw + bends[:, i]
        place = place - module.l * np.column_stack([np.cos(yaw), np.sin(yaw)])
        found.append(np.column_stack([place, yaw]))
    return np.stack(found, axis=1)


def _turned(experiment: Experiment, robot: Robot, t: Floats) -> Floats:
    """Angles of the wheels (n, wheels) by the motors' encoders, rad; NaN of motors that have none."""
    found = np.full((len(t), len(robot.motors)), np.nan)
    motors = experiment.channels.get("motor_torques")
    for i, motor in enumerate(robot.motors):
        name = f"{motor}.position"
        times, angles = motors.series(name) if motors is not None and name in motors else (np.empty(0), np.empty(0))
        if len(times) > 1:
            found[:, i] = np.interp(t, times, angles)
    return wheels_of(robot, found)


def wheels_of(robot: Robot, motors: Floats) -> Floats:
    """Angles of the wheels (…, wheels) by those of `Robot.motors` (…, motors), rad; NaN of sides without a motor."""
    sides = np.full((*motors.shape[:-1], 2 * len(robot.modules)), np.nan)
    gears = side_gears(robot)
    count = min(motors.shape[-1], sides.shape[-1]) if not robot.trailing else min(motors.shape[-1], 4)
    sides[..., :count] = gears[:count] * motors[..., :count]
    return np.repeat(sides, 2, axis=-1)


def _simulated(pieces: Sequence[Pieces], robot: Robot, t: Floats) -> Poses:
    """A simulation at times (n,), with the forces on its wheels."""
    count = 4 * len(robot.modules)
    modules, wheels = np.full((len(t), len(robot.modules), 3), np.nan), np.full((len(t), count), np.nan)
    forces, sliding = np.zeros((len(t), count, 2)), np.zeros((len(t), count), bool)
    for piece in pieces:
        rows = np.flatnonzero(piece.covers(t))
        if not len(rows):
            continue
        run = piece.at(t[rows])
        for i in range(len(robot.modules)):
            modules[rows, i] = run.q[:, [8 * i, 8 * i + 1, 8 * i + GAMMA]]
        wheels[rows] = run.wheel_position[:, :count]
        if not robot.trailing:
            forces[rows], sliding[rows] = _forces_in(run, count)
    return Poses(modules, wheels, forces, sliding)


def wheel_forces(robot: Robot, q: Floats, v: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Forces (wheels, 2) of the ground on the wheels, N, and which of them slide, at a state (16,), (16,)."""
    count = 4 if robot.articulated else 2
    speeds = np.full((2, 4), np.nan)
    speeds[:, :count] = v[list(MOTOR_COORDINATES)[:count]]
    modes = (*(Mode.PRESCRIBED,) * count, *default_modes(robot)[count:])
    run = rollout(
        robot,
        Commands(_INSTANT, speeds),
        dt=_INSTANT,
        every=1,
        modes=modes,
        state=replace(initial_state(robot), q=q, v=v),
    )
    forces, sliding = _forces_in(run, 4 * len(robot.modules))
    return forces[0], sliding[0]


def _forces_in(run: Rollout, wheels: int) -> tuple[Floats, NDArray[np.bool_]]:
    """Forces (n, wheels, 2) of the ground, N, and which wheels slide, of a rollout of two modules at most."""
    along, across = run.row[:, F_L : F_L + wheels], run.row[:, F_T : F_T + wheels]
    return np.stack([along, across], axis=-1), run.row[:, SAT : SAT + wheels] > 0.5


def state_of(
    robot: Robot, pose: Sequence[float], twist: Sequence[float], bend: tuple[float, float], motors: Sequence[float]
) -> tuple[Floats, Floats]:
    """A state (16,), (16,) of a rover of one or two modules that stands on its wheels, as it is measured.

    Parameters
    ----------
    robot : Robot
    pose : x, y (m), yaw (rad) of the front module in `map`
    twist : forward and leftward speed (m/s) and yaw rate (rad/s) of the front module
    bend : articulation yaw (rad) and its rate (rad/s)
    motors : speeds in the order of MOTORS, rad/s
    """
    x, y, yaw = pose
    angle, rate = bend if robot.articulated else (0.0, 0.0)
    q = initial_state(robot, x, y, yaw, angle).q.copy()
    v = np.zeros(len(q))
    forward, left, turn = twist
    v[:2] = forward * math.cos(yaw) - left * math.sin(yaw), forward * math.sin(yaw) + left * math.cos(yaw)
    v[GAMMA] = turn
    if robot.back is not None:
        behind, front, back = yaw + angle, robot.front.l, robot.back.l
        joint = v[:2] - front * turn * np.array([-math.sin(yaw), math.cos(yaw)])
        v[BACK : BACK + 2] = joint - back * (turn + rate) * np.array([-math.sin(behind), math.cos(behind)])
        v[BACK + GAMMA] = turn + rate
    q[[ALPHA, BETA]] = 0.0
    v[Z] = 0.0
    count = len(MOTORS) if robot.articulated else 2
    v[list(MOTOR_COORDINATES)[:count]] = np.asarray(motors, float)[:count]
    return q, v


def _paths(experiment: Experiment) -> dict[str, Floats]:
    found = {}
    for kind in ("planned", "odometric", "true", "total station"):
        track = find_track(experiment, kind, drawn=True)
        if track is not None and not (kind == "total station" and "true" in found):
            breaks = np.flatnonzero(np.diff(track.piece)) + 1
            found[kind] = np.insert(np.column_stack([track.x, track.y]), breaks, np.nan, axis=0)
    return found


def _pushes(diagnosis: Diagnosis) -> dict[str, tuple[float, float]]:
    """Forces that a named effect puts on the rover, the same everywhere on the map, N."""
    from artibot_sim.diagnose.words import effect_words  # with it comes all that a diagnosis is made of

    found = {}
    weight = 9.81 * sum(m.m for m in diagnosis.robot.modules)
    for cause in diagnosis.causes:
        values = {name: one.value for name, one in cause.parameters.items() if not isinstance(one.value, str)}
        if cause.effect == "slope" and {"grade", "heading"} <= set(values):
            size, heading = weight * math.sin(values["grade"]), values["heading"]
        elif cause.effect == "external_force" and {"force", "heading"} <= set(values):
            size, heading = values["force"], values["heading"]
        else:
            continue
        found[effect_words(cause.effect)] = (size * math.cos(heading), size * math.sin(heading))
    return found
