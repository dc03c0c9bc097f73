"""A folder of results that is there whole or not at all."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path

from artibot_sim.errors import ArtibotError
from artibot_sim.report.output import closed, write_files


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
