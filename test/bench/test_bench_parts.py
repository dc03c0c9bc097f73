"""The measuring itself: filters, soils, files, timing."""

from __future__ import annotations

import json
import time
from dataclasses import replace

import numpy as np
import pytest

from artibot_sim.bench import model, nodes, results
from artibot_sim.bench.comparison import number
from artibot_sim.bench.model import SOIL, Scenario, soils
from artibot_sim.bench.results import Peer, Result, write_json
from artibot_sim.model import load_robot


def test_high_pass_takes_away_slow_motion_and_keeps_what_alternates():
    dt = 1e-3
    t = dt * np.arange(2000)
    slow = np.column_stack([3.0 + 0.5 * t, 120.0 + np.sin(0.5 * t)])
    assert np.abs(model.high_pass(slow, dt)).max() < 1e-3
    fast = np.where(np.arange(2000) % 2 == 0, 0.1, -0.1)[:, None]
    kept = model.high_pass(slow[:, :1] + fast, dt)
    assert np.sqrt(np.mean(kept**2)) == pytest.approx(0.1, rel=0.05)


def test_ripple_measures_a_limit_cycle_of_the_back_motors_alone():
    scenario, dt, steady = Scenario(quick=True), 1e-3, (6.6, 8.0)
    clean = scenario.rollout("rk4", dt, every=dt)
    swing = np.where(np.arange(len(clean.t)) % 2 == 0, 0.2, -0.2)
    front, back = clean.v.copy(), clean.v.copy()
    front[:, 6] += swing  # not looked at
    back[:, 14] += swing  # one of two: RMS 0.2 / sqrt(2)
    assert model.ripple(clean, steady, dt) < 0.01
    assert model.ripple(replace(clean, v=front), steady, dt) == model.ripple(clean, steady, dt)
    assert model.ripple(replace(clean, v=back), steady, dt) == pytest.approx(0.1414, rel=0.05)


def test_the_steady_part_is_steady():
    scenario = Scenario()
    first, last = scenario.steady
    part = scenario.plan.twist[round(first / 0.01) : round(last / 0.01) + 1]
    assert last - first > 3.0
    assert np.ptp(part, axis=0).max() < 1e-9
    assert abs(part[0, 1]) > 0.1  # and a turn: there the wheels slip


def test_soils_are_a_latin_hypercube_and_always_the_same():
    robot, count = load_robot("agriq"), 16
    values = np.array([soil.as_vector(list(SOIL)) for soil in soils(robot, count)])
    low, high = np.array(list(SOIL.values())).T
    strata = np.floor((values - low) / (high - low) * count).astype(int)
    assert (np.sort(strata, axis=0) == np.arange(count)[:, None]).all()
    np.testing.assert_array_equal(values, [soil.as_vector(list(SOIL)) for soil in soils(robot, count)])


def test_timing_leaves_the_warm_up_out():
    calls = []
    result = results.repeat(lambda: (calls.append(0), time.sleep(0.05 if len(calls) == 1 else 0.0)), 5)
    assert len(calls) == 6
    assert len(result.wall) == len(result.cpu) == 5
    assert result.best <= result.median
    rates = result.per_second(100)
    assert rates["runs"] == 5 and rates["median"] == pytest.approx(100 / result.median)


def test_the_file_is_whole_or_not_there(tmp_path):
    path = tmp_path / "b.json"
    result = Result("a", 2.0, "s", "n", {"runs": 3}, Peer("other", 4.0, "s"))
    write_json(path, {"cpu": "x"}, [result], [])
    (written,) = json.loads(path.read_text(encoding="utf-8"))["results"]
    peer = {"name": "other", "value": 4.0, "unit": "s", "by_cpu_time": None}
    assert written == {"name": "a", "value": 2.0, "unit": "s", "peer": peer, "note": "n", "runs": 3}
    before = path.read_bytes()
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_json(path, {}, [Result("a", float("nan"), "s")], [])
    assert path.read_bytes() == before
    assert [entry.name for entry in tmp_path.iterdir()] == ["b.json"]


def test_without_ros_the_nodes_are_skipped_with_the_mend(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert "pip install 'artibot_sim[ros]'" in nodes.missing()
    assert nodes.replay_missing() == nodes.missing()


@pytest.mark.parametrize(
    ("value", "shown"), [(1.512e6, "1.51 M"), (93456.0, "93.5 k"), (0.5, "0.5"), (3.7e-10, "3.7e-10"), (0.0, "0")]
)
def test_numbers_are_readable(value, shown):
    assert number(value) == shown
