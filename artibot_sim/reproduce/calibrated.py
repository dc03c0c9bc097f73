"""The geometries that ``artibot reproduce --calibrate`` found; running it again gives the same numbers."""

from __future__ import annotations

from typing import Final

from artibot_sim.reproduce.calibration import Calibration

CALIBRATIONS: Final = {
    "agriq": Calibration(
        robot="agriq",
        values={"i_x": 0.371, "i_y": 0.627, "l_b": 1.109},
        misfit=1.288,
        ranges={"i_x": (0.334, 0.375), "i_y": (0.570, 0.648), "l_b": (0.712, 1.297)},
        evaluations=780,
    ),
    "epiq": Calibration(
        robot="epiq",
        values={"i_x": 0.065, "i_y": 0.264, "l_f = l_b": 0.057},
        misfit=0.320,
        ranges={"i_x": (0.034, 0.084), "i_y": (0.176, 0.346), "l_f = l_b": (0.039, 0.104)},
        evaluations=780,
    ),
}
