"""A section's verdict, statements and tables as PNG, for where no page can be shown."""

from __future__ import annotations

import textwrap

from artibot_sim.report import style
from artibot_sim.report.png import new_canvas, to_png
from artibot_sim.reproduce.result import Section, Table

WIDTH = 13.2
"""Inches."""
_LINE = 0.185
_COLUMNS = 172
"""Characters of the fixed-width type that fit side by side."""

Row = tuple[str, str, bool]
"""Text, colour, and whether it is bold."""


def lines(section: Section) -> list[Row]:
    """The section as lines of text."""
    title = f"Section {section.number}: {section.title}"
    out: list[Row] = [(title, style.INK, True), (section.verdict, style.INK, True)]
    for note in (*section.short, *section.notes):
        out += _wrapped(note, style.MUTED)
    for statement in section.statements:
        word, colour = ("holds", style.TRUE) if statement.holds else ("does not hold", style.ODOMETRIC)
        out.append(("", style.INK, False))
        out += _wrapped(f"{word}: {statement.claim}", colour)
        out += _wrapped(statement.evidence, style.MUTED, "    ")
    for table in section.tables:
        out += [("", style.INK, False), (table.title, style.INK, True), *_table(table)]
    return out


def _wrapped(text: str, colour: str, indent: str = "") -> list[Row]:
    wrapped = textwrap.wrap(text, _COLUMNS, initial_indent=indent, subsequent_indent=indent)
    return [(line, colour, False) for line in wrapped]


def _table(table: Table) -> list[Row]:
    """The rows with their columns aligned; headings that are wider than their column are wrapped."""
    cells = [max([len(row[i]) for row in table.rows] + [0]) for i in range(len(table.columns))]
    words = [max([len(word) for word in head.split()] + [9]) for head in table.columns]
    widths = [max(pair) for pair in zip(cells, words, strict=True)]
    heads = [textwrap.wrap(head, width) or [""] for head, width in zip(table.columns, widths, strict=True)]
    tall = max(map(len, heads))
    heading = [[""] * (tall - len(head)) + head for head in heads]
    rows = [tuple(column[i] for column in heading) for i in range(tall)]
    out = [(_aligned(row, widths), style.MUTED, False) for row in rows]
    out += [(_aligned(row, widths), style.INK, False) for row in table.rows]
    return out + (_wrapped(table.note, style.MUTED) if table.note else [])


def _aligned(row: tuple[str, ...], widths: list[int]) -> str:
    """The first column to the left, the others to the right."""
    first = row[0].ljust(widths[0])
    return "  ".join([first, *(text.rjust(width) for text, width in zip(row[1:], widths[1:], strict=True))])


def render_summary(section: Section) -> bytes:
    """Return the section's verdict, statements and tables as a picture."""
    import matplotlib

    rows = lines(section)
    height = 0.3 + _LINE * len(rows)
    with matplotlib.rc_context(style.matplotlib_style() | {"font.family": ["DejaVu Sans Mono"]}):
        canvas = new_canvas(WIDTH, height)
        for i, (text, colour, bold) in enumerate(rows):
            canvas.text(
                0.15 / WIDTH, 1 - (0.2 + _LINE * i) / height, text, fontsize=9, color=colour, va="top",
                fontweight="bold" if bold else "normal", parse_math=False,
            )  # fmt: skip
        return to_png(canvas, 110)
