"""A recording in two parts: no sample is in both, and each is of the whole time."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment import Channel, Experiment
from artibot_sim.experiment.blocks import BLOCK, HELD_OUT, in_turn, without_share


def recording(segments: tuple[tuple[float, float], ...]) -> Experiment:
    t = np.concatenate([np.arange(a, b + 1e-9, 0.05) for a, b in segments])
    stamps = np.round(t * 1e9).astype(np.int64)
    channel = Channel("/motor_torques", stamps, t, stamps, {"front_right.velocity": np.sin(t)})
    return Experiment("drive", Path("drive"), {}, 0, {"motor_torques": channel}, segments)


LONG = recording(((0.0, 300.0),))
SHORT = recording(tuple((3.0 * i, 3.0 * i + 1.95) for i in range(120)))


@pytest.mark.parametrize("one", [LONG, SHORT])
@pytest.mark.parametrize("share", [0.2, 1 / 3, 0.5, 0.75])
def test_parts_share_no_sample_and_are_of_the_whole_time(one: Experiment, share: float) -> None:
    fitted, held = in_turn(one, share)
    times = [part.channels["motor_torques"].t for part in (fitted, held)]
    assert not set(times[0]) & set(times[1])
    assert len(times[0]) + len(times[1]) >= len(one.channels["motor_torques"]) - 2 * len(held.segments)
    assert len(times[1]) / sum(map(len, times)) == pytest.approx(share, abs=0.06)
    for t in times:
        assert t[0] < one.duration / min(share, 1.0 - share) / 4.0 and t[-1] > 0.7 * one.duration
    for part, t in zip((fitted, held), times, strict=True):
        assert all(((t >= a) & (t <= b)).sum() > 30 for a, b in part.segments)


def test_short_segments_stay_whole() -> None:
    fitted, held = in_turn(SHORT)
    assert {*fitted.segments, *held.segments} == set(SHORT.segments)
    assert max(b - a for a, b in in_turn(LONG)[0].segments) < 1.01 * BLOCK


def test_names_tell_the_parts_apart_and_nonsense_is_refused() -> None:
    (fitted,), (held,) = without_share([LONG], 0.5)
    assert (fitted.name, held.name) == ("drive", "drive" + HELD_OUT)
    with pytest.raises(ArtibotError, match="share to hold out: 1"):
        without_share([LONG], 1.0)
    with pytest.raises(ArtibotError, match="too short to hold out 50 %"):
        in_turn(replace(LONG, segments=((0.0, 8.0),)))
