"""What the driver publishes: the drives' feedback, what was sent to them, and /diagnostics (REP-107)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from sensor_msgs.msg import JointState

from artibot_driver.bus import BusState
from artibot_driver.cia402 import DriveState, StatusBit
from artibot_driver.config import DriverConfig
from artibot_driver.master import Commanded, DriveStatus, Feedback, MasterStatus, Phase, SetupStage
from artibot_sim.estimation.odometry import Odometry, Slip, metres_per_radian
from artibot_sim.model import Robot
from artibot_sim.nodes.common.motor_publishers import JointStatePublisher, MotorPublishers, WheelJoints, stamp_of_ns
from artibot_sim.nodes.common.qos import PUBLISHED, publisher
from artibot_sim.nodes.common.transforms import FrameNames, has_tf
from artibot_sim.nodes.driver.services import obstacles, stop_text

# ----------------------------------------------------------------------
# The driver's /diagnostics (REP-107): one status for each drive, one for the bus, one for the driver itself.
# ----------------------------------------------------------------------


DRIVER = "driver"
"""The node's own name."""

OK, WARN, ERROR, STALE = (DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR, DiagnosticStatus.STALE)

_FAULTS = (DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE)
NO_REASON = "it sends no emergency that says why: see its manual, or ask it with its maker's tool"
"""Of a drive that warns."""

_NOTES: tuple[tuple[str, Callable[[DriveStatus], bool]], ...] = (
    ("the drive warns (statusword, bit 7)", lambda drive: drive.warns),
    (NO_REASON, lambda drive: drive.warns and not drive.emergency),
    (
        "an internal limit acts (statusword, bit 11): torque (6072h), speed (6080h) or one of its maker's",
        lambda drive: drive.at_limit,
    ),
)
"""What a statusword adds to the state, and who says so."""

_BUS_LEVELS = {BusState.ACTIVE: OK, BusState.WARNING: WARN, BusState.PASSIVE: WARN}


@dataclass(frozen=True)
class Identity:
    """Whose diagnostics they are.

    Attributes
    ----------
    robot : str
        The robot file's name.
    place : str
        What distinguishes this driver from another robot's: ``rover1`` for the node ``/rover1/driver``, empty for
        ``/driver``.
    """

    robot: str
    place: str = ""

    @classmethod
    def of_node(cls, robot: str, full_name: str) -> Identity:
        """The identity of a node with this fully qualified name."""
        return cls(robot, full_name.strip("/").removesuffix(DRIVER).rstrip("/"))

    def name(self, part: str) -> str:
        """Name of a part's status."""
        return f"{self._before}artibot driver: {part}"

    def hardware(self, what: str) -> str:
        """Hardware id of a part's status."""
        return f"{self._before}{what}"

    @property
    def _before(self) -> str:
        return f"{self.place}/" if self.place else ""


def diagnostics(
    t_ns: int,
    config: DriverConfig,
    identity: Identity,
    status: MasterStatus | None,
    own: Mapping[str, object],
    fault: str = "",
) -> DiagnosticArray:
    """All statuses of one instant.

    Parameters
    ----------
    t_ns : int
        Stamp.
    identity : Identity
    status : MasterStatus or None
        The master's; None while the driver is not configured.
    own : mapping
        What the node adds of itself: lifecycle state, who commands, kappa, jitter.
    fault : str
        Why the driver could not be configured, or empty.
    """
    message = DiagnosticArray()
    stamp_of_ns(message, t_ns)
    found = judged(status, fault)
    if status is None:
        message.status = [_status(identity, found[0], identity.robot, own)]
        return message
    robot, bus = identity.robot, f"{config.interface} {config.channel}"
    message.status = [
        _status(identity, found[0], robot, _values_of_driver(status, own)),
        _status(identity, found[1], bus, _values_of_bus(config, status)),
    ]
    for judgement, drive in zip(found[2:], status.drives, strict=True):
        hardware = f"{robot} {drive.motor} (node {drive.node})"
        message.status.append(_status(identity, judgement, hardware, _values_of_drive(drive)))
    return message


class Judgement(NamedTuple):
    """What one status says in short: news where it changes.

    Attributes
    ----------
    level : bytes
    part : str
        ``driver``, ``bus``, or a motor.
    text : str
    """

    level: bytes
    part: str
    text: str


def judged(status: MasterStatus | None, fault: str = "") -> list[Judgement]:
    """Level and text of each status, in their order; far less work than the whole message."""
    if status is None:
        level, text = (ERROR, fault) if fault else (STALE, "not configured")
        return [Judgement(level, DRIVER, text)]
    return [_judged_driver(status), _judged_bus(status), *map(_judged_drive, status.drives)]


def _status(identity: Identity, judgement: Judgement, hardware: str, values: Mapping[str, object]) -> DiagnosticStatus:
    pairs = [KeyValue(key=key, value=_word(value)) for key, value in values.items()]
    return DiagnosticStatus(
        level=judgement.level, name=identity.name(judgement.part), hardware_id=identity.hardware(hardware),
        message=judgement.text, values=pairs,
    )  # fmt: skip


def _word(value: object) -> str:
    if isinstance(value, float):
        return "never" if math.isinf(value) else f"{value:.4g}"
    return "" if value is None else str(value)


def _judged_driver(status: MasterStatus) -> Judgement:
    stopped = f"stopped: {stop_text(status.stop)}" if status.stop is not None else ""
    asked_for = status.stop is not None and status.stop.reason.asked_for
    if stopped and (status.phase.moves or not asked_for):
        level = WARN if asked_for else ERROR
        text = _joined((stopped, "" if status.phase.moves else obstacles(status)))
    elif status.phase in (Phase.OFFLINE, Phase.LOCKED) or status.refusal or status.other_driver:
        level, text = ERROR, _joined((status.phase.value, obstacles(status)))
    elif status.phase in (Phase.LISTENING, Phase.CONFIGURING):
        level, text = WARN, _joined((status.phase.value, obstacles(status)))
    else:
        level, text = OK, stopped or status.phase.value
    return Judgement(level, DRIVER, text)


def _values_of_driver(status: MasterStatus, own: Mapping[str, object]) -> dict[str, object]:
    return {
        "phase": status.phase.name,
        "stop reason": status.stop.reason.name if status.stop else "",
        "stop motor": status.stop.motor if status.stop else "",
        "follows commands": status.following,
        "last request": status.notice,
        **own,
        **status.counters,
    }


def _judged_bus(status: MasterStatus) -> Judgement:
    bus = status.bus
    level = _BUS_LEVELS.get(bus.state, ERROR)
    return Judgement(level, "bus", bus.state.value if level == OK else _joined((bus.state.value, bus.reason)))


def _values_of_bus(config: DriverConfig, status: MasterStatus) -> dict[str, object]:
    bus = status.bus
    return {
        "interface": config.interface,
        "channel": config.channel,
        "state": bus.state.name,
        "load": bus.load,
        "transmit errors": bus.tx_errors,
        "receive errors": bus.rx_errors,
        "last trouble": bus.reason,
    }


def _state_of(drive: DriveStatus) -> str:
    return drive.state.name.lower().replace("_", " ") if drive.state else "unknown"


def _judged_drive(drive: DriveStatus) -> Judgement:
    state = _state_of(drive)
    level, text = OK, state
    notes = [words for words, holds in _NOTES if holds(drive)] + ([drive.remark] if drive.remark else [])
    if drive.stage is SetupStage.SEEKING:
        level, text = STALE, drive.trouble or drive.stage.value
    elif drive.stage is SetupStage.REFUSED or drive.state in _FAULTS:
        level, text = ERROR, _joined((state, drive.emergency, drive.trouble))
    elif drive.stage is SetupStage.RUNNING and drive.trouble:
        level, text = ERROR, _joined((drive.trouble, drive.emergency, *notes))
    elif drive.emergency or drive.stage is not SetupStage.RUNNING:
        level, text = WARN, _joined((drive.trouble or drive.stage.value, drive.emergency, *notes))
    elif notes:
        level, text = WARN, _joined((state, *notes))
    return Judgement(level, drive.motor, text)


def _values_of_drive(drive: DriveStatus) -> dict[str, object]:
    return {
        "node id": drive.node,
        "stage": drive.stage.name,
        "state": _state_of(drive),
        "statusword": f"{drive.statusword:#06x}",
        "motor supply": bool(drive.statusword & StatusBit.VOLTAGE_ENABLED),
        "warns": drive.warns,
        "at a limit": drive.at_limit,
        "emergency": drive.emergency,
        "error code": f"{drive.error_code:#06x}",
        "since heartbeat (s)": drive.heartbeat_age,
        "since feedback (s)": drive.feedback_age,
        "set up": f"{100 * drive.progress:.0f} %",
    }


def _joined(parts: Iterable[str]) -> str:
    return "; ".join(filter(None, parts))


# ----------------------------------------------------------------------
# What the driver publishes: the drives' feedback, what was sent to them, and how they are.
# ----------------------------------------------------------------------


EVERY_NS = 1_000_000_000
"""Between two /diagnostics where nothing changes."""

NEWS_NS = 100_000_000
"""Between two /diagnostics at the least."""


class DriverPublishers:
    """The node's publishers.

    Parameters
    ----------
    node : rclpy Node
    robot : Robot
    settings : mapping
        The node's parameters.
    """

    def __init__(self, node: Node, robot: Robot, settings: Mapping[str, Any]) -> None:
        get = settings.__getitem__
        frames = FrameNames.of(get("frame_prefix"), odom=get("odom_frame"), base=get("base_frame"))
        self._motors = MotorPublishers(node, robot, PUBLISHED, frames, has_tf(node, get("publish_tf")))
        self._wheels = WheelJoints(robot)
        self._joints = JointStatePublisher(
            publisher(node, JointState, "joint_states"), self._wheels.names, ("position", "velocity")
        )
        self._diagnostics = publisher(node, DiagnosticArray, "/diagnostics")
        self._odometry = Odometry(metres_per_radian(robot), robot.front.i_y, Slip.of(settings, robot))
        self._sampled = 0
        self._published: list[Judgement] = []
        self._published_ns = self._judged_ns = 0
        self._state: object = None

    def feedback(self, feedback: Feedback, epoch_ns: int) -> None:
        """Publish what the drives reported with the newest SYNC, if that is new.

        Parameters
        ----------
        epoch_ns : int
            System time less steady time.
        """
        sampled = max((stamp for stamp in feedback.stamp_ns if stamp is not None), default=0)
        if sampled <= self._sampled:
            return
        self._sampled, t_ns = sampled, sampled + epoch_ns
        self._motors.torques(t_ns, feedback.position, feedback.velocity, feedback.torque)
        self._joints.publish(t_ns, self._wheels.of(feedback.position), self._wheels.of(feedback.velocity))
        front, rates = feedback.position[:2], feedback.velocity[:2]
        if all(map(math.isfinite, (*front, *rates))):
            self._odometry.update(front, rates)
            self._motors.odom(t_ns, self._odometry)

    def commanded(self, commanded: Commanded, epoch_ns: int) -> None:
        """Publish what was sent with a SYNC."""
        t_ns = commanded.stamp_ns + epoch_ns
        self._motors.command(t_ns, commanded.front_velocity, commanded.back_effort)

    def diagnostics(
        self, now_ns: int, state: object, news: Callable[[], list[Judgement]], made: Callable[[], DiagnosticArray]
    ) -> None:
        """Publish /diagnostics once a second, and ten times a second at most when it says something new.

        Parameters
        ----------
        now_ns : int
            Steady time.
        state : object
            At once there may be news where this is another one, else ten times a second.
        news : callable
            What the message says in short, see `judged`.
        made : callable
            Makes the message, which takes long.
        """
        if now_ns - self._published_ns < NEWS_NS or (state == self._state and now_ns - self._judged_ns < NEWS_NS):
            return
        self._state, self._judged_ns = state, now_ns
        found = news()
        if found == self._published and now_ns - self._published_ns < EVERY_NS:
            return
        self._published, self._published_ns = found, now_ns
        self._diagnostics.publish(made())
