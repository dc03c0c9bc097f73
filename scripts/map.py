"""Draw the map of the house into docs/architecture.md, from the tree alone: ``python scripts/map.py [--check]``.

Rooms, files and the first sentence of each file's docstring; and which room imports which, as the import test reads it.
With ``--check`` nothing is written, and the exit status is 1 where the page is not what the tree says.
"""

from __future__ import annotations

import ast
import sys
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "architecture.md"
sys.path.insert(0, str(ROOT / "test"))

from imports import BELOW_ALL, DRIVER, LAYERS, edges, modules_below, part_of  # noqa: E402

HEAD = """# Map of the house

Drawn from the tree by `make map`; a test holds this page to it. The physics is a library without ROS, CAN, files or
wall clock; everything else is a thin edge around it. Imports run one way, from the top of the list of rooms to its
bottom, and no two files import each other (`test/imports.py`). A reader begins with `model/reference/`, which reads
like the paper.

## Which room imports which

Arrows that others imply are left out, as are the modules that every room may import.

"""


def summary(path: Path) -> str:
    """First sentence of a file's docstring, without its full stop."""
    text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    return " ".join(text.split("\n\n")[0].split()).rstrip(".")


def room_of(module: str) -> str:
    """The room of a module, for arrows: its part of artibot, or the driver."""
    part = part_of(module)
    return "shared" if part in BELOW_ALL else part


def arrows(graph: dict[str, set[str]]) -> list[tuple[str, str]]:
    """Pairs of rooms of which the first imports the second and no third one stands between them."""
    direct: dict[str, set[str]] = defaultdict(set)
    for module, targets in graph.items():
        here = room_of(module)
        direct[here] |= {room_of(target) for target in targets} - {here, "shared", ""}

    def reachable(room: str) -> set[str]:
        found: set[str] = set()
        for target in direct[room]:
            found |= {target} | reachable(target)
        return found

    order = [room for room in (*reversed(LAYERS), DRIVER) if room in direct]
    return [
        (room, target)
        for room in order
        for target in sorted(direct[room])
        if not any(target in reachable(other) for other in direct[room] - {target})
    ]


def folders() -> dict[str, list[tuple[str, str]]]:
    """Files of each folder with what they are about, folders as ``model/equations``."""
    found: dict[str, list[tuple[str, str]]] = defaultdict(list)
    for _, path in modules_below(ROOT):
        place = path.relative_to(ROOT)
        if place.name != "__main__.py":
            found[place.parent.as_posix()].append((place.name, summary(path)))
    return dict(found)


def page() -> str:
    """The whole page."""
    lines = [HEAD + "```mermaid", "flowchart TD"]
    lines += [f"  {room} --> {target}" for room, target in arrows(edges(ROOT))]
    lines += ["```", "", "## Rooms and files", ""]
    rooms = folders()

    def rank(folder: str) -> tuple[int, str]:
        parts = folder.split("/")
        if parts[0] == DRIVER:
            return len(LAYERS) + 1, folder
        if len(parts) == 1:
            return len(LAYERS) + 2, folder
        return len(LAYERS) - 1 - LAYERS.index(parts[1]) if parts[1] in LAYERS else len(LAYERS), folder

    for folder in sorted(rooms, key=rank):
        files = rooms[folder]
        about = dict(files).get("__init__.py", "")
        lines += [f"### {folder}", "", f"{about}." if about else "", "", "| file | |", "|---|---|"]
        lines += [f"| `{name}` | {what.replace('|', chr(92) + '|')} |" for name, what in files if name != "__init__.py"]
        lines.append("")
    return "\n".join(lines).rstrip() + "\n"


def main() -> int:
    """Write the page, or compare it."""
    wanted = page()
    if "--check" in sys.argv[1:]:
        same = PAGE.is_file() and PAGE.read_text(encoding="utf-8") == wanted
        if not same:
            print("docs/architecture.md is not what the tree says; run `make map`", file=sys.stderr)
        return 0 if same else 1
    PAGE.write_text(wanted, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
