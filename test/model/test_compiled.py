"""The compiled code's surroundings: its cache, and what it leaves of other libraries."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from ros_helpers import ROOT

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


@pytest.mark.parametrize("left_out", ["coverage", "scipy", "garbage", "pieces", "coverage,scipy,garbage"])
def test_results_do_not_depend_on_tricks(left_out: str) -> None:
    """Those that change no loop's code: what they spare is there again, and the rollout is the same to the bit."""
    code = (
        "import sys\n" + ROLLOUT.replace("rollout(", "r = rollout(") + "print(r.q.tobytes().hex()[:4000])\n"
        "for name in ('coverage', 'scipy.linalg.blas', 'scipy.linalg'): print(name in sys.modules)\n"
    )

    def done(without: str) -> list[str]:
        environment = os.environ | {"ARTIBOT_WITHOUT": without}
        return subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment
        ).stdout.splitlines()

    plain, other = done(""), done(left_out)
    assert other[0] == plain[0]
    assert plain[2:] == ["False", "False"]
    assert other[2:] == [str("scipy" in left_out)] * 2


USER = (
    "import time; from artibot_sim import progress; heard = []; progress.compiling.append({hear}); "
    "import numpy as np; from artibot_sim.model import load_robot; from artibot_sim.model.equations import kinematics; "
    "kinematics.constraint(load_robot('agriq'), np.zeros(16)); "
    "print(heard, sum(sum(f.stats.cache_misses.values()) for f in vars(kinematics).values() if hasattr(f, 'stats')))"
)
"""Needs the smallest loop, and prints what it heard of compiling and how many functions it compiled."""
STUCK = "lambda begins: (print('compiling', flush=True), time.sleep(600))"


def started(folder: Path, hear: str = "heard.append", package: Path = ROOT) -> subprocess.Popen[str]:
    path = os.pathsep.join(filter(None, (str(package), os.environ.get("PYTHONPATH"))))
    environment = os.environ | {"ARTIBOT_CACHE_DIR": str(folder), "PYTHONPATH": path}
    return subprocess.Popen(
        [sys.executable, "-c", USER.format(hear=hear)], stdout=subprocess.PIPE, text=True, env=environment, cwd=package
    )


def test_one_process_compiles_for_all_and_one_that_is_killed_holds_up_nobody(tmp_path: Path) -> None:
    killed = started(tmp_path, STUCK)
    assert killed.stdout is not None and killed.stdout.readline() == "compiling\n"
    together = [started(tmp_path) for _ in range(2)]
    killed.kill()
    killed.communicate()
    said = [process.communicate(timeout=120)[0].rsplit(maxsplit=1) for process in together]
    (_, none), (heard, some) = sorted(said, key=lambda words: int(words[1]))
    assert int(none) == 0 < int(some)
    assert heard == "[True, False]"  # who compiles says so
    later = started(tmp_path).communicate(timeout=120)[0]
    assert later == "[] 0\n"  # and who finds it says nothing


def test_pieces_are_compiled_once_for_all_loops_that_have_them(tmp_path: Path) -> None:
    assert int(started(tmp_path).communicate(timeout=120)[0].rsplit(maxsplit=1)[1]) > 1
    (loop,) = tmp_path.rglob("kinematics._evaluate-*.nbi")
    loop.unlink()
    assert started(tmp_path).communicate(timeout=120)[0] == "[True, False] 1\n"


GIVEN = """
from artibot_sim.model.kernels.compilation import called, kernel
@called
def twice(f, x):
    return f(f(x))
@called
def more(x):
    return x + 1.5
@kernel
def loop(x):
    return twice(more, x)
print(loop(1.0), sum(loop.stats.cache_misses.values()))
"""


def test_what_is_given_a_function_is_kept_only_in_its_loops(tmp_path: Path) -> None:
    """A function differs from process to process: versions for it would never be found, and pile up."""
    (tmp_path / "given.py").write_text(GIVEN, encoding="utf-8")
    path = os.pathsep.join((str(tmp_path), str(ROOT), os.environ.get("PYTHONPATH", "")))
    environment = os.environ | {"ARTIBOT_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": path}
    said = []
    for _ in range(2):
        command = [sys.executable, "-c", "import given"]
        done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
        assert done.returncode == 0, done.stderr
        said.append(done.stdout)
    assert said[0].split()[0] == said[1].split()[0] == "4.0"
    assert said[1].split()[1] == "0"  # the loop is found, with all that it holds
    assert not [*tmp_path.rglob("given.twice-*.nbi")]
    assert [*tmp_path.rglob("given.more-*.nbi")]


def test_an_installed_copy_takes_what_the_checkout_compiled(tmp_path: Path) -> None:
    cache, copy = tmp_path / "cache", tmp_path / "copy"
    assert int(started(cache).communicate(timeout=120)[0].rsplit(maxsplit=1)[1]) > 0
    for part in ("artibot_sim", "config"):
        shutil.copytree(
            ROOT / part, copy / part, ignore=shutil.ignore_patterns("__pycache__"), copy_function=shutil.copyfile
        )
    shutil.copy(ROOT / "package.xml", copy)
    assert started(cache, package=copy).communicate(timeout=120)[0] == "[] 0\n"
    source = copy / "artibot_sim" / "model" / "equations" / "kinematics.py"
    source.write_text(source.read_text(encoding="utf-8") + "\n# changed\n", encoding="utf-8")
    assert started(cache, package=copy).communicate(timeout=120)[0] != "[] 0\n"
