"""A sweep's table is that of single rollouts, however the work was cut, spread, interrupted or killed."""

from __future__ import annotations

import json
import os
import re
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import yaml
from sweep.conftest import GRID

from artibot_sim import cli
from artibot_sim.errors import ArtibotError
from artibot_sim.experiment.metrics import fit_circle, yaw_error
from artibot_sim.model import rollout
from artibot_sim.model.simulate.commands import as_executed
from artibot_sim.planning import manoeuvre_from_dict, plan
from artibot_sim.sweep import plan_from_dict, sweep
from artibot_sim.sweep.axes import manoeuvre_document, robot_with
from artibot_sim.sweep.folder import TABLE, groups
from artibot_sim.sweep.summary import summarise
from ros_helpers import ROOT


def table(folder: Path):
    pieces = list(groups(folder / TABLE))
    return {name: np.concatenate([piece[name] for piece in pieces]) for name in pieces[0]}


def command(out: Path, plan_file: Path, *more: str) -> list[str]:
    return [sys.executable, "-m", "artibot_sim.cli", "sweep", str(plan_file), "--out", str(out), *more]


@pytest.fixture
def plan_file(tmp_path) -> Path:
    path = tmp_path / "plan.yaml"
    path.write_text(yaml.safe_dump(GRID, sort_keys=False), encoding="utf-8")
    return path


def test_rows_are_those_of_single_rollouts(grid, swept):
    found = table(swept)
    assert found["run"].tolist() == list(range(48)) and set(found["status"]) == {"ok"}
    for run in (0, 17, 47):
        values = {key: found[key][run] for key in grid.columns(0, 1)}
        robot = robot_with(grid.base.robot, values)
        name, document = manoeuvre_document(grid.base, values)
        planned = plan(manoeuvre_from_dict(document, name), robot)
        single = rollout(robot, as_executed(robot, planned.commands()), every=50, energy=True)
        mark = next(mark for mark in planned.marks if mark.label.endswith("arc"))
        rows = (single.t >= mark.start) & (single.t <= mark.end)
        expected = {
            "x_end": single.pose[-1, 0], "yaw_end": single.pose[-1, 2],
            "e_gamma": yaw_error(single.pose[:, 2], planned.at(single.t).pose[:, 2], single.t),
            "radius_1": fit_circle(*single.pose[rows, :2].T).radius,
            "energy_front": single["E_motor_front_right"][-1] + single["E_motor_front_left"][-1],
        }  # fmt: skip
        for name, value in expected.items():
            assert found[name][run] == pytest.approx(value, rel=1e-7), name
    assert len(set(found["x_end"])) == 48  # every parameter matters


@pytest.mark.parametrize(("workers", "chunk"), [(1, 48), (1, 5), (2, 7)])
def test_results_do_not_depend_on_workers_or_chunks(grid, swept, tmp_path, monkeypatch, workers, chunk):
    monkeypatch.setattr("artibot_sim.sweep.run.FEW", 0)  # processes, however few runs there are
    done = sweep(grid, tmp_path / "again", workers=workers, chunk=chunk)
    assert done.runs.read_bytes() == (swept / TABLE).read_bytes()


def test_one_that_is_killed_goes_on_without_repeating_or_losing_a_run(swept, plan_file, tmp_path):
    out = tmp_path / "killed"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), *filter(None, sys.path)])}
    code = (
        "import artibot_sim.sweep.run as run, artibot_sim.sweep.folder as folder, sys\n"
        "run.FEW, folder._CHUNK = 0, (3, 3)\n"
        "from artibot_sim.cli import main\n"
        "sys.exit(main(sys.argv[1:]))"
    )
    arguments = ["sweep", str(plan_file), "--out", str(out), "--workers", "1"]
    with subprocess.Popen([sys.executable, "-c", code, *arguments], env=environment) as process:
        deadline = time.monotonic() + 60
        while len(list(out.glob("parts/[0-9]*"))) < 3 and process.poll() is None and time.monotonic() < deadline:
            time.sleep(0.002)
        process.send_signal(signal.SIGKILL)
    kept = {path.name: path.stat().st_mtime_ns for path in out.glob("parts/[0-9]*")}
    assert 3 <= len(kept) < 16 and not (out / TABLE).exists()
    told = []
    done = sweep(
        plan_from_dict(GRID), out, workers=1, chunk=3, progress=lambda finished, before: told.append((finished, before))
    )
    assert told[0] == (3 * len(kept), 3 * len(kept)) and told[-1][0] == 48
    assert done.before == 3 * len(kept)
    assert len(told) - 1 == 16 - len(kept)  # chunks that were there are not made again
    assert done.runs.read_bytes() == (swept / TABLE).read_bytes()
    assert sorted(entry.name for entry in out.iterdir()) == [TABLE, "sweep.json"]


def test_a_finished_one_is_not_done_again(grid, swept):
    before = (swept / TABLE).stat().st_mtime_ns
    assert sweep(grid, swept).before == 48
    assert (swept / TABLE).stat().st_mtime_ns == before


def test_another_plan_and_strangers_are_refused(swept, tmp_path):
    other = plan_from_dict(GRID | {"axes": {**GRID["axes"], "kappa": [0.8, 1.0]}})
    with pytest.raises(ArtibotError, match=r"holds a sweep that differs in axes; give another --out"):
        sweep(other, swept)
    with pytest.raises(ArtibotError, match=r"differs in dt"):
        sweep(plan_from_dict(GRID | {"dt": 5e-4}), swept)
    (tmp_path / "notes.txt").write_text("mine", encoding="utf-8")
    with pytest.raises(ArtibotError, match=r"holds other files and no sweep"):
        sweep(other, tmp_path)
    with pytest.raises(ArtibotError, match=r"is a file"):
        sweep(other, tmp_path / "notes.txt")


def test_another_artibot_does_not_go_on(grid, tmp_path):
    out = tmp_path / "old"
    from artibot_sim.sweep.folder import Folder

    with Folder(out, grid):
        pass
    manifest = json.loads((out / "sweep.json").read_text(encoding="utf-8"))
    (out / "sweep.json").write_text(json.dumps(manifest | {"artibot": "0.0.9 (abc)"}), encoding="utf-8")
    with pytest.raises(ArtibotError, match=r"was begun by artibot 0\.0\.9 \(abc\), this is"):
        sweep(grid, out)


def test_two_at_once_in_a_folder_are_refused(grid, tmp_path):
    from artibot_sim.sweep.folder import Folder

    with Folder(tmp_path / "one", grid), pytest.raises(ArtibotError, match="another sweep is at work there"):
        sweep(grid, tmp_path / "one")


def test_a_disk_that_is_full_is_said_and_what_is_done_is_kept(swept, tmp_path):
    """The system refuses files beyond a size, as it would on a full disk."""
    out = tmp_path / "full"
    script = f"""
import resource
from artibot_sim.sweep import plan_from_dict, sweep
from artibot_sim.errors import ArtibotError
plan = plan_from_dict({GRID!r})
parts = 0
def tell(done, before):
    global parts
    parts += 1
    if parts == 3:
        resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))
try:
    sweep(plan, {str(out)!r}, workers=1, chunk=4, progress=tell)
except ArtibotError as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=ROOT)
    assert "cannot be written: File too large; finished runs are kept: make room and repeat" in done.stdout
    assert len(list(out.glob("parts/*"))) == 2  # two whole ones, nothing half-written
    sweep(plan_from_dict(GRID), out)
    assert (out / TABLE).read_bytes() == (swept / TABLE).read_bytes()
    assert resource.getrlimit(resource.RLIMIT_FSIZE)[1] != 2000


def test_runs_that_cannot_be_have_a_status_and_leave_the_others_alone(tmp_path):
    document = GRID | {"axes": {"contact.mu_s": [0.2, 0.6], "contact.k_l": [2000, 3e5], "front.i_y": [0.5, 0.7]}}
    found = table(sweep(plan_from_dict(document), tmp_path / "odd").folder)
    refused = found["status"] == "refused"
    assert refused.tolist() == [True] * 4 + [False, False, True, True]
    assert "mu_d" in found["message"][0] and "unstable" in found["message"][6]
    assert np.isnan(found["x_end"][refused]).all() and np.isfinite(found["x_end"][~refused]).all()
    alone = table(
        sweep(
            plan_from_dict(
                document | {"axes": {"contact.mu_s": [0.6], "contact.k_l": [2000], "front.i_y": [0.5, 0.7]}}
            ),
            tmp_path / "fine",
        ).folder
    )
    np.testing.assert_array_equal(found["x_end"][4:6], alone["x_end"])


def test_the_summary_is_that_of_the_table(swept, grid):
    found, summary = table(swept), summarise(swept)
    assert summary.status == {"ok": 48}
    for name, (least, median, most) in summary.spread.items():
        values = found[name]
        assert (least, most) == (values.min(), values.max()) and median == pytest.approx(np.median(values))
    heat = next(one for one in summary.maps if (one.x.key, one.y.key) == ("contact.mu_s", "kappa"))
    for i, kappa in enumerate(heat.y.labels):
        for k, mu_s in enumerate(heat.x.labels):
            rows = (found["kappa"] == kappa) & (found["contact.mu_s"] == mu_s)
            assert rows.sum() == 6
            assert heat.mean["e_x"][i, k] == pytest.approx(found["e_x"][rows].mean())
    assert summary.strongest("radius_1")[0] == "manoeuvre.segments[1].arc.radius_m"


def test_the_command_writes_table_and_page_and_says_what_it_found(plan_file, tmp_path, capsys):
    out = tmp_path / "out"
    assert cli.main(["sweep", str(plan_file), "--out", str(out), "--set", "contact.k_l=2500"]) == 0
    shown = capsys.readouterr().out
    assert "48 runs: 48 ok" in shown and "e_gamma" in shown and str(out / TABLE) in shown
    page = (out / "sweep.html").read_text(encoding="utf-8")
    assert page.startswith("<!DOCTYPE html>") and not re.search('(src|href)="(?!#)', page.split("<script>")[0])
    assert cli.main(["sweep", str(plan_file), "--out", str(out)]) == 2
    assert "differs in set" in capsys.readouterr().err


def test_bad_flags_are_refused(tmp_path, capsys):
    for flags, message in (
        (["--axis", "kappa"], "expected KEY=FROM:TO:COUNT"),
        (["--axis", "kappa=0.5", "--axis", "kappa=0.6"], "given twice"),
        (["--axis", "kapa=0.5"], "did you mean 'kappa'"),
        (["--axis", "kappa=0.5", "--scheduler", "localhost"], "expected an address such as tcp://127.0.0.1:8786"),
        (["nosuchplan"], "unknown"),
    ):
        assert cli.main(["sweep", *flags, "--out", str(tmp_path / "x")]) == 2
        assert message in capsys.readouterr().err
    assert not (tmp_path / "x").exists()


def test_the_shipped_plan_is_sound():
    from artibot_sim.sweep import load_plan

    assert load_plan("soil").count == 1000


def test_a_lock_that_was_removed_meanwhile_is_made_anew(tmp_path, monkeypatch):
    """Who waited with the file of one that has ended in hand must not go on with it: a third could make another."""
    import fcntl

    from artibot_sim.sweep import folder

    path, locked, real = tmp_path / ".lock", [], fcntl.flock

    def ended_first(descriptor, how):
        if not locked:
            path.unlink()  # the one before ends between our opening and locking
        locked.append(descriptor)
        real(descriptor, how)

    monkeypatch.setattr(folder.fcntl, "flock", ended_first)
    own = folder._locked(path)
    assert len(locked) == 2
    with pytest.raises(BlockingIOError):
        folder._locked(path)
    os.close(own)
