"""Fits side by side: the same results in the same order, cores shared out, errors passed on."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest

from artibot_sim.errors import ArtibotError
from artibot_sim.estimation.parallel import TimeIsUp, side_by_side, threads, until
from artibot_sim.estimation.parameters import MU_D, MU_S, Extension, ParameterSet
from artibot_sim.identify.requested import parameter_set
from artibot_sim.model import load_robot


def test_results_stand_in_the_order_of_the_items_and_each_is_told() -> None:
    heard: list[int] = []
    assert side_by_side(lambda k: k * k, range(7), 3, lambda: heard.append(1)) == [k * k for k in range(7)]
    assert len(heard) == 7
    assert side_by_side(abs, [], 2) == []


def test_cores_are_shared_while_several_are_at_work_and_the_last_has_them_all() -> None:
    assert threads(4) == 4 and threads(None) is None
    both = threading.Barrier(2, timeout=20.0)

    def share(k: int) -> tuple[int, int]:
        early = threads(4) or 0
        both.wait()
        deadline = time.monotonic() + 20.0
        while k == 1 and threads(4) == early and time.monotonic() < deadline:
            time.sleep(0.01)  # until the other one's end is noticed
        return early, threads(4) or 0

    (early, _), (other, late) = side_by_side(share, [0, 1], 4)
    assert (early, other, late) == (2, 2, 4)
    inner = side_by_side(lambda _: side_by_side(lambda k: threading.current_thread().name, [0, 1], 4), [0, 1], 4)
    assert all(len(set(names)) == 1 for names in inner), "tasks of a task stay in its thread"


def test_an_error_ends_the_others_at_their_next_simulation() -> None:
    ended: list[int] = []

    def fails(k: int) -> int:
        if k == 1:
            raise ArtibotError("no")
        try:
            deadline = time.monotonic() + 20.0
            while threads(2) and time.monotonic() < deadline:
                time.sleep(0.01)
        except Exception:
            ended.append(k)
            raise
        return k

    with pytest.raises(ArtibotError, match="no"):
        side_by_side(fails, [0, 1, 2, 3], 2)
    assert ended and set(ended) <= {0, 2}, "and no other is begun"


def test_work_whose_time_is_up_ends_at_its_next_simulation() -> None:
    """In every thread that works for it, and nowhere else."""
    with pytest.raises(TimeIsUp), until(time.perf_counter() - 1.0):
        threads(2)
    assert threads(2) == 2

    def simulated(_: int) -> int:
        return threads(4) or 0

    with pytest.raises(TimeIsUp), until(time.perf_counter() - 1.0), until(time.perf_counter() + 60.0):
        side_by_side(simulated, [0, 1, 2], 2)
    with until(time.perf_counter() + 60.0):
        assert len(side_by_side(simulated, [0, 1, 2], 2)) == 3


@pytest.mark.parametrize("keys", [("k_l", "k_t", "mu_s", "mu_d", "u_w"), ("k_l", "front.i_y"), ("mu_s",)])
def test_a_candidate_is_the_robot_that_is_checked(keys: tuple[str, ...]) -> None:
    robot = load_robot("agriq")
    plain = parameter_set(robot, list(keys))
    own = ParameterSet(robot, plain.parameters, (Extension("slope"), Extension("payload", {"module": "front"})))
    rng = np.random.default_rng(3)
    for _ in range(20):
        at = own.inside(0.3 * rng.standard_normal(len(own)))
        quick, checked = own.candidate(at), own.robot_at(at)
        assert quick == checked and quick.effects == checked.effects
        assert quick.as_vector([MU_S, MU_D]).tolist() == checked.as_vector([MU_S, MU_D]).tolist()
    assert robot == load_robot("agriq")
