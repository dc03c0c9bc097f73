"""Commands that come late: a bus, a radio link."""

from __future__ import annotations

from collections import deque

from artibot_sim.model.effects.base import Array, Effect, Search, Step, Values, number


def _step(values: Values, h: float, first: Array) -> Step:
    """Between samples commands are linear; before the first one they were as it is."""
    whole, part = divmod(values["delay"] / h, 1.0)
    past = deque([first] * (int(whole) + 2), maxlen=int(whole) + 2)  # the oldest first, the newest last

    def step(speed: Array) -> Array:
        past.append(speed)
        return (1.0 - part) * past[1] + part * past[0]

    return step


EFFECT = Effect(
    id="command_delay",
    acts="command",
    doc="Front commands act this much later.",
    claim="front commands act {delay} late",
    parameters={"delay": number("s", 0.0, 10.0, "time between command and motion")},
    command=_step,
    search=Search({"delay": 0.15}, views=("command",)),
)
