"""A real SocketCAN, that of a user-mode kernel, carries frames both ways between python-can and can-utils."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from can_kernel import IN_UML, in_uml


@pytest.mark.vcan
def test_frames_cross_vcan_both_ways() -> None:
    count = 20
    done = in_uml(sys.executable, str(Path(__file__).with_name("exchange.py")), "vcan0", str(count))
    assert done.returncode == 0, done.stdout + done.stderr
    seen = json.loads(done.stdout.splitlines()[-1])
    assert seen["dumped"] == [f"{0x180 + k:03X}#{f'{k:02X}' * (k % 9)}" for k in range(count)]
    assert seen["received"] == [0x1F334455, True, "1122334455667788"]


@pytest.mark.vcan
def test_in_uml_hands_over_arguments_environment_and_status(monkeypatch: pytest.MonkeyPatch) -> None:
    words = ["two words", "it's", "$HOME", ""]
    monkeypatch.setenv("ARTIBOT_PROBE", "a 'quoted'\nvalue")
    code = "import os, sys; print(repr((sys.argv[1:], os.environ['ARTIBOT_PROBE'], os.getcwd()))); sys.exit(7)"
    done = in_uml(sys.executable, "-c", code, *words)
    assert done.returncode == 7, done.stdout + done.stderr
    assert done.stdout == repr((words, "a 'quoted'\nvalue", str(Path.cwd()))) + "\n"


@pytest.mark.vcan
def test_slow_motion_skips_what_is_slept_through() -> None:
    code = "from time import *; a, b = monotonic(), time(); sleep(900); print(monotonic() - a, time() - b)"
    done = in_uml("-s", "8", sys.executable, "-c", code, timeout=300.0)
    assert done.returncode == 0, done.stdout + done.stderr
    assert [float(word) for word in done.stdout.split()] == [pytest.approx(900.0, abs=0.5)] * 2


@pytest.mark.vcan
def test_a_signal_s_handler_that_copies_memory_spoils_no_copy_that_it_interrupts(tmp_path: Path) -> None:
    """User-mode Linux does not give AVX-512's registers back after a handler, and glibc copies with them."""
    program = tmp_path / "interrupted_copies"
    source = Path(__file__).with_name("interrupted_copies.c")
    subprocess.run(["cc", "-O1", "-o", str(program), str(source)], check=True)
    done = in_uml(str(program))
    assert (done.returncode, done.stdout) == (0, "0\n"), done.stdout + done.stderr


def test_in_uml_without_a_command_says_so() -> None:
    done = subprocess.run([str(IN_UML)], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (125, "")
    assert done.stderr == "in_uml.sh: no command given\n"
