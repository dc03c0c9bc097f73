"""From a fit's numbers to what they mean: intervals, statuses, and which combination the data leave open, and why."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from artibot_sim.estimation.parameters import MU_D, MU_S, Parameter, ParameterSet
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.solver import Point
from artibot_sim.estimation.uncertainty import Distribution
from artibot_sim.identify.result import Estimate, FitStatus
from artibot_sim.model.simulate.window_inputs import KINDS, SamplingPlan

Array = NDArray[np.float64]

OPEN = 0.5
"""A combination whose standard deviation the data do not bring below this share of the prior's is not identified."""
SYSTEMATIC = 0.005
"""Standard deviation, of a logarithm, of what no residual shows: smoothed rotations make forces some tenths of 1 %
too large, and when wheels break away is known to a few milliseconds. Chosen with `coverage 60 7` before the encoders'
noise was taken off: 95 % of the intervals then covered; 87 % with 0.3 %, 98 % with 0.75 %."""
_TOUCHES = 1e-3
"""Relative distance of mu_d below mu_s at which it stands at it."""
_PART = 0.3
"""Smallest share of a combination that is named."""
_TURNING = 0.02
"""rad/s of mean yaw rate, under which a rover hardly turns."""


@dataclass(frozen=True)
class FittedMotion:
    """What a rover did in the recordings, as the fit has it.

    Attributes
    ----------
    sliding : float
        Share of the time in which some wheel slides.
    grip : float
        Largest share of its normal force that a wheel held.
    turning : float
        Root mean square yaw rate, rad/s.
    torques : bool
        Whether torques were recorded.
    currents : bool
        Whether currents stand for them.
    """

    sliding: float
    grip: float
    turning: float
    torques: bool
    currents: bool = False


def motion_of(
    problem: Problem, coordinates: Array, starts: Array, torques: bool, currents: bool = False
) -> FittedMotion:
    """What the windows' simulations show."""
    t = [np.arange(0.05, duration, 0.05) for duration in problem.durations]
    seen = {}
    for name in ("sliding", "grip", "yaw_rate"):
        plans = [SamplingPlan(times, np.full(len(times), KINDS.index(name))) for times in t]
        seen[name] = np.concatenate(problem.sampled(coordinates, starts, plans))
    known = np.isfinite(seen["sliding"])
    return FittedMotion(
        float((seen["sliding"][known] > 0).mean()), float(seen["grip"][known].max()),
        float(np.sqrt(np.mean(seen["yaw_rate"][known] ** 2))), torques, currents,
    )  # fmt: skip


def weakest(parameters: ParameterSet, covariance: Array) -> tuple[str, float, Array]:
    """The combination of logarithms that the data say least about.

    Returns
    -------
    text : str
    share : float
        Its standard deviation over the prior's.
    part : array, shape (p,)
        How much of it each parameter is, in units of its prior.
    """
    spread = parameters.spread
    values, vectors = np.linalg.eigh(covariance / np.outer(spread, spread))
    vector = vectors[:, -1]
    direction = vector * spread  # back to logarithms
    direction = direction / direction[np.argmax(np.abs(direction))]
    named = [i for i in np.argsort(-np.abs(direction)) if abs(direction[i]) >= _PART]
    parts = [f"{parameters.names[i]}{_power(direction[i])}" for i in sorted(named)]
    return " · ".join(parts), float(np.sqrt(max(values[-1], 0.0))), np.abs(vector)


def _power(exponent: float) -> str:
    return "" if abs(exponent - 1.0) < 0.05 else f"^{exponent:.1f}"


def estimates(
    parameters: ParameterSet, coordinates: Array, curvature: Distribution, bootstrap: Distribution, motion: FittedMotion
) -> tuple[Estimate, ...]:
    """Values, intervals and statuses of all parameters.

    The loss is jagged, so its lowest point is a matter of luck; values are the bootstrap's means, which is to say
    the mean of what draws of windows would have given.
    """
    bound = parameters.at_bound(coordinates)
    values = np.where(bound, parameters.values(coordinates), parameters.at(bootstrap.mean))
    values = parameters.robot_with(values).as_vector(parameters.keys)
    shares = np.sqrt(np.diag(curvature.covariance)) / parameters.spread
    found = []
    for i, p in enumerate(parameters.parameters):
        low, high = p.at(curvature.low[i]), p.at(curvature.high[i])
        again = p.at(bootstrap.low[i]), p.at(bootstrap.high[i])
        reason = unseen(p.key, motion)
        status = FitStatus.CONVERGED
        if bound[i] and not reason:
            status = FitStatus.AT_BOUND
            reason = f"stands at the bound of its prior, {values[i]:.4g}; widen it, or look for another cause"
        elif reason or shares[i] > OPEN:
            status = FitStatus.NOT_IDENTIFIABLE
            reason = reason or open_reason(p.key, motion)
        widened = _with_systematic(p, float(values[i]), min(low, again[0]), max(high, again[1]))
        if status is FitStatus.NOT_IDENTIFIABLE:
            widened = _with_prior(widened, p)
        found.append(
            Estimate(p.key, p.name, p.unit, float(values[i]), widened, (float(low), float(high)), again,
                     (p.prior.value, p.prior.sd), status, reason)
        )  # fmt: skip
    return tuple(_under_the_limit(found, parameters, values))


def _under_the_limit(found: Sequence[Estimate], parameters: ParameterSet, values: Array) -> list[Estimate]:
    """The estimates, mu_d said to stand at mu_s where it does: no draw exceeds that, whatever the curvature says."""
    by_key = {estimate.key: estimate for estimate in found}
    limit = parameters.robot_with(values).contact.mu_s
    sliding, gripping = by_key.get(MU_D), by_key.get(MU_S)
    if sliding is None or gripping is None:
        return list(found)  # a mu_s that is not fitted gives way to mu_d
    if sliding.value < (1.0 - _TOUCHES) * limit or sliding.status is not FitStatus.CONVERGED:
        return list(found)
    ends = min(sliding.ci95[0], sliding.value), max(min(sliding.ci95[1], gripping.ci95[1]), sliding.value)
    note = (
        f"stands at mu_s, {limit:.4g}, which it cannot exceed: nothing shows that a wheel lets go when it slides; "
        "record tighter turns, or fit mu_s alone"
    )
    said = replace(sliding, ci95=ends, status=FitStatus.AT_BOUND, note=note)
    return [said if estimate is sliding else estimate for estimate in found]


def _with_systematic(p: Parameter, value: float, low: float, high: float) -> tuple[float, float]:
    """An interval about `value` widened by SYSTEMATIC, in quadrature."""
    if p.signed:
        floor = 1.96 * SYSTEMATIC * abs(value)
        return float(value - np.hypot(max(value - low, 0.0), floor)), float(
            value + np.hypot(max(high - value, 0.0), floor)
        )
    floor = 1.96 * SYSTEMATIC
    down, up = (np.hypot(max(np.log(ratio), 0.0), floor) for ratio in (value / low, high / value))
    return float(value * np.exp(-down)), float(value * np.exp(up))


def _with_prior(interval: tuple[float, float], p: Parameter) -> tuple[float, float]:
    """An interval at least as wide as the prior's."""
    return min(interval[0], p.at(-1.96 * p.spread)), max(interval[1], p.at(1.96 * p.spread))


def unseen(key: str, motion: FittedMotion) -> str:
    """Why a parameter cannot have acted in the recordings; empty where it can."""
    if key in (MU_S, MU_D) and motion.sliding == 0.0:
        least = f"; all that is known is mu_s > {motion.grip:.2f}" if key == MU_S else ""
        return f"no wheel ever slides: none takes more than {motion.grip:.2f} of its normal force{least}"
    if key == "contact.k_t" and motion.turning < _TURNING:
        return f"the rover hardly turns ({motion.turning:.2g} rad/s): nothing pushes its wheels sideways"
    if key == "contact.u_w" and motion.currents:
        return "currents do not tell rolling resistance from what motors and gears take without a load"
    return ""


def open_reason(key: str, motion: FittedMotion) -> str:
    """The likeliest reason why something stays open though it acts."""
    if not motion.torques and key == "contact.u_w":
        return "without torques rolling resistance is not seen: it changes what motors give, and hardly the path"
    if not motion.torques and key.startswith("contact."):
        return "without torques only ratios of forces act on the path, their common scale hardly does"
    return "the manoeuvres change it together with others only"


def overall(found: Sequence[Estimate], converged: bool, text: str, share: float) -> tuple[FitStatus, str]:
    """Status of the whole, and one line for a person."""
    loose = [e for e in found if e.status is FitStatus.NOT_IDENTIFIABLE]
    if loose:
        reasons = []
        for note in dict.fromkeys(e.note for e in loose):
            names = ", ".join(e.name for e in loose if e.note == note)
            reasons.append(f"{names} cannot be determined from these recordings: {note}")
        return FitStatus.NOT_IDENTIFIABLE, "; ".join(reasons)
    at = [e for e in found if e.status is FitStatus.AT_BOUND]
    if at:
        return FitStatus.AT_BOUND, f"{', '.join(e.name for e in at)}: {at[0].note}"
    if share > OPEN:
        said = f"the combination {text} stays open: the data leave {100 * share:.0f} % of the prior's width"
        return FitStatus.NOT_IDENTIFIABLE, said
    if not converged:
        return FitStatus.NOT_CONVERGED, "the loss still fell when the steps ended; fit again from the result"
    return FitStatus.CONVERGED, "all parameters are identified"


def excitation(problem: Problem, point: Point) -> Iterator[str]:
    """A sentence where no wheel ever slides in a fit."""
    torques = any(s.channel.startswith("torque") for stretch in problem.stretches for s in stretch.series)
    motion = motion_of(problem, point.coordinates, point.starts, torques)
    if motion.sliding == 0.0:
        yield (
            f"no wheel ever slides (at most {motion.grip:.2f} of its load are held): mu_s, mu_d and what acts "
            "through them cannot be determined; drive tighter turns"
        )
