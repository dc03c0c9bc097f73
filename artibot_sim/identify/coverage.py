"""How often intervals cover the truth: ``python -m artibot_sim.identify.coverage COUNT SEED``.

Every trial draws a soil, a manoeuvre, a torque sharing and sensor noise, simulates a recording of 45 s with driven
physics (the back motors under torque), and identifies the soil from it with the robot file's soil as the prior.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from artibot_sim.identify.identification import Status
from artibot_sim.identify.parameters import SOIL
from artibot_sim.identify.run import identify
from artibot_sim.identify.synthetic import random_manoeuvre, random_soil, synthetic
from artibot_sim.model import load_robot

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Trial:
    """One identification of a known soil.

    Attributes
    ----------
    truth, value : array, shape (5,)
    low, high : array, shape (5,)
        Of the 95 % intervals.
    status : Status
    seconds : float
    """

    truth: Array
    value: Array
    low: Array
    high: Array
    status: Status
    seconds: float

    @property
    def covered(self) -> NDArray[np.bool_]:
        """Which intervals hold the truth, shape (5,)."""
        inside: NDArray[np.bool_] = (self.low <= self.truth) & (self.truth <= self.high)
        return inside


def trials(count: int, seed: int, robot: str = "agriq", duration: float = 45.0, recordings: int = 1) -> Iterator[Trial]:
    """Identifications of random soils, each from so many recordings; trial k of a seed is always the same."""
    nominal = load_robot(robot)
    for k in range(count):
        rng = np.random.default_rng([seed, k])
        real = random_soil(nominal, rng)
        drives = [
            synthetic(
                real, random_manoeuvre(rng, duration), duration=duration, kappa=float(rng.uniform(0.65, 1.0)),
                seed=int(rng.integers(2**31)), start=(0.0, 0.0, float(rng.uniform(-np.pi, np.pi))),
                name=f"trial{k}_{i}",
            )
            for i in range(recordings)
        ]  # fmt: skip
        began = time.process_time()
        result = identify(drives, nominal).result
        low, high = np.array([e.ci95 for e in result.estimates]).T
        yield Trial(
            real.as_vector([f"contact.{name}" for name in SOIL]), np.array([e.value for e in result.estimates]), low,
            high, result.status, time.process_time() - began,
        )  # fmt: skip


def main(argv: list[str]) -> int:
    """Run trials and say how many intervals cover."""
    count, seed = (int(text) for text in (argv + ["100", "0"][len(argv) :])[:2])
    done: list[Trial] = []
    for trial in trials(count, seed):
        done.append(trial)
        error = 100.0 * (trial.value / trial.truth - 1.0)
        marks = "".join("+" if inside else "-" for inside in trial.covered)
        width = 50.0 * (trial.high - trial.low) / trial.truth
        cells = " ".join(f"{n} {e:+.2f}±{w:.2f} %" for n, e, w in zip(SOIL, error, width, strict=True))
        print(f"{len(done):4d} {marks} {cells}  {trial.status.value}, {trial.seconds:.0f} s of CPU", flush=True)
    covered = np.array([trial.covered for trial in done])
    each = ", ".join(f"{name} {100 * share:.0f} %" for name, share in zip(SOIL, covered.mean(axis=0), strict=True))
    print(f"{len(done)} recordings: {100 * covered.mean():.1f} % of the intervals cover the truth ({each})")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
