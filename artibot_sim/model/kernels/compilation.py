"""How the model's loops are compiled: numba, cached on disk by the content of the model's sources."""

from __future__ import annotations

import fcntl
import functools
import gc
import hashlib
import importlib.util
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

from artibot_sim import progress

# ----------------------------------------------------------------------
# Tricks, and how each is left out.
# ----------------------------------------------------------------------


TRICKS = {
    "coverage": "numba is imported without `coverage`",
    "scipy": "numba gets the one module of SciPy that it asks for",
    "garbage": "no search for garbage while numba is imported or compiles, nor later among what was imported",
    "stack": "loops over rovers side by side have their stack begin where a line of the cache does",
    "contraction": "a product and a sum become one operation, and no zero has a sign",
    "pieces": "what is compiled into loops alone is never made machine code by itself",
    "passes": "what is compiled into loops alone does not go through numba's passes for what it has not",
}
"""What is done beside numba's own ways, by the name that leaves it out: ``ARTIBOT_WITHOUT=scipy,stack``.

What each gains stands in docs/performance.md. Results are the same without; without contraction to rounding.
"""

_WITHOUT = frozenset(os.environ.get("ARTIBOT_WITHOUT", "").split(",")) & TRICKS.keys()


# ----------------------------------------------------------------------
# Numba, imported without what takes a third of the time until a first rollout and is never used here.
# ----------------------------------------------------------------------


__all__ = ["FunctionCache", "config", "event", "numba"]


@contextmanager
def _undisturbed() -> Iterator[None]:
    """No search for garbage among ten thousand new objects, and no `coverage` but where it measures already.

    What was imported stays, so no later search goes through it either. Numba imports coverage wherever it is installed,
    in case somebody measures with it.
    """
    collects, absent = gc.isenabled() and "garbage" not in _WITHOUT, "coverage" not in {*sys.modules, *_WITHOUT}
    if collects:
        gc.disable()
    if absent:
        sys.modules["coverage"] = None  # type: ignore[assignment]  # so says Python that something cannot be imported
    try:
        yield
    finally:
        if absent:
            del sys.modules["coverage"]
        if collects:
            gc.freeze()
            gc.enable()


def _spare_scipy() -> None:
    """Give numba the one extension module of SciPy that it asks for, without the package around it.

    Numba looks for a BLAS when it first compiles or loads anything, by importing `scipy.linalg`: a quarter of the
    time to a first rollout. Nothing changes for whoever imports `scipy.linalg` later.
    """
    package = "scipy.linalg"
    if package in sys.modules or "scipy" in _WITHOUT or importlib.util.find_spec("scipy") is None:
        return
    spec = importlib.util.find_spec(package)
    if spec is None or spec.submodule_search_locations is None:
        return
    stand_in = ModuleType(package)
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
    from llvmlite import ir
    from numba.core import cgutils, config, event, typed_passes, types, untyped_passes
    from numba.core.caching import FunctionCache, IndexDataCacheFile
    from numba.core.codegen import JITCodeLibrary
    from numba.core.compiler import Compiler
    from numba.core.compiler_machinery import PassManager
    from numba.extending import intrinsic

    _spare_scipy()


# ----------------------------------------------------------------------
# How the model's loops are compiled: numba, cached on disk by the content of the model's sources.
# ----------------------------------------------------------------------


Function = TypeVar("Function", bound=Callable[..., Any])

_FAST: set[str] = set() if "contraction" in _WITHOUT else {"contract", "nsz"}
"""Contraction to fused multiply-adds only: no reordering, and NaN stays visible to the divergence check."""


def cache_folder() -> Path:
    """Where compiled code is kept.

    Numba looks only at the file of the outermost function when it decides whether cached code is stale; the
    contact law is inlined from another file. So the folder's name is a hash of all of the model's sources.
    """
    digest = hashlib.sha256()
    for source in sorted(Path(__file__).parents[1].rglob("*.py")):
        digest.update(source.read_bytes())
    for trick in sorted(_WITHOUT & {"stack", "contraction", "pieces", "passes"}):
        digest.update(trick.encode())
    root = os.environ.get("ARTIBOT_CACHE_DIR") or os.path.join(
        os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"), "artibot"
    )
    return Path(root) / "numba" / digest.hexdigest()[:16]


_CACHE = str(cache_folder())

_PATIENCE = 300.0
"""How long a process waits for another that compiles the same loop, s; then it compiles for itself."""
_PAUSE = 0.05


class _Compiling(event.Listener):
    """Tells those who want to know when numba compiles something that the model's folder does not have."""

    def __init__(self) -> None:
        self._depth = 0

    def on_start(self, event: event.Event | None) -> None:
        """Called for a loop, and for every piece that is compiled into it."""
        self._depth += 1
        if self._depth == 1:
            self._notify(True)

    def on_end(self, event: event.Event | None) -> None:
        """Called in the reverse order."""
        self._depth -= 1
        if self._depth == 0:
            self._notify(False)

    def _notify(self, begins: bool) -> None:
        for listener in progress.compiling:
            listener(begins)


_COMPILING = _Compiling()
event.register("numba:compile", _COMPILING)


class _Uncollected(event.Listener):
    """No search for garbage while numba compiles: it makes a million objects, and most of them stay until it ends."""

    def __init__(self) -> None:
        self._depth, self._collects = 0, False

    def on_start(self, event: event.Event) -> None:
        """Called for a loop, and for every piece that is compiled into it."""
        self._depth += 1
        if self._depth == 1:
            self._collects = gc.isenabled()
            gc.disable()

    def on_end(self, event: event.Event) -> None:
        """Called in the reverse order."""
        self._depth -= 1
        if self._depth == 0 and self._collects:
            gc.enable()


if "garbage" not in _WITHOUT:
    event.register("numba:compile", _Uncollected())


class _NoEnvironment:
    """In the place of a piece's code generator: nothing runs that would want an environment."""

    def set_env(self, name: str, environment: Any) -> None:
        """Do nothing."""


class _Piece(JITCodeLibrary):
    """The code of a piece: optimised for the loops that take it in, and never made machine code by itself.

    Numba would make machine code of every function, for Python to call. That is a tenth of the time until a first
    rollout; each loop has its own copies of its pieces.
    """

    @property
    def codegen(self) -> Any:
        """What numba gives environments to."""
        return _NoEnvironment()

    def get_pointer_to_function(self, name: str) -> int:
        """None: nobody calls it."""
        return 0

    def serialize_using_object_code(self) -> tuple[str, str, bytes]:
        """What is kept on disk: what loops take in."""
        kept: tuple[str, str, bytes] = self.serialize_using_bitcode()
        return kept

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True


_NEEDLESS = (
    untyped_passes.InlineClosureLikes, untyped_passes.WithLifting, untyped_passes.RewriteDynamicRaises,
    untyped_passes.FindLiterallyCalls, untyped_passes.LiteralUnroll, untyped_passes.LiteralPropagationSubPipelinePass,
    untyped_passes.MakeFunctionToJitFunction, typed_passes.InlineOverloads, typed_passes.NopythonRewrites,
)  # fmt: skip
"""Numba's passes for what no piece has: functions within functions, `with`, `raise`, expressions of whole arrays."""


class _PieceCompiler(Compiler):
    """Numba's, whose results are pieces, without the passes for what no piece has."""

    def define_pipelines(self) -> list[Any]:
        """The passes that a piece goes through."""
        (usual,) = super().define_pipelines()
        if "passes" in _WITHOUT:
            return [usual]
        fewer = PassManager(usual.pipeline_name)
        for each, words in usual.passes:
            if each not in _NEEDLESS:
                fewer.add_pass(each, words)
        fewer.finalize()
        return [fewer]

    def compile_extra(self, function: Callable[..., Any]) -> Any:
        """Compile a function."""
        self.state.library = _Piece(self.state.targetctx.codegen(), function.__qualname__)
        return super().compile_extra(function)


@functools.cache
def _digest(file: str) -> str:
    return hashlib.sha256(Path(file).read_bytes()).hexdigest()


def _given_functions(sig: Any) -> bool:
    """Whether an argument is a compiled function: no other process has the same one, so none would find what is kept.

    Its type holds the function weakly, too: a list of versions that was read from disk could not be written again.
    """
    return any(isinstance(one, numba.types.Dispatcher) for one in sig)


class _Shared(FunctionCache):
    """Numba's cache of one function: of processes that miss a version of it one compiles, the others wait and load.

    The pieces of a loop are kept, too: two versions of a loop share most of them, and a process that needs the second
    one compiles only the rest. No piece calls itself, so no two processes wait for each other. The kernel lets go of
    the lock of a process that is killed. Within a process numba lets one thread compile at once.

    Numba keeps apart what was compiled from another folder or at another time. Here the sources' contents decide, so
    that a checkout and what is installed of it share what they compile.
    """

    def __init__(self, function: Callable[..., Any], library: type | None) -> None:
        self._function, self._library, self._lock, self._opens = function, library, -1, True

    def _open(self) -> None:
        """What numba does at once: of some hundred functions most are never asked for, once the loops are compiled."""
        saved = config.CACHE_DIR  # type: ignore[attr-defined]  # numba sets its options when it is imported
        config.CACHE_DIR = _CACHE  # type: ignore[attr-defined]  # other users of numba keep their own
        try:
            super().__init__(self._function)
        finally:
            config.CACHE_DIR = saved  # type: ignore[attr-defined]
        self._opens = False
        self._cache_path = os.path.join(_CACHE, self._function.__module__)
        source = _digest(self._function.__code__.co_filename)
        self._cache_file = IndexDataCacheFile(self._cache_path, self._impl.filename_base, source)
        self._index_path = self._cache_file._index_path

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """What is on disk, or None where this process is to compile: then it holds the lock."""
        if self._opens:
            self._open()
        if _given_functions(sig):
            return None
        found = self._loaded(sig, target_context)
        if found is None and self._held(hashlib.sha256(repr(sig).encode()).hexdigest()[:16]):
            found = self._loaded(sig, target_context)  # another may have been at it
            if found is not None:
                self._let_go()
        return found

    def _loaded(self, sig: Any, target_context: Any) -> Any:
        """What numba finds, which makes itself ready to load for a millisecond even where no file is."""
        if not os.path.exists(self._index_path):
            return None
        codegen = target_context.codegen()
        if self._library is not None:
            codegen._library_class = self._library  # numba's lock is held, nothing else is compiled or loaded
        try:
            return super().load_overload(sig, target_context)
        finally:
            vars(codegen).pop("_library_class", None)

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep what was compiled, and let the others load it.

        Without the table of types that numba prints on demand: to write it is a third of what keeping costs.
        """
        if _given_functions(sig):
            return
        data = data._replace(type_annotation="")
        try:
            with self._index_locked():
                super().save_overload(sig, data)
        finally:
            self._let_go()

    @contextmanager
    def _index_locked(self) -> Iterator[None]:
        """The list of all versions, for one process at a time: numba reads it, adds to it and writes it."""
        with ExitStack() as stack:
            with suppress(OSError):  # a file system without locks
                lock = self._opened("index")
                stack.callback(os.close, lock)
                fcntl.flock(lock, fcntl.LOCK_EX)
            yield

    def _opened(self, of: str) -> int:
        Path(self.cache_path).mkdir(parents=True, exist_ok=True)
        return os.open(f"{self.cache_path}/{self._impl.filename_base}.{of}.lock", os.O_RDWR | os.O_CREAT, 0o666)

    def _held(self, version: str) -> bool:
        """Take a version's lock, or wait for it; False where there can be none, or whoever has it takes too long."""
        self._let_go()  # that of a compilation that failed
        try:
            self._lock = self._opened(version)
            if not self._taken() and not self._waited():
                self._let_go()
        except OSError:  # a file system without locks
            self._let_go()
        return self._lock >= 0

    def _taken(self) -> bool:
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True

    def _waited(self) -> bool:
        """Wait for the lock; whoever wants to know is called when somebody compiles."""
        until = time.monotonic() + _PATIENCE
        _COMPILING.on_start(None)
        try:
            while time.monotonic() < until:
                time.sleep(_PAUSE)
                if self._taken():
                    return True
            return False
        finally:
            _COMPILING.on_end(None)

    def _let_go(self) -> None:
        if self._lock >= 0:
            os.close(self._lock)
            self._lock = -1


def _jit(function: Function, piece: bool, **options: Any) -> Function:
    if library := _Piece if piece and "pieces" not in _WITHOUT else None:
        options["pipeline_class"] = _PieceCompiler
    compiled: Any = numba.njit(error_model="numpy", fastmath=_FAST, **options)(function)
    # Numba finds again what stands in a file and whose name tells all: neither what was put together from a text nor
    # what holds other functions.
    found_again = function.__closure__ is None and Path(function.__code__.co_filename).exists()
    if found_again and compiled is not function:  # as it is where numba is told to compile nothing
        compiled._cache = _Shared(function, library)  # what numba's own option `cache` sets
    return compiled


def inlined(function: Function) -> Function:
    """A piece of the model, compiled into whatever calls it; it allocates nothing.

    Python cannot call it: without the wrappers for that, everything compiles in half the time.
    """
    return _jit(function, True, forceinline=True, _nrt=False, no_cpython_wrapper=True, no_cfunc_wrapper=True)


def called(function: Function) -> Function:
    """A piece of the model that stays a function: for what is long, asked for in many places and seldom needed.

    Numba must be told: what is said of a caller holds for whatever it calls, unless that is said to be otherwise.
    """
    return _jit(function, True, forceinline=False, _nrt=False, no_cpython_wrapper=True, no_cfunc_wrapper=True)


def kernel(function: Function) -> Function:
    """A loop that Python calls: compiled once, cached on disk, runs without the interpreter's lock.

    It allocates nothing either: counting references to arrays would cost half of its speed.
    """
    return _jit(function, False, nogil=True, _nrt=False, no_cfunc_wrapper=True)


def _line_up_stack(typing_context: Any) -> Any:
    """Have the stack of the loop that calls this begin where a line of the cache does.

    Compilers put aside in the stack what registers have no room for. They line it up only where something there wants
    that: here a variable that nobody reads.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        if "stack" not in _WITHOUT:
            variable = cgutils.alloca_once(builder, ir.ArrayType(ir.DoubleType(), 8))
            variable.align = 64
            empty = ir.FunctionType(ir.VoidType(), [variable.type])
            builder.asm(empty, "", "r", [variable], side_effect=True)
        return context.get_dummy_value()

    return types.none(), generate


line_up_stack: Any = intrinsic(_line_up_stack)
