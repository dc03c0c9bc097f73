"""Which module may import which: the rules of docs/design as data, and a reader of import statements."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

LAYERS = (
    "model",
    "sharing",
    "planning",
    "experiment",
    "exchange",
    "estimation",
    "identify",
    "diagnose",
    "sweep",
    "report",
    "view",
    "reproduce",
    "actuate",
    "bench",
    "nodes",
    "cli",
)
"""Parts of artibot_sim, lowest first: each may import itself and what stands before it."""

BELOW_ALL = (
    "checkpoints",
    "cluster",
    "documents",
    "errors",
    "parameters",
    "progress",
    "resources",
    "version",
)
"""Modules that any part may import, and that import only each other."""

DRIVER = "artibot_driver"
DRIVER_MAY = ("model", "sharing", "planning", *BELOW_ALL)
"""What the driver may import of artibot_sim."""

ABOVE_DRIVER = ("nodes", "cli")
"""The parts of artibot_sim that may import the driver."""

OWNERS = {
    "rclpy": ("nodes",),
    "mcap": ("experiment",),
    "rosbags": ("experiment",),
    "can": (DRIVER,),
    "can_remote": (DRIVER,),
    "canopen": (DRIVER,),
    "mujoco": ("bench", "exchange"),
    "pinocchio": ("bench",),
    "pydrake": ("bench",),
    "pybullet": ("bench",),
    "pyarrow": ("exchange", "sweep"),
    "viser": ("view", "nodes"),
    "sklearn": ("estimation",),
    "distributed": ("cluster",),
    "dask": ("cluster",),
}
"""Libraries that only these parts know."""

ROS_SUFFIXES = ("_msgs", "_srvs", "_interfaces", "_ros")
"""Ends of the names of ROS packages: the same rule as for rclpy."""


class Import(NamedTuple):
    """One import: the importing module, what it imports, and the line."""

    module: str
    imported: str
    line: int


def imports_of(source: str, module: str, is_package: bool = False) -> Iterator[Import]:
    """Every import in a source text, wherever it stands, with relative ones resolved."""
    package = module.split(".") if is_package else module.split(".")[:-1]
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield Import(module, alias.name, node.lineno)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) + 1 - node.level] if node.level else []
            origin = ".".join([*base, *filter(None, [node.module])])
            for alias in node.names:
                yield Import(module, f"{origin}.{alias.name}", node.lineno)
        elif isinstance(node, ast.Call) and _name(node.func) in ("import_module", "__import__"):
            for argument in node.args[:1]:
                if isinstance(argument, ast.Constant) and isinstance(argument.value, str):
                    yield Import(module, argument.value, node.lineno)


def _name(function: ast.expr) -> str:
    return function.attr if isinstance(function, ast.Attribute) else getattr(function, "id", "")


def modules_below(root: Path) -> Iterator[tuple[str, Path]]:
    """Dotted name and file of every module of artibot below `root`."""
    for package in ("artibot_sim", DRIVER):
        for path in sorted((root / package).rglob("*.py")):
            parts = path.relative_to(root).with_suffix("").parts
            yield ".".join(parts[:-1] if parts[-1] == "__init__" else parts), path


def part_of(module: str) -> str:
    """The part a module belongs to: a layer, a module below all, the driver, or "" for artibot_sim itself."""
    names = module.split(".")
    if names[0] == DRIVER:
        return DRIVER
    return names[1] if len(names) > 1 else ""


def fault(found: Import) -> str | None:
    """What is wrong with an import, or None."""
    importer, top = part_of(found.module), found.imported.split(".")[0]
    where = f"{found.module}:{found.line} imports {found.imported}"
    if top in ("artibot_sim", DRIVER):
        return None if _inside(importer, part_of(found.imported)) else f"{where}: {importer or 'the package'} may not"
    owners = OWNERS.get("rclpy" if top.endswith(ROS_SUFFIXES) else top)
    if owners is None or importer in owners:
        return None
    return f"{where}: only {' and '.join(owners)} may"


def _inside(importer: str, imported: str) -> bool:
    """Whether one part of artibot may import another."""
    if imported in ("", importer, *BELOW_ALL):
        return True
    if importer == DRIVER:
        return imported in DRIVER_MAY
    if imported == DRIVER:
        return importer in ABOVE_DRIVER
    if importer not in LAYERS or imported not in LAYERS:
        return False
    return LAYERS.index(imported) < LAYERS.index(importer)


def edges(root: Path) -> dict[str, set[str]]:
    """Which modules of artibot each module imports, anywhere in its text: files, not packages' names."""
    files = dict(modules_below(root))
    graph: dict[str, set[str]] = {module: set() for module in files}
    for module, path in files.items():
        for found in imports_of(path.read_text(encoding="utf-8"), module, path.name == "__init__.py"):
            target = found.imported if found.imported in files else found.imported.rpartition(".")[0]
            if target in files and target != module:
                graph[module].add(target)
    return graph


def circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Groups of modules that import each other, directly or by way of others (Tarjan's algorithm)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(module: str) -> None:
        index[module] = low[module] = len(index)
        stack.append(module)
        for target in sorted(graph[module]):
            if target not in index:
                visit(target)
                low[module] = min(low[module], low[target])
            elif target in stack:
                low[module] = min(low[module], index[target])
        if low[module] == index[module]:
            at = stack.index(module)
            if len(stack) - at > 1:
                found.append(sorted(stack[at:]))
            del stack[at:]

    for module in sorted(graph):
        if module not in index:
            visit(module)
    return found
