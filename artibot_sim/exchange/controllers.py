"""What a robot's model says to other controllers and filters: parameter files of ROS 2 packages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from artibot_sim.exchange.turning import PLACES, Differential, DrawnDrives, spread, turn_speed
from artibot_sim.model import WHEEL_JOINTS, Robot
from artibot_sim.progress import Report

RATE = 50.0
"""Hz at which the filter publishes."""
_SIDEWAYS = 0.02
"""Leftward speed over yaw rate, in tracks, up to which `vy = 0` is no wrong measurement."""
_SUREST = 1e-6
"""Least variance, (m/s)² or (rad/s)²: encoders and uneven ground, and a filter must not divide by nothing."""


def diff_drive_controller(
    grounds: Mapping[str, Robot], speed: float | None = None, progress: Report | None = None
) -> str:
    """Return the parameters of ros2_controllers' `diff_drive_controller`, a section for each ground.

    Parameters
    ----------
    grounds : name → the robot as identified on that ground; the first one's section is called
        ``diff_drive_controller``, the others' ``diff_drive_controller_NAME``.
    speed : of the turns, m/s.
    progress : is called with the share that is done.
    """
    advance = progress or (lambda _: None)
    lines = [
        "# Made by `artibot export … --to diff_drive_controller`: the multipliers of the differential drive that moves",
        "# most like the model in steady turns (docs/exchange.md); 95 % intervals come from the robot file's.",
    ]
    for number, (name, robot) in enumerate(grounds.items()):

        def part(share: float, begun: int = number) -> None:
            advance((begun + share) / len(grounds))

        section = "diff_drive_controller" if number == 0 else f"diff_drive_controller_{name}"
        lines += ["", *section_of(section, name, robot, spread(robot, speed, progress=part), speed)]
    return "\n".join(lines) + "\n"


def section_of(
    section: str, name: str, robot: Robot, found: DrawnDrives, speed: float | None, *,
    joints: Mapping[str, Sequence[str]] | None = None, ratio: float = 1.0,
) -> list[str]:  # fmt: skip
    """Return the lines of a controller's section.

    Parameters
    ----------
    section, name : what the section and the ground are called.
    robot, found, speed : the robot, the differential drive fitted to it, and at which speed of the turns, m/s.
    joints : side → the joints that turn it; by default the wheels.
    ratio : turns of a wheel for a turn of a joint.
    """
    front = joints or {"left": WHEEL_JOINTS[2:4], "right": WHEEL_JOINTS[0:2]}
    track, r_w, value = robot.front.i_y, robot.wheel.r_w, found.value
    rows = [
        ("wheel_separation", track, ""),
        ("wheel_radius", r_w * ratio, ""),
        ("wheel_separation_multiplier", value.separation / track, _interval(found, "separation", track)),
        ("left_wheel_radius_multiplier", value.radius_left / r_w, _interval(found, "radius_left", r_w)),
        ("right_wheel_radius_multiplier", value.radius_right / r_w, _interval(found, "radius_right", r_w)),
    ]
    return [
        f"# {name}: {_what(robot, value, speed)}",
        *(f"# {word}" for word in _warnings(robot, found)),
        f"{section}:",
        "  ros__parameters:",
        *(f"    {side}_wheel_names: [{', '.join(joints)}]" for side, joints in front.items()),
        *(f"    {key}: {number:.6g}{comment}" for key, number, comment in rows),
    ]


def _interval(found: DrawnDrives, name: str, nominal: float) -> str:
    interval = found.interval(name)
    return "" if interval is None else f"  # 95 %: {interval[0] / nominal:.4g} … {interval[1] / nominal:.4g}"


def _what(robot: Robot, value: Differential, speed: float | None) -> str:
    tracks = np.array(value.tracks) / robot.front.i_y
    turning = tracks[np.isfinite(tracks)]
    return (
        f"robot '{robot.name}' at {speed or turn_speed(robot):.2g} m/s; turn by turn the separation's multiplier is "
        f"{turning.min():.4g} … {turning.max():.4g}"
    )


def _warnings(robot: Robot, found: DrawnDrives) -> list[str]:
    """Say what a differential drive leaves out, and what was left out of the turns."""
    said = []
    if found.value.drift and abs(found.value.drift) > _SIDEWAYS * robot.front.i_y:
        said.append(
            f"in turns base_link moves {found.value.drift:+.3g} m to the left for each rad of yaw; this controller has "
            "no such term"
        )
    if robot.articulated:
        said.append("the front module; its back module follows, and turns tighter than about 3 tracks fold the rover")
    if left_out := sorted(set(robot.effects) & set(PLACES)):
        said.append(f"without {', '.join(left_out)}, which belong to a place")
    if not found.drawn:
        said.append("no interval: the robot file has none (`artibot identify` writes them)")
    return said


def robot_localization(robot: Robot, speed: float | None = None, progress: Report | None = None) -> str:
    """Return the parameters of robot_localization's `ekf_node` for a robot's odometry and gyroscope.

    Notes
    -----
    The filter takes how sure the odometry is from its messages. What a differential drive gets wrong on this ground,
    from turn to turn and within the robot file's intervals, stands in the header as the variances of its twist.
    """
    found = spread(robot, speed, progress=progress)
    value, sure = found.value, twist_variances(found)
    sideways = abs(value.drift) <= _SIDEWAYS * robot.front.i_y
    why = "" if sideways else f"  # no vy: base_link moves {value.drift:+.3g} m sideways for each rad of yaw"
    odometry = [[False] * 3, [False] * 3, [True, sideways, False], [False, False, True], [False] * 3]
    gyroscope = [[False] * 3, [False] * 3, [False] * 3, [False, False, True], [False] * 3]
    lines = [
        "# Made by `artibot export … --to robot_localization` for its `ekf_node` (docs/exchange.md). What makes /odom",
        f"# should know robot '{robot.name}' by: effective track {value.separation:.4g} m,",
        f"# wheel radii {value.radius_right:.4g} m (right), {value.radius_left:.4g} m (left).",
        "# Its twist's covariance on this ground, (m/s)^2 and (rad/s)^2:",
        f"# [0] {sure['vx']:.3g}, [7] {sure['vy']:.3g}, [35] {sure['yaw_rate']:.3g}.",
        "ekf_filter_node:",
        "  ros__parameters:",
        f"    frequency: {RATE:.1f}",
        "    two_d_mode: true",
        "    publish_tf: true",
        "    map_frame: map",
        "    odom_frame: odom",
        "    base_link_frame: base_link",
        "    world_frame: odom",
        "    odom0: odom",
        *_matrix("odom0_config", odometry, why),
        "    imu0: imu/data",
        *_matrix("imu0_config", gyroscope, ""),
    ]
    return "\n".join(lines) + "\n"


def _matrix(key: str, rows: Sequence[Sequence[bool]], comment: str) -> list[str]:
    words = [", ".join(str(entry).lower() for entry in row) for row in rows]
    indent = " " * (len(key) + 7)
    return [
        f"    {key}: [{words[0]},{comment}",
        *(f"{indent}{row}," for row in words[1:-1]),
        f"{indent}{words[-1]}]",
    ]


def twist_variances(found: DrawnDrives) -> dict[str, float]:
    """Return variances of forward and leftward speed, (m/s)², and yaw rate, (rad/s)², of a differential drive's twist.

    Mean squares of what it is off in the turns, and of what the intervals change about it.
    """
    table = np.array([(turn.right, turn.left, turn.speed, turn.drift, turn.yaw_rate) for turn in found.value.turns])
    off = {"vx": [0.0], "vy": [0.0], "yaw_rate": [0.0]}
    own = predicted(found.value, table[:, :2])
    off["vx"].append(float(np.mean((own[:, 0] - table[:, 2]) ** 2)))
    off["vy"].append(float(np.mean(table[:, 3] ** 2)))
    off["yaw_rate"].append(float(np.mean((own[:, 1] - table[:, 4]) ** 2)))
    others = [predicted(one, table[:, :2]) - own for one in found.drawn]
    if others:
        mean = np.mean(np.square(others), axis=(0, 1))
        off["vx"].append(float(mean[0]))
        off["yaw_rate"].append(float(mean[1]))
    return {name: max(sum(values), _SUREST) for name, values in off.items()}


def predicted(drive: Differential, wheels: np.ndarray) -> np.ndarray:
    """Return forward speed and yaw rate (n, 2) of a differential drive with wheel speeds (n, 2), right and left."""
    right, left = drive.radius_right * wheels[:, 0], drive.radius_left * wheels[:, 1]
    return np.column_stack([0.5 * (right + left), (right - left) / drive.separation])
