"""Searches that a test asks for several times, made once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest

from artibot_sim.diagnose.selection import stepwise
from artibot_sim.estimation.loss import Loss
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.search import Fit


def remember_stages(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have `stepwise` make a stage's search once for the same problem, fit and named effects."""
    searched: dict[tuple[object, ...], tuple[stepwise.Stage, Problem, Fit]] = {}
    stage = stepwise.stage

    def remembered(problem: Problem, fit: Fit, loss: Loss, named: Sequence[str], *rest: Any) -> stepwise.Stage:
        key = id(problem), id(fit), tuple(named)
        if key not in searched:  # problem and fit are kept, so that their numbers are not given to others
            searched[key] = stage(problem, fit, loss, named, *rest), problem, fit
        return searched[key][0]

    monkeypatch.setattr(stepwise, "stage", remembered)
