"""The compiled code's surroundings: its cache, and what it leaves of other libraries."""

from __future__ import annotations

import subprocess
import sys

import pytest

LATER = {
    "scipy.linalg works": "import scipy.linalg as l; assert l.det([[2.0, 0.0], [0.0, 3.0]]) == 6",
    "its BLAS is importable": "from scipy.linalg import cython_blas; import scipy.linalg.cython_blas",
    "numba has a BLAS": "import numba; assert numba.njit(lambda a: np.dot(a, a))(2 * np.eye(2))[1, 1] == 4",
    "scipy.optimize works": "import scipy.optimize as o; assert abs(o.brentq(lambda x: x - 1, 0, 3) - 1) < 1e-9",
}


@pytest.mark.parametrize("code", LATER.values(), ids=LATER.keys())
def test_other_libraries_are_whole_after_a_rollout(code: str) -> None:
    before = (
        "import numpy as np; from artibot_sim.model import *; "
        "v = np.full((3, 4), np.nan); v[:, :2] = 1.0; rollout(load_robot('agriq'), Commands(0.01, v)); "
    )
    done = subprocess.run([sys.executable, "-c", before + code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
