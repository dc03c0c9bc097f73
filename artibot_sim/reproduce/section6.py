"""Section 6: Agri.q on two circles, Table 5 and Fig. 9."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from artibot_sim.model import Robot, load_robot
from artibot_sim.reproduce import section6_text as text
from artibot_sim.reproduce.circles import (
    CircleRun,
    circle_error,
    planned_circle,
    ramp_length,
    rotation_driven,
    torque_limited,
)
from artibot_sim.reproduce.paper import MEASURED, ODOMETRIC, TESTS
from artibot_sim.reproduce.result import Section

Array = NDArray[np.float64]

KAPPA = 1.0
"""The paper does not state the tests' kappa. It moves the rotation-driven radii by less than 1 %."""
DRIVEN_KAPPAS = (1.0, 0.8, 0.622)
LIMITS = (0.30, 0.80)
"""Torque limits that are tried, N m."""


@dataclass(frozen=True, eq=False)
class Driven:
    """Torque-limited motors: the limit fitted on Test 1, and both tests with it.

    Attributes
    ----------
    kappa, limit : share, and N m.
    test1, test2 : CircleRun
    tried : (n, 3) array
        Limit (N m), odometric radius and radius (m) of each trial on Test 1.
    """

    kappa: float
    limit: float
    test1: CircleRun
    test2: CircleRun
    tried: Array

    @property
    def off(self) -> float:
        """How far Test 1's odometric radius is from the paper's: magnitude of the logarithm."""
        return abs(math.log(self.test1.odometric_radius / TESTS["test1"].radius[ODOMETRIC]))


@dataclass(frozen=True, eq=False)
class Study:
    """All that section 6 needs.

    Attributes
    ----------
    smooth, jump : dict of test to CircleRun
        Driven by rotations that go over to the circle within `ENTRY`, or at once.
    driven : tuple of Driven
        One a kappa.
    angle : dict of test to float
        Where errors are compared, rad of the planned circle.
    gap : dict of test to Gap
    """

    robot: Robot
    smooth: dict[str, CircleRun]
    jump: dict[str, CircleRun]
    driven: tuple[Driven, ...]
    angle: dict[str, float]
    gap: dict[str, Gap]

    @property
    def best(self) -> Driven:
        """The driven motors, of those kappa, that come nearest to Test 1's odometric radius."""
        return min(self.driven, key=lambda d: d.off)


def section6(quick: bool = False, progress: Callable[[float], None] | None = None) -> Section:
    """Simulate both tests with the shipped geometry, driven by rotations and by torque-limited motors."""
    return text.written(study(load_robot("agriq"), quick, progress))


def study(robot: Robot, quick: bool = False, progress: Callable[[float], None] | None = None) -> Study:
    """Run all simulations of section 6."""
    tell = progress or (lambda _: None)
    smooth = {test: rotation_driven(robot, test, KAPPA) for test in TESTS}
    jump = {test: rotation_driven(robot, test, KAPPA, entry=0.0) for test in TESTS}
    tell(0.1)
    driven = []
    for i, kappa in enumerate(DRIVEN_KAPPAS):
        driven.append(fit_limit(robot, kappa, 0.04 if quick else 0.01))
        tell(0.1 + 0.9 * (i + 1) / len(DRIVEN_KAPPAS))
    angle = {test: arc_angle(test, robot) for test in TESTS}
    gap = {test: odometric_gap(test) for test in TESTS}
    return Study(robot, smooth, jump, tuple(driven), angle, gap)


def fit_limit(robot: Robot, kappa: float, step: float) -> Driven:
    """The torque limit that brings Test 1's odometric radius nearest to the paper's; Test 2 takes no part.

    A grid, refined twice: over the limit the radius jumps where the wheels break away.
    """
    wanted = TESTS["test1"].radius[ODOMETRIC]
    tried: list[tuple[float, float, float]] = []

    def scan(limits: Array) -> float:
        for limit in limits:
            run = torque_limited(robot, "test1", float(limit), kappa)
            tried.append((float(limit), run.odometric_radius, run.radius))
        return min(tried, key=lambda row: abs(math.log(row[1] / wanted)))[0]

    best = scan(np.arange(LIMITS[0], LIMITS[1] + 1e-9, step))
    best = scan(best + step * np.linspace(-0.9, 0.9, 7))
    best = scan(best + step * np.linspace(-0.25, 0.25, 5))
    runs = [torque_limited(robot, test, best, kappa) for test in ("test1", "test2")]
    return Driven(kappa, best, runs[0], runs[1], np.array(sorted(tried)))


def arc_angle(test: str, robot: Robot) -> float:
    """Planned angle (rad) after which the measured circle is off by the measured e_x: the first such.

    The paper states neither the circle's angle nor the straight's length (2 m here, as in Table 6); e_x depends on
    both. Only what was measured enters: R_e, e_gamma and e_x of Table 5.
    """
    planned = planned_circle(test, robot)
    angles = np.linspace(0.05, 3 * math.pi, 4000)
    found = circle_error(test, MEASURED, angles, float(planned.at(planned.marks[2].start).arc[0]))
    above = np.flatnonzero(found >= TESTS[test].e_x[MEASURED] / 100)
    return float(angles[above[0]])


@dataclass(frozen=True)
class Gap:
    """How near circles of the printed radii and e_gamma come to the printed e_x, odometric and measured.

    Attributes
    ----------
    rms : root mean square of both differences, points.
    odometric, measured : e_x there, percent.
    angle : of the planned circle, rad.
    straight : before it, m.
    """

    rms: float
    odometric: float
    measured: float
    angle: float
    straight: float


def odometric_gap(test: str) -> Gap:
    """Search the circle's angle (to 4 turns) and the straight before it (to 10 m) for both e_x of Table 5."""
    angles = np.linspace(0.05, 8 * math.pi, 1000)
    best = Gap(math.inf, math.nan, math.nan, math.nan, math.nan)
    for straight in np.linspace(0.0, 10.0, 21):
        before = ramp_length(test) + straight
        odometric, measured = (100 * circle_error(test, kind, angles, before) for kind in (ODOMETRIC, MEASURED))
        printed = TESTS[test].e_x
        rms = np.sqrt(((odometric - printed[ODOMETRIC]) ** 2 + (measured - printed[MEASURED]) ** 2) / 2)
        i = int(rms.argmin())
        if rms[i] < best.rms:
            best = Gap(float(rms[i]), float(odometric[i]), float(measured[i]), float(angles[i]), float(straight))
    return best
