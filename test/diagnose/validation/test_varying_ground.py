"""Ground that varies by itself is not taken for an effect that describes its mean; one that is there is seen."""

from __future__ import annotations

import numpy as np
import pytest
from diagnose.hidden.logged import VARYING
from diagnose.hidden.varying import RESISTANCE, held


@pytest.mark.parametrize(
    ("effects", "seed", "seen"),
    [
        pytest.param((VARYING,), 2579376181, False, marks=pytest.mark.long),
        ((RESISTANCE, VARYING), 408484264, True),
    ],
)
def test_only_what_is_there_holds_beside_ground_that_varies(effects: tuple[str, ...], seed: int, seen: bool) -> None:
    low, high = held(effects, seed)
    assert (low > 0.0) is seen and low < high


def test_few_windows_make_nothing_sure() -> None:
    assert held((), 1, duration=15.0) == (-np.inf, np.inf)
