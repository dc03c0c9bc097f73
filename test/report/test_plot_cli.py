"""``artibot plot``: files, table and errors as a user meets them."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from bag_helpers import ROOT

from artibot_sim.cli import main
from artibot_sim.experiment import Experiment, read_bag, write_channels
from artibot_sim.report.measures import measure


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    monkeypatch.setenv("COLUMNS", "200")


def there() -> set[str]:
    return {path.name for path in Path().iterdir()}


def test_a_picture_is_made_by_default(bags: list[Path], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plot", str(bags[0])]) == 0
    assert there() == {"kappa_0.6.png"}
    assert "wrote kappa_0.6.png" in capsys.readouterr().out


def test_json_is_what_measures_says(bags: list[Path], runs: list[Experiment]) -> None:
    assert main(["plot", *map(str, bags), "--json", "out.json"]) == 0
    assert there() == {"out.json"}
    content = json.loads(Path("out.json").read_text(encoding="utf-8"))
    assert content["schema"] == "artibot/plot/1"
    assert [bag["metrics"] for bag in content["bags"]] == [measure(run).as_dict() for run in runs]
    assert [bag["metadata"]["kappa"] for bag in content["bags"]] == ["0.6", "1.0"]


def test_the_table_says_what_json_says(bags: list[Path], run: Experiment, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plot", str(bags[0]), "--png", "a.png", "--html", "a.html"]) == 0
    assert there() == {"a.png", "a.html"}
    out = capsys.readouterr().out
    found = measure(run)
    (row,) = [line for line in out.splitlines() if "eq. 31" in line]
    assert row.split()[-1] == f"{100 * found.e_gamma['true']:.2f}".replace("-", "−")
    (row,) = [line for line in out.splitlines() if "radius, mean" in line]
    assert row.split()[-3:] == [f"{found.radius[kind]:.2f}" for kind in ("planned", "odometric", "true")]
    assert Path("a.html").read_text(encoding="utf-8").startswith("<!DOCTYPE html>")


def test_the_first_screen_says_how_far_from_its_plan_it_ended(bags: list[Path], run: Experiment) -> None:
    """Not only in a table below eight charts."""
    assert main(["plot", str(bags[0]), "--html", "a.html"]) == 0
    head = Path("a.html").read_text(encoding="utf-8").partition("<main>")[0].replace("\u00a0", " ")
    found = measure(run)
    off = found.e_x["true"] * found.path_length["planned"]
    assert f"Ended {off:.2f} m from where it was planned to end" in head
    turned = "less" if found.e_gamma["true"] < 0.0 else "more"
    assert f"it turned {100 * abs(found.e_gamma['true']):.1f} % {turned} than planned" in head


def test_a_part_can_be_drawn(bags: list[Path]) -> None:
    assert main(["plot", str(bags[0]), "--start", "2", "--end", "9", "--json", "a.json"]) == 0
    (bag,) = json.loads(Path("a.json").read_text(encoding="utf-8"))["bags"]
    assert bag["duration"]["value"] == pytest.approx(7.0, abs=0.1)
    assert bag["metrics"]["window"] == pytest.approx({"unit": "s", "start": 2.0, "end": 9.0}, abs=0.1)


def test_a_topic_can_be_renamed(bags: list[Path], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plot", str(bags[0]), "--topic", "/ground_truth/odom=/odom", "--json", "a.json"]) == 0
    (bag,) = json.loads(Path("a.json").read_text(encoding="utf-8"))["bags"]
    assert abs(bag["metrics"]["e_x"]["true"]) < 1e-3  # now the odometry is taken for the truth


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (["nowhere"], "nowhere"),
        (["empty"], "empty"),
        (["foreign.mcap"], "foreign.mcap"),
        (["BAG", "--robot", "nobody"], "nobody"),
        (["BAG", "--png", "no/such/folder/a.png"], "no/such/folder/a.png: cannot be written"),
        (["BAG", "--png", "a.png", "--html", "no/such/folder/a.html"], "a.html: cannot be written"),
        (["BAG", "--png", "a.png", "--html", "a.png"], "a.png: asked for twice"),
        (["BAG", "--start", "9", "--end", "2"], "expected the start before the end"),
        (["BAG", "--start", "nan"], "expected the start before the end"),
        (["BAG", "--start", "900"], "nothing was recorded between 900"),
        (["BAG", "--topic", "/odom"], "expected WANTED=FOUND"),
        (["BAG"] * 6, "6 recordings"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(
    bags: list[Path], args: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("empty").mkdir()
    Path("foreign.mcap").write_text("not a recording at all, but long enough to look at\n" * 20, encoding="utf-8")
    before = there()
    assert main(["plot", *(str(bags[0]) if arg == "BAG" else arg for arg in args)]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert len(error.strip().splitlines()) == 1
    assert there() == before


def test_a_robot_from_elsewhere_costs_only_its_outline(bags: list[Path], tmp_path: Path) -> None:
    run = read_bag(bags[0])
    tables = {key: (run.channels[key].t_ns, run.channels[key].columns) for key in ("ground_truth_odom", "odom")}
    write_channels(tmp_path / "other", tables, {"robot": "unheard_of"})
    assert main(["plot", str(tmp_path / "other"), "--json", "a.json"]) == 0
    said = json.loads(Path("a.json").read_text(encoding="utf-8"))["not_drawn"]
    assert "--robot" in said["rover outline"]
    assert main(["plot", str(tmp_path / "other"), "--robot", "agriq", "--json", "b.json"]) == 0
    assert "rover outline" not in json.loads(Path("b.json").read_text(encoding="utf-8"))["not_drawn"]


def test_help_is_light_and_has_an_example() -> None:
    code = (
        "import sys\nfrom artibot_sim.cli import main\nassert main(['plot', '--help']) == 0\n"
        "heavy = {'numpy', 'matplotlib', 'plotly', 'rich', 'rosbags', 'mcap'} & set(sys.modules)\n"
        "assert not heavy, heavy"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "artibot plot run7" in done.stdout
