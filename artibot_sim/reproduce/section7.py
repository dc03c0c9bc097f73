"""Section 7: both robots on Table 6's trajectory for three kappa, Table 7 and Fig. 10."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from artibot_sim.model import Robot, load_robot
from artibot_sim.planning import load_manoeuvre
from artibot_sim.reproduce import section7_text as text
from artibot_sim.reproduce.calibrated import CALIBRATIONS
from artibot_sim.reproduce.calibration import Calibration
from artibot_sim.reproduce.paper import KAPPAS, ROBOTS
from artibot_sim.reproduce.result import Section
from artibot_sim.reproduce.runs import Run, drive, sliding
from artibot_sim.reproduce.suspects import tried

Array = NDArray[np.float64]

SHIPPED, BEST = "shipped", "best fit"
"""Names of the two geometries: that of the robot file, and that of the calibration."""


@dataclass(frozen=True, eq=False)
class Sweep:
    """Figures of merit over a length.

    Attributes
    ----------
    x : (n,) array
    e_gamma, e_x : dict of kappa to (n,) array
        Fractions.
    front_axle : dict of kappa to (n,) array
        Mean number of the four front module's wheels that slide during the turns.
    """

    x: Array
    e_gamma: dict[float, Array]
    e_x: dict[float, Array]
    front_axle: dict[float, Array]


@dataclass(frozen=True, eq=False)
class Study:
    """All that section 7 needs.

    Attributes
    ----------
    runs : dict of (robot, geometry) to dict of kappa to Run
    calibrations : dict of robot to Calibration
    length : dict of geometry to Sweep
        Epi.q over l_f = l_b, m, with that geometry's wheel spacings.
    branches : Sweep
        Agri.q over i_x / i_y, i_y kept.
    suspects : dict of str to (3, 3) array
        See `suspects.tried`.
    """

    runs: dict[tuple[str, str], dict[float, Run]]
    calibrations: Mapping[str, Calibration]
    length: dict[str, Sweep]
    branches: Sweep
    suspects: dict[str, Array]


def section7(
    quick: bool = False,
    progress: Callable[[float], None] | None = None,
    calibrations: Mapping[str, Calibration] = CALIBRATIONS,
) -> Section:
    """Simulate Table 6 with the shipped geometry and the best-fit one, and what explains the differences."""
    return text.written(study(quick, progress, calibrations))


def study(
    quick: bool = False,
    progress: Callable[[float], None] | None = None,
    calibrations: Mapping[str, Calibration] = CALIBRATIONS,
) -> Study:
    """Run all simulations of section 7."""
    tell = progress or (lambda _: None)
    runs = {}
    for i, name in enumerate(ROBOTS):
        manoeuvre = load_manoeuvre(f"table6_{name}")
        for geometry, robot in ((SHIPPED, load_robot(name)), (BEST, calibrations[name].apply())):
            runs[name, geometry] = {kappa: drive(robot, manoeuvre, kappa) for kappa in KAPPAS}
        tell(0.1 * (i + 1))
    lengths, length = np.linspace(0.03, 0.22, 9 if quick else 39), {}
    for i, geometry in enumerate((SHIPPED, BEST)):
        epiq = runs["epiq", geometry][KAPPAS[0]].robot
        length[geometry] = sweep(epiq, "epiq", lengths, ("front.l", "back.l"), _span(tell, 0.2 + 0.2 * i, 0.2))
    agriq = load_robot("agriq")
    ratios = np.linspace(0.45, 1.0, 9 if quick else 34)
    spacing = ratios * agriq.front.i_y
    branches = sweep(agriq, "agriq", spacing, ("front.i_x", "back.i_x"), _span(tell, 0.6, 0.4))
    branches = Sweep(ratios, branches.e_gamma, branches.e_x, branches.front_axle)
    return Study(runs, calibrations, length, branches, tried())


def _span(tell: Callable[[float], None], start: float, length: float) -> Callable[[float], None]:
    """Report a part's share of being done as one of the whole."""
    return lambda share: tell(start + length * share)


def sweep(
    robot: Robot, name: str, values: Array, keys: tuple[str, ...], progress: Callable[[float], None]
) -> Sweep:  # fmt: skip
    """Drive Table 6 with each of the values (m) in place of the robot's."""
    manoeuvre = load_manoeuvre(f"table6_{name}")
    found = np.empty((3, len(KAPPAS), len(values)))
    for i, value in enumerate(values):
        changed = robot.replace(dict.fromkeys(keys, float(value)))
        for k, kappa in enumerate(KAPPAS):
            run = drive(changed, manoeuvre, kappa)
            slides = sliding(run.result, "front")[run.during(2, 3)].mean()
            found[:, k, i] = run.e_gamma, run.e_x, slides
        progress((i + 1) / len(values))
    e_gamma, e_x, axle = (dict(zip(KAPPAS, rows, strict=True)) for rows in found)
    return Sweep(np.asarray(values), e_gamma, e_x, axle)
