"""Two benchmark files side by side: how much faster, or more exact, is this than that."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.table import Table

from artibot_sim.bench.results import Result
from artibot_sim.bench.table import number
from artibot_sim.errors import ArtibotError

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


def as_quick(earlier: Earlier, machine: Mapping[str, Any]) -> bool:
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
    if not as_quick(earlier, machine):
        yield f"one of {earlier.path} and this was measured with --quick: ratios say little about the code"
    new = {result.name for result in results}
    if left := [name for name in earlier.results if name not in new]:
        yield f"not measured now: {', '.join(left)}"
    if fresh := [name for name in new if name not in earlier.results]:
        yield f"not in {earlier.path}: {', '.join(sorted(fresh))}"


def is_worse(earlier: Earlier, found: Sequence[Change], machine: Mapping[str, Any]) -> bool:
    """Whether something got worse, as far as this machine can tell."""
    alike = same_machine(earlier, machine) and as_quick(earlier, machine)
    return alike and any(change.verdict == "worse" for change in found)
