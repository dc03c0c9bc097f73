"""Whether a fit leaves more than noise: residuals slow enough to be forces, against what fits of clean data leave."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.policy import FAR_BEYOND_NOISE, LEFT_OF_COMMANDS, LEFT_OF_MOTION, LEFT_OF_POSITION
from artibot_sim.diagnose.records import SlowResidual
from artibot_sim.estimation.encoder_noise import with_noisy_inputs
from artibot_sim.estimation.kernels import Parts
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.solver import Point
from artibot_sim.estimation.windows import CHANNEL_NAMES, Window, relaxation_length, time_over

Array = NDArray[np.float64]

BIN = 0.25
"""s over which residuals are averaged: noise averages out, what forces do stays."""
COMMANDED = "front_velocity"
"""The channel in which commands show."""
MOVED = ("yaw", "yaw_rate", "articulation_yaw", "torque_front", "torque_back")
"""Channels that forces move."""
FORCES = frozenset({"torque_front", "torque_back", "articulation_yaw"})
"""Channels in which a force shows that no list has; poses and rates only show that something is not as predicted."""
LIMITS: Mapping[str, float] = {
    "position": LEFT_OF_POSITION, **dict.fromkeys(MOVED, LEFT_OF_MOTION), COMMANDED: LEFT_OF_COMMANDS,
}  # fmt: skip
"""By channel: mean square of averaged residuals above which more than noise is left; 1 is white noise and what noise of
the rotations makes there."""


def shows_forces(problem: Problem) -> bool:
    """Whether anything was measured in which a force on no list would show."""
    return any(series.channel in FORCES for stretch in problem.stretches for series in stretch.series)


_MEMORY = 3.0
"""Relaxation lengths after which a tyre has forgotten the force with which a window took it to begin."""


def remains(problem: Problem, point: Point) -> dict[str, SlowResidual]:
    """What the residuals of a fit leave, by channel.

    In units of the sensors' own noise, as neighbouring samples show it, and of what noise of the rotations, which turn
    the model's wheels, makes of predictions: levels that a fit has widened to its residuals would hide what is left.
    Levels are those of usual samples. Where neighbouring residuals of a window differ by more, as with noise of heavy
    tails, that is its white noise. Of tyres that lag nothing counts until they have forgotten a window's start.
    """
    found: dict[str, list[float]] = {}
    turned: dict[str, list[float]] = {}
    way = _MEMORY * relaxation_length(problem.parameters.robot_at(point.coordinates))
    changed = _from_rotations(problem, point)
    for window, residual, change in zip(problem.windows, point.residuals, changed, strict=True):
        after = time_over(problem.stretches[window.stretch], window.t, way) if way else 0.0
        for sizes, values in ((found, residual), (turned, change)):
            for name, size in _sizes(problem, window, values, after).items():
                sizes.setdefault(name, []).append(size)
    # a window near a switch of eq. 16 answers any noise by taking the other branch: of two the calmer one says it
    noise = {name: 1.0 + float(np.quantile(sizes, 0.5, method="lower")) for name, sizes in turned.items()}
    return {
        name: SlowResidual(float(np.median(sizes)) / noise[name], float(np.quantile(sizes, 0.9)) / noise[name])
        for name, sizes in found.items()
    }


def _from_rotations(problem: Problem, point: Point) -> Parts:
    """What one more draw of the rotations' noise changes in residuals (n,), each window's place and heading fitted."""
    noisy = with_noisy_inputs(problem, 0)
    _, residuals = noisy.aligned(noisy.flat_residuals([point.coordinates], point.starts), point.starts[None])
    return problem.parts(residuals[0] - point.residuals.flat)


def beyond_noise(left: Mapping[str, SlowResidual], times: float = 1.0) -> tuple[str, ...]:
    """Channels in which a force may be at work that the fit does not know: so many times beyond their limit.

    Of what forces move the window in the middle decides: single ones that began on another branch are no force. Of
    channels in which a force shows by itself it is the tenth that is worst, too, where that leaves `FAR_BEYOND_NOISE`
    times as much: a drag that fades is in the first windows only. Poses tell no such force from ground that is another
    one there. Of commands it is the worst tenth: what stands between a command and its motor shows at starts and stops.
    """
    return tuple(name for name, one in left.items() if _size(name, one) > times * LIMITS.get(name, np.inf))


def _size(name: str, one: SlowResidual) -> float:
    if name == COMMANDED:
        return one.worst
    return max(one.typical, one.worst / FAR_BEYOND_NOISE) if name in FORCES else one.typical


def far_beyond_noise(left: Mapping[str, SlowResidual]) -> tuple[str, ...]:
    """Channels that leave no doubt of it."""
    return beyond_noise(left, FAR_BEYOND_NOISE)


def leaves_more_than_noise(left: Mapping[str, SlowResidual]) -> bool:
    """Whether any channel is `beyond_noise`."""
    return bool(beyond_noise(left))


def _sizes(problem: Problem, window: Window, residual: Array, after: float) -> dict[str, float]:
    """Mean squares of one window's averaged residuals, from `after` s on, over those of white noise."""
    found = {}
    for name, scale in problem.widening(window).items():
        mine = (window.channel == CHANNEL_NAMES.index(name)) & (window.plan.t >= after)
        if not mine.any():
            continue
        place = window.plan.kind[mine] * _PLACES + (window.plan.t[mine] / BIN).astype(np.int64)
        order = np.argsort(place, kind="stable")
        firsts = np.flatnonzero(np.diff(place[order], prepend=-1))
        clipped = np.clip(residual[mine][order], -_MOST, _MOST)
        total, count = np.add.reduceat(clipped, firsts), np.add.reduceat(np.ones(len(order)), firsts)
        size, white = float(np.mean(total**2 / count)) * scale**2, _white(clipped, place[order]) * scale**2
        found[name] = size / max(white, 1.0)
    return found


def _white(residual: Array, place: Array) -> float:
    """Mean square of white noise whose neighbours differ as these residuals (n,) do (von Neumann); 0 of single ones."""
    same = place[1:] // _PLACES == place[:-1] // _PLACES
    return 0.5 * float(np.mean(np.diff(residual)[same] ** 2)) if same.any() else 0.0


_PLACES = 100_000
"""Bins of one kind of sample in a window, at most."""
_MOST = 50.0
"""Residual, in units of noise, beyond which it counts as this."""
