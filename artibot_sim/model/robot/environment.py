"""What a robot meets wherever it drives: gravity (eq. 12), on level or sloping ground."""

from __future__ import annotations

import math

STANDARD_GRAVITY = 9.81
"""|g| of eq. 12, m/s²."""


def gravity(grade: float, heading: float) -> tuple[float, float, float]:
    """Gravitational acceleration in `map` (m/s²): eq. 12's vector, tilted by `grade` towards `heading` (rad)."""
    if grade == 0.0:
        return 0.0, 0.0, -STANDARD_GRAVITY
    along = STANDARD_GRAVITY * math.sin(grade)
    return along * math.cos(heading), along * math.sin(heading), -STANDARD_GRAVITY * math.cos(grade)
