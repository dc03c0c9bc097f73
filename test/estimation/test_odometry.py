"""The odometry's covariance holds the errors that slip makes, grows with way and turn, and follows from its parts."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from artibot_sim.estimation.odometry import (
    FLOOR,
    Odometry,
    Slip,
    measured_slip,
    metres_per_radian,
    normalised_errors,
    soil_slip,
    uncertainty,
)
from artibot_sim.model import load_robot, rollout
from artibot_sim.nodes.sim import parameters
from artibot_sim.planning import load_manoeuvre, manoeuvre_names, plan

SLIP = Slip(0.02, 0.2, 0.06)
RADIAN, TRACK = 0.2 / 47.64, 0.72


def driven(slip: Slip, ways: np.ndarray, step: float = 0.01) -> Odometry:
    """An odometry after ways of right and left (m), shape (n, 2), cut into steps."""
    odometry, position = Odometry(RADIAN, TRACK, slip), np.zeros(2)
    odometry.update((0.0, 0.0), (0.0, 0.0))
    for way in ways:
        for part in np.tile(way, (n := max(1, round(np.abs(way).max() / step)), 1)) / n:
            position = position + part / RADIAN
            odometry.update((position[0], position[1]), (0.0, 0.0))
    return odometry


def deviations(odometry: Odometry) -> np.ndarray:
    return np.sqrt(np.diag(odometry.pose_covariance))


def test_a_straight_line_spreads_as_reckoned_by_hand() -> None:
    """Over L metres sigma L all along and sigma sqrt(L) from metre to metre; to the side by the heading's walk too."""
    for length in (1.0, 25.0):
        x, y, yaw = deviations(driven(SLIP, np.array([[length, length]])))
        assert x == pytest.approx(math.hypot(SLIP.travel * length, SLIP.travel * math.sqrt(length), FLOOR[0]), rel=1e-3)
        walk = 2.0 * SLIP.travel / TRACK
        assert yaw == pytest.approx(math.hypot(walk * math.sqrt(length), FLOOR[2]), rel=1e-3)
        led_astray = walk * math.sqrt(length**3 / 3.0)
        side = (SLIP.side * length, SLIP.side * math.sqrt(length), led_astray, FLOOR[1])
        assert y == pytest.approx(math.hypot(*side), rel=1e-2)


def test_it_does_not_depend_on_how_finely_the_way_is_cut() -> None:
    ways = np.array([[3.0, 3.0], [1.5, 0.5], [-1.0, -1.0], [0.4, -0.4]])
    fine, coarse = driven(SLIP, ways, 0.002).pose_covariance, driven(SLIP, ways, 0.02).pose_covariance
    np.testing.assert_allclose(fine, coarse, rtol=5e-3, atol=1e-5)


def test_it_is_a_covariance_and_the_same_whichever_way_the_rover_faces() -> None:
    ways = np.random.default_rng(3).uniform(-1.0, 1.0, (30, 2))
    odometry = driven(SLIP, ways)
    covariance = odometry.pose_covariance
    np.testing.assert_allclose(covariance, covariance.T, atol=1e-15)
    assert np.linalg.eigvalsh(covariance).min() > 0
    turned = Odometry(RADIAN, TRACK, SLIP)
    turned.reset(5.0, -3.0, 1.1)
    position = np.zeros(2)
    turned.update((0.0, 0.0), (0.0, 0.0))
    for way in ways:
        for part in np.tile(way, (n := max(1, round(np.abs(way).max() / 0.01)), 1)) / n:
            position = position + part / RADIAN
            turned.update((position[0], position[1]), (0.0, 0.0))
    c, s = math.cos(1.1), math.sin(1.1)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(turned.pose_covariance, turn @ covariance @ turn.T, rtol=1e-9, atol=1e-12)


def test_sides_that_slip_alike_go_straight_on() -> None:
    apart, alike = (Odometry(0.01, 0.5, Slip(0.02, 0.1, 0.0), same_ground=same) for same in (False, True))
    for odometry in (apart, alike):
        for k in range(1001):
            odometry.update((k, k), (1.0, 1.0))
    assert math.sqrt(apart.pose_covariance[2, 2]) == pytest.approx(2 * 0.02 / 0.5 * math.sqrt(10.0), rel=1e-3)
    assert math.sqrt(alike.pose_covariance[2, 2]) == pytest.approx(1e-3), "the floor"


def test_it_grows_only_while_wheels_turn_and_begins_anew_with_a_reset() -> None:
    odometry = driven(SLIP, np.array([[1.0, 1.0]]))
    before = odometry.pose_covariance
    for _ in range(1000):
        odometry.update((1.0 / RADIAN, 1.0 / RADIAN), (0.0, 0.0))
    np.testing.assert_allclose(odometry.pose_covariance, before, rtol=1e-9)
    odometry.reset(1.0, 2.0, 3.0)
    np.testing.assert_allclose(odometry.pose_covariance, np.diag(np.square(FLOOR)), atol=1e-18)


def test_the_twist_s_covariance_follows_speed_and_turn() -> None:
    odometry = Odometry(RADIAN, TRACK, SLIP)
    np.testing.assert_allclose(odometry.twist_covariance, np.diag(np.square(FLOOR)))
    odometry.update((0.0, 0.0), (1.0 / RADIAN, 0.6 / RADIAN))
    speed, rate = odometry.twist
    forward, side, turn = np.sqrt(np.diag(odometry.twist_covariance))
    assert forward == pytest.approx(math.hypot(0.02 * speed, FLOOR[0]))
    assert side == pytest.approx(math.hypot(0.06 * speed, FLOOR[1]))
    assert turn == pytest.approx(math.hypot(0.2 * rate, 0.04 * speed / TRACK, FLOOR[2]))


@pytest.mark.parametrize("name", ["agriq", "epiq", "husky"])
def test_errors_of_simulated_runs_are_within_what_it_states(name: str) -> None:
    """Position and heading at the end of each manoeuvre, in standard deviations."""
    robot, errors = load_robot(name), []
    slip = measured_slip(robot)
    for manoeuvre in manoeuvre_names():
        result = rollout(robot, plan(load_manoeuvre(manoeuvre), robot).commands(), kappa=0.8, every=10)
        odometry = Odometry(metres_per_radian(robot), robot.front.i_y, slip)
        for q, v in zip(result.q, result.v, strict=True):
            odometry.update((q[6], q[7]), (v[6], v[7]))
        errors.append(np.abs(np.array(odometry.pose) - result.q[-1, [0, 1, 5]]) / deviations(odometry))
    assert np.max(errors) < 3.0
    assert np.max(errors) > 0.2, "nor is it so wide that it says nothing"


def test_its_errors_are_as_stated_also_where_a_wrong_turn_bends_the_path() -> None:
    """Drives whose errors are drawn as the module says: their normalised squared error is 3 in the mean.

    A turn that is wrong by a third leads by a radian astray in a circle: an error of the place that is proportional to
    that of the turn, as it is for small ones, would have 20 there.
    """
    slip, rng, step = Slip(0.01, 0.35, 0.01), np.random.default_rng(1), 0.05
    ways = np.concatenate([np.tile((0.9, 1.1), (20, 1)), np.tile((1.1, 0.9), (20, 1))]) * 1.2
    odometry = driven(slip, ways, step)
    n = round(np.abs(ways).max() / step)
    turns = np.repeat((ways[:, 0] - ways[:, 1]) / TRACK / n, n)
    way = np.repeat(ways.mean(axis=1) / n, n)
    rolled = np.repeat(np.abs(ways).max(axis=1) / n, n)

    def drawn(deviation: float) -> np.ndarray:
        """Relative errors of each step, shape (drives, steps): the same all along, and a walk by metres."""
        changing = rng.standard_normal((2000, len(way))) / np.sqrt(rolled)
        return deviation * (rng.standard_normal((2000, 1)) + changing)

    walk = 2.0 * slip.travel / TRACK * rng.standard_normal((2000, len(way))) * np.sqrt(rolled)
    turned = turns * (1.0 + drawn(slip.turn)) + walk
    heading = np.cumsum(turned, axis=1) - 0.5 * turned
    along, aside = way * (1.0 + drawn(slip.travel)), way * drawn(slip.side)
    x = np.sum(along * np.cos(heading) - aside * np.sin(heading), axis=1)
    y = np.sum(along * np.sin(heading) + aside * np.cos(heading), axis=1)
    errors = np.column_stack((x, y, turned.sum(axis=1))) - odometry.pose
    squares = np.einsum("ni,ni->n", errors, np.linalg.solve(odometry.pose_covariance, errors.T).T)
    assert squares.mean() == pytest.approx(3.0, rel=0.2)


@pytest.mark.long
def test_errors_on_other_soils_are_not_larger_than_stated() -> None:
    """Of the Husky, which scrubs most: its turns fall a third short, and headings a radian."""
    squares, alike = normalised_errors(load_robot("husky"))
    assert (alike >= squares).all(), "sides that slip alike leave less unknown"
    assert np.mean(squares > 7.815) < 0.05
    assert 0.3 < squares.mean() < 3.0


@pytest.mark.parametrize("name", ["agriq", "epiq", "husky", "warthog", "optiodom_diff"])
def test_robot_files_say_what_robots_slip_in_simulation_and_nodes_take_it(name: str) -> None:
    """``python -m artibot_sim.estimation.odometry`` prints it for all robots."""
    robot = load_robot(name)
    settings = {name: parameters.SPECS[name].default for name in parameters.SPECS if name.startswith("odometry.")}
    stated = Slip.of(settings, dataclasses.replace(robot, intervals={}))
    for part, value in dataclasses.asdict(measured_slip(robot)).items():
        assert value / 1.15 < getattr(stated, part) < 1.5 * value


def test_the_uncertainty_of_identified_geometry_adds_to_it() -> None:
    robot = load_robot("agriq")
    settings = {f"odometry.{name}_slip": value for name, value in (("travel", 0.03), ("turn", 0.04), ("side", 0.05))}
    assert Slip.of(settings, robot) == Slip(0.03, 0.04, 0.05)
    radius, track = robot.wheel.r_w, robot.front.i_y
    intervals = {"wheel.r_w": (0.9 * radius, 1.1 * radius), "front.i_y": (track - 0.05, track + 0.05)}
    identified = dataclasses.replace(robot, intervals=intervals)
    assert uncertainty(identified, "wheel.r_w") == pytest.approx(0.1 / 1.96)
    found = Slip.of(settings, identified)
    assert found.travel == pytest.approx(math.hypot(0.03, 0.1 / 1.96))
    assert found.turn == pytest.approx(math.hypot(0.04, 0.1 / 1.96, 0.05 / 1.96 / track))


@pytest.mark.parametrize("name", ["agriq", "husky"])
def test_the_uncertainty_of_identified_soil_adds_to_it(name: str) -> None:
    """A turn of robots drawn within the intervals scatters as is stated; twice the interval is twice as much."""
    robot = load_robot(name)
    assert soil_slip(dataclasses.replace(robot, intervals={})) == Slip()

    def identified(width: float, *keys: str) -> Slip:
        values = {key: robot.as_vector([key])[0] for key in keys}
        intervals = {key: ((1 - width) * value, (1 + width) * value) for key, value in values.items()}
        return soil_slip(dataclasses.replace(robot, intervals=intervals))

    soil = ("contact.k_l", "contact.k_t", "contact.mu_d")
    narrow, wide = identified(0.05, *soil), identified(0.10, *soil)
    assert wide.turn == pytest.approx(2.0 * narrow.turn, rel=0.2)
    assert wide.turn > 1e-3, "the soil decides how much a turn falls short"
    parts = [identified(0.05, key).turn for key in soil]
    assert narrow.turn == pytest.approx(math.hypot(*parts), rel=1e-6)
    settings = {f"odometry.{part}_slip": 0.01 for part in ("travel", "turn", "side")}
    values = {key: robot.as_vector([key])[0] for key in soil}
    given = dataclasses.replace(robot, intervals={key: (0.9 * value, 1.1 * value) for key, value in values.items()})
    assert Slip.of(settings, given).turn == pytest.approx(math.hypot(0.01, wide.turn))
