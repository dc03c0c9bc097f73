"""Sentences on where a model is wrong: they name what was put there, and nothing where there is nothing."""

from __future__ import annotations

import numpy as np
import pytest

from artibot_sim.diagnose.records import ChannelBaseline, Comparison, ErrorSeries
from artibot_sim.diagnose.validation.predictions import baseline_levels, predict
from artibot_sim.diagnose.validation.residuals import (
    concentration,
    direction,
    followed,
    gather,
    moments,
    places,
    worst_moment,
)
from artibot_sim.diagnose.validation.series import comparison
from artibot_sim.experiment import read_bag
from artibot_sim.model import load_robot
from ros_helpers import ROOT

NOISE = 0.004


def drive(error, channel: str = "yaw_rate", runs: int = 3, two: bool = False) -> list[Comparison]:
    """Runs of 60 s through an eight; `error(at)` is what the model is wrong by (n,) or (n, 2), `at` what is driven."""
    comparisons = []
    for k in range(runs):
        rng = np.random.default_rng(k)
        t = np.arange(0.0, 60.0, 0.1)
        rate = 0.4 * np.sin(2 * np.pi * t / (20.0 + k))
        speed = 0.5 + 0.2 * np.sin(2 * np.pi * t / 13.0 + k)
        heading = np.cumsum(rate) * 0.1 + k
        x, y = np.cumsum(speed * np.cos(heading)) * 0.1, np.cumsum(speed * np.sin(heading)) * 0.1
        at = {"t": t, "speed": speed, "yaw_rate": rate, "heading": heading, "articulation_yaw": -0.8 * rate, "x": x,
              "y": y, "load": 1.0 + np.abs(rate)}  # fmt: skip
        shape = (len(t), 2) if two else len(t)
        before = error(at) + NOISE * rng.standard_normal(shape)
        series = ErrorSeries(t, before, NOISE * rng.standard_normal(shape), NOISE)
        path = np.column_stack([t, x, y])
        comparisons.append(Comparison(f"run{k}", k == 2, path, (), (), (), (), None, None, {channel: series}, at))
    return comparisons


def test_errors_in_left_turns_are_said_to_be_there() -> None:
    comparisons = drive(lambda at: 0.05 * (at["yaw_rate"] > 0.1))
    found = concentration(gather(comparisons, "yaw_rate"))
    assert found is not None and "left turns" in found.condition.said
    assert found.error > 0.9


def test_errors_at_a_place_are_said_to_be_there() -> None:
    comparisons = drive(lambda at: 0.2 * (np.hypot(at["x"] - 2.0, at["y"] - 1.5) < 1.2))
    found = concentration(gather(comparisons, "yaw_rate"))
    assert found is not None and found.condition.local
    x, y = (float(v) for v in found.condition.said.partition("(")[2].partition(")")[0].replace("−", "-").split(","))
    assert np.hypot(x - 2.0, y - 1.5) < 1.2


def test_errors_that_come_late_are_said_to_be_late() -> None:
    found = concentration(gather(drive(lambda at: 0.05 * (at["t"] > 42.0)), "yaw_rate"))
    assert found is not None and found.condition.said.startswith("after ")


@pytest.mark.parametrize("seed", range(5))
def test_errors_that_are_everywhere_are_nowhere_in_particular(seed: int) -> None:
    rng = np.random.default_rng(seed)
    assert concentration(gather(drive(lambda at: 0.03 * rng.standard_normal(len(at["t"]))), "yaw_rate")) is None


def test_a_moment_in_one_run_does_not_speak_for_a_manoeuvre() -> None:
    """One bad second in a left turn of one run is no fault of left turns."""

    def error(at: dict[str, np.ndarray]) -> np.ndarray:
        return 3.0 * ((np.abs(at["t"] - 4.0) < 0.5) & (at["heading"][0] < 0.5))

    found = concentration(gather(drive(error), "yaw_rate"))
    assert found is None or found.condition.local


def test_an_error_of_a_few_moments_is_said_to_be_theirs() -> None:
    """A step between two samples is in neither of them: it must not read as if the model were wrong all the time."""

    def error(at: dict[str, np.ndarray]) -> np.ndarray:
        return 2.0 * (np.abs(at["t"] - 20.0) < 0.06) - 2.0 * (np.abs(at["t"] - 40.0) < 0.06)

    samples = gather(drive(error, runs=1), "yaw_rate")
    said = moments(samples)
    assert "in 2 moments" in said
    assert "elsewhere 1.0 times the noise" in said
    wrong_elsewhere = gather(drive(lambda at: error(at) + 0.05 * np.sin(at["t"]), runs=1), "yaw_rate")
    assert not moments(wrong_elsewhere)
    assert not moments(gather(drive(lambda at: 0.0 * at["t"], runs=1), "yaw_rate"))


def test_errors_at_jumps_count_by_what_is_known_there() -> None:
    """In a recording of curves that begin at once the front motors' torque is as good as its noise elsewhere."""
    robot = load_robot("agriq")
    pair = predict(read_bag(ROOT / "bags" / "table6_agriq"), False, robot, robot, 5.0, 1)
    levels = baseline_levels([pair])
    assert levels["torque_front"].over_noise < 0.5 * levels["torque_front"].rmse / levels["torque_front"].noise
    said = [p.what for p in places([comparison(pair, robot)], levels) if p.channel == "torque_front"]
    assert "moments" in said[0]
    assert "times the noise" in said[0].partition("elsewhere")[2]


def test_the_worst_moment_is_told_with_what_was_done() -> None:
    comparisons = drive(lambda at: 0.3 * ((at["t"] >= 25.0) & (at["t"] < 30.0)), runs=1)
    said = worst_moment(gather(comparisons, "yaw_rate"), comparisons, "rad/s")
    assert "run0 from 25 to 30 s" in said
    assert "0.30 rad/s" in said and "turning" in said and "near (" in said


@pytest.mark.parametrize("way", [-2.5, 0.4, 1.9])
def test_a_pull_in_the_map_is_told_with_its_direction(way: float) -> None:
    def error(at: dict[str, np.ndarray]) -> np.ndarray:
        return np.tile([-0.2 * np.cos(way), -0.2 * np.sin(way)], (len(at["t"]), 1))

    said = direction(gather(drive(error, "position", two=True), "position"))
    degrees = float(said.partition("(")[2].partition("°")[0].replace("−", "-"))
    assert np.angle(np.exp(1j * (np.radians(degrees) - way))) == pytest.approx(0.0, abs=0.05)


def test_a_rover_that_lags_is_behind() -> None:
    def error(at: dict[str, np.ndarray]) -> np.ndarray:
        return 0.1 * np.column_stack([np.cos(at["heading"]), np.sin(at["heading"])])

    said = direction(gather(drive(error, "position", two=True), "position"))
    assert "behind its predictions, by 10 cm" in said


def test_an_error_in_proportion_is_told_in_per_cent() -> None:
    said = followed(gather(drive(lambda at: 0.08 * at["yaw_rate"]), "yaw_rate"), "rad/s")
    assert "the model gives 8 % too much" in said


def test_a_constant_error_is_told_with_its_sign() -> None:
    said = followed(gather(drive(lambda at: np.full(len(at["t"]), -0.02)), "yaw_rate"), "rad/s")
    assert said == "the model is too low by 0.020 rad/s on average"


def test_channels_as_good_as_their_noise_are_not_mentioned() -> None:
    comparisons = drive(lambda at: 0.0 * at["t"])
    assert places(comparisons, {"yaw_rate": ChannelBaseline("rad/s", NOISE, NOISE, NOISE)}) == ()


def test_the_worst_channel_comes_first() -> None:
    comparisons = drive(lambda at: 0.05 * (at["yaw_rate"] > 0.1))
    both = [
        Comparison(**{**vars(comparison), "channels": {**comparison.channels, "position": other.channels["position"]}})
        for comparison, other in zip(
            comparisons, drive(lambda at: np.full((len(at["t"]), 2), 0.5), "position", two=True), strict=True
        )
    ]
    baseline = {
        "yaw_rate": ChannelBaseline("rad/s", 0.03, NOISE, 0.1),
        "position": ChannelBaseline("m", 0.7, 0.006, 1.0),
    }
    found = places(both, baseline)
    assert found[0].channel == "position" and "70 cm (RMSE)" in found[0].what
    assert {place.channel for place in found} == {"position", "yaw_rate"}


def test_two_motors_are_no_direction() -> None:
    """Errors of the right and the left motor, (n, 2), are two samples of one channel."""

    def error(at: dict[str, np.ndarray]) -> np.ndarray:
        return np.tile([3.0, 3.0], (len(at["t"]), 1))

    comparisons = drive(error, "front_velocity", two=True)
    samples = gather(comparisons, "front_velocity")
    assert samples.before.shape == (2 * 3 * 600, 1)
    said = [p.what for p in places(comparisons, {"front_velocity": ChannelBaseline("rad/s", 3.0, 0.25, np.nan)})]
    assert "the model is too high by 3.0 rad/s on average" in said
