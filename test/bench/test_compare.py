"""``artibot bench --compare``: what is better, what is worse, what is refused. No speed is judged here."""

from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from artibot_sim import cli
from artibot_sim.bench import suite
from artibot_sim.bench.comparison import MORE_IS_BETTER, TOLERANCE, Earlier, changes, is_worse, read_earlier
from artibot_sim.bench.results import Result, machine, write_json
from artibot_sim.errors import ArtibotError

SIZES = st.floats(1e-6, 1e9)


def earlier(tmp_path, results, **host):
    path = tmp_path / "old.json"
    write_json(path, {**machine(), **host}, results, [])
    return path


@given(SIZES, SIZES, st.sampled_from(["steps/s", "s", "ms", "m", "messages/s"]))
def test_a_gain_is_how_many_times_better_and_turns_round_with_time(tmp_path_factory, old, new, unit):
    folder = tmp_path_factory.mktemp("compare")
    (there,) = changes(read_earlier(earlier(folder, [Result("a", old, unit)])), [Result("a", new, unit)])
    (back,) = changes(read_earlier(earlier(folder, [Result("a", new, unit)])), [Result("a", old, unit)])
    assert there.gain * back.gain == pytest.approx(1.0)
    if old != new:
        assert (there.gain > 1) == ((new > old) == (unit in MORE_IS_BETTER))


def test_only_a_clear_loss_on_the_same_machine_is_worse(tmp_path):
    old = read_earlier(earlier(tmp_path, [Result("fast", 100.0, "steps/s"), Result("long", 10.0, "s")]))
    for fast, long, worse in (
        (100 * (1 - TOLERANCE) + 1, 10.0, False), (100 * (1 - TOLERANCE) - 1, 10.0, True),
        (100.0, 10 / (1 - TOLERANCE) + 0.1, True), (300.0, 3.0, False),
    ):  # fmt: skip
        found = changes(old, [Result("fast", fast, "steps/s"), Result("long", long, "s")])
        assert is_worse(old, found, machine()) is worse
        assert not is_worse(Earlier(old.path, {**old.machine, "cores": 1000}, old.results), found, machine())


def test_the_command_prints_ratios_and_its_status_says_whether_something_got_worse(tmp_path, monkeypatch, capsys):
    given = suite.Benchmark(("speed",), lambda _: [Result("speed", 50.0, "steps/s")], 1)
    monkeypatch.setattr(suite, "SUITE", {"speed": given})
    path = earlier(tmp_path, [Result("speed", 25.0, "steps/s"), Result("gone", 1.0, "s")])
    assert cli.main(["bench", "--compare", str(path)]) == 0
    shown = capsys.readouterr().out
    assert "2.00 x" in shown and "better" in shown and "not measured now: gone" in shown
    path = earlier(tmp_path, [Result("speed", 100.0, "steps/s")])
    assert cli.main(["bench", "--compare", str(path)]) == 1
    assert "0.50 x" in capsys.readouterr().out
    path = earlier(tmp_path, [Result("speed", 100.0, "steps/s")], cpu="another")
    assert cli.main(["bench", "--compare", str(path)]) == 0
    assert "is from another machine (another" in capsys.readouterr().out
    path = earlier(tmp_path, [Result("speed", 100.0, "steps/s")], quick=True)
    assert cli.main(["bench", "--compare", str(path)]) == 0
    assert "was measured with --quick" in " ".join(capsys.readouterr().out.split())
    assert cli.main(["bench", "--quick", "--compare", str(path)]) == 1


@pytest.mark.parametrize("content", ["", "[]", "{}", json.dumps({"machine": {}, "results": [{"name": "a"}]})])
def test_what_is_no_such_file_is_refused_before_measuring(tmp_path, capsys, content):
    path = tmp_path / "old.json"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(ArtibotError, match="not a file of 'artibot bench --json'"):
        read_earlier(path)
    assert cli.main(["bench", "--compare", str(path)]) == 2
    assert cli.main(["bench", "--compare", str(tmp_path / "none.json")]) == 2
    assert "cannot be read" in capsys.readouterr().err


def test_operations_are_counted_by_running_the_loop():
    from artibot_sim.bench.peak import flops_per_second, operations_of_a_step

    found = operations_of_a_step()
    assert 2_000 < found < 10_000  # four right-hand sides of eight wheels, two modules and a joint
    assert flops_per_second(1, runs=1, rounds=200) > 1e8
