"""A sweep as a page: heat maps over pairs of parameters, parallel coordinates, every measure over every parameter."""

from __future__ import annotations

import html
from typing import Any

import numpy as np
from numpy.typing import NDArray

from artibot_sim.report import style
from artibot_sim.report.page import Part, breakable, filled, render_frame
from artibot_sim.report.web import numbers
from artibot_sim.sweep.measures import MEASURES
from artibot_sim.sweep.summary import MeanMap, Summary

LINES = 1_500
"""Runs that are drawn one by one."""
_FIRST = ("e_x", "e_gamma", "path_length")
"""The measure that is shown first: the first of these that there is."""


def sweep_page(summary: Summary, title: str) -> bytes:
    """The page (UTF-8) of a finished sweep."""
    measures = list(summary.spread)
    first = next((name for name in (*_FIRST, *measures) if name in measures), "")
    lines = "".join(f"<p>{html.escape(line)}</p>" for line in headlines(summary))
    options = "".join(_option(summary, name, name == first) for name in measures)
    head = filled(_HEAD, {"TITLE": html.escape(title), "LINES": lines, "OPTIONS": options})
    parts = [Part(*part) for part in _PARTS]
    parts = [*(parts if summary.maps else parts[1:]), Part("Measures", _table(summary))]
    return render_frame(title, head, parts, _FOOT, _data(summary), css=_STYLE, script=_SCRIPT, name="data")


def headlines(summary: Summary) -> list[str]:
    """What was varied, and how the runs ended."""
    plan = summary.manifest["plan"]
    ended = ", ".join(f"{count} {name}" for name, count in sorted(summary.status.items()))
    how = "grid" if plan["method"] == "grid" else f"Latin hypercube, seed {plan['seed']}"
    first = (
        f"{plan['robot']} · {', '.join(plan['manoeuvre'])} · {how} · {plan['integrator']} at {1e3 * plan['dt']:g} ms "
        f"· {summary.manifest['runs']} runs: {ended}"
    )
    return [first] + [f"{count} runs: {text}" for text, count in summary.messages if text]


def _option(summary: Summary, name: str, chosen: bool) -> str:
    unit = summary.unit(name)
    text = html.escape(f"{name}{f' ({unit})' if unit else ''}: {MEASURES[name][1]}")
    return f'<option value="{html.escape(name)}"{" selected" if chosen else ""}>{text}</option>'


def _data(summary: Summary) -> dict[str, Any]:
    """What the script draws from."""
    count = len(summary.sample["run"])
    rows = np.unique(np.linspace(0, count - 1, min(count, LINES)).astype(int)) if count else np.empty(0, int)
    names = [*summary.parameters, *summary.spread]
    return {
        "parameters": summary.parameters,
        "text": summary.manifest["text"],
        "units": {name: summary.unit(name) for name in names},
        "runs": [int(run) for run in summary.sample["run"][rows]],
        "columns": {name: _column(summary.sample[name][rows]) for name in names},
        "maps": [_map(one) for one in summary.maps],
        "look": {
            "ink": style.INK,
            "muted": style.MUTED,
            "grid": style.GRID,
            "paper": style.PAPER,
            "veil": style.VEIL,
            "fonts": style.WEB_FONTS,
        },
    }


def _column(values: NDArray[Any]) -> list[Any]:
    return numbers(values) if values.dtype.kind == "f" else values.tolist()


def _map(one: MeanMap) -> dict[str, Any]:
    return {
        "x": one.x.key, "y": one.y.key, "xs": list(one.x.labels), "ys": list(one.y.labels),
        "z": {name: [numbers(row, 5) for row in mean] for name, mean in one.mean.items()},
    }  # fmt: skip


def _table(summary: Summary) -> str:
    """Least, median, greatest of every measure, the parameter it follows most, and what it is."""
    rows = []
    for name, values in summary.spread.items():
        cells = "".join(f"<td>{value:.4g}</td>" for value in values).replace("-", "−")
        rows.append(
            f"<tr><th>{breakable(name)}</th><td>{html.escape(summary.unit(name))}</td>{cells}"
            f'<td>{html.escape(follows(summary, name))}</td><td class="what">{html.escape(MEASURES[name][1])}</td></tr>'
        )
    head = "<tr><th></th><th></th><th>least</th><th>median</th><th>greatest</th><th>follows</th><th></th></tr>"
    return f'<div class="scroll"><table><thead>{head}</thead><tbody>{"".join(rows)}</tbody></table></div>'


def follows(summary: Summary, measure: str) -> str:
    """The parameter that a measure follows most closely, with its rank correlation."""
    found = summary.strongest(measure)
    return "" if found is None else f"{found[0]} ({found[1]:+.2f})".replace("-", "−")


_STYLE = """
.choice { display: flex; flex-wrap: wrap; gap: 6px 18px; margin: 12px 0; }
.choice label { max-width: 100%; }
.choice select { font: inherit; max-width: 100%; }
.plot.tall { height: 460px; }
td.what { text-align: left; color: var(--muted); }
"""

_SCRIPT = """
const worded = name => data.units[name] ? name + " (" + data.units[name] + ")" : name;
const isText = key => data.text.includes(key);
const varied = data.parameters.filter(key => new Set(data.columns[key]).size > 1);
const base = () => ({font: {family: data.look.fonts, size: 13, color: data.look.ink}, paper_bgcolor: data.look.paper,
  plot_bgcolor: data.look.paper, margin: {l: 64, r: 16, t: 10, b: 48}, hovermode: "closest", showlegend: false});
const axis = (name, more) => Object.assign({title: {text: worded(name)}, gridcolor: data.look.grid, zeroline: false,
  automargin: true, type: isText(name) ? "category" : "-"}, more);
const measure = document.getElementById("measure"), pair = document.getElementById("pair");
data.maps.forEach((map, i) => pair.add(new Option(map.x + " × " + map.y, i)));

function heat() {
  if (!data.maps.length) return null;
  const map = data.maps[pair.value || 0], name = measure.value;
  const trace = {type: "heatmap", x: map.xs, y: map.ys, z: map.z[name], colorscale: "Viridis", hoverongaps: false,
    colorbar: {title: {text: worded(name), side: "right"}, thickness: 14},
    hovertemplate: map.x + " %{x}<br>" + map.y + " %{y}<br>" + name + " %{z:.4g}<extra></extra>"};
  return show("heat", [trace], Object.assign(base(), {xaxis: axis(map.x), yaxis: axis(map.y)}));
}

function shares(name) {  // a column as heights 0 to 1, with what stands at the ends
  const column = data.columns[name];
  if (isText(name)) {
    const names = [...new Set(column)].sort(), top = Math.max(names.length - 1, 1);
    return {y: column.map(v => names.indexOf(v) / top), marks: names.map((n, i) => [i / top, n])};
  }
  const finite = column.filter(Number.isFinite), low = Math.min(...finite), high = Math.max(...finite);
  const size = high > low ? high - low : 1;
  const text = v => String(Number(v.toPrecision(3)));
  return {y: column.map(v => Number.isFinite(v) ? (v - low) / size : null), marks: [[0, text(low)], [1, text(high)]]};
}

function parallel() {
  const names = [...varied, measure.value], all = names.map(shares), bins = 12;
  const colours = ["#440154", "#482173", "#433e85", "#38588c", "#2d708e", "#25858e", "#1e9b8a", "#2ab07f", "#52c569",
    "#86d549", "#c2df23", "#fde725"];
  const last = all[all.length - 1].y, traces = colours.map(colour => ({type: "scatter", mode: "lines", x: [], y: [],
    hoverinfo: "skip", line: {color: colour, width: 1}, opacity: 0.5}));
  data.runs.forEach((run, i) => {
    if (last[i] === null) return;
    const trace = traces[Math.min(Math.floor(last[i] * bins), bins - 1)];
    all.forEach((one, k) => { trace.x.push(k); trace.y.push(one.y[i]); });
    trace.x.push(null); trace.y.push(null);
  });
  const marks = all.flatMap((one, k) => one.marks.map(([y, text]) => ({x: k, y, text, showarrow: false, xanchor: "left",
    xshift: 4, font: {size: 12}, bgcolor: data.look.veil})));
  const layout = Object.assign(base(), {annotations: marks, yaxis: {visible: false, range: [-0.06, 1.06]},
    xaxis: {tickvals: names.map((_, k) => k), ticktext: names.map(worded), range: [-0.15, names.length - 0.6],
      gridcolor: "#9aa5b1", zeroline: false, automargin: true}});
  return show("parallel", traces, layout);
}

function scatters() {
  return varied.map((key, i) => show("over" + i, [{type: "scatter", mode: "markers", x: data.columns[key],
    y: data.columns[measure.value], text: data.runs, marker: {size: 5, opacity: 0.45, color: "#0072b2"},
    hovertemplate: "run %{text}<br>" + key + " %{x}<br>" + measure.value + " %{y:.4g}<extra></extra>"}],
    Object.assign(base(), {xaxis: axis(key), yaxis: axis(measure.value)})));
}

const grid = document.getElementById("over");
varied.forEach((key, i) => {
  const place = document.createElement("div");
  place.id = "over" + i; place.className = "plot"; grid.append(place);
});
function draw() {
  return Promise.all([heat(), parallel(), ...scatters()]).then(all => {
    document.documentElement.dataset.drawn = String(all.filter(Boolean).length);
  });
}
measure.addEventListener("change", draw);
if (pair) pair.addEventListener("change", heat);
draw();
"""

_HEAD = """<h1>@TITLE@</h1>@LINES@
<div class="choice"><label>measure <select id="measure">@OPTIONS@</select></label></div>"""

_PARTS = (
    (
        "Mean over two parameters",
        ('<div class="choice"><label>parameters <select id="pair"></select></label></div>'
        '<div id="heat" class="plot tall"></div>'),
    ),
    (
        "Parallel coordinates: a line is a run, its colour the measure", '<div id="parallel" class="plot tall"></div>',
        True, "Parallel coordinates",
    ),
    ("Over each parameter", '<div id="over" class="grid"></div>'),
)  # fmt: skip
"""Heading, HTML, whether it is open at first, and what the outline calls it; the first one needs two parameters."""

_FOOT = """<p>"Follows" is the parameter with the largest rank correlation. Heat maps are means over all runs of a cell,
which is blank where no run fell; of many runs, lines and points are an even selection.</p>"""
