"""What the paper prints: every number that artibot is held against, with its place. Percentages as printed.

The paper is *Data Driven Analysis of Locomotion for a Class of Articulated Mobile Robots*.
"""

from __future__ import annotations

from typing import Final, NamedTuple


class Circle(NamedTuple):
    """One of section 6's tests: a circle at constant speed, Agri.q, the right wheels outside.

    Radii in m, speed in m/s, e_gamma and e_x (eqs 31, 32) in percent; the kinds are the columns and rows of Table 5.
    """

    speed: float
    radius: dict[str, float]
    e_gamma: dict[str, float]
    e_x: dict[str, float]


PLANNED, ODOMETRIC, MEASURED, SIMULATED = "planned", "odometric", "measured", "simulated"

TESTS: Final[dict[str, Circle]] = {
    "test1": Circle(
        speed=0.5,
        radius={PLANNED: 2.0, ODOMETRIC: 2.63, MEASURED: 3.34, SIMULATED: 3.34},
        e_gamma={ODOMETRIC: -24.76, MEASURED: -42.20, SIMULATED: -40.39},
        e_x={ODOMETRIC: 3.53, MEASURED: 24.02, SIMULATED: 24.30},
    ),
    "test2": Circle(
        speed=1.0,
        radius={PLANNED: 3.0, ODOMETRIC: 4.13, MEASURED: 5.53, SIMULATED: 5.12},
        e_gamma={ODOMETRIC: -30.81, MEASURED: -48.69, SIMULATED: -43.77},
        e_x={ODOMETRIC: 5.05, MEASURED: 16.45, SIMULATED: 14.33},
    ),
}
"""Radii: section 6, text after Table 5. Speeds: caption of Fig. 9. Errors: Table 5."""

NAMES: Final = {"test1": "Test 1", "test2": "Test 2"}

TEST_A_MAX: Final = 0.5
"""Largest acceleration of the tests' ramp, m/s²: section 6, list of the steps of a test."""

KAPPAS: Final = (0.6, 0.8, 1.0)
"""Division parameters of section 7."""


class Trajectory(NamedTuple):
    """A column of Table 6."""

    R: float
    s: float
    v_c: float
    a_max: float


TABLE_6: Final = {"epiq": Trajectory(0.5, 0.5, 0.5, 0.25), "agriq": Trajectory(2.0, 2.0, 1.0, 0.5)}
"""Radius (m), straight (m), cruise speed (m/s), largest acceleration (m/s²)."""

TABLE_7: Final[dict[str, dict[float, tuple[float, float]]]] = {
    "epiq": {0.6: (1.98, 1.79), 0.8: (2.13, 2.20), 1.0: (2.52, 2.75)},
    "agriq": {0.6: (4.36, 5.63), 0.8: (4.52, 6.83), 1.0: (5.10, 6.45)},
}
"""Robot → kappa → (magnitude of e_gamma, e_x), percent. Table 7 prints e_gamma without a sign."""

LENGTH: Final = {"epiq": 0.30, "agriq": 2.0}
"""How long the robots are, m: section 1 ("about 5 kg and 30 cm length", "100 kg and is 2 m long")."""

KAPPA_MIN: Final = 0.622
"""Least kappa for Agri.q's equal motors, 1 / (1 + tau_f / tau_b): section 6, text after eq. 30 (rounded to 0.62)."""

ROBOTS: Final = {"agriq": "Agri.q", "epiq": "Epi.q"}
"""Name of the robot file → name in the paper."""
