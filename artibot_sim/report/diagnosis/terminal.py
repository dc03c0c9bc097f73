"""A diagnosis on the terminal: its sentences, and tables of causes, parameters, errors and models."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from artibot_sim.diagnose.result import Diagnosis
from artibot_sim.diagnose.words import channel_words, effect_words, law_words
from artibot_sim.identify.result import number, spaced
from artibot_sim.report.diagnosis.sentences import (
    budget_words,
    explainable_words,
    headline,
    next_step,
    not_named,
    sureness,
    threshold_words,
    varies_words,
)

_ROWS = 8
"""Effects that the ranking lists."""


def printed(found: Diagnosis) -> Any:
    """Sentences and tables: what `rich.print` shows."""
    from rich.console import Group
    from rich.text import Text

    parts: list[Any] = [*map(Text, found.findings), *([Text("")] if found.findings else [])]
    parts += [Text(headline(found), style="bold"), Text(sureness(found))]
    parts += [Text(unnamed)] if (unnamed := not_named(found)) else []
    for more in (explainable_words(found), varies_words(found), budget_words(found)):
        parts += [Text(f"{more[:1].upper()}{more[1:]}")] if more else []
    parts += [Text(""), *(Text(f"warning: {warning}") for warning in found.warnings)]
    parts += [Text("")] if found.warnings else []
    for table in (_ranking(found), _parameters(found), _gain(found), _predictors(found)):
        if table.row_count:
            parts += [table, Text("")]
    return Group(*parts, *(Text(line) for line in _lines(found)))


def _table(title: str, *columns: str, left: int = 1) -> Any:
    """An empty table; all but the first `left` columns hold numbers."""
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=None, header_style="bold", pad_edge=False)
    for i, column in enumerate(columns):
        table.add_column(column, justify="left" if i < left else "right", overflow="fold")
    return table


def _ranking(found: Diagnosis) -> Any:
    columns = ["effect", "", "log10 Bayes factor"]
    partial = any(candidate.windows < 1.0 for candidate in found.ranking)
    table = _table("Causes", *columns, *(["of the windows"] if partial else []), left=2)
    named = {cause.effect for cause in found.causes}
    tied = {name for cause in found.causes for name in cause.ties}
    order = sorted(found.ranking, key=lambda c: (c.effect not in named, -c.log10_bayes_factor))
    for candidate in order[:_ROWS]:
        role = "found" if candidate.effect in named else "ties" if candidate.effect in tied else ""
        style = "bold" if role else None
        evidence = f"{candidate.log10_bayes_factor:.1f}".replace("-", "−")
        share = [f"{100 * candidate.windows:.0f} %"] if partial else []
        table.add_row(effect_words(candidate.effect), role, evidence, *share, style=style)
    return table


def _parameters(found: Diagnosis) -> Any:
    table = _table("Parameters", "effect", "parameter", "value", "95 %", "unit", left=2)
    for cause in found.causes:
        for name, p in cause.parameters.items():
            value = p.value if isinstance(p.value, str) else number(p.value)
            interval = f"{number(p.ci95[0])} … {number(p.ci95[1])}" if p.ci95 else ""
            table.add_row(effect_words(cause.effect), name, value, interval, spaced(p.unit))
    return table


def _gain(found: Diagnosis) -> Any:
    title = f"RMSE of predictions {number(found.horizon, 2)} s ahead"
    columns = ["channel", "unit", "noise", "paper's model"]
    if found.extends:
        title += f"; before and after: {'held-out data' if found.holdout else 'the fitted data'}"
        columns += ["before", "after", "before − after, 95 %"]
    table = _table(title, *columns, left=2)
    for channel, base in found.baseline.items():
        gain = found.gain.get(channel)
        after = ("", "", "") if found.extends else ()
        if gain is not None and found.extends:
            after = _less(gain.before, gain.after, gain.ci95)
        noise, rmse = number(base.noise, 3), number(base.rmse, 3)
        table.add_row(channel_words(channel), spaced(base.unit), noise, rmse, *after)
        if gain is not None and found.extends and np.isfinite(gain.median_before):
            table.add_row(
                "  median window",
                spaced(base.unit),
                "",
                "",
                *_less(gain.median_before, gain.median_after, gain.median_ci95),
            )
    return table


def _less(before: float, after: float, ci95: tuple[float, float]) -> tuple[str, str, str]:
    low, high = ci95
    return number(before, 3), number(after, 3), f"{number(low, 3)} … {number(high, 3)}"


def _predictors(found: Diagnosis) -> Any:
    """Held-out errors of every model; the one in best.yaml is marked."""
    title = f"Held-out recordings, errors at the ends of predictions {number(found.horizon, 2)} s ahead"
    table = _table(title, "model", "", "position (m)", "heading (rad)", left=2)
    for one in found.predictors:
        cells = [number(one.errors[name].rmse, 3) if name in one.errors else "" for name in ("position", "yaw")]
        table.add_row(one.name, "best.yaml" if one.name == found.best else "", *cells)
    return table


def _lines(found: Diagnosis) -> Iterator[str]:
    """What there is to say besides."""
    for place in found.where:
        yield f"{channel_words(place.channel)}: {place.what}"
    if found.unexplained is not None:
        yield f"not on the list: {found.unexplained.where}"
        for name, law in found.unexplained.laws.items():
            yield f"{'as a law' if found.refusal else 'in extended.yaml'}, {name}: {law_words(law)}"
    yield f"next: {next_step(found)}"
    if question := threshold_words(found):
        yield question
    fitted = f"fitted: {', '.join(found.bags)}"
    held = f"; held out: {', '.join(found.holdout)}" if found.holdout else ""
    yield f"{fitted}{held}; {found.seconds:.1f} s"
