"""Discs of other ground along the paths: what recordings say of them before any is fitted."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from diagnose.hidden.cases import case
from diagnose.searches import baseline

from artibot_sim.diagnose.candidates.patches import deviations_along, scanned
from artibot_sim.diagnose.candidates.screening import Around, around
from artibot_sim.diagnose.policy import THRESHOLDS
from artibot_sim.diagnose.records import Options
from artibot_sim.diagnose.selection.ranking import excluded_patch
from artibot_sim.estimation.parameters import Extension
from artibot_sim.model import load_robot

PATCH, LEAST = "friction_patch", 58.0


@cache
def recorded(severity: float) -> tuple[Around, dict]:
    """Around the best soil of recordings with a patch, or with none; and the patch."""
    hidden = case((PATCH,) if severity else (), severity, 305, runs=2, held_out=0, duration=20.0)
    problem, fit = baseline(hidden.recordings, load_robot("agriq"), Options(workers=2))
    return around(problem, fit.loss, fit.point), hidden.truth.effects.get(PATCH, {})


def test_a_faint_patch_is_seen_where_it_is_and_as_large() -> None:
    base, patch = recorded(0.2)
    best = max(scanned(base, PATCH), key=lambda one: one.disc.gain)
    assert best.disc.gain > LEAST
    assert np.hypot(best.disc.x - patch["x"], best.disc.y - patch["y"]) < patch["radius"] + 1.0
    scale = Extension(PATCH, {"x": 0.0, "y": 0.0, "radius": 1.0}).values(best.disc.probe)["scale"]
    assert float(scale) == pytest.approx(patch["scale"], abs=0.5 * (1.0 - patch["scale"]))


@pytest.mark.long
def test_where_there_is_none_no_disc_promises_anything() -> None:
    base, _ = recorded(0.0)
    assert max(one.disc.gain for one in scanned(base, PATCH)) < 15.0


@pytest.mark.long
def test_a_patch_is_excluded_from_a_size_on_that_most_of_the_ground_tells() -> None:
    base, _ = recorded(0.0)
    (bound,) = excluded_patch(base, PATCH, LEAST, THRESHOLDS).values()
    (stricter,) = excluded_patch(base, PATCH, 4.0 * LEAST, THRESHOLDS).values()
    told = deviations_along(base, PATCH)
    size = Extension(PATCH).search.sizes["scale"]
    told_by = np.log1p(bound) / size / told
    assert 0.05 < bound <= stricter < 1.0
    assert np.mean(told_by**2 / 2.0 > LEAST) >= 0.9
