"""A logger around the project's own simulator: it polls, holds, is late, has clocks of its own, loses messages.

``python -m estimation.logger N SEED`` (with ``test`` on the path) prints how often flaws were found and invented.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from artibot_sim.estimation.checks.comparisons import Finding
from artibot_sim.estimation.checks.findings import ACCELERATIONS, RATES, findings
from artibot_sim.experiment import Channel, Experiment
from artibot_sim.identify.synthetic import random_soil
from artibot_sim.model import Commands, Robot, load_robot, rollout
from artibot_sim.model.robot.environment import STANDARD_GRAVITY

STREAMS = ("motor_torques", "ground_truth_odom", "imu")
START = 1_000_000_000


@dataclass(frozen=True)
class Logger:
    """What becomes of a drive on its way into a recording.

    Attributes
    ----------
    polled : float
        Hz at which the newest message of every topic is copied; 0 for a recorder that writes each message.
    rates : mapping of str to float
        Hz of the sensors' messages.
    delays : mapping of str to float
        s by which stamps are late.
    jitter : mapping of str to float
        s by which stamps scatter, with heavy tails.
    skew : mapping of str to float
        By how much a stream's clock is fast, s per s.
    quantum : float
        s to which stamps are rounded.
    lost : float
        Share of messages that never arrive.
    flaws : frozenset of str
        `side_swap`, `reversed_wheel`, `gyro_flip`, `gyro_axis`, `pose_flip` (its heading), `y_flip`, `frame_flip`
        (both), `pose_leap`, `lost_place` (a localisation that is lost for 15 s), `rpm`, `set_points`, `in_air`.
    gyro_bias : float
    mount : (float, float) or None
        Roll and pitch of the IMU in the robot, rad; None for one without an accelerometer, and level.
    """

    polled: float = 20.0
    rates: Mapping[str, float] = field(
        default_factory=lambda: {"motor_torques": 30.0, "ground_truth_odom": 18.0, "imu": 50.0, "joint_states": 40.0}
    )
    delays: Mapping[str, float] = field(default_factory=dict)
    skew: Mapping[str, float] = field(default_factory=dict)
    jitter: Mapping[str, float] = field(default_factory=dict)
    quantum: float = 0.001
    lost: float = 0.01
    flaws: frozenset[str] = frozenset()
    gyro_bias: float = 0.0
    mount: tuple[float, float] | None = None


@dataclass(frozen=True)
class Drive:
    """What a robot did, 100 times a second.

    Wheel speeds (n, 2), commands (n, 2), pose (n, 3), yaw rate (n,); of an articulated one speeds of the back motors
    (n, 2) and its angle (n,).
    """

    t: np.ndarray
    speed: np.ndarray
    command: np.ndarray
    pose: np.ndarray
    rate: np.ndarray
    back: np.ndarray | None = None
    bend: np.ndarray | None = None


def drive(robot: Robot, rng: np.random.Generator, duration: float = 90.0, ground: Sequence[Robot] = ()) -> Drive:
    """Random speeds of both sides, others every 4 s; the motors follow with a lag of 0.15 s and a ripple.

    Parameters
    ----------
    ground : sequence of Robot, optional
        The robot on other soils, one after the other for an equal part of the time.
    """
    count = round(duration / 0.01)
    rim = robot.wheel.r_w * robot.drive.front.tau
    fast = min(1.0, 6.0 * robot.wheel.r_w)
    slowest, most = (0.2, 0.2) if robot.articulated else (-0.5, 0.35)  # backwards, or in its tracks, a joint folds
    both = rng.uniform(slowest * fast, fast, count // 400 + 1)
    apart = rng.uniform(-most * fast, most * fast, count // 400 + 1)
    asked = np.repeat(np.column_stack([both + apart, both - apart]), 400, axis=0)[:count] / rim
    asked[:100] = 0.0
    speed, now = np.empty_like(asked), np.zeros(2)
    for i, wanted in enumerate(asked):
        now = now + np.clip(0.01 / 0.15 * (wanted - now), -0.02 * fast / rim, 0.02 * fast / rim)
        speed[i] = now
    table = np.column_stack([speed, np.full_like(speed, np.nan)])  # back motors are under eq. 30's torque
    t = np.arange(count) * 0.01
    at = _moved(ground or [robot], table, t)
    joint = (np.column_stack(at[5:]), at[4]) if robot.articulated else ()
    return Drive(t, speed, asked, np.column_stack(at[:3]), at[3], *joint)


def _moved(ground: Sequence[Robot], table: np.ndarray, t: np.ndarray) -> list[np.ndarray]:
    """What a robot did at `t` that goes on from one soil to the next, column by column.

    x, y, yaw and yaw rate; of an articulated one its angle and the speeds of its back motors.
    """
    borders = np.round(np.linspace(0, len(table) - 1, len(ground) + 1)).astype(int)
    state, rows = None, []
    for robot, a, b in zip(ground, borders[:-1], borders[1:], strict=True):
        run = rollout(robot, Commands(0.01, table[a : b + 1]), state=state)
        state = run.final_state
        joint = [run.articulation_yaw, run.motor_velocity[:, 2:]] if robot.articulated else []
        rows.append(np.column_stack([t[a] + (run.t - run.t[0]), run.pose, run.twist[:, 2], *joint])[bool(rows) :])
    every = np.vstack(rows)
    return [np.interp(t, every[:, 0], column) for column in every.T[1:]]


def recorded(of: Drive, logger: Logger, rng: np.random.Generator, heading: bool = True) -> Experiment:
    """The recording of a drive."""
    noise = rng.standard_normal
    speed, pose, rate = of.speed.copy(), of.pose.copy(), of.rate + logger.gyro_bias
    if "in_air" in logger.flaws:
        pose[:], rate = 0.0, 0.0 * rate + logger.gyro_bias
    if "set_points" in logger.flaws:
        speed = of.command.copy()
    if "side_swap" in logger.flaws:
        speed = speed[:, ::-1]
    if "reversed_wheel" in logger.flaws:
        speed = speed * [-1.0, 1.0]
    if "rpm" in logger.flaws:
        speed = speed * 60.0 / (2.0 * np.pi)
    if {"pose_flip", "frame_flip"} & logger.flaws:
        pose[:, 2] *= -1.0
    if {"y_flip", "frame_flip"} & logger.flaws:
        pose[:, 1] *= -1.0
    if "another_time" in logger.flaws:
        pose = np.roll(pose, len(pose) // 3, axis=0)
    if "pose_leap" in logger.flaws:
        pose[of.t > 0.6 * of.t[-1], 0] += 3.0
    if "lost_place" in logger.flaws:
        lost = (of.t > 0.3 * of.t[-1]) & (of.t < 0.3 * of.t[-1] + 15.0)
        pose[lost, :2] += np.repeat(3.0 * noise((lost.sum() // 30 + 1, 2)), 30, axis=0)[: lost.sum()]
    if "gyro_flip" in logger.flaws:
        rate = -rate
    z = np.zeros_like(rate)
    axes = {"roll_rate": z, "pitch_rate": z, "yaw_rate": rate}
    if "gyro_axis" in logger.flaws:
        axes = {"roll_rate": rate, "pitch_rate": z, "yaw_rate": z}
    forces = {}
    if logger.mount is not None:
        axes, forces = _mounted(of, rate, logger.mount)
    ripple = 0.0 if "set_points" in logger.flaws else 0.02 * float(np.abs(speed).max())
    truth = {
        "motor_torques": {"front_right.velocity": (speed[:, 0], ripple), "front_left.velocity": (speed[:, 1], ripple)},
        "ground_truth_odom": {"x": (pose[:, 0], 0.01), "y": (pose[:, 1], 0.01)}
        | ({"yaw": (pose[:, 2], 0.005)} if heading else {}),
        "imu": {name: (values, 0.01) for name, values in axes.items()}
        | {name: (values, 0.3) for name, values in forces.items()},
    }
    if of.back is not None and of.bend is not None:
        sides = {f"back_{side}.velocity": (of.back[:, i], ripple) for i, side in enumerate(("right", "left"))}
        truth["motor_torques"] |= sides
        truth["joint_states"] = {"articulation_yaw.position": (of.bend, 0.002)}
    channels = {}
    for key, columns in truth.items():
        stamps, values = _messages(of.t, columns, logger, key, noise, rng)
        channels[key] = Channel("/" + key, START + np.round(stamps * 1e9).astype(np.int64), stamps, START + np.round(
            stamps * 1e9).astype(np.int64), values)  # fmt: skip
    asked = {f"front_{side}.velocity": of.command[::5, i] for i, side in enumerate(("right", "left"))}
    ns = START + np.round(of.t[::5] * 1e9).astype(np.int64)
    channels["motor_command"] = Channel("/motor_command", ns, of.t[::5], ns, asked)
    end = max(float(channel.t[-1]) for channel in channels.values())
    return Experiment("logged", Path("logged"), {}, START, channels, ((0.0, end),))


def _mounted(of: Drive, rate: np.ndarray, mount: tuple[float, float]) -> tuple[dict, dict]:
    """Rates and specific force, by name, in the axes of an IMU that is turned by roll and pitch."""
    speed = np.gradient(of.pose[:, :2], of.t, axis=0)
    ax, ay = np.gradient(speed, of.t, axis=0).T
    c, s = np.cos(of.pose[:, 2]), np.sin(of.pose[:, 2])
    force = np.column_stack([c * ax + s * ay, c * ay - s * ax, np.full(len(of.t), STANDARD_GRAVITY)])
    turned = Rotation.from_euler("xy", mount)
    rates = turned.apply(np.column_stack([0.0 * rate, 0.0 * rate, rate]), inverse=True)
    felt = turned.apply(force, inverse=True)
    return dict(zip(RATES, rates.T, strict=True)), dict(zip(ACCELERATIONS, felt.T, strict=True))


def _messages(t, columns, logger, key, noise, rng):
    """Stamps and values of one topic as recorded."""
    measured = np.arange(float(rng.uniform(0.5, 0.6)), t[-1] - 2.0, 1.0 / logger.rates[key])
    measured = measured[rng.random(len(measured)) >= logger.lost]
    values = {name: np.interp(measured, t, c) + sd * noise(len(measured)) for name, (c, sd) in columns.items()}
    stamped = (measured + logger.delays.get(key, 0.0)) * (1.0 + logger.skew.get(key, 0.0))
    if key in logger.jitter:
        # a message is written when it is there: those that overtake others are sorted with their values
        stamped = stamped + logger.jitter[key] * rng.standard_t(4.0, len(stamped))
        order = np.argsort(stamped)
        stamped, values = stamped[order], {name: c[order] for name, c in values.items()}
    if not logger.polled:
        stamps = np.round(stamped / logger.quantum) * logger.quantum
        new = np.concatenate(([True], np.diff(stamps) > 0))
        return stamps[new], {name: c[new] for name, c in values.items()}
    polls = np.arange(np.ceil(stamped[0] * logger.polled), stamped[-1] * logger.polled) / logger.polled  # all topics'
    newest = np.searchsorted(stamped, polls, side="right") - 1
    stamps = np.round(polls / logger.quantum) * logger.quantum
    return stamps, {name: c[newest] for name, c in values.items()}


ROBOTS = ("husky_driven", "warthog", "husky", "agriq")


def robot_of(rng: np.random.Generator, of: Sequence[str] = ROBOTS) -> Robot:
    """A rigid or an articulated robot on random soil."""
    return random_soil(load_robot(str(rng.choice(of))), rng, 0.08)


FLAWS = {
    "none": Logger(),
    "rotation_delay": Logger(delays={"motor_torques": 0.2}),
    "gyro_delay": Logger(delays={"imu": 0.15}),
    "articulation_delay": Logger(delays={"joint_states": 0.2}),
    "pose_delay": Logger(delays={"ground_truth_odom": 0.25}),
    "pose_early": Logger(delays={"ground_truth_odom": -0.15}),
    "clock_skew": Logger(skew={"ground_truth_odom": 2e-3}, polled=0.0),
    "held_samples": Logger(rates={"motor_torques": 5.0, "ground_truth_odom": 18.0, "imu": 50.0, "joint_states": 40.0}),
    **{name: Logger(flaws=frozenset({name}))
       for name in ("gyro_flip", "gyro_axis", "pose_flip", "y_flip", "frame_flip", "side_swap", "reversed_wheel",
                    "pose_leap", "lost_place", "set_points", "in_air")},
    "unrelated_pose": Logger(flaws=frozenset({"another_time"})),
    "wheel_units": Logger(flaws=frozenset({"rpm"})),
    "gyro_bias": Logger(gyro_bias=0.05),
    "imu_tilt": Logger(mount=(0.05, -0.15)),
    "imu_turned": Logger(mount=(0.5 * np.pi, 0.0)),
}  # fmt: skip
"""Name → logger that makes it, of a plain size."""
WANTED = {
    "pose_early": "pose_delay", "imu_turned": "imu_tilt", "y_flip": "pose_flip", "frame_flip": "pose_flip",
    "lost_place": "pose_leap",
}  # fmt: skip
BESIDE = {
    "none": {"held_samples"}, "imu_turned": {"gyro_axis"}, "clock_skew": {"pose_delay"},
    "set_points": {"rotation_delay", "pose_delay"}, "unrelated_pose": {"pose_leap"},
}  # fmt: skip
"""What may be found as well: set-points are earlier than what the motors make of them."""


def trial(name: str, seed: int, clean: Logger | None = None) -> tuple[Robot, Experiment, list[Finding]]:
    """One recording with a flaw, and what is found in it."""
    rng = np.random.default_rng([seed, *name.encode()])
    robot = robot_of(rng, ("agriq", "epiq") if name == "articulation_delay" else ROBOTS)
    logger = FLAWS[name]
    if name == "none":
        logger = clean or Logger(float(rng.choice([0.0, 20.0])), lost=float(rng.uniform(0.0, 0.05)), mount=(0.0, 0.0))
    elif name not in ("clock_skew", "held_samples"):
        logger = replace(logger, polled=float(rng.choice([0.0, 20.0])))
    experiment = recorded(drive(robot, rng), logger, rng)
    return robot, experiment, findings(experiment, robot)


def age(logger: Logger, key: str, polled: float) -> float:
    """How old a stream's values are in the mean when a poll first sees them, s."""
    return 0.5 * min(1.0 / polled, 1.0 / logger.rates[key]) if polled else 0.0


def size_is_right(name: str, found: Finding) -> bool:
    """Whether a delay is within 10 ms of the truth or its interval holds it: the delay, and what polling adds to it."""
    logger = FLAWS[name]
    if not logger.delays:
        return True
    ((late, truth),) = logger.delays.items()
    truths = [
        truth + age(logger, late, polled) - age(logger, other, polled)
        for polled in (0.0, 20.0) for other in STREAMS if other != late
    ]  # fmt: skip
    low, high = found.interval
    return any(abs(found.value - x) <= 0.01 or low <= x <= high for x in truths)


if __name__ == "__main__":
    count, seed = int(sys.argv[1]), int(sys.argv[2])
    only = sys.argv[3:] or list(FLAWS)
    for name in only:
        right, sized, invented = 0, 0, Counter()
        for k in range(count):
            wanted = WANTED.get(name, name)
            _, _, found = trial(name, seed + k)
            mine = [one for one in found if one.name == wanted]
            right += bool(mine) if name != "none" else not [f for f in found if f.name not in BESIDE["none"]]
            sized += bool(mine) and size_is_right(name, mine[0])
            invented.update(f.name for f in found if f.name not in {wanted, "held_samples", *BESIDE.get(name, ())})
        print(f"{name:16} {right}/{count} found, {sized} sizes right; beside it {dict(invented)}", flush=True)
