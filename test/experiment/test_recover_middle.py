"""Damage in the middle of a recording costs what it hit: everything behind it is found again."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from bag_helpers import EPOCH, STEP, Message, mcap_file, messages, small_bag
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import Writer

from artibot_sim.experiment import recover
from artibot_sim.experiment.recover import DATA_END, HEAD, RecoverReport
from artibot_sim.experiment.storage import MAGIC

Span = tuple[int, int]


def damaged(draw: Callable[..., object], content: bytes) -> tuple[bytes, Span]:
    """The content with some bytes changed, zeroed, removed or added, and where."""
    at = draw(st.integers(0, len(content) - 1))
    kind = draw(st.sampled_from(["flip", "zeros", "noise", "removed", "added"]))
    if kind == "flip":
        return content[:at] + bytes([content[at] ^ (1 << draw(st.integers(0, 7)))]) + content[at + 1 :], (at, at + 1)
    if kind == "added":
        return content[:at] + draw(st.binary(min_size=1, max_size=300)) + content[at:], (at, at)
    last = min(len(content), at + draw(st.integers(1, 3000)))
    new = {"zeros": bytes(last - at), "noise": draw(st.randoms()).randbytes(last - at), "removed": b""}[kind]
    return content[:at] + new + content[last:], (at, last)


def recovered(folder: Path, content: bytes) -> tuple[RecoverReport, list[Message]]:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    (folder / "run_0.mcap").write_bytes(content)
    report = recover(folder / "run_0.mcap", folder / "saved")
    saved = messages(report.out)
    assert len(saved) == report.messages
    return report, saved


@pytest.fixture(scope="module", params=["zstd", "lz4", "none"])
def chunked(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of a dozen chunks."""
    folder = tmp_path_factory.mktemp("good") / "run"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("artibot_sim.experiment.writer.CHUNK_BYTES", 5000)
        return small_bag(folder, 200, compression=request.param, metadata={"robot": "agriq"})


def chunk_spans(file: Path) -> list[tuple[Span, Span]]:
    """Of each chunk the bytes and the log times."""
    with open(file, "rb") as stream:
        indexes = make_reader(stream).get_summary().chunk_indexes
    return [
        ((c.chunk_start_offset, c.chunk_start_offset + c.chunk_length), (c.message_start_time, c.message_end_time))
        for c in indexes
    ]


@settings(max_examples=25, deadline=None)
@given(data=st.data(), finished=st.booleans())
def test_everything_outside_the_damaged_chunks_comes_back(chunked: Path, data: st.DataObject, finished: bool) -> None:
    whole, file = messages(chunked), mcap_file(chunked)
    content, chunks = file.read_bytes(), chunk_spans(file)
    if not finished:  # killed: no summary
        content = content[: chunks[-1][0][1]]
    bad, (first, last) = damaged(data.draw, content)
    report, saved = recovered(chunked.parent / "bad", bad)
    assert set(saved) <= set(whole), "nothing is invented"
    assert len(set(saved)) == len(saved), "and nothing saved twice"
    lost = [times for (begin, end), times in chunks if begin <= last and first <= end]
    if not finished and chunks[0][1] in lost:
        return  # the first chunk says what the topics are; only a summary says it again
    safe = {m for m in whole if not any(begin <= m[1] <= end for begin, end in lost)}
    assert safe <= set(saved)
    if set(saved) != set(whole):
        assert not report.complete
        assert report.lost_bytes or report.gap_bytes or report.bad_chunks or report.unknown


def test_a_wrong_length_in_the_middle_costs_nothing_behind_it(chunked: Path) -> None:
    whole, content = messages(chunked), bytearray(mcap_file(chunked).read_bytes())
    begin = chunk_spans(mcap_file(chunked))[3][0][0]
    content[begin + 1 : begin + HEAD.size] = (2**40).to_bytes(8, "little")
    report, saved = recovered(chunked.parent / "bad", bytes(content))
    assert saved == whole, "the chunk says its own length again"
    content[begin + HEAD.size + 32 : begin + HEAD.size + 112] = bytes(80)
    report, saved = recovered(chunked.parent / "bad", bytes(content))
    assert report.gaps == 1 and not report.complete
    assert saved[-1] == whole[-1] and 0.8 * len(whole) < len(saved) < len(whole)


@pytest.fixture(scope="module")
def loose(tmp_path_factory: pytest.TempPathFactory) -> tuple[bytes, list[Message], list[Span]]:
    """A file without chunks: its bytes, messages, and where each message's record is."""
    file = tmp_path_factory.mktemp("loose") / "run_0.mcap"
    sent, spans = [], []
    with open(file, "wb") as stream:
        writer = Writer(stream, use_chunking=False)
        writer.start(profile="ros2", library="test")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
        numbers = [writer.register_channel(topic, "cdr", schema) for topic in ("/a", "/b")]
        for i in range(100):
            begin = stream.tell()
            data = bytes([0, 1, 0, 0]) + bytes((7 * i + k) % 256 for k in range(50 + i))
            writer.add_message(numbers[i % 2], EPOCH + i * STEP, data, EPOCH + i * STEP, i)
            sent.append((("/a", "/b")[i % 2], EPOCH + i * STEP, i, data))
            spans.append((begin, stream.tell()))
        writer.finish()
    return file.read_bytes(), sent, spans


@settings(max_examples=25, deadline=None)
@given(data=st.data())
def test_without_chunks_every_message_outside_the_damage_comes_back(
    loose: tuple[bytes, list[Message], list[Span]], tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    content, sent, spans = loose
    bad, (first, last) = damaged(data.draw, content)
    _, saved = recovered(tmp_path_factory.getbasetemp() / "loose", bad)
    safe = {m for m, (begin, end) in zip(sent, spans, strict=True) if end < first or begin > last}
    assert last <= spans[0][0] or safe <= set(saved), "unless the topics' own records were hit"


@pytest.mark.parametrize("opcode", [0x04, 0x05, 0x07, 0x0C, 0x26, 0x86, 0x00])
@pytest.mark.parametrize("finished", [True, False])
def test_a_chunk_is_known_by_its_header_whatever_its_opcode_says(chunked: Path, opcode: int, finished: bool) -> None:
    """One bit of one byte: the chunk behind it is whole, and that a byte was wrong is said."""
    whole, content = messages(chunked), mcap_file(chunked).read_bytes()
    chunks = chunk_spans(mcap_file(chunked))
    begin, _ = chunks[5][0]
    bad = content[:begin] + bytes([opcode]) + content[begin + 1 :]
    if not finished:  # killed after its last chunk: no summary says what is missing
        bad = bad[: chunks[-1][0][1]]
    report, saved = recovered(chunked.parent / "bad", bad)
    assert saved == whole
    assert (report.gaps, report.gap_bytes, report.bad_chunks) == (1, 1, 0)
    assert not report.complete


def opcodes(content: bytes) -> list[int]:
    """Where the records of the data section begin."""
    places, at = [], len(MAGIC)
    while content[at] != DATA_END:
        places.append(at)
        at += HEAD.size + HEAD.unpack_from(content, at)[1]
    return places


@pytest.mark.parametrize("finished", [True, False])
@pytest.mark.parametrize("chunked", ["zstd"], indirect=True)
def test_no_bit_of_an_opcode_takes_or_adds_a_message_unsaid(chunked: Path, finished: bool) -> None:
    """All bits of the first records of each kind: an index of a chunk's messages is one bit away from a message."""
    whole, content = messages(chunked), mcap_file(chunked).read_bytes()
    places = opcodes(content)
    for at in places[:7]:
        for bit in range(8):
            bad = content[:at] + bytes([content[at] ^ 1 << bit]) + content[at + 1 :]
            report, saved = recovered(chunked.parent / "bad", bad if finished else bad[: places[-1]])
            assert set(saved) <= set(whole), (at, bit)
            assert len(set(saved)) == len(saved)
            missing = set(whole) - set(saved)
            assert not missing or report.lost_bytes or report.gap_bytes or report.bad_chunks or report.unknown


def test_what_the_summary_counts_and_nobody_finds_is_said(chunked: Path) -> None:
    """A chunk that was cut out cleanly leaves no trace but the summary's count."""
    content, chunks = mcap_file(chunked).read_bytes(), chunk_spans(mcap_file(chunked))
    (begin, _), (first, last) = chunks[5]
    following = chunks[6][0][0]  # with its message indexes
    report, saved = recovered(chunked.parent / "bad", content[:begin] + content[following:])
    lost = [message for message in messages(chunked) if first <= message[1] <= last]
    assert report.missing == len(lost) == len(messages(chunked)) - len(saved)
    assert not report.complete
