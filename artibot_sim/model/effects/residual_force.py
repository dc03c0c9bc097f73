"""A brief force: what a diagnosis probes with, to see what forces on no list would do. It is never named as a cause."""

from __future__ import annotations

import math

from artibot_sim.model.compiled import inlined
from artibot_sim.model.effects.base import Effect, choice, number

FORCES = (
    "front surge force", "front sway force", "front yaw moment",
    "back surge force", "back sway force", "back yaw moment",
)  # fmt: skip
"""Forces at a module's origin along and across its own frame, and moments about it."""


@inlined
def load(fx, module):
    """Force along and across a module's own frame (N) and yaw moment (N m)."""
    probe = fx.residual_force
    away = fx.t - probe.centre
    away = abs(away - probe.every * math.floor(away / probe.every + 0.5))
    size = probe.size * max(1.0 - away / probe.width, 0.0)
    which = probe.force - 3.0 * module
    return (
        size if which == 0.0 else 0.0,
        size if which == 1.0 else 0.0,
        size if which == 2.0 else 0.0,
    )  # fmt: skip


EFFECT = Effect(
    id="residual_force",
    acts="environment",
    doc="A force on a module that rises and falls linearly with time, once or again and again.",
    parameters={
        "size": number("", -math.inf, math.inf, "at its highest, N or N m"),
        "force": choice(FORCES, "which force"),
        "centre": number("s", -math.inf, math.inf, "when it is highest, since the recording's start"),
        "width": number("s", 0.0, math.inf, "from there to nothing", 0.1, low_open=True),
        "every": number("s", 0.0, math.inf, "from one to the next", 1e6, low_open=True),
    },
    hooks={"load": load},
)
