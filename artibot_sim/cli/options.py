"""Options that several commands share: how a recording is read, and what of it is held out; options as one record."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from artibot_sim.errors import ArtibotError

if TYPE_CHECKING:
    from artibot_sim.experiment import Experiment
    from artibot_sim.model import Robot
    from artibot_sim.progress import Bar


def gathered(record: Callable[..., Any], name: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Give a command the options that are fields of a dataclass as one of its parameters.

    Parameters
    ----------
    record : dataclass
    name : str
        Of the parameter.
    """
    names = [field.name for field in fields(record)]  # type: ignore[arg-type]

    def decorated(command: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(command)
        def called(*args: Any, **given: Any) -> Any:
            return command(*args, **{name: record(**{each: given.pop(each) for each in names}), **given})

        return called

    return decorated


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


@dataclass(frozen=True)
class ReadingOptions:
    """What `reading_options` say: which topics and joints stand for which.

    Attributes
    ----------
    topics, joints : tuple of str
    namespace : str or None
    """

    topics: tuple[str, ...]
    joints: tuple[str, ...]
    namespace: str | None

    def recording(
        self, path: Path, bar: Bar, size: float, robot: Robot | None = None, most: int | None = None
    ) -> Experiment:
        """A recording, read as these options ask for.

        Parameters
        ----------
        path : Path
        bar : Bar
        size : float
            Of the stage that reading it is in that.
        robot : Robot, optional
            Whose wheels it recorded.
        most : int, optional
            Messages that are read at most.
        """
        from artibot_sim.experiment import open_recording

        return open_recording(
            path, robot, topics=self.topics, joints=self.joints, namespace=self.namespace, most=most,
            progress=bar.stage(f"reading {path.name}", size),
        )  # fmt: skip


@dataclass(frozen=True)
class GivenRecordings(ReadingOptions):
    """Recordings to fit to, and what is held out of them or beside them.

    Attributes
    ----------
    recordings, holdout : tuple of Path
    holdout_share : float or None
        Of every recording, instead of whole ones.
    """

    recordings: tuple[Path, ...]
    holdout: tuple[Path, ...]
    holdout_share: float | None

    def __post_init__(self) -> None:
        if self.holdout and self.holdout_share is not None:
            raise ArtibotError("--holdout and --holdout-share: give one of them")

    @property
    def count(self) -> int:
        """How many are read."""
        return len(self.recordings) + len(self.holdout)

    def read(
        self, robot: Robot, bar: Bar, size: float, most: int | None = None
    ) -> tuple[list[Experiment], list[Experiment]]:
        """What to fit to, and what to predict; parameters as in `recording`, for each one."""
        from artibot_sim.experiment.blocks import without_share

        used, held = (
            [self.recording(path, bar, size, robot, most) for path in paths]
            for paths in (self.recordings, self.holdout)
        )
        return (used, held) if self.holdout_share is None else without_share(used, self.holdout_share)
