"""`artibot diagnose`: a real run writes a whole folder; what cannot be used is one line before any work."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from diagnose.searches import FEW, try_only

from artibot_sim.cli import main
from artibot_sim.diagnose import Options
from artibot_sim.experiment import write_channels
from artibot_sim.identify.synthetic import synthetic
from artibot_sim.model import load_robot
from artibot_sim.model.effects import EFFECTS
from artibot_sim.planning import Arc, Dwell, Manoeuvre, Ramp, Slalom, Stop
from artibot_sim.report.diagnosis.files import load
from artibot_sim.report.diagnosis.page import page_of
from artibot_sim.report.diagnosis.sentences import headline
from artibot_sim.version import __version__

TURNS = Manoeuvre(
    "turns",
    (Dwell(0.5), Ramp(speed=0.6), Slalom(curvature=0.45, wavelength=5.0, periods=1.0), Arc(radius=1.6, angle=-2.0),
     Stop()),
    a_max=0.5, blend=0.3,
)  # fmt: skip


@pytest.fixture(scope="module")
def drives(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two recordings of a rover that nothing is wrong with."""
    folder = tmp_path_factory.mktemp("drives")
    paths = []
    for k in range(2):
        drive = synthetic(load_robot("agriq"), TURNS, kappa=0.8, seed=k, name=f"run{k}")
        tables = {key: (channel.t_ns, dict(channel.columns)) for key, channel in drive.channels.items()}
        paths.append(write_channels(folder / f"run{k}", tables, dict(drive.metadata)))
    return paths


def test_a_diagnosis_is_a_whole_folder(
    drives: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    try_only(monkeypatch, *FEW)
    out = tmp_path / "new" / "found"
    given = [str(drives[0]), "--holdout", str(drives[1]), "--robot", "agriq", "--out", str(out), "--horizon", "4"]
    assert main(["diagnose", *given]) == 0
    assert {path.name for path in out.iterdir()} == {
        "diagnosis.json", "extended.yaml", "baseline.yaml", "best.yaml", "report.html", "details.npz",
    }  # fmt: skip
    document = json.loads((out / "diagnosis.json").read_text())
    assert document["schema"] == "artibot/diagnosis/1" and document["horizon"] == 4.0
    assert document["bags"] == ["run0"] and document["holdout"] == ["run1"]
    assert set(document["baseline"]) >= {"position", "yaw_rate", "articulation_yaw", "torque_front", "torque_back"}
    assert {entry["effect"] for entry in document["ranking"]} <= set(EFFECTS)
    found = load(out)
    assert page_of(found, __version__) == (out / "report.html").read_bytes()
    assert load_robot(out / "extended.yaml").contact.k_l == found.extended.contact.k_l
    assert not load_robot(out / "baseline.yaml").effects
    printed = " ".join(capsys.readouterr().out.split())
    assert headline(found) in printed and "report.html" in printed
    assert main(["report", str(out)]) == 0


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"--out": "drives/run0/metadata.yaml"}, "it is a file"),
        ({"--out": "drives/run0/metadata.yaml/x"}, "name another folder"),
        ({"--out": "/proc/none/found"}, "/proc/none cannot be made"),
        ({"--out": "drives/" + 300 * "n"}, "File name too long"),
        ({"--robot": "nobody"}, "nobody"),
        ({"--topic": "/odom"}, "expected WANTED=FOUND"),
        ({"--topic": "/imu/data=/nowhere"}, "/nowhere"),
        ({"--horizon": "0.01"}, "horizon"),
        ({"--robot": "husky"}, "--robot"),
        ({"": "absent"}, "absent"),
    ],
)
def test_what_cannot_be_used_is_one_line(
    drives: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
    change: dict[str, str], said: str,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    (tmp_path / "drives").symlink_to(drives[0].parent)
    options = {"": "drives/run0", "--robot": "agriq", "--out": "found"} | change
    arguments = [word for key, value in options.items() for word in ((key, value) if key else (value,))]
    assert main(["diagnose", *arguments]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and said in error
    assert {path.name for path in tmp_path.iterdir()} == {"drives"}


@pytest.mark.parametrize("option", [["--prior-odds", "0"], ["--false-alarms", "1"], ["--workers", "0"]])
def test_an_option_out_of_range_is_refused(option: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["diagnose", "run0", "--robot", "agriq", "--out", "found", *option]) == 2
    assert option[0] in capsys.readouterr().err


def test_ctrl_c_says_that_the_same_command_goes_on(
    drives: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Once something is finished; what was broken off leaves no folder of results."""

    def interrupted(*_args: object, options: Options, **_rest: object) -> None:
        options.parts.begin("key")
        options.parts.once("soil identified", lambda: 1)
        raise KeyboardInterrupt

    monkeypatch.setattr("artibot_sim.diagnose.diagnose", interrupted)
    out = tmp_path / "found"
    assert main(["diagnose", str(drives[0]), "--robot", "agriq", "--out", str(out)]) == 130
    assert "the same command goes on" in capsys.readouterr().err
    assert not out.exists() and (tmp_path / "found.unfinished" / "000").exists()


def test_a_killed_diagnosis_is_told_by_the_next_call_and_a_signal_at_once(drives: list[Path], tmp_path: Path) -> None:
    """A process that was killed, as the system does where memory is short, can say nothing by itself."""
    out, running = tmp_path / "found", tmp_path / "found.unfinished" / "running"
    diagnose = [sys.executable, "-m", "artibot_sim.cli", "diagnose"]
    command = [*diagnose, *map(str, drives), "--robot", "agriq", "--out", str(out)]

    def ended_by(number: signal.Signals) -> tuple[int, str]:
        with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
            give_up = time.monotonic() + 120.0
            while not (running.exists() and json.loads(running.read_text())["pid"] == process.pid):
                assert process.poll() is None and time.monotonic() < give_up
                time.sleep(0.02)
            process.send_signal(number)
            said = process.communicate(timeout=60.0)[1]
        return process.returncode, said

    assert ended_by(signal.SIGKILL)[0] == -signal.SIGKILL
    status, said = ended_by(signal.SIGTERM)
    assert status == 128 + signal.SIGTERM
    assert "was killed after" in said and "perhaps for lack of memory: it had taken" in said
    assert "ended by SIGTERM: " in said
    assert not out.exists() and not running.exists(), "what was told is not told again"
