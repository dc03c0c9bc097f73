"""`artibot can` as a user calls it: decoded lines, CSV and JSON, the load, logs of candump, pipes that close."""

from __future__ import annotations

import csv
import io
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from bag_helpers import EPOCH, small_bag
from candump import line_of

from artibot_driver.config import config_from_parameters
from artibot_driver.dbc import dbc_text
from artibot_driver.frames import Frame, NmtCommand, nmt
from artibot_driver.rig import load_rig
from artibot_sim.cli import main
from artibot_sim.experiment import BagWriter
from artibot_sim.experiment.can_frames import CAN_QOS, CanFrame, encode_frame
from artibot_sim.experiment.messages import CAN_FRAME
from ros_helpers import ROOT

RIG = load_rig(config_from_parameters({}))
CODEC = RIG.codec
PERIODS = 200


def written() -> list[CanFrame]:
    """Two seconds of a bus."""
    frames: list[Frame] = [nmt(NmtCommand.START), CODEC.emcy(3, 0x8130, 0x10)]
    for k in range(PERIODS):
        frames += [
            CODEC.pdo("RPDO1", 2, (0x0F, 1000 * k, 0)),
            CODEC.sync(),
            CODEC.pdo("TPDO1", 2, (0x237, 1000 * k, -k)),
        ]
    return [
        CanFrame(EPOCH + 3_333_000 * i, frame.can_id, frame.data, len(frame.data)) for i, frame in enumerate(frames)
    ]


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bags") / "run"
    with BagWriter(folder, {"robot": "agriq"}, live=False) as writer:
        writer.register("/from_can_bus", CAN_FRAME, CAN_QOS)
        for frame in written():
            writer.write("/from_can_bus", encode_frame(frame), frame.stamp_ns, frame.stamp_ns)
    return folder


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("logs") / "candump.log"
    file.write_text("".join(line_of(frame) + "\n" for frame in written()))
    return file


def output(capsys: pytest.CaptureFixture[str], *args: object) -> str:
    assert main(["can", *map(str, args)]) == 0
    return capsys.readouterr().out


def refused(capsys: pytest.CaptureFixture[str], *args: object) -> str:
    assert main(["can", *map(str, args)]) == 2
    return capsys.readouterr().err


def test_a_line_for_each_frame(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = output(capsys, "decode", bag).splitlines()
    assert len(lines) == len(written())
    assert lines[0].split() == ["0.000000", "all", "NMT", "command", "start"]
    assert "back_right" in lines[1]
    assert "8130h heartbeat or life guarding missed" in lines[1]
    speed = RIG.scaling["front_left"].velocity.si(1000)
    assert f"target_velocity {speed:.6g} rad/s" in lines[5]
    raw = output(capsys, "decode", bag, "--raw").splitlines()
    assert "202  0F00E80300000000" in raw[5]
    assert "[1000]" in raw[5]


def test_a_log_of_candump_says_the_same(bag: Path, log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for form in ((), ("--raw",), ("--json",), ("--csv",)):
        assert output(capsys, "decode", log, *form) == output(capsys, "decode", bag, *form)


def test_standard_input_is_read_too(log: Path) -> None:
    command = [sys.executable, "-m", "artibot_sim.cli", "can", "decode", "-", "--kind", "nmt"]
    with open(log, encoding="ascii") as stream:
        done = subprocess.run(command, stdin=stream, cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.split() == ["0.000000", "all", "NMT", "command", "start"]


def test_json_and_csv_have_the_values_of_the_scaling(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picked = ("--node", "front_left", "--kind", "tpdo")
    objects = [json.loads(line) for line in output(capsys, "decode", bag, "--json", *picked).splitlines()]
    torque = RIG.scaling["front_left"].torque
    assert [o["values"]["torque_actual_value"]["raw"] for o in objects] == [-k for k in range(PERIODS)]
    assert objects[7]["values"]["torque_actual_value"]["value"] == torque.si(-7)
    assert objects[7]["stamp_ns"] == EPOCH + 3_333_000 * (2 + 3 * 7 + 2)
    rows = list(csv.DictReader(io.StringIO(output(capsys, "decode", bag, "--csv", *picked))))
    torques = [float(row["value"]) for row in rows if row["name"] == "torque_actual_value"]
    assert torques == [o["values"]["torque_actual_value"]["value"] for o in objects]
    assert {row["unit"] for row in rows if row["object"] == "606Ch"} == {"rad/s"}


def test_part_of_the_time(bag: Path, log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for source in (bag, log):
        lines = output(capsys, "decode", source, "--start", 0.5, "--end", 0.6).splitlines()
        times = [float(line.split()[0]) for line in lines]
        expected = [i * 3.333e-3 for i in range(len(written())) if 0.5 <= i * 3.333e-3 <= 0.6]
        assert times == pytest.approx(expected)


@pytest.fixture
def other_robot(tmp_path: Path) -> str:
    """A robot file whose motors are rated for twice the torque."""
    text = (ROOT / "config" / "agriq.yaml").read_text()
    changed = re.sub(r"(rated_torque: *\{value: )([0-9.]+)", lambda m: m[1] + str(2 * float(m[2])), text)
    assert changed != text
    (tmp_path / "other.yaml").write_text(changed)
    return str(tmp_path / "other.yaml")


def test_the_robot_is_the_recording_s_unless_given(
    tmp_path: Path, other_robot: str, capsys: pytest.CaptureFixture[str]
) -> None:
    frame = CanFrame(EPOCH, *CODEC.pdo("TPDO1", 2, (0x237, 0, 1000)), 8)
    with BagWriter(tmp_path / "run", {"robot": other_robot}, live=False) as writer:
        writer.register("/from_can_bus", CAN_FRAME, CAN_QOS)
        writer.write("/from_can_bus", encode_frame(frame), EPOCH, EPOCH)
    rated = RIG.scaling["front_left"].torque.si(1000)
    assert f"torque_actual_value {2 * rated:.6g} N m" in output(capsys, "decode", tmp_path / "run")
    assert f"torque_actual_value {rated:.6g} N m" in output(capsys, "decode", tmp_path / "run", "--robot", "agriq")
    assert f"torque_actual_value {rated:.6g} N m" in output(capsys, "decode", tmp_path / "run", "--params", "driver")


def test_the_load(bag: Path, log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = output(capsys, "load", bag)
    assert text == output(capsys, "load", log)
    assert f"{len(written())} frames in 2.0 s" in text
    (line,) = [line for line in text.splitlines() if line.split()[:1] == ["182"]]
    assert line.split()[1:5] == ["front_left", "TPDO1", str(PERIODS), "100.0"]
    halved = output(capsys, "load", bag, "--bitrate", "250000")
    percent = [float(each.split(" at most ")[1].split(" %")[0]) for each in (text, halved)]
    assert percent[1] == pytest.approx(2 * percent[0], abs=0.11)


def test_commands_to_single_nodes_are_one_identifier_of_all(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = [line_of(CanFrame(EPOCH, *nmt(NmtCommand.START, node), 2)) for node in (2, 3)]
    (tmp_path / "nmt.log").write_text("\n".join(lines) + "\n")
    assert output(capsys, "load", tmp_path / "nmt.log").splitlines()[1].split()[:4] == ["000", "all", "NMT", "2"]


def test_a_reader_that_goes_away_is_no_error(bag: Path) -> None:
    """Standard output's other end closes after the first line, as `| head -1` does."""
    for words in (("decode", str(bag)), ("decode", str(bag), "--json"), ("dbc",)):
        command = [sys.executable, "-m", "artibot_sim.cli", "can", *words]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        with subprocess.Popen(command, cwd=ROOT, env=dict(os.environ), **pipes) as process:  # type: ignore[call-overload]
            process.stdout.close() if words == ("dbc",) else (process.stdout.readline(), process.stdout.close())
            assert process.stderr.read() == b""
            assert process.wait(30) == 0


def test_what_cannot_be_read_is_refused_in_one_line(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plain = small_bag(tmp_path / "plain", 4)
    said = refused(capsys, "decode", plain)
    assert "no CAN frames: expected a topic of type can_msgs/msg/Frame, /from_can_bus by default, found" in said
    assert "/ground_truth/odom, /motor_torques" in said
    assert "no such file or folder" in refused(capsys, "decode", tmp_path / "absent")
    assert "expected front_right, front_left" in refused(capsys, "decode", bag, "--node", "frontleft")
    assert "nothing lies between them" in refused(capsys, "decode", bag, "--start", 2, "--end", 1)
    assert "no CAN frames on a topic 'x'" in refused(capsys, "decode", bag, "--topic", "x")
    assert "nowhere.yaml" in refused(capsys, "decode", bag, "--params", "nowhere.yaml")
    assert "no CAN frame in that time" in refused(capsys, "load", bag, "--start", 100)
    broken = tmp_path / "broken.log"
    broken.write_text("(1.5) can0 181#12\n(1.6) can0 what\n")
    assert "broken.log: line 2: found '(1.6) can0 what'" in refused(capsys, "decode", broken)


def test_the_dbc_is_that_of_the_module(other_robot: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert output(capsys, "dbc") == dbc_text(RIG)
    other = dbc_text(load_rig(config_from_parameters({"robot": other_robot})))
    assert output(capsys, "dbc", "--robot", other_robot) == other != dbc_text(RIG)


def test_the_settings_are_the_rig_s(capsys: pytest.CaptureFixture[str]) -> None:
    lines = output(capsys, "settings").splitlines()
    count = len(RIG.settings("front_right"))
    assert len(lines) == 4 * (1 + count)
    assert lines[0] == "front_right (node 1)"
    for line, setting in zip(lines[1:], RIG.settings("front_right"), strict=False):
        how, key, value, in_hex = line.split()[:4]
        assert how == ("written" if setting.written else "compared")
        assert (key, int(value)) == (f"{setting.index:04X}h:{setting.subindex}", setting.value)
        assert int(in_hex, 16) == setting.value & 0xFFFFFFFF
    (torque,) = [line for line in output(capsys, "settings", "--node", "back_left").splitlines() if "6072h" in line]
    assert torque.endswith(f"max_torque  {RIG.scaling['back_left'].torque_limit.si(int(torque.split()[2])):.6g} N m")
    assert "expected front_right" in refused(capsys, "settings", "--node", "driver")


def test_help_needs_neither_ros_nor_a_bus(capsys: pytest.CaptureFixture[str]) -> None:
    for words in ((), ("decode",), ("load",), ("dbc",), ("settings",), ("loopback",)):
        assert "Example" in output(capsys, *words, "--help")
