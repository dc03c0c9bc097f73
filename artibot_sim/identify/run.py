"""`identify`: from recordings and a robot to an :class:`Identification`."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from artibot_sim.estimation.alignment import mean_shifts, on_one_clock, stream_table, what_is_wrong, with_faults
from artibot_sim.estimation.checks.recordings import require_usable
from artibot_sim.estimation.encoder_noise import noise_share
from artibot_sim.estimation.kinematic import kinematic_models
from artibot_sim.estimation.loss import Loss, channel_levels, merged
from artibot_sim.estimation.measurements import (
    missing,
    noise_levels,
    other_robot,
)
from artibot_sim.estimation.parallel import side_by_side
from artibot_sim.estimation.parameters import SOIL, ParameterSet, Prior
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.search import (
    Effort,
    Fit,
    Tick,
    continued,
    converge,
    evenly,
    restarted_windows,
    search,
    thinned,
)
from artibot_sim.estimation.solver import Point, evaluate
from artibot_sim.estimation.surroundings import Surroundings, surroundings
from artibot_sim.estimation.uncertainty import from_bootstrap, from_curvature, profile
from artibot_sim.estimation.windows import CHANNEL_NAMES
from artibot_sim.experiment import Experiment
from artibot_sim.identify.currents import SCALE, SCALE_PRIOR, counts_currents, currents_of, with_torques
from artibot_sim.identify.judgement import FittedMotion, estimates, motion_of, overall, weakest
from artibot_sim.identify.problems import enough_of, problem_of
from artibot_sim.identify.requested import parameter_set
from artibot_sim.identify.result import Estimate, FitStatus, Identification, number
from artibot_sim.identify.validation import PredictedRecording, channel_fits, hold_out, late_poses
from artibot_sim.model import Robot
from artibot_sim.progress import Report

Array = NDArray[np.float64]

WINDOW = 5.0
"""s of a window: long enough for the path to say something, short enough that a start decides which branch it takes."""
_SEARCHED = 400.0
"""s of windows at most that the search from several starts takes, evenly: real ground differs from one to the next."""
LOWEST_NOISE = 0.7
"""Least noise that residuals may show, in that of neighbouring samples. Not in what was assumed before: how wrong an
earlier fit was, and so where it ended, must not matter once a better one is found."""
_SETTLE = 8
"""Steps at most of a fit that goes on from where another one ended."""
_POOR = 1.4
"""Residuals over the sensor's noise from which a search has probably missed the best optimum; a total station's slow
errors alone make as much."""
_FOREIGN = 4.0
"""Residuals over the sensor's noise from which they are not noise but the model's own error."""
_FOR_CURRENTS = 180.0
"""s of windows at most whose path tells which torques currents follow."""
_BESIDE = {
    "effects.wheel_resistance.share": Prior(0.1, 0.1), "effects.pose_lever_arm.x": Prior(0.0, 0.15),
    "effects.pose_lever_arm.y": Prior(0.0, 0.15),
}  # fmt: skip
"""What is fitted to the path of a rigid robot for that, beside its soil."""
_STIFFNESSES = (0.06, 0.25, 1.0, 4.0)
"""Times the robot file's stiffness of the ground from which that is fitted."""
_PATIENCE = 3
"""Further rounds for a fit that still falls, and moves along its profile."""
_MOVES = 2
"""How often at most a fit goes on from a better place on its profile."""
_BETTER = 10.0
"""Fall of the loss from which a fit goes on from a better place on its profile."""


@dataclass(frozen=True)
class Work:
    """An identification with what it was made of, for pictures and for going on.

    Attributes
    ----------
    result : Identification
    problem : Problem
        Windows with the noise levels that the fit ended with.
    fit : Fit
    around : Surroundings
        Where the search could have ended as well.
    held : tuple of PredictedRecording
    shifts : mapping of str to float
        s by which stamps were shifted before anything was fitted, in the mean over the recordings, by finding.
    """

    result: Identification
    problem: Problem
    fit: Fit
    around: Surroundings
    held: tuple[PredictedRecording, ...]
    shifts: Mapping[str, float] = field(default_factory=dict)


def identify(
    recordings: Sequence[Experiment],
    robot: Robot,
    *,
    fit: Sequence[str] = SOIL,
    priors: Mapping[str, Prior] | None = None,
    holdout: Sequence[Experiment] = (),
    window: float = WINDOW,
    effort: Effort | None = None,
    seed: int = 0,
    workers: int | None = None,
    progress: Report | None = None,
) -> Work:
    """Identify parameters of a robot from recordings.

    The model is driven by all measured motor rotations (section 6); torques are outputs. Recordings are cut into
    windows, each with a start of its own (multiple shooting), because a free run with the right parameters may leave
    the measured branch. See docs/identification.md.

    Parameters
    ----------
    recordings : sequence of Experiment
        What `read_bag` gives.
    robot : Robot
        Its values are the priors' middles.
    fit : sequence of str
        Parameters to identify.
    priors : mapping of str to Prior, optional
    holdout : sequence of Experiment
        Recordings to predict with the result.
    window : float
        Length of a window, s.
    effort : Effort, optional
    seed : int
        Of every random draw: the same data and seed give the same result.
    workers : int, optional
        Threads; as many as cores by default. The result does not depend on it.
    progress : callable
        Called with the share that is done.

    Raises
    ------
    ArtibotError
        For recordings that lack what is needed, or parameters that do not exist.
    """
    begun, parameters = time.perf_counter(), parameter_set(robot, fit, priors)
    ticks = _Ticks(progress, (effort or Effort()), len(parameters.beside_soil), len(holdout))
    require_usable([*recordings, *holdout], robot)
    in_model = "pose_delay" in parameters.robot.effects  # a late pose is the model's own matter then
    timed, later = (on_one_clock(some, parameters.robot, seed, poses=not in_model) for some in (recordings, holdout))
    recordings, holdout = [one.experiment for one in timed], [one.experiment for one in later]
    wrong = what_is_wrong(timed, later)
    currents = with_currents(recordings, holdout, parameters, window, seed, workers)
    recordings, holdout, parameters = currents.recordings, currents.holdout, currents.parameters
    used = any(map(counts_currents, recordings))
    problem = problem_of(recordings, parameters, window, workers, seed=seed)
    problem, fewer = enough_of(problem)
    ticks()
    problem, found = best_fit(problem, effort or Effort(), ticks)
    found, around = explored(problem, found, other_ends(problem, found), _MOVES, ticks)
    motion = motion_of(problem, found.point.coordinates, found.point.starts, _has_torques(problem), used)
    result = _result(recordings, holdout, problem, found, around, motion)
    held = []
    rivals = kinematic_models(problem) if holdout and not robot.articulated else {}
    for experiment in holdout:
        held.append(hold_out(experiment, result.robot, window, workers, rivals))
        ticks()
    seconds = time.perf_counter() - begun
    predictions = tuple(h.summary for h in held)
    late = () if in_model else late_poses(predictions, rivals)
    known = {name: result.robot.effects[name] for name in result.robot.effects if name not in currents.only_here}
    whole = with_faults(replace(result.robot, effects=known), timed, "identified")
    result = replace(
        result, robot=whole, findings=wrong,
        streams=stream_table([*timed, *later]), remarks=(*currents.remarks, *fewer, *result.remarks, *late),
        predictions=predictions, seconds=seconds,
    )  # fmt: skip
    return Work(result, problem, found, around, tuple(held), mean_shifts(timed))


@dataclass(frozen=True)
class WithCurrents:
    """Recordings of which currents count as torques, and parameters that leave their scale open.

    Attributes
    ----------
    recordings, holdout : list of Experiment
    parameters : ParameterSet
    remarks : tuple of str
        What the currents are; empty without any.
    only_here : tuple of str
        Effects of these recordings that are no property of the robot: the scale of such torques.
    """

    recordings: list[Experiment]
    holdout: list[Experiment]
    parameters: ParameterSet
    remarks: tuple[str, ...] = ()
    only_here: tuple[str, ...] = ()


def with_currents(
    recordings: Sequence[Experiment],
    holdout: Sequence[Experiment],
    parameters: ParameterSet,
    window: float,
    seed: int,
    workers: int | None,
) -> WithCurrents:
    """Currents in the place of torques that were not recorded.

    What explains the path tells how they go together: `parameters`, and of a rigid robot how the ground resists its
    wheels and which point the pose is of, unless these are known. Soils of very different stiffness explain a path
    alike; of several the one counts whose torques the currents follow best.
    """
    robot = parameters.robot
    some = [one for one in recordings if currents_of(one, robot) is not None]
    if not some:
        return WithCurrents(list(recordings), list(holdout), parameters)
    known = () if robot.articulated else tuple(key for key in _BESIDE if key.split(".")[1] not in robot.effects)
    richer = beside(parameters, {key: _BESIDE[key] for key in known})
    problem, _ = enough_of(problem_of(some, richer, window, workers, seed=seed), _FOR_CURRENTS)
    paths = side_by_side(lambda factor: _of_stiffness(problem, factor), _STIFFNESSES, workers)
    recordings, holdout, said = with_torques(recordings, holdout, paths, workers)
    if "torque_scale" in robot.effects or not any(map(counts_currents, recordings)):
        return WithCurrents(recordings, holdout, parameters, (said,))
    return WithCurrents(recordings, holdout, beside(parameters, {SCALE: SCALE_PRIOR}), (said,), ("torque_scale",))


def _of_stiffness(problem: Problem, factor: float) -> Robot:
    """The robot that explains the path best near so many times its stiffness of the ground."""
    parameters = problem.parameters
    values = parameters.values(np.zeros(len(parameters)))
    for key in ("contact.k_l", "contact.k_t"):
        if (i := parameters.index(key)) is not None:
            values[i] *= factor
    loss, guess = Loss(1.0, np.ones(len(CHANNEL_NAMES))), parameters.inside(parameters.coordinates(values))
    point = evaluate(problem, loss, [guess], problem.starts)[0]
    return parameters.robot_at(converge(problem, point, loss, _SETTLE).point.coordinates)


def beside(parameters: ParameterSet, priors: Mapping[str, Prior]) -> ParameterSet:
    """These parameters and others of which only priors are known."""
    if not priors:
        return parameters
    more = parameter_set(parameters.robot, tuple(priors), priors)
    return replace(parameters, robot=more.robot, parameters=(*parameters.parameters, *more.parameters))


class _Ticks:
    """Counts parts of the work of about equal length; how many there will be is known well enough."""

    def __init__(self, report: Report | None, effort: Effort, sizes: int, holdouts: int) -> None:
        self._report = report or (lambda _: None)
        self._expected = 5 + effort.ticks + 2 * sizes + holdouts
        self._count = 0
        self._report(0.0)

    def __call__(self) -> None:
        self._count += 1
        self._report(min(1.0, self._count / self._expected))


@dataclass(frozen=True)
class Trust:
    """How far residuals are believed to be noise.

    Where something is not in the model, residuals are larger and slower than what sensors err. Noise levels found
    from them would hide it, channel by channel.

    Attributes
    ----------
    level : float
        Largest factor on a channel's noise as neighbouring samples show it.
    thinning : float
        Most samples that are worth one.
    """

    level: float = np.inf
    thinning: float = np.inf

    def levels(self, found: Mapping[str, float], before: Array) -> Array:
        """Factors on the noise levels, by channel; `before` is what they were multiplied with already."""
        return np.clip(merged(found) * before, LOWEST_NOISE, self.level) / before

    def loss(self, found: Loss) -> Loss:
        """A loss that thins as much at most."""
        return replace(found, thinning=np.minimum(found.thinning, self.thinning))


def best_fit(problem: Problem, effort: Effort, tick: Tick, trust: Trust | None = None) -> tuple[Problem, Fit]:
    """The best fit, and the problem with noise levels as its residuals show them; first with some of the windows.

    Noise estimated from neighbouring samples misses what is slow: a total station's errors, what is left of the
    encoders'. Only at a good fit may channels be distinguished by their residuals. Whoever does not `trust` residuals
    to be noise, for something may be missing in the model, keeps all windows in the end.
    """
    every = evenly(problem, _SEARCHED)
    part = problem.part(every)
    some = search(part, effort, tick)
    loss = Loss(1.0, some.loss.thinning)
    first = channel_levels(part.windows, some.point.residuals)
    foreign = max(first.values()) > _FOREIGN or trust is not None
    poor = max((level for name, level in first.items() if name != "position"), default=0.0) > _POOR and trust is None
    trust, before = trust or Trust(), np.ones(len(CHANNEL_NAMES))
    for _ in range(2):
        levels = trust.levels(channel_levels(part.windows, some.point.residuals), before)
        part, problem, before = part.rescaled(levels), problem.rescaled(levels), before * levels
        loss = trust.loss(thinned(part, some))
        point = evaluate(part, loss, [some.point.coordinates], some.point.starts)[0]
        some = replace(converge(part, point, loss, 3), report=some.report, others=some.others)
    if poor:
        some = _profiled(part, some, _PATIENCE)
    tick()
    # under another loss, and of all windows, another soil may be the best
    anew = continued(problem, loss, some.point.coordinates, effort)
    found = min(_of_all_windows(problem, loss, some.point), anew, key=lambda fit: fit.point.cost)
    for _ in range(_PATIENCE):
        if found.converged:
            break
        found = converge(problem, found.point, loss, _SETTLE)  # far from its end: not yet the time to dismiss windows
    found = converge(problem, found.point, replace(loss, firm=not foreign), _SETTLE)
    tick()
    return problem, replace(found, report=some.report, others=some.others)


def _of_all_windows(problem: Problem, loss: Loss, point: Point) -> Fit:
    """A fit of all windows that begins where that of the searched ones ended."""
    starts = problem.starts.copy()
    starts[evenly(problem, _SEARCHED)] = point.starts
    begun = evaluate(problem, loss, [point.coordinates], starts)[0]
    return converge(problem, restarted_windows(problem, loss, begun), loss, _SETTLE)


def other_ends(problem: Problem, found: Fit) -> list[Fit]:
    """The search's other ends, each fitted to all windows as the best one was."""
    return side_by_side(partial(_of_all_windows, problem, found.loss), found.others, problem.workers)


def explored(
    problem: Problem, found: Fit, others: Sequence[Fit], moves: int, tick: Tick = lambda: None
) -> tuple[Fit, Surroundings]:
    """The fit and what is around it; where the profile over mu_s holds a better place, the fit goes on from there.

    Parameters
    ----------
    problem : Problem
    found : Fit
    others : sequence of Fit
        Other ends of the search.
    moves : int
        How often at most.
    tick : callable
        Called when a part of the work is done.
    """
    around = surroundings([(problem, found)], tick, others)[0]
    for _ in range(moves):
        best = min((node.point for node in around.profile), key=lambda point: point.cost)
        if best.cost > found.point.cost - _BETTER:
            break
        found = replace(converge(problem, best, found.loss, 3), report=found.report)
        own, noise = profile(problem, found), noise_share(problem, found)
        around = Surroundings(own, (*around.beside, *around.profile), noise)
    return found, around


def _profiled(problem: Problem, found: Fit, moves: int) -> Fit:
    """The fit; where its profile over mu_s finds a better place, it goes on from there, at most `moves` times."""
    for _ in range(moves):
        best = min((node.point for node in profile(problem, found)), key=lambda point: point.cost)
        if best.cost > found.point.cost - _BETTER:
            break
        found = replace(converge(problem, best, found.loss, 3), report=found.report, others=found.others)
    return found


def _has_torques(problem: Problem) -> bool:
    return any(s.channel.startswith("torque") for stretch in problem.stretches for s in stretch.series)


def _result(
    recordings: Sequence[Experiment],
    held: Sequence[Experiment],
    problem: Problem,
    found: Fit,
    around: Surroundings,
    motion: FittedMotion,
) -> Identification:
    parameters = problem.parameters
    curvature = from_curvature(problem, around.profile, found.free, around.noise)
    # what lies between two optima is none: values are of the best one, intervals hold all
    own, every = (from_bootstrap(problem, nodes, found.free, around.noise) for nodes in (around.profile, around.nodes))
    bootstrap = replace(every, mean=own.mean)
    text, share, _ = weakest(parameters, curvature.covariance)
    all_ = estimates(parameters, found.point.coordinates, curvature, bootstrap, motion)
    status, message = overall(all_, found.converged, text, share)
    sd = np.sqrt(np.diag(curvature.covariance))
    levels = noise_levels(problem.stretches)
    lacking = missing(problem.stretches, parameters.robot)
    remarks = [f"not measured: {', '.join(lacking)}"] if lacking else []
    remarks += [f"{e.name}: {remark}" for e in recordings for remark in e.remarks]
    remarks += [f"{e.name}: {word}" for e in (*recordings, *held) for word in other_robot(e, parameters.robot)]
    names = [e.name for e in recordings]
    return Identification(
        identified_robot(parameters, all_, names), all_, curvature.covariance / np.outer(sd, sd),
        f"{text} (to {number(100 * share, 2)} % of its prior's width)", status, message, tuple(names), len(problem),
        sum(len(w) for w in problem.windows), channel_fits(problem.windows, found.point.residuals, levels),
        remarks=tuple(remarks), search=found.report,
    )  # fmt: skip


def identified_robot(parameters: ParameterSet, found: Sequence[Estimate], names: Sequence[str]) -> Robot:
    """The robot with the estimates, their sources and intervals."""
    changed = parameters.robot_with(np.array([e.value for e in found]))
    sources = dict(changed.sources)
    where = ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")
    for e in found:
        said = "" if e.status is FitStatus.CONVERGED else f"; {e.status.value}"
        sources[e.key] = f"identified: from {where}{said}"
    intervals = dict(changed.intervals) | {e.key: e.ci95 for e in found}
    return replace(changed, sources=sources, intervals=intervals)
