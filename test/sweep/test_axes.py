"""Axes and plans: which runs there are, and what is refused with which mend."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from artibot_sim.errors import ArtibotError
from artibot_sim.sweep import axis_from_text, plan_from_dict
from artibot_sim.sweep.axes import Base, axis_from_node, known_keys, manoeuvre_document, robot_with


def rows(plan, first, count):
    columns = plan.columns(first, count)
    return list(zip(*columns.values(), strict=True))


@settings(max_examples=50)
@given(st.lists(st.integers(1, 5), min_size=1, max_size=4), st.data())
def test_a_grid_has_every_combination_once_however_it_is_cut(sizes, data):
    keys = ["contact.mu_s", "contact.k_l", "front.m", "kappa"]
    axes = {key: [round(0.4 + 0.1 * i, 3) for i in range(size)] for key, size in zip(keys, sizes, strict=False)}
    plan = plan_from_dict({"axes": axes, "manoeuvre": "short"})
    everything = list(itertools.product(*axes.values()))
    assert plan.count == len(everything)
    assert rows(plan, 0, plan.count) == everything
    cut = data.draw(st.integers(0, plan.count))
    assert rows(plan, 0, cut) + rows(plan, cut, plan.count - cut) == everything


@settings(max_examples=30)
@given(st.integers(1, 60), st.integers(0, 5))
def test_a_hypercube_has_one_run_in_every_slice_of_every_axis(count, seed):
    axes = {"contact.mu_s": {"from": 0.4, "to": 0.8}, "contact.k_l": {"from": 1e2, "to": 1e4, "scale": "log"}}
    plan = plan_from_dict({"axes": axes, "method": "latin", "runs": count, "seed": seed})
    mu_s, k_l = (np.array(values) for values in plan.columns(0, count).values())
    for share in ((mu_s - 0.4) / 0.4, np.log10(k_l / 1e2) / 2):
        assert sorted(np.floor(share * count).astype(int).tolist()) == list(range(count))
    again = plan_from_dict({"axes": axes, "method": "latin", "runs": count, "seed": seed})
    assert again.columns(0, count) == plan.columns(0, count) and again.digest == plan.digest


@given(st.floats(0.1, 10), st.floats(0.1, 10), st.integers(2, 30), st.sampled_from(["linear", "log"]))
def test_ranges_meet_their_ends_and_are_even(low, high, count, scale):
    if low == high:
        return
    points = np.array(axis_from_node("x", {"from": low, "to": high, "count": count, "scale": scale}).points())
    assert points[0] == low and points[-1] == high
    steps = np.diff(np.log(points) if scale == "log" else points)
    np.testing.assert_allclose(steps, steps[0], rtol=1e-6)


def test_flags_say_the_same_as_a_file():
    for text, node in (
        ("contact.mu_s=0.4:0.9:6", {"from": 0.4, "to": 0.9, "count": 6}),
        ("contact.k_l=1e2:1e4:5:log", {"from": 100, "to": "1e4", "count": 5, "scale": "log"}),
        ("contact.k_l=100:200", {"from": 100, "to": 200}),
        ("kappa=0.7, 1", [0.7, 1]),
        ("manoeuvre=eight,slalom", ["eight", "slalom"]),
    ):
        axis = axis_from_text(text)
        assert axis == axis_from_node(axis.key, node)
        assert axis_from_node(axis.key, axis.as_dict()) == axis


def test_the_digest_knows_everything_that_decides_on_results():
    document = {"axes": {"kappa": [0.7, 0.8]}, "manoeuvre": "short"}
    plan = plan_from_dict(document)
    changes = (
        {"axes": {"kappa": [0.7, 0.9]}}, {"axes": {"control.kappa": [0.7, 0.8]}}, {"manoeuvre": "eight"},
        {"robot": "epiq"}, {"dt": 5e-4}, {"integrator": "semi_implicit"}, {"set": {"contact.mu_s": 0.6}},
        {"sample": 0.1}, {"energy": False}, {"method": "latin", "runs": 2},
    )  # fmt: skip
    digests = [plan_from_dict(document | change).digest for change in changes]
    assert len({plan.digest, *digests}) == 1 + len(changes)
    assert plan_from_dict(dict(document)).digest == plan.digest


def test_values_reach_robot_effects_and_manoeuvre(grid):
    base = grid.base
    values = {
        "contact.mu_s": 0.5, "kappa": 0.9, "effects.slope.grade": 0.1, "effects.motor_drag.motor": "back_left",
        "manoeuvre.segments[1].arc.radius_m": 3.0,
    }  # fmt: skip
    robot = robot_with(base.robot, values)
    assert (robot.contact.mu_s, robot.control.kappa) == (0.5, 0.9)
    assert robot.effects["slope"]["grade"] == 0.1 and robot.effects["motor_drag"]["motor"] == "back_left"
    name, document = manoeuvre_document(base, values)
    assert document["segments"][1]["arc"] == {"radius_m": 3.0, "angle_deg": 40.0}
    assert base.manoeuvres[name]["segments"][1]["arc"]["radius_m"] == 2.0


def test_every_known_number_can_be_an_axis(grid):
    from artibot_sim.sweep.axes import check_value

    base = Base(grid.base.robot, grid.base.manoeuvres)
    present = {key: value for key, _, value in base.robot.quantities() if key != "motor.velocity_filter"}
    for key, value in present.items():
        if math.isfinite(value):
            check_value(key, value, base)
    assert set(present) < set(known_keys(base))
    assert "effects.slope.grade" in known_keys(base) and "manoeuvre.segments[1].arc.radius_m" in known_keys(base)


@pytest.mark.parametrize(
    ("document", "message"),
    [
        ({}, "axes: none; add at least one"),
        ({"axes": {"contact.mu_s": []}}, "axes.contact.mu_s: no value"),
        ({"axes": {"contact.my_s": [0.5]}}, "did you mean 'contact.mu_s'"),
        ({"axes": {"effects.slop.grade": [0.1]}}, "did you mean 'effects.slope.grade'"),
        ({"axes": {"contact.mu_s": [-1.0]}}, "contact.mu_s: -1 is out of bounds"),
        ({"axes": {"kappa": {"from": 0.5, "to": 1.5, "count": 3}}}, "kappa: 1.5 is out of bounds"),
        ({"axes": {"kappa": ["high"]}}, "kappa: found 'high', expected a number"),
        ({"axes": {"kappa": [0.5, 0.5]}}, "0.5 stands twice"),
        ({"axes": {"kappa": {"from": 0.5, "to": 1.0}}}, "axes.kappa: a range without count"),
        ({"axes": {"kappa": {"from": 0.5, "to": 1.0, "count": 0}}}, "axes.kappa.count: found 0"),
        ({"axes": {"kappa": {"from": 0.5, "too": 1.0}}}, "axes.kappa.too: unknown key, did you mean 'to'"),
        ({"axes": {"contact.k_l": {"from": 0, "to": 1, "count": 3, "scale": "log"}}}, "must be above 0"),
        ({"axes": {"effects.motor_drag.motor": ["middle"]}}, "expected one of front_right"),
        ({"axes": {"manoeuvre": ["eihgt"]}}, "did you mean 'eight'"),
        ({"axes": {"manoeuvre.segments[9].arc.radius_m": [1]}}, "no such place, did you mean 'manoeuvre.segments"),
        ({"axes": {"manoeuvre.segments[2].arc.radius_m": [-1]}}, "radius_m: -1 m is out of bounds"),
        ({"axes": {"manoeuvre.segments[2].arc.radios_m": [1]}}, "radios_m: unknown key, did you mean 'radius_m'"),
        ({"axes": {"kappa": [0.7]}, "set": {"kappa": 0.8}}, "kappa: stands under 'axes' and under 'set'"),
        ({"axes": {"kappa": [0.7]}, "method": "lattin"}, "did you mean 'latin'"),
        ({"axes": {"kappa": [0.7]}, "method": "latin"}, "runs: found None"),
        ({"axes": {"kappa": [0.7]}, "method": "latin", "runs": 5}, "axes: all 5 runs would be the same"),
        ({"axes": {"kappa": [0.7]}, "runs": 4}, "runs: a grid has as many"),
        ({"axes": {"kappa": [0.7]}, "dt": 0.003}, "dt: 0.003 s does not divide 0.01 s"),
        ({"axes": {"kappa": [0.7]}, "sets": {}}, "sets: unknown key, did you mean 'set'"),
        ({"axes": {"back.m": [30]}, "robot": "husky"}, "back.m: unknown parameter"),
    ],
)
def test_what_cannot_be_is_refused_with_the_mend(document, message):
    with pytest.raises(ArtibotError) as error:
        plan_from_dict(document).count  # noqa: B018 - counting is what finds an endless range
    assert message in str(error.value) and "\n" not in str(error.value)
