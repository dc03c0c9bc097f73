"""Answers to what is on no list: it is never nothing, and takes nothing from what commands show."""

from __future__ import annotations

import pytest
from diagnose.hidden import Case, case
from diagnose.searches import FEW, try_only

from artibot_sim.diagnose import Diagnosis, Verdict, diagnose
from artibot_sim.diagnose.remains import leaves_more_than_noise
from artibot_sim.diagnose.result import headline
from artibot_sim.model import load_robot


def answer(found: Case) -> Diagnosis:
    return diagnose(found.recordings, load_robot("agriq"), holdout=found.holdout)


@pytest.mark.long
def test_what_no_effect_and_no_force_explains_is_said_to_be_there(monkeypatch: pytest.MonkeyPatch) -> None:
    """A third of a wandering moment, in one recording of twenty seconds: too faint for its law, plain in its traces."""
    try_only(monkeypatch, *FEW, "external_force")
    found = answer(case(("wandering_moment",), 0.35, 3, runs=1, duration=20.0))
    assert found.verdict is Verdict.UNEXPLAINED and not found.causes and found.unexplained is None
    assert leaves_more_than_noise(found.left)
    assert "More than noise is left in articulation angle and back motors' torque" in headline(found)
    assert found.next_experiment is not None


@pytest.mark.long
def test_what_leaves_far_more_than_noise_is_not_named_and_a_delay_of_commands_is(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A drag that twelve seconds cannot tell: the nearest names take a part of it. Commands know nothing of that."""
    try_only(monkeypatch, *FEW, "external_force", "friction_anisotropy", "bulldozing", "wheel_resistance", "slip_ratio")
    found = answer(case(("command_delay", "yaw_drag"), 1.0, 2, runs=1, duration=12.0))
    assert found.verdict is Verdict.UNEXPLAINED
    assert leaves_more_than_noise(found.left)
    assert [cause.effect for cause in found.causes] == ["command_delay"]
    assert abs(found.causes[0].parameters["delay"].value - 0.15) < 0.005
    assert found.extended.effects.keys() == {"command_delay"}


@pytest.mark.long
def test_a_ceiling_of_the_speeds_is_on_no_list(monkeypatch: pytest.MonkeyPatch) -> None:
    """Drives that turn no faster than 110 rad/s: the speeds are tens of times their noise off.

    What else happens to commands may gain a little there, and leaves nearly all of it.
    """
    try_only(monkeypatch, *FEW)
    found = answer(case(("command_ceiling",), 1.0, 1, runs=2, duration=15.0))
    assert found.baseline["front_velocity"].rmse > 20.0 * found.baseline["front_velocity"].noise
    assert found.verdict is Verdict.UNEXPLAINED and not found.causes
    assert "front motors' speed" in headline(found)
