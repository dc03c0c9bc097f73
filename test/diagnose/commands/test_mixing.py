"""Commands that are not the motors' are told from motors that do not follow theirs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from estimation.logger import Drive, Logger, drive, recorded

from artibot_sim.diagnose.commands.view import command_view
from artibot_sim.model import load_robot

HUSKY = load_robot("husky_driven")


@pytest.fixture(scope="module")
def driven() -> Drive:
    return drive(HUSKY, np.random.default_rng(1))


def view(of: Drive, command: np.ndarray, speed: np.ndarray):
    seen = replace(of, command=command, speed=speed)
    return command_view([recorded(seen, Logger(polled=0.0), np.random.default_rng(2))], HUSKY)


def twisted(command: np.ndarray, turning: float) -> np.ndarray:
    """Both sides' commands as who takes another track computes them from the same twist."""
    mean, half = command.mean(axis=1, keepdims=True), 0.5 * (command[:, :1] - command[:, 1:])
    return mean + np.hstack([half, -half]) / turning


@pytest.mark.parametrize("turning", [0.5, 0.8, 1.3])
def test_a_twist_converted_with_another_track_is_found(driven: Drive, turning: float) -> None:
    found = view(driven, twisted(driven.command, turning), driven.speed)
    low, high = found.mixing.interval
    assert found.mixing.turning == pytest.approx(turning, rel=0.05) and high - low < 0.1
    assert not (found.plausible or found.followed) and found.found == ()
    assert f"{found.mixing.turning:.2f} times" in found.why
    assert not any(one.nats for one in found.evidence.values()) and found.for_robot(HUSKY) == ({}, {})


def test_motors_own_commands_are_theirs(driven: Drive) -> None:
    found = view(driven, driven.command, driven.speed)
    assert found.plausible and found.followed and not found.why
    assert found.mixing.turning == pytest.approx(1.0, abs=0.03)


def test_a_drive_at_its_limit_mixes_nothing(driven: Drive) -> None:
    """Speeds that end at a third of the fastest command, on no list."""
    most = np.abs(driven.speed).max() / 3.0
    assert view(driven, driven.command, np.clip(driven.speed, -most, most)).plausible


@pytest.mark.long
def test_sides_that_are_told_the_same_tell_nothing(driven: Drive) -> None:
    both = driven.command.mean(axis=1, keepdims=True) * [1.0, 1.0]
    speed = driven.speed.mean(axis=1, keepdims=True) * [1.0, 1.0]
    assert view(driven, both, speed).plausible
