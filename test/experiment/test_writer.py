"""The writer keeps what it was given: in time, whole, once, and also when the disk is full."""

from __future__ import annotations

import contextlib
import filecmp
import os
import resource
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest
import yaml
from bag_helpers import EPOCH, JOINTS, ROOT, STEP, joint_state, mcap_file, small_bag
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.stream_reader import StreamReader
from rosbags.rosbag2 import Reader

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment import BagWriter, bag_info, iter_messages, read_bag, recover

DATA = joint_state(EPOCH, ["front_right"], velocity=[1.0])


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_equal_input_gives_equal_bytes(tmp_path: Path, compression: str) -> None:
    (tmp_path / "b").mkdir()
    one = small_bag(tmp_path / "run", 500, compression=compression, metadata={"robot": "agriq"})
    two = small_bag(tmp_path / "b" / "run", 500, compression=compression, metadata={"robot": "agriq"})
    assert filecmp.cmp(mcap_file(one), mcap_file(two), shallow=False)
    assert filecmp.cmp(one / "metadata.yaml", two / "metadata.yaml", shallow=False)


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    folder = small_bag(tmp_path / "run", 10)
    before = mcap_file(folder).read_bytes()
    with pytest.raises(ArtibotError, match="exists already"):
        BagWriter(folder)
    assert mcap_file(folder).read_bytes() == before


def test_wrong_use_is_refused(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "run", live=False) as bag:
        with pytest.raises(ArtibotError, match="was not registered"):
            bag.write("/odom", DATA, 1, 1)
        bag.register("/joint_states", JOINTS)
        bag.register("/joint_states", JOINTS)
        with pytest.raises(ArtibotError, match="it was registered as sensor_msgs/msg/JointState"):
            bag.register("/joint_states", "nav_msgs/msg/Odometry")
        with pytest.raises(ArtibotError, match=r"'my_msgs/msg/Own' is not one of Jazzy's"):
            bag.register("/own", "my_msgs/msg/Own")
    with pytest.raises(ArtibotError, match="compression 'bz2'"):
        BagWriter(tmp_path / "other", compression="bz2")
    assert not (tmp_path / "other").exists()


def chunks_on_disk(file: Path) -> int:
    """Messages in the complete chunks of a file that is still open."""
    count = 0
    with open(file, "rb") as stream:
        records = StreamReader(stream, emit_chunks=True).records
        try:
            for record in records:
                count += isinstance(record, Chunk)
        except Exception:  # noqa: BLE001 - the file just ends, in one of mcap's several ways
            return count
    return count


def test_a_message_reaches_the_file_although_no_other_follows(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "run") as bag:
        bag.register("/joint_states", JOINTS)
        bag.write("/joint_states", DATA, EPOCH, EPOCH)
        deadline = time.monotonic() + 20
        while chunks_on_disk(bag.file) == 0 and time.monotonic() < deadline:
            time.sleep(0.02)
        assert chunks_on_disk(bag.file) == 1
        # metadata.yaml is there before the end, and already names the topic
        assert "/joint_states" in (tmp_path / "run" / "metadata.yaml").read_text()
    assert bag_info(tmp_path / "run").message_count == 1


def test_a_live_recording_is_the_same_recording(tmp_path: Path) -> None:
    live = read_bag(small_bag(tmp_path / "live", 200, live=True, sync_period=0.1))
    plain = read_bag(small_bag(tmp_path / "plain", 200))
    for key, channel in plain.channels.items():
        for name, values in channel.columns.items():
            assert values.tolist() == live.channels[key][name].tolist()


def test_close_is_idempotent_and_survives_an_error_of_the_caller(tmp_path: Path) -> None:
    with pytest.raises(KeyError, match="mine"), BagWriter(tmp_path / "run") as bag:
        bag.register("/joint_states", JOINTS)
        bag.write("/joint_states", DATA, EPOCH, EPOCH)
        raise KeyError("mine")
    bag.close()
    assert bag_info(tmp_path / "run").message_count == 1


def test_metadata_and_attachments_are_kept(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "run", live=False) as bag:
        bag.add_metadata("weather", {"wind": "none"})
        bag.add_attachment("robot.yaml", "text/yaml", b"robot: agriq")
    recovered = recover(tmp_path / "run").out
    for folder in (tmp_path / "run", recovered):
        with open(mcap_file(folder), "rb") as stream:
            reader = make_reader(stream)
            assert {r.name: r.metadata for r in reader.iter_metadata()}["weather"] == {"wind": "none"}
            assert [(a.name, a.data) for a in reader.iter_attachments()] == [("robot.yaml", b"robot: agriq")]


FILL = """
    import os, sys
    from artibot_sim.errors import ArtibotError
    from artibot_sim.experiment import BagWriter
    written = 0
    try:
        with BagWriter(sys.argv[1], {"robot": "agriq"}, live=sys.argv[2] == "live", compression="none") as bag:
            bag.register("/joint_states", "sensor_msgs/msg/JointState")
            data = bytes.fromhex(sys.argv[3])
            while written < 200_000:
                t = 1_700_000_000_000_000_000 + (written ^ 1) * 1_000_000  # out of order, as from several topics
                bag.write("/joint_states", data, t, t)
                written += 1
    except ArtibotError as error:
        print("refused:", error)
        sys.exit(2)
    sys.exit(0)
"""


def fill(folder: Path, live: bool, limit: int | None = None) -> subprocess.CompletedProcess[str]:
    """Write in a child process until the disk is full."""

    def restrict() -> None:
        if limit is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    return subprocess.run(
        [sys.executable, "-c", textwrap.dedent(FILL), str(folder), "live" if live else "plain", DATA.hex()],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=120,
        preexec_fn=restrict,
        check=False,
    )


def check_full(
    done: subprocess.CompletedProcess[str], folder: Path, size: int, elsewhere: Path, *, indexed: bool
) -> None:
    """One clear line, status 2, and everything up to the last chunk is there: as it is, and recovered."""
    assert done.returncode == 2, done.stderr
    assert done.stderr == ""
    (line,) = done.stdout.splitlines()
    assert str(mcap_file(folder)) in line
    assert "are kept" in line
    assert "free some space" in line
    report = recover(folder, elsewhere / "saved")
    assert report.messages * len(DATA) > size / 3  # all but the chunk in hand, of 1 MiB with its index
    assert f"the {report.messages} messages" in line
    assert sum(1 for _ in iter_messages(elsewhere / "saved")) == report.messages
    assert "readable as they are" in line
    assert ("artibot recover" in line) != indexed, "which makes the index where there is none"
    assert sum(1 for _ in iter_messages(folder)) == report.messages
    content = yaml.safe_load((folder / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert content["message_count"] == report.messages, "what `ros2 bag play` goes by"
    assert content["duration"]["nanoseconds"] == round(report.seconds * 1e9)
    if indexed:
        with Reader(folder) as bag:
            assert sum(1 for _ in bag.messages()) == report.messages
    assert {path.name for path in folder.iterdir()} == {"metadata.yaml", mcap_file(folder).name}


@pytest.mark.parametrize("live", [True, False])
def test_a_file_that_may_not_grow(tmp_path: Path, live: bool) -> None:
    size = 5 << 19
    done = fill(tmp_path / "run", live, limit=size)
    assert "File too large" in done.stdout
    check_full(done, tmp_path / "run", size, tmp_path, indexed=False)


@pytest.mark.parametrize("live", [True, False])
def test_a_full_disk(tmp_path: Path, live: bool) -> None:
    if os.geteuid() != 0:
        pytest.skip("mounting a small file system needs root; the limit on file size above stands in for it")
    disk = tmp_path / "disk"
    disk.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=6m", "tmpfs", str(disk)], capture_output=True, check=False
    )
    if mounted.returncode != 0:
        pytest.skip(f"no tmpfs can be mounted here: {mounted.stderr.decode().strip()}")
    try:
        done = fill(disk / "run", live)
        assert "No space left" in done.stdout
        check_full(done, disk / "run", 6 << 20, tmp_path, indexed=True)
        fill_rest(disk)
        for words, result in ((["recover", "run"], "run_recovered"), (["export", "run", "--to", "csv"], "run_csv")):
            before = {path.name for path in disk.iterdir()}
            done = call_artibot(*words, cwd=disk)
            assert done.returncode == 2, done.stderr
            (line,) = [each for each in done.stderr.splitlines() if each.startswith("artibot: ")]
            assert f"{result}: writing failed: No space left on device; nothing of it is kept" in line
            assert {path.name for path in disk.iterdir()} == before
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def fill_rest(disk: Path) -> None:
    """Take what room a disk has left."""
    with contextlib.suppress(OSError), open(disk / "rest", "wb", buffering=0) as rest:
        while True:
            rest.write(bytes(4096))


def call_artibot(*words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """A command line; what Python and numba keep goes elsewhere."""
    return subprocess.run(
        [sys.executable, "-m", "artibot_sim.cli", *words], env={**os.environ, "PYTHONPATH": str(ROOT)}, cwd=cwd,
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ArtibotError, match="cannot be made"):
        BagWriter(tmp_path / "file" / "run")


def test_a_computed_bag_is_whole_or_not_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import numpy as np

    from artibot_sim.experiment import write_channels

    stamps = EPOCH + np.arange(50) * STEP
    table = {"odom": (stamps, {"x": np.arange(50.0)})}
    calls = []

    def failing(self: BagWriter, *args: object, **kwargs: object) -> None:
        calls.append(1)
        if len(calls) > 20:
            raise OSError(5, "Input/output error")

    with monkeypatch.context() as patch:
        patch.setattr(BagWriter, "write", failing)
        with pytest.raises(OSError, match="Input/output"):
            write_channels(tmp_path / "run", table)
    assert list(tmp_path.iterdir()) == []
    write_channels(tmp_path / "run", table)
    assert read_bag(tmp_path / "run").channels["odom"]["x"].tolist() == list(range(50))
    with pytest.raises(ArtibotError, match="exists already"):
        write_channels(tmp_path / "run", table)
    with pytest.raises(ArtibotError, match="column 'x' has 49 rows"):
        write_channels(tmp_path / "other", {"odom": (stamps, {"x": np.arange(49.0)})})
