"""Where tests on a real CAN run: on this machine's kernel if it has vcan0, else in a user-mode one.

That one is emulated, and slow: its clock is slowed down as much, so that what keeps time there does so whatever else
this machine does.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

from ros_helpers import ROOT, skip

IN_UML = ROOT / "scripts" / "in_uml.sh"
SLOWNESS = 8
TOOLS = {"linux.uml": "user-mode-linux", "insmod": "kmod", "ip": "iproute2", "candump": "can-utils", "cc": "gcc"}


def has_vcan() -> bool:
    """Whether this kernel has vcan0, up, and we may make others: the suites put interfaces down."""
    flags = Path("/sys/class/net/vcan0/flags")
    return flags.is_file() and int(flags.read_text(encoding="ascii"), 0) & 1 == 1 and os.geteuid() == 0


def on_vcan(command: Sequence[str], memory: str = "256M", timeout: float = 600.0) -> subprocess.CompletedProcess[str]:
    """Run `command` where there is a vcan0."""
    if has_vcan():
        return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=timeout, check=False)
    return in_uml("-1", "-m", memory, "-s", str(SLOWNESS), *command, timeout=timeout)


def in_uml(*command: str, timeout: float = 120.0) -> subprocess.CompletedProcess[str]:
    """Run `command` in the user-mode kernel, or skip where its Debian packages are missing."""
    path = "/usr/local/bin:/usr/bin:/bin:/usr/sbin:/sbin"
    missing = sorted(package for tool, package in TOOLS.items() if shutil.which(tool, path=path) is None)
    if missing:
        skip(f"no user-mode kernel with CAN here: apt-get install {' '.join(missing)}")
    with subprocess.Popen([str(IN_UML), *command], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as done:
        try:
            output, errors = done.communicate(timeout=timeout)
        finally:
            done.terminate()  # not killed: it puts its kernel away
    return subprocess.CompletedProcess(done.args, done.returncode, output, errors)
