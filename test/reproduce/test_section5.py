"""Section 5's statements follow from the maps: they hold for the model's and fail for others."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from artibot_sim.model import load_robot
from artibot_sim.model.analysis.influence import InfluenceMap, influence_map
from artibot_sim.reproduce.section5 import section5, statements, zero_curve


@pytest.fixture(scope="module")
def found() -> InfluenceMap:
    return influence_map(load_robot("agriq"), np.linspace(0, 1, 11), np.radians(np.linspace(-60, 60, 41)))


def test_the_four_statements_hold_for_the_model(found: InfluenceMap) -> None:
    said = statements(found, 0.5)
    assert len(said) == 4 and all(statement.holds for statement in said)


@pytest.mark.parametrize(
    ("change", "fails"),
    [
        ({"chi": lambda f: -f.chi}, {0, 1, 2}),
        ({"psi": lambda f: -f.psi}, {1, 3}),
        ({"chi": lambda f: f.chi[::-1]}, {0, 1}),
        ({"psi": lambda f: f.psi + 1e-3}, {3}),
    ],
    ids=["chi turned round", "psi turned round", "sides exchanged", "psi shifted"],
)
def test_they_fail_for_maps_that_contradict_them(found: InfluenceMap, change, fails) -> None:
    other = dataclasses.replace(found, **{name: make(found) for name, make in change.items()})
    assert fails <= {i for i, statement in enumerate(statements(other, 0.5)) if not statement.holds}


def test_the_zero_curve_is_where_the_map_vanishes() -> None:
    x, y = np.linspace(0, 1, 7), np.linspace(-1, 1, 21)
    z = y[None, :] - (0.6 * x[:, None] - 0.25)
    np.testing.assert_allclose(zero_curve(x, y, z)[1], 0.6 * x - 0.25, atol=1e-12)
    assert np.isnan(zero_curve(x, y, np.abs(z) + 1)[1]).all()
    assert np.isnan(zero_curve(x, y, z * (x > 0.5)[:, None])[1][:4]).all()


def test_the_figure_has_six_maps_with_their_zero_curves() -> None:
    section = section5(quick=True)
    maps = [chart for row in section.sheets[0].rows for chart in row]
    assert len(maps) == 6
    for right, left, both in (maps[:3], maps[3:]):
        np.testing.assert_allclose(right.z + left.z, both.z, atol=1e-15)
        assert np.nanmax(np.abs(both.zero[0][1])) == pytest.approx(0.0, abs=1e-9)
        assert np.abs(both.z).max() <= both.scale * (1 + 1e-12)
