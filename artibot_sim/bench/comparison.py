"""Results as a table for a terminal, alone or beside an earlier one."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.table import Table

from artibot_sim.bench.results import Result, Skipped
from artibot_sim.errors import ArtibotError

# ----------------------------------------------------------------------
# The results as a table for a terminal.
# ----------------------------------------------------------------------


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


# ----------------------------------------------------------------------
# Two benchmark files side by side: how much faster, or more exact, is this than that.
# ----------------------------------------------------------------------


MORE_IS_BETTER = ("steps/s", "messages/s", "runs/s", "flop/s", "x", "%")
"""Units of which a larger number is the better one; of all others (s, ms, m, cores, …) the smaller is."""

TOLERANCE = 0.2
"""A result that lost more than this share is worse; timing alone moves by a tenth on a machine that others use."""


@dataclass(frozen=True)
class Change:
    """One result then and now.

    Attributes
    ----------
    name, unit : str
    old, new : float
    gain : float
        How many times better the new one is: 2 is twice as fast, half as long, or half as far off.
    """

    name: str
    unit: str
    old: float
    new: float
    gain: float

    @property
    def verdict(self) -> str:
        """In a word, with the tolerance."""
        if self.gain < 1.0 - TOLERANCE:
            return "worse"
        return "better" if self.gain > 1.0 / (1.0 - TOLERANCE) else "same"


@dataclass(frozen=True)
class Earlier:
    """What an earlier file holds."""

    path: Path
    machine: Mapping[str, Any]
    results: Mapping[str, Mapping[str, Any]]


def read_earlier(path: Path) -> Earlier:
    """Read a file that ``artibot bench --json`` wrote.

    Raises
    ------
    ArtibotError
        Where it is none.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        results = {str(entry["name"]): entry for entry in content["results"]}
        for entry in results.values():
            float(entry["value"]), str(entry["unit"])
        return Earlier(path, dict(content["machine"]), results)
    except OSError as error:
        raise ArtibotError(f"--compare {path}: cannot be read: {error.strerror}") from error
    except (ValueError, KeyError, TypeError) as error:
        raise ArtibotError(
            f"--compare {path}: not a file of 'artibot bench --json'; expected machine and results"
        ) from error


def changes(earlier: Earlier, results: Sequence[Result]) -> list[Change]:
    """What both have, in the order of the new results."""
    found = []
    for result in results:
        old = earlier.results.get(result.name)
        if old is None or old["unit"] != result.unit:
            continue
        before = float(old["value"])
        found.append(Change(result.name, result.unit, before, result.value, _gain(before, result.value, result.unit)))
    return found


def _gain(old: float, new: float, unit: str) -> float:
    if old == new:
        return 1.0
    better, worse = (new, old) if unit in MORE_IS_BETTER else (old, new)
    return better / worse if worse else float("inf")


def same_machine(earlier: Earlier, machine: Mapping[str, Any]) -> bool:
    """Whether both were measured on the same kind of processor with as many cores."""
    return all(earlier.machine.get(key) == machine.get(key) for key in ("cpu", "cores"))


def same_speed(earlier: Earlier, machine: Mapping[str, Any]) -> bool:
    """Whether both were measured in the same way: ``--quick`` has shorter runs, and fewer."""
    return bool(earlier.machine.get("quick")) == bool(machine.get("quick"))


def comparison(earlier: Earlier, found: Sequence[Change]) -> Table:
    """The changes as a table."""
    commit = earlier.machine.get("commit") or earlier.machine.get("artibot") or "then"
    table = Table(box=None, header_style="bold", pad_edge=False)
    for column in ("compared", str(commit), "now", "unit", "gain", ""):
        table.add_column(column, justify="left" if column in ("compared", "unit", "") else "right", overflow="fold")
    for change in found:
        style = {"worse": "red", "better": "green"}.get(change.verdict, "")
        gain = f"{change.gain:.2f} x" if change.gain < 1e3 else "> 1000 x"
        table.add_row(
            change.name, number(change.old), number(change.new), change.unit, gain, change.verdict, style=style
        )
    return table


def remarks(earlier: Earlier, results: Sequence[Result], machine: Mapping[str, Any]) -> Iterator[str]:
    """What is not compared, and what makes the comparison doubtful."""
    if not same_machine(earlier, machine):
        cpu, cores = earlier.machine.get("cpu"), earlier.machine.get("cores")
        yield f"{earlier.path} is from another machine ({cpu}, {cores} cores): ratios say little about the code"
    if not same_speed(earlier, machine):
        yield f"one of {earlier.path} and this was measured with --quick: ratios say little about the code"
    new = {result.name for result in results}
    if left := [name for name in earlier.results if name not in new]:
        yield f"not measured now: {', '.join(left)}"
    if fresh := [name for name in new if name not in earlier.results]:
        yield f"not in {earlier.path}: {', '.join(sorted(fresh))}"


def is_worse(earlier: Earlier, found: Sequence[Change], machine: Mapping[str, Any]) -> bool:
    """Whether something got worse, as far as this machine can tell."""
    alike = same_machine(earlier, machine) and same_speed(earlier, machine)
    return alike and any(change.verdict == "worse" for change in found)
