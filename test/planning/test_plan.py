"""What a plan must be, whatever the manoeuvre."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planning.strategies import A_MAX, AGRIQ, integral, manoeuvres, number, of, starts

from artibot_sim.errors import ArtibotError
from artibot_sim.planning import Arc, FrontKinematics, Manoeuvre, PlanSample, Ramp, Segment, Stop, Straight, plan

MORE = settings(max_examples=25, deadline=None)


@MORE
@given(manoeuvres())
def test_motor_rotations_are_the_integral_of_their_velocities(m: Manoeuvre) -> None:
    p = plan(m, AGRIQ)
    t, rotation = integral(p, lambda sample: sample.velocity)
    np.testing.assert_allclose(p.at(t).position, rotation, atol=1e-5, rtol=1e-10)  # a ramp may end inside a cell


@MORE
@given(manoeuvres(), starts())
def test_pose_and_length_are_the_integrals_of_the_twist(m: Manoeuvre, start: tuple[float, float, float]) -> None:
    def rate(sample: PlanSample) -> np.ndarray:
        (v, yaw_rate), yaw = sample.twist.T, sample.pose[:, 2]
        return np.column_stack([v * np.cos(yaw), v * np.sin(yaw), yaw_rate, v, np.abs(v)])

    p = plan(m, AGRIQ, start=start)
    t, expected = integral(p, rate)
    got = p.at(t)
    np.testing.assert_allclose(got.pose, start + expected[:, :3], atol=1e-7)
    np.testing.assert_allclose(got.arc, expected[:, 3], atol=1e-7)
    np.testing.assert_allclose(got.travelled, expected[:, 4], atol=1e-7)
    assert p.path_length == pytest.approx(got.travelled[-1], abs=1e-12)


@MORE
@given(manoeuvres(), starts())
def test_it_begins_at_the_start_and_ends_at_rest(m: Manoeuvre, start: tuple[float, float, float]) -> None:
    p = plan(m, AGRIQ, start=start)
    np.testing.assert_array_equal(p.pose[0], start)
    np.testing.assert_array_equal(p.position[0], 0.0)
    ends = p.at(np.array([-1.0, 0.0, p.duration, p.duration + 1.0]))
    np.testing.assert_allclose(ends.twist, 0.0, atol=1e-12)
    np.testing.assert_allclose(ends.pose[3], ends.pose[2], atol=1e-12)
    assert p.warnings == ()


@MORE
@given(manoeuvres())
def test_speed_never_changes_faster_than_a_max(m: Manoeuvre) -> None:
    p = plan(m, AGRIQ)
    t = np.linspace(0.0, p.duration, 4001)
    acceleration = np.diff(p.at(t).twist[:, 0]) / np.diff(t)
    assert np.max(np.abs(acceleration)) <= A_MAX * (1 + 1e-6)


@MORE
@given(manoeuvres())
def test_left_and_right_are_mirror_images(m: Manoeuvre) -> None:
    p, q = plan(m, AGRIQ), plan(m.mirrored(), AGRIQ)
    np.testing.assert_array_equal(q.pose, p.pose * [1, -1, -1])
    np.testing.assert_array_equal(q.twist, p.twist * [1, -1])
    np.testing.assert_array_equal(q.velocity, p.velocity[:, ::-1])
    np.testing.assert_array_equal(q.position, p.position[:, ::-1])
    assert m.mirrored().mirrored().segments == m.segments


@MORE
@given(manoeuvres(), starts())
def test_the_start_pose_only_moves_the_plan(m: Manoeuvre, start: tuple[float, float, float]) -> None:
    p, q = plan(m, AGRIQ), plan(m, AGRIQ, start=start)
    x, y, yaw = start
    c, s = math.cos(yaw), math.sin(yaw)
    moved = np.column_stack(
        [x + c * p.pose[:, 0] - s * p.pose[:, 1], y + s * p.pose[:, 0] + c * p.pose[:, 1], yaw + p.pose[:, 2]]
    )
    np.testing.assert_allclose(q.pose, moved, atol=1e-10)
    np.testing.assert_allclose(q.position, p.position, atol=1e-9)


@MORE
@given(manoeuvres(), st.sampled_from([0.001, 0.004, 0.02, 0.1]))
def test_sampling_does_not_change_the_motion(m: Manoeuvre, dt: float) -> None:
    p, q = plan(m, AGRIQ), plan(m, AGRIQ, dt=dt)
    assert (p.duration, p.path_length, p.marks) == (q.duration, q.path_length, q.marks)
    for name in ("pose", "twist", "travelled", "velocity", "position"):
        np.testing.assert_array_equal(getattr(p.at(q.t), name), getattr(q, name))
    assert q.t[-1] >= q.duration - 1e-5 * dt
    assert q.t[-2] < q.duration


@MORE
@given(manoeuvres())
def test_marks_cover_the_duration(m: Manoeuvre) -> None:
    p = plan(m, AGRIQ)
    assert p.marks[0].start == 0
    assert p.marks[-1].end == pytest.approx(p.duration, rel=1e-12)
    assert all(a.end == b.start for a, b in zip(p.marks, p.marks[1:], strict=False))


@MORE
@given(
    st.lists(
        st.one_of(st.builds(Straight, number(0.5, 3)), st.builds(Arc, number(1, 3), number(-4, -0.2))),
        min_size=1,
        max_size=4,
    )
)
def test_in_reverse_it_comes_back_the_way_it_went(paths: list[Segment]) -> None:
    there = of(Ramp(0.8), *paths, Stop())
    back = [Ramp(-0.8), *reversed(paths), Stop()]
    home = plan(Manoeuvre("back", tuple(back), a_max=A_MAX), AGRIQ, start=there.at(there.duration).pose[0])
    assert home.duration == pytest.approx(there.duration, rel=1e-12)
    t = np.linspace(0, there.duration, 501)
    np.testing.assert_allclose(home.at(there.duration - t).pose, there.at(t).pose, atol=1e-10)


@given(number(0.05, 2.0), number(1e-3, 0.3), st.integers(0, 2**32 - 1))
def test_inverse_then_forward_kinematics_changes_nothing(track: float, travel: float, seed: int) -> None:
    kinematics = FrontKinematics(track, travel)
    v, w = np.random.default_rng(seed).normal(size=(2, 20))
    for got, expected in zip(kinematics.forward(kinematics.inverse(v, w)), (v, w), strict=True):
        np.testing.assert_allclose(got, expected, atol=1e-12)


def test_the_right_wheels_are_the_faster_ones_in_a_left_turn() -> None:
    p = of(Ramp(1.0), Arc(2.0, 1.0), Stop())
    right, left = p.at(p.marks[1].start + 0.1).velocity[0]
    # wheels at R ± i_y/2 from the centre, over r_w, times the reduction
    assert right == pytest.approx(1.0 * (2.0 + 0.36) / 2.0 / 0.2 * 47.64, rel=1e-12)
    assert left == pytest.approx(1.0 * (2.0 - 0.36) / 2.0 / 0.2 * 47.64, rel=1e-12)


def test_arrays_cannot_be_written() -> None:
    p = of(Ramp(1.0), Stop())
    for name in ("t", "pose", "twist", "travelled", "velocity", "position"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(p, name)[0] = 1.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        p.dt = 0.1  # type: ignore[misc]


def test_a_jump_at_a_sample_shows_the_value_after_it() -> None:
    p = of(Ramp(1.0), Straight(2.0), Arc(2.0, 1.0), Stop())
    jump = p.marks[2].start  # 5 s, a multiple of dt up to rounding
    yaw_rate = p.at(np.array([jump - 1e-6, jump - 1e-12, jump, jump + 1e-6])).twist[:, 1]
    np.testing.assert_allclose(yaw_rate, [0.0, 0.5, 0.5, 0.5], atol=1e-12)
    assert p.twist[np.argmin(np.abs(p.t - jump)), 1] == pytest.approx(0.5)


def test_a_plan_that_ends_moving_or_too_fast_warns() -> None:
    manoeuvre = Manoeuvre("fast", (Ramp(1.0), Arc(2.0, 1.0)), a_max=A_MAX)
    p = plan(manoeuvre, AGRIQ, wheel_speed_limit=1.1)
    assert len(p.warnings) == 2
    assert "ends at 1 m/s" in p.warnings[0]
    assert "1.18 m/s" in p.warnings[1]
    end = p.at(np.array([p.duration, p.duration + 0.5]))
    assert end.travelled[1] - end.travelled[0] == pytest.approx(0.5)
    centre = p.at(p.marks[1].start).pose[0, :2] + [0.0, 2.0]
    assert np.linalg.norm(end.pose[1, :2] - centre) == pytest.approx(2.0, abs=1e-12)  # still on the arc


@pytest.mark.parametrize("dt", [0.0, -0.01, math.nan, math.inf, 2.0])
def test_an_impossible_interval_is_refused(dt: float) -> None:
    with pytest.raises(ArtibotError, match="dt: found"):
        plan(Manoeuvre("m", (Ramp(1.0),), a_max=A_MAX), AGRIQ, dt=dt)


@pytest.mark.parametrize("start", [(0.0, 0.0), (0.0, math.nan, 0.0)])
def test_an_impossible_start_is_refused(start: tuple[float, ...]) -> None:
    with pytest.raises(ArtibotError, match="start: found"):
        plan(Manoeuvre("m", (Ramp(1.0),), a_max=A_MAX), AGRIQ, start=start)
