"""A drive with turns to either side, for the tests that look into single parts of a diagnosis."""

from __future__ import annotations

import numpy as np

from artibot_sim.estimation.loss import Loss
from artibot_sim.estimation.windows import CHANNEL_NAMES
from artibot_sim.planning import Arc, Dwell, Manoeuvre, Ramp, Slalom, Stop

TURNS = Manoeuvre(
    "turns",
    (Dwell(0.5), Ramp(speed=0.6), Slalom(curvature=0.45, wavelength=5.0, periods=1.5), Arc(radius=1.6, angle=-2.0),
     Stop()),
    a_max=0.5, blend=0.3,
)  # fmt: skip
EVEN = Loss(1.0, np.ones(len(CHANNEL_NAMES)))
"""Every sample counts in full."""
