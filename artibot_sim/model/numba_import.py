"""Numba, imported without what takes a third of the time until a first rollout and is never used here."""

from __future__ import annotations

import gc
import importlib.util
import sys
import types
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["FunctionCache", "config", "event", "numba"]


@contextmanager
def _undisturbed() -> Iterator[None]:
    """No search for garbage among ten thousand new objects, and no `coverage` but where it measures already.

    Numba imports coverage wherever it is installed, in case somebody measures with it.
    """
    collects, absent = gc.isenabled(), "coverage" not in sys.modules
    gc.disable()
    if absent:
        sys.modules["coverage"] = None  # type: ignore[assignment]  # so says Python that something cannot be imported
    try:
        yield
    finally:
        if absent:
            del sys.modules["coverage"]
        if collects:
            gc.enable()


def _spare_scipy() -> None:
    """Give numba the one extension module of SciPy that it asks for, without the package around it.

    Numba looks for a BLAS when it first compiles or loads anything, by importing `scipy.linalg`: a quarter of the
    time to a first rollout. Nothing changes for whoever imports `scipy.linalg` later.
    """
    package = "scipy.linalg"
    if package in sys.modules or importlib.util.find_spec("scipy") is None:
        return
    spec = importlib.util.find_spec(package)
    if spec is None or spec.submodule_search_locations is None:
        return
    stand_in = types.ModuleType(package)
    stand_in.__path__ = list(spec.submodule_search_locations)
    sys.modules[package] = stand_in
    try:
        importlib.import_module(f"{package}.cython_blas")
    except ImportError:
        pass  # numba will say what is missing, should anybody need it
    finally:
        del sys.modules[package]
        vars(sys.modules["scipy"]).pop("linalg", None)


with _undisturbed():
    import numba
    from numba.core import config, event
    from numba.core.caching import FunctionCache

    _spare_scipy()
