"""The paper's numbers, and verdicts that follow from numbers alone."""

from __future__ import annotations

import io
import math

import pytest
from rich.console import Console

from artibot_sim.cli.reproduce import _print_the_paper
from artibot_sim.model import load_robot
from artibot_sim.model.equations.transmission import back_torque_factor
from artibot_sim.planning import load_manoeuvre, plan
from artibot_sim.reproduce import paper
from artibot_sim.reproduce.result import (
    CALIBRATED,
    PREDICTED,
    PaperComparison,
    Section,
    Statement,
    comparison_table,
    the_paper,
)


@pytest.mark.parametrize("name", paper.ROBOTS)
def test_the_manoeuvres_are_table_6(name: str) -> None:
    ramp, straight, left, right, last, _ = load_manoeuvre(f"table6_{name}").segments
    wanted = paper.TABLE_6[name]
    assert (ramp.speed, straight.length, last.length) == (wanted.v_c, wanted.s, wanted.s)
    assert (left.radius, right.radius) == (wanted.R, wanted.R)
    assert (left.angle, right.angle) == pytest.approx((1.5 * math.pi, -1.5 * math.pi))
    assert load_manoeuvre(f"table6_{name}").a_max == wanted.a_max


@pytest.mark.parametrize("test", paper.TESTS)
def test_the_manoeuvres_are_section_6s(test: str) -> None:
    printed, planned = paper.TESTS[test], plan(load_manoeuvre(test), load_robot("agriq"))
    during = planned.at(planned.marks[2].start + 1.0).twist[0]
    assert during[0] == pytest.approx(printed.speed)
    assert during[0] / during[1] == pytest.approx(printed.radius["planned"])
    assert load_manoeuvre(test).a_max == paper.TEST_A_MAX


def test_every_printed_number_is_within_sight_of_its_neighbours() -> None:
    """A slip of the pen would break the order that the paper's text describes."""
    for printed in paper.TESTS.values():
        r = printed.radius
        assert r["planned"] < r["odometric"] < r["simulated"] <= r["measured"]
        assert printed.e_gamma["measured"] < printed.e_gamma["simulated"] < printed.e_gamma["odometric"] < 0
    second = paper.TESTS["test2"].radius
    assert 1 - second["simulated"] / second["measured"] == pytest.approx(0.074, abs=5e-4)  # "about 7.4 %"
    for table in paper.TABLE_7.values():
        assert list(table) == list(paper.KAPPAS)
        assert table[0.6][0] < table[0.8][0] < table[1.0][0]


def test_the_stated_least_kappa_is_that_of_equal_motors() -> None:
    assert back_torque_factor(load_robot("agriq"), paper.KAPPA_MIN) == pytest.approx(0.5, rel=2e-3)  # each of two


def compared(ours: float, unit: str = "%", within: float = 2.5, basis: str = CALIBRATED) -> PaperComparison:
    return PaperComparison("x", unit, "Table 0", 5.0, ours, within, basis)


def test_agreement_is_the_difference_and_nothing_else() -> None:
    assert compared(7.4).agrees and compared(2.6).agrees
    assert not compared(7.6).agrees and not compared(2.4).agrees
    assert compared(5.14, "m", 0.03).agrees and not compared(5.16, "m", 0.03).agrees
    assert not compared(math.nan).agrees
    assert compared(4.0).difference_text == "−1.00 points"
    assert compared(4.0, "m").difference_text == "−20.0 %"


def test_a_verdict_counts() -> None:
    numbers = (compared(5.0), compared(9.0), compared(9.0, basis=PREDICTED))
    said = (Statement("a", True, ""), Statement("b", False, ""), Statement("c", True, ""))
    section = Section(1, "t", (), (), numbers, said)
    assert section.verdict == (
        "1 of 2 calibrated numbers agree; 0 of 1 predicted numbers agree; 2 of 3 statements hold."
    )
    column = comparison_table("t", numbers).columns.index("agrees")
    assert [row[column] for row in comparison_table("t", numbers).rows] == ["yes", "no", "no"]


def test_the_papers_table_has_every_number_with_its_sign_and_what_the_paper_states() -> None:
    said = (Statement("in the paper", False, "", "Fig. 10"), Statement("about it", True, ""))
    off = PaperComparison("e", "%", "Fig. 9", -5.0, -4.0, 2.0, CALIBRATED, "two metres")
    table = the_paper([Section(2, "t", (), (), (off,), said), Section(1, "t", (), (), (compared(6.0, "m"),), ())])
    assert table.rows == (
        ("Fig. 9", "e", "−5.00 %", "−4.00 %", "+1.00 points", "two metres; fitted to the printed number"),
        ("Fig. 10", "in the paper", "holds", "does not hold", "", ""),
        ("Table 0", "x", "5.00 m", "6.00 m", "+20.0 %", "fitted to the printed number"),
    )


def test_the_terminal_says_what_each_number_assumes_within_80_columns() -> None:
    """By number, each assumption listed once, whole."""
    shown = io.StringIO()
    assumed = "a circle of 117° after 2 m straight on", "printed without a sign, taken as negative"
    numbers = (
        PaperComparison("Test 1: e_γ, driven by rotations", "%", "Table 5", -40.39, -42.28, 2.0, PREDICTED, assumed[0]),
        PaperComparison("Epi.q (best fit), κ = 0.6: e_γ", "%", "Table 7", -1.98, -1.86, 2.0, CALIBRATED, assumed[1]),
        PaperComparison("Epi.q: e_γ", "%", "Table 7", -1.98, -1.86, 2.0, PREDICTED, "; ".join(assumed)),
        PaperComparison("Epi.q: e_x", "%", "Table 7", 1.79, 2.34, 2.0, PREDICTED),
    )
    _print_the_paper(Console(file=shown, width=80), [Section(7, "t", (), (), numbers, ())])
    lines = shown.getvalue().splitlines()
    assert max(map(len, lines)) <= 80
    where = {text: [line for line in lines if text in line] for text in (*assumed, "fitted to the printed number")}
    assert all(len(found) == 1 for found in where.values())
    number = {text: found[0].split(".")[0].strip() for text, found in where.items()}
    (both,) = (line for line in lines if line.startswith(" Epi.q: e_γ"))
    assert both.split("points")[1].strip() == ", ".join(sorted(number[text] for text in assumed))
    (free,) = (line for line in lines if line.startswith(" Epi.q: e_x"))
    assert free.rstrip().endswith("points")
