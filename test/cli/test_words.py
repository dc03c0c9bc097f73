"""The ``artibot`` command: words from a table, arguments handed on untouched, one line for bad input."""

from __future__ import annotations

import re
import subprocess
import sys
import types
import xml.etree.ElementTree as ET

import click
import pytest

from artibot_sim import cli
from artibot_sim.cli.words import COMMANDS, Word
from artibot_sim.errors import ArtibotError
from artibot_sim.version import __version__
from ros_helpers import ROOT


@pytest.fixture
def probe(monkeypatch: pytest.MonkeyPatch) -> types.ModuleType:
    """A module that stands for the word ``probe``: its ``main`` is up to the test."""
    module = types.ModuleType("artibot_probe")
    monkeypatch.setitem(sys.modules, "artibot_probe", module)
    monkeypatch.setitem(COMMANDS, "probe", Word("artibot_probe:main", "A probe."))
    return module


def run(*args: str) -> subprocess.CompletedProcess[str]:
    """Run ``artibot ARGS`` in a process of its own."""
    command = [sys.executable, "-m", "artibot_sim.cli", *args]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False)


def test_help_lists_every_word_with_its_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--help"]) == 0
    listing = capsys.readouterr().out
    for word, entry in COMMANDS.items():
        assert re.search(rf"^  {word} +{re.escape(entry.help)}$", listing, re.MULTILINE), word


@pytest.mark.parametrize("word", COMMANDS)
def test_each_word_has_help_with_an_example(word: str) -> None:
    done = run(word, "--help")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("Usage: ")
    assert re.search(rf"artibot {word}\b|ros2 run artibot_sim {word}\b", done.stdout.partition("\n")[2]), "no example"


@pytest.mark.parametrize("args", [["nonsense"], ["--nonsense"], ["plot", "--nonsense"]])
def test_a_wrong_word_or_option_is_status_2(args: list[str]) -> None:
    done = run(*args)
    assert done.returncode == 2
    assert "nonsense" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_word_that_is_like_one_is_answered_with_it() -> None:
    assert "did you mean 'reproduce'?" in run("reprodcue").stderr
    assert "did you mean" not in run("xyz").stderr


def test_versions_agree() -> None:
    manifest = ET.parse(ROOT / "package.xml").getroot()
    assert manifest.findtext("version") == __version__
    assert run("--version").stdout.split()[-1] == __version__


@pytest.mark.parametrize(
    "args",
    [
        ["--ros-args", "-p", "rate:=0"],
        ["--robot", "agriq", "--ros-args", "-r", "a:=b", "--", "--out", "x"],
        ["--help"],
        ["-", "--", "-x", ""],
    ],
)
def test_arguments_arrive_as_typed(probe: types.ModuleType, args: list[str]) -> None:
    seen: list[list[str]] = []
    probe.main = lambda argv: seen.append(argv) or 3
    assert cli.main(["probe", *args]) == 3
    assert seen == [args]


def test_the_executable_is_called_by_its_own_name(
    probe: types.ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    seen: list[list[str]] = []
    probe.main = seen.append
    monkeypatch.setattr(sys, "argv", ["/prefix/lib/artibot_sim/probe", "--ros-args"])
    assert cli.executable() == 0
    assert seen == [["--ros-args"]]
    monkeypatch.setattr(sys, "argv", ["/prefix/lib/artibot_sim/other"])
    assert cli.executable() == 2
    assert "expected one of sim," in capsys.readouterr().err


def test_bad_input_is_one_line_and_status_2(probe: types.ModuleType, capsys: pytest.CaptureFixture[str]) -> None:
    def main(argv: list[str]) -> int:
        raise ArtibotError("a.yaml: wheel.r_w: found -1,\n  expected more than 0; give the radius in m")

    probe.main = main
    assert cli.main(["probe"]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err == "artibot: a.yaml: wheel.r_w: found -1, expected more than 0; give the radius in m\n"


def test_a_click_command_is_named_in_its_help(probe: types.ModuleType, capsys: pytest.CaptureFixture[str]) -> None:
    @click.command()
    @click.option("--size", type=int)
    def main(size: int) -> int:
        return size

    probe.main = main
    assert cli.main(["probe", "--size", "5"]) == 5
    assert cli.main(["probe", "--help"]) == 0
    assert capsys.readouterr().out.startswith("Usage: artibot probe [OPTIONS]")
    assert cli.main(["probe", "--size", "large"]) == 2


@pytest.mark.parametrize("missing", ["rclpy", "rclpy.node", "nav_msgs", "std_srvs"])
def test_without_ros_the_mend_is_said(
    probe: types.ModuleType, capsys: pytest.CaptureFixture[str], missing: str
) -> None:
    def main(argv: list[str]) -> int:
        raise ModuleNotFoundError(f"No module named '{missing}'", name=missing)

    probe.main = main
    assert cli.main(["probe"]) == 2
    assert "needs ROS 2: source it, or pip install 'artibot_sim[ros]'" in capsys.readouterr().err


def test_other_missing_modules_are_faults_of_ours(probe: types.ModuleType) -> None:
    def main(argv: list[str]) -> int:
        raise ModuleNotFoundError("No module named 'artibot_sim.oops'", name="artibot_sim.oops")

    probe.main = main
    with pytest.raises(ModuleNotFoundError):
        cli.main(["probe"])


def test_interrupted_is_status_130(probe: types.ModuleType) -> None:
    def main(argv: list[str]) -> int:
        raise KeyboardInterrupt

    probe.main = main
    assert cli.main(["probe"]) == 130
