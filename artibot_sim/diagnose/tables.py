"""Writes the tables that decide, of verdicts and of numbers, into docs/diagnosis_method.md: `make tables`."""

from __future__ import annotations

import sys
from pathlib import Path

from artibot_sim.diagnose import policy, verdict

TABLES = {"verdict": verdict.as_markdown, "policy": policy.as_markdown}
"""Name of a place in the docs → what stands there."""


def filled(text: str) -> str:
    """A page with every table anew; a place begins with ``<!-- table: NAME -->`` and ends with ``<!-- end -->``.

    Raises
    ------
    ValueError
        Where a table has no place.
    """
    for name, table in TABLES.items():
        begin, end = f"<!-- table: {name} -->\n", "<!-- end -->"
        before, found, rest = text.partition(begin)
        if not found or end not in rest:
            raise ValueError(f"no place for the table {name!r}: expected {begin.strip()} … {end}")
        text = f"{before}{begin}\n{table().strip()}\n\n{rest[rest.index(end) :]}"
    return text


def main(page: str) -> None:
    """Write the tables into a page."""
    path = Path(page)
    path.write_text(filled(path.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
