"""The option ``--effects DIR`` of commands that load robots, and a person's own effects, which they all know."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click


def effects_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """The option ``--effects``: before anything else runs, effect files in these folders are known.

    So are those of the user's own folder, whether the option is given or not. See `model.effects.files`.
    """
    return click.option(
        "--effects",
        multiple=True,
        metavar="DIR",
        is_eager=True,
        expose_value=False,
        callback=_load,
        help="Folder with effects of your own (artibot effects --help), beside your user folder's; repeatable.",
    )(command)


def user_folder() -> Path:
    """Where a person's own effects are kept, by the XDG base directories."""
    base = os.environ.get("XDG_CONFIG_HOME") or os.path.join(os.path.expanduser("~"), ".config")
    return Path(base) / "artibot" / "effects"


def _load(_context: click.Context, _option: click.Parameter, folders: tuple[str, ...]) -> None:
    own = user_folder()
    every = [*([own] if own.is_dir() else []), *map(Path, folders)]
    if every:  # else nothing of the model is imported here
        from artibot_sim.model.effects.files import load_folder

        for folder in every:
            load_folder(folder)
