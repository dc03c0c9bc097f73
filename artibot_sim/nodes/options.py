"""Types of command line options that several nodes share."""

from __future__ import annotations

import math
from typing import Any

import click

EMPTY = ""
"""An option's text that stands for one that is not given: a launch file has no other way to leave an option out."""


class Number(click.FloatRange):
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
