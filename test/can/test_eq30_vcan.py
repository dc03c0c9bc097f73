"""Eq. 30 on the wire: a closed loop drives a short Table 6 on a real vcan, and `candump` says what was sent.

Also the checker itself, held to a log in which one frame is wrong. ARTIBOT_TABLE6=full drives all of Table 6.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from can_kernel import has_vcan, in_uml
from eq30_log import check

from ros_helpers import ROOT

AGRIQ = str(ROOT / "config" / "agriq.yaml")


def table6(folder: Path) -> Path:
    """Table 6 with both three-quarter circles cut to a sixth."""
    text = (ROOT / "config" / "manoeuvres" / "table6_agriq.yaml").read_text(encoding="utf-8")
    assert text.count("270.0") == 2
    path = folder / "table6.yaml"
    path.write_text(text if os.environ.get("ARTIBOT_TABLE6") == "full" else text.replace("270.0", "60.0"), "utf-8")
    return path


@pytest.mark.vcan
def test_back_torque_frames_are_eq30_of_the_front_ones_of_the_cycle_before(tmp_path: Path) -> None:
    kappas = ["0.8", "0.65"]
    command = [sys.executable, str(Path(__file__).with_name("eq30_drive.py")), "vcan0", str(table6(tmp_path)), *kappas]
    if has_vcan():
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)
    else:
        done = in_uml("-m", "1000M", "-r", "70", *command, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    seen = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    assert [each["kappa"] for each in seen] == kappas
    for each in seen:
        assert each["phase"] == "ENABLED", each  # to the end of the plan
        assert not each["wrongs"], each
        assert each["checked"] > 250, each
        assert each["late"] < 0.1 * each["checked"], each
    gentle, hard = (each["largest"] for each in seen)
    assert hard > 1.5 * gentle > 100  # 0.54 and 0.25 of the front torques


def period(right: int, left: int, torque: int) -> list[str]:
    """SYNC, what both fronts measure, and the back targets: permille forwards. Right is mounted the other way round."""

    def frame(can_id: str, word: str, value: int) -> str:
        return f"(0.000000) vcan0 {can_id}#{word}00000000{(value & 0xFFFF).to_bytes(2, 'little').hex().upper()}"

    front = [frame("181", "3712", -right), frame("182", "3712", left)]
    return ["(0.000000) vcan0 080#", *front, frame("203", "0F00", -torque), frame("204", "0F00", torque)]


@pytest.mark.parametrize(
    ("torque", "verdict"),
    [(123, "checked"), (124, "checked"), (122, "wrong"), (125, "wrong"), (-124, "wrong"), (62, "late"), (0, "wrong")],
)
def test_the_checker_tells_right_from_late_and_wrong(torque: int, verdict: str) -> None:
    # (1/0.8 - 1)/2 * (47.64/28.93) = 0.2058: 123.5 of 600, and 61.8 of the 300 before
    log = [*period(200, 100, 62), *period(200, 100, 62), *period(400, 200, torque), "(0.010000) vcan0 080#"]
    found = check(log, AGRIQ, "0.8")
    counts = {"checked": found.checked - 2, "late": found.late, "wrong": len(found.wrong)}
    assert counts == {"checked": 0, "late": 0, "wrong": 0} | {verdict: 1}
