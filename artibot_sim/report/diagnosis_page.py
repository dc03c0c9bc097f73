"""A diagnosis as a page: what is wrong, where, why, how sure, what it gains, and what to measure next."""

from __future__ import annotations

import html
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from artibot_sim.diagnose import words
from artibot_sim.diagnose.diagnosis import Diagnosis, Verdict
from artibot_sim.report import diagnosis_charts as charts
from artibot_sim.report import diagnosis_panels as panels
from artibot_sim.report import diagnosis_tables as tables
from artibot_sim.report import style
from artibot_sim.report.diagnosis_look import CSS, SCRIPT
from artibot_sim.report.frame import filled, render_frame
from artibot_sim.report.panels import Panel, extent
from artibot_sim.report.web import chart

HINT = (
    "Drag over a chart to zoom in, double-click for all; click on a legend to hide a line. "
    "With #all at the end of the address every part is open, for printing."
)
_VERDICTS = {
    Verdict.NONE: "nothing found", Verdict.NAMED: "cause found", Verdict.AMBIGUOUS: "several causes tie",
    Verdict.UNEXPLAINED: "not on the list",
}  # fmt: skip


def page_of(found: Diagnosis, version: str) -> bytes:
    """The page (UTF-8) of a diagnosis."""
    page = _Page(_as_drawn(found))
    body = "".join(
        (
            _first_screen(page), _wrong(page), _where(page), _why(page), _parameters(found), _gains(page), _next(found),
            _data(found), _free_runs(page), _excluded(found),
        )
    )  # fmt: skip
    head = (
        f'<p class="verdict {found.verdict.value}">{html.escape(_VERDICTS[found.verdict])}</p>'
        f"<h1>{html.escape(words.headline(found))}</h1>"
        f'<p class="sure">{html.escape(words.sureness(found))}</p>'
    )
    colours = {"GRID": style.GRID, "MUTED": style.MUTED, "GOOD": style.TRUE, "BAD": style.ODOMETRIC, "TIE": style.LEFT}
    title = f"{found.robot.name}: {_VERDICTS[found.verdict]}"
    return render_frame(title, head, body, _foot(found, version), page.charts, css=filled(CSS, colours), script=SCRIPT)


def _as_drawn(found: Diagnosis) -> Diagnosis:
    """The diagnosis without an extended model where nothing is named: that is the paper's, and would cover it."""
    if found.causes:
        return found
    looks = tuple(
        replace(
            look, after=(), free_after=(),
            channels={name: replace(one, after=np.full_like(one.after, np.nan)) for name, one in look.channels.items()},
        )
        for look in found.looks
    )  # fmt: skip
    gain = {name: replace(one, after=float("nan")) for name, one in found.gain.items()}
    return replace(found, looks=looks, gain=gain)


class _Page:
    """A diagnosis and the charts that its page has so far."""

    def __init__(self, found: Diagnosis) -> None:
        self.found = found
        self.charts: list[dict[str, Any]] = []
        self.channel = words.headline_channel(found)
        self.wrong = panels.wrong_channels(found)

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


def section(title: str, *parts: str) -> str:
    """A part of the page, empty if it has nothing to say."""
    inside = "".join(parts)
    return f"<section><h2>{html.escape(title)}</h2>{inside}</section>" if inside else ""


def folded(title: str, *parts: str) -> str:
    """A part that is opened by a click."""
    inside = "".join(parts)
    return f"<details><summary>{html.escape(title)}</summary>{inside}</details>" if inside else ""


def paragraph(text: str, name: str = "") -> str:
    """A paragraph of plain text."""
    return f'<p class="{name}">{html.escape(text)}</p>' if text else ""


def listed(lines: Sequence[str], name: str = "") -> str:
    """A list of plain texts."""
    inside = "".join(f"<li>{html.escape(line)}</li>" for line in lines)
    return f'<ul class="{name}">{inside}</ul>' if inside else ""


def _first_screen(page: _Page) -> str:
    """The picture under the sentence: measured, paper's model, extended model; and all channels beside it."""
    found = page.found
    look = panels.telling_look(found, page.channel) if page.channel else None
    cells = []
    if look is not None and len(look.path):
        held = "held out" if look.held_out else "fitted"
        cells.append(page.place(panels.path(look, f"{look.name} ({held}), predicted {found.horizon:g} s ahead")))
    beside = page.place(charts.before_and_after(found), "Errors against the sensors' noise", "plot low")
    if look is not None and page.channel is not None and page.channel in look.channels:
        beside += page.place(panels.over_time(found, look, page.channel), kind="plot low")
    cells.append(f'<div class="beside">{beside}</div>')
    return page.row(cells, "first")


def _wrong(page: _Page) -> str:
    """Channels against their noise, and errors over time."""
    found = page.found
    text = (
        f"Predictions {found.horizon:g} s ahead by the paper's model with its soil identified from the same recordings."
        " With ÷ noise at 1 they are as good as the sensor."
    )
    parts = [paragraph(text), tables.baseline(found)]
    for look in found.looks:
        cells = [page.place(panels.over_time(found, look, name)) for name in found.baseline if name in look.channels]
        parts.append(folded(f"Errors over time: {look.name}{' (held out)' if look.held_out else ''}", page.row(cells)))
    return section("What is wrong", *parts)


def _where(page: _Page) -> str:
    """Sentences, the map, and errors over what the rover did."""
    found = page.found
    parts = []
    for channel in dict.fromkeys(place.channel for place in found.where):
        said = [place.what for place in found.where if place.channel == channel]
        parts.append(f"<h3>{html.escape(words.channel_words(channel)).capitalize()}</h3>{listed(said, 'said')}")
    if not found.where:
        parts.append(paragraph("No channel is wrong by much more than its noise."))
    shown = page.wrong or ([page.channel] if page.channel else [])
    for index, channel in enumerate(shown):
        title = f"The error of the {words.channel_words(channel)} on the map"
        cells = [page.place(charts.error_map(found, channel), title, "plot square")]
        over = panels.over_covariates(found, channel)
        cells += [page.place(panel, legend=i == 0) for i, panel in enumerate(over)]
        row = page.row(cells, "grid3")
        name = words.channel_words(channel)
        parts.append(row if index == 0 else folded(f"The same for the {name}", row))
    return section("Where and when", *parts)


def _why(page: _Page) -> str:
    """Evidence of all effects."""
    found = page.found
    if not found.ranking:
        return ""
    text = (
        "Evidence against the model without the effect, of both views together: ground motion and torques for motors "
        "that turn as measured, motor speeds for given commands."
    )
    parts = [paragraph(text), page.row([page.place(charts.evidence(found), kind="plot bars")])]
    if found.unexplained is not None:
        parts.append(tables.unexplained(found.unexplained))
    parts.append(folded(f"All {len(found.ranking)} effects", tables.ranking(found)))
    return section("Why", *parts)


def _parameters(found: Diagnosis) -> str:
    return section("Parameters", tables.parameters(found)) if found.causes else ""


def _gains(page: _Page) -> str:
    found = page.found
    if not found.gain or not found.causes:
        return ""
    where = f"on held-out data ({', '.join(found.holdout)})" if found.holdout else "on data held out"
    text = (
        f"Predictions {found.horizon:g} s ahead {where}: the paper's model, its soil identified, and the extended one."
    )
    return section("What it gains", paragraph(text), tables.gain(found))


def _next(found: Diagnosis) -> str:
    what = found.next_experiment
    if what is None:
        return ""
    said = [paragraph(what.what, "next")]
    if what.separates:
        between = words.joined([words.effect_words(name) for name in what.separates])
        odds = words.odds(what.nats / charts.LOG10)
        said.append(paragraph(f"It would separate {between} by {what.nats:.0f} nats ({odds})."))
    return section("What to measure next", *said)


def _data(found: Diagnosis) -> str:
    return section("Doubts about the data", listed(found.warnings, "warnings")) if found.warnings else ""


def _free_runs(page: _Page) -> str:
    """Whole runs from their start, with the branch that each took."""
    looks = [look for look in page.found.looks if look.free_before]
    if not looks:
        return ""
    text = (
        "Whole recordings in one run from their start. The model has several branches (which wheels slide): a run that "
        "takes another one than the rover did goes astray with every parameter right, so none of this is evidence."
    )
    cells = [page.place(panels.path(look, f"{look.name}: free runs", free=True)) for look in looks]
    return section("Free runs", paragraph(text), listed(words.branch_words(page.found)), page.row(cells))


def _excluded(found: Diagnosis) -> str:
    inside = tables.excluded(found)
    text = (
        "Effects that were not found, and the sizes that these recordings exclude: departures from the paper's model "
        "from so much on, limits below so much, a patch for nine tenths of the ground driven on. An effect that is not "
        "here may have any size."
    )
    if found.verdict is Verdict.UNEXPLAINED:
        text += " That holds beside what is on no list only as far as that neither hides an effect nor looks like one."
    return section("What it is not", paragraph(text), inside) if inside else ""


def _foot(found: Diagnosis, version: str) -> str:
    held = f"; held out: {', '.join(found.holdout)}" if found.holdout else ""
    said = [
        f"Robot {found.robot.name}; fitted: {', '.join(found.bags)}{held}; seed {found.seed}; {found.seconds:.0f} s."
    ]
    said += [asked] if (asked := words.asked(found)) else []
    return "".join(map(paragraph, (*said, HINT, f"artibot {version}")))
