"""``artibot WORD …``, and every word as an executable of its own for ``ros2 run artibot_sim WORD …``.

Nothing but the word's own module is imported, so the help is instant and ``artibot recover`` needs no ROS. Command
lines are read by click (`artibot_sim.cli.group`); where that is missing, simulator and planner take ROS's arguments.
"""

from __future__ import annotations

import contextlib
import faulthandler
import gc
import importlib
import importlib.util
import sys
import sysconfig
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from artibot_sim import progress
from artibot_sim.cli.words import COMMANDS
from artibot_sim.errors import ArtibotError

_NAMES = (
    "canopen click distributed lz4 matplotlib mcap mujoco numba numpy plotly pyarrow rich rosbags scipy viser zstandard"
)
PACKAGES = {
    **{name: name for name in _NAMES.split()},
    "can": "python-can",
    "can_remote": "python-can-remote",
    "dask": "distributed",
    "yaml": "pyyaml",
}
"""Modules of other projects → the packages on PyPI that bring them. Each is imported only where it is used."""

EXIT_BAD_INPUT = 2
"""Exit status for input that cannot be used."""

EXIT_INTERRUPTED = 130
"""Exit status after Ctrl-C, as shells have it."""

WITHOUT_CLICK = {"sim": "run_sim", "planner": "run_planner"}
"""Word → function of `artibot_sim.nodes.plain` that does what it does without options."""


def program() -> int:
    """The program ``artibot``: `main`, and nothing of rclpy is left where the process ends."""
    with _swept():
        return main()


@contextlib.contextmanager
def _swept() -> Iterator[None]:
    """Leave no node, executor or context to the process's end.

    They refer to each other, and what a loop froze is never collected by itself: the middleware would take its
    participant down while its threads still read there.
    """
    try:
        yield
    finally:
        if "rclpy" in sys.modules:
            gc.unfreeze()
            gc.collect()


def main(argv: Sequence[str] | None = None) -> int:
    """``artibot``: run a command line and return the exit status.

    Input that cannot be used gives one line on standard error and status 2.
    """
    args = list(sys.argv[1:] if argv is None else argv)

    def run() -> Any:
        if args and _is_plain(args[0], args[1:]):
            return _run_plain(args[0], args[1:])
        from artibot_sim.cli.group import run_artibot

        return run_artibot(args)

    return _guard(run)


def executable() -> int:
    """An executable that is called as the word itself (``lib/artibot_sim/sim``, which ``ros2 run`` starts)."""
    word, args = Path(sys.argv[0]).stem, sys.argv[1:]
    if word not in COMMANDS:
        print(f"{sys.argv[0]}: no command has this name; expected one of {', '.join(COMMANDS)}", file=sys.stderr)
        return EXIT_BAD_INPUT

    def run() -> Any:
        if _is_plain(word, args):
            return _run_plain(word, args)
        from artibot_sim.cli.group import run_executable

        return run_executable(word, args)

    with _swept():
        return _guard(run)


def _is_plain(word: str, args: Sequence[str]) -> bool:
    """Whether click is missing, and a command line can do without: a node's, with arguments for ROS or none."""
    without = word in WITHOUT_CLICK and (not args or args[0] == "--ros-args") and "--" not in args
    return without and importlib.util.find_spec("click") is None


def _run_plain(word: str, args: Sequence[str]) -> Any:
    return getattr(importlib.import_module("artibot_sim.nodes.plain"), WITHOUT_CLICK[word])({}, list(args))


def _guard(run: Callable[[], Any]) -> int:
    progress.compiling[:] = [progress.CompilationNotice()]
    if not faulthandler.is_enabled():
        with contextlib.suppress(AttributeError, OSError, RuntimeError, ValueError):  # no standard error, or no file
            faulthandler.enable()  # a crash in compiled code says where it was, instead of nothing at all
    try:
        status = run()
    except ArtibotError as error:
        return _refuse(str(error))
    except ModuleNotFoundError as error:
        missing = (error.name or "").partition(".")[0]
        if missing == "rclpy" or missing.endswith(("_msgs", "_srvs", "_interfaces")):
            return _refuse(
                f"{missing}: not found; this command needs ROS 2: source it, or pip install 'artibot_sim[ros]'"
            )
        if missing in PACKAGES:
            return _refuse(f"{missing}: not found; this command needs it: {_pip()} install {PACKAGES[missing]}")
        raise
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
    return status if isinstance(status, int) else 0


def _pip() -> str:
    """How to call pip for this interpreter; one that belongs to the system needs an option that allows to add to it."""
    ours = sys.prefix != sys.base_prefix
    kept = not ours and (Path(sysconfig.get_path("stdlib")) / "EXTERNALLY-MANAGED").exists()
    return f"{sys.executable} -m pip{' --break-system-packages' if kept else ''}"


def _refuse(message: str) -> int:
    print(f"artibot: {' '.join(message.split())}", file=sys.stderr)
    return EXIT_BAD_INPUT
