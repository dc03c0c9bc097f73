"""A diagnosis as a page: what is wrong, where, why, how sure, what it gains, and what to measure next."""

from __future__ import annotations

import html
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from artibot_sim.diagnose.records import DECADE, Candidate, EffectEstimate, Unexplained
from artibot_sim.diagnose.result import Diagnosis
from artibot_sim.diagnose.verdict import Verdict
from artibot_sim.diagnose.words import (
    amount,
    channel_words,
    effect_words,
    excluded_words,
    joined,
    law_words,
    lost_share,
    odds,
    windows_words,
)
from artibot_sim.identify.result import number, spaced
from artibot_sim.model.effects import EFFECTS
from artibot_sim.model.effects.base import Choice
from artibot_sim.report.diagnosis import charts, sentences
from artibot_sim.report.diagnosis.charts import interval
from artibot_sim.report.page import Part, findings_list, listed, render_frame
from artibot_sim.report.panels import Panel, extent
from artibot_sim.report.web import chart

# ----------------------------------------------------------------------
# Style and script of a diagnosis' page.
# ----------------------------------------------------------------------


CSS = """
h1 { font-size: 1.55rem; line-height: 1.25; max-width: 62ch; }
h3 { font-size: .98rem; margin: 12px 0 0; }
main p, main li { max-width: 84ch; }
main p { color: var(--muted); margin: 4px 0; }
header p.sure { color: inherit; max-width: 84ch; font-size: 1rem; }
header p.verdict { display: inline-block; margin: 0 0 6px; padding: 1px 10px; border-radius: 10px; color: var(--paper);
  font-weight: 600; background: var(--muted); }
header p.verdict.named { background: var(--good); } header p.verdict.ambiguous { background: var(--tie); }
header p.verdict.unexplained { background: var(--bad); }
p.next { color: inherit; font-weight: 600; }
ul { padding-left: 1.2em; margin: 6px 0; } li { margin: 4px 0; overflow-wrap: anywhere; }
ul.said li::first-letter { text-transform: uppercase; }
header ul.causes { font-size: 1.15rem; font-weight: 600; margin: 4px 0 10px; padding-left: 1.2em; }
details details { margin: 8px 0; } details details summary { cursor: pointer; padding: 4px 0; color: var(--good); }
.first, .row, .grid3 { display: grid; grid-template-columns: minmax(0, 1fr); gap: 0 24px; }
.plot.square { height: min(92vw, 460px); }
.plot.low { height: 230px; } .plot.bars { height: 380px; }
table td:nth-child(2) { color: inherit; text-align: right; }
.wrap { display: inline-block; white-space: normal; min-width: 14em; max-width: min(56em, 78vw); text-align: left; }
table td.text.text { text-align: left; } th.text { text-align: left; }
tr.found td, tr.found th { font-weight: 600; } tr.ties th { color: var(--tie); }
svg.ci { display: block; }
@media (max-width: 600px) { h1 { font-size: 1.25rem; } header ul.causes { font-size: 1rem; }
  header ul.causes li { margin: 1px 0; } }
@media (min-width: 860px) {
  .first { grid-template-columns: minmax(0, 11fr) minmax(0, 9fr); }
  .first .plot.square { height: 500px; }
  .row { grid-template-columns: repeat(2, minmax(0, 1fr)); }
  .grid3 { grid-template-columns: repeat(3, minmax(0, 1fr)); }
  .grid3 .plot.square { height: 330px; } .grid3 .plot { height: 240px; }
  .row .plot.bars { height: 420px; }
}
@media print {
  body { font-size: 11pt; } main, header, footer { max-width: none; padding: 0; }
  .cell, table, li { break-inside: avoid; } h2, h3 { break-after: avoid; }
  details:not([open]) { display: none; } summary { list-style: none; color: inherit; font-weight: 600; }
  .scroll { overflow: visible; } th, td { padding-right: 8px; font-size: 9.5pt; }
  .first, .row, .grid3 { grid-template-columns: repeat(2, minmax(0, 1fr)); }
}
"""

SCRIPT = """
drawParts();
function fit(width) {  // a sheet of paper has room for two columns of this, px; null is as wide as the screen has room
  for (const place of shown.keys()) Plotly.relayout(place, {width: width, autosize: width === null});
}
function unfold() { for (const rest of document.querySelectorAll("header details")) rest.open = true; }
window.addEventListener("beforeprint", () => { unfold(); fit(340); });
window.addEventListener("afterprint", () => fit(null));
"""


# ----------------------------------------------------------------------
# The tables of a diagnosis' page, as HTML.
# ----------------------------------------------------------------------


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
        cells = (
            html.escape(channel_words(name)), html.escape(spaced(base.unit)), figure(base.noise),
            figure(base.rmse), figure(base.over_noise, 2), figure(base.free_run_rmse),
        )  # fmt: skip
        rows.append(("", cells))
    return table(("channel", "unit", "noise", "RMSE", "÷ noise", "RMSE of free runs"), rows, 2)


def gain(found: Diagnosis) -> str:
    """What each channel gains on held-out data."""
    rows = []
    for name, g in found.gain.items():
        whole = (channel_words(name), g.before, g.after, g.ci95)
        middle = (f"{channel_words(name)}, median window", g.median_before, g.median_after, g.median_ci95)
        for words, before, after, (low, high) in (whole, middle) if math.isfinite(g.median_before) else (whole,):
            less = 100 * lost_share(before, after)
            cells = (
                html.escape(words), html.escape(spaced(g.unit)), figure(before), figure(after),
                f"{less:.0f} %".replace("-", "−"), f"{figure(low)} … {figure(high)}",
            )  # fmt: skip
            rows.append(("", cells))
    return table(("channel", "unit", "before", "after", "less by", "before − after, 95 %"), rows, 2)


def parameters(found: Diagnosis) -> str:
    """Every parameter of every cause, with its interval."""
    rows = []
    for cause in found.causes:
        for i, (name, p) in enumerate(cause.parameters.items()):
            effect = html.escape(effect_words(cause.effect)) if i == 0 else ""
            rows.append(("found" if i == 0 else "", (effect, *_parameter(cause.effect, name, p))))
    docs = [_physics(cause.effect) for cause in found.causes if cause.effect in EFFECTS]
    columns = ("effect", "parameter", "value", "unit", "95 %", "from neutral (dashed)")
    return "".join(docs) + table(columns, rows, 2)


def _physics(effect: str) -> str:
    """What an effect is, in a paragraph."""
    said = EFFECTS[effect].doc.replace("`", "")
    return f"<p><b>{html.escape(effect_words(effect))}</b>: {html.escape(said)}</p>"


def _parameter(effect: str, name: str, p: EffectEstimate) -> tuple[str, ...]:
    said = html.escape(effect_words(name))
    if isinstance(p.value, str):
        return said, html.escape(effect_words(p.value)), "", "", ""
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
        how = ", ".join(filter(None, ("fitted" if c.fitted else "screened", windows_words(c))))
        cells = (
            html.escape(effect_words(c.effect)), role, f"{c.log10_bayes_factor:.1f}".replace("-", "−"), how,
            html.escape(_values(c)), f'<span class="wrap">{html.escape(c.note)}</span>',
        )  # fmt: skip
        rows.append((role, cells))
    return table(("effect", "", "log10 Bayes factor", "", "best at", ""), rows, 2)


def _values(candidate: Candidate) -> str:
    said = []
    for name, value in candidate.values.items():
        if isinstance(value, str):
            said.append(effect_words(value))
        else:
            said.append(f"{effect_words(name)} {amount(value, unit_of(candidate.effect, name), 3)}")
    return ", ".join(said).replace("-", "−")


def excluded(found: Diagnosis) -> str:
    """Sizes that are excluded of effects that were not found."""
    rows = []
    for candidate in found.ranking:
        names = (*candidate.excluded_above, *candidate.excluded_below)
        said = excluded_words(candidate, {name: unit_of(candidate.effect, name) for name in names})
        if not said:
            continue
        rows.append(("", (html.escape(effect_words(candidate.effect)), html.escape(said))))
    return table(("effect", "excluded"), rows, 2)


def predictors(found: Diagnosis) -> str:
    """Held-out errors of every model."""
    rows = []
    for one in found.predictors:
        cells = [figure(one.errors[name].rmse) if name in one.errors else "" for name in ("position", "yaw")]
        best = one.name == found.best
        rows.append(("found" if best else "", (html.escape(one.name) + (" (best.yaml)" if best else ""), *cells)))
    return table(("model", "position (m)", "heading (rad)"), rows)


def unexplained(what: Unexplained) -> str:
    """What acts and is on no list."""
    rows = [
        ("", (label, f'<span class="wrap">{html.escape(text)}</span>'))
        for label, text in (
            ("force", effect_words(what.force)), ("follows", effect_words(what.variable)),
            ("form", what.form), ("size", amount(what.size, what.unit, 3)), ("where", what.where),
            *((f"as a law, {name}", law_words(law)) for name, law in what.laws.items()),
        )
    ]  # fmt: skip
    if what.laws:
        text = f"Fitted beside the soil: log10 Bayes factor {figure(what.log10_bayes_factor)}."
        rows.append(("", ("evidence", text)))
    return table(("not on the list", ""), rows, 2)


# ----------------------------------------------------------------------
# A diagnosis as a page: what is wrong, where, why, how sure, what it gains, and what to measure next.
# ----------------------------------------------------------------------


HINT = (
    "Drag over a chart to zoom in, double-click for all; click on a legend to hide a line. "
    "With #all at the end of the address every part is open, for printing."
)
_MANY = 3
"""Causes that are listed one below the other, not in a sentence."""
_VERDICTS = {
    Verdict.NONE: "nothing found", Verdict.NAMED: "cause found", Verdict.AMBIGUOUS: "several causes tie",
    Verdict.UNEXPLAINED: "not on the list",
}  # fmt: skip


def page_of(found: Diagnosis, version: str) -> bytes:
    """The page (UTF-8) of a diagnosis."""
    page = _Page(_as_drawn(found))
    parts = (
        *_opening(page), _data(found), _wrong(page), _where(page), _why(page), _parameters(found), _gains(page),
        _next(found), _free_runs(page), _excluded(found),
    )  # fmt: skip
    head = (
        f"{findings_list(found.findings)}"
        f'<p class="verdict {found.verdict.value}">{html.escape(_answer(found))}</p>'
        f"{_headline(found)}"
        f'<p class="sure"><b>Next:</b> {html.escape(sentences.next_step(found))}</p>'
        f'<p class="sure">{html.escape(sentences.sureness(found))}</p>'
        f"{paragraph(sentences.not_named(found), 'sure')}"
        f"{_more(found)}"
    )
    title = f"{found.robot.name}: {_answer(found)}"
    return render_frame(title, head, parts, _foot(found, version), page.charts, css=CSS, script=SCRIPT)


def _headline(found: Diagnosis) -> str:
    """The answer in one sentence; of many causes a list, below what all of them are worth."""
    causes = sentences.cause_phrases(found)
    if len(causes) < _MANY or found.unexplained is not None:
        return f"<h1>{html.escape(sentences.headline(found))}</h1>"
    causes[-1] += sentences.which_words(found)
    gained = f"{len(causes)} causes. {sentences.gain_words(found)}".strip()
    return f"<h1>{html.escape(gained)}</h1>{listed([f'{one[:1].upper()}{one[1:]}' for one in causes], 'causes')}"


def _answer(found: Diagnosis) -> str:
    """The verdict in a few words."""
    ties = {bool(cause.ties) for cause in found.causes}
    if found.verdict in (Verdict.NAMED, Verdict.AMBIGUOUS) and len(ties) == 2:
        return "cause found, another one ties"
    return _VERDICTS[found.verdict]


def _more(found: Diagnosis) -> str:
    """How well predictions could be at best, what varies, and where errors come from, as paragraphs of the head."""
    said = {
        "How much is explainable": sentences.explainable_words(found),
        "What varies": sentences.varies_words(found),
        "Where errors come from": sentences.budget_words(found),
    }
    return "".join(f'<p class="sure"><b>{head}:</b> {html.escape(words)}</p>' for head, words in said.items() if words)


def _as_drawn(found: Diagnosis) -> Diagnosis:
    """The diagnosis without an extended model where it has nothing more: it is the paper's, and would cover it."""
    if found.extends:
        return found
    comparisons = tuple(
        replace(
            run, after=(), free_after=(),
            channels={name: replace(one, after=np.full_like(one.after, np.nan)) for name, one in run.channels.items()},
        )
        for run in found.comparisons
    )  # fmt: skip
    gain = {name: replace(one, after=float("nan")) for name, one in found.gain.items()}
    return replace(found, comparisons=comparisons, gain=gain)


class _Page:
    """A diagnosis and the charts that its page has so far."""

    def __init__(self, found: Diagnosis) -> None:
        self.found = found
        self.charts: list[dict[str, Any]] = []
        self.channel = sentences.headline_channel(found)
        self.wrong = charts.wrong_channels(found)

    def place(
        self, drawing: Mapping[str, Any] | Panel | None, title: str = "", kind: str = "plot", legend: bool = True
    ) -> str:
        """HTML of the place of a chart; empty for None."""
        if drawing is None:
            return ""
        if isinstance(drawing, Panel):
            title = title or drawing.title
            kind = "plot square" if drawing.equal else kind
            drawing = chart(drawing, extent([line.x for line in drawing.lines]))
            drawing["layout"] |= {"hovermode": "closest", "showlegend": legend}
        self.charts.append(dict(drawing))
        head = f"<h3>{html.escape(title)}</h3>" if title else ""
        return f'<div class="cell">{head}<div id="plot{len(self.charts) - 1}" class="{kind}"></div></div>'

    def row(self, cells: Iterable[str], name: str = "row") -> str:
        """Charts side by side, where there is room; empty without charts."""
        inside = "".join(cells)
        return f'<div class="{name}">{inside}</div>' if inside else ""


_NONE = Part("", "")
"""A part with nothing to say, which a page leaves out."""


def section(title: str, *parts: str, opened: bool = True, word: str = "") -> Part:
    """A part of the page; empty if it has nothing to say."""
    return Part(title, "".join(parts), opened, word)


def folded(title: str, *parts: str) -> str:
    """A part that is opened by a click."""
    inside = "".join(parts)
    return f"<details><summary>{html.escape(title)}</summary>{inside}</details>" if inside else ""


def paragraph(text: str, name: str = "") -> str:
    """A paragraph of plain text."""
    return f'<p class="{name}">{html.escape(text)}</p>' if text else ""


def _first_screen(page: _Page) -> Part:
    """The picture under the sentence: measured, paper's model, extended model; and all channels beside it."""
    found = page.found
    run = charts.clearest(found, page.channel) if page.channel else None
    cells, windows = [], ""
    if run is not None and len(run.path):
        held = "held out" if run.held_out else "fitted"
        if charts.in_map(run):
            cells.append(page.place(charts.path(run, f"{run.name} ({held}), predicted {found.horizon:g} s ahead")))
        else:
            title = f"{run.name} ({held}), windows of {found.horizon:g} s: a typical, a bad and the worst one"
            drawn = page.row([page.place(one) for one in charts.windows(run)], "grid3")
            windows = f"<h3>{html.escape(title)}</h3>{drawn}"
    beside = page.place(charts.before_and_after(found), "Errors against the sensors' noise", "plot low")
    over = ""
    if run is not None and page.channel is not None and page.channel in run.channels:
        over = page.place(charts.over_time(found, run, page.channel), kind="plot low")
    if windows:
        return Part("", windows + page.row([beside, over]))
    cells.append(f'<div class="beside">{beside}{over}</div>')
    return Part("", page.row(cells, "first"))


def _opening(page: _Page) -> tuple[Part, Part]:
    """Pictures and the table of models; the table first for a robot without articulation, where kinematics may do."""
    picture, models = _first_screen(page), _predictors(page.found)
    return (picture, models) if page.found.robot.articulated else (models, picture)


def _predictors(found: Diagnosis) -> Part:
    """All models side by side."""
    text = (
        f"Errors (RMSE) on held-out data at the ends of predictions {found.horizon:g} s ahead. The best dynamic model "
        "is in best.yaml, for prediction only: it claims no cause."
    )
    inside = predictors(found)
    return section("Which model predicts best", paragraph(text), inside, word="Models") if inside else _NONE


def _wrong(page: _Page) -> Part:
    """Channels against their noise, and errors over time."""
    found = page.found
    text = (
        f"Predictions {found.horizon:g} s ahead by the paper's model with its soil identified from the same recordings."
        " With ÷ noise at 1 they are as good as the sensor; there each error counts by its own sample's noise, which is"
        " larger where a torque or a rate jumps between samples."
    )
    parts = [paragraph(text), baseline(found)]
    for run in found.comparisons:
        cells = [page.place(charts.over_time(found, run, name)) for name in found.baseline if name in run.channels]
        parts.append(folded(f"Errors over time: {run.name}{' (held out)' if run.held_out else ''}", page.row(cells)))
    return section("What is wrong", *parts, opened=False)


def _where(page: _Page) -> Part:
    """Sentences, the map, and errors over what the rover did."""
    found = page.found
    parts = []
    for channel in dict.fromkeys(place.channel for place in found.where):
        said = [place.what for place in found.where if place.channel == channel]
        parts.append(f"<h3>{html.escape(channel_words(channel)).capitalize()}</h3>{listed(said, 'said')}")
    if not found.where:
        parts.append(paragraph("No channel is wrong by much more than its noise."))
    shown = page.wrong or ([page.channel] if page.channel else [])
    for index, channel in enumerate(shown):
        title = f"The error of the {channel_words(channel)} on the map"
        cells = [page.place(charts.error_map(found, channel), title, "plot square")]
        over = charts.over_covariates(found, channel)
        cells += [page.place(panel, legend=i == 0) for i, panel in enumerate(over)]
        row = page.row(cells, "grid3")
        name = channel_words(channel)
        parts.append(row if index == 0 else folded(f"The same for the {name}", row))
    return section("Where and when", *parts, opened=False)


def _why(page: _Page) -> Part:
    """Evidence of all effects."""
    found = page.found
    if not found.ranking:
        return _NONE
    text = (
        "Evidence against the model without the effect, of both views together: ground motion and torques for motors "
        "that turn as measured, motor speeds for given commands."
    )
    parts = [paragraph(text), page.row([page.place(charts.evidence(found), kind="plot bars")])]
    if found.unexplained is not None:
        parts.append(unexplained(found.unexplained))
        curves = [charts.law_curve(found.unexplained, name) for name in found.unexplained.laws]
        parts.append(page.row([page.place(curve, legend=False) for curve in curves if curve is not None]))
        if found.unexplained.residuals:
            parts.append(paragraph(
                "The line is the law. Dots are what the recordings ask for there, whatever its form: the law and the "
                "forces that it leaves over, with 95 % intervals."
            ))  # fmt: skip
    parts.append(folded(f"All {len(found.ranking)} effects", ranking(found)))
    return section("Why", *parts)


def _parameters(found: Diagnosis) -> Part:
    return section("Parameters", parameters(found)) if found.causes else _NONE


def _gains(page: _Page) -> Part:
    found = page.found
    if not found.gain or not found.extends:
        return _NONE
    where = f"on held-out data ({', '.join(found.holdout)})" if found.holdout else "on data held out"
    text = (
        f"Predictions {found.horizon:g} s ahead {where}: the paper's model, its soil identified, and the extended one."
    )
    return section("What it gains", paragraph(text), gain(found))


def _next(found: Diagnosis) -> Part:
    what = found.next_experiment
    if what is None:
        return _NONE
    said = [paragraph(what.what, "next")]
    if what.separates:
        between = joined([effect_words(name) for name in what.separates])
        sure = odds(what.nats / DECADE)
        said.append(paragraph(f"It would separate {between} by {what.nats:.0f} nats ({sure})."))
    return section("What to measure next", *said)


def _data(found: Diagnosis) -> Part:
    return section("Doubts about the data", listed(found.warnings, "warnings")) if found.warnings else _NONE


def _free_runs(page: _Page) -> Part:
    """Whole runs from their start, with the branch that each took."""
    comparisons = [run for run in page.found.comparisons if run.free_before]
    if not comparisons:
        return _NONE
    text = (
        "Whole recordings in one run from their start. The model has several branches (which wheels slide): a run that "
        "takes another one than the rover did goes astray with every parameter right, so none of this is evidence."
    )
    cells = [page.place(charts.path(run, f"{run.name}: free runs", free=True)) for run in comparisons]
    return section(
        "Free runs", paragraph(text), listed(sentences.branch_words(page.found)), page.row(cells), opened=False
    )


def _excluded(found: Diagnosis) -> Part:
    inside = excluded(found)
    text = (
        "Effects that were not found, and the sizes that these recordings exclude: departures from the paper's model "
        "from so much on, limits below so much, a patch for nine tenths of the ground driven on. An effect that is not "
        "here may have any size."
    )
    if found.verdict is Verdict.UNEXPLAINED:
        text += " That holds beside what is on no list only as far as that neither hides an effect nor looks like one."
    return section("What it is not", paragraph(text), inside, opened=False) if inside else _NONE


def _foot(found: Diagnosis, version: str) -> str:
    held = f"; held out: {', '.join(found.holdout)}" if found.holdout else ""
    said = [
        f"Robot {found.robot.name}; fitted: {', '.join(found.bags)}{held}; seed {found.seed}; {found.seconds:.0f} s."
    ]
    said += [asked] if (asked := sentences.threshold_words(found)) else []
    return "".join(map(paragraph, (*said, HINT, f"artibot {version}")))
