"""What the paper prints: every number that artibot is held against, with its place. Percentages as printed.

The paper is *Data Driven Analysis of Locomotion for a Class of Articulated Mobile Robots*.
"""

from __future__ import annotations

from typing import Final, NamedTuple


class CircleTest(NamedTuple):
    """One of section 6's tests: a circle at constant speed, Agri.q, the right wheels outside.

    Radii in m, speed in m/s, e_gamma and e_x (eqs 31, 32) in percent; the kinds are the columns and rows of Table 5.
    """

    speed: float
    radius: dict[str, float]
    e_gamma: dict[str, float]
    e_x: dict[str, float]


PLANNED, ODOMETRIC, MEASURED, SIMULATED = "planned", "odometric", "measured", "simulated"

TESTS: Final[dict[str, CircleTest]] = {
    "test1": CircleTest(
        speed=0.5,
        radius={PLANNED: 2.0, ODOMETRIC: 2.63, MEASURED: 3.34, SIMULATED: 3.34},
        e_gamma={ODOMETRIC: -24.76, MEASURED: -42.20, SIMULATED: -40.39},
        e_x={ODOMETRIC: 3.53, MEASURED: 24.02, SIMULATED: 24.30},
    ),
    "test2": CircleTest(
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


class PrintedTables(NamedTuple):
    """What Tables 2 to 4 print of a robot: keys of its robot file and printed values."""

    table2: dict[str, float]
    table3: dict[str, float]
    table4: dict[str, float]


INPUTS: Final = {
    "epiq": PrintedTables(
        table2={
            "front.m*": 1.98, "back.m*": 1.98,
            "front.J_x": 0.7e-2, "front.J_y": 1.7e-2, "front.J_z": 0.2e-2,
            "back.J_x": 0.7e-2, "back.J_y": 1.7e-2, "back.J_z": 0.2e-2,
            "wheel.J_wx": 2.94e-4, "wheel.J_wy": 0.72e-4,
        },
        table3={
            "drive.front.tau": 1 / 205.0, "drive.back.tau": 1 / 205.0,
            "drive.front.eta_d": 0.81, "drive.back.eta_d": 0.81, "drive.front.eta_r": 0.77, "drive.back.eta_r": 0.77,
        },
        table4={
            "contact.k_l": 200.0, "contact.k_t": 120.0, "contact.k_n": 11e3,
            "contact.mu_s": 0.90, "contact.mu_d": 0.60, "contact.u_w": 8.00e-4,
        },
    ),
    "agriq": PrintedTables(
        table2={
            "front.m*": 59.0, "back.m*": 28.0,
            "front.J_x": 5.729, "front.J_y": 5.729, "front.J_z": 9.167,
            "back.J_x": 2.604, "back.J_y": 2.604, "back.J_z": 4.167,
            "wheel.J_wx": 0.155, "wheel.J_wy": 0.038,
        },
        table3={
            "drive.front.tau": 1 / 47.64, "drive.back.tau": 1 / 28.93,
            "drive.front.eta_d": 0.60, "drive.back.eta_d": 0.60, "drive.front.eta_r": 0.35, "drive.back.eta_r": 0.35,
        },
        table4={
            "contact.k_l": 2939.81, "contact.k_t": 2039.05, "contact.k_n": 15e3,
            "contact.mu_s": 0.63, "contact.mu_d": 0.30, "contact.u_w": 8.32e-3,
        },
    ),
}  # fmt: skip
"""Tables 2 to 4. ``m*`` is eq. 9's mass, of a module with its four wheels; k_t is printed as k_r."""

LENGTH: Final = {"epiq": 0.30, "agriq": 2.0}
"""How long the robots are, m: section 1 ("about 5 kg and 30 cm length", "100 kg and is 2 m long")."""

MASS: Final = {"epiq": 5.0, "agriq": 100.0}
"""What they weigh, kg: the same sentences."""

KAPPA_MIN: Final = 0.622
"""Least kappa for Agri.q's equal motors, 1 / (1 + tau_f / tau_b): section 6, text after eq. 30 (rounded to 0.62)."""

ROBOTS: Final = {"agriq": "Agri.q", "epiq": "Epi.q"}
"""Name of the robot file → name in the paper."""
