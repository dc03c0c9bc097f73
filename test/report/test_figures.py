"""What is in a recording is drawn, with its values, and nothing else."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bag_helpers import foreign
from report_helpers import circle, recording

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment import Experiment, read_bag, write_experiment
from artibot_sim.experiment.columns import SEGMENT_GAP
from artibot_sim.model import MOTORS, Commands, Robot, load_ground, load_robot, rollout
from artibot_sim.report.figures import align, experiment_figure, labels
from artibot_sim.report.panels import Line
from artibot_sim.report.style import BAGS

T = np.arange(0.0, 4.0, 0.05)


def finite(values: np.ndarray) -> np.ndarray:
    return values[np.isfinite(values)]


def only(lines: tuple[Line, ...], **wanted: object) -> Line:
    (found,) = [line for line in lines if all(getattr(line, key) == value for key, value in wanted.items())]
    return found


def test_the_paths_are_the_bags(run: Experiment, agriq: Robot) -> None:
    panel = experiment_figure([run], [agriq])["path"]
    assert [line.kind for line in panel.lines] == ["planned", "odometric", "true"]
    for kind, key in (("planned", "planned_path"), ("odometric", "odom"), ("true", "ground_truth_odom")):
        line = only(panel.lines, kind=kind)
        assert np.array_equal(line.x, run.channels[key]["x"])
        assert np.array_equal(line.y, run.channels[key]["y"])
    assert panel.equal
    assert (panel.x_label, panel.y_label) == ("x (m)", "y (m)")
    assert np.allclose(panel.starts, [[0.0, 0.0]])


def test_lines_of_equal_height_are_drawn_under_a_path_over_uneven_ground(tmp_path: Path, agriq: Robot) -> None:
    """Where each line is, the ground has its height; without its file the path is drawn and the reason said."""
    order = Commands(0.01, np.tile([80.0, 60.0, np.nan, np.nan], (201, 1)))
    for name in ("random:4,rms=0.1,size=12.8", "elsewhere/hill.yaml"):
        ground = replace(load_ground("random:4,rms=0.1,size=12.8"), name=name)
        result = rollout(agriq, order, ground=ground)
        bag = write_experiment(tmp_path / f"run{len(name)}", result, None, agriq, commands=order)
        figure = experiment_figure([read_bag(bag)], [agriq])
        contours = [line for line in figure["path"].lines if line.kind.startswith("ground")]
        if name.startswith("random"):
            assert 3 <= len(contours) <= 10 and "ground" not in figure.missing
            for line in contours:
                level = float(line.name.split()[2])
                heights = ground.heights(finite(line.x), finite(line.y))
                np.testing.assert_allclose(heights, level, rtol=0, atol=2e-3)
            assert {entry.kind for entry in figure["path"].legend} >= {contours[0].kind, "true"}
        else:
            assert not contours and "no such ground file" in figure.missing["ground"]


@pytest.mark.parametrize(
    ("panel", "unit", "kind", "side", "key", "column"),
    [
        ("yaw", "rad", "planned", "", "planned_odom", "yaw"),
        ("yaw", "rad", "odometric", "", "odom", "yaw"),
        ("yaw", "rad", "true", "", "ground_truth_odom", "yaw"),
        ("speed", "m/s", "true", "", "ground_truth_odom", "vx"),
        ("speed", "m/s", "planned", "", "planned_odom", "vx"),
        ("velocity_front", "rad/s", "measured", "right", "motor_torques", "front_right.velocity"),
        ("velocity_front", "rad/s", "commanded", "left", "motor_command", "front_left.velocity"),
        ("torque_front", "N·m", "measured", "right", "motor_torques", "front_right.effort"),
        ("torque_front", "N·m", "measured", "left", "motor_torques", "front_left.effort"),
        ("torque_back", "N·m", "measured", "right", "motor_torques", "back_right.effort"),
        ("torque_back", "N·m", "measured", "left", "motor_torques", "back_left.effort"),
        ("torque_back", "N·m", "commanded", "left", "motor_command", "back_left.effort"),
        ("articulation", "rad", "measured", "", "joint_states", "articulation_yaw.position"),
    ],
)
def test_curves_over_time_are_the_bags(
    run: Experiment, agriq: Robot, panel: str, unit: str, kind: str, side: str, key: str, column: str
) -> None:
    drawn = experiment_figure([run], [agriq])[panel]
    line = only(drawn.lines, kind=kind, side=side)
    t, values = run.channels[key].series(column)
    assert np.array_equal(line.x, t)
    assert np.array_equal(line.y, values)
    assert run.channels[key].units[column] == unit == drawn.y[1]
    assert drawn.x_label == "time (s)"


def test_all_is_drawn_once(run: Experiment, agriq: Robot) -> None:
    figure = experiment_figure([run], [agriq])
    count = {panel.key: len(panel.lines) for panel in figure.panels}
    assert count == {"path": 3, "yaw": 3, "speed": 3, "velocity_front": 4, "torque_front": 2, "torque_back": 4,
                     "articulation": 1}  # fmt: skip
    assert not figure.missing
    for panel in figure.panels:
        assert len({line.name for line in panel.lines}) == len(panel.lines)
    assert figure.title == run.name
    assert "agriq" in figure.subtitle and "κ = 0.6" in figure.subtitle


def test_the_limit_is_the_robots(run: Experiment, agriq: Robot) -> None:
    limit = agriq.drive_front.torque_max
    assert [level.value for level in experiment_figure([run], [agriq])["torque_front"].levels] == [limit]
    near = agriq.replace({"drive.front.torque_max": 0.1})
    assert [level.value for level in experiment_figure([run], [near])["torque_front"].levels] == [0.1, -0.1]
    assert not experiment_figure([run], [None])["torque_front"].levels
    far = agriq.replace({"drive.front.torque_max": 50.0})
    assert not experiment_figure([run], [far])["torque_front"].levels  # it would flatten the curves


def test_several_recordings_share_panels_and_differ_in_hue(runs: list[Experiment], agriq: Robot) -> None:
    figure = experiment_figure(runs, [agriq, agriq])
    names = [label for label, _ in figure.key]
    assert names == ["kappa_0.6 (κ 0.6)", "kappa_1 (κ 1.0)"]
    assert [line.bag for line in figure["path"].lines if line.kind == "true"] == names
    assert [line.bag for line in figure["path"].lines if line.kind == "planned"] == [None]  # the same plan: once
    for motor in MOTORS:
        panel = figure[f"torque_{motor}"]
        measured = [line for line in panel.lines if line.kind == "measured"]
        assert [line.stroke.colour for line in measured] == list(BAGS[:2])
        for line, run in zip(measured, runs, strict=True):
            assert np.array_equal(line.y, run.channels["motor_torques"][f"{motor}.effort"])
    assert "velocity_front" not in figure


def test_plans_that_differ_are_both_drawn(tmp_path: Path) -> None:
    tables = [{"planned_odom": (T, circle(T, radius, 0.3))} for radius in (2.0, 2.2)]
    both = [recording(tmp_path / f"run{i}", table) for i, table in enumerate(tables)]
    lines = experiment_figure(both)["path"].lines
    assert [line.bag for line in lines] == ["run0", "run1"]


def in_pieces(folder: Path, count: int, pause: float = 1.0) -> Experiment:
    parts = [T + i * (T[-1] + pause) for i in range(count)]
    pose = {name: np.tile(values, count) for name, values in circle(T, 2.0, 0.3).items()}
    motors = {"front_right.velocity": np.ones(count * len(T)), "front_left.velocity": np.ones(count * len(T))}
    t = np.concatenate(parts)
    return recording(folder, {"ground_truth_odom": (t, pose), "motor_torques": (t, motors)}, {"robot": "husky"})


def pieces_of(values: np.ndarray) -> int:
    """How many stretches without NaN there are."""
    there = np.isfinite(values).astype(int)
    return int((np.diff(np.concatenate([[0], there])) == 1).sum())


@pytest.mark.parametrize("count", [1, 3, 20])
def test_segments_are_not_joined(tmp_path: Path, count: int) -> None:
    run = in_pieces(tmp_path / "run", count)
    assert len(run.segments) == count
    figure = experiment_figure([run], [load_robot("husky")])
    for panel in figure.panels:
        for line in panel.lines:
            assert pieces_of(line.y) == count
            assert len(finite(line.y)) == count * len(T)


def test_a_gap_of_one_topic_is_not_bridged(tmp_path: Path) -> None:
    rest = (T < 1.0) | (T > 2.5)
    motors = {"front_right.velocity": T[rest], "front_left.velocity": T[rest]}
    tables = {"odom": (T, circle(T, 2.0, 0.3)), "motor_torques": (T[rest], motors)}
    run = recording(tmp_path / "run", tables)
    assert len(run.segments) == 1
    (right, left) = experiment_figure([run])["velocity_front"].lines
    assert pieces_of(right.y) == pieces_of(left.y) == 2


def test_a_pose_without_orientation_still_has_a_path(tmp_path: Path) -> None:
    pose = circle(T, 2.0, 0.3)
    run = recording(tmp_path / "run", {"total_station": (T, {"x": pose["x"], "y": pose["y"], "z": 0 * T})})
    figure = experiment_figure([run])
    assert [panel.key for panel in figure.panels] == ["path"]
    (points,) = figure["path"].lines
    assert points.kind == "total station"
    assert points.stroke.dash == "points"
    assert np.allclose(points.x, pose["x"]) and np.allclose(points.y, pose["y"])
    absent = {"planned path", "odometric path", "true pose", "yaw", "speed", "front motor velocity", "rover outline"}
    assert absent <= set(figure.missing)
    assert "/planned/path" in figure.missing["planned path"]
    assert not figure["path"].outlines


def test_nothing_to_draw_is_said(tmp_path: Path) -> None:
    run = recording(tmp_path / "run", {"imu": (T, {"yaw_rate": 0 * T})})
    with pytest.raises(ArtibotError, match=r"run: nothing to draw .*--topic"):
        experiment_figure([run])


def test_too_many_recordings_are_refused(run: Experiment) -> None:
    with pytest.raises(ArtibotError, match=f"expected 1 to {len(BAGS)}"):
        experiment_figure([run] * (len(BAGS) + 1))


def test_yaws_that_differ_by_whole_turns_are_brought_together(tmp_path: Path) -> None:
    planned, true = circle(T, 2.0, 0.3), circle(T, 2.0, 0.3)
    planned["yaw"], true["yaw"] = planned["yaw"] + 3.1, true["yaw"] + 3.2 - 2 * np.pi  # either side of the cut
    run = recording(tmp_path / "run", {"planned_odom": (T, planned), "ground_truth_odom": (T, true)})
    lines = experiment_figure([run])["yaw"].lines
    assert np.allclose(only(lines, kind="true").y - only(lines, kind="planned").y, 0.1)


def test_a_joint_in_messages_of_its_own_is_drawn(tmp_path: Path) -> None:
    half = T + 0.01
    run = recording(tmp_path / "run", {"joint_states": (half, {"articulation_yaw.position": np.sin(T)}),
                                       "odom": (T, circle(T, 2.0, 0.3))})  # fmt: skip
    (line,) = experiment_figure([run])["articulation"].lines
    assert np.allclose(line.y, np.sin(T))
    assert np.allclose(line.x, half)


def test_times_of_several_start_with_the_plan(tmp_path: Path) -> None:
    waits = (0.5, 1.5)
    both = []
    for i, wait in enumerate(waits):
        t = np.arange(0.0, 6.0, 0.05)
        both.append(recording(tmp_path / f"run{i}", {"planned_odom": (t, circle(t - wait, 2.0, 0.3))}))
    offsets, _ = align(both)
    assert np.allclose(offsets, waits, atol=0.051)
    assert np.isclose(offsets[1] - offsets[0], 1.0, atol=1e-6)
    lines = experiment_figure(both)["yaw"].lines
    assert len(lines) == 1  # so they coincide


def test_a_computed_recording_keeps_its_stamps(tmp_path: Path) -> None:
    first = recording(tmp_path / "measured", {"ground_truth_odom": (T, circle(T, 2.0, 0.3))})
    later = recording(tmp_path / "simulated", {"ground_truth_odom": (T[10:], circle(T[10:], 2.1, 0.3))})
    offsets, _ = align([first, later])
    assert np.allclose(offsets, [0.0, -T[10]])
    lines = experiment_figure([first, later])["yaw"].lines
    assert np.allclose([line.x[0] for line in lines], [0.0, T[10]])


def test_labels_tell_recordings_apart(tmp_path: Path) -> None:
    table = {"odom": (T, circle(T, 2.0, 0.3))}
    assert labels([recording(tmp_path / folder / "run", table) for folder in "ab"]) == ["a/run", "b/run"]


def test_the_husky_recording() -> None:
    run = read_bag(foreign("husky_a"))
    figure = experiment_figure([run], [load_robot("husky")])
    assert [panel.key for panel in figure.panels] == ["path", "yaw", "velocity_front"]
    assert {"planned path", "odometric path", "speed", "front motor torque"} == set(figure.missing)
    (path,) = figure["path"].lines
    assert pieces_of(path.x) == len(run.segments) > 100
    for line in figure["velocity_front"].lines:
        assert np.diff(line.x)[np.isfinite(np.diff(line.x))].max() <= SEGMENT_GAP
    assert len(figure["path"].outlines) == 1  # a rover a window would hide the paths


@pytest.mark.parametrize("what", ["none", "slope"])
def test_recordings_with_a_total_station_alone(what: str, agriq: Robot) -> None:
    run = read_bag(foreign(f"field_examples/{what}/run0"))
    figure = experiment_figure([run], [agriq])
    assert [panel.key for panel in figure.panels] == [
        "path",
        "velocity_front",
        "torque_front",
        "torque_back",
        "articulation",
    ]
    assert len(figure["path"].lines[0].x) == len(run.channels["total_station"])
