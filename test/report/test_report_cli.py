"""`artibot report`: a page for every kind of result, one line for what is none."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bag_helpers import in_namespaces

from artibot_sim.cli import main
from artibot_sim.identify.result import (
    ChannelFit,
    Estimate,
    FitStatus,
    Identification,
    Prediction,
    as_text,
    prediction_lines,
)
from artibot_sim.model import load_robot
from artibot_sim.report.identification import page_of_document


def found() -> Identification:
    fit = ChannelFit("m", 0.004, 0.006, 0.003, 0.009, 321, 1.2)
    prediction = Prediction("run2", 5.0, 7, {"position": fit}, {"position": fit}, {"position": fit}, 12.5, "", {})
    estimate = Estimate(
        "contact.k_l", "k_l", "N s/m", 2650.0, (2600.0, 2700.0), (2610.0, 2690.0), (2600.0, 2700.0), (2900.0, 1160.0),
        FitStatus.CONVERGED, "a note",
    )  # fmt: skip
    return Identification(
        load_robot("agriq"), (estimate,), [[1.0]], "k_l", FitStatus.CONVERGED, "all identified", ("run0",), 9, 999,  # type: ignore[arg-type]
        {"position": fit}, (prediction,), (), ("a remark",), 3.0,
    )  # fmt: skip


def test_an_identification_is_drawn_from_its_json(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    result = found()
    object.__setattr__(result, "correlation", np.eye(1))
    (tmp_path / "soil.json").write_text(json.dumps(result.as_dict()))
    about_zero = replace(result.estimates[0], key="y", name="y", prior=(0.0, 0.1))
    both = replace(result, estimates=(*result.estimates, about_zero))
    object.__setattr__(both, "correlation", np.eye(2))
    (tmp_path / "soil.json").write_text(json.dumps(both.as_dict()))
    assert main(["report", "soil.json"]) == 0
    page = (tmp_path / "soil.html").read_text()
    assert all(line in page for prediction in result.predictions for line in prediction_lines(prediction))
    for said in ("k_l: a note", "a remark", "identified from run0", "2650", "Parameters beside what was known"):
        assert said in page


def test_kinematic_models_stand_beside_the_identified_one_in_one_table() -> None:
    result = found()
    (prediction,) = result.predictions
    fits = prediction.final
    rivals = {name: {"position": replace(fits["position"], rmse=0.2)} for name in ("ideal", "ICR")}
    object.__setattr__(result, "predictions", (replace(prediction, rivals=rivals),))
    object.__setattr__(result, "correlation", np.eye(1))
    object.__setattr__(result, "findings", ("run0: poses are late",))
    page = page_of_document(json.loads(json.dumps(result.as_dict())), Path("soil.json")).decode()
    table = page.partition("Answer</")[2].partition("</table>")[0]
    assert table.index("position, this model") < table.index("position, ideal") < table.index("position, ICR")
    assert table.count("<td>0.200</td>") == 2
    assert table.index("poses are late") < table.index("position, this model"), "findings come first in every report"
    assert "<thead>" not in table, "sections have heads of their own; a common one would be empty"
    assert table.index("position, ICR") < table.index("95 %") < table.index("2650")
    printed = as_text(result)
    assert printed.index("poses are late") < printed.index("2650")
    table = printed.partition("errors at the ends")[2]
    assert table.index("this model") < table.index("ideal") < table.index("ICR")
    assert table.count("0.200") == 2
    assert printed.index("a remark") < printed.index("channel"), "what is wrong with the recordings follows the answer"


def test_of_several_rovers_one_is_drawn_by_the_option_that_the_refusal_names(
    bags: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    two, html = in_namespaces(tmp_path / "two", bags[0], "/rover1", "/rover2"), tmp_path / "page.html"
    assert main(["report", str(two), "--html", str(html)]) == 2
    asked = capsys.readouterr().err.split("choose one with ")[1].split()
    assert main(["report", str(two), "--html", str(html), *asked]) == 0
    assert html.is_file()
    (tmp_path / "soil.json").write_text(json.dumps({"schema": "artibot/identification/1"}))
    assert main(["report", str(tmp_path / "soil.json"), *asked]) == 2
    assert "--namespace is for recordings" in capsys.readouterr().err


def test_recordings_are_drawn(bags: list[Path], tmp_path: Path) -> None:
    pages = [tmp_path / "report.html", tmp_path / "plot.html"]
    assert main(["report", *map(str, bags), "--html", str(pages[0])]) == 0
    assert main(["plot", *map(str, bags), "--html", str(pages[1])]) == 0
    assert pages[0].read_bytes() == pages[1].read_bytes()


def test_a_sweep_is_drawn_again(tmp_path: Path) -> None:
    out = tmp_path / "grip"
    sweep = ["sweep", "--axis", "contact.mu_s=0.5:0.8:2", "--manoeuvre", "eight", "--dt", "0.002"]
    assert main([*sweep, "--integrator", "semi_implicit", "--workers", "1", "--out", str(out)]) == 0
    first = (out / "sweep.html").read_bytes()
    (out / "sweep.html").unlink()
    assert main(["report", str(out)]) == 0
    assert (out / "sweep.html").read_bytes() == first


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("x.json", "{", "not JSON"),
        ("x.json", "[1]", "holds a list"),
        ("x.json", '{"schema": "other/1"}', "schema 'other/1'"),
        ("x.json", '{"schema": "artibot/identification/1", "status": "converged"}', "not an identification"),
        ("x.mcap", "", "x.mcap"),
        ("absent", None, "absent"),
    ],
)
def test_what_is_no_result_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, content: str | None, said: str
) -> None:
    if content is not None:
        (tmp_path / name).write_text(content)
    assert main(["report", str(tmp_path / name), "--html", str(tmp_path / "page.html")]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and said in error
    assert not (tmp_path / "page.html").exists()


def test_a_folder_without_a_result_says_what_would_be_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", str(tmp_path)]) == 2
    assert "expected diagnosis.json, sweep.json or a recording" in capsys.readouterr().err


def test_two_results_do_not_fit_on_a_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "x.json").write_text('{"schema": "artibot/identification/1"}')
    assert main(["report", *[str(tmp_path / "x.json")] * 2]) == 2
    assert "one result" in capsys.readouterr().err
