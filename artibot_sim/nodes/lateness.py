"""How long messages were held up on their way."""

from __future__ import annotations

MEMORY = 5.0
"""s for which the fastest message counts at least; up to twice as long."""


class Lateness:
    """Holds each message of a topic against the fastest one of late, so that the clocks of two machines need not agree.

    A clock that is set by a jump makes messages seem held up until the fastest ones from before are forgotten.
    """

    def __init__(self) -> None:
        self._since = float("-inf")
        self._earlier: int | None = None
        self._fastest: int | None = None

    def of(self, sent_ns: int, heard_ns: int, now: float) -> float:
        """Seconds by which a message was longer on its way than the fastest one; 0 of the first.

        Parameters
        ----------
        sent_ns, heard_ns : int
            By the system clocks of who sent it and who hears it.
        now : float
            Steady time, s.
        """
        if now - self._since > MEMORY:
            self._earlier = self._fastest if now - self._since <= 2.0 * MEMORY else None
            self._fastest, self._since = None, now
        way = heard_ns - sent_ns
        self._fastest = way if self._fastest is None else min(way, self._fastest)
        return 1e-9 * (way - min(self._fastest, way if self._earlier is None else self._earlier))
