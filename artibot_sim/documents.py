"""YAML files that a user names or writes: found by name or path, read strictly, refused with file and key."""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, TypeVar

import yaml

try:  # libyaml's reads a robot in a fifth of the time, but not every PyYAML was built with it
    from yaml import CSafeLoader as _SafeLoader
except ImportError:
    from yaml import SafeLoader as _SafeLoader

from artibot_sim.errors import ArtibotError
from artibot_sim.resources import config_names, config_path

Built = TypeVar("Built")

LARGEST = 1_000_000
"""Bytes; no robot, manoeuvre or parameter file comes near it."""


def load_document(kind: str, name: str | os.PathLike[str], what: str, build: Callable[[Any, str], Built]) -> Built:
    """Read a YAML file and build something of it.

    Parameters
    ----------
    kind : str
        Kind of shipped file (see :func:`artibot_sim.resources.config_names`).
    name : str or path
        Name of a shipped file, or the path of a YAML file.
    what : str
        What such a file holds, for messages (``"robot"``).
    build : callable
        Takes what the file holds, and its name without suffix; raises ArtibotError that begins with the key's path.

    Raises
    ------
    ArtibotError
        Naming the file, the key, what was found, what was expected and the mend.
    """
    return read_document(_find(kind, name, what), what, build)


def read_document(path: Path, what: str, build: Callable[[Any, str], Built]) -> Built:
    """What `build` makes of the YAML file at `path`; `what` it is stands in error messages."""
    try:
        if path.stat().st_size > LARGEST:
            raise ArtibotError(f"{path}: larger than {LARGEST} bytes, expected a {what} file")
        text = path.read_text(encoding="utf-8")
        document = yaml.load(text, Loader=_Strict)  # which builds plain data alone
    except yaml.MarkedYAMLError as error:
        raise ArtibotError(f"{path}: not a YAML file: {_complaint(error, text)}") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ArtibotError(f"{path}: not a YAML file: {' '.join(str(error).split())}") from error
    except OSError as error:
        raise ArtibotError(f"{path}: cannot be read: {error.strerror}") from error
    try:
        return build(document, path.stem)
    except ArtibotError as error:
        raise ArtibotError(f"{path}: {error}") from error


def _complaint(error: yaml.MarkedYAMLError, text: str) -> str:
    """What is wrong with a text of YAML, where, and the mend of two usual mistakes."""
    what, mark = f"{error.problem}", error.problem_mark
    if mark is None:
        return what
    lines = text.splitlines()
    line = lines[mark.line] if mark.line < len(lines) else ""
    mend = ""
    if re.search(r"\d,\d", line):
        mend = "; decimals take a point: 0.5"
    if line[: mark.column + 1].strip(" ").startswith("\t"):
        mend = "; indent with spaces, not with tabs"
    return f"line {mark.line + 1}, column {mark.column + 1}: {what}{mend}"


def did_you_mean(word: object, known: Iterable[str]) -> str:
    """``", did you mean 'x'?"`` where one of `known` is close to `word`, else nothing."""
    match = difflib.get_close_matches(str(word), list(known), n=1, cutoff=0.5)
    return f", did you mean '{match[0]}'?" if match else ""


def _find(kind: str, name: str | os.PathLike[str], what: str) -> Path:
    text, names = os.fspath(name), config_names(kind)
    path = Path(text)
    if path.suffix in (".yaml", ".yml") or os.sep in text:
        if not path.is_file():
            raise ArtibotError(f"{path}: no such {what} file; give an existing file or one of {', '.join(names)}")
        return path
    if text not in names:
        raise ArtibotError(
            f"{what} '{text}': unknown{did_you_mean(text, names)}; "
            f"expected one of {', '.join(names)} or the path of a YAML file"
        )
    return config_path(kind, text)


class _Strict(_SafeLoader):
    """A safe loader that refuses a key given twice, where YAML would silently take the last."""


def _unique(loader: _Strict, node: yaml.MappingNode) -> dict[Any, Any]:
    loader.flatten_mapping(node)
    seen: set[Any] = set()
    for key_node, _ in node.value:
        key = loader.construct_object(key_node)
        if not isinstance(key, str):
            raise yaml.constructor.ConstructorError(None, None, f"key {key!r} is not a word", key_node.start_mark)
        if key in seen:
            raise yaml.constructor.ConstructorError(None, None, f"key '{key}' stands twice", key_node.start_mark)
        seen.add(key)
    return loader.construct_mapping(node, deep=True)


_Strict.add_constructor(yaml.resolver.BaseResolver.DEFAULT_MAPPING_TAG, _unique)
