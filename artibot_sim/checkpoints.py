"""Finished parts of a long computation on disk, so that the same computation goes on after it was broken off.

The parts are numbered in the order in which they are made. The same inputs make the same parts in the same order, so
those that are there are taken as they are, up to the first that is missing. Where inputs, options or version differ,
everything begins anew.
"""

from __future__ import annotations

import json
import os
import pickle
import shutil
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar, cast

from artibot_sim.errors import ArtibotError

Part = TypeVar("Part")

_KEY = "key"
"""File that holds what the parts are of."""
_RUNNING = "running"
"""File that is there while a process computes: one that was killed leaves it behind."""
_BY_OTHERS = ("SIGTERM", "SIGHUP")
"""Signals by which a machine that shuts down, a scheduler or a terminal that is closed ends a process."""


class Checkpoints:
    """Finished parts in a folder, or none of them kept.

    Parts are pickled: they are read back by the same version of the same program, from a folder that it made itself.
    Whoever may write there could run code, as with any program's cache.

    Parameters
    ----------
    folder : Path, optional
        Made when the first part is kept; nothing is kept without one.

    Attributes
    ----------
    taken : int
        Parts that an earlier computation had finished.
    killed : str
        What is known of an earlier computation that ended without a word; empty where none did.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self.folder, self.taken = folder, 0
        self.killed = "" if folder is None else _killed(folder / _RUNNING)
        self._shared: tuple[Any, ...] = ()
        self._number, self._going_on = 0, False
        self._begun = time.perf_counter()

    def begin(self, key: str, shared: Sequence[Any] = ()) -> None:
        """Say what the parts are of.

        Parameters
        ----------
        key : str
            Equal where inputs, options and version are: only then earlier parts are taken.
        shared : sequence
            Large objects that every computation makes itself before its first part; parts refer to them.
        """
        self._shared = tuple(shared)
        if self.folder is None:
            return
        stated = self.folder / _KEY
        self._going_on = stated.is_file() and stated.read_text("utf-8", "replace") == key
        try:
            if not self._going_on:
                if stated.is_file():  # of other inputs, or another version
                    shutil.rmtree(self.folder)
                self.folder.mkdir(parents=True, exist_ok=True)
                _written(stated, key.encode())
            self._note_running()
        except OSError as error:
            raise ArtibotError(f"{self.folder}: cannot be made: {error.strerror}; give another --out") from error

    def once(self, name: str, make: Callable[[], Part]) -> Part:
        """The next part: as it was kept, or made and kept.

        Parameters
        ----------
        name : str
            Of the part: a kept one of another name is of another course of the computation.
        make : callable
        """
        number, self._number = self._number, self._number + 1
        if self.folder is None:
            return make()
        path = self.folder / f"{number:03d}"
        if self._going_on:
            try:
                stated, elapsed, part = self._read(path)
            except Exception:  # noqa: BLE001  what is missing, cut off or damaged is no part, whatever it raises
                stated = None
            if stated == name:
                self.taken += 1
                self._begun = min(self._begun, time.perf_counter() - elapsed)
                return cast("Part", part)
            self._going_on = False
            for later in self.folder.glob("[0-9]*"):
                if int(later.name) >= number:
                    later.unlink()
        part = make()
        self._write(path, (name, self.elapsed, part))
        return part

    @property
    def kept(self) -> int:
        """Parts in the folder."""
        return 0 if self.folder is None else len(list(self.folder.glob("[0-9]*")))

    @property
    def elapsed(self) -> float:
        """s that the computation took so far, what was broken off included up to its last part."""
        return time.perf_counter() - self._begun

    def done(self) -> None:
        """The computation is over: its parts are needed no more."""
        if self.folder is not None:
            shutil.rmtree(self.folder, ignore_errors=True)

    @contextmanager
    def announced(self, tell: Callable[[str], None]) -> Iterator[None]:
        """Within, `tell` says what is kept when Ctrl-C or a signal ends the computation, and which one was killed.

        A signal that asks for the end (SIGTERM, SIGHUP) ends the process with 128 and its number, as shells have it.
        """
        if self.killed:
            tell(f"note: {self.killed}")
        came: list[signal.Signals] = []

        def end(number: int, _frame: Any) -> None:
            came.append(signal.Signals(number))
            raise KeyboardInterrupt

        with _handled(end):
            try:
                yield
            except KeyboardInterrupt:
                what = f"ended by {came[0].name}" if came else "interrupted"
                kept = f"what was finished is kept in {self.folder}; the same command goes on"
                tell(f"{what}: {kept if self.kept else 'nothing was finished yet, nothing is kept'}")
                if came:
                    raise SystemExit(128 + came[0]) from None
                raise
            finally:
                if self.folder is not None:
                    with suppress(OSError):
                        (self.folder / _RUNNING).unlink(missing_ok=True)

    def _note_running(self) -> None:
        """That this process computes, for how long, and with how much memory: it cannot say so once it is killed."""
        assert self.folder is not None
        stated = {"pid": os.getpid(), "seconds": round(self.elapsed), "megabytes": _peak_memory()}
        _written(self.folder / _RUNNING, json.dumps(stated).encode())

    def _read(self, path: Path) -> tuple[str, float, Any]:
        with path.open("rb") as stream:
            stated: tuple[str, float, Any] = _Reader(stream, self._shared).load()
        return stated

    def _write(self, path: Path, stated: tuple[str, float, Any]) -> None:
        """A full disk, or a part that cannot be pickled, costs what is kept, not the computation."""
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=".part.")
        try:
            with os.fdopen(handle, "wb") as stream:
                _Writer(stream, self._shared).dump(stated)
            os.replace(temporary, path)
        except (OSError, TypeError, AttributeError, pickle.PicklingError):
            Path(temporary).unlink(missing_ok=True)
        with suppress(OSError):
            self._note_running()


def _killed(running: Path) -> str:
    """What the file of a process that runs no more says of its end."""
    try:
        stated = json.loads(running.read_text("utf-8"))
        pid, seconds, megabytes = (int(stated[name]) for name in ("pid", "seconds", "megabytes"))
    except (OSError, ValueError, KeyError, TypeError):
        return ""
    if pid == os.getpid() or _runs(pid):
        return ""
    return (
        f"an earlier call (process {pid}) was killed after {seconds} s or more, perhaps for lack of memory: it had "
        f"taken {megabytes} MB by then; with fewer --workers or shorter recordings it takes less"
    )


def _runs(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:  # another user's
        return True
    return True


def _peak_memory() -> int:
    """MB that this process has taken at most; 0 where the system does not say."""
    try:
        import resource
    except ModuleNotFoundError:
        return 0
    unit = 1 if sys.platform == "darwin" else 1024  # bytes there, kB elsewhere
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit // 1_000_000


@contextmanager
def _handled(handler: Callable[[int, Any], None]) -> Iterator[None]:
    """Within, `handler` takes signals that ask for the end, but those that are ignored (nohup)."""
    before = {}
    if threading.current_thread() is threading.main_thread():
        for number in (getattr(signal, name) for name in _BY_OTHERS if hasattr(signal, name)):
            if signal.getsignal(number) is signal.SIG_DFL:
                before[number] = signal.signal(number, handler)
    try:
        yield
    finally:
        for number, was in before.items():
            signal.signal(number, was)


def _written(path: Path, data: bytes) -> None:
    temporary = path.with_name(f".{path.name}")
    temporary.write_bytes(data)
    os.replace(temporary, path)


def _read_only(content: dict[Any, Any]) -> MappingProxyType[Any, Any]:
    return MappingProxyType(content)


class _Writer(pickle.Pickler):
    """Writes shared objects as their numbers."""

    def __init__(self, stream: Any, shared: Sequence[Any]) -> None:
        super().__init__(stream, protocol=pickle.HIGHEST_PROTOCOL)
        self._numbers = {id(one): number for number, one in enumerate(shared)}

    def persistent_id(self, obj: Any) -> int | None:
        """The number of a shared object."""
        return self._numbers.get(id(obj))

    def reducer_override(self, obj: Any) -> Any:
        """How to write what pickle does not know: read-only mappings."""
        return (_read_only, (dict(obj),)) if isinstance(obj, MappingProxyType) else NotImplemented


class _Reader(pickle.Unpickler):
    """Puts shared objects where their numbers are."""

    def __init__(self, stream: Any, shared: Sequence[Any]) -> None:
        super().__init__(stream)
        self._shared = shared

    def persistent_load(self, pid: Any) -> Any:
        """The shared object of a number."""
        return self._shared[pid]
