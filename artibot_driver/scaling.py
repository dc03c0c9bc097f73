"""SI values ↔ the integers of a drive's objects, motor-side, in one where.

A drive counts positions in encoder increments, velocities in decimal fractions of rpm (its SI unit velocity, 60A9h,
says which), torques in permille of its motor's rated torque (6076h, whole mN m). All are rounded half to even. What an
object or the motor's limits cannot hold is cut off there, and the result says so.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

from artibot_sim.errors import ArtibotError
from artibot_sim.model import MOTORS, Robot
from artibot_sim.model.robot.robot import Drive

INT16, INT32 = (-(2**15), 2**15 - 1), (-(2**31), 2**31 - 1)
UINT16, UINT32 = (0, 2**16 - 1), (0, 2**32 - 1)

RPM: Final = 2.0 * math.pi / 60.0
"""One turn a minute, rad/s."""


class Scaled(NamedTuple):
    """An object's integer, and whether it is not what was asked for because a limit cut it off."""

    raw: int
    saturated: bool


@dataclass(frozen=True)
class Scale:
    """How one object counts one quantity.

    Attributes
    ----------
    unit : str
        SI unit.
    step : float
        SI value of 1; negative where the motor's polarity turns the sign.
    low, high : int
        Smallest and largest integer that may be sent.
    what : str
        Motor and quantity, for messages.
    """

    unit: str
    step: float
    low: int
    high: int
    what: str

    def raw(self, value: float) -> Scaled:
        """The integer nearest to an SI value, half to even, within ``low`` and ``high``.

        Raises
        ------
        ArtibotError
            For NaN: it has no nearest integer, and no drive should be given one.
        """
        if math.isnan(value):
            raise ArtibotError(f"{self.what}: found NaN, expected a number of {self.unit}; nothing was sent")
        quotient = value / self.step
        if not self.low - 0.5 <= quotient <= self.high + 0.5:  # before rounding: infinity has no integer
            return Scaled(self.low if quotient < self.low else self.high, True)
        rounded = round(quotient)
        cut = min(max(rounded, self.low), self.high)
        return Scaled(cut, cut != rounded)

    def si(self, raw: float) -> float:
        """The SI value of an integer, whatever its size: what a drive reports is not judged here."""
        return raw * self.step

    def within(self, limit: float) -> Scale:
        """This scale, with SI values limited to ±`limit` (not below zero where negative ones do not exist)."""
        most = min(limit / abs(self.step) * (1 + 1e-12), float(self.high))  # 0.6 N m are 1000 ‰, not 999
        return Scale(self.unit, self.step, max(self.low, -int(most)), int(most), self.what)


@dataclass(frozen=True)
class MotorScaling:
    """All scales of one motor's drive.

    Attributes
    ----------
    position, velocity, torque : Scale
        rad, rad/s, N m, with the motor's polarity; set-points are limited to the motor's.
    acceleration, torque_slope, torque_limit, speed_limit : Scale
        Magnitudes without sign: velocity units a second (6083h, 6084h, 6085h), permille a second (6087h), permille
        (6072h), whole rpm (6080h).
    rated_torque : int
        Object 6076h, mN m.
    rated_current : int or None
        Object 6075h, mA; None where the robot file has no torque constant.
    velocity_exponent : int
        Velocities count in 10^exponent rpm.
    counts_per_turn : int
        Encoder increments in one turn of the motor.
    """

    motor: str
    position: Scale
    velocity: Scale
    torque: Scale
    acceleration: Scale
    torque_slope: Scale
    torque_limit: Scale
    speed_limit: Scale
    rated_torque: int
    rated_current: int | None
    velocity_exponent: int
    counts_per_turn: int

    def of_object(self, index: int) -> Scale | None:
        """The scale of an object of CiA 402, or None where its integer is not a physical quantity."""
        name = OBJECTS.get(index)
        return None if name is None else getattr(self, name)


OBJECTS: Final = {
    0x6064: "position",
    0x606B: "velocity",
    0x606C: "velocity",
    0x60FF: "velocity",
    0x6071: "torque",
    0x6074: "torque",
    0x6077: "torque",
    0x6072: "torque_limit",
    0x6080: "speed_limit",
    0x6083: "acceleration",
    0x6084: "acceleration",
    0x6085: "acceleration",
    0x6087: "torque_slope",
}
"""Object → the scale in :class:`MotorScaling` that it is counted in."""


def motor_scaling(
    robot: Robot, motor: str, *, counts_per_turn: int, velocity_exponent: int, max_speed: float = math.inf
) -> MotorScaling:
    """Scales of one motor from the robot's drive data and the drive's settings.

    Parameters
    ----------
    motor : str
        One of ``MOTORS``.
    counts_per_turn : int
        Encoder increments in one turn of the motor (608Fh), four times the lines of a quadrature encoder.
    velocity_exponent : int
        Velocities count in 10^exponent rpm (60A9h).
    max_speed : float
        Largest velocity of the motor that may be commanded, rad/s.

    Raises
    ------
    ArtibotError
        When the robot has no such motor, or its file no rated torque, with the key and the mend.
    """
    drive, where = _drive(robot, motor)
    sign = drive.polarity.right if motor.endswith("right") else drive.polarity.left
    rated = _rated_torque(drive, where)
    limit = min(largest_torque(drive), UINT16[1] * 1e-6 * rated)
    step, thousandth = RPM * 10.0**velocity_exponent, rated * 1e-6
    current = None if math.isinf(drive.torque_constant) else round(rated / drive.torque_constant)
    return MotorScaling(
        motor=motor,
        position=Scale("rad", sign * 2.0 * math.pi / counts_per_turn, *INT32, f"{motor} position"),
        velocity=Scale("rad/s", sign * step, *INT32, f"{motor} velocity").within(max_speed),
        torque=Scale("N m", sign * thousandth, *INT16, f"{motor} torque").within(limit),
        acceleration=Scale("rad/s^2", step, *UINT32, f"{motor} acceleration"),
        torque_slope=Scale("N m/s", thousandth, *UINT32, f"{motor} torque slope"),
        torque_limit=Scale("N m", thousandth, *UINT16, f"{motor} torque limit").within(limit),
        speed_limit=Scale("rad/s", RPM, *UINT32, f"{motor} speed limit"),
        rated_torque=rated,
        rated_current=current,
        velocity_exponent=velocity_exponent,
        counts_per_turn=counts_per_turn,
    )


def largest_torque(drive: Drive) -> float:
    """Of a motor, N m; its rated one where the robot file has no other."""
    return drive.rated_torque if math.isinf(drive.torque_max) else drive.torque_max


def _drive(robot: Robot, motor: str) -> tuple[Drive, str]:
    if motor not in MOTORS:
        raise ArtibotError(f"motor '{motor}': unknown; expected one of {', '.join(MOTORS)}")
    module = motor.partition("_")[0]
    drive: Drive | None = getattr(robot.drive, module)
    if drive is None:
        raise ArtibotError(f"motor {motor}: robot '{robot.name}' is rigid and has no {module} drives")
    return drive, f"robot '{robot.name}': drive.{module}"


def _rated_torque(drive: Drive, where: str) -> int:
    """The rated torque as a drive holds it, whole mN m, which its permille are permille of."""
    if math.isinf(drive.rated_torque):
        raise ArtibotError(
            f"{where}.rated_torque: missing; a drive counts torque in permille of it. Add it to the file"
        )
    rated = round(drive.rated_torque * 1e3)
    if not 1 <= rated <= UINT32[1]:
        raise ArtibotError(
            f"{where}.rated_torque: {drive.rated_torque:g} N m; a drive holds 0.001 to {UINT32[1] / 1e3:g}"
        )
    return rated


def unwrap(raw: int, total: int) -> int:
    """Count on beyond 32 bits: the integer nearest to `total` whose low 32 bits are those of `raw`.

    Position actual values (6064h) wrap at 2^31 counts; as long as a motor turns by less than that between two of
    them, the sum is right.
    """
    return total + (raw - total + 2**31) % 2**32 - 2**31


def wrap(total: int) -> int:
    """The signed 32 bits that a drive's position object shows of a longer count."""
    return (total + 2**31) % 2**32 - 2**31
