"""Between a simulated drive and its motor: set-points in its own units, what is asked of the shaft, what that does."""

from __future__ import annotations

from typing import Final, NamedTuple, Protocol

from artibot_driver.cia402 import HALT, OperationMode
from artibot_driver.scaling import MotorScaling
from artibot_driver.simulated.objects import Objects

# ----------------------------------------------------------------------
# Between a simulated drive and its motor: what the drive asks of the shaft, and what the shaft does.
# ----------------------------------------------------------------------


class ShaftCommand(NamedTuple):
    """What a drive asks of its motor, SI, motor-side, positive forwards.

    At most one of `velocity` (rad/s) and `torque` (N m) is given; with neither the motor is without current. The
    velocity loop belongs to the shaft, for it is stiff; it may use torques up to ±`torque_limit` (N m).
    """

    velocity: float | None
    torque: float | None
    torque_limit: float

    @property
    def is_free(self) -> bool:
        """Whether the motor is without current."""
        return self.velocity is None and self.torque is None


FREE = ShaftCommand(None, None, 0.0)


class ShaftState(NamedTuple):
    """What a motor does: position (rad), velocity (rad/s), torque (N m), positive forwards."""

    position: float
    velocity: float
    torque: float


class Shaft(Protocol):
    """A motor as a drive sees it. The simulation turns it; `command` holds until the next one."""

    def command(self, command: ShaftCommand) -> None:
        """Take a set-point."""

    def state(self) -> ShaftState:
        """What the motor does now."""


class InertialShaft:
    """A flywheel with viscous friction: a motor on a bench, for trying drives without a rover.

    Parameters
    ----------
    inertia : float
        kg m².
    friction : float
        N m s/rad.
    gain : float
        Of the velocity loop, 1/s: acceleration per speed error.
    """

    def __init__(self, inertia: float = 1e-3, friction: float = 1e-5, gain: float = 40.0) -> None:
        self.inertia, self.friction, self.gain = inertia, friction, gain
        self.asked = FREE
        self._state = ShaftState(0.0, 0.0, 0.0)

    def command(self, command: ShaftCommand) -> None:
        """Take a set-point."""
        self.asked = command

    def state(self) -> ShaftState:
        """What the motor does now."""
        return self._state

    def advance(self, dt: float) -> None:
        """Turn on for `dt` seconds, in steps short beside the velocity loop."""
        steps = max(1, round(dt * self.gain * 20))
        for _ in range(steps):
            self._step(dt / steps)

    def _step(self, dt: float) -> None:
        position, velocity, _ = self._state
        asked = self.asked
        torque = 0.0
        if asked.torque is not None:
            torque = asked.torque
        elif asked.velocity is not None:
            wanted = self.inertia * self.gain * (asked.velocity - velocity) + self.friction * asked.velocity
            torque = min(max(wanted, -asked.torque_limit), asked.torque_limit)
        after = velocity + dt * (torque - self.friction * velocity) / self.inertia
        self._state = ShaftState(position + dt * after, after, torque)


# ----------------------------------------------------------------------
# Set-points of a simulated drive: how the demand follows its target, in the drive's own units.
# ----------------------------------------------------------------------


SLOW_DOWN, QUICK_STOP, SLOW_DOWN_AND_STAY, QUICK_STOP_AND_STAY = 1, 2, 5, 6
"""Quick stop option codes (605Ah): the ramp of 6084h or of 6085h, and whether the drive stays there; 0 is no ramp."""

STANDSTILL_RPM: Final = 1.0
"""Below this speed a motor counts as standing, rpm."""

PATIENCE: Final = 0.5
"""A motor that has not come to rest so long after its demand has is left without current, s."""


_VELOCITY_MODES: Final = frozenset(int(mode) for mode in OperationMode if mode.is_velocity)


class Demands:
    """Demands of velocity (606Bh units) and torque (permille), as floating numbers between two roundings.

    Attributes
    ----------
    limited : bool
        Whether a limit cuts the target off: the statusword's internal limit.
    """

    def __init__(self, objects: Objects, scaling: MotorScaling) -> None:
        self._objects = objects
        self._scaling = scaling
        self._rpm = 10.0**-scaling.velocity_exponent
        self.velocity = 0.0
        self.torque = 0.0
        self.limited = False
        self._waited = 0.0
        self._goal, self._left = 0.0, 0.0

    def begin(self, velocity: int, torque: int) -> None:
        """Start from what the motor does, so that nothing jumps."""
        self.velocity, self.torque = float(velocity), float(torque)
        self.limited, self._waited = False, 0.0
        self._goal, self._left = self.velocity, 0.0

    def stop(self) -> None:
        """No demand any more."""
        self.begin(0, 0)

    def follow(self, mode: int, dt: float) -> ShaftCommand:
        """Move the demand towards the target of the mode for `dt` seconds."""
        objects = self._objects.values
        halted = bool(objects[0x6040, 0] & HALT)
        if mode in (OperationMode.PROFILE_VELOCITY, OperationMode.CYCLIC_SYNC_VELOCITY):
            target = 0.0 if halted else self._limit(objects[0x60FF, 0], objects[0x6080, 0] * self._rpm)
            if mode == OperationMode.CYCLIC_SYNC_VELOCITY and not halted:
                self.velocity = self._interpolate(target, dt)
            else:
                faster = target * self.velocity >= 0 and abs(target) > abs(self.velocity)
                self.velocity = _approach(self.velocity, target, objects[0x6083 if faster else 0x6084, 0] * dt)
                self._goal, self._left = self.velocity, 0.0
            self.torque = 0.0
        elif mode in (OperationMode.PROFILE_TORQUE, OperationMode.CYCLIC_SYNC_TORQUE):
            target = 0.0 if halted else self._limit(objects[0x6071, 0], objects[0x6072, 0])
            free = mode == OperationMode.CYCLIC_SYNC_TORQUE and not halted
            slope = objects[0x6087, 0]
            self.torque, self.velocity = target if free else _approach(self.torque, target, slope * dt), 0.0
        else:
            self.stop()
            return FREE
        return self._command(mode)

    def reached(self, mode: int) -> bool:
        """Whether the demand is at its target."""
        objects = self._objects.values
        if mode in (OperationMode.PROFILE_VELOCITY, OperationMode.CYCLIC_SYNC_VELOCITY):
            return self.velocity == objects[0x60FF, 0]
        return self.torque == objects[0x6071, 0]

    def ramp_down(self, mode: int, code: int, actual: int, dt: float) -> tuple[ShaftCommand, bool]:
        """Bring the motor to rest as an option code says, for `dt` seconds.

        Returns
        -------
        command : ShaftCommand
        done : bool
            Whether the motor stands, or in a torque mode is without torque.
        """
        objects = self._objects.values
        if code == 0 or mode not in tuple(OperationMode):
            self.stop()
            return FREE, True
        if mode in _VELOCITY_MODES:
            slope = objects[0x6085 if code in (QUICK_STOP, QUICK_STOP_AND_STAY) else 0x6084, 0]
            self.velocity = _approach(self.velocity, 0.0, slope * dt)
            at_rest = abs(actual) <= STANDSTILL_RPM * self._rpm
            self._waited += dt if self.velocity == 0.0 else 0.0
            done = self.velocity == 0.0 and (at_rest or self._waited > PATIENCE)
        else:
            self.torque = _approach(self.torque, 0.0, objects[0x6087, 0] * dt)
            done = self.torque == 0.0
        return self._command(mode), done

    def _interpolate(self, target: float, dt: float) -> float:
        """A straight line from one set-point to the next, for as long as 60C2h says that they are apart."""
        objects = self._objects.values
        if target != self._goal:
            self._goal, self._left = target, objects.get((0x60C2, 1), 0) * 10.0 ** objects.get((0x60C2, 2), 0)
        if dt >= self._left:
            self._left = 0.0
            return target
        velocity = self.velocity + (target - self.velocity) * dt / self._left
        self._left -= dt
        return velocity

    def _limit(self, target: float, limit: float) -> float:
        self.limited = abs(target) > limit
        return min(max(target, -limit), limit)

    def _command(self, mode: int) -> ShaftCommand:
        limit = self._scaling.torque_limit.si(self._objects.values[0x6072, 0])
        if mode in _VELOCITY_MODES:
            return ShaftCommand(self._scaling.velocity.si(self.velocity), None, limit)
        return ShaftCommand(None, self._scaling.torque.si(self.torque), limit)


def _approach(value: float, target: float, step: float) -> float:
    """`value`, at most `step` nearer to `target`."""
    return min(value + step, target) if target > value else max(value - step, target)
