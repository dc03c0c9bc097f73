"""``artibot WORD …``, and every word as an executable of its own for ``ros2 run artibot_sim WORD …``.

Nothing but the word's own module is imported, so the help is instant and ``artibot recover`` needs no ROS.
"""

from __future__ import annotations

import importlib
import sys
import sysconfig
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

from artibot_sim import progress
from artibot_sim.cli.words import COMMANDS
from artibot_sim.errors import ArtibotError
from artibot_sim.version import __version__

_NAMES = "canopen distributed lz4 matplotlib mcap mujoco numba numpy plotly pyarrow rich rosbags scipy zstandard"
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


def run_word(word: str, args: Sequence[str], program: str | None = None) -> int:
    """Run one command with its arguments and return its exit status.

    Parameters
    ----------
    word : str
        A key of :data:`artibot_sim.cli.words.COMMANDS`.
    args : sequence of str
        Its arguments as typed, ``--ros-args …`` included.
    program : str, optional
        How the help calls the command; by default ``artibot WORD``.

    Raises
    ------
    click.ClickException, ArtibotError
        For input that cannot be used.
    """
    module, _, name = COMMANDS[word].target.partition(":")
    target: Any = getattr(importlib.import_module(module), name)
    if isinstance(target, click.Command):
        status = target.main(args=list(args), prog_name=program or f"artibot {word}", standalone_mode=False)
    else:
        status = target(list(args))
    return status if isinstance(status, int) else 0


class StandIn(click.Command):
    """Takes the place of a command until it is called, and hands all arguments on as they were typed."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse nothing: ``--help``, ``--`` and ``--ros-args`` are the real command's to read."""
        ctx.args = list(args)
        return ctx.args

    def invoke(self, ctx: click.Context) -> int:
        """Run the real command."""
        return run_word(str(self.name), ctx.args)


class Words(click.Group):
    """A group that knows its commands from a table and imports one only to run it."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """All words, in the table's order."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The word's stand-in, or None."""
        return StandIn(cmd_name, short_help=COMMANDS[cmd_name].help) if cmd_name in COMMANDS else None


@click.group(cls=Words, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="artibot")
def artibot() -> None:
    """Simulate, drive, record, identify and diagnose articulated eight-wheel rovers.

    \b
    artibot demo                        the whole tour in a minute
    artibot sim --robot agriq           a rover that waits for commands
    artibot planner table6_agriq        and a trajectory for it
    artibot WORD --help                 more about one command
    """


def main(argv: Sequence[str] | None = None) -> int:
    """``artibot``: run a command line and return the exit status.

    Input that cannot be used gives one line on standard error and status 2.
    """
    args = list(sys.argv[1:] if argv is None else argv)
    return _guard(lambda: artibot.main(args=args, prog_name="artibot", standalone_mode=False))


def executable() -> int:
    """An executable that is called as the word itself (``lib/artibot_sim/sim``, which ``ros2 run`` starts)."""
    word = Path(sys.argv[0]).stem
    if word not in COMMANDS:
        print(f"{sys.argv[0]}: no command has this name; expected one of {', '.join(COMMANDS)}", file=sys.stderr)
        return EXIT_BAD_INPUT
    return _guard(lambda: run_word(word, sys.argv[1:], program=word))


def _guard(run: Callable[[], Any]) -> int:
    progress.compiling[:] = [progress.CompilationNotice()]
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
    except click.ClickException as error:
        error.show()
        return error.exit_code
    except (click.Abort, KeyboardInterrupt):
        return EXIT_INTERRUPTED
    return status if isinstance(status, int) else 0


def _pip() -> str:
    """How to call pip for this interpreter; one that belongs to the system wants to hear that it may be added to."""
    ours = sys.prefix != sys.base_prefix
    kept = not ours and (Path(sysconfig.get_path("stdlib")) / "EXTERNALLY-MANAGED").exists()
    return f"{sys.executable} -m pip{' --break-system-packages' if kept else ''}"


def _refuse(message: str) -> int:
    print(f"artibot: {' '.join(message.split())}", file=sys.stderr)
    return EXIT_BAD_INPUT
