"""Command lines of which one part is the command's and one is ROS's."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from artibot_sim.errors import ArtibotError
from artibot_sim.resources import config_names, config_path


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


def parameter_files(names: Sequence[str]) -> list[str]:
    """``--ros-args`` that load parameter files, each a path or the name of a shipped one (``sim``)."""
    args: list[str] = []
    for name in filter(None, names):  # an empty text is a launch file's way of naming none
        shipped = config_names("nodes")
        path = config_path("nodes", name) if name in shipped else Path(name)
        if not path.is_file():
            raise ArtibotError(f"--params {name}: no such file; give an existing one or one of {', '.join(shipped)}")
        args += ["--params-file", str(path)]
    return ["--ros-args", *args, "--"] if args else []
