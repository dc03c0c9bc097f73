"""What a simulation of a recording is fed with: motor rotations or commands, and a start state."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment.columns import Channel, Experiment, Floats
from artibot_sim.experiment.measured import MeasuredMotion
from artibot_sim.experiment.smoothing import STAMP, bridge, fit_around_kinks, fresh, hermite, local_fit, smoothed
from artibot_sim.model import MOTORS, Commands, Ground, Mode, Robot, Rollout, State, initial_state
from artibot_sim.model.robot.parameters import SensorErrors
from artibot_sim.model.simulate.commands import as_executed
from artibot_sim.model.simulate.rollout import default_modes, motor_coordinates
from artibot_sim.model.simulate.sensors import low_passed, sensor_errors, tracked_point, true_starts
from artibot_sim.model.simulate.window_inputs import behind

# ----------------------------------------------------------------------
# What turns the motors when a recording is simulated again: measured rotations, or recorded commands.
# ----------------------------------------------------------------------


HALF_WIDTH = 0.04
"""s around each instant whose encoder positions give angle and speed there."""
GAP = 0.5
"""Silence of a command, s, after which the motor is taken to have been told to stand."""
_KNOT = 0.01
"""s between knots of the inputs."""
MOTOR_GAP = 0.2
"""s without a motor sample through which no prediction runs."""
_SHORTEST = 0.5
"""s that motors are measured without a gap at least, for a prediction."""


def unbroken(times: Floats) -> list[tuple[float, float]]:
    """Spans (s) of the motors' stamps without a gap of MOTOR_GAP, however short."""
    if len(times) < 4:
        return []
    gap = max(MOTOR_GAP, 4.0 * float(np.median(np.diff(times))))
    breaks = np.flatnonzero(np.diff(times) > gap)
    firsts, lasts = np.concatenate(([0], breaks + 1)), np.concatenate((breaks, [len(times) - 1]))
    return [(float(times[a]), float(times[b])) for a, b in zip(firsts, lasts, strict=True)]


def is_stretch(span: tuple[float, float]) -> bool:
    """Whether a span (s) is long enough to be predicted."""
    return span[1] - span[0] > _SHORTEST


@dataclass(frozen=True)
class MotorInputs:
    """Inputs of all motors over one stretch of a recording.

    Attributes
    ----------
    t : (n,) knots, s, `dt` apart.
    dt : s.
    position, velocity : (n, 4) rad, rad/s, motor-side; NaN columns for motors without. A column each of `Robot.motors`.
    torque : (n, 4) N·m, held from its knot on; NaN for eq. 30. Of motors that turn as measured it is what was measured,
        smoothed, which says between which efficiencies to choose; NaN where nothing was.
    modes : of the motors.
    measured_position, measured_velocity : (n, 4) what the encoders say, for start states; NaN where nothing is known.
    from_speeds : whether nothing but its speed was recorded of a motor; none by default.
    """

    t: Floats
    dt: float
    position: Floats
    velocity: Floats
    torque: Floats
    modes: tuple[Mode, ...]
    measured_position: Floats
    measured_velocity: Floats
    from_speeds: tuple[bool, ...] = ()

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
    position, velocity = np.full((2, len(t), len(robot.motors)), np.nan)
    for i, motor in enumerate(_motors(robot)):
        found = _rotation(motors, motor, t, t_start, t_end, half_width)
        if found is not None:
            position[:, i], velocity[:, i] = found
        elif i < 2:
            raise ArtibotError(
                f"{experiment.path}: topic {motors.topic} has neither position nor velocity of {motor}; it has "
                f"{', '.join(motors.columns) or 'nothing'}; name the wheels with --joint {motor}=FOUND[,FOUND] "
                "(only `replay --resimulate commands` does without)"
            )
    turned = np.isfinite(velocity).all(axis=0)
    torque = np.full_like(velocity, np.nan)
    for i, motor in enumerate(robot.motors):
        by = _smoothed if turned[i] else _held
        torque[:, i] = by(motors, f"{motor}.effort", t)
    modes = tuple(Mode.PRESCRIBED if given else Mode.TORQUE for given in turned)
    return MotorInputs(t, _KNOT, position, velocity, torque, modes, position, velocity, _from_speeds(motors, robot))


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
    velocity = np.full((len(t), len(robot.motors)), np.nan)
    for i, name in enumerate(names):
        velocity[:, i] = _commanded(*channel.series(name), t)
    torque = np.full_like(velocity, np.nan)
    if robot.articulated and _by_effort(experiment, channel, back):
        for i, motor in enumerate(robot.motors[2:], 2):
            torque[:, i] = _held(channel, f"{motor}.effort", t)
    measured = np.full((2, len(t), len(robot.motors)), np.nan)
    motors = experiment.channels.get("motor_torques")
    for i, motor in enumerate(_motors(robot)):
        found = _rotation(motors, motor, t, t_start, t_end) if motors else None
        if found is not None:
            measured[:, :, i] = found
    position = np.full_like(velocity, np.nan)
    mean = 0.5 * (velocity[1:, :2] + velocity[:-1, :2])
    position[:, :2] = np.vstack([np.zeros((1, 2)), np.cumsum(dt * mean, axis=0)])
    modes = default_modes(robot)  # front motors that an effect limits are driven
    return MotorInputs(t, dt, position, velocity, torque, modes, measured[0], measured[1], _from_speeds(motors, robot))


def _from_speeds(motors: Channel | None, robot: Robot) -> tuple[bool, ...]:
    """Of which motors nothing but the speed is recorded."""
    recorded = motors.columns if motors is not None else {}
    alone = [f"{motor}.velocity" in recorded and f"{motor}.position" not in recorded for motor in _motors(robot)]
    return (*alone, *(False for _ in robot.motors[len(alone) :]))


def _motors(robot: Robot) -> tuple[str, ...]:
    """The motors there are: a rigid robot's back ones are names only."""
    return robot.motors if robot.articulated else robot.motors[:2]


def _knots(t_start: float, t_end: float, dt: float) -> Floats:
    """Return knots from `t_start` to the first one not before `t_end`."""
    count = max(2, int(np.ceil((t_end - t_start) / dt - 1e-6)) + 1)
    return np.asarray(t_start + dt * np.arange(count), float)


def _by_effort(experiment: Experiment, channel: Channel, back: str) -> bool:
    recorded = all(f"{motor}.effort" in channel for motor in MOTORS[2:])
    if back == "effort" and not recorded:
        raise ArtibotError(
            f"{experiment.path}: topic {channel.topic} has no back efforts; it has "
            f"{', '.join(channel.columns) or 'nothing'}; "
            "leave them to eq. 30 with --back kappa"
        )
    return recorded and (back == "effort" or (back == "auto" and "kappa" not in experiment.metadata))


def _rotation(
    motors: Channel, motor: str, t: Floats, t_start: float, t_end: float, half_width: float = HALF_WIDTH
) -> tuple[Floats, Floats] | None:
    """Return angle and speed (n,) of one motor at knots, or None if it is not recorded there."""
    margin = 0.5 + STAMP  # s of neighbours beyond a stretch, never those of another segment, which is further off
    for quantity in ("position", "velocity"):
        name = f"{motor}.{quantity}"
        if name not in motors:
            continue
        times, values = motors.series(name)
        used = fresh(values) & (times >= t_start - margin) & (times <= t_end + margin)
        times, values = times[used], values[used]
        if len(times) > 3:
            if quantity == "position":
                return _from_positions(times, values, t, half_width)
            return _integrated(times, values, t)
    return None


def _from_positions(times: Floats, values: Floats, t: Floats, half_width: float) -> tuple[Floats, Floats]:
    value, rate = fit_around_kinks(times, values, t, half_width)
    value, rate = value[:, None], rate[:, None]
    spacing = float(np.median(np.diff(times)))
    value, rate = bridge(times, t, value, rate, max(0.1, 4.0 * spacing))
    return value[:, 0], rate[:, 0]


def _integrated(times: Floats, values: Floats, t: Floats) -> tuple[Floats, Floats]:
    """Return the integral of recorded speeds, smoothed as far as these allow, and the speeds.

    A wheel that all but breaks away does so in the model wherever the noise of its speed is on the wrong side.
    """
    speed = np.interp(t, times, smoothed(times, values))
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


def _smoothed(channel: Channel, name: str, t: Floats) -> Floats:
    """Return values at knots by lines fitted over as long as rotations; NaN where nothing is recorded."""
    if name not in channel:
        return np.full(len(t), np.nan)
    times, values = channel.series(name)
    new = fresh(values)
    times, values = times[new], values[new]
    found = np.full(len(t), np.nan)
    if len(times) > 3:
        near = np.abs(times[np.clip(np.searchsorted(times, t), 0, len(times) - 1)] - t) <= GAP
        found[near] = local_fit(times, values, t[near], HALF_WIDTH, 1)[0]
    return found


# ----------------------------------------------------------------------
# A simulation as its robot's sensors record it, and measurements as the model takes them: see `model.sensors`.
# ----------------------------------------------------------------------


def recorded_motors(result: Rollout, robot: Robot) -> tuple[Floats, Floats, Floats]:
    """Return motor positions, velocities and torques (n, 4) as recorded, rad, rad/s, N·m."""
    errors = sensor_errors(robot)
    turned, pulled = errors.encoder_scale, errors.torque_scale
    speed = low_passed(result.t, result.motor_velocity, errors.velocity_filter)
    return turned * result.motor_position, turned * speed, pulled * result.motor_torque


def recorded_point(result: Rollout, robot: Robot) -> dict[str, Floats]:
    """Return the columns of a total station that sees the tracked point; before the start it stood still."""
    errors = sensor_errors(robot)
    t, coordinates = result.t, [0, 1, 5]
    at = np.clip(t - errors.delay, t[0], t[-1])
    i = np.clip(np.searchsorted(t, at, side="right") - 1, 0, max(len(t) - 2, 0))
    j = np.minimum(i + 1, len(t) - 1)
    pose, rate = result.q[:, coordinates], result.v[:, coordinates]
    late = hermite(t[i], t[j], pose[i], pose[j], rate[i], rate[j], at)[0] if len(t) > 1 else pose
    point = tracked_point(errors, late)
    return {"x": point[:, 0], "y": point[:, 1], "z": np.interp(at, t, result["z_f"])}


def tracks_origin(errors: SensorErrors) -> bool:
    """Whether the tracked pose is the front module's own, at once."""
    return errors.arm_x == errors.arm_y == errors.delay == errors.heading == 0.0


def true_motion(errors: SensorErrors, motion: MeasuredMotion, late: bool) -> MeasuredMotion:
    """The rover's own motion where sensors with errors measured `motion`, its heading as late as positions or not."""
    if errors._replace(encoder_scale=1.0, torque_scale=1.0) == SensorErrors():
        return motion
    x, y, yaw, vx, vy, rate = np.nan_to_num(np.array(motion[:6], float)).tolist()
    c, s = np.cos(yaw), np.sin(yaw)
    start = np.array([[x, y, yaw, c * vx + s * vy, c * vy - s * vx, rate]])
    x, y, yaw, forward, left, rate = true_starts(np.array([errors]), start, np.array([late]))[0].tolist()
    c, s = np.cos(yaw), np.sin(yaw)
    true = MeasuredMotion(x, y, yaw, c * forward - s * left, s * forward + c * left, rate, *motion[6:])
    return MeasuredMotion(*(float("nan") if np.isnan(old) else new for old, new in zip(motion, true, strict=True)))


def true_inputs(inputs: MotorInputs, errors: SensorErrors, recorded: bool) -> MotorInputs:
    """What turns the motors, from encoders and torques with errors: all of it if `recorded`, else the start alone."""
    trailing = errors.velocity_filter if any(inputs.from_speeds) else 0.0
    if errors.encoder_scale == errors.torque_scale == 1.0 and not trailing:
        return inputs

    def true(angle: Floats, speed: Floats) -> tuple[Floats, Floats]:
        if trailing:
            late = trailing * behind(speed, inputs.dt, inputs.from_speeds)
            angle, speed = angle + late[:, : angle.shape[1]], speed + late[:, angle.shape[1] :]
        return angle / errors.encoder_scale, speed / errors.encoder_scale

    angle, speed = true(inputs.measured_position, inputs.measured_velocity)
    start = replace(inputs, measured_position=angle, measured_velocity=speed)
    if not recorded:
        return start
    angle, speed = true(inputs.position, inputs.velocity)
    return replace(start, position=angle, velocity=speed, torque=inputs.torque / errors.torque_scale)


def executed_inputs(inputs: MotorInputs, robot: Robot) -> MotorInputs:
    """Inputs from commands at the end of their way to the front motors: delayed, lagging, without what is too small."""
    given = Commands(inputs.dt, inputs.velocity, position=inputs.position, t0=float(inputs.t[0]))
    followed = as_executed(robot, given)
    if followed is given:
        return inputs
    return replace(inputs, velocity=followed.velocity, position=followed.position)


def recorded_efforts(experiment: Experiment, t: float, names: tuple[str, ...] = MOTORS) -> Floats:
    """Return the recorded torques of these motors nearest to `t`, N·m; NaN where none is recorded."""
    motors = experiment.channels.get("motor_torques")
    efforts = np.full(len(names), np.nan)
    if motors is not None:
        row = int(np.argmin(np.abs(motors.t - t)))
        for i, motor in enumerate(names):
            if f"{motor}.effort" in motors:
                efforts[i] = motors[f"{motor}.effort"][row]
    return efforts


# ----------------------------------------------------------------------
# A state of the model from measurements.
# ----------------------------------------------------------------------


_STILL = 0.05
"""rad/s: a motor whose smoothed speed is less stands."""
_OVER = 0.1
"""How much faster than its wheels say a rigid rover may be measured to move, as a share of their speed."""


def plausible_motion(robot: Robot, motion: MeasuredMotion, speeds: Floats) -> MeasuredMotion:
    """A measured motion (NaN is unknown) as a simulation can start from it.

    A rover whose motors stand, stands. Velocities that could not be measured are those of rolling; the articulation
    stays unknown. A rigid rover moves no faster than its wheels make it: its velocities are mostly differences of
    poses, and where those jump (6 m/s, 8 rad/s have been seen) nothing could be predicted from them.

    Parameters
    ----------
    robot : Robot
    motion : MeasuredMotion
    speeds : array, shape (4,)
        Of the motors as their encoders show them, rad/s; NaN where there is none.
    """
    if (np.abs(speeds[np.isfinite(speeds)]) < _STILL).all():
        motion = motion._replace(vx=0.0, vy=0.0, yaw_rate=0.0, articulation_rate=0.0)
    rims = np.nan_to_num(speeds[:2]) * robot.drive.front.tau * robot.wheel.r_w
    forward, yaw = float(rims.mean()), float(np.nan_to_num(motion.yaw))
    if not np.isfinite([motion.vx, motion.vy]).all():
        motion = motion._replace(vx=forward * np.cos(yaw), vy=forward * np.sin(yaw))
    motion = motion._replace(yaw=yaw, yaw_rate=float(np.nan_to_num(motion.yaw_rate)))
    return motion if robot.articulated else _driven(robot, motion, rims)


def _driven(robot: Robot, motion: MeasuredMotion, rims: Floats) -> MeasuredMotion:
    """A rigid rover's motion within what the speeds (m/s) of its right and left rims allow."""
    c, s = np.cos(motion.yaw), np.sin(motion.yaw)
    over = _OVER * float(np.abs(rims).max())
    turn = float(rims[0] - rims[1]) / robot.front.i_y
    rate = float(np.clip(motion.yaw_rate, min(turn, 0.0) - over, max(turn, 0.0) + over))
    forward = float(np.clip(c * motion.vx + s * motion.vy, rims.min() - over, rims.max() + over))
    aside = 0.5 * robot.front.i_x * abs(rate) + over
    left = float(np.clip(c * motion.vy - s * motion.vx, -aside, aside))
    return motion._replace(vx=c * forward - s * left, vy=s * forward + c * left, yaw_rate=rate)


def start_state(
    robot: Robot, motion: MeasuredMotion, position: Floats, velocity: Floats, torque: Floats | None = None,
    t: float = 0.0, behind: Floats | None = None, ground: Ground | None = None,
) -> State:  # fmt: skip
    """Return a rover that moves as measured, on its wheels at static equilibrium.

    Parameters
    ----------
    robot : whose state it is.
    motion : of the front module in `map`; what is NaN counts as 0.
    position, velocity : (4,) motors, rad and rad/s; a speed that is NaN is that of rolling without slip.
    torque : (4,) N·m of the motors just before, which eq. 30 feeds back; NaN or None counts as 0.
    t : s.
    behind : (2, joints) angles and rates of the joints behind the first, rad and rad/s; straight if None.
    ground : uneven ground; flat if None.

    Raises
    ------
    ArtibotError
        If the joint cannot be closed at the measured articulation.
    """
    x, y, yaw, vx, vy, yaw_rate, bend, bend_rate = np.nan_to_num(np.array(motion, float), nan=0.0).tolist()
    angles, rates = np.zeros((2, len(robot.trailing))) if behind is None else np.nan_to_num(behind)
    bends, bend_rates = [bend, *angles.tolist()], [bend_rate, *rates.tolist()]
    state = initial_state(
        robot, x=x, y=y, yaw=yaw, articulation_yaw=bends if robot.articulated else 0.0, t=t, ground=ground
    )
    q, v = state.q.copy(), state.v.copy()
    v[[0, 1, 5]] = vx, vy, yaw_rate
    for j, (hitch, module) in enumerate(zip(robot.hitches, robot.modules[1:], strict=True)):
        k, before, rate = 8 * j, yaw, yaw_rate
        yaw, yaw_rate = yaw + bends[j], yaw_rate + bend_rates[j]
        # eq. 13 differentiated: both modules' ends of the joint move alike
        v[k + 8] = v[k] + hitch.l * rate * np.sin(before) + module.l * yaw_rate * np.sin(yaw)
        v[k + 9] = v[k + 1] - hitch.l * rate * np.cos(before) - module.l * yaw_rate * np.cos(yaw)
        v[k + 13] = yaw_rate
    for coordinate, speed in _rolling(robot, q, v).items():
        v[coordinate] = speed
    coordinates = motor_coordinates(robot)[: len(_motors(robot))]
    fed_back = np.zeros(len(state.torque))
    for i, coordinate in enumerate(coordinates):
        q[coordinate] = position[i] if np.isfinite(position[i]) else 0.0
        v[coordinate] = velocity[i] if np.isfinite(velocity[i]) else v[coordinate]
    sides = [2 * (c // 8) + c % 2 for c in motor_coordinates(robot)]
    if torque is not None:
        fed_back[sides] = np.nan_to_num(torque, nan=0.0)
    return replace(state, q=q, v=v, torque=fed_back)


def _rolling(robot: Robot, q: Floats, v: Floats) -> dict[int, float]:
    """Return the speeds of motors whose wheels roll without slip, rad/s, by their coordinates.

    Those of a passive module are the wheels' own.
    """
    speeds = {}
    for k, (module, drive) in enumerate(zip(robot.modules, robot.drives, strict=True)):
        yaw, rate = q[8 * k + 5], v[8 * k + 5]
        forward = np.cos(yaw) * v[8 * k] + np.sin(yaw) * v[8 * k + 1]
        for side, sign in enumerate((1.0, -1.0)):  # right, left
            tau = 1.0 if drive is None else drive.tau
            speeds[8 * k + 6 + side] = (forward + sign * rate * module.i_y / 2) / (robot.wheel.r_w * tau)
    return speeds
