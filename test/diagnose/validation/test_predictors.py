"""Which model predicts held-out recordings best, and when a fitted one is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from report.diagnosis_case import case

from artibot_sim.diagnose.pipeline import with_refusals
from artibot_sim.diagnose.records import BASELINE, EXTENDED, GIVEN, UNNAMED, PredictionError, Predictor
from artibot_sim.diagnose.validation import predictors as module
from artibot_sim.diagnose.validation.predictions import predicted
from artibot_sim.diagnose.validation.predictors import best_of, ends_of, pooled, predictors, refusals, with_alike
from artibot_sim.diagnose.verdict import Verdict
from artibot_sim.identify.problems import problem_of
from artibot_sim.identify.requested import parameter_set
from artibot_sim.identify.synthetic import random_manoeuvre, synthetic
from artibot_sim.identify.validation import hold_out
from artibot_sim.model import Robot, load_robot
from artibot_sim.report.diagnosis.files import BEST, files_of, load
from artibot_sim.report.diagnosis.page import page_of
from artibot_sim.report.diagnosis.sentences import headline, next_step
from artibot_sim.report.files import write_folder

AGRIQ, HUSKY = load_robot("agriq"), load_robot("husky")
SOFT = AGRIQ.replace({"contact.mu_s": 0.45, "contact.mu_d": 0.3})
NAMED = replace(SOFT, effects={"slope": {"grade": 0.05, "heading": 1.9}})
MODELS = {GIVEN: AGRIQ, BASELINE: SOFT, EXTENDED: NAMED}


def predictor(name: str, position: float, yaw: float, robot: Robot | None = AGRIQ) -> Predictor:
    errors = {"position": PredictionError("m", position, 10), "yaw": PredictionError("rad", yaw, 10)}
    return Predictor(name, errors, robot, robot is None)


def test_a_baseline_worse_than_the_file_as_given_is_refused() -> None:
    found = [predictor(GIVEN, 1.1, 0.5), predictor(BASELINE, 2.3, 0.6, SOFT)]
    said, same = refusals(found, {GIVEN: AGRIQ, BASELINE: SOFT, EXTENDED: SOFT})  # nothing is named
    assert (said.file, said.better, said.holds) == ("baseline.yaml", GIVEN, GIVEN)
    assert "2.3" in said.why and "1.1" in said.why and "holds the robot as given" in said.why
    assert (same.file, same.holds) == ("extended.yaml", GIVEN)
    best = best_of(found)
    assert best is not None and best.name == GIVEN


def test_errors_below_the_sensors_noise_are_all_alike() -> None:
    found = [predictor(GIVEN, 1e-6, 1e-6), predictor(BASELINE, 4e-5, 3e-5, SOFT)]
    assert refusals(found, MODELS) and not refusals(found, MODELS, {"position": 4e-4, "yaw": 3e-4})
    assert refusals([found[0], predictor(BASELINE, 8e-4, 3e-5, SOFT)], MODELS, {"position": 4e-4, "yaw": 3e-4})


def test_an_extension_is_asked_the_same() -> None:
    found = [predictor(GIVEN, 1.1, 0.5), predictor(BASELINE, 1.0, 0.5, SOFT), predictor(EXTENDED, 1.15, 0.5, NAMED)]
    (said,) = refusals(found, MODELS)
    assert (said.file, said.better, said.holds) == ("extended.yaml", BASELINE, BASELINE), "worse than the simpler fit"
    assert not refusals([*found[:2], predictor(EXTENDED, 0.9, 0.5, NAMED)], MODELS)


def test_only_what_windows_drawn_anew_bear_is_refused() -> None:
    """One window out of twenty makes a fit worse on the whole, by more than is asked; all twenty do as well."""
    rng = np.random.default_rng(5)
    given = {"position": rng.uniform(0.8, 1.2, 20), "yaw": rng.uniform(0.08, 0.12, 20)}
    once = {name: error * np.where(np.arange(20) == 7, 2.5, 0.99) for name, error in given.items()}
    always = {name: 1.15 * error for name, error in given.items()}
    models = {GIVEN: AGRIQ, BASELINE: SOFT}
    for fitted, sure in ((once, False), (always, True)):
        ends = [given, fitted]
        found = [Predictor(name, pooled(one), models[name]) for name, one in zip(models, ends, strict=True)]
        assert found[1].score > found[0].score + 0.05
        told = with_alike(found, ends)
        assert bool(refusals(told, models)) is sure
        assert told[1].alike == (() if sure else (GIVEN,)) and told[1].is_clearly_worse_than(told[0]) is sure


def test_models_of_which_nothing_is_held_out_are_told_apart_by_nothing() -> None:
    empty = ends_of([])
    assert with_alike([Predictor(GIVEN, pooled(empty), AGRIQ)], [empty]) == (Predictor(GIVEN, {}, AGRIQ),)


def test_what_beats_all_dynamic_models_is_said() -> None:
    rolling = predictor("ICR kinematics", 0.2, 0.1, None)
    given, soil = predictor(GIVEN, 0.4, 0.2), predictor(BASELINE, 0.3, 0.2, SOFT)
    first, last = refusals([given, soil, predictor(EXTENDED, 0.25, 0.2, NAMED), rolling], MODELS)
    assert (first.file, last.file) == ("baseline.yaml", "extended.yaml")
    assert last.better == "ICR kinematics" and last.holds == EXTENDED and "do not simulate" in last.why
    (only,) = refusals([given, soil, predictor(EXTENDED, 0.2, 0.1, NAMED), rolling], MODELS)
    assert only.file == "baseline.yaml"


def test_a_refused_robot_is_in_no_file_and_what_commands_show_stays(tmp_path: Path) -> None:
    delayed = replace(NAMED, effects={**NAMED.effects, "command_delay": {"delay": 0.1}})
    models = {GIVEN: AGRIQ, BASELINE: SOFT, EXTENDED: delayed}
    errs = ((0.2, 0.1), (0.3, 0.1), (0.4, 0.1))
    seen = tuple(predictor(name, *err, models[name]) for name, err in zip(models, errs, strict=True))
    found = replace(
        case("slope", {"grade": 0.05, "heading": 1.9}), robot=AGRIQ, baseline_robot=SOFT, extended=delayed,
        predictors=seen, best=GIVEN,
    )  # fmt: skip
    refused = with_refusals(found, models, {"command_delay"})
    assert [one.file for one in refused.refused] == ["baseline.yaml", "extended.yaml"]
    assert refused.warnings[: len(refused.refused)] == tuple(one.why for one in refused.refused)
    assert headline(refused).endswith("As given predicts held-out data better: extended.yaml is refused.")
    write_folder(tmp_path / "found", files_of(refused, page_of(refused, "1")))
    text = (tmp_path / "found" / "extended.yaml").read_text()
    assert text.startswith("# extended.yaml (with what is named) is refused")
    extended, baseline = (load_robot(tmp_path / "found" / f"{name}.yaml") for name in ("extended", "baseline"))
    assert baseline == AGRIQ
    assert extended.effects == {"command_delay": {"delay": 0.1}} and replace(extended, effects={}) == AGRIQ
    again = load(tmp_path / "found")
    assert again.refused == refused.refused and again.best_robot == AGRIQ
    assert with_refusals(replace(found, predictors=seen[:1]), models, ()).extended == delayed, "nothing to compare with"


def test_the_next_step_never_names_a_model_that_another_beats_clearly() -> None:
    given, rolling = predictor(GIVEN, 0.4, 0.2), predictor("ICR kinematics", 0.2, 0.1, None)
    open_case = replace(case("slope", {"grade": 0.05, "heading": 1.9}), verdict=Verdict.UNEXPLAINED, causes=())
    said = next_step(replace(open_case, predictors=(given, rolling), best=GIVEN))
    assert "predict with ICR kinematics" in said and "best.yaml" not in said
    said = next_step(replace(open_case, predictors=(given, predictor("ICR kinematics", 0.41, 0.2, None)), best=GIVEN))
    assert said.endswith("simulate with best.yaml.")
    assert "Until then" not in next_step(replace(open_case, predictors=(), best=""))


def test_what_is_named_is_simulated_with_only_where_it_predicts_as_well() -> None:
    named = replace(case("slope", {"grade": 0.05, "heading": 1.9}), best=GIVEN)
    given, worse = predictor(GIVEN, 0.4, 0.2), predictor(EXTENDED, 0.6, 0.3)
    assert next_step(replace(named, predictors=(given, worse))).endswith("Until then simulate with best.yaml.")
    good = predictor(EXTENDED, 0.3, 0.2)
    said = next_step(replace(named, predictors=(given, good), best=EXTENDED))
    assert said.endswith("Until then simulate with extended.yaml.")
    rolling = predictor("ideal kinematics", 0.1, 0.1, None)
    assert "predict with ideal kinematics" in next_step(
        replace(named, predictors=(given, good, rolling), best=EXTENDED)
    )
    nothing = replace(named, verdict=Verdict.NONE, causes=())
    assert "simulate with best.yaml" in next_step(replace(nothing, predictors=(given, predictor(BASELINE, 0.6, 0.3))))


def test_the_simplest_of_those_as_good_is_the_best() -> None:
    found = [predictor(GIVEN, 0.30, 0.1), predictor(BASELINE, 0.2, 0.1), predictor(UNNAMED, 0.199, 0.1)]
    best = best_of(found)
    assert best is not None and best.name == BASELINE
    assert best_of([]) is None


def drive(robot: Robot, seed: int):  # type: ignore[no-untyped-def]
    rng = np.random.default_rng(seed)
    return synthetic(robot, random_manoeuvre(rng, 12.0), duration=12.0, seed=seed, name=f"run{seed}")


def test_the_right_soil_predicts_best() -> None:
    real = AGRIQ.replace({"contact.mu_s": 0.45, "contact.mu_d": 0.3, "contact.k_t": 1500.0})
    problem = problem_of([drive(real, 1)], parameter_set(AGRIQ), 3.0, 1)
    found = predictors([drive(real, 2)], {GIVEN: AGRIQ, BASELINE: real, EXTENDED: real}, problem, 3.0, 1)
    assert [one.name for one in found] == [GIVEN, BASELINE], "the same model is not asked twice, and nothing rolls"
    best = best_of(found)
    assert best is not None and best.name == BASELINE and best.robot == real
    assert best.errors["position"].rmse < 0.8 * found[0].errors["position"].rmse


@pytest.mark.parametrize("robot", [AGRIQ, HUSKY], ids=lambda robot: robot.name)
def test_what_was_predicted_before_is_not_predicted_again(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    """A diagnosis has the predictions of its models; the table says of them what it would say without."""
    soft = robot.replace({"contact.mu_s": 0.45, "contact.mu_d": 0.3})
    held, models, problem = [drive(soft, 2)], {GIVEN: robot, BASELINE: soft}, problem_of(
        [drive(soft, 1)], parameter_set(robot), 2.0, 1
    )  # fmt: skip
    expected = predictors(held, models, problem, 2.0, 1)
    known = [(soft, [predicted(held[0], soft, 2.0, 1)])]
    asked = []
    monkeypatch.setattr(
        module, "hold_out", lambda one, model, *rest: asked.append(model) or hold_out(one, model, *rest)
    )
    assert predictors(held, models, problem, 2.0, 1, known) == expected
    assert asked == [robot]


def test_kinematic_models_stand_beside_those_of_a_rigid_robot() -> None:
    problem = problem_of([drive(HUSKY, 1)], parameter_set(HUSKY), 2.0, 1)
    found = predictors([drive(HUSKY, 2)], {GIVEN: HUSKY}, problem, 2.0, 1)
    assert [one.name for one in found] == [
        GIVEN, "ideal kinematics", "effective track kinematics", "ICR kinematics", "ICR with timing kinematics",
    ]  # fmt: skip
    assert all(one.kinematic and one.robot is None and one.errors["position"].rmse > 0.0 for one in found[1:])
    ideal, track = (one.errors["position"].rmse for one in found[1:3])
    assert track < ideal


@pytest.mark.parametrize("robot", [AGRIQ, HUSKY], ids=lambda robot: robot.name)
def test_the_best_is_a_file_that_claims_nothing_else(robot: Robot, tmp_path: Path) -> None:
    better = robot.replace({"contact.mu_s": 0.41, "contact.mu_d": 0.3})
    models = (predictor(GIVEN, 0.4, 0.2, robot), predictor(BASELINE, 0.2, 0.1, better))
    found = replace(case("slope", {"grade": 0.05, "heading": 1.9}), robot=robot, predictors=models, best=BASELINE)
    page = page_of(found, "1").decode()
    assert page.index("<h2>Which model predicts best</h2>") < page.index("<h2>What is wrong</h2>")
    write_folder(tmp_path / "found", files_of(found, page.encode()))
    text = (tmp_path / "found" / BEST).read_text()
    assert text.startswith("# For prediction only") and "position 0.2 m" in text and BASELINE in text
    assert load_robot(tmp_path / "found" / BEST) == better
    again = load(tmp_path / "found")
    assert again.best_robot == better and [one.name for one in again.predictors] == [GIVEN, BASELINE]
    assert again.as_dict()["predictors"] == found.as_dict()["predictors"]
