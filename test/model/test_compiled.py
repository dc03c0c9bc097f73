"""The compiled code's surroundings: its cache, and what it leaves of other libraries."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

LATER = {
    "scipy.linalg works": "import scipy.linalg as l; assert l.det([[2.0, 0.0], [0.0, 3.0]]) == 6",
    "its BLAS is importable": "from scipy.linalg import cython_blas; import scipy.linalg.cython_blas",
    "numba has a BLAS": "import numba; assert numba.njit(lambda a: np.dot(a, a))(2 * np.eye(2))[1, 1] == 4",
    "scipy.optimize works": "import scipy.optimize as o; assert abs(o.brentq(lambda x: x - 1, 0, 3) - 1) < 1e-9",
}


ROLLOUT = (
    "import numpy as np; from artibot_sim.model import *; "
    "v = np.full((3, 4), np.nan); v[:, :2] = 1.0; rollout(load_robot('agriq'), Commands(0.01, v))\n"
)


def test_other_libraries_are_whole_after_a_rollout() -> None:
    """Each looked at in a process that has done a rollout and nothing else since."""
    code = (
        f"import os, sys, traceback\n{ROLLOUT}"
        "def look(code):\n"
        "    try: exec(code, {'np': np})\n"
        "    except BaseException: traceback.print_exc(); sys.stderr.flush(); os._exit(1)\n"
        "    os._exit(0)\n"
        f"for name, code in {LATER!r}.items():\n"
        "    child = os.fork() or look(code)\n"
        "    print(name, os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), sep=': ')\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout.splitlines() == [f"{name}: 0" for name in LATER], done.stderr


def test_compilation_is_announced_once_and_a_cached_loop_never(tmp_path: Path) -> None:
    """Of the smallest loop: all are compiled in the same way."""
    code = (
        "from artibot_sim import progress; heard = []; progress.compiling.append(heard.append); "
        "import numpy as np; from artibot_sim.model import load_robot; "
        "from artibot_sim.model.kinematics import constraint; "
        "constraint(load_robot('agriq'), np.zeros(16)); print(heard)"
    )
    runs = [
        subprocess.run(
            [sys.executable, "-c", code],
            capture_output=True,
            text=True,
            env=os.environ | {"ARTIBOT_CACHE_DIR": str(tmp_path)},
        )
        for _ in range(2)
    ]
    assert [run.stdout.split() for run in runs] == [["[True,", "False]"], ["[]"]], [run.stderr for run in runs]
