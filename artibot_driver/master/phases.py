"""The master's own state machine: one table, and a pure function that looks things up in it.

Where nothing turns, the phase says what is there; from READY on it says what the four drives do together.
"""

from __future__ import annotations

import enum
from typing import Final, NamedTuple


class Phase(enum.Enum):
    """What the master is at."""

    OFFLINE = "the bus carries no frames"
    LISTENING = "listening for another driver"
    CONFIGURING = "drives are missing or being set up"
    LOCKED = "a drive is in fault: reset it first"
    READY = "disabled, may be enabled"
    ENABLING = "drives are being enabled"
    ENABLED = "enabled"
    STOPPING = "coming to standstill, then disabled"

    @property
    def moves(self) -> bool:
        """Whether drives may have current."""
        return self in (Phase.ENABLING, Phase.ENABLED, Phase.STOPPING)


class Facts(NamedTuple):
    """What decides, found anew in every cycle.

    Attributes
    ----------
    carries : the bus carries frames.
    alone : nobody else leads the drives, and this driver's first SYNC is out.
    complete : all drives are set up, and send feedback and heartbeats.
    faulted : a drive reports a fault.
    enable : enabling was asked for since the last cycle.
    incident : there is a reason to stop.
    all_enabled : all drives report operation enabled.
    stopped : the ramp is over, and the drives are without current or had the time for it.
    """

    carries: bool
    alone: bool
    complete: bool
    faulted: bool
    enable: bool
    incident: bool
    all_enabled: bool
    stopped: bool


class PhaseTransition(NamedTuple):
    """One arrow: what must be so (`needs`) and not so (`bars`), by the names of :class:`Facts`."""

    start: Phase
    end: Phase
    needs: tuple[str, ...] = ()
    bars: tuple[str, ...] = ()

    def fits(self, facts: Facts) -> bool:
        """Whether all that it needs is so, and nothing that bars it."""
        return all(getattr(facts, name) for name in self.needs) and not any(getattr(facts, name) for name in self.bars)


_P = Phase
_RESTING = (_P.OFFLINE, _P.LISTENING, _P.CONFIGURING, _P.LOCKED, _P.READY)

TABLE: Final = (
    PhaseTransition(_P.READY, _P.ENABLING, ("enable", "carries", "alone", "complete"), ("faulted",)),
    *(
        row
        for start, over in (*((start, ()) for start in _RESTING), (_P.STOPPING, ("stopped",)))
        for row in (
            PhaseTransition(start, _P.OFFLINE, over, ("carries",)),
            PhaseTransition(start, _P.LISTENING, (*over, "carries"), ("alone",)),
            PhaseTransition(start, _P.CONFIGURING, (*over, "carries"), ("complete",)),
            PhaseTransition(start, _P.LOCKED, (*over, "carries", "complete", "faulted")),
            PhaseTransition(start, _P.READY, (*over, "carries", "complete"), ("faulted",)),
        )
    ),
    PhaseTransition(_P.ENABLING, _P.STOPPING, ("incident",)),
    PhaseTransition(_P.ENABLING, _P.ENABLED, ("all_enabled",)),
    PhaseTransition(_P.ENABLED, _P.STOPPING, ("incident",)),
)
"""Every arrow; of those that fit, the first is taken. Where none fits, the phase stays."""


def next_phase(phase: Phase, facts: Facts) -> Phase:
    """The phase after `phase`, given what was found."""
    for row in TABLE:
        if row.start is phase and row.fits(facts):
            return row.end
    return phase
