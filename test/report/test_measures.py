"""The figures of merit are those of experiment.metrics, over the planned motion."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from bag_helpers import foreign
from report_helpers import EPOCH, Columns, circle, recording

from artibot_sim.experiment import Experiment, metrics, read_bag, write_channels
from artibot_sim.experiment.messages import path_message
from artibot_sim.report.measures import measure
from artibot_sim.report.paths import find_track

RATE = 0.4
T = np.arange(0.0, 10.0, 0.02)


def test_they_are_the_metrics_of_the_bags_columns(run: Experiment) -> None:
    found = measure(run)
    planned = run.channels["planned_odom"]
    for kind, key in (("true", "ground_truth_odom"), ("odometric", "odom")):
        driven = run.channels[key]
        rows = driven.t <= planned.t[-1]
        t = driven.t[rows]
        assert found.e_gamma[kind] == metrics.yaw_error(driven["yaw"][rows], np.interp(t, planned.t, planned["yaw"]), t)
        end = [np.interp(planned.t[-1], driven.t, driven[name]) for name in "xy"]
        sigma = metrics.path_length(planned["x"], planned["y"])
        assert found.e_x[kind] == metrics.position_error(end, [planned["x"][-1], planned["y"][-1]], sigma)
    assert found.path_length["planned"] == sigma
    assert not found.remarks


def test_radii_are_circle_fits_over_the_planned_arcs(run: Experiment) -> None:
    found = measure(run)
    left, right = found.arcs
    assert left.turn == pytest.approx(1.5 * np.pi, abs=0.05)
    assert right.turn == pytest.approx(-1.5 * np.pi, abs=0.05)
    truth = run.channels["ground_truth_odom"]
    for arc in found.arcs:
        part = truth.between(arc.t_start, arc.t_end)
        assert arc.radius["true"] == metrics.radius(part["x"], part["y"])
        assert arc.radius["planned"] == pytest.approx(2.0, abs=1e-6)
    assert found.radius["true"] == np.mean([arc.radius["true"] for arc in found.arcs])
    assert found.radius["true"] > 2.05  # the rover understeers


def wide_circle(folder: Path, before: float = 0.0, after: float = 0.0, until: float = 10.0) -> Experiment:
    """Planned a circle of 2 m, believed one of 2.5 m, driven one of 3 m, all at 0.8 m/s."""
    t = np.arange(0.0, before + 10.0 + after, 0.02)
    moved = np.clip(t - before, 0.0, 10.0 - 0.02)

    def drive(radius: float) -> Columns:
        return circle(moved, radius, 0.8 / radius)

    kept = t < before + until
    driven = {"odom": (t[kept], {k: v[kept] for k, v in drive(2.5).items()}),
              "ground_truth_odom": (t[kept], {k: v[kept] for k, v in drive(3.0).items()})}  # fmt: skip
    return recording(folder, {"planned_odom": (t, drive(2.0)), **driven})


def test_circles_give_what_they_must(tmp_path: Path) -> None:
    found = measure(wide_circle(tmp_path / "run"))
    assert found.radius == pytest.approx({"planned": 2.0, "odometric": 2.5, "true": 3.0})
    assert found.e_gamma == pytest.approx({"odometric": 2.0 / 2.5 - 1, "true": 2.0 / 3.0 - 1})
    length = 0.8 * (T[-1])
    assert found.path_length == pytest.approx(dict.fromkeys(("planned", "odometric", "true"), length), rel=1e-4)
    end = {radius: (radius * np.sin(length / radius), radius * (1 - np.cos(length / radius))) for radius in (2.0, 3.0)}
    assert found.e_x["true"] == pytest.approx(np.hypot(*np.subtract(end[2.0], end[3.0])) / length, rel=1e-4)


def test_standing_before_and_after_changes_nothing(tmp_path: Path) -> None:
    plain, waiting = measure(wide_circle(tmp_path / "a")), measure(wide_circle(tmp_path / "b", before=3.0, after=5.0))
    for name in ("e_gamma", "e_x", "path_length", "radius"):
        assert getattr(waiting, name) == pytest.approx(getattr(plain, name), rel=1e-2)
    assert waiting.window == pytest.approx((3.0, 13.0), abs=0.05)


def test_a_recording_that_ends_early_says_so(tmp_path: Path) -> None:
    found = measure(wide_circle(tmp_path / "run", until=6.0))
    assert found.window == pytest.approx((0.0, 6.0), abs=0.05)
    assert found.e_gamma["true"] == pytest.approx(2.0 / 3.0 - 1)
    assert any("ends 4.0 s before the plan" in remark for remark in found.remarks)


def test_a_plan_whose_poses_were_cut_is_read_from_its_path(tmp_path: Path) -> None:
    planned, driven = circle(T, 2.0, RATE), circle(T, 3.0, 0.8 / 3.0)
    there = (T < 3.0) | (T > 7.0)
    cut = {name: values[there] for name, values in planned.items()}
    stamps = EPOCH + np.rint(T * 1e9).astype(np.int64)
    poses = np.column_stack([planned[name] for name in ("x", "y", "yaw")])
    tables = {
        "planned_odom": (stamps[there], cut),
        "ground_truth_odom": (stamps, driven),
    }
    path = {"planned_path": [(EPOCH, path_message(EPOCH, stamps.tolist(), poses))]}
    found = {}
    for name, latched in (("pose", {}), ("path", path)):
        run = read_bag(write_channels(tmp_path / name, tables, latched=latched))
        found[name] = measure(run)
        track = find_track(run, "planned")
        assert track is not None and len(track.t) == (len(T) if latched else there.sum())
    whole = measure(recording(tmp_path / "whole", {"planned_odom": (T, planned), "ground_truth_odom": (T, driven)}))
    assert found["path"].e_gamma == pytest.approx(whole.e_gamma) and found["path"].radius == pytest.approx(whole.radius)
    assert found["path"].path_length == pytest.approx(whole.path_length)
    assert found["pose"].path_length["planned"] < 0.99 * whole.path_length["planned"]


def test_points_stand_in_for_a_true_pose(tmp_path: Path) -> None:
    planned, driven = circle(T, 2.0, RATE), circle(T, 3.0, 0.8 / 3.0)
    points = {name: driven[name] for name in ("x", "y")} | {"z": 0 * T}
    found = measure(recording(tmp_path / "run", {"planned_odom": (T, planned), "total_station": (T, points)}))
    assert found.radius["true"] == pytest.approx(3.0)
    assert "true" not in found.e_gamma
    assert any("no yaw" in remark for remark in found.remarks)
    assert any(remark == "odometric: not recorded" for remark in found.remarks)


def test_without_a_plan_there_is_nothing_to_compare(tmp_path: Path) -> None:
    found = measure(recording(tmp_path / "run", {"odom": (T, circle(T, 2.0, RATE))}))
    assert not found.e_gamma and not found.e_x and not found.radius
    assert "/planned/odom" in found.remarks[0]
    assert all(value is None for value in (found.as_dict()["e_x"]["true"], found.as_dict()["radius"]["planned"]))


def test_a_plan_that_turns_nowhere_has_no_yaw_error(tmp_path: Path) -> None:
    straight = {"x": 0.5 * T, "y": 0 * T, "yaw": 0 * T}
    found = measure(recording(tmp_path / "run", {"planned_odom": (T, straight), "odom": (T, straight)}))
    assert not found.e_gamma and not found.arcs
    assert found.e_x["odometric"] == 0.0
    assert any("integrates to zero" in remark for remark in found.remarks)


def test_poses_of_several_segments_are_not_compared() -> None:
    found = measure(read_bag(foreign("husky_a")))
    assert not found.e_x
    assert "204 segments" in found.remarks[0]
