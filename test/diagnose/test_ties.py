"""Which effects tie: where motion was fitted the model may lack what favours either, commands know chance alone."""

from __future__ import annotations

import numpy as np
import pytest

from artibot_sim.diagnose.policy import THRESHOLDS
from artibot_sim.diagnose.selection.evidence import CommandEvidence, Evidence
from artibot_sim.diagnose.selection.naming import best_of

LEAST = 58.0


def named(fitted: dict[str, float], from_commands: dict[str, float]) -> tuple[str, tuple[str, ...]]:
    """What is best and what ties with it, all of a plain size."""
    evidence = {effect: Evidence(nats, 0.0, np.ones(1), 1e-4 * np.eye(1)) for effect, nats in fitted.items()}
    others = {effect: CommandEvidence(nats, {}) for effect, nats in from_commands.items()}
    best = best_of(evidence, fitted, others, LEAST, THRESHOLDS)
    assert best is not None
    return best.effect, best.ties


@pytest.mark.parametrize(
    ("fitted", "from_commands", "ties"),
    [
        ({"slope": 10_000.0, "external_force": 9_800.0, "payload": 9_500.0}, {}, ("external_force",)),
        ({"slope": 100.0, "external_force": 93.0, "payload": 91.0}, {}, ("external_force",)),
        ({}, {"command_delay": 38_176.0, "speed_loop_lag": 37_254.0}, ()),
        ({}, {"command_delay": 38_176.0, "speed_loop_lag": 38_170.0}, ("speed_loop_lag",)),
        ({"slope": 10_000.0}, {"command_delay": 9_900.0}, ("command_delay",)),
    ],
)
def test_what_is_close_ties(fitted: dict[str, float], from_commands: dict[str, float], ties: tuple[str, ...]) -> None:
    assert named(fitted, from_commands) == (
        max({**fitted, **from_commands}, key=lambda one: {**fitted, **from_commands}[one]),
        ties,
    )


def with_windows(gained: np.ndarray) -> Evidence:
    """An effect of a plain size that gains so much in each window."""
    return Evidence(float(gained.sum()), 0.0, np.ones(1), 1e-4 * np.eye(1), gained)


def test_a_lead_that_other_windows_may_take_away_is_none() -> None:
    """Of two effects that gain much alike one may lead by the windows that happened to be recorded."""
    rng = np.random.default_rng(3)
    alike, by_chance = np.full(400, 2.0), rng.normal(0.0, 3.0, 400)
    by_chance -= by_chance.mean()
    for lead, ties in ((70.0, ("payload",)), (200.0, ())):  # 60 is its standard deviation
        evidence = {"slope": with_windows(alike + by_chance + lead / 400), "payload": with_windows(alike)}
        best = best_of(evidence, {name: one.nats for name, one in evidence.items()}, {}, LEAST, THRESHOLDS)
        assert best is not None and best.effect == "slope" and best.ties == ties


def test_a_lead_in_every_window_is_no_chance() -> None:
    evidence = {"slope": with_windows(np.full(400, 2.1)), "payload": with_windows(np.full(400, 2.0))}
    best = best_of(evidence, {name: one.nats for name, one in evidence.items()}, {}, LEAST, THRESHOLDS)
    assert best is not None and not best.ties


def test_too_little_is_nothing() -> None:
    assert best_of({}, {}, {"command_delay": CommandEvidence(LEAST - 1.0, {})}, LEAST, THRESHOLDS) is None


def test_commands_alone_do_not_name_what_the_motion_was_asked_for() -> None:
    """A recorded command may be none of these motors'; the motion, which shows an encoder's scale, has to agree."""
    others = {"encoder_scale": CommandEvidence(900.0, {}), "command_delay": CommandEvidence(80.0, {})}
    best = best_of({}, {}, others, LEAST, THRESHOLDS, (), {"encoder_scale"})
    assert best is not None and best.effect == "command_delay" and not best.ties
    untried = best_of({}, {}, others, LEAST, THRESHOLDS)
    assert untried is not None and untried.effect == "encoder_scale", "where the motion cannot show it"
