"""The motors behind simulated drives: those of the model, or flywheels on a bench. No ROS in here.

The drives' velocity and torque loops are stiff, so they are integrated inside the model's step: a motor whose drive
asks for a speed is `Mode.DRIVEN` with the drive's torque limit, one whose drive asks for a torque `Mode.TORQUE`, one
without current `Mode.TORQUE` with none.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Protocol

import numpy as np

from artibot_driver.simulated.motion import FREE, InertialShaft, Shaft, ShaftCommand, ShaftState
from artibot_sim.errors import ArtibotError
from artibot_sim.model import MOTORS, Ground, Robot, Status, initial_state
from artibot_sim.model.kernels.layout import MOTOR_COORDINATES
from artibot_sim.model.simulate.sensors import sensor_errors
from artibot_sim.model.simulate.stepper import MotorCommand, Stepper
from artibot_sim.nodes.sim.engine import Array, Diverged, Periods, StartPose, TrueState, gravity_of, sample_of
from artibot_sim.nodes.sim.sensors import SensorModel, SimulatedSensors

LONGEST_SLICE_NS = 2_000_000
"""Drives and motors exchange at the ends of such slices: what a frame finds is older by so much at most."""

_MOTORS = np.array(MOTOR_COORDINATES)


class Plant(Protocol):
    """The motors of a set of drives and what they move."""

    @property
    def shafts(self) -> Mapping[str, Shaft]:
        """Motor → what its drive sees of it."""

    @property
    def slice_ns(self) -> int:
        """Time between two exchanges."""

    def advance(self, slices: int) -> None:
        """Turn on for so many slices, under what the drives ask for now."""


class ModelShaft:
    """One motor of the model as its drive sees it.

    Over a slice the velocity loop's set-point goes from what was asked for the slice before to what is asked now: it
    has no steps, and its slope is the acceleration that the loop feeds forward.

    Parameters
    ----------
    measured : callable
        What is measured at the end of the last slice.
    """

    def __init__(self, measured: Callable[[], ShaftState]) -> None:
        self.asked = FREE
        self._before: float | None = None
        self._measured = measured

    def command(self, command: ShaftCommand) -> None:
        """Take a set-point."""
        self.asked = command

    def state(self) -> ShaftState:
        """What was measured at the end of the last slice."""
        return self._measured()

    def command_of_slice(self) -> MotorCommand:
        """The set-point of the model's motor for the next slice."""
        asked = self.asked
        if asked.velocity is None:
            self._before = None
            return MotorCommand(None, asked.torque or 0.0, asked.torque_limit)
        first = asked.velocity if self._before is None else self._before
        self._before = asked.velocity
        return MotorCommand((first, asked.velocity), 0.0, asked.torque_limit)


class RoverShafts:
    """The rover of the model, turned by its drives.

    Parameters
    ----------
    robot : Robot
        An articulated one: it needs four motors.
    timing : Periods
        Of the publications; the slices divide their period.
    start : StartPose
    integrator : str
    sensors : SimulatedSensors, optional
        What is wrong with the speeds and torques that the drives measure; what the robot's effects say by default.
        Positions are counted by the drives.
    ground : Ground, optional
        Uneven ground; flat by default.
    """

    def __init__(
        self, robot: Robot, timing: Periods, start: StartPose, integrator: str = "rk4",
        sensors: SimulatedSensors | None = None, ground: Ground | None = None,
    ) -> None:  # fmt: skip
        if not robot.articulated:
            raise ArtibotError(f"robot '{robot.name}': is rigid and has two motors; expected a robot with four drives")
        self.robot, self.timing, self.start = robot, timing, start
        self._steps = steps_of_a_slice(timing)
        self.slice_ns = self._steps * timing.dt_ns
        self._initial = initial_state(robot, start.x, start.y, start.yaw, start.articulation_yaw, ground=ground)
        self._stepper = Stepper(
            robot, dt=timing.dt_ns * 1e-9, integrator=integrator, state=self._initial, ground=ground
        )
        self._sensors = sensors or SimulatedSensors(SensorModel(), 0, sensor_errors(robot))
        self._motors = tuple(ModelShaft(partial(self._seen, motor)) for motor in range(len(MOTORS)))
        self.shafts: Mapping[str, Shaft] = dict(zip(MOTORS, self._motors, strict=True))
        self._counted = np.zeros(4)
        self._readings: tuple[ShaftState, ...] | None = None
        self._gravity = gravity_of(robot)
        self._v_last = self._stepper.v.copy()

    def warm_up(self) -> None:
        """Compile or load the kernel, so that the first slice is like all others."""
        self.advance(1)
        self._put(np.zeros(4))

    def advance(self, slices: int) -> None:
        """Turn on for so many slices.

        Raises
        ------
        Diverged
            When the model cannot go on; the state is left as it was.
        """
        right, left, back_right, back_left = (motor.command_of_slice() for motor in self._motors)
        turns = (right, left, back_right, back_left)
        if self._stepper.advance(slices * self._steps, turns) is not Status.OK:
            raise Diverged(self._stepper.message)
        self._readings = None

    def sample(self) -> TrueState:
        """The truth now; call it once a period."""
        stepper = self._stepper
        specific_force = (stepper.v[:3] - self._v_last[:3]) / (self.timing.period_ns * 1e-9) - self._gravity
        self._v_last = stepper.v.copy()
        asked = [math.nan if motor.asked.velocity is None else motor.asked.velocity for motor in self._motors[:2]]
        return sample_of(
            self.robot, stepper.q.copy(), self._v_last, stepper.torque.copy(), specific_force, (asked[0], asked[1])
        )

    def reset(self) -> None:
        """Back to the start, at rest. The encoders count on: only the rover was moved, by somebody's hands."""
        self._put(self._counted + self._stepper.q[_MOTORS])

    @property
    def pose(self) -> tuple[float, float, float]:
        """Where the front module is, in `map`: x, y (m) and yaw (rad)."""
        q = self._stepper.q
        return float(q[0]), float(q[1]), float(q[5])

    def _put(self, counted: Array) -> None:
        self._counted = counted
        self._stepper.state = self._initial
        self._v_last = self._stepper.v.copy()
        self._readings = None

    def _seen(self, motor: int) -> ShaftState:
        """What a drive sees of its motor: all four are measured when the first is asked for after a slice."""
        if self._readings is None:
            self._readings = self._measured()
        return self._readings[motor]

    def _measured(self) -> tuple[ShaftState, ...]:
        velocity, torque = self._stepper.v[_MOTORS], self._stepper.torque
        position = self._sensors.turned(self._counted + self._stepper.q[_MOTORS])
        velocity = self._sensors.velocities(round(1e9 * self._stepper.t), velocity)
        torque = self._sensors.torques(torque)
        values = zip(position.tolist(), velocity.tolist(), torque.tolist(), strict=True)
        return tuple(ShaftState(*each) for each in values)


class Flywheels:
    """Four flywheels on a bench, each on its own: for a driver without a rover."""

    def __init__(self) -> None:
        self.slice_ns = LONGEST_SLICE_NS
        self._wheels = {motor: InertialShaft() for motor in MOTORS}
        self.shafts: Mapping[str, Shaft] = dict(self._wheels)

    def advance(self, slices: int) -> None:
        """Turn on for so many slices."""
        for wheel in self._wheels.values():
            wheel.advance(slices * self.slice_ns * 1e-9)


def steps_of_a_slice(timing: Periods) -> int:
    """Integration steps between two exchanges: as many as fit into 2 ms and divide the publish period.

    Raises
    ------
    ArtibotError
        When a single step is longer.
    """
    steps = timing.period_ns // timing.dt_ns
    most = LONGEST_SLICE_NS // timing.dt_ns
    if most < 1:
        raise ArtibotError(
            f"dt: {timing.dt_ns * 1e-9:g} s is too long with drives, which are to find motors where they were 2 ms ago "
            "at most: expected at most 0.002 s"
        )
    return next(n for n in range(most, 0, -1) if steps % n == 0)
