"""Each kind of segment, against geometry worked out apart from the planner."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from planning.strategies import A_MAX, AGRIQ, number, of, signed
from scipy.integrate import quad
from scipy.special import fresnel, jn_zeros

from artibot_sim.errors import ArtibotError
from artibot_sim.planning import (
    Arc,
    Dwell,
    Eight,
    Manoeuvre,
    Ramp,
    Repeat,
    Segment,
    Slalom,
    SpeedChirp,
    Spiral,
    Stop,
    Straight,
    TurnInPlace,
    YawRateChirp,
    plan,
)


@given(number(-5.0, 5.0), number(0.05, 3.0))
def test_a_ramp_takes_the_time_and_length_of_the_cubic_profile(speed: float, a_max: float) -> None:
    if abs(speed) < 1e-3:
        speed = 1.0
    p = of(Ramp(speed, a_max=a_max))
    assert p.duration == pytest.approx(1.5 * abs(speed) / a_max, rel=1e-12)
    assert p.path_length == pytest.approx(0.75 * speed**2 / a_max, rel=1e-12)
    u = np.linspace(0, 1, 21)
    np.testing.assert_allclose(p.at(u * p.duration).twist[:, 0], speed * (3 * u**2 - 2 * u**3), atol=1e-12)


@given(number(0.2, 20.0), signed(0.01, 12.0), signed(0.1, 3.0))
def test_an_arc_lies_on_its_circle(radius: float, angle: float, speed: float) -> None:
    p = of(Ramp(speed, a_max=10.0), Arc(radius, angle))
    arc = p.marks[1]
    s = p.at(np.linspace(arc.start, arc.end, 40))
    centre = s.pose[0, :2] + [0.0, math.copysign(radius, angle)]
    np.testing.assert_allclose(np.linalg.norm(s.pose[:, :2] - centre, axis=1), radius, rtol=1e-10)
    assert p.path_length - s.travelled[0] == pytest.approx(radius * abs(angle), rel=1e-10)
    assert s.pose[-1, 2] == pytest.approx(angle * math.copysign(1, speed), rel=1e-10)


@pytest.mark.parametrize("speed", [0.7, -0.7])
@pytest.mark.parametrize("left_first", [True, False])
@pytest.mark.parametrize("smooth", [True, False])
def test_an_eight_closes(smooth: bool, left_first: bool, speed: float) -> None:
    radius = 1.7
    p = of(Eight(radius, left_first, smooth, speed=speed, end_speed=0.0))
    np.testing.assert_allclose(p.at(p.duration).pose[0], [0.0, 0.0, 0.0], atol=1e-12)
    length = 2 * math.pi * radius * (jn_zeros(0, 1)[0] if smooth else 2)
    assert p.path_length == pytest.approx(length, rel=1e-12)
    s = p.at(np.linspace(0.01, p.duration - 0.01, 5001))
    curvature = s.twist[:, 1] / s.twist[:, 0]
    assert np.max(np.abs(curvature)) == pytest.approx(1 / radius, rel=1e-5)
    assert (curvature[5] > 0) == left_first
    assert np.min(s.pose[:, 1]) < -radius / 2  # a lobe on either side
    assert np.max(s.pose[:, 1]) > radius / 2


@settings(max_examples=30)
@given(number(0.5, 10.0), signed(0.05, 1.0))
def test_a_spiral_is_a_fresnel_integral(length: float, end: float) -> None:
    p = of(Ramp(1.0, a_max=50.0), Spiral(length, 0.0, end))
    spiral = p.marks[1]
    s = p.at(np.linspace(spiral.start, spiral.end, 30))
    arc = s.travelled - s.travelled[0]
    scale = math.sqrt(math.pi * length / abs(end))
    sine, cosine = fresnel(arc / scale)
    np.testing.assert_allclose(s.pose[:, 0] - s.pose[0, 0], scale * cosine, atol=1e-12)
    np.testing.assert_allclose(s.pose[:, 1], math.copysign(scale, end) * sine, atol=1e-12)


@settings(max_examples=20)
@given(signed(0.1, 1.0), number(2.0, 8.0), number(0.3, 3.0), number(-6.0, 6.0))
def test_a_slalom_is_the_integral_of_its_sine(
    curvature: float, wavelength: float, periods: float, phase: float
) -> None:
    p = of(Ramp(0.5), Slalom(curvature, wavelength, periods, phase))
    length, k = wavelength * periods, 2 * math.pi / wavelength

    def yaw(s: float) -> float:
        return curvature / k * (math.cos(phase) - math.cos(k * s + phase))

    x = quad(lambda s: math.cos(yaw(s)), 0, length, limit=200, epsabs=1e-12)[0]
    y = quad(lambda s: math.sin(yaw(s)), 0, length, limit=200, epsabs=1e-12)[0]
    start, end = p.at(np.array([p.marks[1].start, p.duration])).pose
    np.testing.assert_allclose(end - start, [x, y, yaw(length)], atol=1e-10)


@given(signed(0.01, 12.0), number(0.1, 2.0), number(0.1, 3.0))
def test_a_turn_in_place_keeps_to_its_limits(angle: float, yaw_rate: float, yaw_a_max: float) -> None:
    p = of(TurnInPlace(angle, yaw_rate, yaw_a_max))
    s = p.at(np.linspace(0, p.duration, 2001))
    np.testing.assert_array_equal(s.pose[:, :2], 0.0)
    assert p.path_length == 0
    assert s.pose[-1, 2] == pytest.approx(angle, rel=1e-9)
    assert np.max(np.abs(s.twist[:, 1])) <= yaw_rate * (1 + 1e-9)
    assert np.max(np.abs(np.diff(s.twist[:, 1]) / np.diff(s.t))) <= yaw_a_max * (1 + 1e-6)
    np.testing.assert_allclose(s.velocity[:, 0], -s.velocity[:, 1])


def test_a_short_turn_in_place_uses_all_its_acceleration() -> None:
    p = of(TurnInPlace(0.1, 5.0, 1.0))
    # two ramps of 0.75 w²/a each
    assert np.max(p.at(np.linspace(0, p.duration, 2001)).twist[:, 1]) == pytest.approx(math.sqrt(0.1 / 1.5), rel=1e-5)


def test_a_yaw_rate_chirp_sweeps_its_frequencies_about_a_constant_speed() -> None:
    p = of(Ramp(0.6), YawRateChirp(0.1, 1.0, 20.0, 2.0, amplitude=0.3))
    chirp = p.marks[1]
    s = p.at(np.linspace(chirp.start, chirp.end, 4001))
    np.testing.assert_allclose(s.twist[:, 0], 0.6, rtol=1e-12)
    np.testing.assert_allclose(s.twist[[0, -1], 1], 0.0, atol=1e-12)
    assert np.max(np.abs(s.twist[:, 1])) == pytest.approx(0.3, rel=1e-3)
    t = s.t - chirp.start
    middle = (t > 3) & (t < 17)  # outside the fades the zeros are those of sin(2 pi (0.1 t + 0.0225 t²))
    zeros = t[:-1][middle[:-1] & (np.diff(np.sign(s.twist[:, 1])) != 0)]
    cycles = 0.1 * zeros + 0.0225 * zeros**2
    np.testing.assert_allclose(2 * cycles, np.round(2 * cycles), atol=0.02)
    assert len(zeros) > 10


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_a_speed_chirp_swings_about_the_speed_on_its_arc(direction: float) -> None:
    p = of(Ramp(direction * 0.6), SpeedChirp(0.1, 0.4, 20.0, amplitude=0.15, curvature=0.25))
    chirp = p.marks[1]
    s = p.at(np.linspace(chirp.start, chirp.end, 4001))
    assert np.max(s.twist[:, 0]) == pytest.approx(direction * 0.6 + 0.15, rel=1e-3)
    assert np.min(s.twist[:, 0]) == pytest.approx(direction * 0.6 - 0.15, rel=1e-3)
    np.testing.assert_allclose(s.twist[:, 1], 0.25 * s.twist[:, 0], rtol=1e-12)
    centre = s.pose[0, :2] + [0, 4.0]
    np.testing.assert_allclose(np.linalg.norm(s.pose[:, :2] - centre, axis=1), 4.0, rtol=1e-10)
    assert np.max(np.abs(np.diff(s.twist[:, 0]) / np.diff(s.t))) <= A_MAX


def test_the_speed_may_change_within_a_path() -> None:
    p = of(Straight(3.0, speed=0.5), Arc(2.0, 3.0, speed=1.0, end_speed=0.25, a_max=1.0), Straight(1.0, end_speed=0.0))
    arc = p.marks[1]
    t = np.array([arc.start, arc.start + 0.75, arc.end - 1.125, arc.end, p.duration])
    np.testing.assert_allclose(p.at(t).twist[:, 0], [0.5, 1.0, 1.0, 0.25, 0.0], atol=1e-12)
    assert p.path_length == pytest.approx(3.0 + 6.0 + 1.0, rel=1e-12)
    t = np.linspace(0, p.duration, 20001)
    acceleration = np.diff(p.at(t).twist[:, 0]) / np.diff(t)
    assert np.max(acceleration) == pytest.approx(1.0, rel=1e-4)
    assert np.min(acceleration) == pytest.approx(-1.0, rel=1e-4)


def test_a_blend_keeps_length_and_heading_and_removes_the_jumps() -> None:
    segments = (Ramp(1.0), Straight(2.0), Arc(2.0, 3.0), Arc(2.0, -3.0), Straight(2.0), Stop())
    jumping, blended = of(*segments), of(*segments, blend=0.8)
    assert (blended.path_length, blended.duration) == pytest.approx((jumping.path_length, jumping.duration), rel=1e-12)
    assert blended.at(blended.duration).pose[0, 2] == pytest.approx(0.0, abs=1e-12)
    t = np.linspace(0, blended.duration, 20001)
    s = blended.at(t)
    # 0.5/m to -0.5/m over 0.8 m at 1 m/s
    assert np.max(np.abs(np.diff(s.twist[:, 1]) / np.diff(t))) == pytest.approx(1.0 / 0.8, rel=1e-3)
    assert np.max(np.abs(np.diff(jumping.at(t).twist[:, 1]))) == pytest.approx(1.0, rel=1e-2)
    assert np.max(np.linalg.norm(s.pose[:, :2] - jumping.at(t).pose[:, :2], axis=1)) < 0.8


def test_a_blend_does_not_act_where_the_rover_stands() -> None:
    segments = (Arc(2.0, 2.0, speed=0.5, end_speed=0.0), Arc(2.0, -2.0, speed=0.5, end_speed=0.0))
    np.testing.assert_array_equal(of(*segments, blend=1.0).pose, of(*segments).pose)


def test_a_repetition_is_its_segments_again_and_again() -> None:
    part: tuple[Segment, ...] = (Straight(1.0, speed=0.5, end_speed=0.0), Dwell(0.5))
    p = of(Repeat(3, part))
    assert p.path_length == pytest.approx(3.0, rel=1e-12)
    assert p.duration == pytest.approx(3 * of(*part).duration, rel=1e-12)
    assert [mark.label for mark in p.marks[:2]] == [
        "segments[0].repeat.segments[0].straight",
        "segments[0].repeat.segments[1].dwell",
    ]


@pytest.mark.parametrize(
    ("segments", "blend", "message"),
    [
        ((Straight(2.0),), 0, r"segments\[0\].straight: the rover stands; give this segment a speed"),
        ((Ramp(1.0), Dwell(1.0)), 0, r"segments\[1\].dwell: the rover runs at 1 m/s.* put a stop before"),
        ((Ramp(1.0), TurnInPlace(1.0, 1.0, 1.0)), 0, r"segments\[1\].turn_in_place: the rover runs"),
        ((Ramp(1.0), Ramp(-1.0)), 0, r"segments\[1\].ramp: the speed changes from 1 to -1.* put a stop between"),
        ((Straight(0.5, speed=1.0),), 0, r"straight: its changes of speed take 1.5 m, the path has 0.5 m"),
        ((Ramp(0.2), SpeedChirp(0.1, 0.1, 9.0, amplitude=0.3)), 0, r"speed_chirp: .* would reverse the rover"),
        ((Ramp(1.0), SpeedChirp(1.0, 1.0, 9.0, amplitude=0.5)), 0, r"speed_chirp: it accelerates at up to 3.1"),
        ((Ramp(1.0), Straight(0.5), Arc(2.0, 1.0)), 1.5, r"segments\[1\].straight: it is 0.5 m .* shorten the blend"),
        ((Stop(),), 0, "nothing moves"),
        ((Repeat(9999, (Repeat(9999, (Dwell(1.0),)),)),), 0, "repeat fewer times"),
    ],
)
def test_what_cannot_be_driven_is_refused_with_the_mend(
    segments: tuple[Segment, ...], blend: float, message: str
) -> None:
    with pytest.raises(ArtibotError, match=f"^test: .*{message}"):
        of(*segments, blend=blend)


def test_a_ramp_without_any_acceleration_is_refused() -> None:
    with pytest.raises(ArtibotError, match="no a_max is given"):
        plan(Manoeuvre("m", (Ramp(1.0),)), AGRIQ)
