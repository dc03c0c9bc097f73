"""The paper's trajectories (sections 6 and 7, Table 6), against numbers worked out here by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from planning.strategies import AGRIQ, integral

from artibot_sim.model import load_robot, rollout
from artibot_sim.planning import load_manoeuvre, manoeuvre_names, plan

TABLE_6 = {"table6_epiq": (0.5, 0.5, 0.5, 0.25), "table6_agriq": (2.0, 2.0, 1.0, 0.5)}
"""R (m), s (m), v_c (m/s), a_max (m/s²)."""


@pytest.mark.parametrize("name", TABLE_6)
def test_table_6_has_the_papers_duration_length_and_end(name: str) -> None:
    R, s, v, a_max = TABLE_6[name]
    p = plan(load_manoeuvre(name), AGRIQ)
    # v(t) = V (3u² − 2u³): the acceleration peaks at 1.5 V/T, the ramp is V T/2 long
    T = 1.5 * v / a_max
    assert p.duration == pytest.approx(2 * T + (2 * s + 2 * 1.5 * math.pi * R) / v, rel=1e-12)
    assert p.path_length == pytest.approx(v * T + 2 * s + 3 * math.pi * R, rel=1e-12)
    # left about (l, R) until heading −y at (l − R, R), then right about (l − 2R, R) until heading x at (l − 2R, 2R)
    run_up = 0.5 * v * T + s
    np.testing.assert_allclose(p.at(p.duration).pose[0], [2 * run_up - 2 * R, 2 * R, 0.0], atol=1e-12)
    assert np.max(p.pose[:, 2]) == pytest.approx(1.5 * math.pi, abs=0.011 * v / R)


@pytest.mark.parametrize("name", TABLE_6)
def test_table_6_lies_on_its_two_circles(name: str) -> None:
    R, s, v, a_max = TABLE_6[name]
    p = plan(load_manoeuvre(name), AGRIQ)
    run_up = 0.75 * v * v / a_max + s
    for mark, centre in zip(p.marks[2:4], ([run_up, R], [run_up - 2 * R, R]), strict=True):
        inside = (p.t > mark.start) & (p.t < mark.end)
        radii = np.linalg.norm(p.pose[inside, :2] - centre, axis=1)
        np.testing.assert_allclose(radii, R, rtol=1e-12)
        np.testing.assert_allclose(np.abs(p.twist[inside]), [[v, v / R]] * inside.sum(), rtol=1e-12)


@pytest.mark.parametrize("name", TABLE_6)
def test_table_6_reaches_a_max_half_way_up_and_down(name: str) -> None:
    *_, v, a_max = TABLE_6[name]
    p = plan(load_manoeuvre(name), AGRIQ)
    T, h = 1.5 * v / a_max, 1e-4
    for middle, sign in ((T / 2, 1), (p.duration - T / 2, -1)):
        ahead, behind = p.at(np.array([middle + h, middle - h])).twist[:, 0]
        assert (ahead - behind) / (2 * h) == pytest.approx(sign * a_max, rel=1e-7)


def test_the_curvature_jumps_as_in_the_paper() -> None:
    p = plan(load_manoeuvre("table6_agriq"), AGRIQ)
    for mark, before, after in zip(p.marks[2:5], (0.0, 0.5, -0.5), (0.5, -0.5, 0.0), strict=True):
        yaw_rate = p.at(np.array([mark.start - 1e-7, mark.start])).twist[:, 1]
        np.testing.assert_allclose(yaw_rate, [before, after], atol=1e-12)


def test_table_6_rotations_are_exact() -> None:
    p = plan(load_manoeuvre("table6_agriq"), AGRIQ)
    t, rotation = integral(p, lambda sample: sample.velocity)
    np.testing.assert_allclose(p.at(t).position, rotation, atol=1e-9)


@pytest.mark.parametrize(("name", "v", "R"), [("test1", 0.5, 2.0), ("test2", 1.0, 3.0)])
def test_section_6_runs_a_left_circle_of_the_stated_radius_and_speed(name: str, v: float, R: float) -> None:
    p = plan(load_manoeuvre(name), AGRIQ)
    arc = p.marks[2]
    during = p.at(np.linspace(arc.start, arc.end - 1e-6, 50))
    np.testing.assert_allclose(during.twist, [[v, v / R]] * 50, rtol=1e-12)
    assert np.all(during.velocity[:, 0] > during.velocity[:, 1])  # the right wheels are the outer ones
    centre = during.pose[0, :2] + [0.0, R]
    last = p.at(np.linspace(arc.start, p.duration, 50)).pose[:, :2]  # the halt, too, is on the circle
    np.testing.assert_allclose(np.linalg.norm(last - centre, axis=1), R, rtol=1e-12)


def test_all_shipped_manoeuvres_end_at_rest_without_warning() -> None:
    assert {
        "table6_agriq",
        "table6_epiq",
        "test1",
        "test2",
        "eight",
        "slalom",
        "spiral",
        "chirp",
        "stop_and_go",
    } <= set(manoeuvre_names())
    for name in manoeuvre_names():
        p = plan(load_manoeuvre(name), AGRIQ, wheel_speed_limit=1.35)
        assert p.warnings == (), name
        np.testing.assert_allclose(p.twist[-1], 0.0, atol=1e-12)
        assert load_manoeuvre(name).description, name


def test_commands_between_knots_follow_the_plan() -> None:
    p = plan(load_manoeuvre("eight"), load_robot("agriq"))
    commands = p.commands()
    assert commands.commanded == (True, True, False, False)
    np.testing.assert_array_equal(commands.position[:, :2], p.position)
    half = p.at(p.t[:-1] + 0.5 * p.dt)
    chord = 0.5 * (p.position[1:] + p.position[:-1]) - p.dt / 8 * np.diff(p.velocity, axis=0)
    # the cubic's error is h⁴/384 of the fourth derivative: nanoradians at 10 ms, more where a ramp begins or ends
    assert np.quantile(np.abs(half.position - chord), 0.99) < 1e-7
    assert np.max(np.abs(half.position - chord)) < 1e-3 * p.dt


def test_the_model_follows_a_plan_to_where_it_is_meant_to_be() -> None:
    robot = load_robot("agriq")
    p = plan(load_manoeuvre("table6_agriq"), robot)
    result = rollout(robot, p.commands(), duration=p.marks[2].start)
    # straight ahead the wheels slip only by what rolling resistance takes
    np.testing.assert_allclose(result.pose[-1], [3.5, 0.0, 0.0], atol=0.05)
    np.testing.assert_allclose(result.motor_position[-1, :2], p.at(result.t[-1]).position[0], atol=1e-2)
