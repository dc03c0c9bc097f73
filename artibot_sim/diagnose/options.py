"""How a diagnosis is made."""

from __future__ import annotations

from dataclasses import dataclass

from artibot_sim.diagnose.thresholds import THRESHOLDS, Thresholds

HALF_WIDTH = 0.045
"""s around an instant whose encoder positions give a motor's rotation. Narrower, the encoders' steps make noise of
predicted torques, which back wheels with less friction seem to mend; wider, the peaks of slip are cut."""
HORIZON = 5.0
"""s over which predictions are judged."""
PRIOR_ODDS = 1.0
"""Of an effect being there, before anything was measured: whoever asks for a diagnosis has a reason."""
FALSE_ALARM_RATE = 0.01
"""Share of the cases with nothing hidden in which something is named."""


@dataclass(frozen=True)
class Options:
    """How a diagnosis is made; see `diagnose`."""

    horizon: float = HORIZON
    seed: int = 0
    workers: int | None = None
    prior_odds: float = PRIOR_ODDS
    false_alarm_rate: float = FALSE_ALARM_RATE
    thresholds: Thresholds = THRESHOLDS
    scheduler: str | None = None

    @property
    def least(self) -> float:
        """Nats that an effect has to gain to be named."""
        return self.thresholds.least(self.prior_odds, self.false_alarm_rate)
