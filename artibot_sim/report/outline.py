"""A rover seen from above, to scale, from its robot file and pose."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from artibot_sim.report.panels import Outline

if TYPE_CHECKING:
    from artibot_sim.model import Robot
    from artibot_sim.model.robot import Module

Floats = NDArray[np.float64]
WHEEL_WIDTH = 0.45
"""Width of a drawn wheel over its radius: robot files have none."""
_DRAWBAR = 0.06
"""Width of the drawn bar between module and joint over the track."""


def outline(robot: Robot, x: float, y: float, yaw: float, articulation_yaw: float | None, t: float = 0.0) -> Outline:
    """Return the polygons of a rover.

    Parameters
    ----------
    robot : Robot
        Its `front`, `back` and `wheel` give the sizes; bodies reach from wheel to wheel.
    x, y : float
        Origin of the front module in `map`, m.
    yaw : float
        Of the front module, rad.
    articulation_yaw : float or None
        gamma_b − gamma_f, rad. Where it is unknown (None) the back module is left out.
    t : float
        When, s.

    Returns
    -------
    Outline
        In `map`, m. The joint is at (−l_f, 0) in the front module and at (+l_b, 0) in the back one.
    """
    bodies, wheels = _module(robot.front, robot.wheel.r_w)
    bodies.append(_nose(robot.front, robot.wheel.r_w))
    parts = [_place(bodies, x, y, yaw), _place(wheels, x, y, yaw)]
    if robot.back is not None and articulation_yaw is not None:
        joint = np.array([x, y]) - robot.front.l * _direction(yaw)
        back_yaw = yaw + articulation_yaw
        back_x, back_y = joint - robot.back.l * _direction(back_yaw)
        bodies, wheels = _module(robot.back, robot.wheel.r_w)
        bar = _DRAWBAR * robot.back.i_y
        bodies.insert(0, _rectangle(0.0, robot.back.l, -bar / 2, bar / 2))
        parts[0] = _place(bodies, back_x, back_y, back_yaw) + parts[0]
        parts[1] += _place(wheels, back_x, back_y, back_yaw)
    return Outline(t, tuple(parts[0]), tuple(parts[1]))


def size(robot: Robot) -> float:
    """Return the length of a straight rover over its wheels, m."""
    behind = robot.front.l + robot.back.l + robot.back.i_x / 2 if robot.back is not None else robot.front.i_x / 2
    return robot.front.i_x / 2 + behind + 2 * robot.wheel.r_w


def _module(module: Module, r_w: float) -> tuple[list[Floats], list[Floats]]:
    """Return body and wheels of a module in its own frame."""
    half = WHEEL_WIDTH * r_w / 2
    body = _rectangle(-module.i_x / 2, module.i_x / 2, -module.i_y / 2 + half, module.i_y / 2 - half)
    wheels = [
        _rectangle(end * module.i_x / 2 - r_w, end * module.i_x / 2 + r_w,
                   side * module.i_y / 2 - half, side * module.i_y / 2 + half)
        for side in (-1, 1) for end in (1, -1)
    ]  # fmt: skip
    return [body], wheels


def _nose(module: Module, r_w: float) -> Floats:
    """Return the wedge that shows which end is the front."""
    base, width = module.i_x / 2, 0.28 * module.i_y
    return np.array([[base, -width], [base + 0.8 * r_w, 0.0], [base, width], [base, -width]])


def _rectangle(x_low: float, x_high: float, y_low: float, y_high: float) -> Floats:
    return np.array([[x_low, y_low], [x_high, y_low], [x_high, y_high], [x_low, y_high], [x_low, y_low]])


def _direction(yaw: float) -> Floats:
    return np.array([np.cos(yaw), np.sin(yaw)])


def _place(polygons: list[Floats], x: float, y: float, yaw: float) -> list[Floats]:
    cos, sin = _direction(yaw)
    return [polygon @ np.array([[cos, sin], [-sin, cos]]) + (x, y) for polygon in polygons]
