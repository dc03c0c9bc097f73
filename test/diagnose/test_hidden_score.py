"""The scorer's arithmetic, on answers that are made up."""

from __future__ import annotations

from math import pi

import pytest
from diagnose.hidden.calibrate import advice, chances, leftovers
from diagnose.hidden.score import is_described, relative_gain, score
from diagnose.hidden.table import confusion, failures, laws, names, picture, table


def found(value, low=None, high=None):
    return {"value": value, "unit": "", "ci95": None if low is None else [low, high]}


def cause(effect, ties=(), **parameters):
    return {"effect": effect, "parameters": parameters, "evidence": {}, "ties": list(ties)}


def answer(verdict="none", causes=(), ranking=(), unexplained=None, gain=None):
    ranked = [{"effect": name} for name in ranking]
    return {
        "verdict": verdict, "causes": list(causes), "ranking": ranked, "unexplained": unexplained, "gain": gain or {},
        "seconds": 3.0,
    }  # fmt: skip


def truth(unlisted=(), **effects):
    return {"effects": effects, "unlisted": {name: {} for name in unlisted}, "idle": {}}


SLOPE = {"grade": 0.05, "heading": 3.0}


def test_nothing_there_nothing_said():
    s = score(answer(), truth())
    assert (s.truth, s.answer, s.detected, s.top1, s.excess) == ((), "none", False, 1.0, 0)


def test_a_false_alarm():
    s = score(answer("named", [cause("slope", grade=found(0.01), heading=found(0.0))]), truth())
    assert (s.answer, s.detected, s.top1, s.excess, s.errors) == ("slope", True, 0.0, 1, {})


def test_right_name_and_numbers():
    c = cause("slope", grade=found(0.055, 0.049, 0.06), heading=found(3.1, 3.05, 3.2))
    s = score(answer("named", [c]), truth(slope=SLOPE))
    assert s.top1 == s.top3 == 1.0 and not s.tie and s.excess == 0
    assert s.errors["slope.grade"] == pytest.approx(0.1) and s.errors["slope.heading"] == pytest.approx(0.1)
    assert s.covered == {"slope.grade": True, "slope.heading": False}


def test_a_push_backwards_is_one_the_other_way():
    c = cause("slope", grade=found(-0.05, -0.052, -0.048), heading=found(3.0 - pi, 2.9 - pi, 3.1 - pi))
    s = score(answer("named", [c]), truth(slope=SLOPE))
    assert max(s.errors.values()) < 1e-9 and all(s.covered.values())


def test_headings_go_round():
    c = cause("slope", grade=found(0.05), heading=found(-3.1, -3.4, -2.8))
    s = score(answer("named", [c]), truth(slope={"grade": 0.05, "heading": 3.1}))
    assert s.errors["slope.heading"] == pytest.approx(2 * pi - 6.2) and s.covered["slope.heading"]


@pytest.mark.parametrize(
    ("name", "ties", "expected"),
    [
        ("slope", ("external_force",), 0.5),
        ("external_force", ("slope",), 0.5),
        ("external_force", ("payload", "com_offset", "slope"), 0.0),
        ("external_force", ("payload",), 0.0),
    ],
)
def test_a_tie_of_up_to_three_that_holds_the_truth_is_half_right(name, ties, expected):
    s = score(answer("ambiguous", [cause(name, ties)]), truth(slope=SLOPE))
    assert s.top1 == expected and s.tie


def test_third_place():
    wrong = answer("named", [cause("payload")], ranking=("payload", "com_offset", "slope", "stribeck"))
    assert score(wrong, truth(slope=SLOPE)).top3 == 1.0
    assert score(wrong, truth(stribeck={"velocity": 0.08})).top3 == 0.0
    assert score(wrong, truth(slope=SLOPE)).top1 == 0.0


def test_two_hidden_need_both_among_three():
    named = answer(
        "named", [cause("slope", grade=found(0.05), heading=found(3.0)), cause("gyro_bias", bias=found(0.01))]
    )
    both = truth(slope=SLOPE, gyro_bias={"bias": 0.01})
    assert score(named, both).top3 == 1.0 and score(named, both).excess == 0
    assert score(named, truth(slope=SLOPE, payload={"mass": 15.0, "module": "back"})).top3 == 0.0


def test_what_is_on_no_list_must_not_get_a_name():
    remainder = {"force": "front yaw moment", "variable": "front yaw rate", "form": "linear", "size": 60.0, "unit": ""}
    right = score(answer("unexplained", unexplained=remainder), truth(["yaw_drag"]))
    assert (right.top1, right.described, right.answer, right.excess) == (1.0, True, "unexplained", 0)
    other = score(answer("unexplained", unexplained={**remainder, "variable": "time"}), truth(["yaw_drag"]))
    assert (other.top1, other.described) == (1.0, False)
    forced = score(answer("named", [cause("bulldozing")]), truth(["yaw_drag"]))
    assert (forced.top1, forced.answer, forced.excess) == (0.0, "bulldozing", 1)


def test_of_what_is_listed_beside_what_is_not_both_must_be_said():
    remainder = {"force": "front yaw moment", "variable": "front yaw rate", "form": "linear", "size": 60.0, "unit": ""}
    slope, both = cause("slope", grade=found(0.05), heading=found(3.0)), truth(["yaw_drag"], slope=SLOPE)
    right = score(answer("named", [slope], unexplained=remainder), both)
    assert (right.top1, right.described, right.excess) == (1.0, True, 0)
    assert score(answer("named", [slope]), both).top1 == 0.0
    assert score(answer("unexplained", unexplained=remainder), both).top1 == 0.0
    other = score(answer("named", [slope, cause("bulldozing")], unexplained=remainder), both)
    assert (other.top1, other.excess) == (0.0, 1)


def test_errors_are_of_the_departure_from_neutral():
    c = cause("back_friction", scale=found(0.64, 0.5, 0.7))
    assert score(answer("named", [c]), truth(back_friction={"scale": 0.6})).errors[
        "back_friction.scale"
    ] == pytest.approx(0.1)
    c = cause("joint_stop", angle=found(0.385))
    assert score(answer("named", [c]), truth(joint_stop={"angle": 0.35})).errors["joint_stop.angle"] == pytest.approx(
        0.1
    )
    c = cause("motor_drag", torque=found(0.25), motor=found("back_left"))
    errors = score(answer("named", [c]), truth(motor_drag={"torque": 0.25, "motor": "back_right"})).errors
    assert errors == {"motor_drag.torque": 0.0, "motor_drag.motor": float("inf")}


def test_gain_is_of_what_the_true_model_gains():
    reference = {
        "position": {"after": 0.1, "noise": 0.1, "count": 100},
        "yaw_rate": {"after": 0.1, "noise": 0.1, "count": 100},
    }
    still = {"before": 0.1, "after": 0.1}
    assert relative_gain({"position": {"before": 0.5, "after": 0.1}, "yaw_rate": still}, reference) == pytest.approx(
        1.0
    )
    assert relative_gain({"position": {"before": 0.5, "after": 0.3}}, reference) == pytest.approx(16 / 24)
    assert relative_gain({"position": {"before": 0.5, "after": 0.5}}, reference) == 0.0
    assert relative_gain({"yaw_rate": still}, reference) is None


def test_a_law_in_other_words_is_as_good_where_it_predicts_as_well():
    words = {"force": "front sway force", "variable": "time", "form": "linear", "size": 1.0, "unit": ""}
    reference = {"position": {"after": 0.1, "noise": 0.1, "count": 100}}
    for after, laws_of, good in ((0.1, {"force_law": {}}, True), (0.1, {}, False), (0.4, {"force_law": {}}, False)):
        said = answer("unexplained", unexplained={**words, "laws": laws_of})
        said["gain"] = {"position": {"before": 0.5, "after": after}}
        seen = score(said, truth(["yaw_drag"]), reference)
        assert (seen.described, seen.equivalent, seen.replaced) == (False, good, False)
    assert score(said, truth(slope=SLOPE)).replaced
    assert not score({**said, "causes": [cause("slope")]}, truth(slope=SLOPE)).replaced


def test_what_is_asked_of_laws_is_counted_with_intervals():
    lines = list(laws(made_up()))
    assert lines[0] == "on no list, 1: said to be 0 of 1, 0.0 … 97.5 %"
    assert lines[-2:] == [
        "nothing hidden, a law: 0 of 3, 0.0 … 70.8 %",
        "a listed effect replaced by a law: 0 of 2, 0.0 … 84.2 %",
    ]


def test_of_ties_it_is_counted_whether_the_best_one_acts():
    right, wrong = cause("slope", ["external_force"]), cause("external_force", ["payload"])
    said = [answer("ambiguous", [one]) for one in (right, wrong)]
    lines = list(names([*made_up(), *(result("single", 9 + i, one, truth(slope=SLOPE)) for i, one in enumerate(said))]))
    assert lines[0].startswith("named alone: it acts in 1 of 3,")
    assert lines[1].startswith("named in a tie: 2 of 5,")
    assert [line.split(",")[0] for line in lines[2:]] == [
        "  the best one acts: 1 of 2", "  one of them acts: 1 of 2", "  one of them does not: 2 of 2",
    ]  # fmt: skip


def result(kind, number, said, hidden, severity=1.0):
    job = {"kind": kind, "number": number, "effects": [], "severity": severity, "noise": 1.0, "seed": number}
    return {"key": f"{kind} {number}", "job": job, "truth": hidden, "answer": said}


def made_up():
    slope = answer("named", [cause("slope", grade=found(0.05, 0.04, 0.06), heading=found(3.0, 2.9, 3.1))], ("slope",))
    return [
        result("none", 0, answer(), truth(), 0.0),
        result("none", 1, slope, truth(), 0.0),
        result("single", 0, slope, truth(slope=SLOPE)),
        result("single", 1, answer(), truth(payload={"mass": 15.0, "module": "back"})),
        result("single", 2, answer(), {**truth(), "idle": {"torque_limit": {"front_max": 0.36}}}),
        result("unlisted", 0, slope, truth(["ridges"])),
        {
            "key": "single 3",
            "job": result("single", 3, {}, {})["job"],
            "truth": truth(slope=SLOPE),
            "error": "ValueError: x",
        },
    ]


def test_the_table_counts():
    lines = {line[:16].strip(): line[16:].split() for line in table(made_up())}
    assert lines["nothing"][:3] == ["3", "33%", "67%"]  # an effect that never acts is nothing
    assert lines["single, 1"][:3] == ["2", "50%", "50%"]
    assert lines["unlisted, 1"][:3] == ["1", "100%", "0%"]
    assert any(line.startswith("1 cases without a diagnosis") for line in table(made_up()))


def test_failures_say_what_was_named_instead():
    lines = list(failures(made_up()))
    assert [line.split(":")[0] for line in lines] == ["none 1", "single 1", "unlisted 0", "single 3"]
    assert "named slope" in lines[0] and "ValueError" in lines[3]


def test_a_calibration_counts_what_chance_gives_and_what_is_left():
    def left(level, *ranking):
        ranked = [{"effect": e, "log10_bayes_factor": b, "fitted": f} for e, b, f in ranking]
        return {**answer(), "ranking": ranked, "left": {"yaw_rate": {"typical": level, "worst": 2.0 * level}}}

    results = [
        result("none", 0, left(1.1, ("slope", 2.0, True), ("payload", 9.0, False)), truth(), 0.0),
        result("none", 1, left(1.3, ("slope", 1.0, True)), truth(), 0.0),
        result("single", 0, left(7.0), truth(slope=SLOPE)),  # missed: what it leaves is no measure of a right name
        result("unlisted", 0, left(4.0), truth(["ridges"])),
    ]
    assert chances(results) == {"slope": pytest.approx([4.605, 2.303], rel=1e-3)}
    assert leftovers(results) == {"nothing": {"yaw_rate": [1.1, 1.3]}, "listed": {}, "unlisted": {"yaw_rate": [4.0]}}
    said = "\n".join(advice(results))
    assert "2 cases" in said and "slope" in said and "payload" not in said


def test_the_confusion_matrix_counts_every_case_once():
    truths, answers, counts = confusion(made_up())
    assert counts.sum() == 6
    assert counts[truths.index("none"), answers.index("slope")] == 1
    assert counts[truths.index("(ridges)"), answers.index("slope")] == 1
    assert picture(made_up()).startswith(b"\x89PNG")


def test_a_false_name_is_one_that_is_not_there_nor_ties_with_what_is():
    slope, tied = cause("slope"), cause("external_force", ties=("slope",))
    assert score(answer("named", [slope]), truth()).false
    assert not score(answer("ambiguous", [tied]), truth(slope=SLOPE)).false
    varying = truth() | {"varies": True}
    job, hidden = {"kind": "single", "severity": 1.0}, truth(wheel_resistance={"share": 0.1})
    rows, _, counts = confusion([{"job": job, "truth": hidden, "answer": answer()}])
    assert counts[rows.index("wheel_resistance"), 0] == counts.sum() == 1.0
    assert score(answer("unexplained"), varying).top1 == 1.0 and score(answer("named", [slope]), varying).top1 == 0.0


def test_a_product_is_no_dependence_on_time():
    gear = {"force": "torque of front_left", "form": "Coulomb-like"}
    assert is_described(gear | {"variable": "speed times time"}, {"cold_gear": {}})
    assert not is_described(gear | {"variable": "speed times wheel angle"}, {"cold_gear": {}})
