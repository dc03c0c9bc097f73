"""``artibot bench`` as a user runs it: names, the contract's file, what is refused. No number is judged here."""

from __future__ import annotations

import json
import math

import pytest

from artibot_sim import cli
from artibot_sim.bench import suite
from artibot_sim.bench.peers import BESIDE
from artibot_sim.bench.results import Result
from artibot_sim.errors import ArtibotError

UNITS = {"steps/s", "s", "x", "m", "rad/s", "messages/s", "cores", "ms", "flop/s", "%", "runs/s"}


def run(*args: str) -> int:
    return cli.main(["bench", *args])


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    """The file of a quick run, and its status."""
    path = tmp_path_factory.mktemp("bench") / "bench.json"
    status = run("--quick", "--json", str(path))
    return status, json.loads(path.read_text(encoding="utf-8"))


def test_a_quick_run_succeeds(quick):
    status, content = quick
    assert status == 0
    assert not [skip for skip in content["skipped"] if skip["failed"]]


def test_the_machine_is_described(quick):
    machine = quick[1]["machine"]
    assert {"cpu", "cores", "python", "numba", "artibot", "commit"} <= set(machine)
    assert machine["cores"] >= 1


def test_results_have_the_contracts_fields(quick):
    results = quick[1]["results"]
    for result in results:
        assert {"name", "value", "unit", "peer"} <= set(result)
        assert math.isfinite(result["value"]) and result["value"] >= 0
        assert result["value"] > 0 or result["unit"] not in ("steps/s", "s", "x")
        assert result["unit"] in UNITS
    names = [result["name"] for result in results]
    assert len(set(names)) == len(names)


def test_every_quick_benchmark_gives_the_names_it_announces(quick):
    given = {result["name"] for result in quick[1]["results"]}
    skipped = {skip["name"] for skip in quick[1]["skipped"]}
    for key in suite.chosen((), quick=True):
        expected = set() if key in skipped else set(suite.SUITE[key].names)
        assert given & set(suite.SUITE[key].names) == expected, key


def test_the_contracts_names_are_there():
    assert {
        "rollout_rk4_1ms", "rollout_semi_implicit", "batch_rk4_all_cores", "start_cold", "start_warm",
    } <= set(suite.all_names())  # fmt: skip


def test_peers_stand_beside_where_they_were_measured(quick):
    results = {result["name"]: result for result in quick[1]["results"]}
    for name, result in results.items():
        peer = results.get(BESIDE.get(name, ""))
        assert (result["peer"] is None) == (peer is None)
        if peer:
            assert (result["peer"]["value"], result["peer"]["unit"]) == (peer["value"], peer["unit"])


@pytest.mark.parametrize(
    ("only", "keys"),
    [
        (("ripple",), ["ripple"]),
        (("start_warm", "rollout_rk4_1ms"), ["rollout", "start"]),
        (("sim", "sim_node_late_p99"), ["sim"]),
    ],
)
def test_only_takes_names_of_benchmarks_and_results(only, keys):
    assert suite.chosen(only, quick=False) == keys
    assert suite.chosen(only, quick=True) == keys


def test_only_measures_only_that(tmp_path, capsys):
    path = tmp_path / "one.json"
    assert run("--quick", "--only", "ripple", "--json", str(path)) == 0
    content = json.loads(path.read_text(encoding="utf-8"))
    assert {result["name"] for result in content["results"]} == set(suite.SUITE["ripple"].names)
    assert content["skipped"] == []
    shown = capsys.readouterr().out
    assert all(name in shown for name in suite.SUITE["ripple"].names)


def test_an_unknown_name_is_refused_with_those_there_are(capsys):
    assert run("--only", "warp") == 2
    message = capsys.readouterr().err
    assert message.startswith("artibot: bench: nothing is called 'warp'; expected one of rollout, rollout_rk4_1ms")


def test_a_folder_that_is_not_there_is_refused_before_measuring(tmp_path, capsys):
    assert run("--only", "rollout", "--json", str(tmp_path / "none" / "b.json")) == 2
    assert "is no folder" in capsys.readouterr().err


def test_a_failure_is_reported_and_the_rest_is_kept(monkeypatch, tmp_path, capsys):
    def fail(_scenario):
        raise ArtibotError("the bus is on fire")

    good = suite.Benchmark(("good",), lambda _: [Result("good", 1.0, "s")], 1)
    absent = suite.Benchmark(("absent",), fail, 1, lambda: "no bus here")
    monkeypatch.setattr(suite, "SUITE", {"bad": suite.Benchmark(("bad",), fail, 1), "good": good, "absent": absent})
    path = tmp_path / "b.json"
    assert run("--json", str(path)) == 1
    content = json.loads(path.read_text(encoding="utf-8"))
    assert [result["name"] for result in content["results"]] == ["good"]
    assert content["skipped"] == [
        {"name": "bad", "reason": "the bus is on fire", "failed": True},
        {"name": "absent", "reason": "no bus here", "failed": False},
    ]
    shown = capsys.readouterr().out
    assert "bad failed: the bus is on fire" in shown
    assert "absent was skipped: no bus here" in shown


def test_the_list_names_everything(capsys):
    assert run("--list") == 0
    shown = capsys.readouterr().out
    assert all(name in shown for name in suite.all_names())
