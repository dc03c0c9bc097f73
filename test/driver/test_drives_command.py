"""``artibot drives``, as typed: on a real bus, on the rover and on a bench, ended by a signal."""

from __future__ import annotations

import re
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from frame_master import FrameMaster

from artibot_driver.bus import open_bus
from artibot_driver.cia402 import DriveState
from artibot_driver.rig import load_rig
from artibot_sim.cli import main
from artibot_sim.nodes.drives.loop import drive_config
from ros_helpers import NodeProcess, NodeStarter


@pytest.fixture
def start(tmp_path: Path) -> Iterator[NodeStarter]:
    starter = NodeStarter(tmp_path, {"ROS_DISTRO": ""})
    try:
        yield starter
    finally:
        starter.end()


def drives(start: NodeStarter, channel: str, *options: object) -> NodeProcess:
    node = start("drives", "--interface", "remote", "--channel", channel, "--every", 0.5, *options)
    node.wait_for("all switch on disabled")
    return node


@pytest.mark.parametrize(("options", "number"), [((), signal.SIGINT), (("--bench",), signal.SIGTERM)])
def test_a_master_drives_them_and_a_signal_ends_them(start: NodeStarter, channel: str, options, number) -> None:
    node = drives(start, channel, *options)
    assert "drives 1 front_right, 2 front_left, 3 back_right, 4 back_left on remote ws://127.0.0.1" in node.output
    rig = load_rig(drive_config("agriq", interface="remote", channel=channel))
    with open_bus("remote", channel) as bus:
        master = FrameMaster(bus, rig)
        master.set_up()
        master.lead_to(DriveState.OPERATION_ENABLED)
        master.run(1.5, lambda t: dict.fromkeys(("front_right", "front_left"), 60.0 * min(1.0, t)))
        for motor in ("front_right", "front_left"):
            assert master.si(motor, "velocity") == pytest.approx(60.0, rel=0.01)
        assert 30.0 < master.si("front_left", "position") < 90.0
    node.wait_for("all operation enabled; motors at 60.0 60.0")
    node.wait_for("fault")  # nobody beats any more
    if not options:
        seen = [float(x) for x in re.findall(r"rover at (\S+) m", node.output)]
        assert seen[0] == 0.0
        assert 0.2 < seen[-1] < 0.6
    node.send(number)
    assert node.wait() == 0
    assert "Traceback" not in node.output


def test_they_end_by_themselves_when_told_so(start: NodeStarter, channel: str) -> None:
    node = drives(start, channel, "--bench", "--duration", 0.5)
    assert node.wait() == 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--robot", "husky"), "robot 'husky': is rigid and has two motors; expected a robot with four drives"),
        (("--channel", "ws://127.0.0.1:9/"), "nobody answers there"),
        (("--params", "nobody"), "nobody"),
        (("--every", "nan"), "nan"),
    ],
)
def test_bad_input_is_refused_in_a_line(
    channel: str, capsys: pytest.CaptureFixture[str], options: tuple[str, ...], message: str
) -> None:
    assert main(["drives", "--interface", "remote", "--channel", channel, *options]) == 2
    said = capsys.readouterr().err
    assert message in said and "Traceback" not in said
