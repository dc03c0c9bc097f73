"""How far a simulation is from its recording, channel by channel (the contract's names)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from artibot_sim.experiment.columns import Floats
from artibot_sim.experiment.local_fit import noise_of

UNITS = {
    "position": "m",
    "yaw": "rad",
    "yaw_rate": "rad/s",
    "articulation_yaw": "rad",
    "front_velocity": "rad/s",
    "torque_front": "N·m",
    "torque_back": "N·m",
}
"""Channel → unit. Motor quantities are motor-side."""


@dataclass(frozen=True)
class Compared:
    """One channel, recorded and simulated at the same instants of one segment.

    Attributes
    ----------
    t : (n,) s.
    recorded, simulated : (n, k): coordinates of a point, or motors; simulated NaN where the model has no answer.
    """

    t: Floats
    recorded: Floats
    simulated: Floats


@dataclass(frozen=True)
class Metric:
    """Size of a channel's deviations.

    Attributes
    ----------
    unit : of all the others.
    rmse, median, p90 : of the absolute deviations (of positions: of the distance).
    noise : standard deviation of the recording's own noise, as `local_fit.noise_of` estimates it; of positions
        that of the distance. NaN if there are too few samples.
    count : how many deviations.
    """

    unit: str
    rmse: float
    median: float
    p90: float
    noise: float
    count: int

    def as_dict(self) -> dict[str, object]:
        """Return what metrics.json holds."""
        noise = self.noise if np.isfinite(self.noise) else None
        return {"unit": self.unit, "rmse": self.rmse, "median": self.median, "p90": self.p90, "noise": noise,
                "count": self.count}  # fmt: skip


def deviations(channel: str, part: Compared) -> Floats:
    """Return the absolute deviations of a part: (m,) of positions and angles, both motors' one after the other."""
    difference = part.simulated - part.recorded
    if channel == "yaw":
        difference = np.arctan2(np.sin(difference), np.cos(difference))
    if channel == "position":
        difference = np.hypot(difference[:, 0], difference[:, 1])
    size = np.abs(difference).ravel()
    return size[np.isfinite(size)]


def metrics_of(compared: Mapping[str, list[Compared]]) -> dict[str, Metric]:
    """Return the metrics of each channel over all its parts; a channel without a deviation is left out."""
    found = {}
    for channel, unit in UNITS.items():
        parts = compared.get(channel, [])
        size = np.concatenate([deviations(channel, part) for part in parts]) if parts else np.empty(0)
        if len(size):
            found[channel] = Metric(
                unit, float(np.sqrt(np.mean(size**2))), float(np.median(size)), float(np.quantile(size, 0.9)),
                _noise(channel, parts), len(size),
            )  # fmt: skip
    return found


def _noise(channel: str, parts: list[Compared]) -> float:
    """Return the noise's standard deviation, averaged in square over the parts by their lengths."""
    squares, weights = [], []
    for part in parts:
        columns = np.array([noise_of(part.t, column) for column in part.recorded.T]) ** 2
        squares.append(columns.sum() if channel == "position" else columns.mean())
        weights.append(len(part.t))
    known = np.isfinite(squares)
    if not known.any():
        return float("nan")
    return float(np.sqrt(np.average(np.array(squares)[known], weights=np.array(weights, float)[known])))
