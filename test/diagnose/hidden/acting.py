"""Whether an effect acts: by how much it changes what sensors say, over their noise."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from diagnose.hidden import driving, rover, sensors
from diagnose.hidden.machine import Machine, Sensing
from diagnose.hidden.sensors import Noise

if TYPE_CHECKING:
    from diagnose.hidden.cases import Drive

Array = np.ndarray
WINDOW = 5.0
"""s; a window begins in the true state, so that no lost branch counts as an effect."""


def nats_of(drive: Drive, without: Machine, noise: Noise) -> float:
    """Half the squared change of all measurements over noise between a drive and its windows in another machine."""
    fine = rover.STEP * np.arange(round(drive.t[-1] / rover.STEP) + 1)
    wish = driving.executed(drive.t, drive.command, without.way, fine)
    every = len(fine) // (len(drive.grid) - 1)
    size = round(WINDOW / rover.STEP / every)
    total = 0.0
    for first in range(0, len(drive.grid) - 1, size):
        last = min(first + size, len(drive.grid) - 1)
        part = wish[first * every : last * every + 1]
        rows = rover.drive(drive.rows[first], fine[first * every], rover.STEP, every, part, without.rover)
        seen = _seen(drive.rows[first : last + 1], drive.machine.sensing, noise)
        expected = _seen(rows, without.sensing, noise)
        total += sum(
            0.5 * rate * 1e-3 * float(np.sum((a - b) ** 2)) for (rate, a), (_, b) in zip(seen, expected, strict=True)
        )
    return total


def _seen(rows: Array, sensing: Sensing, noise: Noise) -> list[tuple[float, Array]]:
    """Measurements over their noise's standard deviation, with the rate (Hz) at which they are taken."""
    torque = rows[:, rover.TORQUE : rover.TORQUE + 4]
    sd = noise.torque + noise.torque_share * np.abs(torque)
    late = sensors.prism(rows, sensing) - sensing.pose_delay * sensors.map_velocity(rows)
    speed = sensors.smoothed(rows[:, rover.SPEED : rover.SPEED + 4], 1e-3, sensing)
    return [
        (noise.station_rate, late / np.hypot(noise.station, noise.drift)),
        (noise.imu_rate, (rows[:, rover.R] + sensing.gyro_bias) / noise.gyro),
        (noise.articulation_rate, (rows[:, rover.YAW_B] - rows[:, rover.YAW_F]) / noise.articulation),
        (noise.motor_rate, sensing.encoder_scale * speed / noise.velocity),
        (noise.motor_rate, sensing.torque_scale * torque / sd),
    ]
