"""Results in files and folders that are there whole or not at all."""

from __future__ import annotations

import json
import math
import os
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from artibot_sim.errors import ArtibotError

# ----------------------------------------------------------------------
# Files that are there whole or not at all.
# ----------------------------------------------------------------------


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


def json_bytes(content: object) -> bytes:
    """A JSON file's content: indented UTF-8; null for numbers that are not finite, for JSON has no word for these."""
    return (json.dumps(_plain(content), indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()


def _plain(content: Any) -> Any:
    if isinstance(content, Mapping):
        return {key: _plain(value) for key, value in content.items()}
    if isinstance(content, tuple | list):
        return [_plain(value) for value in content]
    return None if isinstance(content, float) and not math.isfinite(content) else content


# ----------------------------------------------------------------------
# A folder of results that is there whole or not at all.
# ----------------------------------------------------------------------


def fault_of_folder(folder: Path) -> str | None:
    """Say what keeps results from being written into a folder, which need not be there yet; None if nothing does."""
    there = folder.absolute()
    try:
        if folder.exists():
            return closed(folder) if folder.is_dir() else "it is a file; name a folder"
        while not there.parent.exists():
            there = there.parent
        if not there.parent.is_dir():
            return f"{there.parent} is a file; name another folder"
        there.mkdir()
        there.rmdir()
    except OSError as error:
        return f"{there} cannot be made: {error.strerror}; name another folder"
    return None


def write_folder(folder: Path, contents: Mapping[str, bytes]) -> None:
    """Write files into a folder; nothing is there, or nothing is changed, unless all could be written.

    Parameters
    ----------
    folder : Path
        Made, with its parents, if it is not there; else files of the same names are replaced, others stay.
    contents : mapping of str to bytes
        File name to content.

    Raises
    ------
    ArtibotError
        Naming what cannot be written, and why.
    """
    if folder.is_dir():
        write_files({folder / name: data for name, data in contents.items()})
        return
    partial: Path | None = None
    try:
        folder.absolute().parent.mkdir(parents=True, exist_ok=True)
        partial = Path(tempfile.mkdtemp(dir=folder.absolute().parent, prefix=f".{folder.name}."))
        write_files({partial / name: data for name, data in contents.items()})
        partial.chmod(0o755)
        partial.rename(folder)
        partial = None
    except OSError as error:
        raise ArtibotError(f"{folder}: cannot be made: {error.strerror}; give another --out") from error
    finally:
        if partial is not None:
            shutil.rmtree(partial, ignore_errors=True)
