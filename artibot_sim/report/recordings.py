"""Recordings drawn: a picture, a page and figures of merit of one or several, whole or not at all."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from artibot_sim.errors import ArtibotError
from artibot_sim.report.files import json_bytes

if TYPE_CHECKING:
    from artibot_sim.experiment import Experiment
    from artibot_sim.model import Robot
    from artibot_sim.progress import Report
    from artibot_sim.report.measures import Measures
    from artibot_sim.report.panels import Figure


class Drawn(NamedTuple):
    """What came of drawing: the figure, what the recordings are called in it, their measures, the files written."""

    figure: Figure
    names: Sequence[str]
    measured: Sequence[Measures]
    files: Sequence[Path]


def draw(
    experiments: Sequence[Experiment],
    robots: Sequence[Robot | None],
    *,
    png: Path | None = None,
    html: Path | None = None,
    json: Path | None = None,
    progress: Report | None = None,
) -> Drawn:
    """Write the files asked for; `progress` is called with the share that is done.

    Raises
    ------
    ArtibotError
        If there is nothing to draw, or a file cannot be written; then none is.
    """
    from artibot_sim.report.figures import experiment_figure, labels
    from artibot_sim.report.files import write_files
    from artibot_sim.report.measures import measure

    figure = experiment_figure(experiments, robots)
    measured = [measure(experiment) for experiment in experiments]
    names = labels(experiments)
    files: dict[Path, bytes] = {}
    advance = progress or (lambda _: None)
    for path, render in ((png, _png), (html, _page), (json, _json)):
        advance(len(files) / 3)
        if path is not None:
            if path in files:
                raise ArtibotError(f"{path}: asked for twice; give each output its own name")
            files[path] = render(figure, experiments, names, measured)
    write_files(files)
    advance(1.0)
    return Drawn(figure, names, measured, list(files))


def page_of_recordings(experiments: Sequence[Experiment]) -> bytes:
    """The page (UTF-8) of recordings on top of each other, with the robots that they name.

    Raises
    ------
    ArtibotError
        If there is nothing to draw.
    """
    from artibot_sim.report.figures import experiment_figure, labels
    from artibot_sim.report.measures import measure

    figure = experiment_figure(experiments, [robot_of_recording(None, experiment) for experiment in experiments])
    return _page(figure, experiments, labels(experiments), [measure(experiment) for experiment in experiments])


def robot_of_recording(wanted: str | None, experiment: Experiment) -> Robot | None:
    """The robot that was asked for, else the one the recording names if it is known."""
    from artibot_sim.model import load_robot

    if wanted is not None:
        return load_robot(wanted)
    named = experiment.metadata.get("robot")
    if not named:
        return None
    try:
        return load_robot(named)
    except ArtibotError:
        return None  # a robot from elsewhere: the figure says that the outline is missing


def _png(figure: Figure, *_: object) -> bytes:
    from artibot_sim.report.png import render_png

    return render_png(figure)


def _page(
    figure: Figure, experiments: Sequence[Experiment], names: Sequence[str], measured: Sequence[Measures]
) -> bytes:
    from artibot_sim.report.measures import KINDS, rows
    from artibot_sim.report.page import render_page

    table = [(name, rows(measures)) for name, measures in zip(names, measured, strict=True)]
    said = [
        f"{name}: {text}" if len(names) > 1 else text for name, text in zip(names, map(_ended, measured), strict=True)
    ]
    return render_page(figure, table, KINDS, remarks_of(names, experiments, measured), said=[*filter(None, said)])


def _ended(measures: Measures) -> str:
    """How far from its plan a rover ended, in one sentence; empty where nobody knows."""
    kind = next((kind for kind in ("true", "odometric") if kind in measures.e_x), None)
    if kind is None or "planned" not in measures.path_length:
        return ""
    way, share = measures.path_length["planned"], measures.e_x[kind]
    where = "" if kind == "true" else ", by its wheels"
    of_way = f"{100 * share:.1f}\u00a0% of {way:.1f}\u00a0m"
    said = f"Ended {share * way:.2f}\u00a0m from where it was planned to end ({of_way}){where}"
    if kind not in measures.e_gamma:
        return f"{said}."
    yaw = measures.e_gamma[kind]
    return f"{said}; it turned {100 * abs(yaw):.1f}\u00a0% {'less' if yaw < 0.0 else 'more'} than planned (eq. 31)."


def _json(
    figure: Figure, experiments: Sequence[Experiment], names: Sequence[str], measured: Sequence[Measures]
) -> bytes:
    from artibot_sim.report.measures import summary

    return json_bytes(summary(experiments, measured, figure.missing))


def remarks_of(names: Sequence[str], experiments: Sequence[Experiment], measured: Sequence[Measures]) -> list[str]:
    """What there is to say about recordings, each sentence once, with whom it is about."""
    about: dict[str, list[str]] = {}
    for name, experiment, measures in zip(names, experiments, measured, strict=True):
        for remark in (*measures.remarks, *experiment.remarks):
            about.setdefault(remark, []).append(name)
    return [f"{', '.join(who)}: {remark}" for remark, who in about.items()]
