"""The picture at the head of the README: the paper's Table 6 trajectory, driven with three shares of traction.

``python -m artibot_sim.report.picture`` draws it anew from simulations (`make pictures`).
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click
import numpy as np

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment import Experiment, read_bag, write_experiment
from artibot_sim.report import style
from artibot_sim.report.figures import experiment_figure
from artibot_sim.report.files import write_files
from artibot_sim.report.measures import measure
from artibot_sim.report.panels import Figure, Panel
from artibot_sim.report.png import draw_arrows, draw_outline, line_style, new_canvas, to_png

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

KAPPAS = (0.6, 0.8, 1.0)
_SIZE = (10.0, 4.6)
_DPI = 140
_SCALE = 1.0
"""Length of the drawn scale, m."""
_TOP = 0.75
"""Upper end of the torque axis, N·m: short peaks where the curvature jumps run out of it."""


def table6_runs(folder: Path) -> list[Experiment]:
    """Simulate an Agri.q on the trajectory of Table 6 and return the runs, written below `folder`."""
    from artibot_sim.model import Status, load_robot, rollout
    from artibot_sim.planning import load_manoeuvre, plan

    runs = []
    for kappa in KAPPAS:
        rover = load_robot("agriq").replace({"control.kappa": kappa})
        planned = plan(load_manoeuvre("table6_agriq"), rover)
        result = rollout(rover, planned.commands())
        if result.status is not Status.OK:
            raise ArtibotError(f"agriq with kappa {kappa:g}: the simulation ended early: {result.message}")
        runs.append(read_bag(write_experiment(folder / f"kappa_{kappa:g}", result, planned, rover)))
    return runs


def hero(experiments: Sequence[Experiment], path: Path) -> None:
    """Draw runs of one robot along one plan, as a wide PNG.

    Parameters
    ----------
    experiments : sequence of Experiment
        They differ in kappa; each with a plan, a true pose and motor torques. The rover is drawn where the first
        one is.
    path : Path
        File to write.

    Raises
    ------
    ArtibotError
        If a run lacks what is to be drawn, or the file cannot be written.
    """
    import matplotlib

    from artibot_sim.model import load_robot

    robots = [load_robot(experiment.metadata.get("robot", "agriq")) for experiment in experiments]
    figure = experiment_figure(experiments, robots)
    for key in ("path", "torque_front_right"):
        if key not in figure:
            raise ArtibotError(f"{experiments[0].path}: the picture needs the panel '{key}'; there is {figure.missing}")
    with matplotlib.rc_context(style.matplotlib_style()):
        canvas = new_canvas(*_SIZE)
        _draw_path(canvas.add_axes((0.01, 0.02, 0.6, 0.96)), figure["path"])
        _draw_key(canvas, figure, experiments)
        _draw_torque(canvas.add_axes((0.68, 0.13, 0.305, 0.36)), figure["torque_front_right"])
        write_files({path: to_png(canvas, _DPI)})


def _draw_path(axes: Axes, panel: Panel) -> None:
    """Draw paths and rovers to scale, with a scale instead of axes."""
    for rover in panel.outlines:
        draw_outline(axes, rover)
    for line in panel.lines:
        if line.kind in ("planned", "true"):
            axes.plot(line.x, line.y, **line_style(line.stroke))
    for arrows in panel.arrows[:1]:
        draw_arrows(axes, arrows)
    axes.plot(*panel.starts.T, "o", ms=6, mfc=style.PAPER, mec=style.INK, mew=1.4, zorder=5)
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.03)
    axes.set_axis_off()
    axes.autoscale_view()
    corners = np.concatenate([polygon for rover in panel.outlines for polygon in rover.wheels])
    x, y = corners[:, 0].min(), corners[:, 1].max() - 0.1
    axes.plot([x, x + _SCALE], [y, y], color=style.INK, lw=2, solid_capstyle="butt")
    axes.text(x + _SCALE / 2, y - 0.1, f"{_SCALE:g} m", ha="center", va="top", fontsize=9)


def _draw_key(canvas: Canvas, figure: Figure, experiments: Sequence[Experiment]) -> None:
    """Write what the colours mean and how far each run is off the plan."""
    left, top, step = 0.635, 0.94, 0.07
    canvas.text(left, top, "Agri.q on the trajectory of Table 6", fontsize=11, fontweight="bold", va="center")
    columns = (left + 0.045, left + 0.24, left + 0.35)
    for x, head in zip(columns[1:], ("yaw, eq. 31", "position, eq. 32"), strict=True):
        canvas.text(x, top - step, head, fontsize=9, color=style.MUTED, va="center", ha="right")
    rows: list[tuple[style.Stroke, str, tuple[str, ...]]] = [
        (style.shared(style.track_stroke("planned", None)), "planned", ())
    ]
    for (_, colour), experiment in zip(figure.key, experiments, strict=True):
        measures = measure(experiment)
        texts = tuple(
            f"{100 * values['true']:.1f} %".replace("-", "−") if "true" in values else ""
            for values in (measures.e_gamma, measures.e_x)
        )
        rows.append((style.Stroke(colour, 1.9), f"simulated, κ = {experiment.metadata.get('kappa', '?')}", texts))
    for number, (stroke, name, texts) in enumerate(rows, 1):
        y = top - number * step
        _swatch(canvas, left, y, stroke)
        canvas.text(columns[0], y, name, fontsize=9.5, va="center")
        for x, text in zip(columns[1:], texts, strict=False):
            canvas.text(x, y, text, fontsize=9.5, va="center", ha="right")


def _swatch(canvas: Canvas, x: float, y: float, stroke: style.Stroke) -> None:
    from matplotlib.lines import Line2D

    canvas.add_artist(Line2D([x, x + 0.033], [y, y], transform=canvas.transFigure, **line_style(stroke)))


def _draw_torque(axes: Axes, panel: Panel) -> None:
    for line in panel.lines:
        axes.plot(line.x, line.y, **line_style(line.stroke))
    for level in panel.levels:
        axes.axhline(level.value, **line_style(level.stroke))
        if level.name:
            axes.text(line.x[-1], level.value, "limit ", ha="right", va="bottom", fontsize=8.5, color=style.MUTED)
    axes.set_xlim(line.x[0], line.x[-1])
    axes.set_ylim(-0.15, _TOP)
    axes.set_title(f"{panel.title} (N·m)", fontsize=9.5, fontweight="normal", pad=6)
    axes.set_xlabel(panel.x_label, fontsize=9)


@click.command("picture")
@click.option("--out", type=click.Path(path_type=Path), default=Path("docs/images"), show_default=True, help="Folder.")
def command(out: Path) -> None:
    """Draw the README's pictures from simulations.

    \b
    Example:
      python -m artibot_sim.report.picture --out docs/images
    """
    out.mkdir(parents=True, exist_ok=True)
    target = out / "table6.png"
    with tempfile.TemporaryDirectory() as folder:
        hero(table6_runs(Path(folder)), target)
    click.echo(f"wrote {target} ({target.stat().st_size / 1e3:.0f} kB)")


if __name__ == "__main__":
    command()
