"""The progress bar: on a terminal, for work that lasts; elsewhere a line now and then, for work that lasts long."""

from __future__ import annotations

import io
import os
import pty
import subprocess
import sys
from pathlib import Path

import pytest

from artibot_sim.progress import Bar

WORK = """
import sys, time
from artibot_sim.progress import Bar
lines = {"lines": float(sys.argv[2])} if len(sys.argv) > 2 and sys.argv[2] != "fail" else {}
with Bar(total=10.0, delay=float(sys.argv[1]), **lines) as bar:
    for what, size in (("reading", 8.0), ("drawing", 2.0)):
        report = bar.stage(what, size)
        for i in range(5):
            report(i / 5)
            time.sleep(0.12)
    if "fail" in sys.argv:
        raise KeyboardInterrupt
"""


def on_a_terminal(*args: str) -> str:
    """What the work writes to a terminal as its standard error."""
    ours, theirs = pty.openpty()
    environment = {**os.environ, "TERM": "xterm", "COLUMNS": "100"}
    process = subprocess.Popen(
        [sys.executable, "-c", WORK, *args], stderr=theirs, env=environment, cwd=Path(__file__).parents[1]
    )
    os.close(theirs)
    said = b""
    while True:
        try:
            part = os.read(ours, 65536)
        except OSError:  # Linux says so when the last writer has gone
            break
        if not part:
            break
        said += part
    process.wait()
    os.close(ours)
    return said.decode()


def test_a_terminal_sees_stages_shares_and_the_time_left() -> None:
    said = on_a_terminal("0")
    assert said.index("reading") < said.index("drawing")
    shares = [float(word[:-1]) for word in said.replace(",", "").split() if word.endswith("%")]
    assert len(shares) >= 8 and shares == sorted(shares) and 80 <= shares[-1] <= 100
    assert "0:0" in said and " left" in said
    assert said.rindex("\x1b[2K") > said.rindex("drawing"), "it is gone in the end"


def test_short_work_shows_nothing() -> None:
    assert on_a_terminal("60") == ""


def test_the_cursor_comes_back_after_ctrl_c() -> None:
    said = on_a_terminal("0", "fail")
    assert said.rindex("\x1b[?25h") > said.rindex("\x1b[?25l")


def test_ctrl_c_says_that_what_was_begun_is_lost() -> None:
    """Unless whoever works says what is kept."""
    said = on_a_terminal("0", "fail")
    assert "interrupted (reading)" in said or "interrupted (drawing)" in said
    assert "what was not finished is lost" in said
    with pytest.raises(KeyboardInterrupt), Bar(kept=True):
        raise KeyboardInterrupt


def test_a_pipe_gets_a_line_now_and_then_of_long_work() -> None:
    command = [sys.executable, "-c", WORK, "0", "0.3"]
    run = subprocess.run(command, capture_output=True, cwd=Path(__file__).parents[1], text=True)
    lines = run.stderr.splitlines()
    assert 2 <= len(lines) <= 5, "1.2 s of work, a line every 0.3 s"
    assert lines[0].startswith("reading: ") and lines[0].endswith(" left")
    assert "\x1b" not in run.stderr and run.stdout == ""


def test_a_pipe_gets_nothing_of_short_work() -> None:
    run = subprocess.run([sys.executable, "-c", WORK, "0"], capture_output=True, cwd=Path(__file__).parents[1])
    assert (run.returncode, run.stdout, run.stderr) == (0, b"", b"")


@pytest.mark.parametrize("total", [None, 0.0, 5.0])
def test_any_total_will_do(total: float | None, monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = io.StringIO()
    monkeypatch.setattr(terminal, "isatty", lambda: True)
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    with Bar(total, delay=0.0, period=0.0) as bar:
        bar.show(3.0, "work", "a note")
        bar.stage("more", 1.0)(2.0)
    assert all(word in terminal.getvalue() for word in ("work", "a note", "more"))
