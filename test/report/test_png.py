"""Pictures: size, contents, legends beside the data, and no trace left in matplotlib."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path

import matplotlib
import numpy as np
import pytest

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment import Experiment
from artibot_sim.model import Robot
from artibot_sim.report import png, style
from artibot_sim.report.figures import experiment_figure
from artibot_sim.report.panels import Panel
from artibot_sim.report.picture import hero
from artibot_sim.report.png import place, render_png


def dimensions(data: bytes) -> tuple[int, int]:
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    width, height = struct.unpack(">II", data[16:24])
    return width, height


def test_a_picture_is_1800_pixels_wide(run: Experiment, runs: list[Experiment], agriq: Robot) -> None:
    one, two = (render_png(experiment_figure(which, [agriq] * len(which))) for which in ([run], runs))
    assert dimensions(one)[0] == dimensions(two)[0] == 1800
    assert dimensions(one)[1] < dimensions(two)[1]  # a panel a motor


def test_matplotlib_is_left_as_it_was(run: Experiment, agriq: Robot) -> None:
    before = dict(matplotlib.rcParams)
    render_png(experiment_figure([run], [agriq]))
    assert dict(matplotlib.rcParams) == before


def test_the_same_figure_gives_the_same_bytes(run: Experiment, agriq: Robot) -> None:
    figure = experiment_figure([run], [agriq])
    assert render_png(figure) == render_png(figure)


def drawn(monkeypatch: pytest.MonkeyPatch, figure: object) -> object:
    """The matplotlib figure as it is when it is written."""
    caught = []
    monkeypatch.setattr(png, "to_png", lambda canvas, dpi: (canvas.canvas.draw(), caught.append(canvas), b"")[2])
    render_png(figure)  # type: ignore[arg-type]
    return caught[0]


def test_rounding_is_drawn_as_the_number_that_it_is_around(
    monkeypatch: pytest.MonkeyPatch, run: Experiment, agriq: Robot
) -> None:
    """A rover that stands still does not seem to drive: its path and yaw are no wider than rounding."""
    figure = experiment_figure([run], [agriq])
    still = tuple(
        replace(panel, lines=tuple(replace(line, y=1e-17 * line.y) for line in panel.lines), outlines=(), arrows=())
        for panel in figure.panels
    )
    canvas = drawn(monkeypatch, replace(figure, panels=still))
    for axes in canvas.axes:  # type: ignore[attr-defined]
        assert np.ptp(axes.get_ylim()) > 0.05


@pytest.mark.parametrize("several", [False, True])
def test_panels_hold_the_lines_and_nothing_covers_them(
    monkeypatch: pytest.MonkeyPatch, runs: list[Experiment], agriq: Robot, several: bool
) -> None:
    which = runs if several else runs[:1]
    figure = experiment_figure(which, [agriq] * len(which))
    canvas = drawn(monkeypatch, figure)
    boxes = [axes.get_window_extent() for axes in canvas.axes]  # type: ignore[attr-defined]
    heading = [text.get_window_extent() for text in canvas.texts]  # type: ignore[attr-defined]
    for axes, panel in zip(canvas.axes, figure.panels, strict=True):  # type: ignore[attr-defined]
        curves = {line.get_label(): line for line in axes.get_lines()}
        for line in panel.lines:
            x, y = curves[f"_{line.name}"].get_data()
            assert np.array_equal(x, line.x, equal_nan=True)
            assert np.array_equal(y, line.y, equal_nan=True)
        assert not panel.timed or axes.get_xlim() == figure.time_span
        assert (axes.get_xlabel(), axes.get_ylabel()) == (panel.x_label, panel.y_label)
        legend, title = axes.get_legend(), axes._left_title.get_window_extent()
        assert not any(title.overlaps(box) for box in [*boxes, *heading])
        if legend is not None:
            covered = legend.get_window_extent().padded(-1)
            assert not any(covered.overlaps(box) for box in [*boxes, *heading, title])
    tightened = canvas.get_tightbbox()  # type: ignore[attr-defined]
    assert tightened.x0 >= 0 and tightened.x1 <= png.WIDTH  # nothing is cut off


@pytest.mark.parametrize("equal", [True, False])
@pytest.mark.parametrize("count", range(1, 9))
def test_panels_fill_the_picture_without_overlap(count: int, equal: bool) -> None:
    panels = [Panel(f"p{i}", "", ("", ""), ("", ""), (), equal=equal and i == 0) for i in range(count)]
    cells = place(panels)
    taken = [(row, column) for rows, columns in cells for row in range(rows.start, rows.stop)
             for column in range(columns.start, columns.stop)]  # fmt: skip
    last = max(row for row, _ in taken) + 1
    assert sorted(taken) == [(row, column) for row in range(last) for column in (0, 1)]


def test_titles_of_neighbours_do_not_overlap(run: Experiment, agriq: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    figure = experiment_figure([run], [agriq])
    long = "husky_drive_b: a typical window (50 % err by no more): from 1069.0 s on, 20.2 cm off at the end of it"
    canvas = drawn(monkeypatch, replace(figure, panels=tuple(replace(panel, title=long) for panel in figure.panels)))
    titles = [axes._left_title.get_window_extent() for axes in canvas.axes]
    assert len(titles) > 2
    for i, one in enumerate(titles):
        assert one.x1 < canvas.bbox.x1
        assert not any(one.overlaps(other) for other in titles[i + 1 :])


def test_the_picture_of_the_readme(runs: list[Experiment], tmp_path: Path) -> None:
    target = tmp_path / "table6.png"
    hero(runs, target)
    width, height = dimensions(target.read_bytes())
    assert width / height > 2
    assert target.stat().st_size < 200_000
    assert [path.name for path in tmp_path.iterdir()] == ["table6.png"]


def test_the_picture_needs_torques(run: Experiment, tmp_path: Path) -> None:
    with pytest.raises(ArtibotError, match="torque_front_right"):
        hero([run], tmp_path / "one.png")  # a single recording has no panels by motor
    assert not list(tmp_path.iterdir())


def test_strokes_reach_the_picture() -> None:
    assert png.line_style(style.Stroke("#123456", 2.0, "dash"))["color"] == "#123456"
    assert png.line_style(style.Stroke("#123456", 2.0, "points"))["ls"] == "none"
