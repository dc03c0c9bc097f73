"""A folder of results that is there whole or not at all."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path

from artibot_sim.errors import ArtibotError
from artibot_sim.report.output import write_files


def fault_of_folder(folder: Path) -> str | None:
    """Say what keeps results from being written into a folder, which need not be there yet; None if nothing does."""
    if folder.exists() and not folder.is_dir():
        return "it is a file; name a folder"
    there = folder.absolute()
    while not there.exists():
        there = there.parent
    if not there.is_dir():
        return f"{there} is a file; name another folder"
    return None if os.access(there, os.W_OK | os.X_OK) else f"the folder {there} may not be written to"


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
