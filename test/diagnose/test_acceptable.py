"""Which effects are named at all."""

from __future__ import annotations

import numpy as np
import pytest

from artibot_sim.diagnose.policy import THRESHOLDS
from artibot_sim.diagnose.selection.evidence import Evidence
from artibot_sim.diagnose.selection.forward import refusal

LEAST = 58.0


def told(size: float, nats: float = 500.0, sd: float = 1e-3, sampling_sd: float = 0.0) -> Evidence:
    lost = np.array([-sampling_sd / 2.0**0.5])
    return Evidence(nats, 0.0, np.array([size]), np.array([[sd**2]]), lost)


@pytest.mark.parametrize(
    ("found", "named"),
    [
        (told(0.5), True),
        (told(0.5, nats=LEAST - 1.0), False),
        (told(0.05), False),  # a tenth of a plain one is none
        (told(0.5, sd=0.2), False),  # not away from neutral
        (told(-0.5), True),
        (told(0.5, sampling_sd=200.0), True),
        (told(0.5, sampling_sd=240.0), False),  # other windows lose as much
    ],
)
def test_an_effect_needs_evidence_and_a_size_that_is_not_nothing(found: Evidence, named: bool) -> None:
    assert (not refusal("joint_friction", found, found.nats, LEAST, THRESHOLDS)) is named


@pytest.mark.parametrize("size", [0.0, -0.04, -1.0])
def test_of_a_stop_only_evidence_counts(size: float) -> None:
    """Its coordinate is how far it is from the largest angle that was reached, and neutral is infinitely far."""
    assert not refusal("joint_stop", told(size), 500.0, LEAST, THRESHOLDS)
    assert refusal("joint_stop", told(size), LEAST - 1.0, LEAST, THRESHOLDS)
