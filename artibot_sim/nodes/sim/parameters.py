"""Every parameter of the simulation node in one table, and what its parts take of them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from artibot_driver.config import ODOMETRY
from artibot_sim import parameters
from artibot_sim.errors import ArtibotError
from artibot_sim.estimation.odometry import metres_per_radian
from artibot_sim.model import Ground, Robot, load_ground
from artibot_sim.nodes.common.arbiter import Rules, check_sources, parse_sources
from artibot_sim.nodes.common.parameters import declare as declare_spec
from artibot_sim.nodes.sim.engine import StartPose
from artibot_sim.nodes.sim.sensors import SensorModel
from artibot_sim.parameters import Spec, Value

# ----------------------------------------------------------------------
# Every parameter of the simulation node: name, default, meaning, range, in one table.
# ----------------------------------------------------------------------


ROBOT = Spec("robot", "agriq", "Robot: a name (agriq, epiq, husky) or the path of a robot file.")
KAPPA = Spec(
    "kappa", 1.0, "Share of the front module in the traction torque (eq. 29); default: the robot file's. There is no "
    "service for it, because std_srvs has none with a number: set this parameter.", high=1.0, above=0.0, live=True,
)  # fmt: skip

OTHERS = (
    Spec("integrator", "rk4", "Integration scheme.", choices=("rk4", "semi_implicit")),
    Spec("dt", 1e-3, "Integration step, s; must divide the publish period.", low=1e-5, high=1e-2),
    Spec("publish_rate", 100.0, "Publications per second of simulated time, Hz.", low=1.0, high=1000.0),
    Spec("rate", 1.0, "Simulated over real time; 0: as fast as it goes.", low=0.0, high=1000.0),
    Spec("publish_clock", "auto", "Publish /clock and count time from 0; auto: when rate is not 1. Otherwise stamps "
         "are system time.", choices=("auto", "true", "false")),
    Spec("wait_for_profile", False, "Hold the time after the first step until a command has been accepted. With it and "
         "rate 0 a run is the same to the bit, stamps included, however long discovery takes."),
    Spec("start_paused", False, "Start as after ~/pause."),
    Spec("duration", 0.0, "End with status 0 after this much simulated time, s; 0: never.", low=0.0, high=1e9),
    Spec("seed", 0, "Seed of all sensor noise.", low=0, high=2**31 - 1),
    Spec("ground", "", "Uneven ground: a file (.yaml, .npy with a .yaml beside it, .tif) or random:SEED; empty: flat."),
    Spec("front_mode", "prescribed", "Front motors follow their command exactly (eq. 26), or are driven by a velocity "
         "loop whose torque is limited.", choices=("prescribed", "driven")),
    Spec("start.x", 0.0, "Start of the front module in map, m.", low=-1e6, high=1e6),
    Spec("start.y", 0.0, "Start of the front module in map, m.", low=-1e6, high=1e6),
    Spec("start.yaw", 0.0, "Heading at the start, rad.", low=-10.0, high=10.0),
    Spec("start.articulation_yaw", 0.0, "Articulation at the start, gamma_b - gamma_f, rad.", low=-1.5, high=1.5),
    Spec("command_source", "auto", "Who may command, the ruling one first: auto (live,profile,cmd_vel), none, or some "
         "of these with commas.", live=True),
    Spec("command_timeout", 0.1, "A live request, or the planner's sign of life, older than this starts a ramp to "
         "standstill; steady wall time, s (divided by rate when that is below 1).", low=1e-3, high=60.0, live=True),
    Spec("cmd_vel_timeout", 0.5, "The same for cmd_vel.", low=1e-3, high=60.0, live=True),
    Spec("stop_deceleration", 2.0, "Deceleration of the faster front wheel over ground on a ramp to standstill, m/s^2.",
         high=100.0, above=0.0, live=True),
    Spec("acceleration_limit", 2.0, "Limit for a front wheel over ground that follows cmd_vel or catches up with a "
         "profile, m/s^2; 0: none. Profiles and live requests themselves are never changed.", low=0.0, high=1000.0,
         live=True),
    Spec("max_speed", 20.0, "Commands for a faster wheel over ground are refused, m/s.", high=1000.0, above=0.0,
         live=True),
    Spec("cmd_vel_stamped", True, "cmd_vel is a TwistStamped; false: a Twist."),
    Spec("with_driver", False, "Four simulated CiA 402 drives on a CAN bus turn the rover, and a driver commands them: "
         "it takes all commands and publishes odom, motor_torques, motor_command and the wheel joints, not this node."),
    Spec("driver_params", "driver", "With with_driver: the driver's parameter file, for bus, node ids, EDS and encoder "
         "counts: a shipped one by name (driver), or a path. The robot is this node's."),
    Spec("bus.interface", "", "With with_driver: python-can's name of the CAN interface; empty: by the channel, "
         "or as in driver_params."),
    Spec("bus.channel", "", "With with_driver: channel of the interface; empty: as in driver_params."),
    Spec("realtime_priority", 50, "Priority of the loop among the machine's real-time threads (SCHED_FIFO), so that a "
         "busy machine does not delay it; at a rate up to 1. 0, and where the system does not allow it: that of any "
         "other process.", low=0, high=99),
    *ODOMETRY,
    Spec("map_frame", "map", "Frame of the ground truth, common to all rovers."),
    Spec("reliable", "auto", "Keep a long queue for slow reliable subscribers, for recording without loss; auto: when "
         "rate is 0. Everything is offered reliably in any case.", choices=("auto", "true", "false")),
    Spec("stats", "", "File for a statistic of lateness and CPU share (JSON), written at the end; empty: none."),
    Spec("noise.encoder_counts", 0, "Encoder counts a motor turn, to which positions are rounded; 0: not rounded.",
         low=0, high=10_000_000),
    Spec("noise.velocity", 0.0, "Sigma of motor velocities, rad/s.", low=0.0, high=1e3),
    Spec("noise.torque", 0.0, "Sigma of motor torques, N m.", low=0.0, high=1e3),
    Spec("noise.torque_relative", 0.0, "Sigma of motor torques relative to the torque.", low=0.0, high=1.0),
    Spec("noise.articulation", 0.0, "Sigma of the articulation angles, rad.", low=0.0, high=1.0),
    Spec("imu.enabled", False, "Publish imu/data."),
    Spec("imu.gyro_noise", 0.0, "Sigma of the angular rates, rad/s.", low=0.0, high=10.0),
    Spec("imu.gyro_bias", 0.0, "Constant error of the yaw rate, rad/s.", low=-1.0, high=1.0),
    Spec("imu.acceleration_noise", 0.0, "Sigma of the accelerations, m/s^2.", low=0.0, high=100.0),
    Spec("imu.orientation", False, "Whether imu/data tells the orientation, or says that none is measured."),
    Spec("imu.orientation_noise", 0.0, "Sigma of roll, pitch and yaw, rad.", low=0.0, high=1.0),
    Spec("imu.gyro_deviation", 0.0, "Standard deviation of the yaw rate that imu/data states, rad/s; 0: that of its "
         "noise and bias.", low=0.0, high=10.0),
    Spec("imu.acceleration_deviation", 0.0, "The same for the accelerations, m/s^2; 0: that of their noise.", low=0.0,
         high=100.0),
    Spec("total_station.enabled", False, "Publish total_station/point."),
    Spec("total_station.rate", 10.0, "Points per second of simulated time, Hz.", low=0.01, high=1000.0),
    Spec("total_station.noise", 0.0, "Sigma of each coordinate, m.", low=0.0, high=10.0),
    Spec("total_station.loss", 0.0, "Fraction of the points that are lost.", low=0.0, high=1.0),
    Spec("total_station.prism", (0.0, 0.0, 0.0), "Where the prism sits in the front module, m.", low=-10.0, high=10.0),
)  # fmt: skip
"""All but `robot` and `kappa`, which are declared first: the file gives the other's default."""

SPECS: Mapping[str, Spec] = {spec.name: spec for spec in (ROBOT, KAPPA, *OTHERS)}


def check(name: str, value: Any) -> Value:
    """A parameter's value in its type; raises :class:`ArtibotError` with the reason when it is refused."""
    checked = SPECS[name].check(value)
    if name == "command_source":
        check_sources(str(checked))
    return checked


def as_yaml() -> str:
    """All parameters at their defaults as a ROS 2 parameter file: ``config/sim.yaml``.

    `kappa` stands there as a comment, for its default is the robot file's.
    """
    header = (
        "Parameters of the simulation node at their defaults; made by `python -m artibot_sim.nodes.sim.parameters`.",
        "Use: artibot sim --params sim, or ros2 run artibot_sim sim --ros-args --params-file sim.yaml",
        "Realistic sensors: sim_noisy.yaml.",
    )
    return parameters.as_yaml(SPECS.values(), header, left_out=(KAPPA.name,))


def declare(node: Any, spec: Spec, default: Value | None = None) -> Value:
    """Declare one parameter on an rclpy node and return its checked value; raises :class:`ArtibotError`."""
    return check(spec.name, declare_spec(node, spec, default))


if __name__ == "__main__":
    print(as_yaml(), end="")


# ----------------------------------------------------------------------
# From the node's parameters to what its parts take.
# ----------------------------------------------------------------------


Settings = Mapping[str, Any]
"""Checked parameters by name (:data:`artibot_sim.nodes.sim.parameters.SPECS`)."""


def rules(settings: Settings, robot: Robot) -> Rules:
    """What the arbitration between commands goes by.

    Below real time the limits of silence stretch: publishers whose timers follow /clock slow down with it.
    """
    rate = settings["rate"]
    stretch = 1.0 / min(1.0, rate) if rate else 1.0
    return Rules(
        metres_per_radian=metres_per_radian(robot),
        track=robot.front.i_y,
        torque_max=(robot.drive.back or robot.drive.front).torque_max,
        sources=parse_sources(settings["command_source"]),
        command_timeout=settings["command_timeout"] * stretch,
        cmd_vel_timeout=settings["cmd_vel_timeout"] * stretch,
        stop_deceleration=settings["stop_deceleration"],
        acceleration_limit=settings["acceleration_limit"],
        max_speed=settings["max_speed"],
        needs_sign_of_life=rate != 0,
        sign_tolerance=max(1.0, settings["command_timeout"] * max(1.0, rate)),
    )


def start(settings: Settings) -> StartPose:
    """Where the rover starts."""
    return StartPose(*(settings[f"start.{name}"] for name in ("x", "y", "yaw", "articulation_yaw")))


def ground(settings: Settings) -> Ground | None:
    """The ground under the rover; None where it is flat."""
    return load_ground(settings["ground"]) if settings["ground"] else None


def sensor_model(settings: Settings) -> SensorModel:
    """The sensors' errors."""
    return SensorModel(
        encoder_counts=settings["noise.encoder_counts"],
        velocity=settings["noise.velocity"],
        torque=settings["noise.torque"],
        torque_relative=settings["noise.torque_relative"],
        articulation=settings["noise.articulation"],
        gyro=settings["imu.gyro_noise"],
        gyro_bias=settings["imu.gyro_bias"],
        acceleration=settings["imu.acceleration_noise"],
        orientation=settings["imu.orientation_noise"],
        station=settings["total_station.noise"],
        station_loss=settings["total_station.loss"],
        prism=settings["total_station.prism"],
    )


def gyro_deviation(settings: Settings) -> float:
    """What imu/data states of its yaw rate: as given, or what noise and bias come to (rad/s)."""
    return settings["imu.gyro_deviation"] or math.hypot(settings["imu.gyro_noise"], settings["imu.gyro_bias"])


def check_drives(settings: Settings) -> None:
    """Refuse what does not go together with drives: they and their driver count real time.

    Raises
    ------
    ArtibotError
        Naming the parameter.
    """
    for name, needed in (("rate", 1.0), ("wait_for_profile", False), ("start_paused", False)):
        if settings[name] != needed:
            raise ArtibotError(
                f"parameter {name}: found {settings[name]}, expected {needed} with with_driver: drives on a bus and "
                "their driver live in real time, which cannot be stretched or stopped"
            )


def switched(settings: Settings, name: str, automatic: bool) -> bool:
    """A parameter that is ``true``, ``false`` or ``auto``."""
    return automatic if settings[name] == "auto" else bool(settings[name] == "true")
