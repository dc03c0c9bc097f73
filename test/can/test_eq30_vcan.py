"""Eq. 30 on the wire: a closed loop drives a short Table 6 on a real vcan, and `candump` says what was sent.

Also the checker itself, held to logs in which a frame is wrong. `make eq30` drives all of Table 6
(ARTIBOT_TABLE6=full), with another kappa, too.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import pytest
from can_kernel import on_vcan
from eq30_log import check

from ros_helpers import ROOT

FULL = os.environ.get("ARTIBOT_TABLE6") == "full"
AGRIQ = str(ROOT / "config" / "agriq.yaml")


def table6(folder: Path) -> Path:
    """Table 6 with both three-quarter circles cut to a ninth."""
    text = (ROOT / "config" / "manoeuvres" / "table6_agriq.yaml").read_text(encoding="utf-8")
    assert text.count("270.0") == 2
    path = folder / "table6.yaml"
    path.write_text(text if FULL else text.replace("270.0", "30.0"), "utf-8")
    return path


@pytest.mark.vcan
def test_back_torque_frames_are_eq30_of_the_front_ones_of_the_cycle_before(
    tmp_path: Path,
) -> None:
    kappas = ["0.8", "0.65"] if FULL else ["0.65"]
    command = [sys.executable, str(Path(__file__).with_name("eq30_drive.py")), "vcan0", str(table6(tmp_path)), *kappas]
    done = on_vcan(command, "1000M")
    assert done.returncode == 0, done.stdout + done.stderr
    seen = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    assert [each["kappa"] for each in seen] == kappas
    for each in seen:
        assert each["phase"] == "ENABLED", json.dumps(each)  # to the end of the plan
        assert not each["wrongs"], json.dumps(each)
        assert each["stale"] <= each["counters"]["reads_cut_short"], json.dumps(each)
        assert each["checked"] > 500, each
        print(
            f"kappa {each['kappa']}: {each['checked']} periods are eq. 30, {each['late']} more had a late answer, "
            f"{each['stale']} are of older ones; "
            f"SYNC off by {each['sync_jitter_p99_ms']:.2f} ms (p99; most {each['sync_jitter_max_ms']:.1f})"
        )
    assert all(each["largest"] > 100 for each in seen)  # permille: there was something to share


def period(begin: float, right: int, left: int, torque: int, answered: float = 0.002) -> list[str]:
    """SYNC, what both fronts measure, and the back targets: permille forwards. Right is mounted the other way round."""

    def frame(at: float, can_id: str, word: str, value: int) -> str:
        data = f"{word}00000000{(value & 0xFFFF).to_bytes(2, 'little').hex().upper()}"
        return f"({begin + at:.6f}) vcan0 {can_id}#{data}"

    front = [frame(answered, "181", "3712", -right), frame(answered, "182", "3712", left)]
    back = [frame(0.0099, "203", "0F00", -torque), frame(0.0099, "204", "0F00", torque)]
    return [f"({begin:.6f}) vcan0 080#", *(front + back if answered < 0.0099 else back + front)]


@pytest.mark.parametrize(
    ("answered", "torque", "checked", "right"),
    [
        # (1/0.8 - 1)/2 * (47.64/28.93) = 0.2058: 123.5 of 600, and 61.8 of the 300 before
        *((0.002, torque, 3, right) for torque, right in ((123, True), (124, True), (122, False), (125, False))),
        *((0.002, torque, 3, False) for torque in (-124, 62, 0)),
        *((answered, torque, 2, True) for answered in (0.009, 0.00995) for torque in (124, 62)),
        *((answered, torque, 2, False) for answered in (0.009, 0.00995) for torque in (93, 0, -62)),
    ],
)
def test_the_checker_tells_right_from_wrong_and_says_where_two_answers_are_possible(
    answered: float, torque: int, checked: int, right: bool
) -> None:
    log = [*period(0.0, 200, 100, 62), *period(0.01, 200, 100, 62), *period(0.02, 400, 200, torque, answered)]
    found = check([*log, "(0.030000) vcan0 080#"], AGRIQ, "0.8")
    assert (found.checked, found.late, not found.wrong and not found.stale) == (checked, 3 - checked, right)
    assert found.stale == (torque == 62 and not right)  # eq. 30 of the answers before: not unnoticed, and distinguished
