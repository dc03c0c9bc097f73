"""Both views together: commands can speak for what rotations ask for, and against it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from artibot_sim.diagnose.candidates.hypotheses import Hypothesis, with_effect
from artibot_sim.diagnose.candidates.screening import Trial
from artibot_sim.diagnose.commands.view import CommandView, command_view
from artibot_sim.diagnose.selection.evidence import Evidence, scatter, together, unbent
from artibot_sim.diagnose.selection.joint_fits import Rival
from artibot_sim.estimation.loss import Loss
from artibot_sim.estimation.parameters import Extension
from artibot_sim.estimation.search import Fit
from artibot_sim.estimation.solver import evaluate
from artibot_sim.estimation.windows import CHANNEL_NAMES
from artibot_sim.experiment import Experiment
from artibot_sim.identify.problems import problem_of
from artibot_sim.identify.requested import parameter_set
from artibot_sim.identify.synthetic import random_manoeuvre, synthetic
from artibot_sim.model import load_robot

ROBOT = load_robot("agriq")
SCALE = 0.99
OWN = 40.0
"""Nats that rotations are made to give."""


@pytest.fixture(scope="module")
def recordings() -> list[Experiment]:
    real = replace(ROBOT, effects={"encoder_scale": {"scale": SCALE}})
    return [synthetic(real, random_manoeuvre(np.random.default_rng(2), 10.0), duration=10.0, kappa=0.8, seed=3)]


@pytest.fixture(scope="module")
def view(recordings: list[Experiment]) -> CommandView:
    return command_view(recordings, ROBOT)


def claim(recordings: list[Experiment], scale: float, sd: float) -> tuple[Rival, Evidence]:
    """What rotations would say: encoders have this scale, known to `sd` coordinates."""
    extension = Extension("encoder_scale")
    problem = with_effect(problem_of(recordings, parameter_set(ROBOT), 5.0, 1), extension)
    own = extension.coordinates({"scale": scale})
    loss = Loss(1.0, np.ones(len(CHANNEL_NAMES)))
    point = evaluate(problem, loss, [np.concatenate([np.zeros(5), own])], problem.starts)[0]
    rival = Rival(Trial(Hypothesis(extension), problem, point, np.full(1, sd)), Fit(point, loss, None, (), True))  # type: ignore[arg-type]
    return rival, Evidence(OWN, 0.0, own, np.array([[sd**2]]))


def test_commands_speak_for_what_is_so(recordings: list[Experiment], view: CommandView) -> None:
    assert together(view, *claim(recordings, SCALE, 0.02), {}) > OWN + 100.0


def test_commands_speak_against_what_is_not(recordings: list[Experiment], view: CommandView) -> None:
    """Rotations are sure of the contrary: each view at its own best would have counted both for the effect."""
    assert view.evidence["encoder_scale"].nats > 100.0
    assert together(view, *claim(recordings, 2.0 - SCALE, 0.001), {}) < 0.0


def test_rotations_that_hardly_know_give_way(recordings: list[Experiment], view: CommandView) -> None:
    rival, own = claim(recordings, 1.0005, 1.0)
    assert together(view, rival, own, {}) > OWN + 100.0


def test_without_commands_rotations_stand(recordings: list[Experiment]) -> None:
    rival, own = claim(recordings, SCALE, 0.02)
    assert together(CommandView(), rival, own, {}) == pytest.approx(OWN)


@pytest.mark.parametrize("draw", ["normal", "standard_t"])
def test_what_windows_lose_tells_how_much_chance_gives(draw: str) -> None:
    """Gains that chance alone makes have sums as large as that; what each window gains for sure is no chance."""
    rng = np.random.default_rng(5)
    gained = rng.standard_t(4.0, (4000, 200)) if draw == "standard_t" else rng.normal(0.0, 3.0, (4000, 200))
    ratios = gained.sum(axis=1) / [scatter(one) for one in gained]
    assert np.std(ratios) == pytest.approx(1.0, abs=0.1)
    few = np.zeros(200)
    few[:3] = 50.0  # it acts in few windows
    assert scatter(few) == 0.0


@pytest.mark.parametrize(("gained", "excess"), [(302.9, 281.1), (86.7, 67.7), (20.0, 0.0), (13.0, 247.8)])
def test_noise_of_the_rotations_is_taken_off_where_it_leaves_most(gained: float, excess: float) -> None:
    """Of all shares of a fitted size that one is best at which noise gives little and the effect much."""
    shares = np.linspace(0.0, 1.0, 10001)
    left = gained * (1.0 - (1.0 - shares) ** 2) - excess * shares
    share = unbent(gained, excess)
    assert share == pytest.approx(shares[np.argmax(left)], abs=1e-4)
    assert share**2 * gained == pytest.approx(left.max(), abs=1e-4)


def test_what_gains_nothing_is_left_as_it_is() -> None:
    assert unbent(-3.0, 10.0) == unbent(0.0, 0.0) == 1.0
