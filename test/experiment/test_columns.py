"""Columns cannot be changed behind anybody's back, and segments cover all stamps and nothing else."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment.columns import Channel, Experiment, find_segments
from artibot_sim.experiment.topics import TOPICS, find_topic, parse_renames


def channel(n: int = 5) -> Channel:
    t_ns = np.arange(n) * 10
    return Channel("/odom", t_ns, t_ns / 1e9, t_ns, {"x": np.arange(n, dtype=float)}, {"x": "m"})


def test_nothing_of_a_channel_can_be_changed() -> None:
    source = np.arange(5.0)
    t_ns = np.arange(5)
    c = Channel("/odom", t_ns, t_ns / 1e9, t_ns, {"x": source}, {"x": "m"})
    source[0] = 99.0
    assert c["x"][0] == 0.0
    for array in (c.t, c.t_ns, c.received_ns, c["x"]):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1
    with pytest.raises(TypeError):
        c.columns["y"] = source  # type: ignore[index]


def test_a_missing_column_lists_those_there_are() -> None:
    with pytest.raises(ArtibotError, match=r"/odom has no 'yaw'; it has x"):
        channel()["yaw"]


def test_a_column_of_the_wrong_length_is_refused() -> None:
    with pytest.raises(ArtibotError, match="column 'x'"):
        Channel("/odom", np.arange(3), np.arange(3.0), np.arange(3), {"x": np.arange(4.0)})


def test_require_says_how_to_rename() -> None:
    e = Experiment("run", "run", {}, 0, {"odom": channel()}, ((0.0, 1.0),), {"/odom": "t", "/lidar": "t"})  # type: ignore[arg-type]
    with pytest.raises(
        ArtibotError, match=r"no message on /ground_truth/odom; .*/lidar.*--topic /ground_truth/odom=FO"
    ):
        e.require("ground_truth_odom")
    with pytest.raises(ArtibotError, match="/odom has no yaw"):
        e.require("odom", "x", "yaw")
    assert e.require("odom", "x") is e.channels["odom"]


@given(st.lists(st.integers(0, 2_000_000_000), min_size=1, max_size=60), st.integers(0, 10**18))
def test_segments_partition_the_stamps(gaps: list[int], start: int) -> None:
    stamps = start + np.cumsum(np.array(gaps, np.int64))
    segments = find_segments(np.unique(stamps), start)
    t = (stamps - start) / 1e9
    inside = sum((t >= a) & (t <= b) for a, b in segments)
    assert (inside == 1).all()
    for (_, end), (begin, _) in zip(segments, segments[1:], strict=False):
        assert begin - end > 0.5
    for a, b in segments:
        own = np.unique(stamps[(t >= a) & (t <= b)])
        assert own[0] == start + round(a * 1e9)
        assert own[-1] == start + round(b * 1e9)
        assert (np.diff(own) <= 500_000_000).all()


def test_between_keeps_the_zero_of_time() -> None:
    c = channel().between(1.5e-8, 3.5e-8)
    assert c["x"].tolist() == [2.0, 3.0]
    assert c.t.tolist() == [2e-8, 3e-8]


def test_topics_are_found_by_any_of_their_names() -> None:
    for topic in TOPICS:
        assert find_topic(topic.name) is find_topic(topic.key) is find_topic(topic.name[1:]) is topic
    with pytest.raises(ArtibotError, match="'/nothing'"):
        find_topic("/nothing")


@pytest.mark.parametrize("pair", ["/odom", "=x", "/odom=", "/nothing=/x"])
def test_a_bad_rename_is_refused(pair: str) -> None:
    with pytest.raises(ArtibotError):
        parse_renames([pair])
    assert parse_renames(["odom=/wheels/odom"]) == {"/odom": "/wheels/odom"}
