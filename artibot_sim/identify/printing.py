"""An identification on the terminal."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from artibot_sim.identify.identification import ChannelFit, Identification, Prediction


def printed(found: Identification) -> Any:
    """Tables and lines, for a rich console."""
    from rich.console import Group
    from rich.text import Text

    lines = [Text(line) for line in _lines(found)]
    return Group(_parameters(found), *lines[:2], _channels(found), *lines[2:])


def as_text(found: Identification) -> str:
    """The same as plain text."""
    from io import StringIO

    from rich.console import Console

    out = StringIO()
    Console(file=out, width=118, highlight=False).print(printed(found))
    return out.getvalue()


def _parameters(found: Identification) -> Any:
    from rich.table import Table

    table = Table(title=f"{found.robot.name}: identified from {', '.join(found.recordings)}", title_justify="left")
    for column in ("parameter", "value", "95 %", "unit", "prior", "status"):
        table.add_column(column, justify="left" if column in ("parameter", "unit", "status") else "right")
    for e in found.estimates:
        low, high = e.ci95
        table.add_row(
            e.name, number(e.value), f"{number(low)} … {number(high)}", spaced(e.unit),
            f"{number(e.prior[0])} ± {number(e.prior[1], 2)}", e.status.value,
        )  # fmt: skip
    return table


def _channels(found: Identification) -> Any:
    from rich.table import Table

    table = Table()
    for column in ("channel", "unit", "noise", "fitted"):
        table.add_column(column, justify="right" if column in ("noise", "fitted") else "left")
    for prediction in found.predictions:
        table.add_column(f"{prediction.name}: {prediction.horizon:g} s ahead", justify="right")
        table.add_column("free run", justify="right")
    for name, fit in found.channels.items():
        cells = [name, spaced(fit.unit), number(fit.noise, 3), number(fit.rmse, 3)]
        for prediction in found.predictions:
            cells += [_rmse(prediction.channels.get(name)), _rmse(prediction.free_run.get(name))]
        table.add_row(*cells)
    return table


def _rmse(fit: ChannelFit | None) -> str:
    return number(fit.rmse, 3) if fit else "–"


def _lines(found: Identification) -> Iterator[str]:
    """What there is to say besides tables."""
    yield f"{found.status.value}: {found.message}"
    yield f"least known: {found.weakest}"
    for e in found.estimates:
        if e.note:
            yield f"{e.name}: {e.note}"
    for prediction in found.predictions:
        yield from prediction_lines(prediction)
    yield from found.remarks
    yield f"{found.windows} windows, {found.samples} samples, {found.seconds:.1f} s"


def prediction_lines(prediction: Prediction) -> Iterator[str]:
    """Sentences about a held-out recording."""
    position = prediction.channels.get("position")
    if position is not None:
        yield (
            f"{prediction.name}, held out: {prediction.windows} predictions of {prediction.horizon:g} s, "
            f"position RMSE {1e3 * position.rmse:.1f} mm (fast noise alone: {1e3 * position.noise:.1f} mm)"
        )
    for name, fits in {"this model": prediction.final, **prediction.rivals}.items() if prediction.rivals else ():
        errors = "; ".join(
            f"{channel} RMSE {fit.rmse:.3f}, median {fit.median:.3f}, 90 % {fit.p90:.3f} {spaced(fit.unit)}"
            for channel, fit in fits.items()
            if channel in ("position", "yaw")
        )
        yield f"{prediction.name}, at the ends, {name}: {errors}"
    if prediction.left is not None:
        yield f"{prediction.name}: its free run leaves the measured branch at {prediction.left:.1f} s"
    for sentence in prediction.outliers:
        yield f"{prediction.name}: {sentence}"
    if prediction.note:
        yield f"{prediction.name}: {prediction.note}"


def number(value: float, digits: int = 4) -> str:
    """A number for people: so many digits, no exponent where there need be none."""
    text = f"{value:#.{digits}g}"
    if "e" in text:
        mantissa, exponent = text.split("e")
        if 0 <= int(exponent) <= 6:
            return f"{value:.0f}"
        return f"{mantissa}e{int(exponent)}"
    return text.rstrip(".")


def spaced(unit: str) -> str:
    """A unit as it is printed: N·m for N m."""
    return unit.replace("^2", "²").replace(" ", "·")
