"""Faults made of others: two at once, and those that pass by before anybody may have noticed."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from artibot_driver.faults.catalogue import BY_NAME, Fault
from artibot_driver.faults.world import World

TWO: Final = "two faults at once"
BRIEFLY: Final = "a fault that passes by"

HELD: Final = 0.3
"""A second fault may hold up the ramp that the first began: until the drives go on with it by themselves, s."""

CAN_PASS: Final = tuple(
    BY_NAME[name]
    for name in (
        "drive unplugged",
        "drive without supply",
        "driver hangs",
        "cable off",
        "bus flooded",
        "all of these together",
    )
)
"""Those that can be over soon."""


def two(one: Fault, other: Fault, delay: float) -> Fault:
    """Both, `delay` seconds apart; the one that has to stop the rover comes first."""
    first, second = (one, other) if one.stops or not other.stops else (other, one)

    def inject(world: World, motor: str) -> None:
        first.inject(world, motor)
        world.run(delay)
        second.inject(world, motor)

    def mend(world: World, motor: str) -> None:
        for each in (second, first):
            each.mend(world, motor)

    known = bool(first.reasons and second.reasons)
    return Fault(
        f"{first.name}, then {second.name}",
        inject,
        mend,
        first.stops,
        max(first.within, second.within),
        (*first.reasons, *second.reasons) if known else (),
        own=max(first.own, second.own),
        held=HELD + delay,
        group=TWO,
    )


def briefly(fault: Fault, time: float) -> Fault:
    """A fault that is over after `time` seconds: the rover stops as it must for the fault, or goes on."""

    def inject(world: World, motor: str) -> None:
        fault.inject(world, motor)
        world.run(time)
        fault.mend(world, motor)

    return replace(
        fault,
        name=f"{fault.name} for {time:.3f} s",
        inject=inject,
        mend=lambda world, motor: None,
        stops=False,
        reasons=(),
        held=HELD,
        silent=False,
        group=BRIEFLY,
    )
