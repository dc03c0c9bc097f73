"""tf2_msgs where no full ROS 2 is: built from its one message by ROS's own generators, for the tests of /tf.

The wheels of rclpy have no tf2_msgs, yet they have the generators, headers and libraries that make a package of
messages. So the tests publish real messages through the real middleware; their type hash is that of Jazzy's package.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

from ros_helpers import skip

DEFINITION = "geometry_msgs/TransformStamped[] transforms\n"
PACKAGE = "tf2_msgs"

GENERATORS = {
    "rosidl_generator_c.cli": "GenerateC",
    "rosidl_generator_py.cli": "GeneratePython",
    "rosidl_typesupport_c.cli": "GenerateCTypesupport",
    "rosidl_typesupport_fastrtps_c.cli": "GenerateFastRTPSCTypesupport",
}
INTROSPECTION = ("rosidl_typesupport_introspection_c.cli", "GenerateIntrospectionCTypesupport")
"""Writes a file of the same name as GenerateC, and so into a folder of its own."""

LIBRARIES = {
    "rosidl_generator_c": (
        "gcc", "c", ["msg/detail/tf_message__description.c", "msg/detail/tf_message__functions.c",
                     "msg/detail/tf_message__type_support.c"],
        ["geometry_msgs__rosidl_generator_c", "rosidl_runtime_c"],
    ),
    "rosidl_typesupport_fastrtps_c": (
        "g++", "c", ["msg/detail/tf_message__type_support_c.cpp"],
        ["tf2_msgs__rosidl_generator_c", "geometry_msgs__rosidl_typesupport_fastrtps_c",
         "rosidl_typesupport_fastrtps_c", "fastcdr"],
    ),
    "rosidl_typesupport_introspection_c": (
        "gcc", "introspection", ["msg/detail/tf_message__type_support.c"],
        ["tf2_msgs__rosidl_generator_c", "geometry_msgs__rosidl_typesupport_introspection_c",
         "rosidl_typesupport_introspection_c"],
    ),
    "rosidl_typesupport_c": (
        "g++", "c", ["msg/tf_message__type_support.cpp"], ["tf2_msgs__rosidl_generator_c", "rosidl_typesupport_c"],
    ),
    "rosidl_generator_py": (
        "gcc", "c", ["msg/_tf_message_s.c"], ["tf2_msgs__rosidl_generator_c", "geometry_msgs__rosidl_generator_py"],
    ),
}  # fmt: skip
"""Library → compiler, folder of its sources, sources, libraries it needs; in the order of their needs."""


def environment(folder: Path) -> dict[str, str]:
    """Variables with which a process finds tf2_msgs: none where it is installed, else a package built in `folder`.

    Parameters
    ----------
    folder : path
        Empty, and kept as long as the processes run.
    """
    if importlib.util.find_spec(PACKAGE):
        return {}
    missing = [name for name in ("gcc", "g++") if shutil.which(name) is None]
    if missing or not (Path(sys.prefix) / "include" / "rosidl_runtime_c").is_dir():
        skip(f"tf2_msgs is not installed and cannot be built: no {' '.join(missing) or 'headers of rosidl'}")
    script = [sys.executable, "-W", "ignore", __file__, str(folder)]
    subprocess.run(script, check=True, capture_output=True, env={**os.environ, "AMENT_PREFIX_PATH": sys.prefix})
    installed = folder / "installed"
    before = os.environ.get("LD_LIBRARY_PATH", "")
    return {
        "PYTHONPATH": str(installed),
        "LD_LIBRARY_PATH": os.pathsep.join(filter(None, [str(installed), before])),
    }


def build(folder: Path) -> None:
    """Generate, compile and lay out the package below ``folder/installed``."""
    _generate(folder)
    installed = folder / "installed"
    module = installed / PACKAGE
    (module / "msg").mkdir(parents=True)
    for name, (compiler, kind, sources, needed) in LIBRARIES.items():
        _compile(folder, compiler, kind, sources, installed / f"lib{PACKAGE}__{name}.so", needed)
    entry, needed = "_tf2_msgs_s.ep.rosidl_typesupport_c.c", ["rosidl_generator_py", "rosidl_generator_c"]
    target = module / f"tf2_msgs_s__rosidl_typesupport_c{sysconfig.get_config_var('EXT_SUFFIX')}"
    needs = [f"{PACKAGE}__{each}" for each in (*needed, "rosidl_typesupport_c")]
    _compile(folder, "gcc", "c", [entry], target, [*needs, "rosidl_runtime_c"])
    for path in (folder / "c" / "msg").glob("*.py"):
        shutil.copy(path, module / "msg")
    (module / "__init__.py").touch()


def _generate(folder: Path) -> None:
    from rosidl_cli.command.hash.api import generate_type_hashes
    from rosidl_cli.command.translate.api import translate

    os.chdir(folder)
    Path("msg").mkdir()
    Path("msg/TFMessage.msg").write_text(DEFINITION, encoding="ascii")
    share, out = [str(Path(sys.prefix) / "share")], Path("c")
    out.mkdir()
    given = {"package_name": PACKAGE, "include_paths": share, "output_path": out}
    idl = translate(interface_files=["msg/TFMessage.msg"], output_format="idl", input_format="msg", **given)
    generate_type_hashes(interface_files=idl, **given)
    hashes = [str((out / "msg" / "TFMessage.json").resolve())]
    for module, name in GENERATORS.items():
        generator = getattr(importlib.import_module(module), name)(name)
        named = {"type_description_files": hashes} if name == "GenerateC" else {}
        generator.generate(PACKAGE, idl, share, out, **named)
    shutil.copytree(out, "introspection")
    module, name = INTROSPECTION
    getattr(importlib.import_module(module), name)(name).generate(PACKAGE, idl, share, Path("introspection"))


def _compile(folder: Path, compiler: str, kind: str, sources: list[str], target: Path, needed: list[str]) -> None:
    import numpy as np

    own = folder / f"include_{kind}"
    own.mkdir(exist_ok=True)
    if not (own / PACKAGE).exists():
        (own / PACKAGE).symlink_to(folder / kind)
    include = Path(sys.prefix) / "include"
    places = [own, include, *filter(Path.is_dir, include.iterdir()), sysconfig.get_path("include"), np.get_include()]
    subprocess.run(
        [
            *(compiler, "-O1", "-fPIC", "-shared", *(f"-I{place}" for place in places)),
            *(str(folder / kind / source) for source in sources),
            *("-o", str(target), f"-L{folder / 'installed'}", f"-L{Path(sys.prefix) / 'lib'}"),
            *(f"-l{name}" for name in needed),
        ],
        check=True,
    )


if __name__ == "__main__":
    build(Path(sys.argv[1]))
