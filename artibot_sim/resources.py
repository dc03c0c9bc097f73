"""Where the files shipped with artibot are: robots, manoeuvres, node parameters, URDF, EDS.

They are data files of the package: ``config/`` in a checkout, ``share/artibot_sim/config`` once installed by pip or
colcon. Both are found from where this module lies, so nothing has to be sourced or set.
"""

from __future__ import annotations

import os
from functools import lru_cache
from pathlib import Path
from typing import Final

from artibot_sim.errors import ArtibotError

KINDS: Final = {
    "robots": ("", ".yaml"),
    "nodes": ("", ".yaml"),
    "manoeuvres": ("manoeuvres", ".yaml"),
    "sweeps": ("sweeps", ".yaml"),
    "columns": ("columns", ".yaml"),
    "urdf": ("urdf", ".urdf"),
    "eds": ("", ".eds"),
}
"""Kind of file → its folder below ``config`` and its suffix. Robots and nodes' parameters share a folder."""


@lru_cache(maxsize=1)
def config_folder() -> Path:
    """The folder ``config`` that belongs to this very copy of artibot.

    Raises
    ------
    ArtibotError
        When the package was copied somewhere without its data files.
    """
    here = Path(__file__).resolve()
    checkout = here.parents[1]
    if (checkout / "package.xml").is_file() and (checkout / "config").is_dir():
        return checkout / "config"
    for prefix in here.parents:
        folder = prefix / "share" / "artibot_sim" / "config"
        if folder.is_dir():
            return folder
    raise ArtibotError(
        f"{here.parent}: found neither config/ beside package.xml nor share/artibot_sim/config in a folder above; "
        "install artibot with pip or colcon, or run it from its checkout"
    )


def config_names(kind: str) -> tuple[str, ...]:
    """Names of the shipped files of a kind, sorted, without suffix.

    Parameters
    ----------
    kind : {"robots", "nodes", "manoeuvres", "sweeps", "columns", "urdf", "eds"}
    """
    folder, suffix = _place(kind)
    return tuple(sorted(path.stem for path in folder.glob(f"*{suffix}") if _is_kind(kind, path)))


def config_path(kind: str, name: str) -> Path:
    """Path of a shipped file.

    Parameters
    ----------
    kind : {"robots", "nodes", "manoeuvres", "sweeps", "columns", "urdf", "eds"}
    name : str
        Name without suffix, such as ``"agriq"``.

    Raises
    ------
    ArtibotError
        When there is no such file; the message lists those there are.
    """
    if name not in config_names(kind):
        raise ArtibotError(f"{kind}: there is no '{name}'; expected one of {', '.join(config_names(kind)) or '(none)'}")
    folder, suffix = _place(kind)
    return folder / f"{name}{suffix}"


def local_environment() -> dict[str, str]:
    """Variables that keep nodes to this machine and let them meet quickly and surely.

    With Fast DDS they speak over loopback as ``config/fastdds.xml`` has it, for what killed nodes leave in shared
    memory can keep later ones from finding each other; rmw_fastrtps heeds that file only where the range is another
    than LOCALHOST. A profile of Fast DDS that was set before stays, as does another middleware: then LOCALHOST it is.
    """
    names = ("FASTDDS_DEFAULT_PROFILES_FILE", "FASTRTPS_DEFAULT_PROFILES_FILE")  # the latter until Fast DDS 3
    profile = str(config_folder() / "fastdds.xml")
    middleware = os.environ.get("RMW_IMPLEMENTATION") or "rmw_fastrtps_cpp"
    if "fastrtps" not in middleware or any(os.environ.get(name) not in (None, "", profile) for name in names):
        return {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    # the older variable, where it is set, would bring LOCALHOST back
    older = {"ROS_LOCALHOST_ONLY": "0"} if "ROS_LOCALHOST_ONLY" in os.environ else {}
    return {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET", **older, **dict.fromkeys(names, profile)}


def _place(kind: str) -> tuple[Path, str]:
    if kind not in KINDS:
        raise ArtibotError(f"kind of file '{kind}': unknown; expected one of {', '.join(KINDS)}")
    folder, suffix = KINDS[kind]
    return config_folder() / folder, suffix


def _is_kind(kind: str, path: Path) -> bool:
    if KINDS[kind][0]:
        return True
    if path.suffix == ".eds":
        return True
    is_node = "ros__parameters:" in path.read_text(encoding="utf-8")  # what makes a YAML file ROS 2 parameters
    return is_node == (kind == "nodes")
