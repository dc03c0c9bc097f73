"""What the demo's drive came to, beside the paper's figures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from rich.table import Table

from artibot_sim.experiment import Experiment, bag_info, read_bag
from artibot_sim.report.measures import Measures, measure

PAPER: Final[Mapping[str, Mapping[float, tuple[float, float]]]] = {
    "agriq": {0.6: (4.36, 5.63), 0.8: (4.52, 6.83), 1.0: (5.10, 6.45)},
    "epiq": {0.6: (1.98, 1.79), 0.8: (2.13, 2.20), 1.0: (2.52, 2.75)},
}
"""Table 7: robot → kappa → magnitude of e_gamma and e_x in %, on the trajectory of Table 6."""
TORQUES: Final = (
    "Torques peak where the planned curvature jumps: prescribed motors follow, whatever it takes. ",
    (
        "Torques peak where the planned curvature jumps, up to the motors' limits; the wheels catch up after. A CAN "
        "period more or less there turns the rover by some hundredths of a radian: no two runs have the same e_γ. "
    ),
)
"""Of motors that follow their command exactly, and of those that drives turn."""
TABLE_7: Final = (
    "Table 7 prints magnitudes; geometry that the paper lost was inferred by fitting this very table, so it is context "
    "here, not a validation."
)


def note(drives: bool) -> str:
    """What to say below the figures."""
    return TORQUES[drives] + TABLE_7


class DemoResult(NamedTuple):
    """A drive: its recording and figures."""

    recording: Experiment
    measures: Measures
    messages: int


def read_result(recording: Path) -> DemoResult:
    """Read the recording of a drive.

    The figures are taken against `/planned/path`, whose stamps say when each point was planned for: it is one message,
    while `/planned/odom` has a gap wherever a busy machine held up the planner.
    """
    experiment = read_bag(recording)
    channels = dict(experiment.channels)
    if "planned_path" in channels:
        channels.pop("planned_odom", None)
    return DemoResult(experiment, measure(replace(experiment, channels=channels)), bag_info(recording).message_count)


def lacks(result: DemoResult, duration: float) -> str:
    """Return what of the drive (planned to last `duration`, s) the recording misses, empty if it is whole."""
    for key in ("planned_path", "ground_truth_odom", "motor_torques"):
        if key not in result.recording.channels:
            return f"nothing came on {key}"
    window = result.measures.window
    if window is None or window[1] - window[0] < duration - 0.1:
        return "; ".join(result.measures.remarks) or "the drive is not whole"
    return ""


def result_table(
    result: DemoResult, robot: str, kappa: float, duration: float, path_length: float, paper: bool
) -> Table:
    """Return the figures as a table; those of Table 7 beside them with `paper`."""
    measures = result.measures
    stated = PAPER.get(robot, {}) if paper else {}
    table = Table(title=f"{robot} at κ = {kappa:g}", title_style="bold", title_justify="left", show_edge=False)
    for name in ("", "odometric", "true", *(["paper, Table 7"] if stated else [])):
        table.add_column(name, justify="left" if not name else "right")
    errors = (("yaw error e_γ (eq. 31)", measures.e_gamma), ("final position error e_x (eq. 32)", measures.e_x))
    for i, (name, values) in enumerate(errors):
        table.add_row(name, *_pair(values, 100.0, "%"), *([_paper(stated, i, kappa)] if stated else []))
    for arc in measures.arcs:
        side = "left" if arc.turn > 0 else "right"
        table.add_row(f"radius to the {side}, planned {arc.radius['planned']:.2f} m", *_pair(arc.radius, 1.0, "m"))
    table.add_row(f"path length, planned {path_length:.2f} m", *_pair(measures.path_length, 1.0, "m"))
    table.add_section()
    table.add_row("duration", "", f"{duration:.2f} s")
    for end, peak in peak_torques(result.recording).items():
        table.add_row(f"peak torque, {end} motors", "", f"{peak:.3g} N·m")
    table.add_row("messages recorded", "", str(result.messages))
    return table


def peak_torques(experiment: Experiment) -> dict[str, float]:
    """Return the largest magnitude of the motor torques (N·m) of each module that has motors."""
    channel = experiment.channels["motor_torques"]
    peaks = {}
    for end in ("front", "back"):
        efforts = [channel[name] for name in channel.columns if name.startswith(end) and name.endswith(".effort")]
        if efforts:
            peaks[end] = float(np.nanmax(np.abs(efforts)))
    return peaks


def _pair(values: Mapping[str, float], factor: float, unit: str) -> list[str]:
    return [f"{factor * values[kind]:.2f} {unit}" if kind in values else "–" for kind in ("odometric", "true")]


def _paper(stated: Mapping[float, tuple[float, float]], column: int, kappa: float) -> str:
    """Return Table 7's figure for this kappa, else the range of those it has."""
    figures = [stated[kappa][column]] if kappa in stated else sorted(row[column] for row in stated.values())
    return "–".join(f"{figure:.2f}" for figure in dict.fromkeys((figures[0], figures[-1]))) + " %"
