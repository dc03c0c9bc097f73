"""A campaign goes on after it was killed, without losing or repeating a case."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from diagnose.hidden.calibrate import promises, thresholds
from diagnose.hidden.jobs import RIGID, Job, jobs
from diagnose.hidden.journal import Journal, read_results
from diagnose.hidden.logged import RECIPES, VARYING
from diagnose.hidden.null import NullCase, added, read, surplus, write

from artibot_sim.diagnose.policy import THRESHOLDS
from artibot_sim.diagnose.records import DECADE
from artibot_sim.errors import ArtibotError

ROOT = Path(__file__).resolve().parents[2]
COUNTS = {"none": 3, "single": 4, "unlisted": 2}


def start(folder: Path, *words: str) -> subprocess.Popen:
    """A campaign whose diagnosis always says that nothing is wrong, which costs nothing."""
    paths = [str(ROOT), str(ROOT / "test"), os.environ.get("PYTHONPATH", "")]
    kinds = ",".join(f"{kind}:{count}" for kind, count in COUNTS.items())
    command = [
        sys.executable,
        "-m",
        "diagnose.hidden",
        "--way",
        "silent",
        "--kinds",
        kinds,
        "--out",
        str(folder),
        "--runs",
        "1",
        "--duration",
        "6",
        *words,
    ]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths))}
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


@pytest.mark.long
def test_killed_again_and_again_it_comes_to_the_same_end(tmp_path):
    journal, deadline = tmp_path / "cases.jsonl", time.monotonic() + 240.0
    for _ in range(3):
        before = journal.read_bytes().count(b"\n") if journal.exists() else 0
        process = start(tmp_path, "--workers", "2")
        while process.poll() is None and time.monotonic() < deadline:
            if journal.exists() and journal.read_bytes().count(b"\n") > before:
                break
            time.sleep(0.02)
        process.send_signal(signal.SIGKILL)
        process.communicate()
    said, _ = (last := start(tmp_path, "--workers", "1")).communicate(timeout=240)
    assert last.returncode == 0, said
    expected = [job.key for job in jobs(1, COUNTS, (1.0,), 1.0, runs=1, duration=6.0)]
    keys = [result["key"] for result in read_results(journal)]
    assert sorted(keys) == sorted(expected)
    assert "nothing" in said and (tmp_path / "confusion.png").stat().st_size > 1000


def test_jobs_are_the_seed_s_alone_and_a_larger_campaign_begins_with_a_smaller_one():
    few, many = (jobs(3, {"none": n, "single": n, "pair": n}, (1.0, 0.3), 1.0) for n in (5, 60))
    assert few == jobs(3, {"none": 5, "single": 5, "pair": 5}, (1.0, 0.3), 1.0)
    assert {job.key for job in few} < {job.key for job in many}
    assert len({job.key for job in many}) == len(many) == 60 + 120 + 120
    assert {job.key for job in jobs(4, {"single": 5}, (1.0,), 1.0)}.isdisjoint(job.key for job in many)
    assert Job.from_dict(json.loads(json.dumps(few[0]._asdict()))) == few[0]


def test_effects_take_turns():
    singles = [job.effects[0] for job in jobs(1, {"single": 54}, (1.0,), 1.0)]
    assert len(set(singles[:27])) == 27 and sorted(singles) == sorted(2 * sorted(set(singles)))


def test_a_line_that_was_cut_off_is_done_again(tmp_path):
    path = tmp_path / "cases.jsonl"
    with Journal(path) as journal:
        journal.add({"key": "a"})
        journal.add({"key": "b"})
    path.write_bytes(path.read_bytes()[:-4])
    with Journal(path) as journal:
        assert journal.done == {"a"}
        journal.add({"key": "c"})
    assert [result["key"] for result in read_results(path)] == ["a", "c"]


def test_a_case_is_another_one_where_more_false_alarms_are_asked_for():
    usual, more = (jobs(3, {"none": 1}, (1.0,), 1.0, false_alarms=rate)[0] for rate in (0.01, 0.2))
    assert usual == jobs(3, {"none": 1}, (1.0,), 1.0)[0]
    assert usual.key != more.key and usual.seed == more.seed


def test_false_alarms_are_counted_by_what_is_asked_of_effects():
    """What is too near to neutral or too small is no false alarm however much it gains, nor what scatters as much."""

    def case_with(nats: float, **seen: float) -> dict[str, object]:
        ranking = [{"effect": "slope", "log10_bayes_factor": nats / DECADE, "fitted": True}]
        search = {"slope": {"nats": nats, "scatter": 0.0, "deviations": 9.0, "size": 0.5, **seen}}
        answer = {"ranking": ranking, "first_search": search, "causes": [], "verdict": "none"}
        job = jobs(1, {"none": 1}, (1.0,), 1.0, false_alarms=0.2)[0]._asdict()
        return {"key": "", "job": job, "truth": {"effects": {}, "unlisted": {}}, "answer": answer}

    enough = THRESHOLDS.least(1.0, 0.2) + 1.0
    cases = [case_with(enough), case_with(enough, size=0.01), case_with(enough, deviations=1.0)]
    cases.append(case_with(enough, scatter=10.0))
    assert [bool(surplus(each)) for each in cases] == [True, False, False, True]
    assert surplus(cases[3])["slope"] == pytest.approx(enough - 20.0)
    said = "\n".join(promises([NullCase.of(case) for case in cases]))
    assert "0.2 asked" in said and "first search 1 of 4" in said and "named 0 of 4" in said


def null_case(seed: int = 1, nats: float = 0.0, commit: str = "a") -> NullCase:
    """Of Epi.q."""
    return NullCase(
        commit, "epiq", True, seed, 2, 30.0, 1.0, 0.2, "none", "", "slope" if nats else "", nats, "", 0.0, "yaw", 0.5
    )


def test_the_table_of_null_cases_grows_and_takes_newer_answers(tmp_path):
    path = tmp_path / "cases.csv"
    write(added(read(path), [null_case(2), null_case(1, 3.5)]), path)
    assert read(path) == [null_case(1, 3.5), null_case(2)]
    write(added(read(path), [null_case(1, 1.5, commit="b"), null_case(3)]), path)
    assert read(path) == [null_case(1, 1.5, commit="b"), null_case(2), null_case(3)]
    path.write_text(path.read_text().replace("1.5", "many"))
    with pytest.raises(ArtibotError, match=r"cases\.csv: no case of a campaign"):
        read(path)


def test_the_table_in_the_repository_is_in_order():
    cases = read()
    assert cases and added(cases, []) == cases


def test_a_rate_is_sure_only_with_cases_enough():
    """Of 299 without any false alarm 1 % is sure, of 298 not: 0.99 to the power of them is 0.05."""
    for count, sure in ((298, "too few cases"), (299, "surely no more above 9.0")):
        said = list(thresholds([null_case(seed, 9.0 if seed == 7 else 0.0) for seed in range(count)]))
        assert "quantile 0.0" in said[0] and "surely no more above 0.0" in said[0]
        assert sure in said[-1] and said[-1].startswith("0.01")


def test_two_campaigns_do_not_share_a_journal(tmp_path):
    with Journal(tmp_path / "cases.jsonl"), pytest.raises(ArtibotError, match="another campaign"):
        Journal(tmp_path / "cases.jsonl")


def test_a_line_that_is_no_result_is_named(tmp_path):
    path = tmp_path / "cases.jsonl"
    path.write_text('{"key": "a"}\nnonsense\n')
    with pytest.raises(ArtibotError, match=r"cases.jsonl:2"):
        Journal(path)


def test_rigid_robots_have_kinds_of_their_own():
    counts = dict.fromkeys(RIGID, len(RECIPES))
    found = jobs(1, counts, (1.0,), 1.0, robot="husky_driven")
    assert {job.effects for job in found if job.kind == "varying"} == {(VARYING,)}
    assert {job.effects[1:] for job in found if job.kind == "beside"} == {(VARYING,)}
    assert {job.effects for job in found if job.kind == "single"} == {(name,) for name in RECIPES}
    with_torques = [job for job in jobs(1, {"none": 2}, (1.0,), 1.0, robot="husky", torques=True) if job.torques]
    assert len({job.key for job in with_torques + jobs(1, {"none": 2}, (1.0,), 1.0, robot="husky")}) == 4
    for robot, kind in (("agriq", "none"), ("husky", "single")):
        with pytest.raises(ArtibotError):
            jobs(1, {kind: 1}, (1.0,), 1.0, robot=robot, torques=True)
    for kind, robot in (("pair", "husky_driven"), ("varying", "agriq"), ("single", "train3")):
        with pytest.raises(ArtibotError, match=f"no '{kind}' of {robot}"):
            jobs(1, {kind: 1}, (1.0,), 1.0, robot=robot)
