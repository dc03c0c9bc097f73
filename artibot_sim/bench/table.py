"""The results as a table for a terminal."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from rich.table import Table

from artibot_sim.bench.results import Result, Skipped

WIDTH = 118
"""Columns that the table needs to show everything in a line."""

MUJOCO_NOTE = (
    "MuJoCo: mujoco_law_* has artibot's masses, joint, contact law, motors and torque sharing as a C callback, and "
    "differs in what eq. 8 leaves out. mujoco_native_* is a user's model: Coulomb friction with mu_s at the ground, "
    "MuJoCo's contact softness, torque sharing at 100 Hz; it is another law, so its distance is no error. Both keep "
    "position and velocity at 100 Hz; artibot keeps every force as well."
)


def number(value: float) -> str:
    """Three digits, with M or k where there are many, and without an exponent as far as that is readable."""
    for factor, prefix in ((1e6, " M"), (1e3, " k")):
        if abs(value) >= factor:
            return f"{value / factor:.3g}{prefix}"
    return f"{value:.3g}"


def heading(machine: dict[str, Any]) -> str:
    """On what and with what it was measured."""
    version = f"artibot {machine['artibot']}" + (f" ({machine['commit']})" if machine["commit"] else "")
    return (
        f"{version}, {machine['cpu']}, {machine['cores']} cores, load {machine['load_average']}, "
        f"Python {machine['python']}, numba {machine['numba']}"
    )


def table(results: Sequence[Result]) -> Table:
    """All results, with medians and spreads where there were several runs."""
    shown = Table(box=None, header_style="bold", pad_edge=False)
    for column in ("result", "best", "unit", "median", "by CPU time", "runs", "peer", "over peer"):
        left = column in ("result", "unit")
        shown.add_column(column, justify="left" if left else "right", overflow="fold")
    for result in results:
        shown.add_row(*_row(result))
    return shown


def _row(result: Result) -> Iterator[str]:
    detail = result.detail
    yield result.name
    yield number(result.value)
    yield result.unit
    yield number(detail["median"]) if "median" in detail else ""
    yield number(detail["by_cpu_time"]) if "by_cpu_time" in detail else ""
    spread = f" ±{50 * detail['spread']:.0f} %" if "spread" in detail else ""
    yield f"{detail['runs']:.0f}{spread}" if "runs" in detail else ""
    yield number(result.peer.value) if result.peer else ""
    yield _ratio(result)


def _ratio(result: Result) -> str:
    """Over the peer, by CPU time where both have it: others on the machine slow one of the two more than the other."""
    if result.peer is None:
        return ""
    own, other = result.detail.get("by_cpu_time"), result.peer.by_cpu_time
    return f"{own / other if own and other else result.value / result.peer.value:.1f} x"


def notes(results: Sequence[Result], skipped: Sequence[Skipped]) -> Iterator[str]:
    """What was measured, and what was not and why."""
    yield ""
    said: dict[str, list[str]] = {}
    for result in results:
        said.setdefault(result.note, []).append(result.name)
    for note, names in said.items():
        yield f"{', '.join(names)}: {note}"
    if any(result.peer and result.peer.by_cpu_time for result in results):
        yield "over peer: ratio of the values by CPU time, which others on the machine disturb less"
    if any(result.name.startswith("mujoco_") for result in results):
        yield MUJOCO_NOTE
    for skip in skipped:
        yield f"{skip.name} {'failed' if skip.failed else 'was skipped'}: {skip.reason}"
