"""Folders of recordings: never overwritten, and never half of one that was computed."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from artibot_sim.errors import ArtibotError


def make_folder(folder: Path) -> None:
    """Make a recording's folder, which must not be there."""
    try:
        folder.mkdir(parents=True)
    except FileExistsError:
        raise ArtibotError(f"{folder}: exists already; recordings are never overwritten, give another name") from None
    except OSError as error:
        raise ArtibotError(f"{folder}: cannot be made: {error.strerror}") from error


@contextmanager
def whole_folder(folder: Path) -> Iterator[Path]:
    """Give a folder beside `folder` to write into, renamed to it at the end, removed if anything fails.

    Raises
    ------
    ArtibotError
        If `folder` exists, or its folder cannot be written to.
    """
    if folder.exists():
        raise ArtibotError(f"{folder}: exists already; recordings are never overwritten, give another name")
    partial = folder.with_name(f".{folder.name}.{os.getpid()}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    try:
        partial.mkdir(parents=True)
        partial.rmdir()  # who writes makes it: tried here, where an error can name the folder that was asked for
    except OSError as error:
        raise ArtibotError(f"{folder}: cannot be made: {error.strerror}") from error
    try:
        yield partial
        partial.rename(folder)
    except BaseException:
        shutil.rmtree(partial, ignore_errors=True)
        raise
