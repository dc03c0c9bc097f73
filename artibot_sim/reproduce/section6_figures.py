"""Section 6's figures: Fig. 9, and what explains the differences."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from artibot_sim.planning import FrontKinematics
from artibot_sim.report.panels import Panel
from artibot_sim.reproduce import charts
from artibot_sim.reproduce.circles import CircleRun, circle_error, ideal_circle
from artibot_sim.reproduce.paper import MEASURED, NAMES, ODOMETRIC, PLANNED, TESTS
from artibot_sim.reproduce.result import Sheet

if TYPE_CHECKING:
    from artibot_sim.reproduce.section6 import Study

SHOWN = 1.5 * math.pi
"""Arc that is drawn, rad."""


def sheets(study: Study) -> tuple[Sheet, ...]:
    """All pictures of the section."""
    return _fig9(study), _angle_sheet(study), _limit_sheet(study)


def odometric_path(run: CircleRun) -> np.ndarray:
    """x, y, yaw (n, 3) that the front wheels' rotations stand for without slip."""
    forward, yaw = FrontKinematics.of(run.robot).forward(run.result.motor_position[:, :2])
    step, middle = np.diff(forward), 0.5 * (yaw[1:] + yaw[:-1])
    x, y = np.cumsum(step * np.cos(middle)), np.cumsum(step * np.sin(middle))
    return np.column_stack([np.append(0.0, x), np.append(0.0, y), yaw])


def _fig9(study: Study) -> Sheet:
    rows = []
    for test in TESTS:
        driven = study.best.test1 if test == "test1" else study.best.test2
        rows.append((_path(study, test, driven), _speeds(study, test, driven), _torques(study, test, driven)))
    caption = (
        "Paths, front motor speeds and torques. Blue: driven by rotations at the paper's odometric radius, as in "
        f"section 6. Green: driven motors within ±{study.best.limit:.3f} N·m, fitted on Test 1's odometric radius, "
        f"with κ = {study.best.kappa:g}. "
        "The measured path is a circle of the printed radius and e_γ; the recordings are not published."
    )
    return Sheet("fig9", "Fig. 9: Agri.q on the circles of section 6", caption, tuple(rows))


def _path(study: Study, test: str, driven: CircleRun) -> Panel:
    run = study.smooth[test]
    rows, far = run.until(SHOWN), driven.until(SHOWN)
    odometric = odometric_path(run)
    begin = run.planned.pose[int(np.searchsorted(run.result.t, run.arc_start)), 0]
    printed = TESTS[test]
    angles = np.linspace(0.0, SHOWN, 200)
    measured = ideal_circle(printed.radius[MEASURED], printed.e_gamma[MEASURED] / 100, angles)
    lines = [
        charts.curve("planned", run.planned.pose[rows, 0], run.planned.pose[rows, 1], charts.PLANNED),
        charts.curve("odometric", odometric[rows, 0], odometric[rows, 1], charts.ODOMETRIC),
        charts.curve("measured (circle)", begin + measured[:, 0], measured[:, 1], charts.MEASURED),
        charts.curve("simulated", run.result.pose[rows, 0], run.result.pose[rows, 1], charts.SIMULATED),
        charts.curve("driven motors", driven.result.pose[far, 0], driven.result.pose[far, 1], charts.DRIVEN),
    ]
    title = f"{NAMES[test]}: {printed.speed:g} m/s, R = {printed.radius[PLANNED]:g} m"
    return charts.panel(f"path_{test}", title, ("x", "m"), ("y", "m"), lines)


def _speeds(study: Study, test: str, driven: CircleRun) -> Panel:
    run = study.smooth[test]
    rows = run.until(SHOWN)
    t = _twice(run.result.t[rows])
    lines = [
        charts.curve("planned", t, _both(run.planned.velocity[rows]), charts.PLANNED),
        charts.curve("by rotations", t, _both(run.result.motor_velocity[rows]), charts.SIMULATED),
        charts.curve("driven motors", t, _both(driven.result.motor_velocity[rows]), charts.DRIVEN),
    ]
    title = "Front motor speeds: right above, left below"
    return charts.panel(f"speed_{test}", title, charts.TIME, ("motor speed", "rad/s"), lines)


def _twice(t: np.ndarray) -> np.ndarray:
    """The times of `_both`."""
    return np.concatenate([t, [np.nan], t])


def _both(values: np.ndarray) -> np.ndarray:
    """Right and left motor (n, 2) one after the other, with a gap."""
    return np.concatenate([values[:, 0], [np.nan], values[:, 1]])


def _torques(study: Study, test: str, driven: CircleRun) -> Panel:
    run = study.smooth[test]
    rows = run.until(SHOWN)
    t = _twice(run.result.t[rows])
    lines = [
        charts.curve("by rotations", t, _both(run.result.motor_torque[rows]), charts.SIMULATED),
        charts.curve("driven motors", t, _both(driven.result.motor_torque[rows]), charts.DRIVEN),
    ]
    cut, _ = charts.without_peaks(lines, 1.3)
    levels = [charts.level("limit of driven", study.best.limit)]
    title = "Front motor torques: right above, left below"
    return charts.panel(f"torque_{test}", title, charts.TIME, ("torque", "N·m"), cut, levels)


def _angle_sheet(study: Study) -> Sheet:
    """e_x over the angle at which the test ends, which the paper does not state."""
    rows = []
    for test, run in study.smooth.items():
        angles = np.linspace(0.2, 3 * math.pi, 120)
        before, printed = float(run.plan.at(run.arc_start).arc[0]), TESTS[test]
        values = [
            ("simulated", np.array([run.errors(angle)[1] for angle in angles]), charts.SIMULATED),
            ("measured circle", circle_error(test, MEASURED, angles, before), charts.MEASURED._replace(dash="dash")),
            ("odometric circle", circle_error(test, ODOMETRIC, angles, before), charts.ODOMETRIC._replace(dash="dash")),
        ]
        lines = [charts.curve(name, np.degrees(angles), 100 * e_x, stroke) for name, e_x, stroke in values]
        levels = [
            charts.level(f"Table 5: measured {printed.e_x[MEASURED]:g} %", printed.e_x[MEASURED]),
            charts.level(f"odometric {printed.e_x[ODOMETRIC]:g} %", printed.e_x[ODOMETRIC], "#d55e00"),
        ]
        x = ("planned angle at the end", "°")
        rows.append(charts.panel(f"e_x_{test}", f"{NAMES[test]}: e_x", x, ("e_x", "%"), lines, levels))
    caption = (
        "The position error depends on where a test ends. The measured circle has the measured e_x at "
        + " and ".join(f"{math.degrees(angle):.0f}°" for angle in study.angle.values())
        + ", the odometric one has another e_x there than Table 5 prints."
    )
    return Sheet("angle", "How long a test was: e_x over the circle's angle", caption, (tuple(rows),))


def _limit_sheet(study: Study) -> Sheet:
    """Radii of Test 1 over the torque limit: where the wheels break away."""
    panels = []
    printed = TESTS["test1"].radius
    for title, column, kind in (("odometric radius", 1, ODOMETRIC), ("radius", 2, MEASURED)):
        lines = []
        for d in study.driven:
            lines.append(charts.over_kappa(d.kappa, d.tried[:, 0], d.tried[:, column]))
        levels = [charts.level(f"paper, {kind}: {printed[kind]} m", printed[kind])]
        x = ("limit of the front motors", "N·m")
        panels.append(charts.panel(f"limit_{column}", f"Test 1: {title}", x, (title, "m"), lines, levels))
    caption = (
        "Driven motors. The higher the limit, the tighter the circle, until front wheels break away, which takes "
        "the circle to the planned one."
    )
    return Sheet("limit", "Why one torque limit does not do", caption, (tuple(panels),))
