"""What turns the motors when a recording is simulated again: measured rotations, or recorded commands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment.columns import Channel, Experiment, Floats
from artibot_sim.experiment.kinks import fit_beside
from artibot_sim.experiment.local_fit import bridge, fresh, local_fit
from artibot_sim.model import MOTORS, Commands, Mode, Robot
from artibot_sim.model.rollout_checks import default_modes

HALF_WIDTH = 0.04
"""s around each instant whose encoder positions give angle and speed there."""
GAP = 0.5
"""Silence of a command, s, after which the motor is taken to have been told to stand."""
_KNOT = 0.01


@dataclass(frozen=True)
class MotorInputs:
    """Inputs of all motors over one stretch of a recording.

    Attributes
    ----------
    t : (n,) knots, s, `dt` apart.
    dt : s.
    position, velocity : (n, 4) rad, rad/s, motor-side; NaN columns for motors without.
    torque : (n, 4) N·m, held from its knot on; NaN for eq. 30.
    modes : of the four motors.
    measured_position, measured_velocity : (n, 4) what the encoders say, for start states; NaN where nothing is known.
    """

    t: Floats
    dt: float
    position: Floats
    velocity: Floats
    torque: Floats
    modes: tuple[Mode, ...]
    measured_position: Floats
    measured_velocity: Floats

    def commands(self, first: int, last: int, offset: Floats) -> Commands:
        """Return the commands from knot `first` to knot `last`, with `offset` (4,) rad added to the angles."""
        part = slice(first, last + 1)
        return Commands(
            self.dt, self.velocity[part], position=self.position[part] + offset, torque=self.torque[part],
            t0=float(self.t[first]),
        )  # fmt: skip


def rotations(
    experiment: Experiment, robot: Robot, t_start: float, t_end: float, half_width: float = HALF_WIDTH
) -> MotorInputs:
    """Return inputs that turn every motor as it was measured to turn.

    Encoder positions give both angle and speed, by a cubic fitted locally (`half_width`, s); a motor without
    positions is turned by its recorded speed. Back motors without either are driven by their recorded torque, or
    share eq. 30's.

    Raises
    ------
    ArtibotError
        If a front motor's rotation is not in the recording.
    """
    motors = experiment.require("motor_torques")
    t = _knots(t_start, t_end, _KNOT)
    position, velocity = np.full((2, len(t), 4), np.nan)
    for i, motor in enumerate(MOTORS[: _count(robot)]):
        found = _rotation(motors, motor, t, t_start, t_end, half_width)
        if found is not None:
            position[:, i], velocity[:, i] = found
        elif i < 2:
            raise ArtibotError(
                f"{experiment.path}: topic {motors.topic} has neither position nor velocity of {motor}; it has "
                f"{', '.join(motors.columns)}; resimulate from commands instead, or give the topic with --topic"
            )
    turned = np.isfinite(velocity).all(axis=0)
    torque = np.full_like(velocity, np.nan)
    for i in np.flatnonzero(~turned).tolist():
        torque[:, i] = _held(motors, f"{MOTORS[i]}.effort", t)
    modes = tuple(Mode.PRESCRIBED if given else Mode.TORQUE for given in turned)
    return MotorInputs(t, _KNOT, position, velocity, torque, modes, position, velocity)


def commands(experiment: Experiment, robot: Robot, t_start: float, t_end: float, back: str = "auto") -> MotorInputs:
    """Return inputs that do again what `/motor_command` says: front speeds, linear from one to the next.

    Parameters
    ----------
    back : `kappa`: the back motors share their torque by eq. 30; `effort`: they get the recorded back efforts;
        `auto`: eq. 30 where the recording names its kappa, or has no back efforts.

    Raises
    ------
    ArtibotError
        If the recording has no front speeds, or no back efforts and they were asked for.
    """
    names = [f"{motor}.velocity" for motor in MOTORS[:2]]
    channel = experiment.require("motor_command", *names)
    spacing = float(np.median(np.diff(channel.t))) if len(channel) > 1 else _KNOT
    dt = min(_KNOT, max(1e-3, round(spacing, 3)))
    t = _knots(t_start, t_end, dt)
    velocity = np.full((len(t), 4), np.nan)
    for i, name in enumerate(names):
        velocity[:, i] = _commanded(*channel.series(name), t)
    torque = np.full_like(velocity, np.nan)
    if robot.articulated and _by_effort(experiment, channel, back):
        for i in (2, 3):
            torque[:, i] = _held(channel, f"{MOTORS[i]}.effort", t)
    measured = np.full((2, len(t), 4), np.nan)
    motors = experiment.channels.get("motor_torques")
    for i, motor in enumerate(MOTORS[: _count(robot)]):
        found = _rotation(motors, motor, t, t_start, t_end) if motors else None
        if found is not None:
            measured[:, :, i] = found
    position = np.full_like(velocity, np.nan)
    mean = 0.5 * (velocity[1:, :2] + velocity[:-1, :2])
    position[:, :2] = np.vstack([np.zeros((1, 2)), np.cumsum(dt * mean, axis=0)])
    modes = default_modes(robot)  # front motors that an effect limits are driven
    return MotorInputs(t, dt, position, velocity, torque, modes, measured[0], measured[1])


def _count(robot: Robot) -> int:
    return 4 if robot.articulated else 2


def _knots(t_start: float, t_end: float, dt: float) -> Floats:
    """Return knots from `t_start` to the first one not before `t_end`."""
    count = max(2, int(np.ceil((t_end - t_start) / dt - 1e-6)) + 1)
    return np.asarray(t_start + dt * np.arange(count), float)


def _by_effort(experiment: Experiment, channel: Channel, back: str) -> bool:
    recorded = all(f"{motor}.effort" in channel for motor in MOTORS[2:])
    if back == "effort" and not recorded:
        raise ArtibotError(
            f"{experiment.path}: topic {channel.topic} has no back efforts; it has {', '.join(channel.columns)}; "
            "leave them to eq. 30 with --back kappa"
        )
    return recorded and (back == "effort" or (back == "auto" and "kappa" not in experiment.metadata))


def _rotation(
    motors: Channel, motor: str, t: Floats, t_start: float, t_end: float, half_width: float = HALF_WIDTH
) -> tuple[Floats, Floats] | None:
    """Return angle and speed (n,) of one motor at knots, or None if it is not recorded there."""
    margin = 0.5  # s of neighbours beyond the ends of a stretch; never those of another segment, which is further off
    for quantity in ("position", "velocity"):
        name = f"{motor}.{quantity}"
        if name not in motors:
            continue
        times, values = motors.series(name)
        used = (times >= t_start - margin) & (times <= t_end + margin)
        times, values = times[used], values[used]
        new = fresh(values)
        times, values = times[new], values[new]
        if len(times) > 3:
            if quantity == "position":
                return _from_positions(times, values, t, half_width)
            return _from_speeds(times, values, t)
    return None


def _from_positions(times: Floats, values: Floats, t: Floats, half_width: float) -> tuple[Floats, Floats]:
    value, rate = fit_beside(times, values, t, half_width)
    value, rate = value[:, None], rate[:, None]
    spacing = float(np.median(np.diff(times)))
    value, rate = bridge(times, t, value, rate, max(0.1, 4.0 * spacing))
    return value[:, 0], rate[:, 0]


def _from_speeds(times: Floats, values: Floats, t: Floats) -> tuple[Floats, Floats]:
    """Return the integral of recorded speeds, smoothed where they are dense enough for it, and the speeds."""
    if float(np.median(np.diff(times))) <= HALF_WIDTH / 2:
        values, _ = local_fit(times, values, times, HALF_WIDTH)
    speed = np.interp(t, times, values)
    angle = np.concatenate(([0.0], np.cumsum(0.5 * np.diff(t) * (speed[1:] + speed[:-1]))))
    return angle, speed


def _commanded(times: Floats, values: Floats, t: Floats) -> Floats:
    """Return commanded speeds (n,) at knots: 0 before the first, after the last and in long silences."""
    speed = np.interp(t, times, values, left=0.0, right=0.0)
    at = np.clip(np.searchsorted(times, t), 1, max(1, len(times) - 1))
    silent = (times[at] - times[at - 1] > GAP) & (t > times[at - 1]) & (t < times[at]) if len(times) > 1 else False
    near = (t >= times[0] - 1e-6) & (t <= times[-1] + _KNOT)  # the grid's last knot may lie past the last command
    held = np.interp(t, times, values)
    return np.where(silent, 0.0, np.where(near, held, speed))


def _held(channel: Channel, name: str, t: Floats) -> Floats:
    """Return the last value at or before each knot; NaN (eq. 30) before the first, and where none is recorded."""
    if name not in channel:
        return np.full(len(t), np.nan)
    times, values = channel.series(name)
    at = np.searchsorted(times, t + 1e-6, side="right") - 1
    return np.where(at >= 0, values[np.maximum(at, 0)], np.nan)
