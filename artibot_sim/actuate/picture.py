"""The laws' paths, yaw errors and torques as one sheet."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from artibot_sim.actuate.run import Actuation
from artibot_sim.report import style
from artibot_sim.report.panels import Line, Panel
from artibot_sim.reproduce.charts import PLANNED, TIME, curve, panel
from artibot_sim.reproduce.result import Sheet

Array = NDArray[np.float64]


def sheet(found: Sequence[Actuation], robot: str, manoeuvre: str) -> Sheet:
    """Paths and yaw errors above, front and back torques below."""
    colours = style.BAGS
    widths = np.linspace(3.6, 1.2, len(found)).tolist()  # laws that drive alike lie on each other
    strokes = [style.Stroke(colours[i % len(colours)], width) for i, width in enumerate(widths)]

    def curves(x: Callable[[Actuation], Array], y: Callable[[Actuation], Array]) -> list[Line]:
        return [curve(str(a.law), x(a), y(a), stroke) for a, stroke in zip(found, strokes, strict=True)]

    planned = found[0].planned
    path = panel(
        "path", "path of the front module", ("x", "m"), ("y", "m"),
        [curve("planned", planned.pose[:, 0], planned.pose[:, 1], PLANNED),
         *curves(lambda a: a.pose[:, 0], lambda a: a.pose[:, 1])],
    )  # fmt: skip
    rows: tuple[tuple[Panel, ...], ...] = (
        (
            path,
            panel("yaw", "yaw error", TIME, ("yaw − planned", "°"),
                  curves(_time, lambda a: np.degrees(a.pose[:, 2] - a.planned.pose[:, 2]))),
        ),
        (
            panel("front", "larger front motor torque", TIME, ("torque", "N·m"),
                  curves(_time, lambda a: np.abs(a.torque[:, :2]).max(axis=1))),
            panel("back", "back right motor torque", TIME, ("torque", "N·m"),
                  curves(_time, lambda a: a.torque[:, 2])),
        ),
    )  # fmt: skip
    caption = (
        f"{found[0].plan.path_length:.1f} m in {found[0].plan.duration:.1f} s. Each law sets the back motors' torques "
        "every 10 ms from the front motors' torques and the commanded speeds; the front motors follow the plan."
    )
    return Sheet("actuation", f"Torque-sharing laws: {robot} on {manoeuvre}", caption, rows)


def _time(a: Actuation) -> Array:
    return a.t
