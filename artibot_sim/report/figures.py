"""From recordings to figure data: pure functions, no plotting library.

>>> from artibot_sim.experiment import read_bag
>>> from artibot_sim.report.figures import experiment_figure
>>> figure = experiment_figure([read_bag("run1")])               # doctest: +SKIP
>>> figure["path"].lines, figure.missing                         # doctest: +SKIP
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime, timezone
from typing import TYPE_CHECKING

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment import Experiment
from artibot_sim.report.panels import Figure
from artibot_sim.report.path_panel import path_panel
from artibot_sim.report.paths import find_track, motion_window
from artibot_sim.report.style import BAGS
from artibot_sim.report.time_panels import DrawnRecording, time_panels

if TYPE_CHECKING:
    from artibot_sim.model import Robot

_WALL_CLOCK = 10 * 365 * 86400 * 10**9
"""Stamps before 1980 are a simulation's own time, not a date."""


def check_count(recordings: int) -> None:
    """Refuse to draw so many on top of each other (ArtibotError)."""
    if not 1 <= recordings <= len(BAGS):
        raise ArtibotError(f"{recordings} recordings; expected 1 to {len(BAGS)}, else colours cannot be distinguished")


def experiment_figure(experiments: Sequence[Experiment], robots: Sequence[Robot | None] = ()) -> Figure:
    """Return everything there is to draw of one recording, or of several on top of each other.

    Parameters
    ----------
    experiments : sequence of Experiment
        At most as many as there are hues (`style.BAGS`).
    robots : sequence of Robot or None
        One for each recording, for outlines and torque limits; None where it is not known.

    Returns
    -------
    Figure
        Panels ``path``, ``yaw``, ``speed``, ``velocity_front``, ``torque_front``, ``torque_back`` and
        ``articulation`` as far as there are data; with several recordings the motors have a panel each
        (``velocity_front_right``, …). Times of several are aligned (`align`).

    Raises
    ------
    ArtibotError
        If there is nothing to draw, or there are too many recordings.
    """
    check_count(len(experiments))
    sources = _sources(experiments, robots or [None] * len(experiments))
    first, missing = path_panel(sources)
    rest, also = time_panels(sources)
    panels = tuple(([first] if first else []) + rest)
    if not panels:
        wanted = "; ".join(f"{what}: {why}" for what, why in (missing | also).items())
        raise ArtibotError(
            f"{', '.join(str(experiment.path) for experiment in experiments)}: nothing to draw ({wanted}); "
            "if topics have other names, say --topic WANTED=FOUND"
        )
    title, subtitle = _titles(sources)
    if len(sources) > 1:
        subtitle += f" · times from {align(experiments)[1]}"
    key = tuple((source.label, BAGS[i]) for i, source in enumerate(sources)) if len(sources) > 1 else ()
    return Figure(title, subtitle, panels, missing | also, key)


def align(experiments: Sequence[Experiment]) -> tuple[list[float], str]:
    """Return what to subtract from the times of each recording (s) so that they can be compared, and its name.

    The beginning of the planned motion where all have one; the first stamp of all where the recordings overlap in
    time (one was computed from the other); else the beginning of each.
    """
    windows = []
    for experiment in experiments:
        planned = find_track(experiment, "planned")
        windows.append(motion_window(planned) if planned else None)
    starts = [window[0] for window in windows if window]
    if len(experiments) > 1 and len(starts) == len(experiments):
        return starts, "the start of the planned motion"
    begin = min(experiment.start_ns for experiment in experiments)
    end = min(experiment.start_ns + int(experiment.duration * 1e9) for experiment in experiments)
    if all(experiment.start_ns < end for experiment in experiments):
        return [(begin - experiment.start_ns) / 1e9 for experiment in experiments], "the first stamp"
    return [0.0] * len(experiments), "the start of each recording"


def labels(experiments: Sequence[Experiment]) -> list[str]:
    """Return names that tell recordings apart: with folders where names are equal, with kappa where it differs."""
    paths = [experiment.path.resolve().parts for experiment in experiments]
    names = [experiment.name for experiment in experiments]
    depth = 1
    while len(set(names)) < len(names) and depth < max(map(len, paths)):
        depth += 1
        names = [
            "/".join([*path[-depth:-1], experiment.name]) for path, experiment in zip(paths, experiments, strict=True)
        ]
    kappas = [experiment.metadata.get("kappa", "") for experiment in experiments]
    if len(set(kappas)) > 1:
        names = [f"{name} (κ {kappa})" if kappa else name for name, kappa in zip(names, kappas, strict=True)]
    return names


def _sources(experiments: Sequence[Experiment], robots: Sequence[Robot | None]) -> list[DrawnRecording]:
    if len(experiments) == 1:
        return [DrawnRecording(experiments[0], experiments[0].name, None, robots[0])]
    zeros, _ = align(experiments)
    rows = zip(experiments, labels(experiments), robots, zeros, strict=True)
    return [
        DrawnRecording(experiment, label, i, robot, zero) for i, (experiment, label, robot, zero) in enumerate(rows)
    ]


def _titles(sources: Sequence[DrawnRecording]) -> tuple[str, str]:
    """Return what was driven, and with what and when."""
    experiments = [source.experiment for source in sources]
    title = " · ".join(source.label for source in sources)
    words = _common(experiments, "robot")
    words += [f"κ = {kappa}" for kappa in _common(experiments, "kappa")]
    words += _when(experiments)
    if len(experiments) == 1:
        experiment = experiments[0]
        words.append(f"{experiment.duration:.1f} s")
        if len(experiment.segments) > 1:
            words.append(f"{len(experiment.segments)} segments")
        words += [experiment.metadata[key] for key in ("surface", "description") if experiment.metadata.get(key)]
    return title, " · ".join(words)


def _common(experiments: Sequence[Experiment], key: str) -> list[str]:
    """Return the values of a metadata entry; none where recordings differ in kappa, which their labels then say."""
    values = [experiment.metadata.get(key, "") for experiment in experiments]
    if len(set(values)) > 1 and key == "kappa":
        return []
    return [" and ".join(dict.fromkeys(filter(None, values)))] if any(values) else []


def _when(experiments: Sequence[Experiment]) -> list[str]:
    stamps = sorted({experiment.start_ns for experiment in experiments})
    if stamps[0] < _WALL_CLOCK:
        return ["simulated time"] if stamps[-1] < _WALL_CLOCK else []
    dates = [datetime.fromtimestamp(stamp // 10**9, timezone.utc).strftime("%Y-%m-%d %H:%M UTC") for stamp in stamps]
    return [dates[0] if dates[0] == dates[-1] else f"{dates[0]} to {dates[-1]}"]
