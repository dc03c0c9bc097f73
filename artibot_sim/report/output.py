"""Files that are there whole or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from pathlib import Path

from artibot_sim.errors import ArtibotError


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
