"""Forms in which a force may follow a variable: basis functions, and words for what was found."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.unlisted.variables import PLACE
from artibot_sim.diagnose.words import NOTHING
from artibot_sim.model.effects.force_law import FORMS, shapes

Array = NDArray[np.float64]
Curve = Callable[[Array, NDArray[np.int64]], Array]
"""From a variable (windows, k) and the numbers of the recordings (windows,) to basis functions (windows, k, b)."""

UNITS = {
    "speed": "m/s", "lateral speed": "m/s", "own speed": "m/s", "own lateral speed": "m/s", "own slip": "m/s",
    "yaw rate": "rad/s", "articulation rate": "rad/s", "articulation angle": "rad", "curvature": "1/m",
}  # fmt: skip
"""Variables with a sign and a neutral value, and their units."""
_PER = {"m/s": ("s/m", "s^2/m^2"), "rad/s": ("s/rad", "s^2/rad^2"), "rad": ("1/rad", "1/rad^2"), "1/m": ("m", "m^2")}
TIME = "time since the start"
WANDERING = "wandering in time"
"""A form that says nothing of another day."""
_KNOTS = 2.5
"""s between the corners of a force that wanders in time."""
_PER_PERIOD, _WAVES = 4, 60
"""Waves in time that are tried from one more period in a recording to the next, and of them all."""
_FADES = (4.0, 8.0, 16.0, 32.0)
"""s in which a drag falls to a third."""
_SHARP = 0.08
"""Share of a variable's usual size over which a Coulomb-like force changes its sign."""
_BEGINS = (0.3, 0.5, 0.7)
"""Shares of a variable's usual size from which a force may begin."""
_WITHIN = (0.15, 0.5)
"""Shares of the largest angle within which a drag falls to a third."""
_FADES_REACH, _BEGINS_REACH = 0.5, 0.4
"""Largest change of a scale's logarithm once a law is in the model: beyond it is the next one of these."""
_AXES, _EDGES, _EDGE = 8, 8, 0.1
"""Directions in which the ground may change at a line, places along each where that may be, and how wide it is, m."""
_RATES = ("speed", "own speed", "yaw rate", "articulation rate")
"""Variables whose sign friction and damping follow, and from which on a force may begin. Slip and lateral speeds are
none of them: wheels let go at some of these, and a fit that is wrong about when looks just so."""
_LEVELS = ("speed", "own speed", "yaw rate", "articulation angle", "lateral speed")
"""Variables whose size may set how strong that is."""


@dataclass(frozen=True)
class Form:
    """One form in one variable.

    Attributes
    ----------
    variable, name : str
    curve : callable
    size : callable
        From the coefficients (b,) to the size that is reported.
    per : str
        What the force's unit is multiplied with in the size's unit.
    across : bool
        Whether it is to be found again in other recordings at the same value of the variable, or within each.
    wave : (float, float), optional
        Of a force that repeats over the ground: 2π/period along x and y of `map`, rad/m; `curve` takes the phase.
    scale : float
        What the variable is divided by first, in its unit.
    law : str
        The form's name in the model (`effects.force_law`); empty where that has no such term.
    times, times_law : str
        A second variable with the form that the first one's is multiplied by; empty where there is none. Then `curve`
        takes both, shape (windows, k, 2).
    times_scale : float
        What the second variable is divided by first, in its unit.
    reach : float
        By how much the logarithm of `times_scale`, where there are two variables, else of `scale` may change once the
        law is in the model; 0 where it is as it is. Of an edge by how far that may move, m.
    edge : (float, float), optional
        Of a force that acts on one side of a line: the direction in `map` (rad) across it, and where it is along that
        (m). The second variable is the place then.
    named : str
        The name with a field for the number that is fitted with the law; empty where none is.
    between : bool
        Of a wave in time whether fits of the next longer and the next shorter one reach it.
    """

    variable: str
    name: str
    curve: Curve
    size: Callable[[Array], float]
    per: str = ""
    across: bool = False
    wave: tuple[float, float] | None = None
    scale: float = 1.0
    law: str = ""
    times: str = ""
    times_law: str = ""
    times_scale: float = 1.0
    reach: float = 0.0
    edge: tuple[float, float] | None = None
    named: str = ""
    between: bool = False

    def name_at(self, fitted: float) -> str:
        """The name once the number that is fitted with the law has this value."""
        return self.named.format(fitted) if self.named else self.name


def amplitude(coefficients: Array) -> float:
    """Of a sum of sines and cosines, those of several recordings one after the other: the mean amplitude."""
    return float(np.sqrt((coefficients.reshape(-1, 2) ** 2).sum(axis=1)).mean())


def _first(coefficients: Array) -> float:
    return float(coefficients[0])


def rms(coefficients: Array) -> float:
    """Of values at corners."""
    return float(np.sqrt(np.mean(coefficients**2)))


def forms(variable: str, every: Array, recordings: int, sharp: float = 0.0) -> Iterator[Form]:
    """All forms in a variable that takes these values.

    Parameters
    ----------
    every : array
        Its values, to know its usual size.
    recordings : int
        How many there are.
    sharp : float
        Over which a Coulomb-like force of it changes its sign, where that is known.
    """
    usual = float(np.quantile(np.abs(every), 0.9))
    if variable == NOTHING:
        yield Form(variable, "constant", lambda u, r: np.ones((*u.shape, 1)), _first, law="constant")
    elif variable in UNITS and usual > 1e-6:
        yield from _signed(variable, usual, sharp or _SHARP * usual)
    elif "wheel angle" in variable or variable == "own angle":
        for count, name in ((1, "once a turn"), (2, "twice a turn")):
            yield Form(variable, f"periodic, {name}", waves(count), amplitude)
        if recordings > 1:
            yield Form(variable, "periodic, once a turn", _own_phase(recordings), amplitude)
    elif variable == "heading":
        yield Form(variable, "periodic, once a turn", waves(1), amplitude)
    elif variable == PLACE:
        yield Form(variable, "towards a point, growing with the distance", lambda u, r: -u, _first, "1/m")
    elif variable == TIME:
        at = (every - every.min()) / _KNOTS
        # only those that something is measured near: windows may be minutes apart
        corners = every.min() + _KNOTS * np.unique([np.floor(at), np.ceil(at)])
        yield Form(variable, WANDERING, lambda u, r: _linear_between(u, corners), rms, across=recordings > 1)
        yield from _in_time(variable, float(np.ptp(every)), recordings)


def _in_time(variable: str, longest: float, recordings: int) -> Iterator[Form]:
    """Waves in time from half a period in the longest recording on, so close that some one is hardly out of phase."""
    for count in range(_PER_PERIOD // 2, _WAVES if longest > 0.0 else 0):
        period = _PER_PERIOD * longest / count
        named = "periodic in time with period {:.3g} s"
        curve = waves(2.0 * np.pi / period)
        # the longest one stays: longer ones would be any trend
        reach = float(np.log(count / (count - 1.0))) if count > _PER_PERIOD // 2 else 0.0
        yield Form(
            variable, named.format(period), curve, amplitude, across=recordings > 1, scale=period, law="periodic",
            reach=reach, named=named, between=count % 2 == 1,
        )  # fmt: skip


def _signed(variable: str, usual: float, sharp: float) -> Iterator[Form]:
    linear, square = _PER[UNITS[variable]]
    for name, law, scale, per in (
        ("linear", "linear", 1.0, linear), ("quadratic", "quadratic", 1.0, square),
        ("Coulomb-like", "coulomb", sharp, ""), ("linear in its size", "magnitude", 1.0, linear),
    ):  # fmt: skip
        yield Form(variable, name, _of_one(law, scale), _first, per, scale=scale, law=law)
    if variable in _RATES:
        for share in _BEGINS:
            begins = share * usual
            named = f"nothing up to {{:.2g}} {UNITS[variable]}, then linear"
            curve = _of_one("threshold", begins)
            yield Form(
                variable, named.format(begins), curve, _first, scale=begins, law="threshold", reach=_BEGINS_REACH,
                named=named,
            )  # fmt: skip


def products(variable: str, every: Array, times: str, second: Array, sharp: float = 0.0) -> Iterator[Form]:
    """Forms that follow one variable's sign, as friction and damping do, times a second one's size.

    Parameters
    ----------
    every, second : array
        Values of both, to know their usual sizes.
    sharp : float
        As in `forms`.
    """
    turned = times.startswith("wheel angle")
    if variable not in _RATES or not (turned or times in (TIME, *_LEVELS)) or _bare(variable) == _bare(times):
        return
    usual, size = (float(np.quantile(np.abs(one), 0.9)) for one in (every, second))
    if min(usual, size) <= 1e-6:
        return
    coulomb = "Coulomb-like", "coulomb", sharp or _SHARP * usual
    if times == TIME:
        yield _product(variable, coulomb, times, ("time since the start", "linear", 1.0), "1/s")
        for fades in _FADES:
            yield _product(variable, coulomb, times, ("what fades within {:.3g} s", "decaying", fades))
    elif turned:
        for fades in (share * size for share in _WITHIN):
            yield _product(variable, coulomb, times, ("what fades within {:.3g} rad", "decaying", fades))
    else:
        per = _PER[UNITS[times]][0]
        for first, more in ((coulomb, ""), (("linear", "linear", 1.0), _PER[UNITS[variable]][0])):
            yield _product(variable, first, times, (f"the size of {times}", "magnitude", 1.0), f"{per} {more}".strip())


def edges(variable: str, every: Array, x: Array, y: Array) -> Iterator[Form]:
    """Friction, by a variable's sign, on one side of a line across `map`.

    Parameters
    ----------
    every, x, y : array
        Values of the variable and of the place, m, to know their usual sizes.
    """
    usual = float(np.quantile(np.abs(every), 0.9))
    if variable not in _RATES or usual <= 1e-6:
        return
    coulomb = "Coulomb-like", "coulomb", _SHARP * usual
    for direction in 2.0 * np.pi / _AXES * np.arange(_AXES):
        along = x * np.cos(direction) + y * np.sin(direction)
        places = np.quantile(along, np.arange(1, _EDGES + 1) / (_EDGES + 1)).tolist()
        apart = float(np.ptp(along)) / _EDGES
        for place in places if apart > 2.0 * _EDGE else ():
            words = f"place beyond {{:.3g}} m along {np.degrees(direction):.0f}° in map"
            form = _product(variable, coulomb, PLACE, (words, "step", _EDGE))
            yield replace(form, name=form.named.format(place), reach=apart, edge=(float(direction), place))


def _product(
    variable: str, first: tuple[str, str, float], times: str, second: tuple[str, str, float], per: str = ""
) -> Form:  # fmt: skip
    """A form from words, name in the model and scale of each factor; a field in the words is for the second's scale."""
    (name, law, scale), (words, times_law, times_scale) = first, second
    one, other, named = _of_one(law, scale), _of_one(times_law, times_scale), f"{name}, times {words}"
    return Form(
        variable, named.format(times_scale), lambda u, r: one(u[..., 0], r) * other(u[..., 1], r), _first, per,
        scale=scale, law=law, times=times, times_law=times_law, times_scale=times_scale,
        reach=_FADES_REACH if times_law == "decaying" else 0.0, named=named if "{" in words else "",
    )  # fmt: skip


def _bare(variable: str) -> str:
    return variable.removeprefix("own ")


def _of_one(law: str, scale: float) -> Curve:
    """A form of the model with one coefficient."""
    form = list(FORMS).index(law)

    def curve(u: Array, r: NDArray[np.int64]) -> Array:
        out = np.empty(u.size)
        shapes(form, np.ravel(u) / scale, out)
        return out.reshape(*u.shape, 1)

    return curve


def waves(count: float) -> Curve:
    """cos and sin of so many times an angle, or of so many radians a second."""
    return lambda u, r: np.stack([np.cos(count * u), np.sin(count * u)], axis=-1)


def _own_phase(recordings: int) -> Curve:
    """Once a turn from an origin that each recording has for itself: encoders begin anywhere."""

    def curve(u: Array, r: NDArray[np.int64]) -> Array:
        table = np.zeros((*u.shape, recordings, 2))
        mine = np.arange(len(u))
        table[mine, :, r] = np.stack([np.cos(u), np.sin(u)], axis=-1)
        return table.reshape(*u.shape, 2 * recordings)

    return curve


def _linear_between(u: Array, corners: Array) -> Array:
    return np.maximum(1.0 - np.abs(u[..., None] - corners) / _KNOTS, 0.0)


def unit(force: str, per: str = "") -> str:
    """Of a force by its name, and of its coefficient."""
    own = "N m" if "moment" in force or "torque" in force else "N"
    return own + per.removeprefix("1") if per.startswith("1/") else f"{own} {per}".strip()
