"""What a candidate gains and proves, against all normal equations written out."""

from __future__ import annotations

import numpy as np
import pytest

from artibot_sim.diagnose.policy import FORCE_WINDOW
from artibot_sim.diagnose.unlisted.forms import TIME, forms
from artibot_sim.diagnose.unlisted.search import Equations, NormalEquations, judge, proven
from artibot_sim.diagnose.words import NOTHING

WINDOWS, FORCES, PARAMETERS, COLUMNS = 40, 6, 3, 2


def equations(rng: np.random.Generator) -> tuple[Equations, NormalEquations, np.ndarray, np.ndarray]:
    """Random equations and columns; and what all columns together have, (windows, m, m) and (windows, m)."""
    size = FORCES + PARAMETERS
    root = rng.normal(size=(WINDOWS, size, size))
    matrix, rhs = root @ root.transpose(0, 2, 1), rng.normal(0.0, 3.0, (WINDOWS, size))
    beside = rng.normal(size=(WINDOWS, size, PARAMETERS + 2))
    information, slope = 5.0 * np.eye(PARAMETERS), rng.normal(size=PARAMETERS)
    recording = np.repeat([0, 1], WINDOWS // 2)
    found = Equations(matrix, rhs, np.zeros(WINDOWS), recording, information, slope, beside)
    own = rng.normal(size=(WINDOWS, size, COLUMNS))
    own[8:, :, 1] = 0.0  # a column of the first stretch alone
    every = np.concatenate([own, beside], axis=2)
    turned = own.transpose(0, 2, 1)
    sums = NormalEquations(turned @ matrix @ own, np.einsum("wji,wj->wi", own, rhs), turned @ matrix @ beside)
    return found, sums, every.transpose(0, 2, 1) @ matrix @ every, np.einsum("wji,wj->wi", every, rhs)


def fitted(found: Equations, matrix: np.ndarray, rhs: np.ndarray) -> np.ndarray:
    """Of columns summed over windows, with the prior of the parameters; zero for one that is nowhere."""
    own = matrix.shape[0] - found.beside.shape[2]
    prior, towards = found.prior()
    matrix, rhs = matrix.copy(), rhs.copy()
    matrix[own:, own:] += prior
    rhs[own:] += towards
    return np.linalg.lstsq(matrix, rhs, rcond=1e-13)[0]


@pytest.mark.parametrize("across", [False, True])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_gains_are_those_of_all_equations_together(seed: int, across: bool) -> None:
    found, sums, matrix, rhs = equations(np.random.default_rng(seed))
    form = next(iter(forms(NOTHING, np.zeros(1), 1)))
    x = fitted(found, matrix.sum(axis=0), rhs.sum(axis=0))
    alone = fitted(found, matrix[:, COLUMNS:, COLUMNS:].sum(axis=0), rhs[:, COLUMNS:].sum(axis=0))
    _, towards = found.prior()
    whole, beside = rhs.sum(axis=0), rhs[:, COLUMNS:].sum(axis=0) + towards
    whole[COLUMNS:] += towards
    one = judge(found, sums, form, "force", ("force",))
    assert one.gain == pytest.approx(0.5 * (whole @ x - beside @ alone), rel=1e-6)
    assert one.coefficients == pytest.approx(x[:COLUMNS], rel=1e-6)

    fold = found.recording if across else found.stretches
    total = 0.0
    for k in np.unique(fold):
        out, kept = fold == k, fold != k
        x = fitted(found, matrix[kept].sum(axis=0), rhs[kept].sum(axis=0))
        alone = fitted(found, matrix[kept][:, COLUMNS:, COLUMNS:].sum(axis=0), rhs[kept][:, COLUMNS:].sum(axis=0))
        for M, m in zip(matrix[out], rhs[out], strict=True):
            more = m @ x - 0.5 * x @ M @ x
            less = m[COLUMNS:] @ alone - 0.5 * alone @ M[COLUMNS:, COLUMNS:] @ alone
            total += np.clip(more - less, -FORCE_WINDOW, FORCE_WINDOW)
    assert proven(found, sums, across) == pytest.approx(total, abs=1e-6)


def test_what_wanders_has_corners_only_where_something_is_measured() -> None:
    """Windows an hour apart: no coefficient is paid for in between, and every instant has its value."""
    t = np.concatenate([np.linspace(0.0, 20.0, 60), np.linspace(3600.0, 3610.0, 30)])
    form = next(forms(TIME, t, 1))
    table = form.curve(t, np.zeros(len(t), np.int64))
    assert table.shape[1] < 20
    assert table.sum(axis=1) == pytest.approx(1.0)
    assert (table > 0.0).any(axis=0).all()
