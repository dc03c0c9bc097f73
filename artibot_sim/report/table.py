"""Figures of merit in the terminal, as in Table 5 of the paper, and for scripts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from artibot_sim.report.measures import Measures

if TYPE_CHECKING:
    from rich.table import Table

    from artibot_sim.experiment import Experiment

SCHEMA = "artibot/plot/1"
KINDS = ("planned", "odometric", "true")
NONE = "–"


def rows(measures: Measures) -> list[tuple[str, str, tuple[str, ...]]]:
    """Return the lines of a table: quantity, unit, and texts for planned, odometric and true."""
    out = [
        ("e_γ, yaw (eq. 31)", "%", _texts(measures.e_gamma, 100.0)),
        ("e_x, final position (eq. 32)", "%", _texts(measures.e_x, 100.0)),
    ]
    for number, arc in enumerate(measures.arcs, 1):
        side = "left" if arc.turn > 0 else "right"
        out.append((f"radius, arc {number} ({side})", "m", _texts(arc.radius)))
    if len(measures.arcs) > 1:
        out.append(("radius, mean", "m", _texts(measures.radius)))
    out.append(("path length", "m", _texts(measures.path_length)))
    return [row for row in out if set(row[2]) != {NONE}]


def terminal_table(names: Sequence[str], measured: Sequence[Measures]) -> Table:
    """Return a rich table of the figures of merit of some recordings, one without rows if they have none."""
    from rich.table import Table
    from rich.text import Text

    table = Table("", "", *KINDS, box=None, header_style="bold", pad_edge=False)
    for column in table.columns[2:]:
        column.justify = "right"
    for name, measures in zip(names, measured, strict=True):
        found = rows(measures)
        if found:
            table.add_row(Text(name, style="bold"))
        for what, unit, texts in found:
            table.add_row(f"  {what}", unit, *texts)
    return table


def summary(
    experiments: Sequence[Experiment], measured: Sequence[Measures], missing: Mapping[str, str]
) -> dict[str, Any]:
    """Return what the table says, as JSON takes it: SI units, null for what is absent."""
    bags = [
        {
            "name": experiment.name,
            "path": str(experiment.path),
            "metadata": dict(experiment.metadata),
            "duration": {"unit": "s", "value": experiment.duration},
            "segments": len(experiment.segments),
            "metrics": measures.as_dict(),
            "remarks": [*measures.remarks, *experiment.remarks],
        }
        for experiment, measures in zip(experiments, measured, strict=True)
    ]
    return {"schema": SCHEMA, "bags": bags, "not_drawn": dict(missing)}


def _texts(values: Mapping[str, float], factor: float = 1.0) -> tuple[str, ...]:
    return tuple(f"{factor * values[kind] + 0.0:.2f}".replace("-", "−") if kind in values else NONE for kind in KINDS)
