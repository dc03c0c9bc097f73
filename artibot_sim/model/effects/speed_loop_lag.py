"""A slow velocity loop in the front drives."""

from __future__ import annotations

import math

from artibot_sim.model.effects.base import Array, Effect, Search, Step, Values, number


def _way(values: Values, h: float, first: Array) -> Step:
    """Exact for commands that are linear between samples; at the first one it has settled."""
    T = values["time_constant"]
    kept = math.exp(-h / T) if T > 0.0 else 0.0
    before, now = first, first

    def step(speed: Array) -> Array:
        nonlocal before, now
        behind = (speed - before) / h * T  # by which it trails a ramp, once settled
        now = speed - behind + (now - before + behind) * kept
        before = speed
        return now

    return step


EFFECT = Effect(
    id="speed_loop_lag",
    acts="command",
    doc="Front motor velocities follow their commands through a first-order lag.",
    parameters={"time_constant": number("s", 0.0, 100.0, "of the lag")},
    command=_way,
    search=Search({"time_constant": 0.25}, views=("command",)),
)
