"""Recordings with hidden effects, made by a rover that is not the model, and the scoring of diagnoses of them."""

from __future__ import annotations

from diagnose.hidden.cases import Case, Truth, case, write
from diagnose.hidden.effects import LISTED
from diagnose.hidden.ground import OTHER_GROUND
from diagnose.hidden.sensors import Noise
from diagnose.hidden.unlisted import UNLISTED

__all__ = ["LISTED", "OTHER_GROUND", "UNLISTED", "Case", "Noise", "Truth", "case", "write"]
