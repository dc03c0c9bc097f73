"""Currents count as torques up to a constant and an offset, whatever they are the current of."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bag_helpers import JOINTS, joint_state, write_bag
from numpy.typing import NDArray

from artibot_sim.estimation.search import Effort
from artibot_sim.experiment import Experiment, read_bag
from artibot_sim.experiment.columns import Channel
from artibot_sim.identify.currents import (
    READINGS,
    CurrentSensor,
    counts_currents,
    current_sensor,
    currents_of,
    simulated,
    with_torques,
)
from artibot_sim.identify.requested import parameter_set
from artibot_sim.identify.result import FitStatus
from artibot_sim.identify.run import identify, with_currents
from artibot_sim.identify.synthetic import Noise, random_manoeuvre, synthetic
from artibot_sim.model import MOTORS, Robot, load_robot

Array = NDArray[np.float64]

CONSTANTS = {"signed": -0.8, "unsigned": 1.3, "supply": 0.04}
"""A/(N m), A/(N m) and A/W; a current that counts the other way is one with a sign."""
OFFSETS = (0.6, 0.2)
SIDES = MOTORS[:2]
WHEELS = Noise(velocity=0.01, counts=100_000, torque=0.1, torque_share=0.0, jitter=0.0)
"""Of wheels whose speed is measured behind the gear."""


@pytest.fixture(scope="module")
def husky() -> Robot:
    return load_robot("husky_driven")


@pytest.fixture(scope="module")
def run(husky: Robot) -> Experiment:
    """80 s of a Husky with torques."""
    drive = random_manoeuvre(np.random.default_rng(5), 80.0)
    return synthetic(husky, drive, duration=80.0, kappa=1.0, noise=WHEELS, seed=2)


def measured(
    run: Experiment, reading: str, names: tuple[str, ...] = SIDES, late: float = 0.0, noise: float = 0.3
) -> Experiment:
    """The run with currents at 5 Hz instead of torques."""
    rng, motors = np.random.default_rng(3), run.channels["motor_torques"]
    stamps = np.arange(run.start_ns + 10**9, motors.t_ns[-1] - 10**9, 2 * 10**8)
    t = (stamps - run.start_ns) / 1e9
    columns = {}
    for name, motor, offset in zip(names, SIDES, OFFSETS, strict=True):
        torque, speed = (np.interp(t - late, *motors.series(f"{motor}.{what}")) for what in ("effort", "velocity"))
        current = offset + CONSTANTS[reading] * READINGS[reading].of(torque, speed)
        columns[f"{name}.effort"] = current + noise * np.std(current) * rng.standard_normal(len(t))
    silent = {name: column for name, column in motors.columns.items() if not name.endswith("effort")}
    channels = dict(run.channels) | {
        "motor_torques": replace(motors, columns=silent),
        "motor_currents": Channel("/motor_currents", stamps, t, stamps, columns),
    }
    return replace(run, channels=channels)


def sensor_of(recording: Experiment, robot: Robot) -> CurrentSensor | None:
    current = currents_of(recording, robot)
    assert current is not None
    return current_sensor([(current, simulated(recording, robot, 1))], robot)


@pytest.mark.parametrize("names", [SIDES, ("right", "left")])
@pytest.mark.parametrize("reading", list(CONSTANTS))
def test_what_currents_follow_is_found_with_its_constant_and_they_are_torques(
    husky: Robot, run: Experiment, reading: str, names: tuple[str, ...]
) -> None:
    recording = measured(run, reading, names, late=0.1)
    sensor = sensor_of(recording, husky)
    assert sensor is not None and sensor.reading == reading
    assert sensor.late == pytest.approx(0.05, abs=0.101), "torques change slowly"
    assert sensor.constant == pytest.approx(CONSTANTS[reading], rel=0.12), "its scale is fitted once more"
    (found,), (other,), said = with_torques([recording], [run], [husky], 1)
    assert READINGS[reading].words in said
    assert counts_currents(found) and not counts_currents(other), "torques that were recorded stay"
    channel = found.channels["motor_currents"]
    for motor in SIDES:
        t, torque = channel.series(f"{motor}.torque")
        true = np.interp(t, *run.channels["motor_torques"].series(f"{motor}.effort"))
        assert np.corrcoef(torque, true)[0, 1] > 0.8


def test_the_soil_whose_torques_currents_follow_counts(husky: Robot, run: Experiment) -> None:
    """A soil six times as soft explains a path nearly as well; its torques are others."""
    wrong = husky.replace({"contact.k_l": husky.contact.k_l / 6.0, "contact.k_t": husky.contact.k_t / 6.0})
    recording = measured(run, "unsigned", noise=0.1)
    found = sensor_of(recording, husky)
    assert found is not None
    other = sensor_of(recording, wrong)
    assert other is None or other.share < found.share - 0.05
    said = {with_torques([recording], [], paths, 1)[2] for paths in ([husky, wrong], [wrong, husky], [husky])}
    assert len(said) == 1


def test_currents_of_something_else_are_left_out(husky: Robot, run: Experiment) -> None:
    channel = (recording := measured(run, "unsigned")).channels["motor_currents"]
    rng = np.random.default_rng(8)
    foreign = {name: rng.permutation(values) for name, values in channel.columns.items()}
    channels = dict(recording.channels) | {"motor_currents": replace(channel, columns=foreign)}
    (found,), _, said = with_torques([replace(recording, channels=channels)], [], [husky], 1)
    assert "left out" in said and not counts_currents(found)


def test_currents_that_were_not_measured_while_wheels_turned_are_left_out(husky: Robot, run: Experiment) -> None:
    channel = (recording := measured(run, "unsigned")).channels["motor_currents"]
    late = replace(channel, t=channel.t + 500.0, t_ns=channel.t_ns + 500 * 10**9)
    channels = dict(recording.channels) | {"motor_currents": late}
    (found,), _, said = with_torques([replace(recording, channels=channels)], [], [husky], 1)
    assert "left out" in said and not counts_currents(found)


def test_recordings_without_currents_stay_as_they_are(husky: Robot, run: Experiment) -> None:
    found = with_currents([run], [run], parameter_set(husky), 2.0, 0, 1)
    assert found.recordings == [run] and found.holdout == [run]
    assert found.parameters == parameter_set(husky) and not found.remarks


def test_an_identification_with_currents_says_what_they_are_and_what_they_cannot_tell(
    husky: Robot, run: Experiment
) -> None:
    few = Effort(starts=1, finalists=1)
    found = identify([measured(run, "unsigned", noise=0.2)], husky, effort=few, window=2.0, workers=1).result
    assert any("follow the motors' torques without their sign" in remark for remark in found.remarks)
    assert "torque_scale" not in found.robot.effects, "that is of these recordings"
    known = {one.name: one for one in found.estimates}
    assert known["u_w"].status is FitStatus.NOT_IDENTIFIABLE and "without a load" in known["u_w"].note
    low, high = known["mu_s"].ci95
    assert low < husky.contact.mu_s < high, "hardly a wheel slides"
    assert known["k_l"].value == pytest.approx(husky.contact.k_l, rel=0.25)


def test_the_topic_is_read(tmp_path: Path) -> None:
    names = ["front_right", "front_left"]
    messages = []
    for i in range(100):
        stamp = 10**9 + 10**8 * i
        messages.append(("/motor_torques", JOINTS, joint_state(stamp, names, velocity=[1.0, 2.0]), stamp))
        messages.append(("/motor_currents", JOINTS, joint_state(stamp, names, effort=[0.1 * i, 3.0]), stamp))
    found = read_bag(write_bag(tmp_path / "run", messages)).channels["motor_currents"]
    np.testing.assert_allclose(found["front_right.effort"], 0.1 * np.arange(100))
    assert set(found.units.values()) == {"A"}
