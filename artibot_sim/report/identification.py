"""An identification as a page: parameters, residuals against noise, predictions of what was held out, free runs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from artibot_sim.errors import ArtibotError
from artibot_sim.estimation.checks.common_map import in_common_map
from artibot_sim.estimation.kinematic import TIMED, UNTIMED
from artibot_sim.estimation.measurements import CHANNEL_UNITS
from artibot_sim.estimation.windows import CHANNEL_NAMES
from artibot_sim.identify.result import from_dict, number, prediction_lines, spaced
from artibot_sim.identify.validation import deviations, end_errors, worst_of
from artibot_sim.report.page import Section, render_page
from artibot_sim.report.panels import Figure, Floats, Level, Line, Panel
from artibot_sim.report.style import LEFT, MUTED, ODOMETRIC, POINTS, RIGHT, TRUE, Stroke
from artibot_sim.report.windows import Path, WindowErrors, side_by_side

if TYPE_CHECKING:
    import pathlib

    from artibot_sim.estimation.windows import Window
    from artibot_sim.identify.result import ChannelFit, Estimate, Prediction
    from artibot_sim.identify.run import Work
    from artibot_sim.identify.validation import PredictedRecording

# ----------------------------------------------------------------------
# Pictures of a held-out recording of separate windows: how far off models are at their ends, and which are worst.
# ----------------------------------------------------------------------


_MODELS = {
    "this model": Stroke(TRUE, 2.2),
    "ideal": Stroke(MUTED, 1.3, "dot"),
    "effective track": Stroke(ODOMETRIC, 1.5, "dash"),
    UNTIMED: Stroke(POINTS, 1.7),
    TIMED: Stroke(POINTS, 1.7, "dash"),
}
_PATHS = Stroke(MUTED, 0.7, "solid", 0.45)
_WINDOW_MEASURED = Stroke(LEFT, 1.8)
_WINDOW_PREDICTED = Stroke(TRUE, 1.8, "dash")
_EVERY = Stroke(MUTED, 2.6, "points", 0.6)
_FAR = Stroke(LEFT, 6.5, "points")
_TURNED = Stroke(RIGHT, 4.5, "points")
_CUT = 1.5
"""A chart ends at so many times the effective track's 95 % quantile: ideal wheels are far off everywhere."""
_BREAK = np.array([np.nan])
_WHERE = "Where windows are bad"
_PATHS_PART = "Paths"
_ERRORS_PART = "Errors over time"
_LEAST = 8
"""Windows of which an order says something."""


def window_panels(held: PredictedRecording) -> Iterator[Panel]:
    """How far off predictions are at the windows' ends, which windows are worst, and what these look like."""
    ends = {name: end_errors(held.windows, held.residuals, name) for name in ("position", "yaw")}
    worst = {name: worst_of(error).tolist() for name, error in ends.items() if np.isfinite(error).all()}
    for name in worst:
        yield _distribution(held, name)
    if "position" in worst:
        yield from _drives(held, ends["position"])
        if in_common_map([held.experiment]):
            yield _map(held, worst["position"])
    if worst:
        yield _wheels(held, worst)


def _drives(held: PredictedRecording, error: Floats) -> Iterator[Panel]:
    """A typical, a bad and the worst window."""
    drives = []
    for i, window in enumerate(held.windows):
        paths = [Path("measured", _points(held, i, None), _WINDOW_MEASURED)]
        models = {"this model": held.residuals, **held.rivals}
        paths += [Path(name, _points(held, i, own[i]), _MODELS[name]) for name, own in models.items()]
        drives.append(WindowErrors(window.t, float(error[i]), paths))
    title = "Typical, bad and worst windows"
    for panel in side_by_side(held.summary.name, drives):
        yield replace(panel, title=f"{held.summary.name}: {panel.title}", part=title)


def _points(held: PredictedRecording, row: int, residual: Floats | None) -> Floats:
    """A window's positions (n, 2), m: measured, or predicted with these residuals."""
    window = held.windows[row]
    x, y, _ = window.places
    value = window.value if residual is None else window.value + residual * window.sigma
    return np.column_stack([value[x], value[y]])


def _distribution(held: PredictedRecording, channel: str) -> Panel:
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
    return Panel(
        f"{held.summary.name}_{channel}_ends", title, ("windows", "%"), ("error", unit), tuple(lines[::-1]),
        part="Windows in order of error",
    )  # fmt: skip


def _map(held: PredictedRecording, worst: Sequence[int]) -> Panel:
    """Measured paths of all windows, and of the worst ones with what was predicted."""
    every = range(len(held.windows))
    lines = [_paths(held, "measured, every window", every, False, _PATHS)]
    lines += [_paths(held, f"measured, the worst {len(worst)}", worst, False, _WINDOW_MEASURED)]
    lines += [_paths(held, f"predicted, the worst {len(worst)}", worst, True, _WINDOW_PREDICTED)]
    title = f"{held.summary.name}: the worst positions on its map"
    return Panel(f"{held.summary.name}_map", title, ("x", "m"), ("y", "m"), tuple(lines), equal=True, part=_WHERE)


def _paths(held: PredictedRecording, name: str, rows: Sequence[int], predicted: bool, stroke: Stroke) -> Line:
    xs, ys = [], []
    for i in rows:
        window = held.windows[i]
        x, y, _ = window.places
        value = window.value + held.residuals[i] * window.sigma if predicted else window.value
        xs += [value[x], _BREAK]
        ys += [value[y], _BREAK]
    return Line(name, name, None, np.concatenate(xs), np.concatenate(ys), stroke)


def _wheels(held: PredictedRecording, worst: Mapping[str, Sequence[int]]) -> Panel:
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
        equal=True, part=_WHERE,
    )  # fmt: skip


def _speeds(held: PredictedRecording, window: Window) -> Floats:
    """Mean speed of the right and the left front motor, rad/s."""
    part = slice(window.first, window.first + window.knots + 1)
    return np.asarray(held.stretches[window.stretch].inputs.velocity[part, :2].mean(axis=0), float)


# ----------------------------------------------------------------------
# An identification as a page: parameters, residuals against noise, predictions of what was held out, free runs.
# ----------------------------------------------------------------------


_MEASURED = Stroke(POINTS, 3.0, "points")
_PREDICTED = Stroke(TRUE, 1.6)
_FREE = Stroke(RIGHT, 1.5, "dash")
_FITTED = Stroke(LEFT, 1.2)
_NOISE = Stroke(MUTED, 1.2, "dot")
COLUMNS = ("",) * 5
"""Sections differ in what their columns are, so their first lines say it and there is no common head."""
_ERRORS = ("RMSE", "median", "90 %", "noise", "samples")


def page_of(work: Work) -> bytes:
    """The page (UTF-8) of an identification."""
    found = work.result
    return render_page(
        figure_of(work), tables(work), COLUMNS, findings=found.findings,
        answer=[_meanings(work), *_answer(found.estimates, found.remarks, found.predictions)],
        first=_first(found.predictions), closed=(_ERRORS_PART, "table"),
    )  # fmt: skip


def _meanings(work: Work) -> str:
    """What the parameters are."""
    robot = work.result.robot
    docs = {key: declared.doc for key, declared, _ in (*robot.quantities(), *robot.effect_quantities())}
    return "; ".join(f"{e.name}: {docs[e.key]}" for e in work.result.estimates if e.key in docs) + "."


def _answer(estimates: Sequence[Estimate], remarks: Sequence[str], predictions: Sequence[Prediction]) -> list[str]:
    """What stands below the answer's tables."""
    notes = [f"{e.name}: {e.note}" for e in estimates if e.note]
    return [*remarks, *notes, *(line for one in predictions for line in prediction_lines(one))]


def _first(predictions: Sequence[Prediction]) -> int:
    """How many sections stand with the answer: models side by side, and the parameters."""
    return sum(bool(prediction.rivals) for prediction in predictions) + 1


def figure_of(work: Work) -> Figure:
    """The page's charts."""
    found = work.result
    subtitle = f"{found.status.value}: {found.message} · least known: {found.weakest} · {found.seconds:.1f} s"
    return Figure(f"{found.robot.name}: identified from {', '.join(found.recordings)}", subtitle, tuple(panels(work)))


def page_of_document(document: Mapping[str, Any], path: pathlib.Path) -> bytes:
    """The page of an identification's JSON: its tables, and parameters beside their priors.

    Raises
    ------
    ArtibotError
        If the document is not one.
    """
    try:
        estimates, channels, predictions = from_dict(document)
        subtitle = f"{document['status']}: {document['message']} · least known: {document['weakest']}"
        recordings = ", ".join(document["recordings"])
        title = f"{document['robot']}: identified from {recordings}"
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise ArtibotError(
            f"{path}: not an identification ({type(error).__name__}: {error}); expected a file of "
            "`artibot identify --json`"
        ) from error
    figure = Figure(title, subtitle, (_intervals(estimates),))
    return render_page(
        figure, _tables(estimates, channels, predictions), COLUMNS, findings=document.get("findings", ()),
        answer=_answer(estimates, document["remarks"], predictions), first=_first(predictions),
    )  # fmt: skip


def _intervals(estimates: Sequence[Estimate]) -> Panel:
    """Values with their intervals beside their priors, in the priors' standard deviations."""
    place = np.arange(1.0, len(estimates) + 1.0)
    middle, sd = np.array([e.prior for e in estimates]).T
    ends = (np.array([e.ci95 for e in estimates]) - middle[:, None]) / sd[:, None]
    bars = np.column_stack([ends, np.full(len(estimates), np.nan)]).ravel()
    values = (np.array([e.value for e in estimates]) - middle) / sd
    lines = (
        Line("prior", "prior", None, np.zeros(2), np.array([0.5, len(estimates) + 0.5]), _NOISE),
        Line("95 % interval", "95 % interval", None, bars, np.repeat(place, 3), _PREDICTED),
        Line("value", "value", None, values, place, Stroke(TRUE, 6.0, "points")),
    )
    return Panel(
        "parameters", "Parameters beside what was known before",
        ("value − prior", "prior's σ"), ("parameter", "-"),
        lines, names=tuple(e.name.removeprefix("effects.") for e in estimates),
    )  # fmt: skip


def tables(work: Work) -> list[Section]:
    """Parameters, then errors by channel: fitted, predicted, and of free runs."""
    found = work.result
    return _tables(found.estimates, found.channels, found.predictions)


def _tables(
    estimates: Sequence[Estimate], channels: Mapping[str, ChannelFit], predictions: Sequence[Prediction]
) -> list[Section]:
    heads = ("value", "95 %", "known before")
    values = [(e.name, spaced(e.unit), _estimate(e)) for e in estimates]
    sections: list[Section] = [_models(prediction) for prediction in predictions if prediction.rivals]
    sections += [("Parameters", [("", "", heads), *values]), ("Residuals of the fit", _errors(channels))]
    for prediction in predictions:
        said = f"{prediction.name}, held out: {prediction.windows} predictions of {prediction.horizon:g} s"
        sections.append((said, _errors(prediction.channels)))
        sections.append((f"{prediction.name}: at the ends of the predictions", _errors(prediction.final)))
        sections += [
            (f"{prediction.name}: at the ends, {name} (a kinematic model fitted to the same windows)", _errors(fits))
            for name, fits in prediction.rivals.items()
        ]
        if prediction.free_run:
            left = "" if prediction.left is None else f", which leaves the measured branch at {prediction.left:.1f} s"
            sections.append((f"{prediction.name}: free run{left}", _errors(prediction.free_run)))
    return sections


def _estimate(e: Estimate) -> tuple[str, str, str]:
    """Value, interval and prior: few columns, so that a phone shows them."""
    low, high = (number(value, 3) for value in e.ci95)
    return number(e.value), f"{low} … {high}", f"{e.prior[0]:.4g} ± {number(e.prior[1], 2)}"


def _models(prediction: Prediction) -> Section:
    """This model beside kinematic ones, in position and heading at the ends of predictions."""
    heading = f"{prediction.name}, held out: errors at the ends of {prediction.windows} predictions"
    lines: list[tuple[str, str, Sequence[str]]] = [("", "", _ERRORS[:3])]
    for channel, words in (("position", "position"), ("yaw", "heading")):
        for name, fits in {"this model": prediction.final, **prediction.rivals}.items():
            if channel in fits:
                fit = fits[channel]
                texts = tuple(f"{value:.3f}" for value in (fit.rmse, fit.median, fit.p90))
                lines.append((f"{words}, {name}", spaced(fit.unit), texts))
    return f"{heading} {prediction.horizon:g} s ahead", lines


def _errors(channels: Mapping[str, ChannelFit]) -> list[tuple[str, str, tuple[str, ...]]]:
    return [("", "", _ERRORS)] * bool(channels) + [
        (
            name.replace("_", " "),
            spaced(fit.unit),
            (*(number(v, 3) for v in (fit.rmse, fit.median, fit.p90, fit.noise)), str(fit.count)),
        )
        for name, fit in channels.items()
    ]


def panels(work: Work) -> Iterator[Panel]:
    """What is drawn: of held-out recordings if there are any, else of the fitted windows."""
    for held in work.held:
        name = held.summary.name
        if held.rivals or len(held.windows) >= _LEAST:
            yield from window_panels(held)
        if any(run.window.channel.tolist().count(0) for run in held.free):
            yield _path(held)
        for c, channel in enumerate(CHANNEL_NAMES):
            drawn = (
                ("predicted", _PREDICTED, _over_time(held.windows, held.residuals, c)),
                ("free run", _FREE, _over_time([r.window for r in held.free], [r.residual for r in held.free], c)),
            )
            fit = held.summary.channels.get(channel)
            if fit is not None:
                yield _panel(f"{name}_{channel}", f"{name}, error of {channel.replace('_', ' ')}", fit, drawn)
    windows, residuals = work.problem.windows, work.fit.point.residuals
    for number_, recording in enumerate(work.result.recordings):
        mine = [i for i, w in enumerate(windows) if work.problem.stretches[w.stretch].experiment.name == recording]
        if work.held and number_ > 0:
            break  # one fitted recording is enough beside the held-out ones
        for c, channel in enumerate(CHANNEL_NAMES):
            fit = work.result.channels.get(channel)
            drawn_ = (("fitted", _FITTED, _over_time([windows[i] for i in mine], [residuals[i] for i in mine], c)),)
            if fit is not None and len(drawn_[0][2][0]):
                title = f"{recording}, residual of {channel.replace('_', ' ')}"
                yield _panel(f"{recording}_{channel}_fitted", title, fit, drawn_)


def _panel(
    key: str, title: str, fit: ChannelFit, drawn: tuple[tuple[str, Stroke, tuple[Floats, Floats]], ...]
) -> Panel:
    lines = tuple(Line(name, name, None, x, y, stroke) for name, stroke, (x, y) in drawn if len(x))
    noise = Level("noise", fit.noise, _NOISE)
    return Panel(key, title, ("time", "s"), ("error", spaced(fit.unit)), lines, (noise,), part=_ERRORS_PART)


def _over_time(windows: list[Window], residuals: list[Floats], channel: int) -> tuple[Floats, Floats]:
    """Absolute errors of a channel over time, smoothed to a tenth of a second; windows are not joined."""
    times, errors = [], []
    for window, residual in zip(windows, residuals, strict=True):
        t, error = deviations(window, residual, channel)
        if not len(t):
            continue
        order = np.argsort(t, kind="stable")
        bins = np.floor(t[order] / 0.1).astype(int)
        count = np.maximum(np.bincount(bins), 1)
        filled = np.flatnonzero(np.bincount(bins))
        mean = np.sqrt(np.bincount(bins, error[order] ** 2) / count)[filled]
        times += [window.t + 0.1 * filled + 0.05, _BREAK]
        errors += [mean, _BREAK]
    if not times:
        return np.empty(0), np.empty(0)
    return np.concatenate(times), np.concatenate(errors)


def _path(held: PredictedRecording) -> Panel:
    """Measured points, predictions and the free run from above."""
    lines = []
    for name, stroke, windows, residuals in (
        ("total station", _MEASURED, held.windows, [np.zeros(len(w)) for w in held.windows]),
        ("predicted", _PREDICTED, held.windows, held.residuals),
        ("free run", _FREE, [run.window for run in held.free], [run.residual for run in held.free]),
    ):
        xs, ys = [], []
        for window, residual in zip(windows, residuals, strict=True):
            value = window.value + residual * window.sigma
            xs += [value[window.plan.kind == 0], _BREAK]
            ys += [value[window.plan.kind == 1], _BREAK]
        label = "measured points" if stroke is _MEASURED else name
        lines.append(Line(label, label, None, np.concatenate(xs), np.concatenate(ys), stroke))
    title = f"{held.summary.name}: path, predicted {held.summary.horizon:g} s ahead, and run freely"
    return Panel(f"{held.summary.name}_path", title, ("x", "m"), ("y", "m"), tuple(lines), equal=True, part=_PATHS_PART)
