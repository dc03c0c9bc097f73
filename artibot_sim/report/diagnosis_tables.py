"""The tables of a diagnosis' page, as HTML."""

from __future__ import annotations

import html
from collections.abc import Sequence

import numpy as np

from artibot_sim.diagnose import words
from artibot_sim.diagnose.diagnosis import Candidate, Diagnosis, Found, Unexplained
from artibot_sim.identify.printing import number, spaced
from artibot_sim.model.effects import EFFECTS
from artibot_sim.model.effects.base import Choice
from artibot_sim.report.diagnosis_charts import interval


def table(columns: Sequence[str], rows: Sequence[tuple[str, Sequence[str]]], text: int = 1) -> str:
    """A table; cells are HTML.

    Parameters
    ----------
    columns : sequence of str
        Headings, plain text.
    rows : sequence of (class, cells)
    text : int
        So many columns at the left hold text, the others numbers.
    """
    if not rows:
        return ""
    head = "".join(f"<th{_left(i, text)}>{html.escape(column)}</th>" for i, column in enumerate(columns))
    body = []
    for name, cells in rows:
        first = f'<th scope="row" class="text">{cells[0]}</th>'
        rest = "".join(f"<td{_left(i, text)}>{cell}</td>" for i, cell in enumerate(cells[1:], 1))
        body.append(f'<tr class="{name}">{first}{rest}</tr>')
    return f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{"".join(body)}</tbody></table></div>'


def _left(column: int, text: int) -> str:
    return ' class="text"' if column < text else ""


def figure(value: float, digits: int = 3) -> str:
    """A number as a cell."""
    return number(value, digits).replace("-", "−") if np.isfinite(value) else "–"


def baseline(found: Diagnosis) -> str:
    """Every channel's error of the paper's model against its noise."""
    rows = []
    for name, base in found.baseline.items():
        ratio = base.rmse / base.noise if base.noise > 0 else float("nan")
        cells = (
            html.escape(words.channel_words(name)), html.escape(spaced(base.unit)), figure(base.noise),
            figure(base.rmse), figure(ratio, 2), figure(base.free_run_rmse),
        )  # fmt: skip
        rows.append(("", cells))
    return table(("channel", "unit", "noise", "RMSE", "÷ noise", "RMSE of free runs"), rows, 2)


def gain(found: Diagnosis) -> str:
    """What each channel gains on held-out data."""
    rows = []
    for name, g in found.gain.items():
        low, high = g.ci95
        less = 100 * words.lost(g)
        interval_ = f"{figure(low)} … {figure(high)}"
        cells = (
            html.escape(words.channel_words(name)), html.escape(spaced(g.unit)), figure(g.before),
            figure(g.after), f"{less:.0f} %".replace("-", "−"), interval_,
        )  # fmt: skip
        rows.append(("", cells))
    return table(("channel", "unit", "before", "after", "less by", "before − after, 95 %"), rows, 2)


def parameters(found: Diagnosis) -> str:
    """Every parameter of every cause, with its interval."""
    rows = []
    for cause in found.causes:
        for i, (name, p) in enumerate(cause.parameters.items()):
            effect = html.escape(words.effect_words(cause.effect)) if i == 0 else ""
            rows.append(("found" if i == 0 else "", (effect, *_parameter(cause.effect, name, p))))
    docs = [_physics(cause.effect) for cause in found.causes if cause.effect in EFFECTS]
    columns = ("effect", "parameter", "value", "unit", "95 %", "from neutral (dashed)")
    return "".join(docs) + table(columns, rows, 2)


def _physics(effect: str) -> str:
    """What an effect is, in a paragraph."""
    said = EFFECTS[effect].doc.replace("`", "")
    return f"<p><b>{html.escape(words.effect_words(effect))}</b>: {html.escape(said)}</p>"


def _parameter(effect: str, name: str, p: Found) -> tuple[str, ...]:
    said = html.escape(words.effect_words(name))
    if isinstance(p.value, str):
        return said, html.escape(words.effect_words(p.value)), "", "", ""
    between = f"{figure(p.ci95[0], 4)} … {figure(p.ci95[1], 4)}" if p.ci95 else ""
    drawn = interval(p.value, p.ci95, neutral(effect, name))
    return said, figure(p.value, 4), html.escape(spaced(p.unit)), between, drawn


def neutral(effect: str, name: str) -> float:
    """Where a parameter's effect is absent; NaN where that is no number, or the parameter says no size."""
    declared = EFFECTS.get(effect)
    if declared is None or name not in list(declared.parameters)[: declared.sizes]:
        return float("nan")
    value = declared.parameters[name].neutral
    return float("nan") if isinstance(value, str) else float(value)


def unit_of(effect: str, name: str) -> str:
    """Unit of an effect's parameter; empty where it has none."""
    declared = EFFECTS.get(effect)
    if declared is None or name not in declared.parameters:
        return ""
    quantity = declared.parameters[name].quantity
    return "" if isinstance(quantity, Choice) else quantity.unit


def ranking(found: Diagnosis) -> str:
    """Every effect, best first."""
    named = {cause.effect for cause in found.causes}
    tied = {name for cause in found.causes for name in cause.ties}
    rows = []
    for c in sorted(found.ranking, key=lambda c: (c.effect not in named, -c.log10_bayes_factor)):
        role = "found" if c.effect in named else "ties" if c.effect in tied else ""
        how = "fitted" if c.fitted else "screened"
        cells = (
            html.escape(words.effect_words(c.effect)), role, f"{c.log10_bayes_factor:.1f}".replace("-", "−"), how,
            html.escape(_values(c)), f'<span class="wrap">{html.escape(c.note)}</span>',
        )  # fmt: skip
        rows.append((role, cells))
    return table(("effect", "", "log10 Bayes factor", "", "best at", ""), rows, 2)


def _values(candidate: Candidate) -> str:
    said = []
    for name, value in candidate.values.items():
        if isinstance(value, str):
            said.append(words.effect_words(value))
        else:
            said.append(f"{words.effect_words(name)} {words.amount(value, unit_of(candidate.effect, name), 3)}")
    return ", ".join(said).replace("-", "−")


def excluded(found: Diagnosis) -> str:
    """Sizes that are excluded of effects that were not found."""
    rows = []
    for candidate in found.ranking:
        names = (*candidate.excluded_above, *candidate.excluded_below)
        said = words.excluded_words(candidate, {name: unit_of(candidate.effect, name) for name in names})
        if not said:
            continue
        rows.append(("", (html.escape(words.effect_words(candidate.effect)), html.escape(said))))
    return table(("effect", "excluded"), rows, 2)


def unexplained(what: Unexplained) -> str:
    """What acts and is on no list."""
    rows = [
        ("", (label, f'<span class="wrap">{html.escape(text)}</span>'))
        for label, text in (
            ("force", words.effect_words(what.force)), ("follows", words.effect_words(what.variable)),
            ("form", what.form), ("size", words.amount(what.size, what.unit, 3)), ("where", what.where),
        )
    ]  # fmt: skip
    return table(("not on the list", ""), rows, 2)
