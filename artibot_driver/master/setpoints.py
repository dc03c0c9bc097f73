"""Set-points of a cycle: what is followed, how it ramps down, eq. 30, and the integers that go into the frames."""

from __future__ import annotations

import math
from collections import Counter
from typing import Final, NamedTuple

from artibot_driver.master.values import NAN_PAIR, Commanded, Pair, Setpoints
from artibot_driver.rig import Rig, motor_per_metre
from artibot_driver.scaling import Scaled, largest_torque
from artibot_sim.errors import ArtibotError
from artibot_sim.model import Robot
from artibot_sim.model.equations.transmission import back_torque_factor
from artibot_sim.sharing import Cycle, Law

# ----------------------------------------------------------------------
# Eq. 30 in the drives' own counts, and the bounds that the motors' limits set to kappa.
# ----------------------------------------------------------------------


def kappa_bounds(robot: Robot) -> tuple[float, float]:
    """Smallest and largest kappa with which no back motor needs more torque than it has.

    With both front motors at their limit M_f, eq. 30 asks each back motor for M_f (tau_b/tau_f) (1/kappa − 1); that
    this is at most M_b gives ``kappa >= 1/(1 + M_b tau_f/(M_f tau_b))``: 0.622 for Agri.q's four equal motors (section
    6). It is rounded down to thousandths, as the paper states it: a permille of torque is one count. Where the robot
    file limits neither or only one pair of motors the smallest is 0, which kappa has to exceed.
    """
    front, back = robot.drive.front, robot.drive.back
    if back is None or math.isinf(largest_torque(front)) or math.isinf(largest_torque(back)):
        return 0.0, 1.0
    share = largest_torque(back) * front.tau / (largest_torque(front) * back.tau)
    return math.floor(1e3 / (1.0 + share) + 1e-9) / 1e3, 1.0


def check_kappa(robot: Robot, kappa: float) -> float:
    """`kappa`, if it is one that the motors allow.

    Raises
    ------
    ArtibotError
        With the bounds and where they come from.
    """
    low, high = kappa_bounds(robot)
    if not (low <= kappa <= high and kappa > 0.0):  # NaN is not either
        raise ArtibotError(
            f"kappa: found {kappa:g}, expected {low:g} to {high:g} for robot '{robot.name}': with less the back motors "
            "would need more than their torque_max when the front motors are at theirs"
        )
    return kappa


def back_torque(rig: Rig, motor: str, factor: float, front: tuple[int, int]) -> Scaled:
    """The target torque (6071h) of a back motor's drive by eq. 30, exact to rounding.

    Parameters
    ----------
    factor : float
        `back_torque_factor` of the robot and its kappa.
    front : (int, int)
        Torque actual values (6077h) of the front right and left drive, in their counts.
    """
    right, left = rig.scaling["front_right"].torque, rig.scaling["front_left"].torque
    total = right.si(front[0]) + left.si(front[1])
    return rig.scaling[motor].torque.raw(factor * total)


# ----------------------------------------------------------------------
# Set-points of a cycle: what is followed, how it ramps down, and the integers that go into the frames.
# ----------------------------------------------------------------------


FRONT: Final = ("front_right", "front_left")
BACK: Final = ("back_right", "back_left")

TOLERANCE: Final = 1.01
"""What is asked for beyond a limit times this is a mistake and is not followed; up to it, it is cut off."""

STANDSTILL: Final = 0.02
"""Wheels slower than this over ground count as standing, m/s."""


class Integers(NamedTuple):
    """Target velocities (60FFh) of the front drives and target torques (6071h) of the back ones, right and left."""

    velocity: tuple[int, int]
    torque: tuple[int, int]

    @property
    def moves(self) -> bool:
        """Whether the front wheels are to turn."""
        return any(self.velocity)


STANDING: Final = Integers((0, 0), (0, 0))


class Targets:
    """What the rover is commanded now; begins at rest.

    Attributes
    ----------
    velocity : (float, float)
        Front motors, rad/s.
    """

    def __init__(self, rig: Rig, tally: Counter[str]) -> None:
        self._rig, self._tally = rig, tally
        turn = motor_per_metre(rig.robot, FRONT[0])
        self._limit = rig.config.max_speed * turn
        self._deceleration = rig.config.stop_deceleration * turn
        self.velocity: Pair = (0.0, 0.0)
        self._effort = NAN_PAIR
        self._kappa, self._share, self._checked = math.nan, 0.0, math.nan
        self._share_by(rig.robot.control.kappa)
        self._law: Law | None = None
        self._law_fault = ""
        self._shared: Pair = (0.0, 0.0)

    def fault_of(self, given: Setpoints) -> str:
        """What is wrong with set-points, one clause; empty where they can be followed."""
        try:
            if not isinstance(given.stamp_ns, int):
                return f"a stamp that is no time in ns: {given.stamp_ns!r}"
            (right, left), (back_right, back_left) = given.front_velocity, given.back_effort
            speed = max(abs(right), abs(left))
            if not math.isfinite(right + left) or speed > TOLERANCE * self._limit:
                return f"front velocities {right:g} and {left:g} rad/s, expected at most {self._limit:g} (max_speed)"
            for motor, effort in zip(BACK, (back_right, back_left), strict=True):
                most = abs(self._rig.scaling[motor].torque.si(self._rig.scaling[motor].torque.high))
                if abs(effort) > TOLERANCE * most:  # NaN leaves it to eq. 30
                    return f"{motor} effort {effort:g} N m, expected at most {most:g}"
            if given.kappa is not None and given.kappa != self._checked:
                self._checked = check_kappa(self._rig.robot, given.kappa)
            if self._law_fault and given.law is self._law:
                return self._law_fault
        except ArtibotError as error:
            return str(error)
        except (TypeError, ValueError) as error:
            return f"no numbers: {error}"
        return ""

    def follow(self, given: Setpoints) -> None:
        """Take set-points that :meth:`fault_of` has passed; too fast ones are scaled down alike."""
        right, left = given.front_velocity
        speed = max(abs(right), abs(left))
        scale = 1.0
        if speed > self._limit:
            scale = self._limit / speed
            self._tally["saturated_velocity"] += 1
        self.velocity = (right * scale, left * scale)
        self._effort = given.back_effort
        self._share_by(self._rig.robot.control.kappa if given.kappa is None else given.kappa)
        self._law = given.law

    def _share_by(self, kappa: float) -> None:
        """Have eq. 30 share the torque by this kappa."""
        if kappa != self._kappa:
            self._kappa, self._share = kappa, back_torque_factor(self._rig.robot, kappa)

    def begin(self, velocity: Pair) -> None:
        """Start from what the front motors do, rad/s, or the limit; what is next to nothing is rest."""
        slow = not math.isfinite(sum(velocity)) or all(map(self.is_slow, velocity))
        self.velocity, self._effort = (0.0, 0.0), NAN_PAIR
        self._law, self._law_fault, self._shared = None, "", (0.0, 0.0)
        if not slow:
            scale = min(1.0, self._limit / max(map(abs, velocity)))
            self.velocity = (velocity[0] * scale, velocity[1] * scale)

    def is_slow(self, velocity: float) -> bool:
        """Whether a front motor with this velocity (rad/s) counts as standing; not for NaN."""
        return abs(velocity) <= STANDSTILL / self._rig.config.max_speed * self._limit

    def ramp_down(self, dt: float) -> None:
        """`dt` seconds nearer to standstill, both wheels scaled alike: the path keeps its curvature.

        It is eq. 30 that shares the torque then: a stop does not rest on a law that somebody wrote for driving.
        """
        self._effort, self._law = NAN_PAIR, None
        speed = max(map(abs, self.velocity))
        left = max(0.0, speed - self._deceleration * dt)
        scale = left / speed if speed > 0.0 else 0.0
        self.velocity = (self.velocity[0] * scale, self.velocity[1] * scale)

    @property
    def at_rest(self) -> bool:
        """Whether nothing is commanded but standstill, in the drives' counts."""
        return not any(self._velocities()) and not any(effort for effort in self._effort if not math.isnan(effort))

    def _velocities(self) -> tuple[int, int]:
        right, left = (
            self._rig.scaling[motor].velocity.raw(value).raw for motor, value in zip(FRONT, self.velocity, strict=True)
        )
        return right, left

    def integers(self, front_torque: tuple[int, int]) -> Integers:
        """What goes into the frames, given the front drives' torque actual values (6077h)."""
        torques, law = [], self._by_law(front_torque)
        for i, (motor, effort) in enumerate(zip(BACK, self._effort, strict=True)):
            if law is not None and math.isnan(effort):
                scaled = self._rig.scaling[motor].torque.raw(law[i])
            elif math.isnan(effort):
                scaled = back_torque(self._rig, motor, self._share, front_torque)
            else:
                scaled = self._rig.scaling[motor].torque.raw(effort)
            self._tally["saturated_torque"] += scaled.saturated
            torques.append(scaled.raw)
        right, left = (self._rig.scaling[motor].torque.si(raw) for motor, raw in zip(BACK, torques, strict=True))
        self._shared = right, left
        return Integers(self._velocities(), (torques[0], torques[1]))

    def _by_law(self, front_torque: tuple[int, int]) -> Pair | None:
        """Back torques (N m) by the law that set-points named; None for eq. 30.

        A law is anybody's code: where it fails the back motors get no torque, and the next set-points that name it are
        faulty, which stops the rover.
        """
        law = self._law
        if law is None:
            return None
        if self._law_fault:
            return 0.0, 0.0
        right, left = (self._rig.scaling[m].torque.si(raw) for m, raw in zip(FRONT, front_torque, strict=True))
        try:
            torques = law.torques(self._rig.robot, Cycle(self.velocity, (right, left), self._shared, self._kappa))
            sound = math.isfinite(sum(torques))
            self._law_fault = "" if sound else f"law {law} gives torques {torques[0]:g} and {torques[1]:g} N m"
        except Exception as error:  # noqa: BLE001 - whatever a user's law does, the loop goes on
            self._law_fault = f"law {law}: {type(error).__name__}: {error}"
        return (0.0, 0.0) if self._law_fault else torques

    def commanded(self, sent: Integers, now: int) -> Commanded:
        """What frames with these integers say, SI."""
        scaling = self._rig.scaling
        velocity = [scaling[motor].velocity.si(raw) for motor, raw in zip(FRONT, sent.velocity, strict=True)]
        torque = [scaling[motor].torque.si(raw) for motor, raw in zip(BACK, sent.torque, strict=True)]
        return Commanded((velocity[0], velocity[1]), (torque[0], torque[1]), now)
