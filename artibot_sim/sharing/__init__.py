"""Torque-sharing laws: how much of the traction the back module takes, and which of its sides.

The paper's is eq. 30 with a constant kappa; the others begin what it names as future work. A law is declared in one
file of this package that ends in ``LAW = Law(…)``; being there is enough to be known. A law of one's own is such a
file anywhere, given by its path. `artibot actuate` compares laws, and the driver drives with any of them.
"""

from __future__ import annotations

import importlib
import importlib.util
import pkgutil
from pathlib import Path

from artibot_sim.documents import did_you_mean
from artibot_sim.errors import ArtibotError
from artibot_sim.sharing.base import Cycle, Law, Pair, eq30

__all__ = ["LAWS", "Cycle", "Law", "Pair", "eq30", "is_file", "load_law"]


def _found() -> dict[str, Law]:
    names = sorted(module.name for module in pkgutil.iter_modules(__path__) if module.name != "base")
    laws = [importlib.import_module(f"{__name__}.{name}").LAW for name in names]
    return {law.id: law for law in laws}


LAWS: dict[str, Law] = _found()
"""Every law by id, with its defaults."""


def load_law(text: str) -> Law:
    """A law from ``NAME`` or ``NAME:PARAMETER=VALUE,…``; NAME is an id or the path of a Python file with a ``LAW``.

    Raises
    ------
    ArtibotError
        For a name that is neither, a file without a law, or values that do not fit it.
    """
    name, _, rest = text.strip().partition(":")
    law = _from_file(Path(name)) if is_file(text) else LAWS.get(name)
    if law is None:
        raise ArtibotError(
            f"law: '{name}' is unknown{did_you_mean(name, LAWS)}; expected one of {', '.join(LAWS)}, "
            "or the path of a Python file with a LAW"
        )
    values = {}
    for part in filter(None, rest.split(",")):
        key, equals, value = part.partition("=")
        if not equals:
            raise ArtibotError(f"law {name}: '{part}'; expected PARAMETER=VALUE, such as {name}:{_example(law)}")
        values[key.strip()] = value.strip()
    return law.with_values(values)


def is_file(text: str) -> bool:
    """Whether a law's text names a Python file, which is run to read it."""
    return text.strip().partition(":")[0].endswith(".py")


def _example(law: Law) -> str:
    return next((f"{name}={value:g}" for name, value in law.defaults.items()), "…")


def _from_file(path: Path) -> Law:
    """The law of a user's own file, which is run as Python code."""
    spec = importlib.util.spec_from_file_location(f"artibot_law_{path.stem}", path)
    if spec is None or spec.loader is None or not path.is_file():
        raise ArtibotError(f"law: {path}: no such file")
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:  # whatever is wrong with a user's code, the line says where
        raise ArtibotError(f"law: {path}: cannot be run: {type(error).__name__}: {error}") from error
    law = getattr(module, "LAW", None)
    if not isinstance(law, Law):
        raise ArtibotError(f"law: {path}: no LAW in it; expected LAW = Law(id, doc, share) at the file's end")
    return law
