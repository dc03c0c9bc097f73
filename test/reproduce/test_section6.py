"""Section 6: the circles of Tests 1 and 2."""

from __future__ import annotations

import math

import numpy as np
import pytest

from artibot_sim.model import load_robot
from artibot_sim.reproduce import paper, section6
from artibot_sim.reproduce.section6 import odometric_path
from artibot_sim.reproduce.simulations import (
    circle_error,
    odometric_speed,
    ramp_length,
    rotation_driven,
    torque_limited,
)


def test_rotations_turn_at_the_papers_odometric_radius_and_speed(circles: section6.Study) -> None:
    for test, run in circles.smooth.items():
        printed = paper.TESTS[test]
        assert run.odometric_radius == pytest.approx(printed.radius["odometric"], rel=1e-6)
        path = odometric_path(run)
        late = run.steady
        speed = np.hypot(*(np.diff(path[late, :2], axis=0) / np.diff(run.result.t[late])[:, None]).T)
        np.testing.assert_allclose(speed, odometric_speed(test), rtol=1e-4)
        # which is the speed that Table 5's odometric e_gamma stands for
        rate = odometric_speed(test) / printed.radius["odometric"]
        planned = printed.speed / printed.radius["planned"]
        assert 100 * (rate / planned - 1) == pytest.approx(printed.e_gamma["odometric"])


def test_radii_are_within_the_tolerance_of_the_papers_model(circles: section6.Study) -> None:
    for test, within in (("test1", 0.03), ("test2", 0.08)):
        assert circles.smooth[test].radius == pytest.approx(paper.TESTS[test].radius["simulated"], rel=within)
    assert all(run.radius > run.odometric_radius for run in circles.smooth.values())


def test_errors_are_of_the_papers_size(circles: section6.Study) -> None:
    for test, run in circles.smooth.items():
        e_gamma, e_x = run.errors(circles.angle[test])
        assert 100 * e_gamma == pytest.approx(paper.TESTS[test].e_gamma["simulated"], abs=2.5)
        assert 100 * e_x == pytest.approx(paper.TESTS[test].e_x["simulated"], abs=2.5)


def test_the_angle_is_where_the_measured_circle_has_the_measured_error(circles: section6.Study) -> None:
    for test, angle in circles.angle.items():
        there = circle_error(test, "measured", np.array([angle]), ramp_length(test) + 2.0)
        assert 100 * there[0] == pytest.approx(paper.TESTS[test].e_x["measured"], abs=0.05)


def test_a_perfect_circle_has_no_error(monkeypatch: pytest.MonkeyPatch) -> None:
    printed = paper.TESTS["test1"]
    monkeypatch.setitem(printed.radius, "measured", printed.radius["planned"])
    monkeypatch.setitem(printed.e_gamma, "measured", 0.0)
    np.testing.assert_allclose(circle_error("test1", "measured", np.linspace(0, 6, 50), 2.0), 0.0, atol=1e-12)


def test_the_entry_decides_between_two_steady_circles(circles: section6.Study) -> None:
    held, slid = circles.smooth["test1"], circles.jump["test1"]
    assert held.odometric_radius == pytest.approx(slid.odometric_radius, rel=1e-6)
    sliding = [max(run.steady_share(f"sat_front_{s}_back") for s in ("right", "left")) for run in (held, slid)]
    assert sliding == [0.0, 1.0]
    assert held.radius > 1.03 * slid.radius
    slower = rotation_driven(held.robot, "test1", held.kappa, entry=1.0)
    assert slower.radius == pytest.approx(held.radius, rel=1e-3)  # any entry that does not jump ends on the same one


def test_driven_motors_stay_within_the_fitted_limit(circles: section6.Study) -> None:
    best = circles.best
    for run in (best.test1, best.test2):
        assert np.abs(run.result.motor_torque[:, :2]).max() <= best.limit * (1 + 1e-9)
    assert best.test1.torque[0] == pytest.approx(best.limit, rel=1e-6)  # the outer motor
    kin = best.test1.plan.velocity[-1] / best.test1.result.motor_velocity[-1, :2]
    assert kin[0] > 1.02 and kin[1] == pytest.approx(1.0, abs=0.01)  # it lags, the inner one does not


def test_the_limit_is_fitted_on_test_1_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = load_robot("agriq")
    fitted = section6.fit_limit(robot, 1.0, 0.1)
    wanted = paper.TESTS["test1"].radius["odometric"]
    errors = np.abs(np.log(fitted.tried[:, 1] / wanted))
    assert fitted.limit == fitted.tried[errors.argmin(), 0]
    monkeypatch.setitem(paper.TESTS["test2"].radius, "odometric", 9.0)
    assert section6.fit_limit(robot, 1.0, 0.1).limit == fitted.limit


def test_more_torque_makes_a_tighter_circle() -> None:
    radii = [torque_limited(load_robot("agriq"), "test1", limit).odometric_radius for limit in (0.3, 0.45, 0.6, 0.8)]
    assert all(np.diff(radii) < 0)
    assert radii[-1] == pytest.approx(paper.TESTS["test1"].radius["planned"], rel=1e-3)  # it no longer limits


def test_the_section_says_what_the_numbers_say(circles: section6.Study) -> None:
    section = section6.written(circles)
    verdicts = {c.what: c.agrees for c in section.comparisons}
    assert verdicts["Test 1: radius, driven by rotations"] and verdicts["Test 2: radius, driven by rotations"]
    two = circles.best.test2
    wanted = paper.TESTS["test2"].radius["measured"]
    assert verdicts["Test 2: radius, driven motors"] == (abs(two.radius / wanted - 1) <= 0.08)
    at_limit = next(s for s in section.statements if "reaches its limit" in s.claim)
    assert at_limit.holds == all(run.torque[0] > 0.99 * circles.best.limit for run in (circles.best.test1, two))
    assert {sheet.key for sheet in section.sheets} == {"fig9", "angle", "limit"}
    assert all(math.isfinite(c.ours) for c in section.comparisons)
