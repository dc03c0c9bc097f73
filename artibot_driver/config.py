"""The driver's parameters: every one in one table, read from a ROS 2 parameter file or handed over by a node.

``config/driver.yaml`` is the file; it is made by ``python -m artibot_driver.config``. The node declares the same table
with ROS, and :func:`config_from_parameters` turns either into a :class:`DriverConfig`.
"""

from __future__ import annotations

import difflib
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final

from artibot_driver.cia402 import OperationMode
from artibot_sim.documents import load_document
from artibot_sim.errors import ArtibotError
from artibot_sim.model import MOTORS
from artibot_sim.parameters import Spec, Value, as_yaml

MODES: Final = {mode.name.lower(): mode for mode in OperationMode}
"""Modes of operation by the names that stand in the file."""

VELOCITY_MODES = tuple(name for name, mode in MODES.items() if mode.is_velocity)
TORQUE_MODES = tuple(name for name, mode in MODES.items() if not mode.is_velocity)

MODULES = ("front", "back")

_TABLE = (
    Spec("robot", "agriq", "Robot: a name (agriq, epiq) or the path of a robot file. Its drives' rated torque, "
         "limits and polarity are taken from there."),
    Spec("eds", "drive", "Object dictionary of the drives: a name (drive) or the path of an EDS file."),
    Spec("bus.interface", "socketcan", "python-can's name of the CAN interface: socketcan, or remote for a loopback "
         "bus between processes, or any other."),
    Spec("bus.channel", "vcan0", "Channel of the interface: can0 on a rover, vcan0; for remote ws://127.0.0.1:PORT/."),
    Spec("bus.bitrate", 500_000, "Bit rate, bit/s. SocketCAN's is set by `ip link`; it is needed all the same, to know "
         "how much the bus can carry.", low=10_000, high=1_000_000),
    *(Spec(f"node_ids.{motor}", k, f"CANopen node id of the {motor.replace('_', ' ')} drive.", low=1, high=127)
      for k, motor in enumerate(MOTORS, 1)),
    Spec("node_ids.driver", 127, "Node id of the driver itself, under which its heartbeat is sent.", low=1, high=127),
    Spec("sync_rate", 100.0, "SYNC frames a second, Hz: set-points go out and feedback comes in with each.", low=1.0,
         high=1000.0),
    Spec("heartbeat.driver_period", 0.02, "Between two heartbeats of the driver, s; whole ms. Several fit into the "
         "timeout: on a bad bus single ones get lost.", low=1e-3, high=10.0),
    Spec("heartbeat.driver_timeout", 0.15, "Without the driver's heartbeat for this long the drives stop, s; whole ms.",
         low=2e-3, high=60.0),
    Spec("heartbeat.drive_period", 0.04, "Between two heartbeats of a drive, s; whole ms.", low=1e-3, high=10.0),
    Spec("heartbeat.drive_timeout", 0.1, "Without a drive's heartbeat for this long the driver stops, s; whole ms.",
         low=2e-3, high=60.0),
    Spec("mode.front", "cyclic_sync_velocity", "Mode of operation of the front drives.", choices=VELOCITY_MODES),
    Spec("mode.back", "cyclic_sync_torque", "Mode of operation of the back drives.", choices=TORQUE_MODES),
    *(Spec(f"counts_per_turn.{module}", 4096, f"Encoder increments in one turn of a {module} motor (608Fh): four times "
           "the lines of a quadrature encoder.", low=1, high=2**24) for module in MODULES),
    Spec("velocity_exponent", -3, "Velocities count in 10^this rpm (60A9h): 0 is rpm, -3 thousandths.", low=-6, high=0),
    Spec("max_speed", 2.0, "No wheel is commanded to be faster over ground, m/s.", high=20.0, above=0.0),
    Spec("drive_acceleration", 5.0, "Acceleration and deceleration that a front drive may follow a set-point with, "
         "of the wheel over ground (6083h, 6084h), m/s^2. Keep it above what plans ask for.", high=1000.0, above=0.0),
    Spec("stop_deceleration", 2.0, "Deceleration of the wheels over ground when a drive stops by itself (6085h), "
         "m/s^2.", high=100.0, above=0.0),
    Spec("torque_slope", 6.0, "Fastest change of a drive's torque in profile torque mode and when it stops (6087h), "
         "motor-side, N m/s.", high=1e4, above=0.0),
)  # fmt: skip

KAPPA = Spec(
    "kappa", 1.0, "Share of the front module in the traction torque (eq. 29); default: the robot file's. Not below "
    "what the back motors' torque_max allows (Agri.q: 0.622).", high=1.0, above=0.0, live=True,
)  # fmt: skip

LAW = Spec(
    "law",
    "constant",
    "How the back motors share the torque: a law of `artibot actuate --list`, with parameters as "
    "NAME:PARAMETER=VALUE, or a Python file with a LAW. constant is eq. 30 with kappa.",
    live=True,
)

ODOMETRY = (
    Spec("publish_tf", True, "Publish the transforms on /tf, where tf2_msgs can be imported; false where a filter such "
         "as robot_localization publishes that of odom."),
    Spec("frame_prefix", "", "Before the name of every frame but map, as robot_state_publisher has it: rover1/ gives "
         "rover1/odom, so that several rovers share one tree."),
    Spec("odometry.travel_slip", -1.0, "Standard deviation of the travelled distance relative to that of odom, 1; "
         "negative: as the robot file says.", low=-1.0, high=1.0),
    Spec("odometry.turn_slip", -1.0, "Standard deviation of the turned angle relative to it, which slip shortens; "
         "negative: as the robot file says. The three set odom's covariances, which grow with way and turn.",
         low=-1.0, high=1.0),
    Spec("odometry.side_slip", -1.0, "Standard deviation of the drift to the side relative to the distance, 1; "
         "negative: as the robot file says.", low=-1.0, high=1.0),
)  # fmt: skip
"""What whoever publishes odom says of it: driver and simulator alike."""

_COMMANDING = (
    KAPPA,
    LAW,
    Spec("autoconfigure", True, "Open the bus and set the drives up at the start; false: wait for the lifecycle's "
         "configure."),
    Spec("enable_on_start", False, "Enable the drives as soon as they are set up, within a minute and unless something "
         "happens before; false: wait for ~/enable or the lifecycle's activate."),
    Spec("command_source", "auto", "Who may command, the ruling one first: auto (live,profile,cmd_vel), none, or some "
         "of these with commas.", live=True),
    Spec("command_timeout", 0.1, "A live request, or the planner's sign of life, older than this starts a ramp to "
         "standstill; steady wall time, s.", low=1e-3, high=60.0, live=True),
    Spec("cmd_vel_timeout", 0.5, "A cmd_vel older than this starts a ramp to standstill; steady wall time, s.",
         low=1e-3, high=60.0, live=True),
    Spec("acceleration_limit", 2.0, "Limit for a front wheel over ground that follows cmd_vel or catches up with a "
         "profile, m/s^2; 0: none. Profiles and live requests themselves are never changed.", low=0.0, high=1000.0,
         live=True),
    Spec("cmd_vel_stamped", True, "cmd_vel is a TwistStamped; false: a Twist."),
    Spec("odom_frame", "odom", "Frame of odom."),
    Spec("base_frame", "base_link", "Frame of the front module, child of odom_frame."),
    *ODOMETRY,
    Spec("realtime_priority", 50, "Priority of the loop among the machine's real-time threads (SCHED_FIFO); 0, and "
         "where the system does not allow it: that of any other process.", low=0, high=99),
    Spec("stats", "", "File for a statistic of lateness and CPU share (JSON), written at the end; empty: none."),
)  # fmt: skip

SPECS: Mapping[str, Spec] = {spec.name: spec for spec in _TABLE}
"""What drives, bus and driver share, by name, which is its key's path in the file."""

COMMANDING_SPECS: Mapping[str, Spec] = {spec.name: spec for spec in _COMMANDING}
"""What only the driver node uses: how commands are listened to. :class:`DriverConfig` has none of it."""

ALL_SPECS: Mapping[str, Spec] = {**SPECS, **COMMANDING_SPECS}
"""Every parameter that may stand in the file."""

_HEADER = (
    "Parameters of the driver and of the simulated drives; made by `python -m artibot_driver.config`.",
    "Node ids, channel and encoder counts are those of the wiring; the robot file has the motors' data.",
)


@dataclass(frozen=True)
class DriverConfig:
    """The values of :data:`SPECS`, checked; SI units.

    Attributes
    ----------
    node_ids : mapping of str to int
        Motor → node id.
    modes, counts_per_turn : mapping of str
        By module, ``front`` and ``back``.
    """

    robot: str
    eds: str
    interface: str
    channel: str
    bitrate: int
    node_ids: Mapping[str, int]
    driver_id: int
    sync_rate: float
    driver_period: float
    driver_timeout: float
    drive_period: float
    drive_timeout: float
    modes: Mapping[str, OperationMode]
    counts_per_turn: Mapping[str, int]
    velocity_exponent: int
    max_speed: float
    drive_acceleration: float
    stop_deceleration: float
    torque_slope: float

    def mode(self, motor: str) -> OperationMode:
        """Mode of operation of a motor's drive."""
        return self.modes[motor.partition("_")[0]]

    @property
    def sync_period_us(self) -> int:
        """Between two SYNC frames, µs (1006h)."""
        return round(1e6 / self.sync_rate)

    def interpolation_period(self) -> tuple[int, int]:
        """The SYNC period as 60C2h holds it: a number up to 255 and an exponent of ten, in seconds.

        Raises
        ------
        ArtibotError
            When there is no such number.
        """
        for exponent in (-3, -4, -5, -6):
            number = 1e-6 * self.sync_period_us / 10.0**exponent
            if abs(number - round(number)) < 1e-6 and 1 <= round(number) <= 255:
                return round(number), exponent
        raise ArtibotError(
            f"parameter sync_rate: found {self.sync_rate:g} Hz, a period of {self.sync_period_us} µs, which object "
            "60C2h cannot hold; expected one such as 50, 100, 125, 200, 250, 500 or 1000"
        )


def config_from_parameters(given: Mapping[str, Any]) -> DriverConfig:
    """Build the configuration from parameters by name; those not given have their defaults.

    Those of :data:`COMMANDING_SPECS` are checked and left to the node.

    Raises
    ------
    ArtibotError
        With the parameter's name, what was found and what is expected.
    """
    for name, found in given.items():
        if name not in ALL_SPECS:
            near = difflib.get_close_matches(name, ALL_SPECS, n=1, cutoff=0.5)
            mend = f"did you mean '{near[0]}'?" if near else f"expected one of {', '.join(ALL_SPECS)}"
            raise ArtibotError(f"parameter {name}: unknown; {mend}")
        ALL_SPECS[name].check(found)
    value: dict[str, Any] = {name: spec.check(given.get(name, spec.default)) for name, spec in SPECS.items()}
    config = DriverConfig(
        robot=value["robot"],
        eds=value["eds"],
        interface=value["bus.interface"],
        channel=value["bus.channel"],
        bitrate=value["bus.bitrate"],
        node_ids=MappingProxyType({motor: value[f"node_ids.{motor}"] for motor in MOTORS}),
        driver_id=value["node_ids.driver"],
        sync_rate=value["sync_rate"],
        driver_period=value["heartbeat.driver_period"],
        driver_timeout=value["heartbeat.driver_timeout"],
        drive_period=value["heartbeat.drive_period"],
        drive_timeout=value["heartbeat.drive_timeout"],
        modes=MappingProxyType({module: MODES[value[f"mode.{module}"]] for module in MODULES}),
        counts_per_turn=MappingProxyType({module: value[f"counts_per_turn.{module}"] for module in MODULES}),
        velocity_exponent=value["velocity_exponent"],
        max_speed=value["max_speed"],
        drive_acceleration=value["drive_acceleration"],
        stop_deceleration=value["stop_deceleration"],
        torque_slope=value["torque_slope"],
    )
    _check_together(config, value)
    return config


def _check_together(config: DriverConfig, value: Mapping[str, Value]) -> None:
    """Relations between parameters that bounds alone do not catch."""
    seen: dict[Value, str] = {}
    for name in (name for name in SPECS if name.startswith("node_ids.")):
        if (other := seen.get(value[name])) is not None:
            raise ArtibotError(f"parameter {name}: {value[name]} is {other}'s too; expected ids that differ")
        seen[value[name]] = name
    for who in ("driver", "drive"):
        period, timeout = getattr(config, f"{who}_period"), getattr(config, f"{who}_timeout")
        for name, seconds in (("period", period), ("timeout", timeout)):
            if abs(1e3 * seconds - round(1e3 * seconds)) > 1e-6:
                raise ArtibotError(f"parameter heartbeat.{who}_{name}: found {seconds} s; expected whole milliseconds")
        if timeout < 2 * period:
            raise ArtibotError(
                f"parameter heartbeat.{who}_timeout: {timeout:g} s is less than two periods of {period:g} s; one late "
                "heartbeat would stop the rover"
            )
    for name, seconds, what in (
        ("drive_timeout", config.drive_timeout, "in which feedback has to come"),
        ("driver_timeout", config.driver_timeout, "in which the driver's heartbeat has to, one a period at most"),
    ):
        if seconds * config.sync_rate < 2:
            raise ArtibotError(
                f"parameter sync_rate: {config.sync_rate:g} Hz leaves less than two periods in heartbeat.{name} "
                f"({seconds:g} s), {what}; expected at least {2 / seconds:g} Hz"
            )
    config.interpolation_period()  # raises where 60C2h cannot hold it


def load_config(config: str | os.PathLike[str] = "driver") -> DriverConfig:
    """Read a driver's parameter file.

    Parameters
    ----------
    config : str or path
        A name (``"driver"``: the file shipped with artibot) or the path of a YAML file.

    Raises
    ------
    ArtibotError
        Naming the file, the key, what was found, what was expected and the mend.
    """
    return load_document(
        "nodes", config, "driver parameters", lambda document, _: config_from_parameters(_flat_parameters(document))
    )


def _flat_parameters(document: Any) -> dict[str, Any]:
    return dict(_flat(_parameters(document), ""))


def _parameters(document: Any) -> Mapping[Any, Any]:
    """What stands below ``ros__parameters`` of the one node in a file."""
    if isinstance(document, Mapping) and len(document) == 1:
        (body,) = document.values()
        if isinstance(body, Mapping) and isinstance(body.get("ros__parameters"), Mapping):
            return body["ros__parameters"]
    raise ArtibotError("expected ROS 2 parameters of one node: '/**:', below it 'ros__parameters:', below it the keys")


def _flat(node: Mapping[Any, Any], path: str) -> Iterator[tuple[str, Any]]:
    """Names with dots, as ROS makes them of nested keys."""
    for key, value in node.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{path}{key}.")
        else:
            yield f"{path}{key}", value


def shipped_file() -> str:
    """All parameters at their defaults: ``config/driver.yaml``. `kappa` is a comment: its default is the robot's."""
    return as_yaml(ALL_SPECS.values(), _HEADER, left_out=(KAPPA.name,))


if __name__ == "__main__":
    print(shipped_file(), end="")
