"""The simulated rover between two publications: state, integer time, and one rollout a period."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from artibot_sim.errors import ArtibotError
from artibot_sim.model import Commands, Ground, Mode, Robot, Rollout, State, Status, initial_state
from artibot_sim.model.effects import has_memory
from artibot_sim.model.robot.derived import front_params
from artibot_sim.model.simulate.commands import CommandChain, travelled
from artibot_sim.model.simulate.motion import joint_motion, velocities
from artibot_sim.model.simulate.rollout import (
    RolloutSetup,
    default_modes,
    motor_coordinates,
    prepare,
    side_gears,
    simulate,
)
from artibot_sim.nodes.common.arbiter import CommandSource, PeriodCommands
from artibot_sim.nodes.common.rotations import rotation

Array = NDArray[np.float64]

KNOT_NS = 10_000_000
"""Longest spacing of the command knots: slower publications do not coarsen the commands."""


@dataclass(frozen=True)
class StartPose:
    """Where the rover starts: pose of the front module in `map` (m, rad) and articulation yaw (rad)."""

    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0
    articulation_yaw: float = 0.0


@dataclass(frozen=True)
class Periods:
    """Periods in integer nanoseconds: of publication, of the command knots, of integration.

    Attributes
    ----------
    period_ns : int
        Between two publications; a whole number of knots.
    knots : int
        Command intervals in a period.
    dt_ns : int
        Integration step; a knot interval is a whole number of steps.
    """

    period_ns: int
    knots: int
    dt_ns: int

    @property
    def knot_ns(self) -> int:
        """Spacing of the command knots."""
        return self.period_ns // self.knots

    @classmethod
    def of(cls, publish_rate: float, dt: float) -> Periods:
        """From a rate (Hz) and a step (s).

        Raises
        ------
        ArtibotError
            When the step does not divide the period.
        """
        period_ns, dt_ns = round(1e9 / publish_rate), round(dt * 1e9)
        if dt_ns < 1 or period_ns % dt_ns:
            raise ArtibotError(
                f"dt: {dt:g} s does not divide the publish period 1/{publish_rate:g} s = {period_ns * 1e-9:.9g} s; "
                "expected a period of a whole number of steps, such as dt 0.001 with publish_rate 100"
            )
        steps = period_ns // dt_ns
        knots = next(n for n in range(math.ceil(period_ns / KNOT_NS), steps + 1) if steps % n == 0)
        return cls(period_ns, knots, dt_ns)


@dataclass(frozen=True)
class TrueState:
    """The truth at one instant: shapes (4,) by MOTORS (by `Robot.motors`); map frame unless said otherwise.

    Attributes
    ----------
    position, rpy : array, shape (3,)
        Front module's origin (m), roll, pitch and yaw (rad).
    twist : tuple of 3 floats
        As seen from above, along its heading: forward, left (m/s) and yaw rate (rad/s).
    velocity, rates : array, shape (3,)
        In its own frame, which rolls and pitches with it: of its origin (m/s) and angular (rad/s).
    specific_force : array, shape (3,)
        Specific force (m/s²), the mean over the last period: acceleration less gravity.
    motor_position, motor_velocity, motor_torque : array, shape (4,)
        Motor-side, rad, rad/s, N·m.
    articulation : array, shape (2, 2)
        Yaw and roll (rad); their rates (rad/s). Two columns a joint.
    command : tuple of 2 floats
        Front motors' commanded velocities at this instant, rad/s.
    wheels : array, shape (2, sides), or None
        Angles and rates of the wheels on each side of all modules, wheel-side, rad and rad/s; known of a robot with
        passive modules.
    """

    position: Array
    rpy: Array
    twist: tuple[float, float, float]
    velocity: Array
    rates: Array
    specific_force: Array
    motor_position: Array
    motor_velocity: Array
    motor_torque: Array
    articulation: Array
    command: tuple[float, float]
    wheels: Array | None = None

    @property
    def attitude(self) -> Array:
        """Rotation from the front module's frame to `map`, shape (3, 3)."""
        return rotation(*self.rpy.tolist())

    @property
    def acceleration(self) -> Array:
        """What an accelerometer in the front module feels, in its frame (m/s², shape (3,))."""
        return self.attitude.T @ self.specific_force


class Diverged(Exception):
    """The model has left the range in which it means anything; the message says when and what."""


class Engine:
    """A rover that is stepped from one publication to the next.

    Parameters
    ----------
    robot : Robot
    timing : Periods
    start : StartPose
    integrator : str
        ``"rk4"`` or ``"semi_implicit"``.
    driven : bool
        Front motors driven by a velocity loop with limited torque, instead of prescribed; so they are in any case
        where an effect limits them.
    ground : Ground, optional
        Uneven ground; flat by default.
    """

    def __init__(
        self, robot: Robot, timing: Periods, start: StartPose, integrator: str = "rk4", driven: bool = False,
        ground: Ground | None = None,
    ) -> None:  # fmt: skip
        self.robot, self.ground = robot, ground
        self.timing = timing
        self.start = start
        self.integrator = integrator
        front = Mode.DRIVEN if driven else default_modes(robot)[0]
        self.modes = (front, front, *default_modes(robot)[2:])
        self._gravity = gravity_of(robot)
        self._initial = initial_state(robot, start.x, start.y, start.yaw, start.articulation_yaw, ground=ground)
        self.state: State = self._initial
        self._v_last = self.state.v
        self._chain: CommandChain | None = None
        self._setup: RolloutSetup | None = None

    def warm_up(self) -> None:
        """Compile or load the kernel, so that the first period is like all others."""
        still = ((0.0, 0.0),) * (self.timing.knots + 1)
        self.step(PeriodCommands(still, still, (math.nan, math.nan), CommandSource.NONE), self.robot.control.kappa)
        self.reset()

    def reset(self) -> None:
        """Back to the start, at rest."""
        self.state = self._initial
        self._v_last = self.state.v
        self._chain = None

    @property
    def front_position(self) -> tuple[float, float]:
        """Angles of the front motors, right and left, rad."""
        return float(self.state.q[6]), float(self.state.q[7])

    def step(self, decision: PeriodCommands, kappa: float) -> TrueState:
        """The truth now, under these commands; the state then is that of the period's end.

        Raises
        ------
        Diverged
            When the period cannot be computed; the state is left as it was.
        """
        dt, every = self.timing.dt_ns * 1e-9, self.timing.period_ns // self.timing.dt_ns
        setup = self._prepared(self._commands(decision), kappa)
        result = simulate(setup, dt, self.integrator, every, energy=False)
        if result.status is not Status.OK:
            raise Diverged(result.message)
        sample = self._sample(result, decision)
        self._v_last, self.state = self.state.v, result.final_state
        return sample

    def _prepared(self, commands: Commands, kappa: float) -> RolloutSetup:
        """A period as `rollout` prepares it: once for all, but where the step's limit depends on the commands."""
        setup, duration = self._setup, self.timing.period_ns * 1e-9
        if setup is None or setup.kappa != kappa or has_memory(self.robot.effects):
            every = self.timing.period_ns // self.timing.dt_ns
            setup = self._setup = prepare(
                self.robot, commands, self.timing.dt_ns * 1e-9, self.integrator, every, self.modes, kappa, self.state,
                duration, self.ground,
            )  # fmt: skip
        return setup._replace(commands=commands, start=self.state)

    def _commands(self, decision: PeriodCommands) -> Commands:
        n = len(decision.velocity)
        velocity, position, torque = (np.full((n, 4), np.nan) for _ in range(3))
        velocity[:, :2], position[:, :2] = self._executed(np.array(decision.velocity), np.array(decision.position))
        torque[:, 2:] = decision.effort
        return Commands(self.timing.knot_ns * 1e-9, velocity, position=position, torque=torque, t0=self.state.t)

    def _executed(self, speeds: Array, angles: Array) -> tuple[Array, Array]:
        """What the front motors follow through a period, shape (n, 2): speeds and angles after the way to them."""
        h = self.timing.knot_ns * 1e-9
        if self._chain is None:
            self._chain, self._angles = CommandChain(self.robot, h, speeds[0]), angles[0]
        if not self._chain:
            return speeds, angles
        followed = np.vstack([self._chain.now, self._chain.follow(speeds[1:])])
        turned = np.vstack([self._angles, self._angles + travelled(followed, h)])
        self._angles = turned[-1]
        return followed, turned

    def _sample(self, result: Rollout, decision: PeriodCommands) -> TrueState:
        """Row 0 of the period: its torques are those that act from this instant on, as in one long rollout."""
        q, v = result.q[0], result.v[0]
        specific_force = (v[:3] - self._v_last[:3]) / (self.timing.period_ns * 1e-9) - self._gravity
        return sample_of(self.robot, q, v, result.motor_torque[0], specific_force, decision.velocity[0])


def sample_of(
    robot: Robot, q: Array, v: Array, torque: Array, specific_force: Array, command: tuple[float, float]
) -> TrueState:
    """The sample of a state (q, v), both of shape (16,), under motor torques (4,); it keeps views of the arrays."""
    motors, passive = motor_coordinates(robot), None in robot.drive.trailing
    yaw = float(q[5])
    velocity, rates = velocities(q, v)
    c, s, (x, y, *_, rate) = math.cos(yaw), math.sin(yaw), v[:6].tolist()
    return TrueState(
        position=q[:3],
        rpy=q[3:6],
        twist=(c * x + s * y, c * y - s * x, rate),
        velocity=velocity,
        rates=rates,
        specific_force=specific_force,
        motor_position=q[motors],
        motor_velocity=v[motors],
        motor_torque=torque,
        articulation=np.array(joint_motion(q, v)) if robot.articulated else np.zeros((2, 2)),
        wheels=np.array([q, v]).reshape(2, -1, 8)[:, :, 6:].reshape(2, -1) * side_gears(robot) if passive else None,
        command=command,
    )


def gravity_of(robot: Robot) -> Array:
    """Gravity in `map`, m/s², shape (3,): tilted on a slope."""
    p = front_params(robot)
    return np.array([p.g_x, p.g_y, p.g_z])
