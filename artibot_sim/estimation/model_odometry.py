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
from artibot_sim.estimation.odometry import PoseError, Slip, diagonal, metres_per_radian
from artibot_sim.exchange.turning import placeless
from artibot_sim.model import Commands, Mode, Robot, State, initial_state
from artibot_sim.model.kernels.layout import MOTOR_COORDINATES
from artibot_sim.model.simulate.rollout import INTEGRATORS, Status, prepare
from artibot_sim.model.simulate.sensors import sensor_errors
from artibot_sim.model.simulate.stepper import PrescribedStepper

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
_STANDING = (0.0,) * 4
"""rad/s of four motors."""
_MOTORS = list(MOTOR_COORDINATES)
_BACK = 1.0
"""s by which stamps must fall back for a clock that was set back, or a recording that begins again."""


@dataclass(frozen=True)
class StreamProperties:
    """What is known of the measurements.

    Attributes
    ----------
    rotation_delay, gyro_delay, articulation_delay : by which rotations, yaw rates and joint angles are stamped late, s.
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
    articulation_delay: float = 0.0
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
        self._position, self._speed = [math.nan] * motors, [math.nan] * motors

    def take(
        self, t: float, position: Sequence[float], velocity: Sequence[float]
    ) -> tuple[float, list[float], bool] | None:
        """Return the time since the last sample, mean speeds (n) over it (rad/s), and whether they are known.

        None where the sample says nothing new: held, late, or without a number. A motor that says nothing while others
        do keeps its speed.
        """
        where = self._padded(position)
        speed = [v if abs(v) <= self._fastest else math.nan for v in self._padded(velocity)]
        if all(value != value for value in (*where, *speed)):
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
        short = elapsed <= self._streams.longest_gap
        rate, between = self._rates(elapsed, where), self._mean_speed(elapsed, speed)
        for motor, (r, v) in enumerate(zip(rate, between, strict=True)):
            if abs(r) > self._fastest or (short and abs(r - v) > _UNLIKE * self._fastest):
                rate[motor] = math.inf
        if math.inf in rate:
            self.remark("jump of a rotation")
        known = short or (math.isfinite(rate[0]) and math.isfinite(rate[1]))
        if not known:
            self.remark("gap")
        mean = [next(filter(math.isfinite, pair), 0.0) for pair in zip(rate, between, strict=True)]
        self._remember(t, where, [m if v != v else v for v, m in zip(speed, mean, strict=True)])
        return elapsed, mean, known

    def _padded(self, values: Sequence[float]) -> list[float]:
        """A number for each motor; NaN where there is none."""
        given = [value if math.isfinite(value) else math.nan for value in values[: self._n]]
        return given + [math.nan] * (self._n - len(given))

    def _rates(self, elapsed: float, where: list[float]) -> list[float]:
        return [(new - old) / elapsed for new, old in zip(where, self._position, strict=True)]

    def _mean_speed(self, elapsed: float, speed: list[float]) -> list[float]:
        """Of the speeds at both ends, of one where the other is not known; a robot does not go on over a gap."""
        if elapsed > self._streams.longest_gap:
            return [0.0] * self._n
        pairs = ((old, old if new != new else new) for old, new in zip(self._speed, speed, strict=True))
        return [0.5 * ((new if old != old else old) + new) for old, new in pairs]

    def _is_held(self, elapsed: float, where: list[float], speed: list[float]) -> bool:
        if elapsed >= self._streams.longest_hold or not any(v != 0.0 for v in self._speed if v == v):
            return False
        same = all(new == old or (new != new and old != old) for new, old in zip(where, self._position, strict=True))
        return same and [0.0 if v != v else v for v in speed] == [0.0 if v != v else v for v in self._speed]

    def _remember(self, t: float, where: list[float], speed: list[float]) -> None:
        self._t, self._position, self._speed = t, where, speed

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
        self._slip_sensed = replace(self._slip, turn=self._streams.gyro_scale)
        self._scale = errors.encoder_scale
        self._gyro_sign = -1.0 if robot.sensors.gyro_flip else 1.0
        fitted = "gyro_bias" in robot.effects
        bias = errors.gyro_bias if fitted else self._gyro_sign * robot.sensors.gyro_bias
        self.gyro = Gyroscope(self._streams, bias)
        motors = 4 if robot.articulated else 2
        tau = [robot.drive.front.tau] * 2 + [(robot.drive.back or robot.drive.front).tau] * 2
        self._tau, self._metres = tau, metres_per_radian(self.robot)
        self._rotations = Rotations(motors, self._streams.fastest_wheel / min(tau), self._streams)
        self._begun = False
        self._models = {
            seen: _stepper(self.robot, seen, self._kappa, self._streams.fastest_wheel) for seen in (False, True)
        }
        self._model = self._models[not robot.articulated]
        self.reset(0.0, 0.0, 0.0)

    @property
    def remarks(self) -> dict[str, int]:
        """What was left out, and how often."""
        return self._rotations.remarks

    def reset(self, x: float, y: float, yaw: float) -> None:
        """Believe this pose (m, rad) for certain, and go on from the motion that was."""
        self.pose, self.twist, self.t = (x, y, yaw), (0.0, 0.0, 0.0), getattr(self, "t", None)
        self._error = PoseError(self._slip, self.robot.front.i_y)
        self._restart(None, _STANDING)

    def settle(self) -> None:
        """Believe to be at the origin for certain; the motion under way goes on, unlike after `reset`."""
        self.pose = (0.0, 0.0, 0.0)
        self._error = PoseError(self._slip, self.robot.front.i_y)

    def _restart(self, articulation: float | None, speeds: Sequence[float]) -> None:
        """Put the model on its wheels anew, its motors turning at these speeds.

        Parameters
        ----------
        articulation : float or None
            Where it was measured, rad; else the model takes up what these speeds lead to.
        speeds : sequence of four
            rad/s, motor-side.
        """
        metres, track = self._metres, self.robot.front.i_y
        articulated = self.robot.articulated
        state = initial_state(self.robot, articulation_yaw=(articulation or 0.0) if articulated else 0.0)
        v = state.v.copy()
        if articulation is None:
            v[0] = 0.5 * metres * (speeds[0] + speeds[1])
            v[8] = v[0] if articulated else 0.0
            v[_MOTORS] = speeds if articulated else [*speeds[:2], 0.0, 0.0]
            if not articulated:
                v[5] = _SKID * metres * (speeds[0] - speeds[1]) / track
        self._model.state = State(state.t, state.q, v, state.eta, state.torque)
        self._still_for, self._speeds = 0.0, speeds
        if articulation is None and any(speeds):
            self._turn(_TAKE_UP, speeds)  # speeds that are met under way have long led to a steady motion

    def take_gyro(self, t: float, rate: float) -> None:
        """Take a yaw rate of the front module (rad/s), stamped `t` s; the robot file knows of one upside down."""
        self.gyro.take(t - self._streams.gyro_delay, self._gyro_sign * rate, self._still_for > _SETTLED)

    def take_articulation(self, angle: float) -> None:
        """Take a measured articulation (rad): a model that has left it behind is put there."""
        if not self.robot.articulated or not math.isfinite(angle):
            return
        q, v = self._model.q, self._model.v
        angle += self._streams.articulation_delay * (v[13] - v[5])  # where it is by now
        if abs(math.remainder(q[13] - q[5] - angle, math.tau)) > 0.1:
            self._rotations.remark("articulation taken from its sensor")
            self._restart(angle, self._speeds)

    def update(self, t: float, position: Sequence[float] = (), velocity: Sequence[float] = ()) -> bool:
        """Go on by motor positions (rad) and speeds (rad/s), motor-side in the order of MOTORS, stamped `t` s.

        Either may be empty, shorter, or hold NaN. Returns whether the pose has gone on.
        """
        position, velocity = ([value / self._scale for value in values] for values in (position, velocity))
        if self._model is not self._models[True] and any(map(_four, (position, velocity))):
            self._models[True].state = self._model.state
            self._model = self._models[True]
        found = self._rotations.take(t - self._streams.rotation_delay, position, velocity)
        if self.t is None:
            self.t = t - self._streams.rotation_delay
        if found is None:
            return False
        elapsed, speeds, known = found
        speeds = [*speeds, *_STANDING][:4]
        if not self._begun:
            self._begun = True
            self._restart(None, speeds)
        self.t = t - self._streams.rotation_delay
        begin = self.t - elapsed
        if not known:
            self._skip(begin, elapsed, speeds)
            return True
        forward, left, turn = self._moved(elapsed, speeds)
        self._go(begin, elapsed, speeds, (forward, left, turn))
        return True

    def _moved(self, elapsed: float, speeds: Sequence[float]) -> tuple[float, float, float]:
        """Turn the model's motors for `elapsed` s; return its motion in the frame it began in (m, m, rad)."""
        wheel = max(abs(speed) * tau for speed, tau in zip(speeds, self._tau, strict=True))
        self._still_for = self._still_for + elapsed if wheel < _STILL else 0.0
        if self._still_for > _SETTLED:
            self.twist = (0.0, 0.0, 0.0)
            self._speeds = _STANDING
            self._restart_at_rest()
            return 0.0, 0.0, 0.0
        first = self._model.q
        if not self._turn(elapsed, speeds):
            self._rotations.remark("slice that the model could not follow")
            self._restart(None, speeds)
            return (
                0.5 * self._metres * elapsed * (speeds[0] + speeds[1]),
                0.0,
                _SKID * self._metres * elapsed * (speeds[0] - speeds[1]) / self.robot.front.i_y,
            )
        x, y, _, _, _, yaw, *_ = first.tolist()
        new_x, new_y, _, _, _, new_yaw, *_ = self._model.q.tolist()
        vx, vy, _, _, _, rate, *_ = self._model.v.tolist()
        c, s, ahead, aside = math.cos(yaw), math.sin(yaw), math.cos(new_yaw), math.sin(new_yaw)
        self.twist = (ahead * vx + aside * vy, ahead * vy - aside * vx, rate)
        dx, dy = new_x - x, new_y - y
        return c * dx + s * dy, c * dy - s * dx, new_yaw - yaw

    def _turn(self, elapsed: float, speeds: Sequence[float]) -> bool:
        """Turn the model's motors for `elapsed` s from the speeds before to these; say whether it could follow.

        The change of speeds is within the first slice.
        """
        slices = max(1, round(elapsed / SLICE))
        width = elapsed / slices
        angle = self._model.q[_MOTORS].tolist()
        angles = [
            angle,
            [a + 0.5 * width * (old + new) for a, old, new in zip(angle, self._speeds, speeds, strict=True)],
        ]
        for _ in range(slices - 1):
            angles.append([a + width * speed for a, speed in zip(angles[-1], speeds, strict=True)])
        velocity, position = np.array([self._speeds, *[speeds] * slices]), np.array(angles)
        self._speeds = speeds
        return self._model.turn(width, velocity, position) is Status.OK

    def _restart_at_rest(self) -> None:
        still, q = self._still_for, self._model.q
        if self._model.v.any():
            self._restart(float(q[13] - q[5]) if self.robot.articulated else 0.0, _STANDING)
        self._still_for = still

    def _go(self, begin: float, elapsed: float, speeds: Sequence[float], motion: tuple[float, float, float]) -> None:
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
        rolled = max(abs(speeds[0]), abs(speeds[1])) * self._metres * elapsed
        error.slip = self._slip_sensed if sensed else self._slip
        error.drift = self.gyro.deviation if sensed else 0.0
        if rolled > 0.0 and self._still_for <= _SETTLED:
            error.spread(dx, dy, turn, rolled, elapsed if sensed else 0.0)
            if sensed:
                error.wander(self._streams.gyro_noise**2 * elapsed)
            else:
                error.sides_slip(rolled)
        self.pose = (x + dx, y + dy, yaw + turn)

    def _skip(self, begin: float, elapsed: float, speeds: Sequence[float]) -> None:
        """Nothing is known of the time between: the robot may have gone on, or have stopped."""
        assert self.t is not None
        reach = max(abs(self.twist[0]), max(map(abs, self._speeds[:2])) * self._metres)
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
        late = self._streams.timing
        return self._error.covariance_with(
            (late * (c * forward - s * left), late * (s * forward + c * left), late * rate)
        )

    @property
    def twist_covariance(self) -> Array:
        """Of the velocities forward and to the left and of the yaw rate, shape (3, 3), diagonal."""
        slip, (speed, _, rate) = self._error.slip, self.twist
        turned = math.hypot(slip.turn * rate, self._error.drift)
        if not self._error.drift:
            turned = math.hypot(turned, 2.0 * slip.travel * speed / self.robot.front.i_y)
        return diagonal(slip.travel * speed, slip.side * speed, turned)


def _four(values: Sequence[float]) -> bool:
    """Whether these are of four motors, those behind being numbers."""
    return len(values) == 4 and math.isfinite(values[2]) and math.isfinite(values[3])


def _stepper(robot: Robot, back_seen: bool, kappa: float | None, fastest: float) -> PrescribedStepper:
    """Return the robot's model with the longest of `STEPS` with which it can be integrated, explicitly if any.

    It is checked once, for any command up to the fastest wheel, and not for each message. Motors behind whose rotations
    are not measured share the front ones' torque, and their spin wants shorter steps.
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
        return PrescribedStepper(setup, integrator, step)
    raise AssertionError
