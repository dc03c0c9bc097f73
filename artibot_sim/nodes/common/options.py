"""Options that several nodes' command lines share: parameter files, and types."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from artibot_sim.errors import ArtibotError
from artibot_sim.resources import config_names, config_path


def parameter_files(names: Sequence[str]) -> list[str]:
    """``--ros-args`` that load parameter files, each a path or the name of a shipped one (``sim``)."""
    args: list[str] = []
    for name in filter(None, names):  # an empty text is a launch file's way of naming none
        shipped = config_names("nodes")
        path = config_path("nodes", name) if name in shipped else Path(name)
        if not path.is_file():
            raise ArtibotError(f"--params {name}: no such file; give an existing one or one of {', '.join(shipped)}")
        args += ["--params-file", str(path)]
    return ["--ros-args", *args, "--"] if args else []


EMPTY = ""
"""An option's text that stands for one that is not given: a launch file has no other way to leave an option out."""


class BoundedNumber(click.FloatRange):
    """A finite number within bounds: click's own range lets NaN pass, of which no comparison is true."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Return the number; a click error otherwise."""
        number = float(super().convert(value, param, ctx))
        if not math.isfinite(number):
            self.fail(f"{value} is not a finite number", param, ctx)
        return number


class Optional(click.ParamType):
    """Another type, of which an empty text counts as not given.

    Parameters
    ----------
    kind : click type or Python type
    """

    def __init__(self, kind: Any) -> None:
        self._kind = click.types.convert_type(kind)
        self.name = self._kind.name

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the value, or None."""
        return None if value == EMPTY else self._kind.convert(value, param, ctx)
