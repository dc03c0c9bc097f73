"""The command, its page and its pictures."""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from report_helpers import data_of

from artibot_sim.cli import main
from artibot_sim.reproduce import section3, section5, section6, section7
from artibot_sim.reproduce.page import _chart, lines, render, render_sheet, render_summary
from artibot_sim.reproduce.result import Section

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


@pytest.fixture(scope="module")
def sections(circles: section6.Study, runs: section7.Study) -> list[Section]:
    return [section3.section3(), section5.section5(quick=True), section6.written(circles), section7.written(runs)]


@pytest.fixture(scope="module")
def page(sections: list[Section]) -> str:
    return render(sections, "0").decode()


def charts(sections: list[Section]) -> list:
    return [item for section in sections for sheet in section.sheets for row in sheet.rows for item in row]


def test_the_page_has_everything_and_needs_nothing(sections: list[Section], page: str) -> None:
    for section in sections:
        assert section.verdict in page
        assert all(html.escape(sentence) in page for sentence in section.short)
        assert page.count("does not hold</b>") == sum(not s.holds for sec in sections for s in sec.statements)
    assert len(set(re.findall(r'id="plot(\d+)"', page))) == len(charts(sections))
    markup = re.sub(r"<script>.*?</script>", "", page, flags=re.S)
    assert not re.search(r'(?:src|href)="(?!#)', markup)
    assert data_of(page)  # JSON knows no NaN


def test_the_page_begins_folded_under_its_summary(page: str) -> None:
    """Whole it is longer than a phone's screen twenty times."""
    parts = re.findall(r'<details class="part"[^>]*>', page)
    assert len(parts) == 5 and not any(" open" in part for part in parts)
    assert "`" not in re.sub(r"<script.*?</script>", "", page, flags=re.S)


def test_plotly_knows_every_attribute(sections: list[Section]) -> None:
    go = pytest.importorskip("plotly.graph_objects")
    for item in charts(sections):
        drawn = _chart(item)
        assert len(go.Figure(drawn).data) == len(drawn["data"])


def test_each_sheet_is_a_picture(sections: list[Section]) -> None:
    for sheet in (sections[1].sheets[0], sections[2].sheets[-1]):  # maps, curves
        data = render_sheet(sheet)
        assert data[:8] == b"\x89PNG\r\n\x1a\n"
        assert int.from_bytes(data[16:20], "big") == 1650
    assert render_sheet(sheet) == data  # the same numbers, the same bytes


def test_the_summary_has_every_statement_and_every_cell(sections: list[Section]) -> None:
    for section in sections:
        text = " ".join(" ".join(line.split()) for line, _, _ in lines(section))
        for statement in section.statements:
            assert f"{'holds' if statement.holds else 'does not hold'}: {statement.claim}" in text
            assert statement.evidence in text
        for cell in (cell for table in section.tables for row in table.rows for cell in row):
            assert " ".join(cell.split()) in text
        assert max(len(line) for line, _, _ in lines(section)) < 180  # what fits in the picture
    assert render_summary(sections[1])[:4] == b"\x89PNG"


def test_a_browser_draws_the_page(page: str, tmp_path: Path) -> None:
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        pytest.skip("no chromium or chrome to draw the page with; install one")
    target = tmp_path / "page.html"
    target.write_text(page)
    result = subprocess.run(
        [browser, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}",
         "--virtual-time-budget=20000", "--dump-dom", f"{target.as_uri()}#all"],
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    expected = len(set(re.findall(r'id="plot(\d+)"', page)))
    assert f'data-drawn="{expected}"' in result.stdout


def test_the_command_writes_page_pictures_and_numbers(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "new" / "folder"
    assert main(["reproduce", "--section", "5", "--quick", "--out", str(out)]) == 0
    assert {path.name for path in out.iterdir()} == {
        "reproduction.html",
        "reproduction.json",
        "fig6.png",
        "section5.png",
    }
    numbers = json.loads((out / "reproduction.json").read_text())
    assert list(numbers) == ["5", "the_paper"] and len(numbers["5"]["statements"]) == 4
    assert numbers["5"]["verdict"] in capsys.readouterr().out


def test_a_folder_that_cannot_be_made_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("")
    assert main(["reproduce", "--section", "5", "--quick", "--out", str(tmp_path / "file" / "x")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert main(["reproduce", "--section", "8"]) == 2
