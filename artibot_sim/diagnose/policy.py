"""From which evidence on an effect is named: one place for all numbers that decide."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from artibot_sim.identify.run import Trust


@dataclass(frozen=True)
class Thresholds:
    """What it takes to be named.

    Attributes
    ----------
    floor, tail : float
        Nats that recordings with nothing hidden give to the best effect: its middle, and the mean excess over that.
        A false alarm in `false_alarm_rate` of such cases is then `floor` + `tail` · log(1 / rate). Both are on the safe
        side of what campaigns have shown (docs/diagnosis_method.md).
    biased : mapping of str to float
        The same beside `floor` for effects that what is left of the sensors' errors can look like: a campaign's
        recordings with nothing hidden gave back_friction 62 nats, noise of the rotations taken off.
    away : float
        Standard deviations from neutral.
    size : float
        Least coordinate: an effect a tenth as large as a plain one is none. Rotations that are smoothed leave some
        effects a few hundredths: recordings with nothing hidden give back_friction 0.05, dozens of standard
        deviations from neutral.
    tie : float
        Nats within which two effects tie.
    tie_share : float
        The same as a share of the gain, where motion was fitted: what the model still lacks may favour either.
    most : int
        Effects that are looked for one after the other.
    """

    floor: float = 30.0
    tail: float = 6.0
    biased: Mapping[str, float] = field(default_factory=lambda: {"back_friction": 120.0, "com_offset": 120.0})
    away: float = 4.0
    size: float = 0.1
    tie: float = 8.0
    tie_share: float = 0.03
    most: int = 3

    def more(self, effect: str) -> float:
        """Nats that an effect has to gain beyond `least`."""
        return max(0.0, self.biased.get(effect, self.floor) - self.floor)

    def least(self, prior_odds: float, false_alarm_rate: float) -> float:
        """Nats that an effect has to gain.

        Whoever believes less in an effect wants fewer false alarms in the same proportion: then as many of the names
        given are wrong.
        """
        return self.floor + self.tail * max(0.0, float(-np.log(false_alarm_rate * prior_odds)))


THRESHOLDS = Thresholds()
TRUST = Trust(level=1.6, thinning=4.0)
"""Of residuals to be noise while something may be missing in the model: as slow and large as a total station errs."""
