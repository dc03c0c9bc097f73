"""A diagnosis on the terminal."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from artibot_sim.diagnose import words
from artibot_sim.identify.printing import number, spaced

if TYPE_CHECKING:
    from artibot_sim.diagnose.diagnosis import Diagnosis

_ROWS = 8
"""Effects that the ranking lists."""


def printed(found: Diagnosis) -> Any:
    """Sentences and tables, for a rich console."""
    from rich.console import Group
    from rich.text import Text

    parts: list[Any] = [Text(words.headline(found), style="bold"), Text(words.sureness(found)), Text("")]
    for table in (_ranking(found), _parameters(found), _gain(found)):
        if table.row_count:
            parts += [table, Text("")]
    return Group(*parts, *(Text(line) for line in _lines(found)))


def as_text(found: Diagnosis) -> str:
    """The same as plain text."""
    from io import StringIO

    from rich.console import Console

    out = StringIO()
    Console(file=out, width=118, highlight=False).print(printed(found))
    return out.getvalue()


def _table(title: str, *columns: str, left: int = 1) -> Any:
    """An empty table; all but the first `left` columns hold numbers."""
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=None, header_style="bold", pad_edge=False)
    for i, column in enumerate(columns):
        table.add_column(column, justify="left" if i < left else "right", overflow="fold")
    return table


def _ranking(found: Diagnosis) -> Any:
    table = _table("Causes", "effect", "", "log10 Bayes factor", left=2)
    named = {cause.effect for cause in found.causes}
    tied = {name for cause in found.causes for name in cause.ties}
    order = sorted(found.ranking, key=lambda c: (c.effect not in named, -c.log10_bayes_factor))
    for candidate in order[:_ROWS]:
        role = "found" if candidate.effect in named else "ties" if candidate.effect in tied else ""
        style = "bold" if role else None
        evidence = f"{candidate.log10_bayes_factor:.1f}".replace("-", "−")
        table.add_row(words.effect_words(candidate.effect), role, evidence, style=style)
    return table


def _parameters(found: Diagnosis) -> Any:
    table = _table("Parameters", "effect", "parameter", "value", "95 %", "unit", left=2)
    for cause in found.causes:
        for name, p in cause.parameters.items():
            value = p.value if isinstance(p.value, str) else number(p.value)
            interval = f"{number(p.ci95[0])} … {number(p.ci95[1])}" if p.ci95 else ""
            table.add_row(words.effect_words(cause.effect), name, value, interval, spaced(p.unit))
    return table


def _gain(found: Diagnosis) -> Any:
    title = f"RMSE of predictions {number(found.horizon, 2)} s ahead"
    columns = ["channel", "unit", "noise", "paper's model"]
    if found.causes:
        title += f"; before and after: {'held-out data' if found.holdout else 'the fitted data'}"
        columns += ["before", "after", "before − after, 95 %"]
    table = _table(title, *columns, left=2)
    for channel, base in found.baseline.items():
        gain = found.gain.get(channel)
        after = ("", "", "") if found.causes else ()
        if gain is not None and found.causes:
            low, high = gain.ci95
            after = number(gain.before, 3), number(gain.after, 3), f"{number(low, 3)} … {number(high, 3)}"
        noise, rmse = number(base.noise, 3), number(base.rmse, 3)
        table.add_row(words.channel_words(channel), spaced(base.unit), noise, rmse, *after)
    return table


def _lines(found: Diagnosis) -> Iterator[str]:
    """What there is to say besides."""
    for place in found.where:
        yield f"{words.channel_words(place.channel)}: {place.what}"
    if found.unexplained is not None:
        yield f"not on the list: {found.unexplained.where}"
    if found.next_experiment is not None:
        yield f"measure next: {found.next_experiment.what}"
    for warning in found.warnings:
        yield f"warning: {warning}"
    if question := words.asked(found):
        yield question
    fitted = f"fitted: {', '.join(found.bags)}"
    held = f"; held out: {', '.join(found.holdout)}" if found.holdout else ""
    yield f"{fitted}{held}; {found.seconds:.1f} s"
