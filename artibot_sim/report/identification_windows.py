"""Pictures of a held-out recording of separate windows: how far off models are at their ends, and which are worst."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from artibot_sim.identify.printing import spaced
from artibot_sim.identify.quality import end_errors, worst_of
from artibot_sim.identify.sensing import CHANNEL_UNITS
from artibot_sim.report.panels import Floats, Line, Panel
from artibot_sim.report.style import LEFT, MUTED, ODOMETRIC, POINTS, RIGHT, TRUE, Stroke

if TYPE_CHECKING:
    from artibot_sim.identify.holdout import Held
    from artibot_sim.identify.windows import Window

_MODELS = {
    "this model": Stroke(TRUE, 2.2),
    "ideal": Stroke(MUTED, 1.3, "dot"),
    "effective track": Stroke(ODOMETRIC, 1.5, "dash"),
    "ICR": Stroke(POINTS, 1.7),
}
_PATHS = Stroke(MUTED, 0.7, "solid", 0.45)
_MEASURED = Stroke(LEFT, 1.8)
_PREDICTED = Stroke(TRUE, 1.8, "dash")
_EVERY = Stroke(MUTED, 2.6, "points", 0.6)
_FAR = Stroke(LEFT, 6.5, "points")
_TURNED = Stroke(RIGHT, 4.5, "points")
_CUT = 1.5
"""A chart ends at so many times the effective track's 95 % quantile: ideal wheels are far off everywhere."""
_BREAK = np.array([np.nan])


def window_panels(held: Held) -> Iterator[Panel]:
    """What is drawn where other models predict the same windows."""
    ends = {name: end_errors(held.windows, held.residuals, name) for name in ("position", "yaw")}
    worst = {name: worst_of(error).tolist() for name, error in ends.items() if np.isfinite(error).all()}
    if "position" in worst:
        yield _map(held, worst["position"])
    if worst:
        yield _wheels(held, worst)
    for name in worst:
        yield _distribution(held, name)


def _distribution(held: Held, channel: str) -> Panel:
    """Errors at the windows' ends in order of size, for each model."""
    residuals = {"this model": held.residuals, **held.rivals}
    found = {name: np.sort(end_errors(held.windows, own, channel)) for name, own in residuals.items()}
    share = 100.0 * (np.arange(len(held.windows)) + 0.5) / len(held.windows)
    limit = _CUT * float(np.quantile(found.get("effective track", found["this model"]), 0.95))
    lines = [
        Line(name, name, None, share, np.where(error <= limit, error, np.nan), _MODELS[name])
        for name, error in found.items()
    ]
    unit = spaced(CHANNEL_UNITS[channel])
    title = f"{held.summary.name}: {channel} at the ends, windows in order of error"
    return Panel(f"{held.summary.name}_{channel}_ends", title, ("windows", "%"), ("error", unit), tuple(lines[::-1]))


def _map(held: Held, worst: Sequence[int]) -> Panel:
    """Measured paths of all windows, and of the worst ones with what was predicted."""
    every = range(len(held.windows))
    lines = [_paths(held, "measured, every window", every, False, _PATHS)]
    lines += [_paths(held, f"measured, the worst {len(worst)}", worst, False, _MEASURED)]
    lines += [_paths(held, f"predicted, the worst {len(worst)}", worst, True, _PREDICTED)]
    title = f"{held.summary.name}: the worst positions on its map"
    return Panel(f"{held.summary.name}_map", title, ("x", "m"), ("y", "m"), tuple(lines), equal=True)


def _paths(held: Held, name: str, rows: Sequence[int], predicted: bool, stroke: Stroke) -> Line:
    xs, ys = [], []
    for i in rows:
        window = held.windows[i]
        x, y, _ = window.places
        value = window.value + held.residuals[i] * window.sigma if predicted else window.value
        xs += [value[x], _BREAK]
        ys += [value[y], _BREAK]
    return Line(name, name, None, np.concatenate(xs), np.concatenate(ys), stroke)


def _wheels(held: Held, worst: Mapping[str, Sequence[int]]) -> Panel:
    """How fast both sides turned in every window, the worst ones marked."""
    speed = np.array([_speeds(held, window) for window in held.windows])
    lines = [Line("every window", "every window", None, speed[:, 0], speed[:, 1], _EVERY)]
    for name, stroke in (("position", _FAR), ("yaw", _TURNED)):
        if name in worst:
            said = f"worst {len(worst[name])} in {name}"
            mine = speed[worst[name]]
            lines.append(Line(said, said, None, mine[:, 0], mine[:, 1], stroke))
    title = f"{held.summary.name}: mean speeds of motors, worst windows"
    return Panel(
        f"{held.summary.name}_wheels", title, ("right motor", "rad/s"), ("left motor", "rad/s"), tuple(lines),
        equal=True,
    )  # fmt: skip


def _speeds(held: Held, window: Window) -> Floats:
    """Mean speed of the right and the left front motor, rad/s."""
    part = slice(window.first, window.first + window.knots + 1)
    return np.asarray(held.stretches[window.stretch].inputs.velocity[part, :2].mean(axis=0), float)
