"""Forces that repeat over the ground: ridges, furrows, joints of a pavement. Their direction and period are unknown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.unlisted.forms import Form, amplitude, waves
from artibot_sim.diagnose.unlisted.search import Equations, ForceCandidate, InForce, judge, place, proven
from artibot_sim.diagnose.unlisted.variables import Scene

Array = NDArray[np.float64]

SHORTEST = 0.2
"""m: shorter periods pass under a wheel within a hat or two."""
LONGEST = 4.0
_PIXEL = 0.05
_PEAKS = 10
_STEPS = 8
_REACH = 0.05
"""Largest change of a period's logarithm once it is in the model."""


def ridges(equations: Equations, of: Scene, force: str, parts: Sequence[str]) -> ForceCandidate | None:
    """The best force that is a sine of the place along some direction, with some period; None if there is no room."""
    inside = InForce(equations, of, parts)
    x, y = (np.concatenate([place(a)[c] for a in inside.acting], axis=1).ravel() for c in (0, 1))
    extent = float(max(np.ptp(x), np.ptp(y)))
    if extent < 3.0 * SHORTEST:
        return None
    own = "own x" in of[parts[0]].follows
    found: list[ForceCandidate] = []
    for wave in _peaks(x, y, inside.left().ravel(), extent):
        found.append(_refined(equations, inside, force, wave, extent, own))
    if not found:
        return None
    best = max(found, key=lambda c: c.gain)
    sums = inside.sums(inside.basis(best.form))
    return replace(best, proven=proven(equations, sums, False))


def _peaks(x: Array, y: Array, asked: Array, extent: float) -> list[Array]:
    """Waves (rad/m along x and y) with which what the residuals ask for beats most, by a Fourier transform."""
    size = min(2 ** int(np.ceil(np.log2(2.0 * extent / _PIXEL + 2.0))), 2048)
    pixel = max(_PIXEL, 2.0 * extent / size)
    ground = np.zeros((size, size))
    i, j = (((values - values.min()) / pixel).round().astype(int) for values in (x, y))
    np.add.at(ground, (i, j), asked)
    power = np.abs(np.fft.fft2(ground)) ** 2
    k = 2.0 * np.pi * np.fft.fftfreq(size, pixel)
    number, longest = np.hypot(k[:, None], k[None, :]), min(LONGEST, extent / 2.0)
    power[(number > 2.0 * np.pi / SHORTEST) | (number < 2.0 * np.pi / longest)] = 0.0
    power[k < 0.0] = 0.0
    found: list[Array] = []
    reach = np.arange(-_resolved(k, extent), _resolved(k, extent) + 1)
    for _ in range(_PEAKS):
        a, b = np.unravel_index(int(np.argmax(power)), power.shape)
        if power[a, b] <= 0.0:
            break
        found.append(np.array([k[a], k[b]]))
        power[np.ix_((reach + a) % size, (reach + b) % size)] = 0.0
    return found


def _resolved(k: Array, extent: float) -> int:
    """Over how many cells a wave's peak is wide."""
    return int(np.ceil(2.0 * np.pi / extent / (k[1] - k[0])))


def _refined(
    equations: Equations, inside: InForce, force: str, wave: Array, extent: float, own: bool
) -> ForceCandidate:  # fmt: skip
    """The wave near this one that explains most."""

    def tried(at: Array) -> ForceCandidate:
        form = _form(at, own)
        return judge(equations, inside.sums(inside.basis(form)), form, force, inside.parts)

    step, best = np.pi / extent, tried(wave)
    for _ in range(_STEPS):
        moves = [wave + step * np.array(move) for move in ((1, 0), (-1, 0), (0, 1), (0, -1))]
        others = [tried(at) for at in moves]
        k = int(np.argmax([other.gain for other in others]))
        if others[k].gain > best.gain:
            wave, best = moves[k], others[k]
        else:
            step /= 2.0
    return best


def _form(wave: Array, own: bool) -> Form:
    period, named = 2.0 * np.pi / float(np.hypot(*wave)), "periodic in place with period {:.3g} m"
    along = float(np.degrees(np.arctan2(wave[1], wave[0])))
    return Form(
        f"{'each wheel’s own place' if own else 'place'} along {along:.0f}° in map",
        named.format(period), waves(1), amplitude, wave=(float(wave[0]), float(wave[1])), reach=_REACH, named=named,
    )  # fmt: skip
