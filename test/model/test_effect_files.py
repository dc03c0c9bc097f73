"""Effects of one's own in files: known as the built-in ones are, and refused with one line where something is wrong."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import yaml
from model.effects import SEVERITY_1, with_effects
from model.test_effects import turn

from artibot_sim.cli import main
from artibot_sim.diagnose.candidates.hypotheses import hypotheses
from artibot_sim.errors import ArtibotError
from artibot_sim.exchange.own_effects import user_folder
from artibot_sim.model import load_robot, save_robot
from artibot_sim.model.effects import EFFECTS, at_work
from artibot_sim.model.effects.files import effect_document, effect_of, load_folder, register

COLD_GEAR = {
    "id": "cold_gear",
    "description": "The front left gear is stiff while it is cold.",
    "law": {
        "where": "front_left_torque", "variable": "time", "form": "decaying", "times": "speed", "times_form": "coulomb",
        "times_scale": 0.02,
    },
    "parameters": {
        "size": {"unit": "N m", "low": 0.0, "high": 2.0, "typical": 0.13},
        "scale": {"unit": "s", "low": 1.0, "high": 100.0, "typical": 8.0},
    },
}  # fmt: skip


@pytest.fixture
def forgets(monkeypatch, tmp_path):
    """Effects that a test makes known are forgotten after it, and the folder of whoever runs it is left alone."""
    before = dict(EFFECTS)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    yield
    EFFECTS.clear()
    EFFECTS.update(before)


def written(folder: Path, document: object = COLD_GEAR) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "cold_gear.yaml"
    path.write_text(yaml.safe_dump(document), encoding="utf-8")
    return path


def test_an_effect_of_a_file_is_the_law_that_it_says(agriq, tmp_path, forgets):
    written(tmp_path / "mine")
    assert load_folder(tmp_path / "mine") == ["cold_gear"]
    robot = dataclasses.replace(agriq, effects={"cold_gear": {"size": 0.3, "scale": 8.0}})
    np.testing.assert_array_equal(turn(robot).q, turn(with_effects(agriq, "force_law_2")).q)
    beside = dataclasses.replace(agriq, effects={**robot.effects, "force_law": SEVERITY_1["force_law"]})
    assert list(at_work(beside.effects)) == ["force_law", "force_law_2"]
    absent = dataclasses.replace(agriq, effects={"cold_gear": {}})
    np.testing.assert_array_equal(turn(absent).q, turn(agriq).q)


def test_a_diagnosis_looks_for_it_by_its_typical_size(agriq, epiq, tmp_path, forgets):
    written(tmp_path / "mine")
    load_folder(tmp_path / "mine")
    for robot in (agriq, epiq):
        (mine,) = (one for one in hypotheses(robot, []) if one.id == "cold_gear")
        assert mine.extension.values(np.array([1.0]))["size"] == pytest.approx(0.13)


def test_more_laws_than_a_robot_can_have_are_refused(agriq, tmp_path, forgets):
    written(tmp_path / "mine")
    load_folder(tmp_path / "mine")
    laws = {name: SEVERITY_1[name] for name in ("force_law", "force_law_2", "force_law_3")}
    with pytest.raises(ArtibotError, match="cold_gear: a robot has at most 3 laws at work"):
        turn(dataclasses.replace(agriq, effects={"cold_gear": {"size": 0.1}, **laws}))


def changed(*path: str, to: object) -> dict:
    document = yaml.safe_load(yaml.safe_dump(COLD_GEAR))
    node = document
    for key in path[:-1]:
        node = node[key]
    if to is None:
        del node[path[-1]]
    else:
        node[path[-1]] = to
    return document


@pytest.mark.parametrize(
    ("document", "says"),
    [
        (["a list"], "f.yaml: found list, expected the keys id, description, law, parameters"),
        (changed("law", to=None), "f.yaml: law: missing; an effect needs id, description, law, parameters"),
        (changed("id", to="Cold Gear"), "f.yaml: id: found 'Cold Gear', expected small letters"),
        (changed("wher", to=1), "f.yaml: wher: unknown key"),
        (changed("law", "where", to="roof"), "f.yaml: law.where: found 'roof', expected one of front_surge"),
        (changed("law", "times", to="slip"), "f.yaml: law.times: 'slip' means nothing to the torque of motor"),
        (changed("law", "times_scale", to="x"), "f.yaml: law.times_scale: found 'x', expected a number"),
        (changed("law", "times", to=None), "f.yaml: law.times_form: 'coulomb' needs a variable"),
        (changed("law", "times_form", to=None), "f.yaml: law.times_form: 'constant' does not follow the speed"),
        (changed("description", to=" "), "f.yaml: description: found nothing"),
        (changed("parameters", "scale", "low", to=-1.0), "f.yaml: parameters.scale.low: -1 SI is out of bounds"),
        (changed("law", "scale", to=3.0), "f.yaml: law.scale: is one of the parameters, too"),
        (changed("parameters", "size", to=None), "f.yaml: parameters.size: missing"),
        (changed("parameters", "size", "unit", to="N"), "f.yaml: parameters.size.unit: found 'N', expected 'N m'"),
        (changed("parameters", "scale", "unit", to="m"), "f.yaml: parameters.scale.unit: found 'm', expected 's'"),
        (changed("parameters", "size", "high", to=0.1), "f.yaml: parameters.size: found 0 to 0.1, typical 0.13"),
        (changed("parameters", "size", "low", to=0.1), "f.yaml: parameters.size: found 0.1 to 2; expected 0 between"),
        (changed("parameters", "size", "typical", to=0.0), "f.yaml: parameters.size.typical: found 0, expected"),
        (changed("parameters", "size", "typical", to="big"), "f.yaml: parameters.size.typical: found 'big', expected"),
    ],
)
def test_a_file_that_is_no_effect_is_refused_with_one_line(document, says):
    with pytest.raises(ArtibotError) as caught:
        effect_of(document, "f.yaml")
    assert str(caught.value).startswith(says)
    assert "\n" not in str(caught.value)


def test_a_built_in_effect_keeps_its_name(tmp_path, forgets):
    path = written(tmp_path / "mine", changed("id", to="slope"))
    with pytest.raises(ArtibotError, match=f"{path}: id: 'slope' is a built-in effect"):
        load_folder(tmp_path / "mine")
    assert main(["effects", "check", str(path)]) == 2


def test_two_files_of_a_folder_do_not_declare_the_same_effect(tmp_path, forgets):
    first = written(tmp_path / "mine")
    second = first.rename(first.with_name("another.yaml"))
    written(tmp_path / "mine")
    with pytest.raises(ArtibotError, match=f"{first}: id: 'cold_gear' is that of {second}, too"):
        load_folder(tmp_path / "mine")


def test_an_effect_of_a_file_is_shown_as_a_formula(tmp_path, forgets, capsys):
    written(tmp_path / "mine")
    assert main(["effects", "show", "cold_gear", "--effects", str(tmp_path / "mine")]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "torque of motor front_left = 0.13 N m · exp(−|time since the start / 8 s|) · tanh(speed / 0.02 m/s)" in said


def test_text_that_is_no_yaml_is_refused_by_the_command(tmp_path, forgets, capsys):
    path = tmp_path / "broken.yaml"
    path.write_text("id: [", encoding="utf-8")
    assert main(["effects", "check", str(path)]) == 2
    said = capsys.readouterr().err
    assert "broken.yaml: not YAML" in said and said.count("\n") == 1


def test_a_law_that_was_found_gets_a_name_and_is_known_from_then_on(tmp_path, forgets, capsys):
    save_robot(with_effects(load_robot("agriq"), "force_law_2"), tmp_path / "extended.yaml")
    adopt = [
        "effects",
        "adopt",
        str(tmp_path / "extended.yaml"),
        "--as",
        "cold_gear",
        "--describe",
        "Stiff while cold.",
    ]
    assert main(adopt) == 2  # there is no first law in the file
    assert "laws in the file: force_law_2" in capsys.readouterr().err
    adopt += ["--law", "force_law_2"]
    assert main(adopt) == 0
    assert main(adopt) == 2 and "exists already" in capsys.readouterr().err
    assert (user_folder() / "cold_gear.yaml").is_file()
    EFFECTS.pop("cold_gear")
    assert main(["effects", "show", "cold_gear"]) == 0  # read from the user's own folder
    assert "Stiff while cold." in capsys.readouterr().out
    found = EFFECTS["cold_gear"].law({"size": 0.3})
    assert found == EFFECTS["force_law_2"].read(SEVERITY_1["force_law_2"], "")


def test_a_wheel_out_of_round_is_looked_for_in_any_phase(agriq, forgets):
    """Its angle is 0 where a recording begins: next week it stands otherwise."""
    law = {"size": 40.0, "where": "front_left_longitudinal", "variable": "angle", "form": "periodic", "phase": -1.2}
    law = EFFECTS["force_law"].read(law | {"scale": 2.0 * np.pi}, "")
    effect = register(effect_of(effect_document("oval", "A wheel out of round.", law), "f.yaml"), Path("f.yaml"))
    assert effect.law({"size": 40.0, "phase": -1.2}) == law
    (mine,) = (one for one in hypotheses(agriq, []) if one.id == "oval")
    found = mine.extension.values(mine.extension.coordinates({"size": 30.0, "phase": 2.0}))
    assert (found["size"], found["phase"]) == (pytest.approx(30.0), pytest.approx(2.0))


def test_the_list_has_built_in_effects_and_those_of_a_folder(tmp_path, forgets, capsys):
    written(tmp_path / "mine")
    assert main(["effects", "list", "--effects", str(tmp_path / "mine")]) == 0
    said = capsys.readouterr().out
    assert "cold_gear" in said and "slope" in said
    assert main(["effects", "list", "--effects", str(tmp_path / "none")]) == 2
    assert "no such folder" in capsys.readouterr().err
