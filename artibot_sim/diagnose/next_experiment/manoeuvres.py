"""Manoeuvres that a next experiment is chosen from: each brings out something else."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

from artibot_sim.planning import Arc, Dwell, Eight, Manoeuvre, Ramp, Repeat, Segment, Slalom, Stop, Straight

KAPPA = 0.65
"""Front share of all of them: back motors whose torque is commanded show what torque sensors make of it."""
_BLEND = 0.3
"""m over which curvature changes."""


@dataclass(frozen=True)
class Entry:
    """A manoeuvre of the library.

    Attributes
    ----------
    name : str
    what : str
        What to do, for a person, to follow "drive".
    manoeuvre : Manoeuvre
    yaw : float
        Heading at the start in `map`, rad.
    """

    name: str
    what: str
    manoeuvre: Manoeuvre
    yaw: float = 0.0


def _entry(name: str, what: str, *segments: Segment, a_max: float = 0.5, yaw: float = 0.0) -> Entry:
    return Entry(name, what, Manoeuvre(name, (Dwell(0.5), *segments), a_max=a_max, blend=_BLEND), yaw)


_FORTH_AND_BACK = (
    Straight(length=2.5, speed=0.6, end_speed=0.0), Dwell(0.5), Straight(length=2.5, speed=-0.6, end_speed=0.0),
)  # fmt: skip
_BENDS = (Ramp(speed=0.5), Arc(radius=1.8, angle=1.6), Arc(radius=1.8, angle=-1.6), Stop())

LIBRARY: tuple[Entry, ...] = (
    _entry("forth_and_back", "2.5 m straight ahead and 2.5 m back", *_FORTH_AND_BACK),
    _entry(
        "forth_and_back_turned", "2.5 m straight ahead and 2.5 m back, headed 90° to the left of the last recordings",
        *_FORTH_AND_BACK, yaw=pi / 2,
    ),
    _entry(
        "jerks", "four short straights with hard starts and stops",
        Repeat(4, (Straight(length=0.8, speed=0.8, end_speed=0.0), Dwell(0.5))), a_max=2.0,
    ),
    _entry(
        "creep", "slowly, up to 0.25 m/s and down again, in a bend to the left, in one to the right, and straight",
        Ramp(speed=0.25, curvature=0.4, a_max=0.08), Stop(curvature=0.4, a_max=0.08), Dwell(0.5),
        Ramp(speed=0.25, curvature=-0.4, a_max=0.08), Stop(curvature=-0.4, a_max=0.08), Dwell(0.5),
        Ramp(speed=0.25, a_max=0.08), Stop(a_max=0.08),
    ),
    _entry("bends", "a bend to the left and one to the right, both of 1.8 m radius", *_BENDS),
    _entry(
        "bends_turned", "a bend to the left and one to the right, headed 90° to the left of the last recordings",
        *_BENDS, yaw=pi / 2,
    ),
    _entry(
        "stop_and_go", "stop and go: straight, in a left turn and in a right turn",
        Straight(length=1.5, speed=0.8, end_speed=0.0), Dwell(0.5),
        Arc(radius=2.5, angle=0.8, speed=0.8, end_speed=0.0), Dwell(0.5),
        Arc(radius=2.5, angle=-0.8, speed=0.8, end_speed=0.0), a_max=0.8,
    ),
    _entry(
        "slow_and_fast", "4 m at 0.25 m/s and 6 m at 0.9 m/s, in a wide bend",
        Ramp(speed=0.25, curvature=0.15), Arc(radius=1 / 0.15, angle=0.6), Ramp(speed=0.9, curvature=0.15),
        Arc(radius=1 / 0.15, angle=0.9), Stop(curvature=0.15),
    ),
    _entry(
        "slalom", "a slalom of three waves",
        Ramp(speed=0.6), Slalom(curvature=0.25, wavelength=5.0, periods=0.5),
        Slalom(curvature=-0.5, wavelength=5.0, periods=3.0), Stop(),
    ),
    _entry(
        "square", "a square with sides of 2 m, corners rounded, to the left",
        Ramp(speed=0.5), Repeat(4, (Straight(length=1.2), Arc(radius=1.3, angle=pi / 2))), Stop(),
    ),
    _entry("eight", "a figure of eight of 2 m radius", Eight(radius=2.0, smooth=True, speed=0.6, end_speed=0.0)),
    _entry(
        "circles", "a whole circle to the left and one to the right, both of 1.8 m radius",
        Ramp(speed=0.6), Arc(radius=1.8, angle=2 * pi), Arc(radius=1.8, angle=-2 * pi), Stop(),
    ),
    _entry(
        "eights", "two figures of eight of 2 m radius without a pause",
        Repeat(2, (Eight(radius=2.0, smooth=True, speed=0.6),)), Stop(),
    ),
)  # fmt: skip
"""All of them."""
