"""Commands as they come in: which sources there are, and what is refused before it can move the rover."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

from artibot_sim.model import MOTORS
from artibot_sim.nodes.profile import Pair, Refused


class Source(Enum):
    """Who sets the front motors' velocities."""

    NONE = "none"
    LIVE = "live"
    PROFILE = "profile"
    CMD_VEL = "cmd_vel"


AUTO = (Source.LIVE, Source.PROFILE, Source.CMD_VEL)
"""Who rules when several speak, the first one first: a request at the motors, the experiment under way, a joystick."""

TOPICS = {
    Source.LIVE: "motor_command_request",
    Source.PROFILE: "planned/front_velocity",
    Source.CMD_VEL: "cmd_vel",
}

SIGN_OF_LIFE = "planned/odom"
"""A planner's, while its profile is followed."""


def parse_sources(text: str) -> tuple[Source, ...]:
    """Sources in order of precedence from ``auto``, ``none`` or names with commas between.

    Raises
    ------
    Refused
        On an unknown name, or one that stands twice.
    """
    if text == "auto":
        return AUTO
    if text == "none":
        return ()
    by_name = {source.value: source for source in AUTO}
    names = [name.strip() for name in text.split(",")]
    if not set(names) <= set(by_name) or len(set(names)) != len(names):
        raise Refused(
            f"'{text}': expected auto, none, or some of {', '.join(by_name)} with commas, the ruling one first"
        )
    return tuple(by_name[name] for name in names)


@dataclass(frozen=True)
class Rules:
    """What the arbitration needs to know (SI units).

    Attributes
    ----------
    metres_per_radian : float
        ``r_w tau``: ground covered per radian of a front motor.
    track : float
        ``i_y`` of the front module, for inverse kinematics.
    torque_max : float
        Requested back efforts are cut to ± this (N·m).
    needs_sign_of_life : bool
        False when the simulator runs as fast as it goes.
    sign_tolerance : float
        A sign of life whose stamp is further than this (simulated s) from now is none: a recording's, say.
    """

    metres_per_radian: float
    track: float
    torque_max: float = math.inf
    sources: tuple[Source, ...] = AUTO
    command_timeout: float = 0.1
    cmd_vel_timeout: float = 0.5
    stop_deceleration: float = 2.0
    acceleration_limit: float = 2.0
    max_speed: float = 20.0
    needs_sign_of_life: bool = True
    sign_tolerance: float = 1.0

    def check_speed(self, velocity: Pair) -> None:
        """Refuse motor velocities (rad/s) that no rover has."""
        speed = max(abs(velocity[0]), abs(velocity[1])) * self.metres_per_radian
        if not speed <= self.max_speed:
            raise Refused(f"it asks for {speed:.4g} m/s at a wheel; max_speed is {self.max_speed:g} m/s")


def parse_request(message: Any, rules: Rules) -> tuple[Pair, Pair, str]:
    """Check a `/motor_command_request` (sensor_msgs/JointState).

    Returns
    -------
    velocity, effort : (float, float)
        Of the front motors (rad/s) and the back motors (N·m, NaN where not commanded, cut to ±torque_max).
    remark : str
        What of the message was not used, or empty.

    Raises
    ------
    Refused
        Unless the names are motors, both front ones among them, and every array is empty or as long as the names.
    """
    names = list(message.name)
    if len(set(names)) != len(names) or not set(names) <= set(MOTORS) or not set(MOTORS[:2]) <= set(names):
        raise Refused(f"names are {names}; expected {list(MOTORS[:2])} and, for back efforts, {list(MOTORS[2:])}")
    velocity = _field(names, message.velocity, "velocity")
    effort = _field(names, message.effort, "effort")
    front = (velocity[MOTORS[0]], velocity[MOTORS[1]])
    if not (math.isfinite(front[0]) and math.isfinite(front[1])):
        raise Refused(f"front velocities are {front}; expected two finite numbers in rad/s")
    rules.check_speed(front)
    unused = [f"{m}.velocity" for m in MOTORS[2:] if velocity[m] == velocity[m] and velocity[m] != 0]
    unused += [f"{m}.effort" for m in MOTORS[:2] if effort[m] == effort[m] and effort[m] != 0]
    remark = f"{', '.join(unused)} cannot be commanded and is ignored" if unused else ""
    return front, (_cut(effort[MOTORS[2]], rules), _cut(effort[MOTORS[3]], rules)), remark


def _field(names: list[str], values: Sequence[float], what: str) -> dict[str, float]:
    if len(values) not in (0, len(names)):
        raise Refused(f"{what} has {len(values)} entries for {len(names)} names; expected none or {len(names)}")
    found = dict.fromkeys(MOTORS, math.nan)
    found.update(zip(names, map(float, values), strict=False))
    return found


def _cut(effort: float, rules: Rules) -> float:
    if math.isinf(effort):
        raise Refused(f"a back effort is {effort}; expected a finite torque in N m, or NaN to leave it to eq. 30")
    return max(-rules.torque_max, min(rules.torque_max, effort)) if effort == effort else effort


def parse_twist(message: Any, rules: Rules) -> Pair:
    """Front motor velocities (rad/s) of a geometry_msgs/Twist: v = linear.x, yaw rate = angular.z, no slip.

    Raises
    ------
    Refused
        If any of its six numbers is not finite, or a wheel would exceed `max_speed`.
    """
    linear, angular = message.linear, message.angular
    numbers = (linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)
    if not all(math.isfinite(number) for number in numbers):
        raise Refused(f"it holds {numbers}; expected finite numbers")
    half = angular.z * rules.track / 2.0
    velocity = ((linear.x + half) / rules.metres_per_radian, (linear.x - half) / rules.metres_per_radian)
    rules.check_speed(velocity)
    return velocity
