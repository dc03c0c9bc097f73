"""A damaged, empty or foreign file gets one clear error: never a traceback from inside, never half a result."""

from __future__ import annotations

from pathlib import Path

import pytest
from bag_helpers import mcap_file, small_bag
from hypothesis import given, settings
from hypothesis import strategies as st

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment import bag_info, read_bag


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return mcap_file(small_bag(tmp_path_factory.mktemp("good") / "run", 120)).read_bytes()


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "is empty"),
        (b"time,x,y\n0,1,2\n", "not a recording"),
        (b"#ROSBAG V2.0\n" + bytes(100), "ROS 1 bag"),
        (b"\x28\xb5\x2f\xfd" + bytes(100), "zstd -d"),
        (b"\x89MCAP0\r\n", "artibot recover"),
        (b"SQLite format 3\x00" + bytes(4096), "damaged SQLite"),
    ],
)
def test_foreign_and_empty_files(tmp_path: Path, content: bytes, said: str) -> None:
    file = tmp_path / "thing.mcap"
    file.write_bytes(content)
    for read in (read_bag, bag_info):
        with pytest.raises(ArtibotError, match=said) as error:
            read(file)
        assert str(file) in str(error.value)
        assert "\n" not in str(error.value)


def test_missing_and_empty_folders(tmp_path: Path) -> None:
    with pytest.raises(ArtibotError, match="no such file or folder"):
        read_bag(tmp_path / "nothing")
    (tmp_path / "empty").mkdir()
    with pytest.raises(ArtibotError, match=r"no \.mcap or \.db3 file"):
        read_bag(tmp_path / "empty")
    (tmp_path / "empty" / "a_0.mcap.zstd").write_bytes(b"x")
    with pytest.raises(ArtibotError, match="decompress it"):
        read_bag(tmp_path / "empty")


def test_a_recording_without_messages_says_so(tmp_path: Path) -> None:
    folder = small_bag(tmp_path / "run", 0)
    with pytest.raises(ArtibotError, match=r"no message was recorded"):
        read_bag(folder)
    assert bag_info(folder).message_count == 0


@pytest.mark.parametrize(
    "yaml_text",
    [
        "",
        "not: [yaml",
        "rosbag2_bagfile_information: 7",
        "rosbag2_bagfile_information: {relative_file_paths: [gone.mcap]}",
    ],
)
def test_the_mcap_file_is_found_whatever_metadata_yaml_says(tmp_path: Path, yaml_text: str) -> None:
    folder = small_bag(tmp_path / "run", 20)
    (folder / "metadata.yaml").write_text(yaml_text)
    assert bag_info(folder).message_count == 20
    (folder / "metadata.yaml").unlink()
    assert len(read_bag(folder).channels) == 2


@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_a_file_cut_anywhere_is_refused_with_the_mend(
    good: bytes, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    cut = data.draw(st.integers(8, len(good) - 1))
    file = tmp_path_factory.getbasetemp() / "cut.mcap"
    file.write_bytes(good[:cut])
    with pytest.raises(ArtibotError, match=r"cut\.mcap: .*run `artibot recover"):
        read_bag(file)


@settings(max_examples=400, deadline=None)
@given(data=st.data())
def test_changed_bytes_are_noticed_or_harmless(
    good: bytes, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    """Any single changed byte: either an ArtibotError, or the messages are those that were written."""
    at = data.draw(st.integers(0, len(good) - 1))
    value = data.draw(st.integers(0, 255).filter(lambda v: v != good[at]))
    file = tmp_path_factory.getbasetemp() / "changed.mcap"
    file.write_bytes(good[:at] + bytes([value]) + good[at + 1 :])
    try:
        experiment = read_bag(file)
    except ArtibotError as error:
        assert "changed.mcap" in str(error)
        return
    for channel in experiment.channels.values():
        assert len(channel) == 60


def test_a_compressed_recording_is_read_once_it_was_unpacked_as_the_refusal_says(tmp_path: Path) -> None:
    """metadata.yaml goes on naming the compressed file, which `zstd -d` leaves where it is."""
    zstandard = pytest.importorskip("zstandard")
    folder = small_bag(tmp_path / "run", 50)
    plain = mcap_file(folder)
    packed = plain.with_name(f"{plain.name}.zstd")
    packed.write_bytes(zstandard.ZstdCompressor().compress(plain.read_bytes()))
    metadata = folder / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace(plain.name, packed.name))
    content = plain.read_bytes()
    plain.unlink()
    with pytest.raises(ArtibotError, match="zstd -d"):
        read_bag(folder)
    plain.write_bytes(zstandard.ZstdDecompressor().decompress(packed.read_bytes()))
    assert plain.read_bytes() == content
    assert bag_info(folder).files == (plain,)
    assert read_bag(folder).channels
