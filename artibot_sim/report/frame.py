"""The frame of every page: one file with its charts, its style and plotly in it, which asks the network for nothing."""

from __future__ import annotations

import html
import json
import re
from collections.abc import Mapping
from typing import Any

from artibot_sim.report import style


def render_frame(
    title: str, head: str, main: str, foot: str, data: Any, *, css: str = "", script: str, name: str = "charts"
) -> bytes:
    """Return a page (UTF-8).

    Parameters
    ----------
    title : str
        Plain text, for the browser's window.
    head, main, foot : str
        HTML of the page's parts.
    data : object
        What the script draws from, JSON-ready: plotly figures, say.
    css : str
        Style beside that of all pages.
    script : str
        Draws the charts, and says so: ``document.documentElement.dataset.drawn`` is how many.
    name : str
        What the script calls `data`.
    """
    from plotly.offline import get_plotlyjs

    parts = {
        "TITLE": html.escape(title),
        "STYLE": page_style() + css,
        "HEAD": head,
        "MAIN": main,
        "FOOT": foot,
        "NAME": name,
        "DATA": script_json(data),
        "SCRIPT": script,
        "PLOTLY": get_plotlyjs(),
    }
    return filled(_PAGE, parts).encode()


def filled(text: str, parts: Mapping[str, str]) -> str:
    """Return a text with @NAME@ replaced; what is put in is not looked at again."""
    return re.sub("@([A-Z]+)@", lambda match: parts[match[1]], text)


def script_json(content: Any) -> str:
    """Return JSON that cannot end the script element it stands in."""
    return json.dumps(content, separators=(",", ":"), allow_nan=False, ensure_ascii=False).replace("</", "<\\/")


def page_style() -> str:
    """Return the style sheet of all pages, in the colours of `style`."""
    colours = {name: getattr(style, name) for name in ("INK", "MUTED", "GRID", "PAPER")}
    return filled(_CSS, colours | {"FONTS": style.WEB_FONTS})


_CSS = """
:root { color-scheme: light; }
* { box-sizing: border-box; }
body { margin: 0; background: @PAPER@; color: @INK@; font: 15px/1.45 @FONTS@; -webkit-text-size-adjust: 100%; }
main, header, footer { max-width: 1240px; margin: 0 auto; padding: 0 16px; }
header { padding-top: 20px; }
h1 { font-size: 1.5rem; margin: 0 0 4px; overflow-wrap: anywhere; }
h2 { font-size: 1rem; margin: 18px 0 2px; }
header p, footer { color: @MUTED@; font-size: .93rem; }
header p { margin: 2px 0; }
footer { padding-bottom: 24px; padding-top: 12px; }
.key { display: flex; flex-wrap: wrap; gap: 4px 18px; }
.key button { font: inherit; font-size: 1.15rem; color: inherit; background: none; border: 0; padding: 2px 0;
  cursor: pointer; }
.key button::before { content: ""; display: inline-block; width: 1.3em; height: .28em; margin-right: .5em;
  vertical-align: .25em; background: var(--hue); }
.key button[aria-pressed=false] { color: @MUTED@; text-decoration: line-through; }
.key button[aria-pressed=false]::before { background: @GRID@; }
.grid { display: grid; grid-template-columns: minmax(0, 1fr); gap: 0 24px; }
.plot { width: 100%; height: 270px; }
.plot.square { height: min(100vw, 560px); }
.scroll { overflow-x: auto; margin-top: 20px; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: 3px 14px 3px 0; text-align: right; white-space: nowrap; }
th:first-child, td:nth-child(2) { text-align: left; font-weight: normal; }
td:nth-child(2) { color: @MUTED@; }
thead th { font-weight: 600; border-bottom: 1px solid @GRID@; }
tr.name th { font-weight: 600; padding-top: 10px; }
@media (min-width: 860px) {
  .grid { grid-template-columns: minmax(0, 1fr) minmax(0, 1fr); }
  .wide { grid-row: span 2; }
  .both { grid-column: span 2; }
  .wide .plot.square { height: 592px; }
}
"""

_PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy"
 content="default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:">
<title>@TITLE@</title>
<style>@STYLE@</style>
</head>
<body>
<header>@HEAD@</header>
<main>@MAIN@</main>
<footer>@FOOT@</footer>
<script>const @NAME@ = @DATA@;</script>
<script>@PLOTLY@</script>
<script>@SCRIPT@</script>
</body>
</html>
"""
