"""What an identification finds: parameters with intervals, how well they explain the data, how it prints."""

from __future__ import annotations

import enum
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from artibot_sim.estimation.checks.stream_values import StreamTable
from artibot_sim.estimation.search import SearchReport
from artibot_sim.model import Robot

# ----------------------------------------------------------------------
# An identification on the terminal.
# ----------------------------------------------------------------------


def printed(found: Identification) -> Any:
    """Tables and lines, for a rich console."""
    from rich.console import Group
    from rich.text import Text

    answer = [f"{found.status.value}: {found.message}", f"least known: {found.weakest}"]
    lines = [Text(line) for line in (*answer, *found.remarks)]
    models = [_models(prediction) for prediction in found.predictions if prediction.rivals]
    return Group(
        *map(Text, found.findings),
        _Parameters(found),
        *lines,
        _channels(found),
        *models,
        *(Text(line) for line in _lines(found)),
    )


def as_text(found: Identification) -> str:
    """An identification as plain text, as the terminal shows it."""
    from io import StringIO

    from rich.console import Console

    out = StringIO()
    Console(file=out, width=118, highlight=False).print(printed(found))
    return out.getvalue()


class _Parameters:
    """The table of estimates; without its priors where the terminal is too narrow for them."""

    def __init__(self, found: Identification) -> None:
        self._found = found

    def __rich_console__(self, console: Any, options: Any) -> Iterator[Any]:
        whole = _parameters(self._found, priors=True)
        needed = console.measure(whole, options=options.update(width=1000)).maximum
        yield whole if needed <= options.max_width else _parameters(self._found, priors=False)


def _parameters(found: Identification, priors: bool) -> Any:
    from rich.table import Table

    title = f"{found.robot.name}: identified from {', '.join(found.recordings)}"
    table = Table(
        title=title, title_justify="left", box=None, header_style="bold", pad_edge=False, padding=(0, 1, 0, 0)
    )
    for column in ("parameter", "value", "95 %", "unit", *(["prior"] if priors else []), "status"):
        left = column in ("parameter", "unit", "status")
        # a name or a number that is cut is none
        table.add_column(column, justify="left" if left else "right", no_wrap=True, overflow="fold")
    for e in found.estimates:
        low, high = e.ci95
        known = [f"{e.prior[0]:.4g} ± {number(e.prior[1], 2)}"] if priors else []
        table.add_row(
            e.name.removeprefix("effects."), number(e.value), f"{number(low, 3)} … {number(high, 3)}", spaced(e.unit),
            *known, e.status.value,
        )  # fmt: skip
    return table


def _channels(found: Identification) -> Any:
    from rich.table import Table

    table = Table(box=None, header_style="bold", pad_edge=False)
    for column in ("channel", "unit", "noise", "fitted"):
        numbers = column in ("noise", "fitted")
        table.add_column(column, justify="right" if numbers else "left", no_wrap=True)
    for prediction in found.predictions:
        table.add_column(f"{prediction.name}: {prediction.horizon:g} s ahead", justify="right")
        table.add_column("free run", justify="right")
    for name, fit in found.channels.items():
        cells = [name, spaced(fit.unit), number(fit.noise, 3), number(fit.rmse, 3)]
        for prediction in found.predictions:
            cells += [_rmse(prediction.channels.get(name)), _rmse(prediction.free_run.get(name))]
        table.add_row(*cells)
    return table


def _models(prediction: Prediction) -> Any:
    """This model beside kinematic ones, by errors at the ends of predictions."""
    from rich.table import Table

    title = f"{prediction.name}, held out: errors at the ends of predictions {prediction.horizon:g} s ahead"
    table = Table(title=title, title_justify="left", box=None, header_style="bold", pad_edge=False)
    table.add_column("model", overflow="fold")
    for words, unit in (("position", "m"), ("heading", "rad")):
        for column in (f"{words} RMSE", "median", f"90 %, {unit}"):
            table.add_column(column, justify="right")
    for name, fits in {"this model": prediction.final, **prediction.rivals}.items():
        some = [fits.get(channel) for channel in ("position", "yaw")]
        cells = [
            "–" if fit is None else f"{value:.3f}"
            for fit in some
            for value in ((fit.rmse, fit.median, fit.p90) if fit is not None else (0.0,) * 3)
        ]
        table.add_row(name, *cells)
    return table


def _rmse(fit: ChannelFit | None) -> str:
    return number(fit.rmse, 3) if fit else "–"


def _lines(found: Identification) -> Iterator[str]:
    """What there is to say besides tables."""
    for e in found.estimates:
        if e.note:
            yield f"{e.name}: {e.note}"
    for prediction in found.predictions:
        yield from prediction_lines(prediction)
    yield f"{found.windows} windows, {found.samples} samples, {found.seconds:.1f} s"


def prediction_lines(prediction: Prediction) -> Iterator[str]:
    """Sentences about a held-out recording."""
    position = prediction.channels.get("position")
    if position is not None:
        known = np.isfinite(position.noise)
        noise = f" (noise of the sensor: {number(1e3 * position.noise, 3)} mm)" if known else ""
        yield (
            f"{prediction.name}, held out: {prediction.windows} predictions of {prediction.horizon:g} s, "
            f"position RMSE {number(1e3 * position.rmse, 3)} mm{noise}"
        )
    if prediction.left is not None:
        yield f"{prediction.name}: its free run leaves the measured branch at {prediction.left:.1f} s"
    for sentence in prediction.outliers:
        yield f"{prediction.name}: {sentence}"
    if prediction.note:
        yield f"{prediction.name}: {prediction.note}"


def number(value: float, digits: int = 4) -> str:
    """A number for people: so many digits, no exponent where there need be none; a dash where it is not known."""
    if np.isnan(value):
        return "–"
    text = f"{value + 0.0:#.{digits}g}"  # 0 has no sign
    if "e" in text:
        mantissa, exponent = text.split("e")
        if 0 <= int(exponent) <= 6:
            return f"{value:.0f}"
        return f"{mantissa}e{int(exponent)}"
    return text.rstrip(".")


def spaced(unit: str) -> str:
    """A unit as it is printed: N·m for N m."""
    return unit.replace("^2", "²").replace(" ", "·")


# ----------------------------------------------------------------------
# What an identification finds: parameters with intervals, how well they explain what was measured, and a status.
# ----------------------------------------------------------------------


Array = NDArray[np.float64]


class FitStatus(enum.Enum):
    """How an identification, or one parameter of it, ended."""

    CONVERGED = "converged"
    AT_BOUND = "at bound"
    NOT_IDENTIFIABLE = "not identifiable"
    NOT_CONVERGED = "not converged"


@dataclass(frozen=True)
class Estimate:
    """One parameter.

    Attributes
    ----------
    key, name, unit : str
    value : float
        SI.
    ci95 : (float, float)
        95 % interval: the wider of `curvature` and `bootstrap`, widened by what neither sees
        (`judgement.SYSTEMATIC`).
    curvature, bootstrap : (float, float)
        Intervals by either way.
    prior : (float, float)
        Middle and standard deviation assumed beforehand.
    status : FitStatus
    note : str
        What a person should know about it; empty where nothing.
    """

    key: str
    name: str
    unit: str
    value: float
    ci95: tuple[float, float]
    curvature: tuple[float, float]
    bootstrap: tuple[float, float]
    prior: tuple[float, float]
    status: FitStatus
    note: str = ""


@dataclass(frozen=True)
class ChannelFit:
    """How one channel is explained over all windows.

    Attributes
    ----------
    unit : str
    noise : float
        Standard deviation of one sample, as fast changes in the recording show it (`local_fit.noise_of`).
    rmse, median, p90 : float
        Of the absolute residuals; of positions those of the distance.
    count : int
        Samples.
    excess : float
        Typical window's root mean square residual over the noise: 1 is as good as the sensor.
    """

    unit: str
    noise: float
    rmse: float
    median: float
    p90: float
    count: int
    excess: float


@dataclass(frozen=True)
class Prediction:
    """A recording that was not fitted, predicted.

    Attributes
    ----------
    name : str
    horizon : float, s
    windows : int
        How many predictions of that length.
    channels : mapping of str to ChannelFit
        Errors of the predictions, each started from what the measurements before it give.
    final : mapping of str to ChannelFit
        Errors at the ends of the windows alone (position and yaw).
    free_run : mapping of str to ChannelFit
        Errors of one simulation of the whole recording.
    left : float or None
        s, when the free run leaves the branch that was measured: other wheels slide from then on, and it goes astray.
    note : str
    outliers : tuple of str
        Which windows are predicted worst, where windows are separate.
    rivals : mapping of str to mapping
        For a rigid robot: the same as `final` of kinematic models fitted to the same recordings (see `skid`).
    """

    name: str
    horizon: float
    windows: int
    channels: Mapping[str, ChannelFit]
    final: Mapping[str, ChannelFit]
    free_run: Mapping[str, ChannelFit]
    left: float | None
    note: str = ""
    rivals: Mapping[str, Mapping[str, ChannelFit]] = field(default_factory=dict)
    outliers: tuple[str, ...] = ()


@dataclass(frozen=True)
class Identification:
    """Parameters identified from recordings.

    Attributes
    ----------
    robot : Robot
        With the new values, their sources and intervals.
    estimates : tuple of Estimate
    correlation : array, shape (p, p)
        Of the estimates' logarithms.
    weakest : str
        The combination of parameters that the data say least about, and how much.
    status : FitStatus
        The worst of all.
    message : str
        One line for a person.
    recordings : tuple of str
    windows, samples : int
    channels : mapping of str to ChannelFit
    predictions : tuple of Prediction
    findings : tuple of str
        What is wrong with the recordings, and what of that was mended before anything was fitted.
    remarks : tuple of str
        What was left out or assumed.
    seconds : float
        It took.
    search : SearchReport or None
        What the search from several starts says of itself.
    streams : mapping
        Delay, hold, scale and sign of each stream as it was recorded: topic → recording → `stream_values`.
    """

    robot: Robot
    estimates: tuple[Estimate, ...]
    correlation: Array
    weakest: str
    status: FitStatus
    message: str
    recordings: tuple[str, ...]
    windows: int
    samples: int
    channels: Mapping[str, ChannelFit]
    predictions: tuple[Prediction, ...] = ()
    findings: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    seconds: float = 0.0
    search: SearchReport | None = None
    streams: StreamTable = field(default_factory=dict)

    def __getitem__(self, name: str) -> Estimate:
        """An estimate by its short name or its key."""
        for estimate in self.estimates:
            if name in (estimate.name, estimate.key):
                return estimate
        raise KeyError(f"{name}: not identified; there are {', '.join(e.name for e in self.estimates)}")

    def as_dict(self) -> dict[str, Any]:
        """All but the robot, as plain data for JSON."""
        return {
            "schema": "artibot/identification/1",
            "robot": self.robot.name,
            "status": self.status.value,
            "message": self.message,
            "parameters": {e.key: _estimate(e) for e in self.estimates},
            "correlation": self.correlation.tolist(),
            "weakest": self.weakest,
            "recordings": list(self.recordings),
            "windows": self.windows,
            "samples": self.samples,
            "channels": {name: vars(fit) for name, fit in self.channels.items()},
            "predictions": [_prediction(p) for p in self.predictions],
            "findings": list(self.findings),
            "remarks": list(self.remarks),
            "search": vars(self.search) if self.search else None,
            "streams": self.streams,
            "seconds": self.seconds,
        }

    def __rich__(self) -> Any:
        return printed(self)

    def __str__(self) -> str:
        return as_text(self)


def _estimate(e: Estimate) -> dict[str, Any]:
    return {
        "value": e.value, "unit": e.unit, "ci95": list(e.ci95), "curvature": list(e.curvature),
        "bootstrap": list(e.bootstrap), "prior": {"value": e.prior[0], "sd": e.prior[1]}, "status": e.status.value,
        "note": e.note,
    }  # fmt: skip


def _prediction(p: Prediction) -> dict[str, Any]:
    groups = {name: {k: vars(v) for k, v in getattr(p, name).items()} for name in ("channels", "final", "free_run")}
    rivals = {name: {k: vars(v) for k, v in fits.items()} for name, fits in p.rivals.items()}
    about = {"name": p.name, "horizon": p.horizon, "windows": p.windows, "left": p.left, "note": p.note}
    about["outliers"] = list(p.outliers)
    return {**about, **groups, "rivals": rivals}


def from_dict(
    document: Mapping[str, Any],
) -> tuple[tuple[Estimate, ...], dict[str, ChannelFit], tuple[Prediction, ...]]:
    """Estimates, channels and predictions from what `Identification.as_dict` gave; KeyError or TypeError otherwise."""
    estimates = [_estimate_from(key, entry) for key, entry in document["parameters"].items()]
    predictions = [_prediction_from(entry) for entry in document["predictions"]]
    return tuple(estimates), _fits(document["channels"]), tuple(predictions)


def _estimate_from(key: str, entry: Mapping[str, Any]) -> Estimate:
    ci95, curvature, bootstrap = (
        (float(entry[name][0]), float(entry[name][1])) for name in ("ci95", "curvature", "bootstrap")
    )
    prior = (float(entry["prior"]["value"]), float(entry["prior"]["sd"]))
    return Estimate(
        key, key.removeprefix("contact."), entry["unit"], entry["value"], ci95, curvature, bootstrap, prior,
        FitStatus(entry["status"]), entry["note"],
    )  # fmt: skip


def _fits(entries: Mapping[str, Any]) -> dict[str, ChannelFit]:
    return {name: ChannelFit(**entry) for name, entry in entries.items()}


def _prediction_from(entry: Mapping[str, Any]) -> Prediction:
    rivals = {name: _fits(fits) for name, fits in entry["rivals"].items()}
    groups = {name: _fits(entry[name]) for name in ("channels", "final", "free_run")}
    return Prediction(**{**entry, **groups, "rivals": rivals, "outliers": tuple(entry.get("outliers", ()))})
