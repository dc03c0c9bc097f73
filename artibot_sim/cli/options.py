"""Options that several commands share: how a recording is read, and what of it is held out."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import click


def reading_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """The options ``--topic``, ``--joint`` and ``--namespace``: `topics`, `joints` and `namespace` of a command."""
    options = (
        click.option(
            "--topic", "topics", multiple=True, metavar="WANTED=FOUND", help="Read topic FOUND as WANTED; repeatable."
        ),
        click.option(
            "--joint", "joints", multiple=True, metavar="WANTED=FOUND[,FOUND]",
            help="Take joints FOUND (their mean) as motor WANTED, such as front_right; repeatable.",
        ),
        click.option(
            "--namespace", metavar="NAME", help="Rover whose topics to read, where there are several: /rover1."
        ),
    )  # fmt: skip
    for option in reversed(options):
        command = option(command)
    return command


holdout_share_option = click.option(
    "--holdout-share", type=click.FloatRange(0.0, 1.0, min_open=True, max_open=True), metavar="SHARE",
    help="Share of every recording to predict, not to fit, such as 0.5: blocks of 12 s of it in turn.",
)  # fmt: skip
