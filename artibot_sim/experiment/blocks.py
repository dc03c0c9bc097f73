"""A recording in two parts, one to fit and one to hold out: blocks of its time in turn."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment.columns import Experiment

BLOCK = 12.0
"""s of a block: long beside what follows from one command, short beside a change of the ground or of the load."""
_APART = 1e-4
"""s."""
HELD_OUT = " (rest)"
"""What is added to the name of the part that is held out."""


def without_share(recordings: Iterable[Experiment], share: float) -> tuple[list[Experiment], list[Experiment]]:
    """Recordings without a share of their blocks, and these blocks as recordings of their own.

    Raises
    ------
    ArtibotError
        For a share that is none, or a recording too short for it.
    """
    if not 0.0 < share < 1.0:
        raise ArtibotError(f"share to hold out: {share:g}; expected more than 0 and less than 1, such as 0.5")
    parts = [in_turn(experiment, share) for experiment in recordings]
    return [fitted for fitted, _ in parts], [held for _, held in parts]


def in_turn(experiment: Experiment, share: float = 0.5) -> tuple[Experiment, Experiment]:
    """A recording without a share of its blocks, and these; both have parts of its beginning, its middle and its end.

    Segments shorter than a block stay whole, several of them to a block.

    Raises
    ------
    ArtibotError
        Where no block is left for one of the parts.
    """
    spans: tuple[list[tuple[float, float]], ...] = ([], [])
    step = float(np.median(np.diff(experiment.require("motor_torques").t)))
    driven = 0.0
    for first, last in experiment.segments:
        count = max(1, round((last - first) / BLOCK))
        edges = np.linspace(first, last, count + 1).tolist()
        for a, b in zip(edges, edges[1:], strict=False):
            number = int((driven + 1e-9) // BLOCK)
            held = int((number + 1) * share + 1e-9) > int(number * share + 1e-9)
            # parts are apart by less than a sample, or one on an edge would be in both
            begin, end = a if a == first else a + _APART, b if b == last else b - _APART
            if a > first and spans[held] and spans[held][-1][1] > a - 2 * _APART:
                begin = spans[held].pop()[0]  # goes on
            spans[held].append((begin, end))
            driven += b - a + step
    if not all(spans):
        raise ArtibotError(
            f"{experiment.path}: too short to hold out {100 * share:.0f} % in blocks of {BLOCK:g} s; record longer, or "
            "hold out another recording with --holdout"
        )
    rest = part_of(experiment, spans[1], experiment.name + HELD_OUT)
    fitted = part_of(experiment, spans[0], experiment.name)
    return fitted, replace(rest, fitted_part=fitted)


def part_of(experiment: Experiment, spans: Sequence[tuple[float, float]], name: str) -> Experiment:
    """The rows of all channels within some spans (s), under a name of their own."""
    channels = {}
    for key, channel in experiment.channels.items():
        inside = np.zeros(len(channel), bool)
        for a, b in spans:
            inside |= (channel.t >= a - 1e-6) & (channel.t <= b + 1e-6)
        if inside.any():
            columns = {column: values[inside] for column, values in channel.columns.items()}
            channels[key] = replace(
                channel, t_ns=channel.t_ns[inside], t=channel.t[inside], received_ns=channel.received_ns[inside],
                columns=columns,
            )  # fmt: skip
    return replace(experiment, name=name, channels=channels, segments=tuple(spans))
