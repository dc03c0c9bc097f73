"""Where and when a model is wrong: sentences computed from its errors and from what the rover did meanwhile."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.conditions import Condition, conditions
from artibot_sim.diagnose.diagnosis import ChannelBaseline, Look, Place
from artibot_sim.diagnose.samples import Samples, gather
from artibot_sim.diagnose.words import amount, is_wrong
from artibot_sim.identify.printing import number

Array = NDArray[np.float64]

_LEAST_SHARE = 0.45
"""Share of the squared error that a condition must hold to be named,"""
_LEAST_LIFT = 1.5
"""and how much more than its share of the time that is."""
_RARE = 0.02
"""Share of the time that a condition must last at least."""
_RARE_PLACE = 0.004
"""The same of a place or a time, which a rover passes once."""
_MANY = 0.6
"""How much the surprise of a place or a time counts: there are hundreds to choose from, so some fit by chance."""
_COMMON = 0.85
"""and at most: what is always so tells nothing."""
_CAP = 0.95
"""Quantile at which squared errors are cut, so that no single moment speaks for a manoeuvre."""
_AGREE = 0.6
"""Share of the recordings in which a condition must hold more than its share of the error."""
_ONE_WAY = 0.6
"""Errors of positions whose mean is so much of their mean size point one way."""
_FOLLOWS = 0.5
"""Share of the squared error that following a quantity must explain to be said."""
_BLOCK = 5.0
"""s of the moment that is told as the worst."""


def places(looks: Sequence[Look], baseline: Mapping[str, ChannelBaseline]) -> tuple[Place, ...]:
    """Sentences on each channel that is wrong, the worst channel first: how much, when, in which manoeuvre, which way.

    Parameters
    ----------
    looks : sequence of Look
    baseline : mapping of str to ChannelBaseline
        The channels to look at, with their errors and noise.
    """
    ratios = {name: base.rmse / base.noise for name, base in baseline.items() if is_wrong(name, base)}
    found: list[Place] = []
    for channel in sorted(ratios, key=lambda name: -ratios[name]):
        samples = gather(looks, channel)
        if samples is not None and len(samples) > 1:
            found += [Place(channel, said) for said in _sentences(samples, looks, baseline[channel])]
    return tuple(found)


def _sentences(samples: Samples, looks: Sequence[Look], base: ChannelBaseline) -> Iterator[str]:
    head = f"off by {amount(base.rmse, base.unit)} (RMSE), {number(base.rmse / base.noise, 2)} times the noise"
    where = concentration(samples)
    told = where.said if where else "spread over all that was driven"
    yield f"{head}; {told}"
    yield worst_moment(samples, looks, base.unit)
    way = direction(samples) if samples.before.shape[1] == 2 else followed(samples, base.unit)
    if way:
        yield way


@dataclass(frozen=True)
class Concentration:
    """A condition that holds more of the error than of the time.

    Attributes
    ----------
    condition : Condition
    error, time : float
        Its shares of the squared error (beyond noise) and of the samples.
    """

    condition: Condition
    error: float
    time: float

    @property
    def said(self) -> str:
        """A sentence's part."""
        return f"{100 * self.error:.0f} % of it (squared) {self.condition.said}, {100 * self.time:.0f} % of the time"


def concentration(samples: Samples) -> Concentration | None:
    """The condition under which the error sits, None where it sits nowhere in particular.

    Of all conditions that hold most of the error, it is the one whose share of the error is most surprising given its
    share of the time (relative entropy of the two shares).
    """
    squares = np.maximum(samples.size**2 - samples.level**2, 0.0)
    capped = np.minimum(squares, np.quantile(squares, _CAP))
    best, most = None, 0.0
    for condition in conditions(samples):
        counted = squares if condition.local else capped
        if counted.sum() <= 0:
            continue
        e, p = float(counted[condition.mask].sum() / counted.sum()), float(condition.mask.mean())
        rare = _RARE_PLACE if condition.local else _RARE
        if not (rare < p < _COMMON and e > _LEAST_SHARE and e > _LEAST_LIFT * p):
            continue
        if not _agree(samples, counted, condition.mask):
            continue
        surprise = _entropy(e, p) * (_MANY if condition.local else 1.0)
        if surprise > most:
            best, most = Concentration(condition, e, p), surprise
    return best


def _entropy(e: float, p: float) -> float:
    """Relative entropy of shares e and p, nats."""
    rest = (1.0 - e) * np.log((1.0 - e) / (1.0 - p)) if e < 1.0 else 0.0
    return float(e * np.log(e / p) + rest)


def _agree(samples: Samples, squares: Array, mask: NDArray[np.bool_]) -> bool:
    """Whether most recordings in which a condition occurs show it."""
    votes = []
    for number_ in np.unique(samples.look):
        mine = samples.look == number_
        p, total = mask[mine].mean(), squares[mine].sum()
        if _RARE < p < 1.0 and total > 0:
            votes.append(squares[mine & mask].sum() / total > p)
    return not votes or float(np.mean(votes)) >= _AGREE


def worst_moment(samples: Samples, looks: Sequence[Look], unit: str) -> str:
    """When it is worst, and what the rover did then."""
    block = np.floor(samples.t / _BLOCK).astype(np.int64)
    names, rows = np.unique(np.column_stack([samples.look, block]), axis=0, return_inverse=True)
    rows = rows.reshape(-1)
    count = np.bincount(rows)
    mean = np.bincount(rows, samples.size**2) / count
    mean[count < 0.2 * np.median(count)] = 0.0
    worst = int(np.argmax(mean))
    mine = rows == worst
    look, t = looks[int(names[worst, 0])], samples.t[mine]
    doing = _doing({name: values[mine] for name, values in samples.at.items()})
    return (
        f"worst in {look.name} from {t.min():.0f} to {t.max():.0f} s, {amount(float(np.sqrt(mean[worst])), unit)}"
        f"{': ' if doing else ''}{doing}"
    )


def _doing(at: Mapping[str, Array]) -> str:
    """What a rover does over some samples: manoeuvre, speed, heading, joint, place, load."""
    mean = {name: float(np.mean(values)) for name, values in at.items()}
    said = []
    if np.isfinite(mean["yaw_rate"]) and np.isfinite(mean["speed"]):
        rate, speed = mean["yaw_rate"], mean["speed"]
        if abs(speed) < 0.03 and abs(rate) < 0.03:
            said.append("standing")
        else:
            turn = "turning left" if rate > 0.08 else "turning right" if rate < -0.08 else "going straight"
            said.append(f"{turn} at {amount(speed, 'm/s')}")
    if np.isfinite(at["heading"]).all():
        heading = float(np.angle(np.mean(np.exp(1j * at["heading"]))))
        said.append(f"heading {number(heading, 2)} rad")
    if np.isfinite(mean["articulation_yaw"]):
        said.append(f"joint at {number(mean['articulation_yaw'], 2)} rad")
    if np.isfinite(mean["x"]) and np.isfinite(mean["y"]):
        x, y = (round(mean[name], 1) + 0.0 for name in ("x", "y"))  # there is no place −0.0
        said.append(f"near ({x:.1f}, {y:.1f}) m")
    if np.isfinite(mean["load"]):
        said.append(f"motor torques {amount(mean['load'], 'N m')} in all")
    return ", ".join(said).replace("-", "−")


def direction(samples: Samples) -> str:
    """Which way the rover is off its predictions, in `map` or in its own frame; empty where all ways are alike."""
    off = -samples.before
    heading = samples.at["heading"]
    mean_size = float(np.mean(samples.size))
    if mean_size <= 0:
        return ""
    best, said = _ONE_WAY, ""
    in_map = off.mean(axis=0)
    if (share := float(np.hypot(*in_map)) / mean_size) > best:
        towards = float(np.arctan2(in_map[1], in_map[0]))
        best = share
        said = (
            f"the rover is found to one side of its predictions, towards {number(towards, 2)} rad "
            f"({np.degrees(towards):.0f}°) in map, by {amount(float(np.hypot(*in_map)), 'm')} on average"
        )
    if np.isfinite(heading).all():
        c, s = np.cos(heading), np.sin(heading)
        own = np.array([np.mean(c * off[:, 0] + s * off[:, 1]), np.mean(c * off[:, 1] - s * off[:, 0])])
        if float(np.hypot(*own)) / mean_size > best:
            axis = int(np.argmax(np.abs(own)))
            name = (("ahead of", "behind"), ("to the left of", "to the right of"))[axis][int(own[axis] < 0)]
            said = f"the rover is found {name} its predictions, by {amount(float(abs(own[axis])), 'm')} on average"
    return said.replace("-", "−")


_OWN = {
    "yaw_rate": (("yaw_rate", "yaw rate"),),
    "articulation_yaw": (("articulation_yaw", "articulation angle"), ("yaw_rate", "yaw rate")),
    "yaw": (("yaw_rate", "yaw rate"),),
    "front_velocity": (("acceleration", "acceleration"), ("speed", "speed")),
    "torque_front": (("load", "load"), ("speed", "speed")),
    "torque_back": (("load", "load"), ("speed", "speed")),
}
"""Channel → what its error may follow."""


def followed(samples: Samples, unit: str) -> str:
    """What the error of a scalar channel follows, or its mean where it is always the same; empty where neither is."""
    error = samples.before[:, 0]
    total = float(np.sum(error**2))
    if total <= 0:
        return ""
    mean = float(error.mean())
    best, said = _FOLLOWS, ""
    if (share := len(error) * mean**2 / total) > best:
        best = share
        said = f"the model is too {'high' if mean > 0 else 'low'} by {amount(abs(mean), unit)} on average"
    for name, words in _OWN.get(samples.channel, ()):
        x = samples.at[name]
        if not np.isfinite(x).all() or not np.any(x):
            continue
        slope = float(x @ error / (x @ x))
        if slope**2 * float(x @ x) / total > best:
            best = slope**2 * float(x @ x) / total
            said = f"the error follows the {words}: {number(slope, 2)} {unit} a unit of it".replace("-", "−")
            if name == samples.channel:
                many = "much" if slope > 0 else "little"
                said = f"the error follows the {words} itself: the model gives {100 * abs(slope):.0f} % too {many}"
    return said
