"""Odometry that knows how its robot slips: measured rotations drive the identified model, which says where that leads.

Wheels that roll without slip turn a skid-steered robot by far too much. The model knows the forces between wheels and
ground, and so what is left of a commanded turn, also while speeds change. A gyroscope, where there is one, says how far
the robot turned; the model then says where it went meanwhile.

Streams are taken as robots have them: samples that a logger held, gaps, NaN, counters that are reset. What cannot be
trusted is left out, and the covariance grows by what may have happened instead.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from artibot_sim.errors import ArtibotError
from artibot_sim.estimation.odometry import FLOOR, PoseError, Slip, metres_per_radian
from artibot_sim.exchange.turning import placeless
from artibot_sim.model import Commands, Mode, Robot, State, initial_state
from artibot_sim.model.simulate.rollout import INTEGRATORS, RolloutSetup, Status, prepare, simulate
from artibot_sim.model.simulate.sensors import sensor_errors

Array = NDArray[np.float64]

SLICE = 0.01
"""s: rotations are given to the model as speeds at knots so far apart."""
STEPS = (2.5e-3, 1e-3, 5e-4)
"""s: steps of the integration, the first that is stable for the robot is taken."""
_UNLIKE = 0.1
"""Of the fastest wheel's speed: a rotation that differs so much from the speeds measured beside it is a jump."""
_STILL = 0.02
"""Wheels that turn slower (rad/s, wheel-side) stand."""
_SKID = 0.5
"""Of the yaw rate of wheels without slip: from it a rigid robot's model begins, and goes on where it fails."""
_TAKE_UP = 0.6
"""s in which a model that is put on its wheels takes up the motion that its motors lead to."""
_SETTLED = 0.5
"""s that wheels must have stood before the gyroscope is believed to show its bias."""


_BACK = 1.0
"""s by which stamps must fall back for a clock that was set back, or a recording that begins again."""


@dataclass(frozen=True)
class StreamProperties:
    """What is known of the measurements.

    Attributes
    ----------
    rotation_delay, gyro_delay : by which rotations and yaw rates are stamped late, s.
    timing : standard deviation of stamps, s: so much sooner or later the pose may be that of its stamp.
    longest_hold : s that equal samples in a row are taken for one that a logger held; then the wheels stand.
    longest_gap : s without rotations after which the robot's motion between is not known.
    fastest_wheel : rad/s, wheel-side; a rotation that asks for more is a jump of the counter.
    bias : standard deviation of the gyroscope's bias before the robot was ever seen at rest, rad/s.
    gyro_noise : of a yaw rate, rad/s per root Hz.
    gyro_scale : relative error of angles from the gyroscope.
    """

    rotation_delay: float = 0.0
    gyro_delay: float = 0.0
    timing: float = 0.01
    longest_hold: float = 0.3
    longest_gap: float = 0.5
    fastest_wheel: float = 60.0
    bias: float = 0.01
    gyro_noise: float = 0.002
    gyro_scale: float = 0.005


class Rotations:
    """Angles of the motors since the beginning, from positions and speeds as they come.

    Parameters
    ----------
    motors : int
    fastest : float
        rad/s, motor-side.
    streams : StreamProperties

    Attributes
    ----------
    remarks : dict
        What was left out, and how often.
    """

    def __init__(self, motors: int, fastest: float, streams: StreamProperties) -> None:
        self._n, self._fastest, self._streams = motors, fastest, streams
        self.remarks: dict[str, int] = {}
        self._t: float | None = None
        self._position, self._speed = np.full(motors, math.nan), np.full(motors, math.nan)
        self._known = np.zeros(motors, dtype=bool)

    def take(self, t: float, position: Sequence[float], velocity: Sequence[float]) -> tuple[float, Array, bool] | None:
        """Return the time since the last sample, mean speeds (n,) over it (rad/s), and whether they are known.

        None where the sample says nothing new: held, late, or without a number. A motor that says nothing while others
        do keeps its speed.
        """
        where, speed = self._padded(position), self._padded(velocity)
        speed[np.abs(speed) > self._fastest] = math.nan
        if not (np.isfinite(where) | np.isfinite(speed)).any():
            self.remark("sample without a number")
            return None
        if self._t is None:
            self._remember(t, where, speed)
            return None
        elapsed = t - self._t
        if elapsed < -_BACK:
            self.remark("time that went back")
            self._remember(t, where, speed)
            return None
        if elapsed <= 0.0:
            self.remark("sample not later than the one before")
            return None
        if self._is_held(elapsed, where, speed):
            self.remark("held sample")
            return None
        rate, between = (where - self._position) / elapsed, self._mean_speed(elapsed, speed)
        jumped = np.abs(rate) > self._fastest
        if elapsed <= self._streams.longest_gap:
            jumped |= np.abs(rate - between) > _UNLIKE * self._fastest
        if jumped.any():
            self.remark("jump of a rotation")
        rate[jumped] = math.nan
        mean = np.where(np.isfinite(rate), rate, between)
        known = elapsed <= self._streams.longest_gap or bool(np.isfinite(rate[:2]).all())
        if not known:
            self.remark("gap")
        mean = np.where(np.isfinite(mean), mean, 0.0)
        self._remember(t, where, np.where(np.isfinite(speed), speed, mean))
        return elapsed, mean, known

    def _padded(self, values: Sequence[float]) -> Array:
        found = np.full(self._n, math.nan)
        given = np.asarray(values, dtype=float)[: self._n]
        found[: len(given)] = np.where(np.isfinite(given), given, math.nan)
        return found

    def _mean_speed(self, elapsed: float, speed: Array) -> Array:
        """Of the speeds at both ends; over a gap the robot is not taken to have gone on."""
        if elapsed > self._streams.longest_gap:
            return np.zeros(self._n)
        before = np.where(np.isfinite(self._speed), self._speed, speed)
        return 0.5 * (before + np.where(np.isfinite(speed), speed, before))

    def _is_held(self, elapsed: float, where: Array, speed: Array) -> bool:
        same = np.array_equal(where, self._position, equal_nan=True)
        same = same and np.array_equal(np.nan_to_num(speed), np.nan_to_num(self._speed))
        moving = bool(np.nanmax(np.abs(self._speed), initial=0.0) > 0.0)
        return same and moving and elapsed < self._streams.longest_hold

    def _remember(self, t: float, where: Array, speed: Array) -> None:
        self._t = t
        self._position = where
        self._speed = speed

    def remark(self, text: str) -> None:
        """Count what was left out."""
        self.remarks[text] = self.remarks.get(text, 0) + 1


class Gyroscope:
    """Turned angles from yaw rates, and their bias from standstills.

    Parameters
    ----------
    streams : StreamProperties
    bias : float
        To begin with, rad/s.

    Attributes
    ----------
    bias, deviation : rad/s
    """

    def __init__(self, streams: StreamProperties, bias: float) -> None:
        self._streams, self.bias, self.deviation = streams, bias, streams.bias
        self._samples: deque[tuple[float, float]] = deque(maxlen=2000)

    def take(self, t: float, rate: float, still: bool) -> None:
        """Take a yaw rate (rad/s); `still` where the robot stands."""
        if self._samples and t < self._samples[-1][0] - _BACK:
            self._samples.clear()
        if not math.isfinite(rate) or (self._samples and t <= self._samples[-1][0]):
            return
        dt = t - self._samples[-1][0] if self._samples else 0.0
        self._samples.append((t, rate))
        if still and 0.0 < dt < self._streams.longest_gap and abs(rate - self.bias) < 5.0 * self._streams.bias:
            noise = self._streams.gyro_noise**2 / dt
            gain = self.deviation**2 / (self.deviation**2 + noise)
            self.bias += gain * (rate - self.bias)
            # a bias wanders: it is never known better than to a hundredth of what it may be
            self.deviation = max(math.sqrt(1.0 - gain) * self.deviation, 0.01 * self._streams.bias)

    def turned(self, begin: float, end: float) -> float:
        """Return the angle turned between two instants, rad; NaN where the samples do not reach."""
        while len(self._samples) > 2 and self._samples[1][0] <= begin:
            self._samples.popleft()
        reach = self._streams.longest_gap / 2.0
        if len(self._samples) < 2 or self._samples[0][0] > begin + reach or self._samples[-1][0] < end - reach:
            return math.nan
        t, rate = np.array(self._samples).T
        inside = (t > begin) & (t < end)
        if np.diff(t[(t > begin - reach) & (t < end + reach)], prepend=t[0], append=t[-1])[1:-1].max(initial=0.0) > (
            self._streams.longest_gap
        ):
            return math.nan
        knots = np.concatenate(([begin], t[inside], [end]))
        values = np.interp(knots, t, rate) - self.bias
        return float(np.sum(0.5 * np.diff(knots) * (values[1:] + values[:-1])))


class ModelOdometry:
    """Pose and twist of the front module from rotations, through the model.

    Parameters
    ----------
    robot : Robot
        As identified; effects of a place (a slope, a patch) are left out.
    slip : Slip
        What the model leaves open, relative: of distance, angle and drift to the side.
    streams : StreamProperties
    kappa : float, optional
        Front share of the torque, for back motors whose rotations are not measured; the robot's own by default.

    Attributes
    ----------
    t : s, of the pose; None before the first sample
    pose : (x, y, yaw), m and rad
    twist : (forward, leftward, yaw rate), m/s and rad/s
    gyro : Gyroscope

    Raises
    ------
    ArtibotError
        For a robot of more than two modules.
    """

    SLIP = Slip(0.02, 0.05, 0.03)
    """What a model that was identified well leaves open."""

    def __init__(
        self,
        robot: Robot,
        slip: Slip | None = None,
        streams: StreamProperties | None = None,
        kappa: float | None = None,
    ) -> None:
        if len(robot.modules) > 2:
            raise ArtibotError(
                f"robot '{robot.name}': has {len(robot.modules)} modules; odometry through the model takes one or two"
            )
        errors = sensor_errors(robot)
        self.robot, self._kappa = replace(placeless(robot), name=robot.name), kappa
        self._streams, self._slip = streams or StreamProperties(), slip or self.SLIP
        self._scale = errors.encoder_scale
        self._gyro_sign = -1.0 if robot.sensors.gyro_flip else 1.0
        fitted = "gyro_bias" in robot.effects
        bias = errors.gyro_bias if fitted else self._gyro_sign * robot.sensors.gyro_bias
        self.gyro = Gyroscope(self._streams, bias)
        motors = 4 if robot.articulated else 2
        tau = [robot.drive.front.tau] * 2 + [(robot.drive.back or robot.drive.front).tau] * 2
        self._tau = np.array(tau)
        self._rotations = Rotations(motors, self._streams.fastest_wheel / min(tau), self._streams)
        self._back_seen = self._begun = False
        self._ways = {
            seen: _step_choice(self.robot, seen, self._kappa, self._streams.fastest_wheel) for seen in (False, True)
        }
        self.reset(0.0, 0.0, 0.0)

    @property
    def remarks(self) -> dict[str, int]:
        """What was left out, and how often."""
        return self._rotations.remarks

    def reset(self, x: float, y: float, yaw: float) -> None:
        """Believe this pose (m, rad) for certain, and go on from the motion that was."""
        self.pose, self.twist, self.t = (x, y, yaw), (0.0, 0.0, 0.0), getattr(self, "t", None)
        self._error = PoseError(self._slip, self.robot.front.i_y)
        self._restart(None, np.zeros(4))

    def settle(self) -> None:
        """Believe to be at the origin for certain; the motion under way goes on, unlike after `reset`."""
        self.pose = (0.0, 0.0, 0.0)
        self._error = PoseError(self._slip, self.robot.front.i_y)

    def _restart(self, articulation: float | None, speeds: Array) -> None:
        """Put the model on its wheels anew, its motors turning at these speeds.

        Parameters
        ----------
        articulation : float or None
            Where it was measured, rad; else the model takes up what these speeds lead to.
        speeds : array, shape (4,)
            rad/s, motor-side.
        """
        metres, track = metres_per_radian(self.robot), self.robot.front.i_y
        articulated = self.robot.articulated
        state = initial_state(self.robot, articulation_yaw=(articulation or 0.0) if articulated else 0.0)
        v = state.v.copy()
        if articulation is None:
            v[0] = 0.5 * metres * (speeds[0] + speeds[1])
            v[8] = v[0] if articulated else 0.0
            v[[6, 7, 14, 15]] = speeds if articulated else [*speeds[:2], 0.0, 0.0]
            if not articulated:
                v[5] = _SKID * metres * (speeds[0] - speeds[1]) / track
        self._state = State(state.t, state.q, v, state.eta, state.torque)
        self._still_for, self._speeds = 0.0, speeds.copy()
        if articulation is None and np.abs(speeds).max() > 0.0:
            self._turn(_TAKE_UP, speeds)  # speeds that are met under way have long led to a steady motion

    def take_gyro(self, t: float, rate: float) -> None:
        """Take a yaw rate of the front module (rad/s), stamped `t` s; the robot file knows of one upside down."""
        self.gyro.take(t - self._streams.gyro_delay, self._gyro_sign * rate, self._still_for > _SETTLED)

    def take_articulation(self, angle: float) -> None:
        """Take a measured articulation (rad): a model that has left it behind is put there."""
        if not self.robot.articulated or not math.isfinite(angle):
            return
        q = self._state.q
        if abs(math.remainder(q[13] - q[5] - angle, math.tau)) > 0.1:
            self._rotations.remark("articulation taken from its sensor")
            self._restart(angle, self._speeds)

    def update(self, t: float, position: Sequence[float] = (), velocity: Sequence[float] = ()) -> bool:
        """Go on by motor positions (rad) and speeds (rad/s), motor-side in the order of MOTORS, stamped `t` s.

        Either may be empty, shorter, or hold NaN. Returns whether the pose has gone on.
        """
        scaled = [np.asarray(values, dtype=float) / self._scale for values in (position, velocity)]
        self._back_seen |= any(len(values) == 4 and bool(np.isfinite(values[2:]).all()) for values in scaled)
        found = self._rotations.take(t - self._streams.rotation_delay, scaled[0].tolist(), scaled[1].tolist())
        if self.t is None:
            self.t = t - self._streams.rotation_delay
        if found is None:
            return False
        elapsed, speeds, known = found
        if not self._begun:
            self._begun = True
            self._restart(None, np.concatenate([speeds, np.zeros(4)])[:4])
        self.t = t - self._streams.rotation_delay
        begin = self.t - elapsed
        speeds = np.concatenate([speeds, np.zeros(4)])[:4]
        if not known:
            self._skip(begin, elapsed, speeds)
            return True
        forward, left, turn = self._moved(elapsed, speeds)
        self._go(begin, elapsed, speeds, (forward, left, turn))
        return True

    def _moved(self, elapsed: float, speeds: Array) -> tuple[float, float, float]:
        """Turn the model's motors for `elapsed` s; return its motion in the frame it began in (m, m, rad)."""
        wheel = np.abs(speeds * self._tau).max()
        self._still_for = self._still_for + elapsed if wheel < _STILL else 0.0
        if self._still_for > _SETTLED:
            self.twist = (0.0, 0.0, 0.0)
            self._speeds = np.zeros(4)
            self._restart_at_rest()
            return 0.0, 0.0, 0.0
        first = self._state
        if not self._turn(elapsed, speeds):
            self._rotations.remark("slice that the model could not follow")
            metres = metres_per_radian(self.robot)
            self._restart(None, speeds)
            return (
                0.5 * metres * elapsed * float(speeds[0] + speeds[1]),
                0.0,
                _SKID * metres * elapsed * float(speeds[0] - speeds[1]) / self.robot.front.i_y,
            )
        last = self._state
        dx, dy = (last.q[:2] - first.q[:2]).tolist()
        c, s = math.cos(first.q[5]), math.sin(first.q[5])
        ahead, aside = math.cos(last.q[5]), math.sin(last.q[5])
        vx, vy, rate = last.v[0], last.v[1], last.v[5]
        self.twist = (float(ahead * vx + aside * vy), float(ahead * vy - aside * vx), float(rate))
        return c * dx + s * dy, c * dy - s * dx, float(last.q[5] - first.q[5])

    def _turn(self, elapsed: float, speeds: Array) -> bool:
        """Turn the model's motors for `elapsed` s from the speeds before to these; say whether it could follow."""
        slices = max(1, round(elapsed / SLICE))
        width = elapsed / slices
        way = self._ways[self._back_seen or not self.robot.articulated]
        steps = max(1, math.ceil(width / way.step - 1e-9))
        knots = np.repeat(speeds[None], slices + 1, axis=0)
        knots[0] = self._speeds
        angle = np.concatenate([np.zeros((1, 4)), np.cumsum(0.5 * width * (knots[1:] + knots[:-1]), axis=0)])
        first = self._state
        angle += first.q[[6, 7, 14, 15]]
        origin = State(0.0, first.q, first.v, first.eta, first.torque, first.lateral, first.bristles, first.windup)
        commands = Commands(width, knots, position=angle)
        setup = way.setup._replace(commands=commands, start=origin, steps=slices * steps)
        result = simulate(setup, width / steps, way.integrator, 10**9, energy=False)
        self._speeds = speeds.copy()
        if result.status is not Status.OK or result.final_state is None:
            return False
        self._state = result.final_state
        return True

    def _restart_at_rest(self) -> None:
        still, q = self._still_for, self._state.q
        if np.abs(self._state.v).max() > 0.0:
            self._restart(float(q[13] - q[5]) if self.robot.articulated else 0.0, np.zeros(4))
        self._still_for = still

    def _go(self, begin: float, elapsed: float, speeds: Array, motion: tuple[float, float, float]) -> None:
        """Carry the pose on by a motion in its own frame, with the gyroscope's turn where there is one."""
        forward, left, turn = motion
        assert self.t is not None
        turned, error = self.gyro.turned(begin, self.t), self._error
        sensed = math.isfinite(turned)
        if sensed:
            turn = turned if self._still_for <= _SETTLED else 0.0
            self.twist = (self.twist[0], self.twist[1], turn / elapsed)
        x, y, yaw = self.pose
        middle = yaw + 0.5 * (turn - motion[2])  # the model's own turn is in its motion already
        c, s = math.cos(middle), math.sin(middle)
        dx, dy = c * forward - s * left, s * forward + c * left
        rolled = float(np.abs(speeds[:2]).max()) * metres_per_radian(self.robot) * elapsed
        error.slip = replace(self._slip, turn=self._streams.gyro_scale) if sensed else self._slip
        error.drift = self.gyro.deviation if sensed else 0.0
        if rolled > 0.0 and self._still_for <= _SETTLED:
            error.spread(dx, dy, turn, rolled, elapsed if sensed else 0.0)
            if sensed:
                error.wander(self._streams.gyro_noise**2 * elapsed)
            else:
                error.sides_slip(rolled)
        self.pose = (x + dx, y + dy, yaw + turn)

    def _skip(self, begin: float, elapsed: float, speeds: Array) -> None:
        """Nothing is known of the time between: the robot may have gone on, or have stopped."""
        assert self.t is not None
        reach = max(abs(self.twist[0]), float(np.abs(self._speeds[:2]).max()) * metres_per_radian(self.robot))
        turned = self.gyro.turned(begin, self.t)
        rate = abs(self.twist[2]) + 2.0 * self._slip.travel * reach / self.robot.front.i_y
        self._error.wander(0.0 if math.isfinite(turned) else (rate * elapsed) ** 2, (reach * elapsed) ** 2)
        x, y, yaw = self.pose
        self.pose = (x, y, yaw + turned if math.isfinite(turned) else yaw)
        self._restart(None, speeds)

    @property
    def pose_covariance(self) -> Array:
        """Of x, y and yaw, shape (3, 3)."""
        (forward, left, rate), yaw = self.twist, self.pose[2]
        c, s = math.cos(yaw), math.sin(yaw)
        passed = np.array([c * forward - s * left, s * forward + c * left, rate]) * self._streams.timing
        return self._error.covariance + np.outer(passed, passed)

    @property
    def twist_covariance(self) -> Array:
        """Of the velocities forward and to the left and of the yaw rate, shape (3, 3), diagonal."""
        slip, (speed, _, rate) = self._error.slip, self.twist
        turned = math.hypot(slip.turn * rate, self._error.drift)
        if not self._error.drift:
            turned = math.hypot(turned, 2.0 * slip.travel * speed / self.robot.front.i_y)
        return np.diag(np.square((slip.travel * speed, slip.side * speed, turned)) + np.square(FLOOR))


@dataclass(frozen=True)
class _StepChoice:
    """How the model goes on: checked once, for any command up to the fastest wheel, and not for each message."""

    setup: RolloutSetup
    integrator: str
    step: float


def _step_choice(robot: Robot, back_seen: bool, kappa: float | None, fastest: float) -> _StepChoice:
    """Return the longest of `STEPS` with which the robot's motion can be integrated, explicitly if any.

    Motors behind whose rotations are not measured share the front ones' torque, and their spin wants shorter steps.
    """
    modes = [Mode.PRESCRIBED] * 4 if back_seen or not robot.articulated else None
    tau = np.array([robot.drive.front.tau] * 2 + [(robot.drive.back or robot.drive.front).tau] * 2)
    commands = Commands(SLICE, np.tile(fastest / tau, (2, 1)))
    ways = [(integrator, step) for integrator in INTEGRATORS for step in STEPS]
    for integrator, step in ways:
        try:
            setup = prepare(robot, commands, step, integrator, 10**9, modes, kappa, None, None)
        except ArtibotError:
            if (integrator, step) == ways[-1]:
                raise
            continue
        return _StepChoice(setup, integrator, step)
    raise AssertionError
