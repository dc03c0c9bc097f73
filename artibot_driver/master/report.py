"""What a cycle gives: feedback and status from what the drives have said."""

from __future__ import annotations

import math
from collections.abc import Sequence

from artibot_driver.config import DriverConfig
from artibot_driver.master import watch
from artibot_driver.master.link import TORQUE, VELOCITY, Link
from artibot_driver.master.values import DriveStatus, Feedback, Four, Stage


def feedback(links: Sequence[Link], now: int, config: DriverConfig) -> Feedback:
    """What the drives have reported; NaN for those that are silent or not set up."""
    known = [each.setup.stage is Stage.RUNNING and each.feedback_age(now) <= config.drive_timeout for each in links]

    def four(values: Sequence[float]) -> Four:
        one, two, three, four = (value if there else math.nan for value, there in zip(values, known, strict=True))
        return one, two, three, four

    one, two, three, last = (each.heard.sampled_ns if there else None for each, there in zip(links, known, strict=True))
    return Feedback(
        four([each.position(now, config.drive_timeout) for each in links]),
        four([each.quantity(VELOCITY) for each in links]),
        four([each.quantity(TORQUE) for each in links]),
        (one, two, three, last),
    )


def drives(links: Sequence[Link], now: int, config: DriverConfig) -> tuple[DriveStatus, ...]:
    """All about each drive, for a person."""
    return tuple(link.status(now, watch.text_of(link, now, config)) for link in links)


def refusal(links: Sequence[Link]) -> str:
    """What keeps a drive from being set up for good; empty where nothing does."""
    return next((link.setup.refusal for link in links if link.setup.refusal), "")
