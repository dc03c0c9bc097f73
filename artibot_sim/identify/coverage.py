"""How often intervals cover the truth: ``python -m artibot_sim.identify.coverage COUNT SEED [FILE]``.

Every trial draws a soil, a manoeuvre, a torque sharing and sensor noise, simulates a recording of 45 s with driven
physics (the back motors under torque), and identifies the soil from it with the robot file's soil as the prior.
With a FILE every trial becomes a line of it, and the next call goes on where the last one ended.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from artibot_sim.estimation.parameters import SOIL
from artibot_sim.identify.result import FitStatus
from artibot_sim.identify.run import identify
from artibot_sim.identify.synthetic import random_manoeuvre, random_soil, synthetic
from artibot_sim.model import load_robot

Array = NDArray[np.float64]

_DURATION = 45.0
"""s of a recording."""


@dataclass(frozen=True)
class CoverageTrial:
    """One identification of a known soil.

    Attributes
    ----------
    truth, value : array, shape (5,)
    low, high : array, shape (5,)
        Of the 95 % intervals.
    status : FitStatus
    seconds : float
    """

    truth: Array
    value: Array
    low: Array
    high: Array
    status: FitStatus
    seconds: float

    @property
    def covered(self) -> NDArray[np.bool_]:
        """Which intervals hold the truth, shape (5,)."""
        inside: NDArray[np.bool_] = (self.low <= self.truth) & (self.truth <= self.high)
        return inside

    def to_json(self) -> str:
        """One line."""
        plain = asdict(self) | {name: getattr(self, name).tolist() for name in ("truth", "value", "low", "high")}
        return json.dumps(plain | {"status": self.status.value})

    @classmethod
    def from_json(cls, line: str) -> CoverageTrial:
        """A trial from its line."""
        found = json.loads(line)
        arrays = {name: np.array(found[name]) for name in ("truth", "value", "low", "high")}
        return cls(**arrays, status=FitStatus(found["status"]), seconds=found["seconds"])


def trials(count: int, seed: int, first: int = 0) -> Iterator[CoverageTrial]:
    """Identifications of random soils by an Agri.q; trial k of a seed is always the same."""
    nominal = load_robot("agriq")
    for k in range(first, count):
        rng = np.random.default_rng([seed, k])
        real = random_soil(nominal, rng)
        drive = synthetic(
            real, random_manoeuvre(rng, _DURATION), duration=_DURATION, kappa=float(rng.uniform(0.65, 1.0)),
            seed=int(rng.integers(2**31)), start=(0.0, 0.0, float(rng.uniform(-np.pi, np.pi))), name=f"trial{k}",
        )  # fmt: skip
        began = time.process_time()
        result = identify([drive], nominal).result
        low, high = np.array([e.ci95 for e in result.estimates]).T
        yield CoverageTrial(
            real.as_vector([f"contact.{name}" for name in SOIL]), np.array([e.value for e in result.estimates]), low,
            high, result.status, time.process_time() - began,
        )  # fmt: skip


def main(argv: list[str]) -> int:
    """Run trials and say how many intervals cover."""
    count, seed = (int(text) for text in (argv + ["100", "0"][len(argv) :])[:2])
    kept = Path(argv[2]) if len(argv) > 2 else None
    lines = kept.read_text().splitlines() if kept and kept.exists() else []
    done = [CoverageTrial.from_json(line) for line in lines[:count]]
    for number, trial in enumerate(done, 1):
        print(_line(number, trial))
    for trial in trials(count, seed, first=len(done)):
        done.append(trial)
        print(_line(len(done), trial), flush=True)
        if kept:
            with kept.open("a") as file:
                file.write(trial.to_json() + "\n")
    covered = np.array([trial.covered for trial in done])
    each = ", ".join(f"{name} {100 * share:.0f} %" for name, share in zip(SOIL, covered.mean(axis=0), strict=True))
    print(f"{len(done)} recordings: {100 * covered.mean():.1f} % of the intervals cover the truth ({each})")
    off = 100.0 * np.median([trial.value / trial.truth - 1.0 for trial in done], axis=0)
    print("median errors: " + ", ".join(f"{name} {error:+.2f} %" for name, error in zip(SOIL, off, strict=True)))
    return 0


def _line(number: int, trial: CoverageTrial) -> str:
    error = 100.0 * (trial.value / trial.truth - 1.0)
    marks = "".join("+" if inside else "-" for inside in trial.covered)
    width = 50.0 * (trial.high - trial.low) / trial.truth
    cells = " ".join(f"{n} {e:+.2f}±{w:.2f} %" for n, e, w in zip(SOIL, error, width, strict=True))
    return f"{number:4d} {marks} {cells}  {trial.status.value}, {trial.seconds:.0f} s of CPU"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
