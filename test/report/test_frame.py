"""The frame of all pages: an outline that stays in sight, parts that are folded, dark where the browser asks for it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from browser import Browser

from artibot_sim.report import style
from artibot_sim.report.page import Part, render_frame
from artibot_sim.report.panels import Line, Panel
from artibot_sim.report.style import Stroke
from artibot_sim.report.web import chart
from artibot_sim.report.windows import Path as Track
from artibot_sim.report.windows import WindowErrors, side_by_side


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three parts of which the last one is folded, each with a chart and much text; and a wide table."""
    x = np.linspace(0.0, 5.0, 50)
    panel = Panel("k", "t", ("time", "s"), ("y", "m"), (Line("a", "a", None, x, np.sin(x), Stroke(style.TRUE)),))
    text = "<p>Something to read.</p>" * 40
    cells = "<td>12345.678</td>" * 20
    table = f'<div class="scroll"><table><tr><th>name of a row</th>{cells}</tr></table></div>'
    parts = [
        Part(f"Part {k}", f'<div id="plot{k}" class="plot"></div>{text}{table}', k < 2, f"word{k}") for k in range(3)
    ]
    data = render_frame(
        "t", "<h1>Head</h1>", [*parts, Part("Empty", "")], "", [chart(panel, (0.0, 5.0))] * 3, script="drawParts();"
    )
    path = tmp_path_factory.mktemp("page") / "page.html"
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("width", [390, 1400])
def test_the_outline_stays_in_sight_and_opens_what_is_folded(chromium: Browser, page: Path, width: int) -> None:
    chromium.size(width, 844, phone=width < 800)
    chromium.open(page)
    assert chromium.value("document.documentElement.dataset.drawn") == "2"
    links = chromium.value("[...document.querySelectorAll('nav.outline a')].map(a => a.textContent)")
    assert links == ["word0", "word1", "word2"]  # a part with nothing in it is left out
    folded = chromium.value("document.documentElement.scrollHeight")
    chromium.value("document.querySelectorAll('nav.outline a')[2].click()")
    chromium.wait("document.documentElement.dataset.drawn === '3'")
    assert chromium.value("document.documentElement.scrollHeight") > folded + 500
    chromium.value("window.scrollTo(0, document.documentElement.scrollHeight)")
    chromium.wait("window.scrollY > 500")
    top, bottom = chromium.value(
        "(() => { const b = document.querySelector('nav.outline a').getBoundingClientRect();"
        " return [b.top, b.bottom]; })()"
    )
    assert 0 <= top < bottom <= 844
    assert chromium.value("document.documentElement.scrollWidth") <= width
    scrolls = chromium.value("(() => { const t = document.querySelector('.scroll');"
                             " return t.scrollWidth > t.clientWidth; })()")  # fmt: skip
    assert scrolls


def test_pages_are_dark_where_the_browser_asks_for_it(chromium: Browser, page: Path) -> None:
    """Page and charts, at the beginning and when the wish changes."""
    chromium.size(1000, 800)
    inside = "document.querySelector('#plot0 .main-svg').style.background"
    line = "document.querySelector('#plot0 .js-line').style.stroke"
    seen = {}
    for scheme in ("dark", "light"):
        chromium.scheme(scheme)
        if scheme == "dark":
            chromium.open(page)
        paper = style.PAPER if scheme == "light" else style.DARK[style.PAPER]
        rgb = ", ".join(str(int(paper[i : i + 2], 16)) for i in (1, 3, 5))
        chromium.wait(f"{inside} === 'rgb({rgb})'")
        assert chromium.value("getComputedStyle(document.body).backgroundColor") == f"rgb({rgb})"
        seen[scheme] = chromium.value(line)
    assert seen["dark"] != seen["light"]


def test_a_page_is_small(page: Path) -> None:
    assert page.stat().st_size < 2_000_000


def test_windows_are_ranked_and_begin_alike() -> None:
    """However a window lies on its map, it is drawn from the origin on, along x."""
    rng = np.random.default_rng(5)
    drives = []
    for k in range(21):
        turn, start = rng.uniform(-3.0, 3.0), rng.uniform(-50.0, 50.0, 2)
        way = np.linspace(0.0, 2.0, 30)
        points = start + way[:, None] * np.array([np.cos(turn), np.sin(turn)])
        off = points + 0.01 * k * (way / 2.0)[:, None] * np.array([-np.sin(turn), np.cos(turn)])
        stroke = Stroke(style.TRUE)
        drives.append(
            WindowErrors(float(k), 0.01 * k, [Track("measured", points, stroke), Track("model", off, stroke)])
        )
    rng.shuffle(drives)
    typical, bad, worst = side_by_side("run", drives)
    for panel, error in ((typical, 0.10), (bad, 0.18), (worst, 0.20)):
        measured, predicted = panel.lines
        assert np.allclose(measured.y, 0.0, atol=1e-9) and measured.x[-1] == pytest.approx(2.0)
        assert predicted.y[-1] == pytest.approx(error) and f"{100 * error:.1f} cm" in panel.title
    assert len(side_by_side("run", drives[:1])) == 1 and not side_by_side("run", [])


def test_windows_in_which_the_rover_stands_are_no_typical_ones() -> None:
    rng, stroke = np.random.default_rng(6), Stroke(style.TRUE)
    drives = [WindowErrors(0.0, 0.3, [Track("measured", np.linspace((0.0, 0.0), (2.0, 0.0), 9), stroke)])]
    for k in range(20):
        drives.append(WindowErrors(1.0 + k, 0.01, [Track("measured", 0.005 * rng.standard_normal((9, 2)), stroke)]))
    (only,) = side_by_side("run", drives)
    assert "30.0 cm" in only.title
