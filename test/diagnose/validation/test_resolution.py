"""Errors of front motors' speeds: what is finer than any encoder shows is none, also in a recording without noise."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from artibot_sim.diagnose.commands.model import CommandResponse
from artibot_sim.diagnose.commands.series import RESOLUTION, level_of, series_of
from artibot_sim.diagnose.records import ChannelBaseline
from artibot_sim.diagnose.words import is_wrong
from artibot_sim.experiment import Experiment
from artibot_sim.identify.synthetic import synthetic
from artibot_sim.model import MOTORS, load_robot
from artibot_sim.planning import Dwell, Manoeuvre, Ramp, Stop, Straight

RAMP = Manoeuvre("ramp", (Dwell(0.5), Ramp(speed=0.6), Straight(length=2.0), Stop()), a_max=0.5, blend=0.3)


def following(error: float) -> Experiment:
    """A recording whose front motors turn as commanded but for `error` (rad/s), exactly."""
    own = synthetic(load_robot("agriq"), RAMP, seed=1, name="exact", duration=6.0)
    motors = own.channels["motor_torques"]
    names = [f"{motor}.velocity" for motor in MOTORS[:2]]
    smooth = {name: 3.0 + np.sin(0.5 * motors.t) for name in names}
    command = replace(motors, topic="/motor_command", columns=dict(smooth))
    measured = replace(motors, columns={**motors.columns, **{name: smooth[name] + error for name in names}})
    return replace(own, channels={**own.channels, "motor_torques": measured, "motor_command": command})


@pytest.mark.parametrize(("error", "wrong"), [(5e-7, False), (0.05, True)])
def test_a_speed_off_by_less_than_sensors_resolve_is_not_off(error: float, wrong: bool) -> None:
    recording = following(error)
    found = series_of([recording], CommandResponse(), CommandResponse(), None, None)  # type: ignore[arg-type]
    level = level_of(found)
    assert level.rmse == pytest.approx(error, rel=0.2, abs=1e-6)
    assert level.noise == found["exact"].noise == RESOLUTION
    assert is_wrong("front_velocity", ChannelBaseline(level.unit, level.rmse, level.noise, math.nan)) is wrong


def test_noise_that_is_measured_stays() -> None:
    noisy = following(0.0)
    motors = noisy.channels["motor_torques"]
    rng = np.random.default_rng(3)
    columns = {name: column + 0.02 * rng.standard_normal(len(column)) for name, column in motors.columns.items()}
    again = replace(noisy, channels={**noisy.channels, "motor_torques": replace(motors, columns=columns)})
    found = series_of([again], CommandResponse(), CommandResponse(), None, None)  # type: ignore[arg-type]
    assert level_of(found).noise == pytest.approx(0.02, rel=0.2)
