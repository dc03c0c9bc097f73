"""Subscriptions to commands, of simulator and driver: refusals, lateness, and what holds now."""

from __future__ import annotations

import math
import time
from typing import Any

from geometry_msgs.msg import Twist, TwistStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from artibot_sim.nodes.common import arbiter
from artibot_sim.nodes.common.arbiter import SIGN_OF_LIFE, TOPICS, CommandSource, Rules, parse_request, parse_twist
from artibot_sim.nodes.common.pacer import Seldom
from artibot_sim.nodes.common.profile import Profile, ProfileReader, Refused
from artibot_sim.nodes.common.qos import LATCHED, subscription
from artibot_sim.nodes.common.stamps import SECOND, stamp_of

# ----------------------------------------------------------------------
# How long messages were held up on their way.
# ----------------------------------------------------------------------


MEMORY = 5.0
"""s for which the fastest message counts at least; up to twice as long."""


class Lateness:
    """Holds each message of a topic against the fastest one of late, so that the clocks of two machines need not agree.

    A clock that is set by a jump makes messages seem held up until the fastest ones from before are forgotten.
    """

    def __init__(self) -> None:
        self._since = float("-inf")
        self._earlier: int | None = None
        self._fastest: int | None = None

    def of(self, sent_ns: int, heard_ns: int, now: float) -> float:
        """Seconds by which a message was longer on its way than the fastest one; 0 of the first.

        Parameters
        ----------
        sent_ns, heard_ns : int
            By the system clocks of who sent it and who receives it.
        now : float
            Steady time, s.
        """
        if now - self._since > MEMORY:
            self._earlier = self._fastest if now - self._since <= 2.0 * MEMORY else None
            self._fastest, self._since = None, now
        way = heard_ns - sent_ns
        self._fastest = way if self._fastest is None else min(way, self._fastest)
        return 1e-9 * (way - min(self._fastest, way if self._earlier is None else self._earlier))


# ----------------------------------------------------------------------
# Commands of simulator and driver: subscriptions, refusals with their warnings, and what was received so far.
# ----------------------------------------------------------------------


IN_FLIGHT = 1.0
"""For so long after a reset (s) a command may still arrive that was sent before it."""

MOST_AT_ONCE = 20
"""Messages of a topic that are taken at most before the loop goes on: more than a queue holds, unless it is flooded."""

SHORTEST = 12
"""A serialised message with a stamp has so many bytes at least."""

UNNAMED = "_NODE_NAME_UNKNOWN_"
"""What rmw calls the node of an endpoint as long as it does not know it."""

TYPES_EVERY = 0.25
"""Between two checks of who publishes a command topic as what, s; each looks at one topic."""


class CommandInputs:
    """Takes commands and decides, with :mod:`artibot_sim.nodes.common.arbiter`, what holds.

    Parameters
    ----------
    node : rclpy Node
    rules : Rules
        May be exchanged while running.
    stamped : bool
        Whether `cmd_vel` is a TwistStamped.
    beside : bool
        Whether profiles are read in a thread of their own, so that nothing else waits for them.
    aged : bool
        Whether a message that was held up on its way counts as old as it is, not as fresh as its arrival.

    Attributes
    ----------
    t_ns : int
        What the time is, in that of the stamps.
    state : Commanding
        What was received so far.
    closed : str
        Why no command is taken at the moment, or empty; a command that comes then is lost.
    refusals : dict of CommandSource to str
        Why the last message of a source was refused; nothing where it was not.
    latest : float
        For how long (s) a message was held up on its way at most, since commands were dropped last; 0 unless `aged`.
    """

    def __init__(self, node: Node, rules: Rules, stamped: bool, beside: bool = False, aged: bool = False) -> None:
        self.rules = rules
        self.t_ns = 0
        self.state = arbiter.Commanding()
        self._log = node.get_logger()
        self._quiet = 0.0
        self._stopped_at: float | None = None
        self._reset_wall_ns = 0
        self._reset_at = -IN_FLIGHT
        self.closed = ""
        self.refusals: dict[CommandSource, str] = {}
        self._warned: dict[CommandSource, float] = {}
        self._say_remark, self._say_stamped = Seldom(1.0), Seldom(5.0)
        self._aged, self.latest = aged, 0.0
        self._ways: dict[str, Lateness] = {}
        sensor = qos_profile_sensor_data
        self._subscriptions = [
            subscription(node, JointState, TOPICS[CommandSource.LIVE], self._on_request, sensor),
            subscription(
                node, TwistStamped if stamped else Twist, TOPICS[CommandSource.CMD_VEL], self._on_twist, sensor
            ),
            subscription(node, Odometry, SIGN_OF_LIFE, self._on_planner, sensor, raw=True),
        ]
        self._stamped = stamped
        self._reader = ProfileReader(beside)
        self._node, self._profiles = node, None
        self._types_at, self._types_of = 0.0, 0
        self._strangers: set[tuple[str, str, str]] = set()
        self._nameless: set[bytes] = set()
        self.listen_for_profiles(True)

    def listen_for_profiles(self, wanted: bool) -> None:
        """Subscribe to profiles or not: a planner waits for somebody who does before it publishes its one."""
        if wanted and self._profiles is None:
            topic = TOPICS[CommandSource.PROFILE]
            self._profiles = subscription(self._node, JointTrajectory, topic, self._on_profile, LATCHED, raw=True)
        elif not wanted and self._profiles is not None:
            self._node.destroy_subscription(self._profiles)
            self._profiles = None

    @property
    def now(self) -> float:
        """Steady wall time (s) that stands still while the simulation is stopped: silence does not count then."""
        return (self._stopped_at if self._stopped_at is not None else time.monotonic()) - self._quiet

    def stop_time(self, stopped: bool) -> None:
        """The simulation stands still from now on, or goes on."""
        if stopped and self._stopped_at is None:
            self._stopped_at = time.monotonic()
        elif not stopped and self._stopped_at is not None:
            self._quiet += time.monotonic() - self._stopped_at
            self._stopped_at = None

    @property
    def has_command(self) -> bool:
        """Whether a command has been accepted since the start or the last reset."""
        return arbiter.commanded(self.state)

    def drop(self, position: tuple[float, float]) -> None:
        """Forget every command, also those on their way; the front motors stand at `position` (rad)."""
        self.state = arbiter.Commanding(position=position)
        self.refusals.clear()
        self._reader.drop()
        self._ways.clear()
        self.latest = 0.0
        self._reset_wall_ns, self._reset_at = time.time_ns(), time.monotonic()

    def take(self) -> None:
        """Take the messages that have come, without an executor."""
        for subscribed in (*self._subscriptions, *([self._profiles] if self._profiles else [])):
            handle = subscribed.handle
            with handle:
                for _ in range(MOST_AT_ONCE):
                    taken = handle.take_message(subscribed.msg_type, subscribed.raw)
                    if taken is None:
                        break
                    subscribed.callback(*taken)
        self._take_profiles()
        if time.monotonic() >= self._types_at:
            self._types_at = time.monotonic() + TYPES_EVERY
            self._types_of = (self._types_of + 1) % len(self._subscriptions)
            self._check_types(self._subscriptions[self._types_of])

    def _check_types(self, subscribed: Any) -> None:
        """Warn once of each node that publishes a topic as another type: its messages never arrive here."""
        kind = subscribed.msg_type
        expected = f"{kind.__module__.partition('.')[0]}/msg/{kind.__name__}"
        for info in self._node.get_publishers_info_by_topic(subscribed.topic_name):
            stranger = (f"{info.node_namespace.rstrip('/')}/{info.node_name}", subscribed.topic_name, info.topic_type)
            if info.topic_type == expected or stranger in self._strangers:
                continue
            endpoint = bytes(info.endpoint_gid)
            if info.node_name == UNNAMED and endpoint not in self._nameless:
                self._nameless.add(endpoint)  # named later than found; once more, and it is no node
                continue
            self._strangers.add(stranger)
            mend = ""
            if kind in (Twist, TwistStamped):
                flag = "false" if self._stamped else "true"
                mend = f", or set the parameter cmd_vel_stamped of {self._node.get_name()} to {flag}"
            self._log.warning(
                f"{stranger[1]} comes from {stranger[0]} as {stranger[2]} and is not taken: "
                f"publish {expected} there{mend}"
            )

    def decide(self, knot_ns: int, knots: int = 1) -> arbiter.PeriodCommands:
        """Commands for the period of `knots` intervals of `knot_ns` nanoseconds that begins now, ``t_ns``."""
        self.state, decision = arbiter.decide(self.state, self.rules, self.t_ns, knot_ns, knots, self.now)
        if decision.notice:
            self._log.warning(decision.notice)
        return decision

    def _outdated(self, info: dict[str, Any]) -> bool:
        """Whether a message was sent before commands were dropped and has only arrived after it."""
        if time.monotonic() - self._reset_at > IN_FLIGHT:
            return False
        return bool(info["source_timestamp"] < self._reset_wall_ns)

    def _warn_of(self, source: CommandSource, what: str, every: float) -> None:
        """Say something of a topic, at most once in so many seconds: a logger's own throttle would mix the topics."""
        now = time.monotonic()
        if now - self._warned.get(source, -math.inf) >= every:
            self._warned[source] = now
            self._log.warning(f"{TOPICS[source]} {what}")

    def _is_closed(self, source: CommandSource) -> bool:
        if self.closed:
            self._warn_of(source, f"refused: {self.closed}", 5.0)
        return bool(self.closed)

    def _is_void(self, source: CommandSource, info: dict[str, Any]) -> bool:
        """Whether a command is none, because of when it was sent or comes."""
        return self._is_closed(source) or self._outdated(info)

    def _said_at(self, topic: str, info: dict[str, Any]) -> float:
        """When a message counts as received, in terms of `now`: earlier by as much as it was held up on its way."""
        sent_ns = info["source_timestamp"]
        if not self._aged or not sent_ns:
            return self.now
        late = self._ways.setdefault(topic, Lateness()).of(sent_ns, time.time_ns(), time.monotonic())
        self.latest = max(self.latest, late)
        return self.now - late

    def _refuse(self, source: CommandSource, reason: Refused) -> None:
        self._warn_of(source, f"refused: {reason}", 1.0)
        self.refusals[source] = str(reason)
        self.state = arbiter.take_refusal(self.state, source)

    def _on_profile(self, message: bytes, info: dict[str, Any]) -> None:
        if self._is_closed(CommandSource.PROFILE):
            return
        # one that waits for late subscribers may come long after a stop
        if info["source_timestamp"] < self._reset_wall_ns:
            self._refuse_profile(Refused("it was published before the last stop or enable; publish it anew"))
            return
        self._reader.submit(message, self.now)
        self._take_profiles()

    def _take_profiles(self) -> None:
        for profile, received in self._reader.results():
            self._take_profile(profile, received)

    def _take_profile(self, profile: Profile | Refused, received: float) -> None:
        try:
            if isinstance(profile, Refused):
                raise profile
            known = self.state.last_key == profile.key
            self.state = arbiter.take_profile(self.state, profile, self.rules, self.t_ns, received)
        except Refused as reason:
            self._refuse_profile(reason)
            return
        if not known:
            ahead, lasts = (profile.start_ns - self.t_ns) * 1e-9, profile.times_ns[-1] * 1e-9
            self._log.info(f"profile accepted: it starts in {ahead:.3f} s and lasts {lasts:.3f} s")

    def _refuse_profile(self, reason: Refused) -> None:
        self._log.warning(f"{TOPICS[CommandSource.PROFILE]} refused: {reason}")

    def _on_request(self, message: JointState, info: dict[str, Any]) -> None:
        if self._is_void(CommandSource.LIVE, info):
            return
        try:
            velocity, effort, remark = parse_request(message, self.rules)
        except Refused as reason:
            self._refuse(CommandSource.LIVE, reason)
            return
        if remark and self._say_remark.due():
            self._log.warning(f"{TOPICS[CommandSource.LIVE]}: {remark}")
        self.refusals.pop(CommandSource.LIVE, None)
        self.state = arbiter.take_live(self.state, velocity, effort, self._said_at(TOPICS[CommandSource.LIVE], info))

    def _on_twist(self, message: TwistStamped | Twist, info: dict[str, Any]) -> None:
        if self._is_void(CommandSource.CMD_VEL, info):
            return
        try:
            velocity = parse_twist(message.twist if self._stamped else message, self.rules)
        except Refused as reason:
            self._refuse(CommandSource.CMD_VEL, reason)
            return
        self.refusals.pop(CommandSource.CMD_VEL, None)
        self.state = arbiter.take_twist(self.state, velocity, self._said_at(TOPICS[CommandSource.CMD_VEL], info))

    def _on_planner(self, message: bytes, info: dict[str, Any]) -> None:
        if self.closed or self._outdated(info) or len(message) < SHORTEST:
            return
        stamp_ns = stamp_of(message)
        off = (stamp_ns - self.t_ns) / SECOND
        # a recording that is played again is no planner; without a stamp nobody can tell
        if stamp_ns and self.rules.needs_sign_of_life and abs(off) > self.rules.sign_tolerance:
            # while it is stopped, the time does not go on that stamps are held against
            if self._stopped_at is None and self._say_stamped.due():
                self._log.warning(
                    f"planned/odom is stamped {off:+.1f} s from now: taken for no sign of life (a replay, another "
                    "clock?)"
                )
            return
        self.state = arbiter.take_sign_of_life(self.state, self._said_at(SIGN_OF_LIFE, info))
