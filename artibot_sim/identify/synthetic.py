"""Recordings with a soil that is known: what an identification is tried on."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from artibot_sim.estimation.parameters import SOIL
from artibot_sim.experiment import Channel, Experiment
from artibot_sim.experiment.inputs import recorded_motors
from artibot_sim.model import MOTORS, Robot, Rollout, rollout
from artibot_sim.model.simulate.rollout import integration
from artibot_sim.model.simulate.sensors import sensor_errors, tracked_point
from artibot_sim.planning import Arc, Dwell, Eight, Manoeuvre, Plan, Ramp, Segment, Slalom, Stop, Straight, plan

Array = NDArray[np.float64]

START_NS = 1_000_000_000
_EVERY = 1e-3
"""s between rows of the simulation."""
_BLEND = 0.3
"""m over which curvature changes: no real motor's speed jumps."""


@dataclass(frozen=True)
class Noise:
    """Errors of the sensors: standard deviations (SI) unless said otherwise, and their rates (Hz).

    Attributes
    ----------
    counts : int
        Encoder counts a motor turn.
    torque_share : float
        Of a torque, beside `torque`.
    colour : float
        Correlation of one point of the total station with the one before.
    lost : float
        Share of its points that are lost.
    jitter : float
        Of every stamp, s.
    heading : float or None
        Of a heading that comes with each point, rad, as a localisation has it: then the points are those of
        `ground_truth_odom`. None: of points alone, of a total station.
    """

    counts: int = 2048
    velocity: float = 0.25
    torque: float = 0.02
    torque_share: float = 0.01
    articulation: float = 0.002
    gyro: float = 0.004
    acceleration: float = 0.05
    station: float = 0.0035
    colour: float = 0.5
    lost: float = 0.01
    jitter: float = 0.0
    motor_rate: float = 100.0
    articulation_rate: float = 50.0
    imu_rate: float = 100.0
    station_rate: float = 10.0
    command_rate: float = 100.0
    heading: float | None = None


def random_soil(robot: Robot, rng: np.random.Generator, spread: float = 0.12) -> Robot:
    """The robot on another soil: each parameter drawn log-normally about the robot's; mu_d at most mu_s."""
    keys = [f"contact.{name}" for name in SOIL]
    drawn = robot.as_vector(keys) * np.exp(spread * rng.standard_normal(len(keys)))
    at = {name: i for i, name in enumerate(SOIL)}
    drawn[at["mu_d"]] = min(drawn[at["mu_d"]], drawn[at["mu_s"]])
    return robot.with_vector(keys, drawn)


def random_manoeuvre(rng: np.random.Generator, duration: float) -> Manoeuvre:
    """An eight, a slalom or stop-and-go of random size and speed, repeated until it lasts so long."""
    speed, kind = float(rng.uniform(0.4, 0.8)), int(rng.integers(3))
    sign = float(rng.choice([-1.0, 1.0]))
    segments: list[Segment] = [Dwell(1.0)]
    length = speed * duration
    if kind == 0:
        radius = float(rng.uniform(1.8, 2.8))
        for _ in range(int(length / (4 * np.pi * radius)) + 1):
            segments.append(Eight(radius=radius, smooth=True, speed=speed, end_speed=0.0))
    elif kind == 1:
        wave, bend = float(rng.uniform(5.0, 9.0)), float(rng.uniform(0.3, 0.5))
        segments += [Ramp(speed=speed), Slalom(curvature=sign * bend / 2, wavelength=wave, periods=0.5)]
        periods = float(np.ceil(length / wave))
        segments += [Slalom(curvature=-sign * bend, wavelength=wave, periods=periods), Stop()]
    else:
        for k in range(int(length / 4.0) + 1):
            turn = sign * float(rng.uniform(0.6, 1.6)) * (-1.0) ** k
            segments += [
                Ramp(speed=speed), Straight(length=1.0), Arc(radius=float(rng.uniform(1.6, 3.0)), angle=turn), Stop(),
                Dwell(0.7),
            ]  # fmt: skip
    return Manoeuvre("random", tuple(segments), a_max=0.5, blend=_BLEND)


def synthetic(
    robot: Robot,
    manoeuvre: Manoeuvre,
    *,
    duration: float = 45.0,
    kappa: float = 0.8,
    noise: Noise | None = None,
    seed: int = 0,
    start: tuple[float, float, float] = (0.0, 0.0, 0.0),
    start_ns: int = START_NS,
    name: str = "synthetic",
) -> Experiment:
    """A recording of a robot that drives a manoeuvre: front motors follow the plan, back ones share (Fig. 7).

    The robot's effects act on its commands and sensors as well. The same seed gives the same recording.
    """
    planned = plan(manoeuvre, robot, start=start)
    result = _drive(robot, planned, min(duration, planned.duration), kappa)
    recording = observed(
        robot, result, noise or Noise(), seed, start_ns, name, {"robot": robot.name, "kappa": repr(kappa)}
    )
    commanded = _command(robot, result, planned, noise or Noise(), seed, start_ns)
    return replace(recording, channels=dict(recording.channels) | {"motor_command": commanded})


def _drive(robot: Robot, planned: Plan, duration: float, kappa: float) -> Rollout:
    from artibot_sim.model import initial_state
    from artibot_sim.model.simulate.commands import as_executed

    state = initial_state(robot, *planned.start)
    integrator, step = integration(robot, _EVERY, kappa=kappa)
    return rollout(
        robot,
        as_executed(robot, planned.commands()),
        dt=step,
        every=round(_EVERY / step),
        kappa=kappa,
        integrator=integrator,
        duration=duration,
        state=state,
    )


def observed(
    robot: Robot, result: Rollout, noise: Noise, seed: int, start_ns: int, name: str, metadata: dict[str, str]
) -> Experiment:
    """What sensors make of a rollout."""
    rng = np.random.default_rng(seed)
    end = float(result.t[-1])
    channels = {
        "motor_torques": _motors(robot, result, noise, rng, end, start_ns),
        "imu": _imu(result, sensor_errors(robot).gyro_bias, noise, rng, end, start_ns),
        "total_station" if noise.heading is None else "ground_truth_odom": _points(
            robot, result, noise, rng, end, start_ns
        ),
    }
    if robot.articulated:
        channels["joint_states"] = _joints(robot, result, noise, rng, end, start_ns)
    return Experiment(name, Path(name), metadata, start_ns, channels, ((0.0, end),))


def _times(rng: np.random.Generator, rate: float, end: float, jitter: float) -> tuple[Array, Array]:
    """True instants and stamps, s."""
    t = np.arange(0.0, end, 1.0 / rate)
    limit = 0.4 / rate  # stamps stay in order
    return t, np.maximum(t + np.clip(jitter * rng.standard_normal(len(t)), -limit, limit), 0.0)


def _at(result: Rollout, values: Array, t: Array) -> Array:
    table = values if values.ndim > 1 else values[:, None]
    return np.column_stack([np.interp(t, result.t, column) for column in table.T])


def _channel(topic: str, t: Array, start_ns: int, columns: dict[str, Array]) -> Channel:
    stamps = start_ns + np.round(t * 1e9).astype(np.int64)
    return Channel(topic, stamps, (stamps - start_ns) / 1e9, stamps, columns)


def _motors(robot: Robot, result: Rollout, noise: Noise, rng: np.random.Generator, end: float, ns: int) -> Channel:
    t, stamps = _times(rng, noise.motor_rate, end, noise.jitter)
    motors = robot.motors if robot.articulated else MOTORS[:2]
    angle, speed, torque = (_at(result, v, t) for v in recorded_motors(result, robot))
    step = 2 * np.pi / noise.counts
    columns: dict[str, Array] = {}
    for i, motor in enumerate(motors):
        columns[f"{motor}.position"] = np.round(angle[:, i] / step) * step
        columns[f"{motor}.velocity"] = speed[:, i] + noise.velocity * rng.standard_normal(len(t))
        sd = np.hypot(noise.torque, noise.torque_share * torque[:, i])
        columns[f"{motor}.effort"] = torque[:, i] + sd * rng.standard_normal(len(t))
    return _channel("/motor_torques", stamps, ns, columns)


def _command(robot: Robot, result: Rollout, planned: Plan, noise: Noise, seed: int, ns: int) -> Channel:
    """What was commanded, from a stream of its own: front velocities as planned, and the back motors' share."""
    t, stamps = _times(np.random.default_rng([seed, 1]), noise.command_rate, float(result.t[-1]), noise.jitter)
    columns = {f"{motor}.velocity": planned.at(t).velocity[:, i] for i, motor in enumerate(MOTORS[:2])}
    if robot.articulated:
        torque = _at(result, result.motor_torque, t)
        columns |= {f"{motor}.effort": torque[:, i] for i, motor in enumerate(robot.motors) if i >= 2}
    return _channel("/motor_command", stamps, ns, columns)


def _joints(robot: Robot, result: Rollout, noise: Noise, rng: np.random.Generator, end: float, ns: int) -> Channel:
    t, stamps = _times(rng, noise.articulation_rate, end, noise.jitter)
    columns = {}
    for name, bend in zip(robot.articulation_joints[::2], result.articulations[:, :, 0].T, strict=True):
        columns[f"{name}.position"] = _at(result, bend, t)[:, 0] + noise.articulation * rng.standard_normal(len(t))
    return _channel("/joint_states", stamps, ns, columns)


def _imu(result: Rollout, bias: float, noise: Noise, rng: np.random.Generator, end: float, ns: int) -> Channel:
    t, stamps = _times(rng, noise.imu_rate, end, noise.jitter)
    h = 0.01
    velocity = [_at(result, result.v[:, :2], np.clip(t + s, 0.0, end)) for s in (-h, h)]
    across = np.clip(t + h, 0.0, end) - np.clip(t - h, 0.0, end)
    a_x, a_y = ((velocity[1] - velocity[0]) / across[:, None]).T
    yaw = _at(result, result.pose[:, 2], t)[:, 0]
    rate = _at(result, result.twist[:, 2], t)[:, 0]
    draw = rng.standard_normal((3, len(t)))
    return _channel("/imu/data", stamps, ns, {
        "yaw_rate": rate + bias + noise.gyro * draw[0],
        "ax": np.cos(yaw) * a_x + np.sin(yaw) * a_y + noise.acceleration * draw[1],
        "ay": np.cos(yaw) * a_y - np.sin(yaw) * a_x + noise.acceleration * draw[2],
    })  # fmt: skip


def _points(robot: Robot, result: Rollout, noise: Noise, rng: np.random.Generator, end: float, ns: int) -> Channel:
    t, stamps = _times(rng, noise.station_rate, end, noise.jitter)
    white = noise.station * rng.standard_normal((len(t), 2))
    error = white.copy()
    for k in range(1, len(t)):
        error[k] = noise.colour * error[k - 1] + np.sqrt(1.0 - noise.colour**2) * white[k]
    errors = sensor_errors(robot)
    pose = _at(result, result.pose, np.maximum(t - errors.delay, 0.0))
    point = tracked_point(errors, pose) + error
    kept = rng.random(len(t)) >= noise.lost
    columns = {"x": point[kept, 0], "y": point[kept, 1], "z": np.zeros(int(kept.sum()))}
    if noise.heading is None:
        return _channel("/total_station/point", stamps[kept], ns, columns)
    heading = pose[:, 2] + errors.heading + noise.heading * rng.standard_normal(len(t))
    return _channel("/ground_truth/odom", stamps[kept], ns, columns | {"yaw": heading[kept]})
