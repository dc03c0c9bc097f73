"""Which parameters are to be fitted: those that somebody names, with what is known of them beforehand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from artibot_sim.documents import did_you_mean
from artibot_sim.errors import ArtibotError
from artibot_sim.estimation.parameters import INERTIAS, SOIL, Parameter, ParameterSet, Prior, sum_of_others
from artibot_sim.model import Robot
from artibot_sim.model.effects import EFFECTS

_SPREAD = {"contact": 0.4, "wheel.r_w": 0.05}
"""Standard deviation of the prior over its middle, by key or by section; a guess in a robot file is a wide prior."""
_MASS_SPREAD = 0.3
"""Standard deviation of the prior of a module's mass, over its middle."""
_GEOMETRY_SPREAD = 0.15
GROUPS = {
    "soil": SOIL,
    "geometry": (
        "wheel.r_w",
        "effects.wheel_radius_mismatch.relative",
        "effects.pose_lever_arm.x",
        "effects.pose_lever_arm.y",
        "effects.pose_heading_offset.angle",
    ),
    "resistance": ("effects.wheel_resistance.share",),
    "timing": ("effects.pose_delay.delay",),
}
"""Names that stand for several parameters. No data sheet has what this geometry says of one robot: how its tyres roll
under load, that those of its sides are never quite equal, and where on it the tracked body was mounted. The ground's
resistance to each wheel's motion over it is what eqs 15 and 16 lack most on real ground. How late poses are beside
rotations the model tells where the streams by themselves do not: wheels recorded at 1 to 3 Hz, windows of 2 s."""
_SIDES_SPREAD = 0.03
"""Standard deviation of the prior of `wheel_radius_mismatch`, whose middle is 0."""
_ARM_SPREAD = 0.25
"""Standard deviation of the prior of a lever arm, in track widths."""
_ANGLE_SPREAD = 0.05
"""Standard deviation of the prior of the angle at which a tracked body is mounted, rad."""
_RESISTED = Prior(0.2, 0.2)
"""Prior of the resistance, a share of the friction force: 0.01 to 0.2 were found on real ground."""
_LATE = Prior(0.1, 0.1)
"""Prior of a pose's delay, s: a localisation takes as long."""
_BEFOREHAND = ("assumed", "inferred", "datasheet", "stated")
"""Sources of numbers that no recording was asked for yet."""
_WIDEST = 5.0
"""Bounds lie this many prior deviations from the middle, in the logarithm."""


def parameter_set(robot: Robot, fit: Sequence[str] = SOIL, priors: Mapping[str, Prior] | None = None) -> ParameterSet:
    """The parameters named by `fit`.

    Parameters
    ----------
    robot : Robot
        Whose values are the priors' middles unless `priors` says otherwise.
    fit : sequence of str
        Names as in a robot file (``contact.k_l``, ``front.i_x``, ``effects.pose_lever_arm.x``), the soil's short
        ones (``k_l``), or those of `GROUPS`. An effect that the robot does not have begins at its prior's middle.
    priors : mapping of str to Prior, optional
        By the same names.

    Raises
    ------
    ArtibotError
        For an unknown name, one that stands twice, or a prior of nothing that is fitted.
    """
    fit = [one for name in fit for one in GROUPS.get(name.strip(), (name.strip(),))]
    usual = {name: prior for name, prior in _usual_priors(robot).items() if name in fit and not _has(robot, name)}
    priors = {**usual, **(priors or {})}
    robot = _with_effects(robot, fit, priors)
    found = (*robot.quantities(), *robot.effect_quantities())
    quantities = {key: (quantity, value) for key, quantity, value in found}
    keys = [_key(name, quantities) for name in fit]
    if not keys:
        raise ArtibotError("fit: nothing named; expected at least one parameter, such as k_l")
    for key in keys:
        if keys.count(key) > 1:
            raise ArtibotError(f"fit: {key} stands there twice; name each parameter once")
    known = {_key(name, quantities): prior for name, prior in priors.items()}
    for key in known:
        if key not in keys:
            raise ArtibotError(f"prior: {key} is not fitted; name it in --fit as well, or leave its prior out")
    parameters = []
    for key in keys:
        quantity, value = quantities[key]
        prior = known.get(key) or _prior(robot, key, value)
        signed = quantity.low < 0.0
        if not ((prior.value > 0 or signed) and np.isfinite(prior.value)):
            raise ArtibotError(
                f"prior: {key} has the middle {prior.value:g} {quantity.unit}; a fit needs one that is finite and "
                f"greater than 0, such as --prior {_short(key)}=1±0.3"
            )
        one = Parameter(key, _short(key), quantity.unit, prior, quantity.low, quantity.high, signed)
        low, high = max(one.at(-_WIDEST * one.spread), one.low), min(one.at(_WIDEST * one.spread), one.high)
        if key.endswith(INERTIAS):
            high = min(high, sum_of_others(robot, key))
        parameters.append(replace(one, low=low, high=high))
    return ParameterSet(robot, tuple(parameters))


def _usual_priors(robot: Robot) -> dict[str, Prior]:
    """Priors of those effects among `GROUPS` where nothing is known of one robot."""
    arm = _ARM_SPREAD * robot.front.i_y
    spreads = (_SIDES_SPREAD, arm, arm, _ANGLE_SPREAD)
    found = {name: Prior(0.0, spread) for name, spread in zip(GROUPS["geometry"][1:], spreads, strict=True)}
    return found | dict.fromkeys(GROUPS["resistance"], _RESISTED) | dict.fromkeys(GROUPS["timing"], _LATE)


def _has(robot: Robot, name: str) -> bool:
    """Whether an effect's parameter (``effects.id.parameter``) is at work in a robot."""
    _, effect, parameter = name.split(".")
    return bool(robot.effects.get(effect, {}).get(parameter))


def _with_effects(robot: Robot, fit: Sequence[str], priors: Mapping[str, Prior]) -> Robot:
    """The robot with the effects that are to be fitted."""
    effects = {name: dict(values) for name, values in robot.effects.items()}
    for name in fit:
        section, _, rest = name.strip().partition(".")
        effect, _, parameter = rest.partition(".")
        if section != "effects" or effect in robot.effects or effect not in EFFECTS:
            continue
        if parameter in EFFECTS[effect].parameters and name not in priors:
            raise ArtibotError(
                f"fit: {name}: robot '{robot.name}' has no such effect to begin with; say about how large it is, "
                f"such as --prior {name}=0.1±0.05"
            )
        effects.setdefault(effect, {})[parameter] = priors[name].value if name in priors else 0.0
    return replace(robot, effects=effects) if set(effects) != set(robot.effects) else robot


def parse_priors(texts: Sequence[str]) -> dict[str, Prior]:
    """Priors from ``NAME=MIDDLE±SD`` (or ``+-`` for ±), in SI units.

    Raises
    ------
    ArtibotError
        For anything else.
    """
    found: dict[str, Prior] = {}
    for text in texts:
        name, _, rest = text.partition("=")
        middle, _, sd = rest.replace("+-", "±").partition("±")
        try:
            prior = Prior(float(middle), float(sd))
        except ValueError:
            prior = Prior(np.nan, np.nan)
        if not (name and prior.sd > 0 and np.isfinite([prior.value, prior.sd]).all()):
            raise ArtibotError(f"prior: '{text}'; expected NAME=MIDDLE±SD in SI units, such as front.i_x=0.45±0.05")
        found[name.strip()] = prior
    return found


def _key(name: str, quantities: Mapping[str, object]) -> str:
    name = name.strip()
    full = f"contact.{name}" if "." not in name else name
    if full in quantities:
        return full
    effect = name.removeprefix("effects.").partition(".")[0]
    if name.startswith("effects.") and effect not in EFFECTS:
        raise ArtibotError(
            f"fit: '{name}': unknown effect{did_you_mean(effect, EFFECTS)}; `artibot effects list` has them all"
        )
    known = [*GROUPS, *map(_short, quantities)]
    close = did_you_mean(_short(name), known)
    raise ArtibotError(f"fit: '{name}' is no parameter of the robot{close}; expected one of {', '.join(known)}")


def _short(key: str) -> str:
    return key.removeprefix("contact.")


def _prior(robot: Robot, key: str, value: float) -> Prior:
    """What the robot file says of a number: by its interval, else by how well such numbers are known.

    An interval of what was identified is not taken: the same recordings would count twice.
    """
    low, high = robot.intervals.get(key, (0.0, 0.0))
    if 0.0 < low < value < high and robot.sources.get(key, "").startswith(_BEFOREHAND):
        return Prior(value, value * float(np.log(high / low)) / (2.0 * 1.96))
    return Prior(value, _spread(key) * abs(value))


def _spread(key: str) -> float:
    section, _, name = key.partition(".")
    return _MASS_SPREAD if name == "m" else _SPREAD.get(key, _SPREAD.get(section, _GEOMETRY_SPREAD))
