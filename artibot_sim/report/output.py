"""Files that are there whole or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from artibot_sim.errors import ArtibotError


class OutputFile(click.ParamType):
    """Option for a file to write: refused at once, not after the work, where its folder is missing or closed."""

    name = "file"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Return the path; an ArtibotError otherwise."""
        path = Path(str(value))
        if why := fault(path):
            raise ArtibotError(f"{param.opts[-1]} {path}: cannot be written: {why}" if param else f"{path}: {why}")
        return path


def fault(path: Path) -> str | None:
    """Say what keeps a file from being written, None if nothing does."""
    if path.is_dir():
        return "it is a folder"
    folder = path.absolute().parent
    if not folder.is_dir():
        return f"there is no folder {path.parent}; make it first"
    return closed(folder)


def closed(folder: Path) -> str | None:
    """Say what keeps files from being made in a folder that is there, None if nothing does.

    By trying: a file system may be read-only or hold no files, whatever its rights say, and root has them all.
    """
    try:
        with tempfile.NamedTemporaryFile(dir=folder, prefix=".artibot."):
            return None
    except OSError as error:
        return f"no file can be made in the folder {folder}: {error.strerror}; name another one"


def write_files(contents: Mapping[Path, bytes]) -> None:
    """Write files; nothing is changed unless all could be written.

    Parameters
    ----------
    contents : mapping of path to bytes
        A file that exists is replaced.

    Raises
    ------
    ArtibotError
        Naming the file that cannot be written, and why.
    """
    written: list[tuple[str, Path]] = []
    target = Path()
    try:
        for target, data in contents.items():
            if target.is_dir():
                raise ArtibotError(f"{target}: is a folder; expected the name of a file to write")
            handle, temporary = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.")
            written.append((temporary, target))
            with os.fdopen(handle, "wb") as stream:
                stream.write(data)
            os.chmod(temporary, 0o644)
        for temporary, target in written:
            os.replace(temporary, target)
    except OSError as error:
        raise ArtibotError(f"{target}: cannot be written: {error.strerror}; is its folder there, and yours?") from error
    finally:
        for temporary, _ in written:
            Path(temporary).unlink(missing_ok=True)
