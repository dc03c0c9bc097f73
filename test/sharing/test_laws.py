"""Torque-sharing laws: what holds for each, and how one's own is brought in."""

from __future__ import annotations

import pytest

from artibot_sim.errors import ArtibotError
from artibot_sim.model import load_robot
from artibot_sim.sharing import LAWS, Cycle, load_law
from artibot_sim.sharing.base import eq30

AGRIQ = load_robot("agriq")

OWN = """
from artibot_sim.sharing import Law


def share(robot, cycle, part=0.5):
    total = part * sum(cycle.front_torque)
    return total, total


LAW = Law("own", "A part of the front's torque.", share)
"""


def cycle(front=(0.2, 0.1), velocity=(30.0, 20.0), back=(0.0, 0.0), kappa=0.8) -> Cycle:
    return Cycle(velocity, front, back, kappa)


@pytest.mark.parametrize("name", LAWS)
def test_mirrored_cycles_give_mirrored_torques(name):
    law = LAWS[name]
    right, left = law.torques(AGRIQ, cycle())
    mirrored = law.torques(AGRIQ, cycle((0.1, 0.2), (20.0, 30.0)))
    assert mirrored == pytest.approx((left, right), abs=1e-15)


@pytest.mark.parametrize("name", LAWS)
def test_backwards_is_forwards_with_all_signs_turned(name):
    law = LAWS[name]
    right, left = law.torques(AGRIQ, cycle((0.2, 0.1), (30.0, 20.0), (0.05, 0.05)))
    back = law.torques(AGRIQ, cycle((-0.2, -0.1), (-30.0, -20.0), (-0.05, -0.05)))
    assert sum(back) == pytest.approx(-right - left, abs=1e-15)


@pytest.mark.parametrize("name", LAWS)
def test_without_front_torque_the_back_motors_rest(name):
    assert LAWS[name].torques(AGRIQ, cycle((0.0, 0.0))) == pytest.approx((0.0, 0.0), abs=1e-15)


@pytest.mark.parametrize("name", LAWS)
def test_torques_stay_within_the_back_motors_limit(name):
    right, left = LAWS[name].torques(AGRIQ, cycle((1e3, 1e3)))
    most = AGRIQ.drive.back.torque_max
    assert abs(right) <= most and abs(left) <= most


def test_constant_is_eq_30():
    gears = AGRIQ.drive.back.tau / AGRIQ.drive.front.tau
    for kappa in (0.65, 0.8, 1.0):
        both = load_law(f"constant:kappa={kappa}").torques(AGRIQ, cycle())
        assert both == pytest.approx([(1 / kappa - 1) * gears * 0.3 / 2] * 2)


def test_by_curvature_moves_between_its_kappas():
    law = load_law("by_curvature:straight=0.9,turn=0.7,radius=2")
    straight = law.torques(AGRIQ, cycle(velocity=(25.0, 25.0)))[0]
    on_the_spot = law.torques(AGRIQ, cycle(velocity=(25.0, -25.0)))[0]
    assert straight == pytest.approx(eq30(AGRIQ, 0.9, (0.2, 0.1)))
    assert on_the_spot == pytest.approx(eq30(AGRIQ, 0.7, (0.2, 0.1)))


def test_relieve_helps_only_front_motors_that_have_too_much():
    law, rated = LAWS["relieve"], AGRIQ.drive.front.rated_torque
    assert law.torques(AGRIQ, cycle((0.5 * rated, 0.4 * rated)))[0] == 0.0
    helped = law.torques(AGRIQ, cycle((1.5 * rated, rated)))[0]
    more = law.torques(AGRIQ, cycle((1.5 * rated, rated), back=(helped, helped)))[0]
    assert 0.0 < helped < more


def test_vectoring_keeps_the_sum_and_favours_the_outer_motor():
    law = LAWS["vectoring"]
    right, left = law.torques(AGRIQ, cycle())
    assert right > left  # a left turn
    assert right + left == pytest.approx(2 * eq30(AGRIQ, 0.8, (0.2, 0.1)))


def test_a_law_of_ones_own_is_a_file(tmp_path):
    path = tmp_path / "own.py"
    path.write_text(OWN)
    law = load_law(f"{path}:part=0.25")
    assert law.torques(AGRIQ, cycle()) == pytest.approx((0.075, 0.075))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("konstant", "did you mean 'constant'"),
        ("constant:kapa=0.7", "did you mean 'kappa'"),
        ("constant:kappa", "PARAMETER=VALUE"),
        ("constant:kappa=much", "finite number"),
        ("nowhere.py", "no such file"),
    ],
)
def test_what_is_wrong_with_a_law_is_said_in_one_line(text, said):
    with pytest.raises(ArtibotError, match="law") as error:
        load_law(text)
    assert said in str(error.value) and "\n" not in str(error.value)


def test_a_file_without_a_law_or_that_fails_is_refused(tmp_path):
    empty, broken = tmp_path / "empty.py", tmp_path / "broken.py"
    empty.write_text("x = 1\n")
    broken.write_text("1 / 0\n")
    with pytest.raises(ArtibotError, match="no LAW in it"):
        load_law(str(empty))
    with pytest.raises(ArtibotError, match="ZeroDivisionError"):
        load_law(str(broken))
