"""What each named cause is worth on held-out data: by how much predictions err less once it is in the model."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.command_view import CommandView
from artibot_sim.diagnose.decision import Decision, leaves_more_than_noise
from artibot_sim.diagnose.diagnosis import ChannelGain, Left
from artibot_sim.diagnose.options import Options
from artibot_sim.diagnose.predictions import Pair, predicted
from artibot_sim.identify.holdout import Held
from artibot_sim.identify.robust import channel_levels, merged
from artibot_sim.model import Robot

Array = NDArray[np.float64]

_WORSE = 0.1
"""Growth of the held-out error beyond noise from which data speak against a cause: one that happens not to act in them
adds a few hundredths."""
_LITTLE = 0.5
"""Share of that error which causes leave at most, where the fitted recordings show that there is something else."""


def improvements(
    decision: Decision, pairs: Sequence[Pair], extended: Robot, view: CommandView, options: Options
) -> dict[str, float]:
    """Fraction by which the noise-weighted mean squared error, less the noise's share, falls as each cause is added.

    In the order in which they were found, the soil fitted again each time; 0 where there is no error to fall.

    Parameters
    ----------
    pairs : sequence of Pair
        Of what was held out.
    extended : Robot
        With all causes.
    view : CommandView
        Of the same recordings and others.
    """
    if not decision.named:
        return {}
    levels = merged(channel_levels(decision.problem.windows, decision.fit.point.residuals))
    robots = [*_models(decision)[:-1], extended]
    seen = [pair.before.experiment for pair in pairs]
    held = [[predicted(one, robot, options.horizon, options.workers) for one in seen] for robot in robots[:-1]]
    held.append([pair.after for pair in pairs])
    names = [one.name for one in seen]
    before = excess([pair.before for pair in pairs], _followed(view, extended, names, "before"), levels)
    found = {}
    for named, robot, one in zip(decision.named, robots, held, strict=True):
        after = excess(one, _followed(view, robot, names, "after"), levels)
        found[named.effect] = 1.0 - max(after, 0.0) / before if before > 0.0 else 0.0
        before = after
    return found


def is_refuted(gained: Mapping[str, float], gain: Mapping[str, ChannelGain]) -> bool:
    """Whether held-out data are predicted worse with all that was named: in sum by `_WORSE`, and surely in one channel.

    Parameters
    ----------
    gained : mapping of str to float
        What `improvements` gives.
    gain : mapping of str to ChannelGain
        By channel, with intervals.
    """
    return _left(gained) > 1.0 + _WORSE and any(one.ci95[1] < 0.0 for one in gain.values())


def is_minor(gained: Mapping[str, float], left: Mapping[str, Left]) -> bool:
    """Whether all that was named takes little of the held-out error, and more than noise is left of the fitted one.

    The cause of most of it is another one then, of which what was named may be no more than a part or the shadow.

    Parameters
    ----------
    gained : mapping of str to float
        What `improvements` gives.
    left : mapping of str to Left
        What the fit with all causes leaves.
    """
    return bool(gained) and leaves_more_than_noise(left) and _left(gained) > _LITTLE


def _left(gained: Mapping[str, float]) -> float:
    """Share of the held-out error that all causes together leave."""
    return math.prod(1.0 - share for share in gained.values())


def _models(decision: Decision) -> list[Robot]:
    """The model once each of the named effects was added, in their order."""
    fits = [(turn.problem, turn.fit) for turn in decision.turns[1:]] + [(decision.problem, decision.fit)]
    robots, fitted, commanded = [], -1, {}
    for named in decision.named:
        if named.found:
            commanded[named.effect] = {name: found.value for name, found in named.found.items()}
        else:
            fitted = min(fitted + 1, len(fits) - 1)
        problem, fit = fits[fitted] if fitted >= 0 else (decision.neutral_problem, decision.neutral_fit)
        robot = problem.parameters.robot_at(fit.point.coordinates)
        robots.append(replace(robot, effects=dict(robot.effects) | commanded))
    return robots


def _followed(view: CommandView, robot: Robot, names: Sequence[str], which: str) -> list[Array]:
    """Squared errors of the front motors' speeds in the recordings `names`, in units of noise, if commands say any."""
    if not view.followed:
        return []
    _, series = view.seen_by(robot)
    return [((getattr(series[name], which) / series[name].noise) ** 2).ravel() for name in names if name in series]


def excess(held: Sequence[Held], commanded: Sequence[Array], levels: Array) -> float:
    """Mean squared error in units of noise, `levels` (channels,) times what sensors show, less the noise's share."""
    parts = [(r / levels[w.channel]) ** 2 for h in held for w, r in zip(h.windows, h.residuals, strict=True)]
    every = np.concatenate([*parts, *commanded]) if parts or commanded else np.ones(1)
    return float(np.mean(every[np.isfinite(every)])) - 1.0
