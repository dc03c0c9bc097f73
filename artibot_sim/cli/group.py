"""``artibot`` for click: a group whose commands are imported when they are run, and what click's refusals end with."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from typing import Any

import click

from artibot_sim.cli.words import COMMANDS
from artibot_sim.version import __version__

_HELP: dict[str, Any] = {"help_option_names": ["-h", "--help"]}
"""Every command answers to both."""


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
        called = program or f"artibot {word}"
        status = target.main(args=list(args), prog_name=called, standalone_mode=False, **_HELP)
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

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """The word's stand-in; an unknown word is refused with the one that is like it."""
        if args[0] not in COMMANDS:
            from artibot_sim.documents import did_you_mean

            ctx.fail(f"No such command '{args[0]}'{did_you_mean(args[0], COMMANDS) or '.'}")
        return super().resolve_command(ctx, args)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The word's stand-in, or None."""
        return StandIn(cmd_name, short_help=COMMANDS[cmd_name].help) if cmd_name in COMMANDS else None


@click.group(cls=Words, context_settings=_HELP)
@click.version_option(__version__, prog_name="artibot")
def artibot() -> None:
    """Simulate, drive, record, identify and diagnose articulated eight-wheel rovers.

    \b
    artibot demo                        the whole tour in a minute
    artibot sim --robot agriq           a rover that waits for commands
    artibot planner table6_agriq        and a trajectory for it
    artibot WORD --help                 more about one command
    """


def run_artibot(args: Sequence[str]) -> Any:
    """Run a command line of ``artibot``; return what its command returns, or the status of what click refuses.

    Parameters
    ----------
    args : sequence of str
        The word and what follows it.
    """
    return _refusals_shown(lambda: artibot.main(args=list(args), prog_name="artibot", standalone_mode=False))


def run_executable(word: str, args: Sequence[str]) -> Any:
    """Run a command that was called by its own name, as ``ros2 run`` does.

    Parameters
    ----------
    word : str
        A key of :data:`artibot_sim.cli.words.COMMANDS`.
    args : sequence of str
    """
    return _refusals_shown(lambda: run_word(word, args, program=word))


def _refusals_shown(run: Callable[[], Any]) -> Any:
    try:
        return run()
    except click.ClickException as error:
        error.show()
        return error.exit_code
    except click.Abort as abort:
        raise KeyboardInterrupt from abort
