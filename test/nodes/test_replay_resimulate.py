"""`replay --resimulate rotations --horizon` and `identify`: one way to start a window, one figure of what it misses."""

from __future__ import annotations

from dataclasses import replace

import pytest
from bag_helpers import foreign

from artibot_sim.errors import ArtibotError
from artibot_sim.estimation.alignment import aligned
from artibot_sim.experiment import Experiment, read_bag
from artibot_sim.identify.synthetic import synthetic
from artibot_sim.identify.validation import hold_out
from artibot_sim.model import Robot, load_robot
from artibot_sim.nodes.replay.resimulate import simulated
from artibot_sim.planning import Dwell, Eight, Manoeuvre

CLOSE = 3e-3
"""What is left between two figures: steps of 5 ms in one, of 1 ms in the other."""


def articulated() -> tuple[Experiment, Robot, float]:
    """A rover on a soil that the model does not know, in one piece: windows follow each other."""
    robot = load_robot("agriq")
    eight = Manoeuvre("eight", (Dwell(0.5), Eight(radius=1.8, smooth=True, speed=0.6)), a_max=0.5, blend=0.3)
    other = robot.replace({"contact.k_t": 0.6 * robot.contact.k_t, "contact.mu_s": 0.8 * robot.contact.mu_s})
    return synthetic(other, eight, duration=20.0, seed=3), robot, 3.0


def late_poses() -> tuple[Experiment, Robot, float]:
    """Sensors with errors, which the model knows."""
    recording, robot, horizon = articulated()
    seen = {"pose_delay": {"delay": 0.1}, "encoder_scale": {"scale": 1.02}}
    return recording, replace(robot, effects=seen), horizon


def husky() -> tuple[Experiment, Robot, float]:
    """A real one in separate windows, its gyroscope on another clock."""
    recording = read_bag(foreign("real/husky_drive_b"))
    return replace(recording, segments=recording.segments[:60]), load_robot("husky_driven"), 2.0


@pytest.mark.parametrize("case", [articulated, late_poses, husky])
def test_a_resimulation_misses_what_an_identification_says_it_misses(case: object) -> None:
    recording, robot, horizon = case()  # type: ignore[operator]
    told = hold_out(aligned(recording, robot, poses="pose_delay" not in robot.effects).experiment, robot, horizon)
    again = simulated(recording, robot, "rotations", horizon, "auto")
    for channel, fit in told.summary.channels.items():
        metric = again.metrics[channel]
        assert metric.count == fit.count, channel
        assert metric.rmse == pytest.approx(fit.rmse, rel=CLOSE), channel
        assert metric.median == pytest.approx(fit.median, rel=2 * CLOSE), channel
        assert metric.noise == pytest.approx(fit.noise), channel


def test_stamps_are_mended_in_a_free_run_as_well_and_it_is_said() -> None:
    recording, robot, _ = husky()
    remarks = simulated(recording, robot, "rotations", None, "auto").remarks
    assert any("gyroscope" in remark and "shifted" in remark for remark in remarks)


def test_a_horizon_too_short_for_any_window_is_refused() -> None:
    recording, robot, _ = articulated()
    with pytest.raises(ArtibotError, match=r"no window of 0\.15 s holds four positions.*--horizon"):
        simulated(recording, robot, "rotations", 0.15, "auto")
