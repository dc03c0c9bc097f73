"""Drives that go after a new command on a ramp: a limit of acceleration set in them."""

from __future__ import annotations

import math

import numpy as np

from artibot_sim.model.effects.base import Array, Effect, Search, Step, Values, number
from artibot_sim.model.kernels.compilation import kernel


@kernel
def on_ramp(speed, most, now, out):
    """Speeds that go after `speed` (n, k) by at most `most` a sample, into `out`; `now` (k,) is the last one's."""
    for k in range(speed.shape[1]):
        last = now[k]
        for i in range(speed.shape[0]):
            wanted = speed[i, k]
            if wanted > last + most:  # a branch: what is reached already waits for no sample before it
                last += most
            elif wanted < last - most:
                last -= most
            else:
                last = wanted
            out[i, k] = last
        now[k] = last


def _step(values: Values, h: float, first: Array) -> Step:
    now, out = np.array(first, dtype=float), np.empty((1, len(first)))

    def step(speed: Array) -> Array:
        on_ramp(np.array(speed, dtype=float)[np.newaxis], values["rate"] * h, now, out)
        return out[0].copy()

    return step


EFFECT = Effect(
    id="command_rate_limit",
    acts="command",
    doc="Front velocity commands change by at most so many rad/s², whatever is commanded.",
    claim="a ramp of {rate} is set in the front drives",
    parameters={"rate": number("rad/s²", 0.0, math.inf, "largest acceleration of a motor", math.inf, low_open=True)},
    command=_step,
    search=Search({"rate": 0.3}, logarithmic=True, reference="acceleration", views=("command",)),
)
