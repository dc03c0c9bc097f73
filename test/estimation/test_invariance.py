"""What a fit is of does not depend on how it is written down: the map, left and right, the unit of force, time's zero.

A recording and the same one written in another way have the same losses at the same soil; so they have the same best
fit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from diagnose.turns import EVEN, TURNS

from artibot_sim.estimation.solver import evaluate
from artibot_sim.experiment import Experiment
from artibot_sim.identify.problems import problem_of
from artibot_sim.identify.requested import parameter_set
from artibot_sim.identify.synthetic import synthetic
from artibot_sim.model import Robot, load_robot

ROBOT = load_robot("agriq")
SIDES = {"right": "left", "left": "right"}
FORCES = ("front.m", "front.J_x", "front.J_y", "front.J_z", "back.m", "back.J_x", "back.J_y", "back.J_z", "wheel.m_w",
          "wheel.J_wx", "wheel.J_wy", "contact.k_n", "contact.k_l", "contact.k_t", "drive.front.J_m",
          "drive.back.J_m")  # fmt: skip
"""Of a robot file: what has a unit of force, or of mass, in its numerator."""


@pytest.fixture(scope="module")
def recording() -> Experiment:
    return synthetic(ROBOT, TURNS, kappa=0.8, seed=6)


Columns = dict[str, np.ndarray]


def with_columns(of: Experiment, key: str, change: Callable[[Columns], Columns]) -> Experiment:
    channel = of.channels[key]
    columns = {name: np.array(values) for name, values in channel.columns.items()}
    return replace(of, channels={**of.channels, key: replace(channel, columns=change(columns))})


def on_another_map(of: Experiment) -> Experiment:
    """Turned by a quarter and shifted by hundreds of metres."""
    return turned_by(of, 0.5 * np.pi)


def with_other_axes(of: Experiment) -> Experiment:
    """Turned by 2 rad."""
    return turned_by(of, 2.0)


def turned_by(of: Experiment, angle: float) -> Experiment:
    c, s = np.cos(angle), np.sin(angle)

    def turned(columns: Columns) -> Columns:
        x, y = columns["x"], columns["y"]
        return columns | {"x": 300.0 + c * x - s * y, "y": -120.0 + s * x + c * y}

    return with_columns(of, "total_station", turned)


def mirrored(of: Experiment) -> Experiment:
    """Left and right swapped."""

    def swapped(columns: Columns) -> Columns:
        found = {}
        for name, values in columns.items():
            motor, quantity = name.split(".")
            end, side = motor.split("_")
            found[f"{end}_{SIDES[side]}.{quantity}"] = values
        return found

    def negative(*names: str) -> Callable[[Columns], Columns]:
        return lambda columns: columns | {name: -columns[name] for name in names}

    for key in ("motor_torques", "motor_command"):
        of = with_columns(of, key, swapped)
    of = with_columns(of, "total_station", negative("y"))
    of = with_columns(of, "imu", negative("yaw_rate", "ay"))
    return with_columns(of, "joint_states", negative("articulation_yaw.position"))


def begun_earlier(of: Experiment, by: float = 40.0) -> Experiment:
    """The same run in a recording that begins `by` s before it: seconds since the beginning round otherwise."""
    channels = {key: replace(channel, t=channel.t + by) for key, channel in of.channels.items()}
    segments = tuple((a + by, b + by) for a, b in of.segments)
    return replace(of, start_ns=of.start_ns - round(by * 1e9), channels=channels, segments=segments)


def in_other_newtons(of: Experiment, times: float = 2.0) -> Experiment:
    """Torques so many times as large a number."""
    return with_columns(
        of, "motor_torques",
        lambda columns: {name: times * v if name.endswith(".effort") else v for name, v in columns.items()},
    )  # fmt: skip


def robot_in_other_newtons(times: float) -> Robot:
    keys = [key for key in FORCES if key in ROBOT.sources]
    return ROBOT.with_vector(keys, times * np.array(ROBOT.as_vector(keys)))


def losses_of(of: Experiment, robot: Robot) -> np.ndarray:
    """Of each window (windows,), at several soils (rows), from the measured starts."""
    problem = problem_of([of], parameter_set(robot), 3.0, 1)
    soils = 0.1 * np.random.default_rng(8).standard_normal((6, len(problem.parameters)))
    return np.array([point.losses for point in evaluate(problem, EVEN, list(soils), problem.starts)])


@pytest.mark.parametrize(
    ("change", "robot", "within"),
    [
        (on_another_map, ROBOT, 1e-6),
        (with_other_axes, ROBOT, 0.03),
        (mirrored, ROBOT, 1e-6),
        *((partial(begun_earlier, by=seconds), ROBOT, 1e-6) for seconds in (0.37, 40.0, 1234.567)),
        *(
            (partial(in_other_newtons, times=times), robot_in_other_newtons(times), 1e-6)
            for times in (2.0, 64.0, 1.0 / 512.0)  # of motors of Husky's and of Epi.q's size
        ),
    ],
)
def test_a_fit_does_not_depend_on_how_a_recording_is_written(
    recording: Experiment, change: Callable[[Experiment], Experiment], robot: Robot, within: float
) -> None:
    """The noise of positions is estimated along two axes, so that it is a little different along others."""
    before, after = losses_of(recording, ROBOT), losses_of(change(recording), robot)
    assert after.shape == before.shape
    np.testing.assert_allclose(after, before, rtol=within)


def test_the_numbers_do_change(recording: Experiment) -> None:
    """Each way of writing changes what is read, and torques twice as large without their robot change the loss."""
    for change in (on_another_map, mirrored, begun_earlier, in_other_newtons):
        changed = change(recording)
        assert any(
            not np.array_equal(channel.t, recording.channels[key].t)
            or any(not np.array_equal(v, recording.channels[key].columns[n]) for n, v in channel.columns.items())
            for key, channel in changed.channels.items()
        )
    assert losses_of(in_other_newtons(recording), ROBOT).sum() > 1.5 * losses_of(recording, ROBOT).sum()
