"""Splitting a command line between the command and ROS."""

from __future__ import annotations

from collections.abc import Sequence


def split_ros_args(argv: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the command's own arguments, and those between `--ros-args` and `--`, markers included."""
    own: list[str] = []
    ros: list[str] = []
    inside = False
    for word in argv:
        inside = inside or word == "--ros-args"
        (ros if inside else own).append(word)
        inside = inside and word != "--"
    return own, ros
