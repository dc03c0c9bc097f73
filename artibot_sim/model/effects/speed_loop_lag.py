"""A slow velocity loop in the front drives."""

from __future__ import annotations

import math

from artibot_sim.model.effects.base import Array, Effect, Search, Step, Values, number


def weights(time_constant: float, h: float) -> tuple[float, float, float]:
    """Of a command, of the one a sample `h` (s) before it, and of what the motor did then, in what it does now.

    Exact for commands that are linear between samples.
    """
    if time_constant <= 0.0:
        return 1.0, 0.0, 0.0
    kept = math.exp(-h / time_constant)
    behind = time_constant / h * (1.0 - kept)  # share of a sample's rise by which it trails
    return 1.0 - behind, behind - kept, kept


def _step(values: Values, h: float, first: Array) -> Step:
    """At the first sample it has settled."""
    fresh, last, kept = weights(values["time_constant"], h)
    before, now = first, first

    def step(speed: Array) -> Array:
        nonlocal before, now
        now = fresh * speed + last * before + kept * now
        before = speed
        return now

    return step


EFFECT = Effect(
    id="speed_loop_lag",
    acts="command",
    doc="Front motor velocities follow their commands through a first-order lag.",
    claim="the front drives follow their commands with a time constant of {time_constant}",
    parameters={"time_constant": number("s", 0.0, 100.0, "of the lag")},
    command=_step,
    search=Search({"time_constant": 0.25}, views=("command",)),
)
