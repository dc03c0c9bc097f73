"""Between a simulated drive and its motor: what the drive asks of the shaft, and what the shaft does."""

from __future__ import annotations

from typing import NamedTuple, Protocol


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
