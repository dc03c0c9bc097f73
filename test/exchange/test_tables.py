"""Recordings as tables and back: what is written is what was recorded, other programs read it, and errors say where."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from bag_helpers import EPOCH, JOINTS, ROOT, joint_state
from report_helpers import recording

from artibot_sim.cli import main
from artibot_sim.errors import ArtibotError
from artibot_sim.exchange.columns import load_columns
from artibot_sim.exchange.inspection import inspect_recording
from artibot_sim.exchange.logs import import_logs
from artibot_sim.exchange.tables import joined
from artibot_sim.experiment import BagWriter, read_bag, serialize

BAG = ROOT / "bags" / "table6_agriq"


def rows_of(path: Path) -> list[dict[str, str]]:
    """A CSV file as the standard library reads it."""
    return list(csv.DictReader(io.StringIO(path.read_text(encoding="utf-8"))))


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_tables_make_the_same_recording_again(tmp_path: Path, form: str) -> None:
    assert main(["export", str(BAG), "--to", form, "--out", str(tmp_path / "t")]) == 0
    files = [str(path) for path in sorted((tmp_path / "t").glob(f"*.{form}"))]
    again = tmp_path / "again"
    assert main(["import", *files, "--columns", str(tmp_path / "t" / "columns.yaml"), "--out", str(again)]) == 0
    one, other = read_bag(BAG), read_bag(again)
    written = {"odom", "ground_truth_odom", "joint_states", "motor_torques", "motor_command", "planned_odom"}
    assert set(other.channels) == written
    assert other.metadata["robot"] == "agriq"
    for key in written:
        assert np.array_equal(one.channels[key].t_ns, other.channels[key].t_ns)
        for name, values in one.channels[key].columns.items():
            assert np.allclose(values, other.channels[key][name], rtol=0, atol=1e-12, equal_nan=True), (key, name)


def test_other_programs_read_the_tables_with_their_units(tmp_path: Path) -> None:
    for form in ("csv", "parquet"):
        main(["export", str(BAG), "--to", form, "--out", str(tmp_path / form)])
    motors = read_bag(BAG).channels["motor_torques"]
    rows = rows_of(tmp_path / "csv" / "motor_torques.csv")
    assert list(rows[0])[:3] == ["time [s]", "stamp [ns]", "front_right.position [rad]"]
    speeds = [float(row["front_left.velocity [rad/s]"]) for row in rows]
    assert np.array_equal(speeds, motors["front_left.velocity"])  # every digit
    assert [int(row["stamp [ns]"]) for row in rows] == motors.t_ns.tolist()
    table = pq.read_table(tmp_path / "parquet" / "motor_torques.parquet")
    assert table.schema.field("back_right.effort").metadata == {b"unit": "N·m".encode()}
    assert table.schema.metadata[b"robot"] == b"agriq"
    assert np.array_equal(table.column("back_right.effort"), motors["back_right.effort"])


def test_a_joined_table_keeps_to_segments_silences_and_commands(tmp_path: Path) -> None:
    t = np.concatenate([np.arange(0, 4, 0.01), np.arange(9, 12, 0.01)])
    pose_t = t[(t < 1) | (t > 2)] + 0.003
    command_t = np.array([0.0, 0.3, 0.6])
    experiment = recording(
        tmp_path / "run",
        {
            "motor_torques": (t, {"front_right.velocity": 2.0 * t}),
            "ground_truth_odom": (pose_t, {"x": 3.0 * pose_t, "y": 0 * pose_t, "yaw": 0 * pose_t}),
            "motor_command": (command_t, {"front_right.velocity": np.array([1.0, 2.0, 3.0])}),
        },
    )
    table = joined(experiment, 20.0)
    column = {name: np.array(table.column(name).to_pylist(), float) for name in table.column_names}
    assert set(column["segment"]) == {0.0, 1.0}
    assert not ((column["time"] > 4.1) & (column["time"] < 8.9)).any()
    assert np.allclose(column["motor_torques/front_right.velocity"], 2.0 * column["time"], atol=1e-9)
    x = column["ground_truth_odom/x"]
    silent = (column["time"] > 1.01) & (column["time"] < 1.99)
    assert np.isnan(x[silent]).all()
    assert np.allclose(x[np.isfinite(x)], 3.0 * column["time"][np.isfinite(x)])
    given = column["motor_command/front_right.velocity"]
    assert given[[1, 8, 20]].tolist() == [1.0, 2.0, 3.0]  # held, not drawn out to a ramp
    assert np.isnan(given[column["time"] > 1.2]).all()


LOG = """time_ms,rpm_right,rpm_left,counts_right,counts_left,easting,northing,gyro_z
0,-60,60,0,0,372000.5,4995000.25,0
20,-60,60,-2048,2048,,,9
40,-60,90,-4096,4096,372000.75,4995000.5,18
60,,120,-6144,6144,372001,4995001,90
"""


def test_the_shipped_columns_file_reads_a_log_in_other_units(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text(LOG)
    import_logs([tmp_path / "log.csv"], load_columns("rover_log"), tmp_path / "run")
    run = read_bag(tmp_path / "run")
    motors, station = run.channels["motor_torques"], run.channels["total_station"]
    assert run.start_ns == 1_777_888_800_000_000_000  # date -d 2026-05-04T10:00:00Z +%s
    assert motors["front_right.velocity"][0] == pytest.approx(2 * np.pi)  # mounted mirrored
    assert motors["front_left.velocity"].tolist() == pytest.approx([2 * np.pi, 2 * np.pi, 3 * np.pi, 4 * np.pi])
    assert motors["front_right.position"].tolist() == pytest.approx([0, 2 * np.pi, 4 * np.pi, 6 * np.pi])
    assert station["x"].tolist() == [0.5, 0.75, 1.0]  # an empty cell is no measurement
    assert station.t.tolist() == pytest.approx([0.0, 0.04, 0.06])
    assert run.channels["imu"]["yaw_rate"][3] == pytest.approx(np.pi / 2)
    assert not np.isfinite(run.channels["imu"].columns.get("ax", np.full(1, np.nan))).any()
    assert run.metadata["robot"] == "agriq"


def write_columns(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


POSE = """
topics:
  /ground_truth/odom:
    x: {column: x, unit: m}
    y: {column: y, unit: m}
    yaw: {column: heading, unit: deg}
"""


def test_a_pose_without_a_speed_claims_none(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("t;x;y;heading\n0;1,5;2;90\n0,1;1,6;2;91\n")
    columns = write_columns(tmp_path / "c.yaml", "time: {column: t, unit: s}" + POSE)
    import_logs([tmp_path / "log.csv"], load_columns(columns), tmp_path / "run")
    pose = read_bag(tmp_path / "run").channels["ground_truth_odom"]
    assert pose["x"].tolist() == [1.5, 1.6]
    assert pose["yaw"].tolist() == pytest.approx([np.pi / 2, 91 * np.pi / 180])
    assert np.isnan(pose["vx"]).all()


def test_dates_are_read(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("t,x,y,heading\n2026-05-04T10:00:00.25Z,1,2,90\n2026-05-04T10:00:01Z,1,2,90\n")
    columns = write_columns(tmp_path / "c.yaml", "time: {column: t, unit: iso8601}" + POSE)
    import_logs([tmp_path / "log.csv"], load_columns(columns), tmp_path / "run")
    run = read_bag(tmp_path / "run")
    assert run.start_ns == 1_777_888_800_250_000_000
    assert run.channels["ground_truth_odom"].t.tolist() == [0.0, 0.75]


GOOD = "time: {column: t, unit: s}" + POSE


@pytest.mark.parametrize(
    ("columns", "log", "said"),
    [
        (GOOD.replace("unit: deg", "unit: degrees"), LOG, r"yaw.unit: found 'degrees', did you mean 'deg'\?"),
        (GOOD.replace("heading", "headin"), "t,x,y,heading\n0,1,2,3\n", r"no column 'headin' .*did you mean 'heading'"),
        (GOOD, "t,x,y,heading\n0,1,2,3\n1,1,oops,3\n", r"log.csv: row 2: column y is 'oops'; expected a number"),
        (GOOD, "t,x,y,heading\n0,1,2,3\n5,1,2,3\n1,1,2,3\n", r"row 3: t goes back by 4 s; cut the log there"),
        (GOOD, "t,x,y,heading\n", r"log.csv: no row; expected a header line"),
        (GOOD, "", r"log.csv: not a table: Empty CSV file"),
        (GOOD, "t,x,y,y,heading\n0,1,2,2,3\n", r"column y stands twice"),
        (GOOD.replace("yaw: {column: heading, unit: deg}", ""), "t,x,y\n0,1,2\n", r"yaw missing; points without"),
        (GOOD.replace("/ground_truth/odom", "/ground_truth"), LOG, r"topic '/ground_truth' is not one"),
        (GOOD.replace("yaw:", "yaaw:"), LOG, r"odom.yaaw: unknown quantity; expected one of x, y"),
        (GOOD.replace("time: {column: t, unit: s}", ""), "t,x,y,heading\n0,1,2,3\n", r"names no time; add time"),
        (GOOD.replace("unit: s", "unit: h"), LOG, r"time: found .*unit: s, ms, us, ns or iso8601"),
        ("robt: agriq\n" + GOOD, LOG, r"robt: unknown key, did you mean 'robot'\?"),
        ("start: noon\n" + GOOD, LOG, r"start: found 'noon', expected a date"),
        (GOOD, "t,x,y,heading\n0,,2,3\n", r"no row has x and y and yaw"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_in_one_line_and_nothing_is_left(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], columns: str, log: str, said: str
) -> None:
    import re

    (tmp_path / "log.csv").write_text(log)
    file = write_columns(tmp_path / "c.yaml", columns)
    assert main(["import", str(tmp_path / "log.csv"), "--columns", str(file), "--out", str(tmp_path / "run")]) == 2
    line = capsys.readouterr().err
    assert line.count("\n") == 1
    assert re.search(said, line), line
    assert sorted(path.name for path in tmp_path.iterdir()) == ["c.yaml", "log.csv"]


ONE_SIDED = """
topics:
  /motor_torques:
    front_right.velocity: {from: /right/speed, column: data, unit: rpm}
    front_left.velocity: {from: /left/state, column: hub.velocity, unit: rad/s, scale: -1}
"""


def test_a_bag_with_a_topic_a_side_is_named_and_joined(tmp_path: Path) -> None:
    path = tmp_path / "foreign"
    with BagWriter(path, live=False) as writer:
        writer.register("/right/speed", "std_msgs/msg/Float64")
        writer.register("/left/state", JOINTS)
        for i in range(200):
            t = EPOCH + 20_000_000 * i
            writer.write("/right/speed", serialize("std_msgs/msg/Float64", data=float(i)), t, t)
            late = t + 7_000_000
            writer.write("/left/state", joint_state(late, ["hub"], velocity=[-0.5 * (i + 0.35)]), late, late)
    found = inspect_recording(path)
    assert any("artibot import" in line for line in found.advice)
    columns = write_columns(tmp_path / "c.yaml", ONE_SIDED)
    assert main(["import", str(path), "--columns", str(columns), "--out", str(tmp_path / "named")]) == 0
    motors = read_bag(tmp_path / "named").channels["motor_torques"]
    right, left = motors["front_right.velocity"], motors["front_left.velocity"]
    assert right[:5].tolist() == pytest.approx([i * 2 * np.pi / 60 for i in range(5)])
    assert np.allclose(left[1:], 0.5 * np.arange(1, 200), atol=1e-6)  # linear between its own stamps
    assert inspect_recording(tmp_path / "named").topics[0].columns == ("front_right.velocity", "front_left.velocity")


def test_fields_of_any_message_can_be_exported(tmp_path: Path) -> None:
    path = tmp_path / "foreign"
    with BagWriter(path, live=False) as writer:
        writer.register("/odom", "nav_msgs/msg/Odometry")
        writer.register("/left/speed", "std_msgs/msg/Float64")
        from bag_helpers import odometry

        for i in range(30):
            t = EPOCH + 20_000_000 * i
            writer.write("/odom", odometry(t, x=float(i)), t, t)
            writer.write("/left/speed", serialize("std_msgs/msg/Float64", data=float(i)), t, t)
    assert main(["export", str(path), "--to", "csv", "--all", "--out", str(tmp_path / "t")]) == 0
    assert [float(row["data"]) for row in rows_of(tmp_path / "t" / "left_speed.csv")] == list(range(30))
    assert (tmp_path / "t" / "odom.csv").is_file()


def test_an_export_overwrites_nothing(tmp_path: Path) -> None:
    (tmp_path / "t").mkdir()
    assert main(["export", str(BAG), "--to", "csv", "--out", str(tmp_path / "t")]) == 2
    assert not list((tmp_path / "t").iterdir())


def test_a_columns_file_for_what_cannot_be_is_refused(tmp_path: Path) -> None:
    text = "topics:\n  /motor_torques:\n    wheel.velocity: {column: a, unit: rpm}\n"
    with pytest.raises(ArtibotError, match=r"wheel.velocity: unknown quantity; expected one of front_right.velocity"):
        load_columns(write_columns(tmp_path / "c.yaml", text))
