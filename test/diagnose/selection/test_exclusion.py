"""Excluded sizes: what would have been named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from artibot_sim.diagnose.candidates.hypotheses import Hypothesis
from artibot_sim.diagnose.candidates.screening import Trial
from artibot_sim.diagnose.policy import THRESHOLDS
from artibot_sim.diagnose.selection.ranking import excluded, excluded_below
from artibot_sim.estimation.parameters import Extension

LEAST = 58.0


def trial(effect: str, sd: float, blur: float, probes: tuple[float, ...] = (0.5, 1.5)) -> Trial:
    return tried(Extension(effect), sd, {probe: (probe / blur) ** 2 for probe in probes})


def tried(extension: Extension, sd: float, costs: dict[float, float]) -> Trial:
    """A trial by what each probe costs."""
    tested = tuple((np.array([probe]), cost) for probe, cost in costs.items())
    hypothesis = Hypothesis(extension, tuple(probe for probe, _ in tested))
    return Trial(hypothesis, None, None, np.full(1, sd), tested)  # type: ignore[arg-type]


def coordinate(trials: list[Trial]) -> float:
    """Of the bound, for an effect of one parameter."""
    ((name, bound),) = excluded(trials, LEAST, THRESHOLDS).items()
    return bound / trials[0].hypothesis.extension.search.sizes[name]


@pytest.mark.parametrize("sd", [0.001, 0.02, 0.05])
def test_what_is_excluded_would_have_been_named(sd: float) -> None:
    x = coordinate([trial("joint_friction", sd, sd)])
    unlucky = x - 2.0 * sd
    assert unlucky**2 / (2.0 * sd**2) - np.log(1.5 / sd) >= LEAST - 1e-6
    assert unlucky / sd > THRESHOLDS.distance
    assert unlucky >= THRESHOLDS.size


def test_the_soil_s_freedom_counts() -> None:
    """Sensitivities hold mu_s; finite probes, after which everything had its say, cost less."""
    assert coordinate([trial("joint_friction", 0.002, 0.05)]) > 1.5 * coordinate([trial("joint_friction", 0.002, 0.02)])


def test_an_effect_that_asks_for_more_evidence_is_excluded_from_a_larger_size_on() -> None:
    name = "com_offset"
    assert THRESHOLDS.more(name) > 0.0
    lenient = replace(THRESHOLDS, biased={})
    strict, plain = (excluded([trial(name, 0.02, 0.02)], LEAST, t)["x"] for t in (THRESHOLDS, lenient))
    assert strict > plain


def test_the_weakest_of_several_choices_counts() -> None:
    assert coordinate([trial("joint_friction", 0.02, 0.02), trial("joint_friction", 0.05, 0.05)]) == coordinate(
        [trial("joint_friction", 0.05, 0.05)]
    )


def test_what_costs_nothing_is_not_excluded() -> None:
    assert excluded([trial("joint_friction", 0.01, np.inf)], LEAST, THRESHOLDS) == {}


def test_what_is_not_smooth_is_excluded_from_its_smallest_probe_on() -> None:
    assert coordinate([trial("tyre_relaxation", 0.0004, 0.01, (0.3, 0.7))]) == pytest.approx(0.3)


def stop(costs: dict[float, float], bend: float = 0.4) -> Trial:
    return tried(Extension("joint_stop", {}, bend), np.inf, costs)


TOLD, FAINT = 2.0 * (np.sqrt(LEAST) + 2.0) ** 2, 2.0 * LEAST
"""What a probe costs that bad luck does not hide, and one that it may hide."""


@pytest.mark.parametrize(
    ("costs", "share"),
    [
        ({0.0: TOLD, -0.15: TOLD, -0.5: 9 * TOLD}, 1.0),
        ({0.0: FAINT, -0.15: TOLD, -0.5: 9 * TOLD}, np.exp(-0.015)),
        ({-0.5: 9 * TOLD, 0.0: -3.0, -0.15: FAINT}, np.exp(-0.05)),
        ({0.0: TOLD, -0.15: FAINT, -0.5: TOLD}, np.exp(-0.05)),  # gentler by chance
        ({0.0: TOLD, -0.15: TOLD, -0.5: FAINT}, None),
    ],
)
def test_a_stop_is_excluded_below_the_gentlest_that_would_have_been_named(costs: dict, share: float | None) -> None:
    found = excluded_below(stop(costs), LEAST, THRESHOLDS)
    assert found == ({} if share is None else {"angle": pytest.approx(0.4 * share)})
    assert excluded([stop(costs)], LEAST, THRESHOLDS) == {}


def test_only_limits_are_excluded_below() -> None:
    assert excluded_below(trial("joint_friction", 0.01, 0.01), LEAST, THRESHOLDS) == {}
