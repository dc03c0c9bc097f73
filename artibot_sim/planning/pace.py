"""Progress as a function of time: constant rates and the paper's cubic ramps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from artibot_sim.planning.quadrature import Array


@dataclass(frozen=True)
class Pace:
    """A rate of progress that changes from `start` to `end` over `duration` (s) by ``3 u² - 2 u³``.

    Its largest acceleration, 1.5 |end - start| / duration, is reached half way; with equal ends it is a constant.
    Rates are in the progress's unit per second and never negative: progress does not go back.
    """

    start: float
    end: float
    duration: float

    @property
    def length(self) -> float:
        """Progress over the whole duration."""
        return 0.5 * (self.start + self.end) * self.duration


def ramp(start: float, end: float, a_max: float) -> Pace:
    """The cubic ramp from rate `start` to `end` whose largest acceleration is `a_max`."""
    return Pace(start, end, 1.5 * abs(end - start) / a_max)


def rest_to_rest(length: float, peak: float, a_max: float) -> list[Pace]:
    """Paces from rest to rest over `length`, with `peak` the largest rate where there is room for it."""
    peak = min(peak, math.sqrt(length * a_max / 1.5))
    up, down = ramp(0.0, peak, a_max), ramp(peak, 0.0, a_max)
    cruise = (length - up.length - down.length) / peak
    return [up, Pace(peak, peak, cruise), down] if cruise > 1e-9 else [up, down]


def sample(paces: Sequence[Pace], index: NDArray[np.intp], local: Array) -> tuple[Array, Array]:
    """Progress since its start and rate of ``paces[index]`` at the times `local` after its start, all (n,)."""
    start, end, duration = np.array([(pace.start, pace.end, pace.duration) for pace in paces])[index].T
    u = local / duration
    progress = start * local + (end - start) * duration * (1.0 - 0.5 * u) * u**3
    return progress, start + (end - start) * (3.0 - 2.0 * u) * u * u
