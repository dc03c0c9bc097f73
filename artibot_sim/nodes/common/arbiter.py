"""Commands as they come in, and who drives the rover: what is refused, arbitration, silence.

Pure and without ROS: a frozen :class:`Commanding` is what has been received so far; the ``take_*`` functions and
:func:`decide` return a new one. `now` is always steady wall time in seconds, ``t_ns`` simulated time.

The rules, in the default order of `AUTO`:

1. **live** (`motor_command_request`) rules while its last message is at most `command_timeout` old. Its velocities
   are taken as they are. It ends a profile that is under way, for a profile belongs to its absolute time.
2. **profile** (`planned/front_velocity`) rules from its first to its last point, while the planner's sign of life
   (`planned/odom`) is at most `command_timeout` old, counted from the first point at the earliest. A planner that
   was there and has fallen silent before the first point is not followed at all. Where the command differs from the
   profile (it came late, or took over from another source), the command first catches up, at `acceleration_limit`.
3. **cmd_vel** rules while at most `cmd_vel_timeout` old, through inverse kinematics, at `acceleration_limit`.
4. When nobody rules, both wheels' commands are scaled down alike, so that the path keeps its curvature, at
   `stop_deceleration`; a standing rover is held.

The vehicle's speed in this is that of the faster front wheel over ground, ``r_w tau max |theta_dot_m|``: on a straight
line the speed of the rover, in a bend that of its outer side, and also defined when it turns on the spot.

"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any

from artibot_sim.errors import ArtibotError
from artibot_sim.model import MOTORS
from artibot_sim.nodes.common.profile import Pair, Profile, Refused

# ----------------------------------------------------------------------
# Commands as they come in: which sources there are, and what is refused before it can move the rover.
# ----------------------------------------------------------------------


class CommandSource(Enum):
    """Who sets the front motors' velocities."""

    NONE = "none"
    LIVE = "live"
    PROFILE = "profile"
    CMD_VEL = "cmd_vel"


AUTO = (CommandSource.LIVE, CommandSource.PROFILE, CommandSource.CMD_VEL)
"""Who rules when several speak, the first one first: a request at the motors, the experiment under way, a joystick."""

TOPICS = {
    CommandSource.LIVE: "motor_command_request",
    CommandSource.PROFILE: "planned/front_velocity",
    CommandSource.CMD_VEL: "cmd_vel",
}

SIGN_OF_LIFE = "planned/odom"
"""A planner's, while its profile is followed."""


def parse_sources(text: str) -> tuple[CommandSource, ...]:
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


def check_sources(text: str) -> None:
    """Raise an :class:`ArtibotError` that names the parameter where `parse_sources` refuses its value."""
    try:
        parse_sources(text)
    except Refused as reason:
        raise ArtibotError(f"parameter command_source: {reason}") from reason


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
    sources: tuple[CommandSource, ...] = AUTO
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


# ----------------------------------------------------------------------
# Who drives the rover now: arbitration between the command topics, and what silence does.
#
# Pure and without ROS: a frozen :class:`Commanding` is what has been received so far; the ``take_*`` functions and
# :func:`decide` return a new one. `now` is always steady wall time in seconds, ``t_ns`` simulated time.
#
# The rules, in the default order of `AUTO`:
#
# 1. **live** (`motor_command_request`) rules while its last message is at most `command_timeout` old. Its velocities
#    are taken as they are. It ends a profile that is under way, for a profile belongs to its absolute time.
# 2. **profile** (`planned/front_velocity`) rules from its first to its last point, while the planner's sign of life
#    (`planned/odom`) is at most `command_timeout` old, counted from the first point at the earliest. A planner that
#    was there and has fallen silent before the first point is not followed at all. Where the command differs from the
#    profile (it came late, or took over from another source), the command first catches up, at `acceleration_limit`.
# 3. **cmd_vel** rules while at most `cmd_vel_timeout` old, through inverse kinematics, at `acceleration_limit`.
# 4. When nobody rules, both wheels' commands are scaled down alike, so that the path keeps its curvature, at
#    `stop_deceleration`; a standing rover is held.
#
# The vehicle's speed in this is that of the faster front wheel over ground, ``r_w tau max |theta_dot_m|``: on a
# straight line the speed of the rover, in a bend that of its outer side, and also defined when it turns on the
# spot.
# ----------------------------------------------------------------------


STALE_NS = 1_000_000_000
"""A profile whose start lies further in the past is refused (contract)."""

HORIZON_NS = 3_600_000_000_000
"""A profile whose start lies further ahead is refused: the planner's clock is another one."""

NAN_PAIR: Pair = (math.nan, math.nan)

IN_STEP = 1e-9
"""A command this close to the profile (rad/s) is on it."""


@dataclass(frozen=True)
class Live:
    """A live request: front velocities (rad/s) and back efforts (N·m, NaN where eq. 30 rules), and when it came."""

    velocity: Pair
    effort: Pair
    at: float


@dataclass(frozen=True)
class Twist:
    """A `/cmd_vel`, already as front motor velocities (rad/s), and when it came."""

    velocity: Pair
    at: float


@dataclass(frozen=True)
class PendingProfile:
    """An accepted profile: when it came, and when its first point was reached (None before)."""

    profile: Profile
    accepted: float
    begun: float | None = None


@dataclass(frozen=True)
class Commanding:
    """What has been received, and the front motors' command now: velocity rad/s, position rad."""

    position: Pair = (0.0, 0.0)
    velocity: Pair = (0.0, 0.0)
    source: CommandSource = CommandSource.NONE
    live: Live | None = None
    twist: Twist | None = None
    pending: PendingProfile | None = None
    sign_of_life: float | None = None
    last_key: bytes | None = None


@dataclass(frozen=True)
class PeriodCommands:
    """Commands of one period: knots at its start, between, and its end.

    Attributes
    ----------
    velocity, position : tuple of (float, float)
        Front right and left at each knot, rad/s and rad, motor-side.
    effort : (float, float)
        Back right and left, N·m; NaN where eq. 30 rules.
    source : CommandSource
        Who ruled at the end of the period.
    notice : str
        Something a person should know, or empty.
    silenced : bool
        Whether in this period a source fell silent that had asked for motion, and no other took over.
    """

    velocity: tuple[Pair, ...]
    position: tuple[Pair, ...]
    effort: Pair
    source: CommandSource
    notice: str = ""
    silenced: bool = False


def take_live(state: Commanding, velocity: Pair, effort: Pair, now: float) -> Commanding:
    """A live request that :func:`parse_request` has passed."""
    return replace(state, live=Live(velocity, effort, now))


def take_twist(state: Commanding, velocity: Pair, now: float) -> Commanding:
    """A velocity command that :func:`parse_twist` has passed."""
    return replace(state, twist=Twist(velocity, now))


def take_refusal(state: Commanding, source: CommandSource) -> Commanding:
    """A message that was refused ends the command that its source gave before; a profile stands by itself."""
    return replace(
        state,
        live=None if source is CommandSource.LIVE else state.live,
        twist=None if source is CommandSource.CMD_VEL else state.twist,
    )


def take_sign_of_life(state: Commanding, now: float) -> Commanding:
    """A sign of life of the planner."""
    return replace(state, sign_of_life=now)


def take_profile(state: Commanding, profile: Profile, rules: Rules, t_ns: int, now: float) -> Commanding:
    """A profile, at simulated time `t_ns`. One that was received before changes nothing.

    Raises
    ------
    Refused
        If its start lies more than 1 s in the past, or an hour ahead, or it is faster than `max_speed`.
    """
    if profile.key == state.last_key:
        return state
    ahead = (profile.start_ns - t_ns) * 1e-9
    clocks = "do planner and simulator use the same clock (use_sim_time)?"
    if profile.start_ns < t_ns - STALE_NS:
        raise Refused(
            f"its start lies {-ahead:.3f} s in the past, more than 1 s; send it anew with a later start; {clocks}"
        )
    if profile.start_ns > t_ns + HORIZON_NS:
        raise Refused(f"its start lies {ahead:.0f} s ahead, more than an hour; {clocks}")
    for velocity in profile.velocity:
        rules.check_speed(velocity)
    return replace(state, pending=PendingProfile(profile, now), last_key=profile.key)


def commanded(state: Commanding) -> bool:
    """Whether anything has been accepted that may move the rover."""
    return state.live is not None or state.twist is not None or state.pending is not None


def decide(
    state: Commanding, rules: Rules, t_ns: int, knot_ns: int, knots: int, now: float
) -> tuple[Commanding, PeriodCommands]:
    """Commands for the period that begins at `t_ns` and lasts ``knots * knot_ns`` nanoseconds.

    Returns
    -------
    Commanding, PeriodCommands
        What was received, without what is over, and with the command at the period's end; the ``knots + 1`` commands.
    """
    end_ns = t_ns + knots * knot_ns
    pending, notice = _planner_alive(state, rules, end_ns, now)
    fresh = _fresh(state, rules, now)
    source, velocity, position = CommandSource.NONE, state.velocity, state.position
    velocities, positions = [velocity], [position]
    for k in range(knots):
        t = t_ns + k * knot_ns
        source = _ruling(rules, fresh, pending, t, t + knot_ns)
        if (
            pending
            and pending.begun is not None
            and source not in (CommandSource.PROFILE, CommandSource.NONE)
            and _on(pending, t)
        ):
            pending, notice = None, f"{TOPICS[source]} takes over: the profile under way is dropped"
        velocity, moved = _next(state, rules, source, pending, velocity, t, knot_ns)
        position = (position[0] + moved[0], position[1] + moved[1])
        velocities.append(velocity)
        positions.append(position)
    silenced = source is CommandSource.NONE and _asked_for_motion(state, bool(notice))
    if source is CommandSource.NONE and state.source is not CommandSource.NONE and velocity != (0.0, 0.0):
        notice = notice or f"{TOPICS[state.source]} is silent or over: ramp to standstill"
    if pending and end_ns >= pending.profile.end_ns:
        pending = None
    effort = state.live.effort if source is CommandSource.LIVE and state.live else NAN_PAIR
    after = replace(state, position=position, velocity=velocity, source=source, pending=pending)
    return after, PeriodCommands(tuple(velocities), tuple(positions), effort, source, notice, silenced)


def _asked_for_motion(state: Commanding, planner_silent: bool) -> bool:
    """Whether the source that ruled until now wanted the rover to move; what has asked for a stop may fall silent."""
    last = {CommandSource.LIVE: state.live, CommandSource.CMD_VEL: state.twist}.get(state.source)
    asked = last.velocity if last else state.velocity
    return state.source is not CommandSource.NONE and (asked != (0.0, 0.0) or planner_silent)


def _planner_alive(state: Commanding, rules: Rules, end_ns: int, now: float) -> tuple[PendingProfile | None, str]:
    """The profile, unless its planner has fallen silent; marked as begun once its first point is reached."""
    pending = state.pending
    if pending is None or end_ns < pending.profile.begin_ns or CommandSource.PROFILE not in rules.sources:
        return pending, ""
    begun = now if pending.begun is None else pending.begun
    sign, limit = state.sign_of_life, rules.command_timeout
    if rules.needs_sign_of_life:
        alive = sign is not None and sign >= pending.accepted - limit
        if pending.begun is None and alive and now - sign > limit:  # type: ignore[operator]
            return None, f"the planner fell silent before its profile began ({now - sign:.2f} s): not followed"  # type: ignore[operator]
        since = max(begun, sign) if alive else begun  # type: ignore[type-var]
        if now - since > limit:
            return None, f"no sign of life of the planner (planned/odom) for {now - since:.2f} s: ramp to standstill"
    return replace(pending, begun=begun), ""


def _fresh(state: Commanding, rules: Rules, now: float) -> frozenset[CommandSource]:
    """The sources that speak now, profiles aside."""
    live = state.live is not None and now - state.live.at <= rules.command_timeout
    twist = state.twist is not None and now - state.twist.at <= rules.cmd_vel_timeout
    return frozenset(
        source for source, speaks in ((CommandSource.LIVE, live), (CommandSource.CMD_VEL, twist)) if speaks
    )


def _on(pending: PendingProfile, t_ns: int) -> bool:
    return pending.profile.begin_ns <= t_ns < pending.profile.end_ns


def _ruling(
    rules: Rules, fresh: frozenset[CommandSource], pending: PendingProfile | None, start: int, end: int
) -> CommandSource:
    """The first source in order that speaks in the interval from `start` to `end` (ns)."""
    for source in rules.sources:
        if source is CommandSource.PROFILE:
            if pending and pending.profile.begin_ns <= end and start < pending.profile.end_ns:
                return source
        elif source in fresh:
            return source
    return CommandSource.NONE


def _next(
    state: Commanding,
    rules: Rules,
    source: CommandSource,
    pending: PendingProfile | None,
    velocity: Pair,
    t_ns: int,
    knot_ns: int,
) -> tuple[Pair, Pair]:
    """Velocity at the interval's end (rad/s) and the rotation until then (rad)."""
    h = knot_ns * 1e-9
    gain = rules.acceleration_limit * h / rules.metres_per_radian
    if source is CommandSource.PROFILE and pending:
        profile, end = pending.profile, t_ns + knot_ns
        at, p0 = profile.sample(t_ns)
        target, p1 = profile.sample(end)
        if abs(at[0] - velocity[0]) <= IN_STEP and abs(at[1] - velocity[1]) <= IN_STEP:
            before, past = max(0, profile.begin_ns - t_ns) * 1e-9, max(0, end - profile.end_ns) * 1e-9
            moved = (p1[k] - p0[k] + before * at[k] + past * target[k] for k in (0, 1))
            return target, (next(moved), next(moved))
        after = _toward(velocity, target, gain)
    elif source is CommandSource.LIVE and state.live:
        after = state.live.velocity
    elif source is CommandSource.CMD_VEL and state.twist:
        after = _toward(velocity, state.twist.velocity, gain)
    else:
        after = _slower(velocity, rules.stop_deceleration * h / rules.metres_per_radian)
    return after, (0.5 * h * (velocity[0] + after[0]), 0.5 * h * (velocity[1] + after[1]))


def _toward(velocity: Pair, target: Pair, change: float) -> Pair:
    """`velocity` moved straight to `target` in the plane of both wheels, neither by more than `change`; 0: at once."""
    difference = (target[0] - velocity[0], target[1] - velocity[1])
    largest = max(abs(difference[0]), abs(difference[1]))
    if change == 0.0 or largest <= change:
        return target
    part = change / largest
    return velocity[0] + part * difference[0], velocity[1] + part * difference[1]


def _slower(velocity: Pair, change: float) -> Pair:
    """Both scaled alike, so that the faster loses `change`: the path's curvature stays."""
    fastest = max(abs(velocity[0]), abs(velocity[1]))
    if fastest <= change:
        return 0.0, 0.0
    part = (fastest - change) / fastest
    return part * velocity[0], part * velocity[1]
