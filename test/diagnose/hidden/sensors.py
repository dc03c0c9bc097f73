"""What sensors make of a drive: rates, noise with a colour, lost samples, counts, clocks."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from diagnose.hidden import rover as at
from diagnose.hidden.effects import MOTORS
from diagnose.hidden.machine import Sensing
from scipy.signal import lfilter

from artibot_sim.diagnose.sizes import scale_of
from artibot_sim.model import Robot

Array = np.ndarray
Rng = np.random.Generator
Table = tuple[Array, dict[str, Array]]
"""Stamps (n,) in s and columns (n,)."""


@dataclass(frozen=True)
class Noise:
    """Errors of the sensors, SI; rates in Hz.

    Attributes
    ----------
    counts : int
        Of an encoder, a motor turn.
    torque_share : float
        Of a torque; adds to `torque`.
    station, drift, memory : float
        The total station's white error, and another that is forgotten over `memory` s; both m.
    lost : float
        Share of its points that are lost.
    jitter : float
        Of every stamp, s.
    offset : float
        Standard deviation of each topic's clock against the motors', s.
    """

    counts: int = 2048
    velocity: float = 0.25
    torque: float = 0.02
    torque_share: float = 0.01
    articulation: float = 0.002
    gyro: float = 0.004
    acceleration: float = 0.05
    station: float = 0.003
    drift: float = 0.0018
    memory: float = 0.3
    lost: float = 0.01
    jitter: float = 0.0
    offset: float = 0.0
    motor_rate: float = 100.0
    articulation_rate: float = 50.0
    imu_rate: float = 100.0
    station_rate: float = 10.0

    def of(self, robot: Robot) -> Noise:
        """The same for a robot whose motors turn faster and pull less than Agri.q's."""
        scale = scale_of(robot)
        return replace(self, velocity=self.velocity * scale.speed, torque=self.torque * scale.motor)

    def scaled(self, factor: float) -> Noise:
        """The same with all standard deviations times a factor."""
        names = ("velocity", "torque", "torque_share", "articulation", "gyro", "acceleration", "station", "drift")
        return replace(self, **{name: factor * getattr(self, name) for name in names})


def _column(t: Array, rows: Array, grid: Array, column: int) -> Array:
    return np.interp(t, grid, rows[:, column])


def _clock(rng: Rng, end: float, rate: float, noise: Noise, shift: float = 0.0) -> tuple[Array, Array]:
    """True instants and stamps, s; stamps stay in order."""
    t = np.arange(0.0, end, 1.0 / rate)
    wobble = np.clip(noise.jitter * rng.standard_normal(len(t)), -0.4 / rate, 0.4 / rate)
    return t, t + wobble + shift


def map_velocity(rows: Array) -> Array:
    """Velocity of the front origin in `map` (n, 2), m/s."""
    c, s = np.cos(rows[:, at.YAW_F]), np.sin(rows[:, at.YAW_F])
    u, v = rows[:, at.U], rows[:, at.V]
    return np.column_stack([c * u - s * v, s * u + c * v])


def smoothed(speed: Array, h: float, sensing: Sensing) -> Array:
    """Speeds (n, k), `h` s apart, through the low-pass in front of what is recorded; it has settled at the first."""
    kept = np.exp(-h / sensing.smoothed) if sensing.smoothed else 0.0
    return lfilter([1.0 - kept], [1.0, -kept], speed, axis=0, zi=kept * speed[:1])[0]


def prism(rows: Array, sensing: Sensing) -> Array:
    """Where the tracked point is (n, 2), m."""
    c, s = np.cos(rows[:, at.YAW_F]), np.sin(rows[:, at.YAW_F])
    x, y = sensing.lever_x, sensing.lever_y
    return rows[:, :2] + np.column_stack([c * x - s * y, s * x + c * y])


def observe(grid: Array, rows: Array, t_command: Array, command: Array, sensing: Sensing, noise: Noise, rng: Rng):
    """Tables by channel key of what is recorded of a drive.

    Parameters
    ----------
    grid, rows : arrays, shape (n,) and (n, ROW)
        The drive, s since its start.
    t_command, command : arrays, shape (m,) and (m, 2)
        What the front motors were told.
    """
    end = float(grid[-1])
    shift = noise.offset * rng.standard_normal(3)
    return {
        "motor_torques": _motors(grid, rows, sensing, noise, rng, end),
        "motor_command": _command(grid, rows, t_command, command, noise, rng, end),
        "joint_states": _joint(grid, rows, noise, rng, end, shift[0]),
        "imu": _imu(grid, rows, sensing, noise, rng, end, shift[1]),
        "total_station": _station(grid, rows, sensing, noise, rng, end, shift[2]),
    }


def _motors(grid: Array, rows: Array, sensing: Sensing, noise: Noise, rng: Rng, end: float) -> Table:
    t, stamps = _clock(rng, end, noise.motor_rate, noise)
    count = 2 * np.pi / noise.counts
    columns = {}
    speeds = smoothed(rows[:, at.SPEED : at.SPEED + 4], float(grid[1] - grid[0]), sensing)
    for i, motor in enumerate(MOTORS):
        angle, torque = (_column(t, rows, grid, c + i) for c in (at.ANGLE, at.TORQUE))
        speed = np.interp(t, grid, speeds[:, i])
        columns[f"{motor}.position"] = count * np.floor(sensing.encoder_scale * angle / count + 0.5)
        columns[f"{motor}.velocity"] = sensing.encoder_scale * speed + noise.velocity * rng.standard_normal(len(t))
        sd = noise.torque + noise.torque_share * np.abs(torque)
        columns[f"{motor}.effort"] = sensing.torque_scale * torque + sd * rng.standard_normal(len(t))
    return stamps, columns


def _command(grid: Array, rows: Array, t_command: Array, command: Array, noise: Noise, rng: Rng, end: float) -> Table:
    """What was commanded at the motors' rate: speeds in front, torques behind."""
    t, stamps = _clock(rng, end, noise.motor_rate, noise)
    columns = {f"{motor}.velocity": np.interp(t, t_command, command[:, i]) for i, motor in enumerate(MOTORS[:2])}
    columns |= {f"{motor}.effort": _column(t, rows, grid, at.TORQUE + 2 + i) for i, motor in enumerate(MOTORS[2:])}
    return stamps, columns


def _joint(grid: Array, rows: Array, noise: Noise, rng: Rng, end: float, shift: float) -> Table:
    t, stamps = _clock(rng, end, noise.articulation_rate, noise, shift)
    angle = _column(t, rows, grid, at.YAW_B) - _column(t, rows, grid, at.YAW_F)
    return stamps, {"articulation_yaw.position": angle + noise.articulation * rng.standard_normal(len(t))}


def _imu(grid: Array, rows: Array, sensing: Sensing, noise: Noise, rng: Rng, end: float, shift: float) -> Table:
    t, stamps = _clock(rng, end, noise.imu_rate, noise, shift)
    velocity, half = map_velocity(rows), 0.5 / noise.imu_rate
    after, before = np.minimum(t + half, end), np.maximum(t - half, 0.0)
    a_x, a_y = ((np.interp(after, grid, v) - np.interp(before, grid, v)) / (after - before) for v in velocity.T)
    yaw = _column(t, rows, grid, at.YAW_F)
    noises = rng.standard_normal((3, len(t)))
    return stamps, {
        "yaw_rate": _column(t, rows, grid, at.R) + sensing.gyro_bias + noise.gyro * noises[0],
        "ax": np.cos(yaw) * a_x + np.sin(yaw) * a_y + noise.acceleration * noises[1],
        "ay": np.cos(yaw) * a_y - np.sin(yaw) * a_x + noise.acceleration * noises[2],
    }


def _station(grid: Array, rows: Array, sensing: Sensing, noise: Noise, rng: Rng, end: float, shift: float) -> Table:
    t, stamps = _clock(rng, end, noise.station_rate, noise, shift + sensing.pose_delay)
    point = prism(rows, sensing)
    error = noise.station * rng.standard_normal((len(t), 2))
    kept, walk = np.exp(-1.0 / (noise.station_rate * noise.memory)), noise.drift * rng.standard_normal(2)
    for row in error:
        row += walk
        walk = kept * walk + noise.drift * np.sqrt(1.0 - kept**2) * rng.standard_normal(2)
    there = rng.random(len(t)) >= noise.lost
    x, y = (np.interp(t, grid, column) + error[:, i] for i, column in enumerate(point.T))
    return stamps[there], {"x": x[there], "y": y[there], "z": np.zeros(int(there.sum()))}
