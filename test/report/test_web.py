"""The page: plotly's data are the figure's, it needs nothing from outside, and a browser draws it."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from report_helpers import circle, data_of, expanded, recording

from artibot_sim.experiment import Experiment
from artibot_sim.model import MOTORS, Robot
from artibot_sim.report.figures import experiment_figure
from artibot_sim.report.page import compact, render_page
from artibot_sim.report.panels import Figure
from artibot_sim.report.web import MOST_POINTS, chart, numbers, thinned

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


def traces(panel_chart: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """The traces that carry data of a recording, by name."""
    return {trace["name"]: trace for trace in panel_chart["data"] if "meta" in trace}


@pytest.mark.parametrize("several", [False, True])
def test_traces_are_the_lines(runs: list[Experiment], agriq: Robot, several: bool) -> None:
    which = runs if several else runs[:1]
    figure = experiment_figure(which, [agriq] * len(which))
    for panel in figure.panels:
        found = traces(chart(panel, figure.time_span))
        assert list(found) == [line.name for line in panel.lines]
        for line in panel.lines:
            trace = found[line.name]
            for name, values in (("x", line.x), ("y", line.y)):
                fine = 1e-5 * float(np.nanmax(values) - np.nanmin(values))
                assert np.allclose(np.array(trace[name], float), values, rtol=1e-6, atol=fine, equal_nan=True)
            assert trace["connectgaps"] is False
            assert line.stroke.colour in (trace.get("line", {}).get("color"), trace.get("marker", {}).get("color"))


def test_plotly_knows_every_attribute(runs: list[Experiment], agriq: Robot) -> None:
    go = pytest.importorskip("plotly.graph_objects")
    for panel in experiment_figure(runs, [agriq, agriq]).panels:
        drawn = chart(panel, (0.0, 1.0))
        assert len(go.Figure(drawn).data) == len(drawn["data"])  # it refuses unknown names and values


def test_each_legend_entry_stands_for_lines(run: Experiment, agriq: Robot) -> None:
    for panel in experiment_figure([run], [agriq]).panels:
        data = chart(panel, (0.0, 1.0))["data"]
        groups = {trace["legendgroup"] for trace in data if "meta" in trace}
        entries = [trace for trace in data if trace["showlegend"] and "legendgroup" in trace]
        assert {trace["legendgroup"] for trace in entries} == groups
        assert len({trace["name"] for trace in entries}) == len(entries)


@given(st.lists(st.floats(allow_infinity=False), max_size=30))
def test_numbers_are_json(values: list[float]) -> None:
    found = json.loads(json.dumps(numbers(np.array(values, float)), allow_nan=False))
    assert len(found) == len(values)
    for value, kept in zip(values, found, strict=True):
        assert (kept is None) == np.isnan(value)
        if kept is not None:
            assert kept == pytest.approx(value, rel=1e-6, abs=0)


@given(st.integers(2, 4000), st.integers(0, 2**31), st.booleans())
def test_thinning_keeps_extremes_ends_and_gaps(count: int, seed: int, broken: bool) -> None:
    rng = np.random.default_rng(seed)
    x, y = np.arange(count, dtype=float), rng.normal(size=count)
    if broken:
        x[count // 2] = y[count // 2] = np.nan
    kept_x, kept_y = thinned(x, y, most=200)
    assert len(kept_x) <= max(200, min(count, 200)) + 3
    if np.isfinite(y).any():
        assert np.nanmax(kept_y) == np.nanmax(y) and np.nanmin(kept_y) == np.nanmin(y)
    assert np.isnan(kept_y).sum() == np.isnan(y).sum()
    inside = np.isfinite(kept_x)
    assert (np.diff(kept_x[inside]) > 0).all()
    assert np.array_equal(kept_y[inside], y[kept_x[inside].astype(int)])


def page_of(figure: Figure) -> str:
    return render_page(figure, [("run", [("path length", "m", ("1", "2", "3"))])], ("a", "b", "c"), ["a note"]).decode()


def test_the_page_needs_nothing_from_outside(run: Experiment, agriq: Robot) -> None:
    text = page_of(experiment_figure([run], [agriq]))
    assert "default-src 'none'" in text  # so a browser would refuse what there were
    assert not re.search(r"<(script|link|img|iframe)[^>]+(src|href)\s*=", text)


NUMBERS = st.one_of(st.none(), st.integers(-(10**6), 10**6), st.floats(allow_nan=False, allow_infinity=False))
ROUNDED = st.builds(lambda whole, digits: whole / 10.0**digits, st.integers(-(10**9), 10**9), st.integers(0, 7))


@given(st.lists(st.one_of(NUMBERS, ROUNDED), max_size=60), st.lists(ROUNDED, min_size=30, max_size=60))
def test_numbers_written_as_differences_are_the_same(some: list[float | None], rounded: list[float]) -> None:
    data = {"some": some, "rounded": [*rounded, None], "words": ["a"] * 40, "truth": [True] * 40, "deep": [{"x": some}]}
    assert expanded(json.loads(json.dumps(compact(data)))) == data
    assert compact([round(0.01 * k, 2) for k in range(30)]) == {"~": [2, 0, *[1] * 29]}, "steps of a clock"


def test_a_page_with_many_long_lines_stays_below_two_megabytes(tmp_path: Path) -> None:
    t = 0.01 * np.arange(20_000)
    rng = np.random.default_rng(0)
    columns = [f"{motor}.{what}" for motor in MOTORS for what in ("velocity", "effort")]
    motors = {name: 100.0 * np.sin(0.01 * t) + rng.normal(size=len(t)) for name in columns}
    channels = {"odom": (t, circle(t, 2.0, 0.3)), "motor_torques": (t, motors)}
    figure = experiment_figure([recording(tmp_path / "run", channels)])
    text = page_of(figure)
    assert len(text) < 2_000_000
    assert any(len(trace["x"]) > 1_000 for one in data_of(text) for trace in one["data"])


def test_a_page_says_that_it_thinned_long_lines(tmp_path: Path) -> None:
    for count, said in ((1_000, False), (MOST_POINTS + 2, True)):
        t = 0.01 * np.arange(count)
        figure = experiment_figure([recording(tmp_path / f"run{count}", {"odom": (t, circle(t, 2.0, 0.3))})])
        assert ("Lines of more than 3 000 samples are drawn" in page_of(figure)) == said
        assert all(
            len(trace["x"]) <= MOST_POINTS + 2 for panel in figure.panels for trace in chart(panel, (0, 1))["data"]
        )


def test_names_cannot_break_the_page(tmp_path: Path) -> None:
    t = np.arange(0.0, 2.0, 0.05)
    nasty = '</script><b>@CHARTS@ & "run"'
    run = recording(tmp_path / "run", {"odom": (t, circle(t, 2.0, 0.3))}, {"description": nasty})
    text = page_of(experiment_figure([run]))
    head = text[: text.index("<script>")]
    assert "<b>" not in head
    assert "&lt;b&gt;@CHARTS@ &amp; &quot;run&quot;" in head


def browser() -> str:
    """A Chromium; the test is skipped, saying so, where there is none."""
    for name in BROWSERS:
        if shutil.which(name):
            return name
    pytest.skip(f"no browser ({', '.join(BROWSERS)}) is installed; as root: apt-get install chromium")


def opened(page: Path, profile: Path) -> tuple[str, list[str]]:
    """The page's DOM once its scripts have run, and what they wrote to the console."""
    done = subprocess.run(
        [
            browser(), "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-sync",
            "--disable-background-networking", "--disable-component-update", "--disable-dev-shm-usage",
            f"--user-data-dir={profile}", "--enable-logging=stderr", "--window-size=1200,2400",
            "--virtual-time-budget=10000", "--dump-dom", page.as_uri(),
        ],
        capture_output=True, text=True, timeout=120, check=True,
    )  # fmt: skip
    return done.stdout, [line for line in done.stderr.splitlines() if "CONSOLE" in line]


@pytest.mark.parametrize("several", [False, True])
def test_a_browser_draws_it(tmp_path: Path, runs: list[Experiment], agriq: Robot, several: bool) -> None:
    which = runs if several else runs[:1]
    figure = experiment_figure(which, [agriq] * len(which))
    page = tmp_path / "page.html"
    page.write_text(page_of(figure), encoding="utf-8")
    dom, console = opened(page, tmp_path / "profile")
    assert not console
    assert f'data-drawn="{len(figure.panels)}"' in dom
    lines = sum(line.stroke.dash != "points" for panel in figure.panels for line in panel.lines)
    curves = re.findall(r'<path class="js-line"[^>]* d="(M[^"]+)"', dom)
    assert len([curve for curve in curves if len(curve) > 100]) >= lines
    for panel in figure.panels:
        assert f">{panel.x_label}<" in dom and f">{panel.y_label}<" in dom


def test_a_fault_in_a_page_would_be_seen(tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    page.write_text("<!DOCTYPE html><p>x</p><script>nowhere.to.be.found()</script>", encoding="utf-8")
    dom, console = opened(page, tmp_path / "profile")
    assert "<p>x</p>" in dom
    assert any("nowhere is not defined" in line for line in console)
