"""How the model's loops are compiled: numba, cached on disk by the content of the model's sources."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from artibot_sim import progress
from artibot_sim.model.numba_import import config, event, numba

Function = TypeVar("Function", bound=Callable[..., Any])

_FAST = {"contract", "nsz"}
"""Contraction to fused multiply-adds only: no reordering, and NaN stays visible to the divergence check."""


def cache_folder() -> Path:
    """Where compiled code is kept.

    Numba looks only at the file of the outermost function when it decides whether cached code is stale; the
    contact law is inlined from another file. So the folder's name is a hash of all of the model's sources.
    """
    digest = hashlib.sha256()
    for source in sorted(Path(__file__).parent.rglob("*.py")):
        digest.update(source.read_bytes())
    root = os.environ.get("ARTIBOT_CACHE_DIR") or os.path.join(
        os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"), "artibot"
    )
    return Path(root) / "numba" / digest.hexdigest()[:16]


_CACHE = str(cache_folder())


class _Compiling(event.Listener):
    """Tells those who want to know when numba compiles something that the model's folder does not have."""

    def __init__(self) -> None:
        self._depth = 0

    def on_start(self, event: event.Event) -> None:
        """Called for a loop, and for every piece that is compiled into it."""
        self._depth += 1
        if self._depth == 1:
            self._tell(True)

    def on_end(self, event: event.Event) -> None:
        """Called in the reverse order."""
        self._depth -= 1
        if self._depth == 0:
            self._tell(False)

    def _tell(self, begins: bool) -> None:
        for hear in progress.compiling:
            hear(begins)


event.register("numba:compile", _Compiling())


def _jit(function: Function, **options: Any) -> Function:
    saved = config.CACHE_DIR  # type: ignore[attr-defined]  # numba sets its options when it is imported
    config.CACHE_DIR = _CACHE  # type: ignore[attr-defined]  # read when the function is decorated, so other users of numba keep their own
    try:
        compiled: Function = numba.njit(error_model="numpy", fastmath=_FAST, **options)(function)
        return compiled
    finally:
        config.CACHE_DIR = saved  # type: ignore[attr-defined]


def inlined(function: Function) -> Function:
    """A piece of the model, compiled into whatever calls it; it allocates nothing.

    Python cannot call it: without the wrappers for that, everything compiles in half the time.
    """
    return _jit(function, forceinline=True, _nrt=False, no_cpython_wrapper=True, no_cfunc_wrapper=True)


def kernel(function: Function) -> Function:
    """A loop that Python calls: compiled once, cached on disk, runs without the interpreter's lock.

    It allocates nothing either: counting references to arrays would cost half of its speed.
    """
    return _jit(function, cache=True, nogil=True, _nrt=False, no_cfunc_wrapper=True)
