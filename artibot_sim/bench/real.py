"""Recordings of real robots: each model fitted to one part, and judged by its predictions of another.

``make real DATA=folder`` prints errors of windows of 2 s at their ends, beside those of kinematic models and of a
regressor. The recordings are not part of artibot.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import click
import numpy as np
from numpy.typing import NDArray

from artibot_sim.errors import ArtibotError
from artibot_sim.estimation.boosting import boosted
from artibot_sim.estimation.kinematic import (
    AFTER,
    BEFORE,
    FREE,
    STEP,
    TIMED,
    UNTIMED,
    DrivenWindows,
    Kinematic,
    fit_kinematic,
    ideal,
)
from artibot_sim.estimation.streams import new_values
from artibot_sim.experiment import Experiment, read_bag
from artibot_sim.experiment.blocks import BLOCK, in_turn
from artibot_sim.model import MOTORS, Robot, load_robot
from artibot_sim.model.simulate.sensors import measured_starts, sensor_errors

if TYPE_CHECKING:
    from artibot_sim.identify.run import Work

Array = NDArray[np.float64]

DATA = "ARTIBOT_REAL_DATA"
"""Environment variable with the folder of the recordings."""
HORIZON = 2.0
"""s of a window."""
_DRIVEN = 0.05
"""m/s of a wheel's rim, in the mean over a window, below which the robot is not driven."""
_LEAP = 0.2
"""m by which a measured pose may move farther than the wheels' rims before it counts as a leap."""
_JITTER = 0.2
"""s by which stamps may be wrong where leaps are looked for."""
_DRAWS = 1000
_SETTLES = 1.0
"""s for which wheels turn evenly before a window: then soft ground has its slip, and a turn its sideslip."""


@dataclass(frozen=True)
class RobotOnGround:
    """One robot on one ground.

    Attributes
    ----------
    name : str
    robot : str
        Robot file.
    recordings : tuple of str
        Folders. Each is predicted by what was fitted to the others; a single one by its other half, in blocks.
    """

    name: str
    robot: str
    recordings: tuple[str, ...]


GROUNDS = (
    RobotOnGround("husky, tiles, soft tyres", "husky_driven", ("husky_deflated",)),
    RobotOnGround("husky, wet grass", "husky_driven", ("husky_wetgrass",)),
    RobotOnGround("husky, not stated", "husky_driven", ("husky_drive_a", "husky_drive_b")),
    RobotOnGround("warthog, asphalt", "warthog", ("warthog_asphalt",)),
    RobotOnGround("warthog, gravel", "warthog", ("warthog_gravel",)),
    RobotOnGround("optiodom", "optiodom_diff", ("optiodom_diff_1", "optiodom_diff_2", "optiodom_diff_3")),
)


# ----------------------------------------------------------------------
# Windows: where the robot was at a start and an end, and how its wheels turned.
# ----------------------------------------------------------------------


@dataclass(frozen=True)
class RecordingPart:
    """What is fitted or judged together: a recording, or some blocks of it."""

    experiments: tuple[Experiment, ...]
    windows: DrivenWindows
    leaps: int = 0


def windows_of(experiment: Experiment, radius: float) -> tuple[DrivenWindows, int]:
    """Windows of `HORIZON` s one after the other wherever the robot is driven, and how many leap.

    A window that leaps holds a measured pose that moves farther than wheels of this `radius` (m) could make it; no
    model can be judged by it.
    """
    odometry, motors = experiment.require("ground_truth_odom", "x", "y", "yaw"), experiment.require("motor_torques")
    rows: list[tuple[float, float, Array, Array, Array]] = []
    leaps = 0
    for first, last in experiment.segments:
        t_pose, pose = new_values(odometry, ("x", "y", "yaw"), first, last)
        t_speed, speed = new_values(motors, _SPEEDS, first, last)
        if len(t_pose) < 4 or len(t_speed) < 2:
            continue
        pose = np.column_stack([pose[:, :2], np.unwrap(pose[:, 2])])
        for t in np.arange(max(first, t_pose[0]), last - HORIZON + STEP + 1e-6, HORIZON):
            length = min(HORIZON, last - t)
            at = t + STEP * np.arange(-round(BEFORE / STEP), round((HORIZON + AFTER) / STEP) + 1)
            turned = np.column_stack([np.interp(at, t_speed, column) for column in speed.T])
            inside = (at >= t) & (at <= t + length)
            if radius * np.abs(turned[inside]).mean() < _DRIVEN:
                continue
            near = (t_pose >= t - STEP) & (t_pose <= t + length + STEP)
            if near.sum() < 4:
                continue
            if _leaps(t_pose[near], pose[near], radius * float(np.abs(turned).max())):
                leaps += 1
                continue
            ends = np.array([[np.interp(when, t_pose, column) for column in pose.T] for when in (t, t + length)])
            rows.append((float(t), float(length), ends[0], ends[1], turned))
    if not rows:
        raise ArtibotError(f"{experiment.path}: no window of {HORIZON:g} s in which the robot is driven")
    return DrivenWindows(*(np.array(column) for column in zip(*rows, strict=True))), leaps


_SPEEDS = tuple(f"{motor}.velocity" for motor in MOTORS[:2])


def _leaps(t: Array, pose: Array, rim: float) -> bool:
    """Whether a measured pose moves farther than wheels with such speeds (m/s) at their rims could move it."""
    steps = np.hypot(*np.diff(pose[:, :2], axis=0).T)
    return bool((steps > rim * (np.diff(t) + _JITTER) + _LEAP).any())


def parts_of(ground: RobotOnGround, folder: Path, robot: Robot) -> list[RecordingPart]:
    """What is fitted or judged together: recordings, or the two halves of a single one."""
    recordings = [read_bag(folder / name) for name in ground.recordings]
    if len(recordings) == 1:
        recordings = list(in_turn(recordings[0]))
    found = []
    for experiment in recordings:
        windows, leaps = windows_of(experiment, robot.wheel.r_w)
        found.append(RecordingPart((experiment,), windows, leaps))
    return found


# ----------------------------------------------------------------------
# Models: each is fitted to a part and predicts ends of windows, seen from their starts.
# ----------------------------------------------------------------------


Predictor = Callable[[DrivenWindows], Array]
"""Windows → where they end as seen from their starts, shape (n, 3)."""


def fit_regressor(windows: DrivenWindows, robot: Robot) -> Predictor:
    """Gradient-boosted trees on the wheels' speeds: what the three-parameter model leaves."""
    base = fit_kinematic(windows, robot, FREE[TIMED])

    def features(of: DrivenWindows) -> Array:
        bins = np.array_split(np.arange(of.speed.shape[1]), 12)
        means = [of.speed[:, rows].mean(axis=1) for rows in bins]
        return np.column_stack([*means, base(of), of.length])

    trees = boosted(features(windows), windows.moved - base(windows))
    return lambda of: base(of) + trees(features(of))


_RESISTED = (("effects.wheel_resistance.share", "0.2±0.2"), ("effects.pose_lever_arm.x", "0±0.15"))
_LATE = ("effects.pose_delay.delay", "")
_WOUND = ("effects.wheel_windup.way", "0.02±0.02")
_SIDES = (
    ("wheel.r_w", ""),
    ("effects.wheel_radius_mismatch.relative", "0±0.02"),
    ("effects.pose_lever_arm.y", "0±0.15"),
    ("effects.pose_heading_offset.angle", "0±0.05"),
)
"""What loaded tyres, and a tracked body beside the middle or at an angle, make of a robot's geometry."""
ARTIBOT: dict[str, tuple[tuple[str, str], ...]] = {
    "artibot, soil only": (),
    "artibot, wheels resisted": _RESISTED,
    "artibot, wheels resisted, timing": (*_RESISTED, _LATE),
    "artibot, wheels resisted, sides": (*_RESISTED, *_SIDES),
    "artibot, wheels resisted, sides, timing": (*_RESISTED, *_SIDES, _LATE),
    "artibot, wheels resisted, sides, timing, windup": (*_RESISTED, *_SIDES, _LATE, _WOUND),
}
"""Artibot's own model → what is fitted beside the soil, with its prior.

Where there is none it is that of the robot file, and of a delay what ICR with timing has fitted to the same part."""
_DELAY = 0.1
"""s to which that is known."""


def fit_artibot(part: RecordingPart, robot: Robot, beside: Sequence[tuple[str, str]], rolling: Kinematic) -> Work:
    """The soil, and what else is asked for, identified from a part to which `rolling` was fitted."""
    from artibot_sim.estimation.parameters import SOIL
    from artibot_sim.identify import identify, parse_priors

    late = {_LATE[0]: f"{max(rolling.delay, STEP):.3g}±{_DELAY}"}
    given = [f"{name}={prior or late.get(name)}" for name, prior in beside if prior or name in late]
    fit = [*SOIL, *(name for name, _ in beside)]
    return identify(list(part.experiments), robot, fit=fit, priors=parse_priors(given), window=HORIZON)


def predict_artibot(robot: Robot, late: float, part: RecordingPart, rolling: Kinematic) -> Array:
    """Ends of a part's windows by the model of a robot whose poses are `late` (s), seen from their starts.

    Every window starts at the pose that is measured there, with the velocity that the model has once its wheels have
    turned as they do then for a while: nothing that is measured after the start is used. A pose that is stamped late is
    one from before: the model starts as much earlier, with the wheels as they turned then; where rotations are stamped
    late it starts later. Where a recording begins after that or ends before it does, the robot is taken to have moved
    evenly over the delay, and late rotations to be on time.
    """
    ends = _simulated_ends(robot, part, rolling, late)
    outside = np.isnan(ends[:, 0])
    if late and outside.any():
        delayed = replace(robot, effects={**robot.effects, "pose_delay": {"delay": max(late, 0.0)}})
        ends[outside] = _simulated_ends(delayed, part, rolling, 0.0)[outside]
    return ends


def _simulated_ends(robot: Robot, part: RecordingPart, rolling: Kinematic, earlier: float) -> Array:
    """Ends of windows (n, 3) by a model that starts so much earlier, s; NaN where no wheels are recorded then."""
    from artibot_sim.estimation.measurements import stretches
    from artibot_sim.estimation.parameters import ParameterSet
    from artibot_sim.estimation.problem import Problem
    from artibot_sim.estimation.windows import window_at
    from artibot_sim.model.simulate.window_inputs import KINDS, SamplingPlan

    found, windows = stretches(part.experiments[0], robot), part.windows
    rows, chosen, ends = [], [], []
    for i, (t, length) in enumerate(zip((windows.t - earlier).tolist(), windows.length.tolist(), strict=True)):
        least = length - 0.11 if earlier < 0.0 else 0.5
        where = next((n for n, s in enumerate(found) if s.inputs.t[0] - 0.11 <= t < s.inputs.t[-1] - least), None)
        if where is None:
            continue
        inputs = found[where].inputs
        first = max(0, round((t - inputs.t[0]) / inputs.dt))
        knots = min(round(length / inputs.dt), len(inputs.t) - 1 - first)
        chosen.append(window_at(found[where], where, robot, first, knots))
        ends.append(knots * inputs.dt)
        rows.append(i)
    every = np.full((len(windows), 3), np.nan)
    if not rows:
        return every
    problem = Problem(ParameterSet(robot, ()), found, chosen)
    now = round((BEFORE - (earlier or rolling.delay)) / STEP)
    starts = problem.starts.copy()
    starts[:, :3] = windows.start[rows]
    late = np.array([window.start.late for window in chosen])
    starts[:, 3:6] = _steady_rates(robot, rolling, windows.speed[rows, now], late)
    kinds = np.array([KINDS.index(name) for name in ("x", "y", "yaw")])
    seen = problem.sampled(np.empty(0), starts, [SamplingPlan(np.full(3, end), kinds) for end in ends])
    moved = replace(windows[np.array(rows)], end=np.array(seen)).moved
    every[rows] = moved
    return every


def _steady_rates(robot: Robot, rolling: Kinematic, speed: Array, late: NDArray[np.bool_]) -> Array:
    """Forward and leftward speed and yaw rate (n, 3), as sensors have them, where wheels have turned so for a while.

    It begins as `rolling` says of such wheel speeds (n, 2) and settles for `_SETTLES` s. `late` (n,) are headings that
    are stamped as late as positions.
    """
    from artibot_sim.model import Commands, initial_state, rollout

    begun, rest, found = rolling.rates(speed), initial_state(robot), np.zeros((len(speed), 6))
    for i, wheels in enumerate(speed):
        v = rest.v.copy()
        v[[0, 1, 5]] = begun[i]
        turned = np.tile([*wheels, np.nan, np.nan], (2, 1))
        run = rollout(robot, Commands(_SETTLES, turned), integrator="semi_implicit", state=replace(rest, v=v))
        found[i, 3:] = run.twist[-1]
    return measured_starts(np.array([sensor_errors(robot)]), found, late)[:, 3:]


# ----------------------------------------------------------------------
# Scores: errors of all judged windows, with intervals from blocks drawn anew.
# ----------------------------------------------------------------------


@dataclass(frozen=True)
class Score:
    """Errors of one model on one ground; each figure with the ends of its 95 % interval.

    Attributes
    ----------
    ground, model : str
    windows, leaps : int
        Judged, and left out because measured poses leap in them.
    position, yaw : mapping of str to (float, float, float)
        `rmse`, `median`, `p90` in m and rad.
    against : mapping of str to (float, float, float)
        The same over those of the three-parameter ICR on the same windows; empty for itself.
    seconds : float
        For fitting and predicting.
    turns : mapping of str to (float, int)
        RMSE of the heading (rad) in windows at whose end the robot turns the other way than at their start
        (`reversed`) and in the others (`kept`), and how many there are.
    values : tuple of str
        What was fitted, a part each.
    """

    ground: str
    model: str
    windows: int
    leaps: int
    position: Mapping[str, tuple[float, float, float]]
    yaw: Mapping[str, tuple[float, float, float]]
    against: Mapping[str, tuple[float, float, float]]
    seconds: float
    turns: Mapping[str, tuple[float, int]] = field(default_factory=dict)
    values: tuple[str, ...] = ()


FIGURES: dict[str, Callable[[Array], float]] = {
    "rmse": lambda error: float(np.sqrt(np.mean(error**2))),
    "median": lambda error: float(np.median(error)),
    "p90": lambda error: float(np.quantile(error, 0.9)),
}
BASE = UNTIMED
"""Model that others stand against."""


def blocks_of(parts: Sequence[RecordingPart]) -> NDArray[np.int64]:
    """Which block every window of all parts is of: what follows each other within `BLOCK` s is not independent."""
    found, count = [], 0
    for part in parts:
        t = part.windows.t
        new = np.concatenate(([True], np.floor(t[1:] / BLOCK) != np.floor(t[:-1] / BLOCK)))
        found.append(count + np.cumsum(new) - 1)
        count = int(found[-1][-1]) + 1
    return np.concatenate(found)


def draws(blocks: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Rows of windows, `_DRAWS` times: blocks drawn with replacement."""
    rng, count = np.random.default_rng(0), int(blocks.max()) + 1
    rows = [np.flatnonzero(blocks == block) for block in range(count)]
    return [np.concatenate([rows[i] for i in rng.integers(0, count, count)]) for _ in range(_DRAWS)]


def _figures(error: Array, drawn: Sequence[NDArray[np.int64]]) -> dict[str, tuple[float, float, float]]:
    found = {}
    for name, figure in FIGURES.items():
        low, high = np.quantile([figure(error[rows]) for rows in drawn], [0.025, 0.975])
        found[name] = (figure(error), float(low), float(high))
    return found


def _ratios(
    errors: Mapping[str, Array], base: Mapping[str, Array], drawn: Sequence[NDArray[np.int64]]
) -> dict[str, tuple[float, float, float]]:
    found = {}
    for what, error in errors.items():
        for name, figure in FIGURES.items():
            ratios = [figure(error[rows]) / max(figure(base[what][rows]), 1e-12) for rows in drawn]
            low, high = np.quantile(ratios, [0.025, 0.975])
            found[f"{what} {name}"] = (figure(error) / max(figure(base[what]), 1e-12), float(low), float(high))
    return found


def errors_of(predicted: Array, windows: DrivenWindows) -> dict[str, Array]:
    """Distance (m) and difference of heading (rad) at the ends of windows, (n,) each."""
    off = predicted - windows.moved
    turned = np.abs(np.arctan2(np.sin(off[:, 2]), np.cos(off[:, 2])))
    return {"position": np.hypot(off[:, 0], off[:, 1]), "yaw": turned}


def turned_back(windows: DrivenWindows) -> NDArray[np.bool_]:
    """Windows (n,) whose faster side at the end is not that of the start: what turns late or winds up shows there."""
    rows, first = np.arange(len(windows)), round(BEFORE / STEP)
    last = first + np.round(windows.length / STEP).astype(int)
    right, left = windows.speed[..., 0], windows.speed[..., 1]
    return np.asarray((right - left)[rows, first] * (right - left)[rows, last] < 0.0)


Fitted = tuple[Callable[[RecordingPart], Array], str]
"""A model fitted to one part: what predicts another, and its values in words."""


def fit_model(model: str, part: RecordingPart, robot: Robot) -> Fitted:
    """One of MODELS fitted to a part."""
    windows = part.windows
    if model == "ideal":
        rolling = ideal(robot)
        return lambda other: rolling(other.windows), ""
    if model in FREE:
        found = fit_kinematic(windows, robot, FREE[model])
        said = ", ".join(f"{name} {getattr(found, name):.3g}" for name in FREE[model])
        return lambda other: found(other.windows), said
    if model == "regressor":
        trees = fit_regressor(windows, robot)
        return lambda other: trees(other.windows), ""
    rolling = fit_kinematic(windows, robot, FREE[TIMED])
    work = fit_artibot(part, robot, ARTIBOT[model], rolling)
    values = ", ".join(f"{e.name} {e.value:.3g} ({e.ci95[0]:.3g} … {e.ci95[1]:.3g})" for e in work.result.estimates)
    identified, late = as_recorded(work.result.robot, work.shifts)
    return lambda other: predict_artibot(identified, late, other, rolling), values


def as_recorded(robot: Robot, shifts: Mapping[str, float]) -> tuple[Robot, float]:
    """A robot identified with stamps that were shifted, and by how much poses are later than rotations as they came, s.

    Less than 0 where rotations are the later ones. The robot is left without the delay of its poses.
    """
    effects = dict(robot.effects)
    delay = float(effects.pop("pose_delay", {}).get("delay", 0.0))
    delay += shifts.get("rotation_delay", 0.0) - shifts.get("pose_delay", 0.0)
    return replace(robot, effects=effects), delay


MODELS = ("ideal", *FREE, "regressor", *ARTIBOT)


def judge(ground: RobotOnGround, folder: Path, models: Sequence[str] = MODELS) -> Iterator[Score]:
    """Every model's errors on one ground, each part predicted by what was fitted to the others."""
    robot = load_robot(ground.robot)
    parts = parts_of(ground, folder, robot)
    drawn, leaps = draws(blocks_of(parts)), sum(part.leaps for part in parts)
    base: dict[str, Array] = {}
    back = np.concatenate([turned_back(part.windows) for part in parts])
    for model in sorted(models, key=lambda name: name != BASE) if BASE in models else models:
        begun = time.perf_counter()
        every, said = [], []
        for i, part in enumerate(parts):
            predict, values = fit_model(model, _together([p for j, p in enumerate(parts) if j != i]), robot)
            every.append(errors_of(predict(part), part.windows))
            said += [values] if values else []
        errors = {what: np.concatenate([one[what] for one in every]) for what in ("position", "yaw")}
        lost = ~np.isfinite(errors["position"])
        if lost.any():
            raise ArtibotError(f"{ground.name}: {model} predicts nothing in {int(lost.sum())} of {len(lost)} windows")
        base = base or (errors if model == BASE else {})
        yield Score(
            ground.name, model, len(lost), leaps, _figures(errors["position"], drawn), _figures(errors["yaw"], drawn),
            _ratios(errors, base, drawn) if base and model != BASE else {}, time.perf_counter() - begun,
            {
                name: (FIGURES["rmse"](errors["yaw"][some]), int(some.sum()))
                for name, some in (("kept", ~back), ("reversed", back)) if some.any()
            },
            tuple(said),
        )  # fmt: skip


def _together(parts: Sequence[RecordingPart]) -> RecordingPart:
    """Several parts as one to fit."""
    columns = zip(*((w.t, w.length, w.start, w.end, w.speed) for w in (part.windows for part in parts)), strict=True)
    experiments = tuple(experiment for part in parts for experiment in part.experiments)
    return RecordingPart(experiments, DrivenWindows(*(np.concatenate(column) for column in columns)))


# ----------------------------------------------------------------------
# The command.
# ----------------------------------------------------------------------


def table_of(scores: Sequence[Score]) -> str:
    """Scores as a table in Markdown; medians over those of the three-parameter ICR with their intervals."""
    lines = [
        "| ground | windows | model | position RMSE / median / p90, m | yaw, rad | position, of ICR's | yaw | s |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for score in scores:
        count = f"{score.windows}" + (f" ({score.leaps} leap)" if score.leaps else "")
        cells = [" / ".join(f"{error[name][0]:.3f}" for name in FIGURES) for error in (score.position, score.yaw)]
        ratios = [score.against.get(f"{what} median") for what in ("position", "yaw")]
        beside = [f"{r[0]:.2f} ({r[1]:.2f} … {r[2]:.2f})" if r else "" for r in ratios]
        lines.append(
            "| " + " | ".join([score.ground, count, score.model, *cells, *beside, f"{score.seconds:.0f}"]) + " |"
        )
    return "\n".join(lines)


def turns_table(scores: Sequence[Score]) -> str:
    """Scores' errors of heading where robots go on turning one way, and where they turn back, in Markdown."""
    lines = ["| ground | model | heading RMSE where a turn is kept, rad | where it is reversed |", "|---|---|---|---|"]
    for score in scores:
        cells = [
            f"{score.turns[k][0]:.3f} ({score.turns[k][1]})" if k in score.turns else "" for k in ("kept", "reversed")
        ]
        lines.append("| " + " | ".join([score.ground, score.model, *cells]) + " |")
    return "\n".join(lines)


def data_folder(given: Path | None) -> Path:
    """The folder of the recordings, by option or environment.

    Raises
    ------
    ArtibotError
        Where neither says one, or there is none.
    """
    named = given or (Path(os.environ[DATA]) if os.environ.get(DATA) else None)
    if named is None:
        raise ArtibotError(f"no recordings of real robots: say where they are with --data FOLDER, or {DATA}=FOLDER")
    if not named.is_dir():
        raise ArtibotError(f"{named}: there is no such folder; it should hold recordings such as husky_drive_a")
    return named


def usable(folder: Path, only: Sequence[str]) -> tuple[list[RobotOnGround], list[str]]:
    """Grounds whose recordings are there, and sentences on those that are not."""
    found, said = [], []
    for ground in GROUNDS:
        if only and not any(word in (ground.name, *ground.recordings) for word in only):
            continue
        absent = [name for name in ground.recordings if not (folder / name).exists()]
        if absent:
            said.append(f"{ground.name}: left out, {', '.join(absent)} not in {folder}")
        else:
            found.append(ground)
    return found, said


@click.command("real", context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--data", type=click.Path(path_type=Path, file_okay=False), help=f"Folder of the recordings [${DATA}].")
@click.option("--only", multiple=True, metavar="GROUND", help="A ground or one of its recordings; repeatable.")
@click.option("--model", "models", multiple=True, type=click.Choice(MODELS), help="Repeatable [all].")
@click.option("--json", "as_json", type=click.Path(path_type=Path, dir_okay=False), help="Everything as JSON.")
def command(data: Path | None, only: tuple[str, ...], models: tuple[str, ...], as_json: Path | None) -> None:
    """Judge models on recordings of real robots: fitted to one part, errors on another, after windows of 2 s.

    Windows start at the pose that is measured there; nothing measured later is used but the wheels' speeds. Windows in
    which the robot is not driven, or in which its measured pose leaps, are not judged.
    """
    from artibot_sim.report.files import write_files

    folder = data_folder(data)
    grounds, absent = usable(folder, only)
    for sentence in absent:
        print(sentence, file=sys.stderr)
    if not grounds:
        raise ArtibotError(f"{folder}: none of the recordings is there; expected folders such as husky_drive_a")
    scores: list[Score] = []
    try:
        for ground in grounds:
            for score in judge(ground, folder, models or MODELS):
                scores.append(score)
                print(f"{score.ground}: {score.model}, {score.seconds:.0f} s", file=sys.stderr, flush=True)
                for values in score.values:
                    print(f"    {values}", file=sys.stderr)
    finally:  # what is judged is kept where a later model fails, or somebody stops it
        print(table_of(scores) + "\n\n" + turns_table(scores))
        if as_json is not None:
            write_files({as_json: (json.dumps([asdict(score) for score in scores], indent=1) + "\n").encode()})


if __name__ == "__main__":
    try:
        command()
    except ArtibotError as error:
        sys.exit(f"artibot: {error}")
