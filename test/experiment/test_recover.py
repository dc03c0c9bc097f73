"""`recover` saves every message that is whole, and only those."""

from __future__ import annotations

import hashlib
import shutil
from pathlib import Path

import pytest
from bag_helpers import Message, mcap_file, messages, small_bag
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader

from artibot_sim.cli.recover import command
from artibot_sim.errors import ArtibotError
from artibot_sim.experiment import recover
from artibot_sim.experiment.writer import BagWriter


def check_valid(folder: Path, expected: list[Message]) -> None:
    """The recovered bag is a bag to mcap (with index and right checksums) and to rosbags."""
    assert messages(folder) == expected
    with open(mcap_file(folder), "rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert reader.get_summary().statistics.message_count == len(expected)
        assert [m.data for _, _, m in reader.iter_messages()] == [data for *_, data in expected]
    with Reader(folder) as bag:
        assert [bytes(data) for _, _, data in bag.messages()] == [data for *_, data in expected]


@pytest.fixture(scope="module", params=["zstd", "lz4", "none"])
def good(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of several chunks."""
    folder = tmp_path_factory.mktemp("good") / "run"
    import bag_helpers

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("artibot_sim.experiment.writer.CHUNK_BYTES", 5000)
        return bag_helpers.small_bag(folder, 200, compression=request.param, metadata={"robot": "agriq"})


@settings(max_examples=20, deadline=None)
@given(data=st.data())
def test_a_recording_cut_anywhere_gives_its_first_messages(good: Path, data: st.DataObject) -> None:
    whole = messages(good)
    content = mcap_file(good).read_bytes()
    cut = data.draw(st.integers(8, len(content)))
    folder = good.parent / "cut"
    shutil.rmtree(folder, ignore_errors=True)
    shutil.rmtree(good.parent / "saved", ignore_errors=True)
    folder.mkdir()
    (folder / "run_0.mcap").write_bytes(content[:cut])
    report = recover(folder, good.parent / "saved")
    check_valid(report.out, whole[: report.messages])
    assert report.complete == (cut >= len(content) - 8)  # the last 8 bytes are the end mark alone
    # nothing is given up that was written in full: the chunks before the cut, at least
    with open(mcap_file(good), "rb") as stream:
        indexes = make_reader(stream).get_summary().chunk_indexes
    safe = [c for c in indexes if c.chunk_start_offset + c.chunk_length <= cut]
    assert report.messages >= sum(1 for m in whole if safe and m[1] <= safe[-1].message_end_time)


def test_what_can_be_decompressed_of_a_truncated_chunk_is_saved(tmp_path: Path) -> None:
    folder = small_bag(tmp_path / "run", 1000, compression="none")
    whole = messages(folder)
    file = mcap_file(folder)
    with open(file, "rb") as stream:
        (chunk,) = make_reader(stream).get_summary().chunk_indexes
    file.write_bytes(file.read_bytes()[: chunk.chunk_start_offset + chunk.chunk_length // 2])
    report = recover(folder)
    assert 400 < report.messages < 600
    assert (report.bad_chunks, report.complete) == (1, False)
    check_valid(report.out, whole[: report.messages])


@settings(max_examples=12, deadline=None)
@given(garbage=st.binary(min_size=1, max_size=300))
def test_garbage_after_the_end_is_left_out(good: Path, garbage: bytes) -> None:
    folder = good.parent / "tail"
    for old in (folder, good.parent / "saved"):
        shutil.rmtree(old, ignore_errors=True)
    folder.mkdir()
    (folder / "run_0.mcap").write_bytes(mcap_file(good).read_bytes() + garbage)
    report = recover(folder, good.parent / "saved")
    assert report.garbage_bytes == len(garbage)
    check_valid(report.out, messages(good))


@settings(max_examples=20, deadline=None)
@given(data=st.data())
def test_garbage_after_a_cut_adds_nothing(good: Path, data: st.DataObject) -> None:
    whole = messages(good)
    content = mcap_file(good).read_bytes()
    cut = data.draw(st.integers(8, len(content) - 40))
    garbage = data.draw(st.one_of(st.binary(max_size=200), st.just(bytes(4096))))
    folder = good.parent / "torn"
    for old in (folder, good.parent / "saved"):
        shutil.rmtree(old, ignore_errors=True)
    folder.mkdir()
    (folder / "run_0.mcap").write_bytes(content[:cut] + garbage)
    report = recover(folder, good.parent / "saved")
    assert messages(report.out) == whole[: report.messages]


def test_a_chunk_with_changed_bytes_is_left_out_and_the_rest_saved(good: Path, tmp_path: Path) -> None:
    whole = messages(good)
    content = bytearray(mcap_file(good).read_bytes())
    with open(mcap_file(good), "rb") as stream:
        indexes = make_reader(stream).get_summary().chunk_indexes
    bad = indexes[len(indexes) // 2]
    content[bad.chunk_start_offset + bad.chunk_length - 20] ^= 0xFF
    (tmp_path / "run_0.mcap").write_bytes(content)
    report = recover(tmp_path / "run_0.mcap")
    assert report.bad_chunks == 1
    saved = messages(report.out)
    outside = [m for m in whole if not bad.message_start_time <= m[1] <= bad.message_end_time]
    assert set(outside) <= set(saved) <= set(whole)


def test_the_recording_is_not_changed_and_nothing_overwritten(tmp_path: Path) -> None:
    folder = small_bag(tmp_path / "run", 50)
    mcap_file(folder).write_bytes(mcap_file(folder).read_bytes()[:-200])
    (folder / "metadata.yaml").unlink()

    def state() -> dict[str, str]:
        return {f.name: hashlib.sha256(f.read_bytes()).hexdigest() for f in folder.iterdir()}

    before = state()
    report = recover(folder)
    assert report.out == tmp_path.resolve() / "run_recovered"
    assert state() == before
    with pytest.raises(ArtibotError, match="run_recovered: exists already"):
        recover(folder)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["run", "run_recovered"]


@pytest.mark.parametrize(
    ("content", "said"),
    [(b"", "is empty"), (b"a,b\n1,2\n", "nothing to recover"), (b"SQLite format 3\x00", "SQLite")],
)
def test_what_cannot_be_recovered_leaves_nothing_behind(tmp_path: Path, content: bytes, said: str) -> None:
    file = tmp_path / "x.mcap"
    file.write_bytes(content)
    with pytest.raises(ArtibotError, match=said):
        recover(file)
    assert list(tmp_path.iterdir()) == [file]
    with pytest.raises(ArtibotError, match="no such file"):
        recover(tmp_path / "nothing")


def test_a_recording_killed_before_its_first_message_becomes_an_empty_bag(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "run", {"robot": "agriq"}, live=False)
    report = recover(tmp_path / "run")
    assert (report.messages, report.seconds, report.topics) == (0, 0.0, {})
    check_valid(report.out, [])
    bag.close()


def test_the_command_says_how_much_and_where(tmp_path: Path) -> None:
    folder = small_bag(tmp_path / "run", 300)
    file = mcap_file(folder)
    file.write_bytes(file.read_bytes()[:-100])
    result = CliRunner().invoke(command, [str(folder)])
    assert result.exit_code == 0, result.output
    text = " ".join(result.output.split())
    assert "saved 300 messages, 2.99 s, 2 topics" in text
    assert "/motor_torques 150" in text
    assert str(tmp_path / "run_recovered") in result.output
    assert "Example" in CliRunner().invoke(command, ["--help"]).output


def test_the_command_refuses_in_one_line(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    from artibot_sim.cli import main

    assert main(["recover", str(tmp_path / "nothing")]) == 2
    error = capfd.readouterr().err
    assert error.count("\n") == 1
    assert str(tmp_path / "nothing") in error


def test_progress_is_a_share_that_grows(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "long", live=False) as bag:
        bag.register("/odom", "nav_msgs/msg/Odometry")
        for i in range(20_000):
            bag.write("/odom", bytes(256), i, i)
    told: list[float] = []
    assert recover(tmp_path / "long", progress=told.append).messages == 20_000
    assert len(told) >= 20
    assert told == sorted(told)
    assert told[0] >= 0 and 0.5 < told[-1] <= 1
