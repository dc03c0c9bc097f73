"""Forces for a while: what a diagnosis probes with, to see what forces on no list would do. It is never named."""

from __future__ import annotations

import math

from artibot_sim.model.effects.base import Effect, number
from artibot_sim.model.effects.parts import names_of
from artibot_sim.model.kernels.compilation import inlined

FORCES = ("front_surge", "front_sway", "front_turn", "back_turn")
"""Forces at the front module's origin along and across its own frame, N, and moments about both modules', N m."""


def forces_of(modules: int) -> tuple[str, ...]:
    """FORCES, and the moments about each module behind these two: all that can move so many modules on a plane."""
    return names_of(FORCES, modules)


@inlined
def load(fx, module):
    """Force along and across a module's own frame (N) and yaw moment (N m)."""
    probe = fx.residual_force
    since = fx.t - probe.since
    share = max(1.0 - abs(since) * probe.fall, 0.0)
    if module == 0:
        return (
            share * (probe.front_surge + since * probe.front_surge_rate),
            share * (probe.front_sway + since * probe.front_sway_rate),
            share * (probe.front_turn + since * probe.front_turn_rate),
        )
    return 0.0, 0.0, share * (probe.back_turn + since * probe.back_turn_rate)


def _unit(name: str) -> str:
    return "N m" if name.endswith("turn") else "N"


EFFECT = Effect(
    id="residual_force",
    acts="environment",
    doc="Forces on the modules that grow linearly with time, or a pulse of them.",
    parameters={name: number(_unit(name), -math.inf, math.inf, "at the time `since`") for name in FORCES}
    | {f"{name}_rate": number(f"{_unit(name)}/s", -math.inf, math.inf, "its growth") for name in FORCES}
    | {
        "since": number("s", -math.inf, math.inf, "since the recording's start"),
        "fall": number("1/s", 0.0, math.inf, "share of a pulse that is gone for each second before and after `since`"),
    },
    sizes=2 * len(FORCES),
    hooks={"load": load},
)
